"""A batch: concrete scenarios of one file that run together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from threading import Lock
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.plugin_errors import format_time_of_failure
from cornercase._common.text.element_locations import add_location_to_input_errors
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import Driver
from cornercase.drivers._attached_driver import DriverError
from cornercase.drivers._parameters import find_parameter, must_be_same_in_batch, read_parameters
from cornercase.recordings import Collision, Recording
from cornercase.scenario import Value
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._other_formats import later_minor_version
from cornercase.scenario._scope import Scope
from cornercase.scenario._seeds import ScenarioSeeds
from cornercase.simulators.builtin._entities import read_entities
from cornercase.simulators.builtin._prepared_file import PreparedScenario, UnusableValuesError
from cornercase.simulators.builtin._stepper import Coupling, Stepper
from cornercase.simulators.builtin.actions._controller import DriverControl, create_file_driver
from cornercase.simulators.builtin.kernels._recording_pages import copy_motion
from cornercase.simulators.builtin.kernels._simulation_state import CENTER_X, LENGTH, WIDTH
from cornercase.simulators.builtin.paths._positions import read_entity_refs
from cornercase.simulators.builtin.storyboard._storyboard import Storyboard
from cornercase.simulators.builtin.world._traffic_signals import read_signal_controllers
from cornercase.simulators.builtin.world._world import World

_MAX_ENTITIES: Final = 500


class Batch:
    """Concrete scenarios of one file that run together, since they have the same storyboard.

    `values` and `seeds` have one entry per scenario. `drivers` maps entities to drivers, and overrides the controllers
    in the file. `coupling` is another simulator that moves some of the entities. Raises `UnusableValuesError` if the
    file cannot be used with these parameter values, and `BatchSplitError` if the scenarios must be split into smaller
    batches.

    `failure` is the error of a driver that ended the run early. In a batch of one scenario, `failure` is the result. In
    a larger batch, the scenario at fault is unknown, and no result can be used.
    """

    def __init__(
        self,
        prepared: PreparedScenario,
        values: Sequence[Mapping[str, Value]],
        seeds: Sequence[int],
        time_step: float,
        duration: float,
        stop_at_collision: bool,
        drivers: Mapping[str, Driver | str],
        coupling: Coupling | None = None,
    ) -> None:
        self._parameters, self._values = split_off_driver_parameters(prepared.scenario, values)
        scope, self._file_name = prepared.scenario.scope(self._values), prepared.scenario.path.name
        self._time_step = time_step
        self.failure: DriverError | None = None
        try:
            self._read_file(prepared, scope, seeds, drivers, duration)
        except InputError as error:
            minor, message = later_minor_version(prepared.scenario.root), str(error)
            if minor is not None and "not supported" in message:
                message = f"{message.removesuffix('.')}. OpenSCENARIO XML 1.{minor}, the file's version, may have it."
            raise UnusableValuesError(message, scope.split_parameters) from None
        self._stepper = Stepper(self._world, self._storyboard, time_step, duration, stop_at_collision, coupling)

    def _read_file(
        self,
        prepared: PreparedScenario,
        scope: Scope,
        seeds: Sequence[int],
        drivers: Mapping[str, Driver | str],
        duration: float,
    ) -> None:
        scenario = prepared.scenario
        prepared.check_elements_supported()
        storyboard = scenario.root.find("Storyboard")
        init_element = None if storyboard is None else storyboard.find("Init")
        reference = storyboard if init_element is None else init_element
        self._init_location = "" if reference is None else f"line {reference.sourceline}: <{reference.tag}>"
        logic_file = scenario.root.find("RoadNetwork/LogicFile")
        road_file = "" if logic_file is None else scope.read_text(logic_file, "filepath", "")
        with add_location_to_input_errors(logic_file, scope.file_name):
            network = prepared.road_network(road_file) if road_file else None
        objects = list(scenario.root.iterfind("Entities/ScenarioObject"))
        with add_location_to_input_errors(scenario.root.find("Entities"), scope.file_name):
            if not objects:
                raise InputError("has no entities, so there is nothing to simulate.")
            if len(objects) > _MAX_ENTITIES:
                raise InputError(
                    f"has {len(objects)} entities; the builtin simulator supports at most {_MAX_ENTITIES}."
                )
        entities, tows = read_entities(objects, scope)
        self._world = World(entities, scope.n_scenarios, network, tows, self._time_step, duration)
        self._world.values = self._values
        self._world.signal_controllers = read_signal_controllers(scenario.root, scope)
        _read_entity_selections(scenario.root, self._world, scope)
        # A copied file names other paths.
        names = scope.parameter_values.keys() - scenario.path_parameters
        self._world.seeds = ScenarioSeeds(seeds, {name: scope.parameter_values[name] for name in names})
        self._world.parameters = {
            name: _to_parameter_array(value, scope.n_scenarios) for name, value in scope.parameter_values.items()
        }
        self._world.variables = scope.read_declared_values(
            scenario.root, "VariableDeclarations/VariableDeclaration", "variableType"
        )
        lines = {declaration.name: declaration.sourceline for declaration in prepared.declarations}
        for name, is_violated in scope.find_violations_in(scenario.root).items():
            message = f"line {lines.get(name)}: the value of {name} breaks a constraint of its <ParameterDeclaration>"
            self._world.fail(is_violated, message)
        drivers_by_entity = {**scenario.drivers, **drivers}
        for e, name in enumerate(self._world.names):
            driver = drivers_by_entity.get(name)
            if driver is None:
                continue
            with add_location_to_input_errors(None if name in drivers else objects[e], scope.file_name):
                driver_object = create_file_driver(driver, scope.file_name) if isinstance(driver, str) else driver
            number = DriverControl(self._world, e, driver_object, self._read_parameters(name, driver_object)).number
            self._world.has_fixed_driver[e] = name in drivers
            self._world.assign_control(e, np.ones(scope.n_scenarios, dtype=np.bool_), number, True)
        self._storyboard = Storyboard(scenario, scope, self._world)
        # Again, as catalog entries have been read meanwhile.
        prepared.check_elements_supported()
        for message, mask in scope.invalid_values():
            self._world.fail(mask, message)

    def _read_parameters(self, entity: str, driver: Driver) -> dict[str, FloatArray]:
        """Return the parameters of an entity's driver by name; a scenario fails if the driver refuses its value."""
        names, values = self._parameters.get(entity, ({}, []))
        parameters, problems = read_parameters(entity, driver, values)
        shared = {name for name in parameters if must_be_same_in_batch(driver, find_parameter(entity, driver, name)[0])}
        if differing := {names[name] for name in shared if (parameters[name] != parameters[name][0]).any()}:
            raise BatchSplitError(differing)
        for n, problem in problems.items():
            self._world.fail(np.arange(self._world.scenarios) == n, problem)
        return parameters

    @property
    def _driver_controls(self) -> list[DriverControl]:
        return [driver for driver in self._world.drivers if isinstance(driver, DriverControl)]

    @property
    def has_python_drivers(self) -> bool:
        """Whether the batch has drivers that are not compiled, such as a user's own."""
        return not all(driving.in_fleet for driving in self._driver_controls)

    @property
    def remarks(self) -> list[str]:
        """Sentences, after the run, about limits that drivers exceeded, and about deviations from the scenario file."""
        if self.failure is not None and self._world.scenarios > 1:
            return []
        # Actions name their line, and their file only if it is not the scenario file.
        remarks = [remark.replace("(line ", f"({self._file_name}, line ", 1) for remark in self._world.notices]
        return [*remarks, *(text for remark in self._driver_controls for text in remark.limit_notices.values())]

    def run(self, n_threads: int = 1, gil_lock: Lock | None = None) -> None:
        """Run until every scenario has ended or a driver fails; compiled code runs without the `gil_lock`."""
        # Failed scenarios are still computed, but their results are not used.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            try:
                for driving in self._driver_controls:
                    driving.reset_driver()
                self._stepper.run(n_threads, gil_lock)
            except DriverError as failure:
                self.failure = failure
                if self._world.scenarios == 1:
                    self._world.errors[0] = failure.error
            finally:
                for driving in self._driver_controls:
                    driving.free_driver_resources()

    def cancel(self) -> None:
        """Make `run` in another thread end soon; its results cannot be used."""
        self._stepper.is_cancelled = True

    def results(self, scenarios: Sequence[int], gil_lock: Lock | None = None) -> list[Recording | SimulationError]:
        """Return the recordings or errors of some scenarios after the run; they share no memory with the batch."""
        world, scene = self._world, self._stepper.scene
        motion, placed = copy_motion(scene, np.array(scenarios, dtype=np.int64), gil_lock)
        names, object_types = tuple(world.names), tuple(entity.kind for entity in world.entities)
        boxes = np.ascontiguousarray(scene.dimensions[:, [LENGTH, WIDTH, CENTER_X]].T)
        time = np.arange(scene.n_frames.max(initial=0)) * self._time_step
        results: list[Recording | SimulationError] = []
        for i, motion_of_scenario, was_placed in zip(scenarios, motion, placed.tolist(), strict=True):
            if i in world.errors:
                results.append(world.errors[i])
                continue
            if not was_placed:
                end_time = format_time_of_failure(time[motion_of_scenario.shape[2] - 1])
                message = f"{self._init_location}: no action places an entity on the map up to{end_time[3:]}"
                results.append(SimulationError(message))
                continue
            length, width, center_x = boxes.copy()
            results.append(
                Recording(
                    time=time[: motion_of_scenario.shape[2]].copy(),
                    names=names,
                    object_types=object_types,
                    # Indexing is twice as fast as iterating over the array.
                    x=motion_of_scenario[0],
                    y=motion_of_scenario[1],
                    heading=motion_of_scenario[2],
                    speed=motion_of_scenario[3],
                    acceleration=motion_of_scenario[4],
                    length=length,
                    width=width,
                    center_x=center_x,
                    collisions=self._collisions.get(i, ()),
                    is_truncated=bool(self._is_cut_off[i]),
                )
            )
        return results

    def recording_size(self, scenario: int) -> int:
        """Return the size of a scenario's recording in bytes, after the run."""
        return self._recording_sizes[scenario]

    @cached_property
    def _recording_sizes(self) -> list[int]:
        scene = self._stepper.scene
        return list(map(int, scene.n_frames * scene.pages[0, :, :, 0].nbytes))

    @cached_property
    def _is_cut_off(self) -> BoolArray:
        """Return which scenarios reached the maximum duration before the end of their storyboard, as a mask."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray(
                (self._stepper.scene.n_frames == self._stepper.max_frames) & self._storyboard.would_continue()
            )

    @cached_property
    def _collisions(self) -> dict[int, tuple[Collision, ...]]:
        collision_time, names = self._stepper.scene.collision_time, self._world.names
        scenarios, firsts, seconds = np.nonzero(~np.isnan(collision_time))
        # The clock sums up steps; times of a recording are multiples of one.
        times = np.rint(collision_time[scenarios, firsts, seconds] / self._time_step) * self._time_step
        columns = (scenarios, times, firsts, seconds)
        collisions: dict[int, list[Collision]] = {}
        for i, time, a, b in sorted(zip(*(column.tolist() for column in columns), strict=True)):
            collisions.setdefault(i, []).append(Collision(time, (names[a], names[b])))
        return {i: tuple(of_scenario) for i, of_scenario in collisions.items()}


def split_off_driver_parameters(
    scenario: ScenarioFile, values: Sequence[Mapping[str, Value]]
) -> tuple[dict[str, tuple[dict[str, str], list[dict[str, Value]]]], Sequence[Mapping[str, Value]]]:
    """Split parameter values into values of drivers, such as ``Ego.reaction``, and values of the file's parameters.

    The first part has two things for each entity: a dict from short to full names, such as ``{"reaction":
    "Ego.reaction"}``, and a list with the values of each scenario by short name. Raises `BatchSplitError` if only some
    scenarios have a driver parameter.
    """
    parameters = scenario.parse_driver_option_names({name for of_scenario in values for name in of_scenario})
    if partly_given := {name for name in parameters if not all(name in of_scenario for of_scenario in values)}:
        raise BatchSplitError(partly_given)
    by_entity: dict[str, dict[str, str]] = {}
    for full_name, (entity, name) in parameters.items():
        by_entity.setdefault(entity, {})[name] = full_name
    return {
        entity: (names, [{name: of_scenario[full] for name, full in names.items()} for of_scenario in values])
        for entity, names in by_entity.items()
    }, [
        {name: value for name, value in of_scenario.items() if name not in parameters} for of_scenario in values
    ] if parameters else values


def _to_parameter_array(value: Any, n_scenarios: int) -> Any:
    array = np.asarray(value)
    if array.dtype.kind == "b":
        array = np.where(array, "true", "false")
    elif array.dtype.kind != "U":
        array = array.astype(np.float64)
    return np.broadcast_to(array, (n_scenarios,)).copy()


def _read_entity_selections(root: etree._Element, world: World, scope: Scope) -> None:
    """Store the entities in each entity selection, which lists entities, types of entities or other selections."""
    waiting = {
        scope.read_text(selection, "name"): members
        for selection in root.iterfind("Entities/EntitySelection")
        if (members := selection.find("Members")) is not None
    }
    while waiting:
        unknown = waiting.keys() - {*world.names}
        ready = {
            name: members
            for name, members in waiting.items()
            if unknown.isdisjoint(scope.read_text(element, "entityRef") for element in members.iterfind("EntityRef"))
        }
        if not ready:
            name, members = next(iter(waiting.items()))
            raise scope.error_at(
                members,
                f"<EntitySelection>: '{name}' contains itself, or selections that contain themselves; name entities.",
            )
        for name, members in ready.items():
            rows = read_entity_refs(members, scope, world)
            for by_type in members.iterfind("ByType"):
                rows += [k for k in world.entities_of_type(scope.read_text(by_type, "objectType")) if k not in rows]
            world.selections[name] = rows
            del waiting[name]
