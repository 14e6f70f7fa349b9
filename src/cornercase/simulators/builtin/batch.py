"""Run one batch: concrete scenarios of one file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from threading import Lock
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.parts import format_instant
from cornercase._common.places import placed
from cornercase._common.typing import BoolArray
from cornercase.drivers import Driver
from cornercase.recordings import Collision, Recording
from cornercase.scenario import Scope, Value, later_version
from cornercase.simulators.builtin.actions.controller import DriverError, Driving, registered_driver
from cornercase.simulators.builtin.entities import read_entities
from cornercase.simulators.builtin.frames.recorded import motion_of
from cornercase.simulators.builtin.frames.scene import CENTER_X, LENGTH, WIDTH
from cornercase.simulators.builtin.openscenario import refuse_unusable
from cornercase.simulators.builtin.paths.positions import entities_in
from cornercase.simulators.builtin.prepared import PreparedScenario, UnusableError
from cornercase.simulators.builtin.stepping import Coupling, Stepper
from cornercase.simulators.builtin.storyboard.storyboard import Storyboard
from cornercase.simulators.builtin.world.signals import read_signal_controllers
from cornercase.simulators.builtin.world.state import World

_MOST_ENTITIES: Final = 500
_OBJECT_TYPES: Final = {"pedestrian": "pedestrian", "misc": "miscellaneous"}


class Batch:
    """Concrete scenarios that share a file and everything that shapes its storyboard.

    `drivers` maps entities to drivers, and overrides the file's controllers. `coupling` is another simulator that moves
    some of the entities. Raises `UnusableValuesError` if the file cannot be used with these values, `BatchSplitError`
    if the scenarios have to be split further.

    `failure` is the error of a driver that ended the batch early. It is the result of a single scenario; with several
    scenarios it is not known which of them failed, and no result is usable.
    """

    def __init__(
        self,
        prepared: PreparedScenario,
        values: Sequence[Mapping[str, Value]],
        time_step: float,
        duration: float,
        stop_at_collision: bool,
        drivers: Mapping[str, Driver | str],
        coupling: Coupling | None = None,
    ) -> None:
        scope, self._name = prepared.scope(values), prepared.scenario.path.name
        self._time_step = time_step
        self.failure: DriverError | None = None
        try:
            self._read(prepared, scope, drivers)
        except InputError as error:
            minor, message = later_version(prepared.scenario.root), str(error)
            if minor is not None and "not supported" in message:
                message = f"{message.removesuffix('.')}. OpenSCENARIO XML 1.{minor}, the file's version, may have it."
            raise UnusableError(message, scope.used) from None
        self._stepper = Stepper(self._world, self._storyboard, time_step, duration, stop_at_collision, coupling)

    def _read(self, prepared: PreparedScenario, scope: Scope, drivers: Mapping[str, Driver | str]) -> None:
        scenario = prepared.scenario
        refuse_unusable(prepared)
        storyboard = scenario.root.find("Storyboard")
        init_element = None if storyboard is None else storyboard.find("Init")
        reference = storyboard if init_element is None else init_element
        self._init = "" if reference is None else f"line {reference.sourceline}: <{reference.tag}>"
        logic_file = scenario.root.find("RoadNetwork/LogicFile")
        road_file = "" if logic_file is None else scope.text(logic_file, "filepath", "")
        with placed(logic_file, scope.source):
            network = prepared.network(road_file) if road_file else None
        objects = list(scenario.root.iterfind("Entities/ScenarioObject"))
        with placed(scenario.root.find("Entities"), scope.source):
            if not objects:
                raise InputError("has no entities, so there is nothing to simulate.")
            if len(objects) > _MOST_ENTITIES:
                raise InputError(f"has {len(objects)} entities; the builtin simulator supports {_MOST_ENTITIES}.")
        entities, tows = read_entities(objects, scope)
        self._world = World(entities, scope.scenarios, network, tows)
        self._world.signal_controllers = read_signal_controllers(scenario.root, scope)
        self._world.selections = _selections(scenario.root, self._world, scope)
        self._world.parameters = {name: _held(value, scope.scenarios) for name, value in scope.values.items()}
        self._world.variables = scope.declared(
            scenario.root, "VariableDeclarations/VariableDeclaration", "variableType"
        )
        lines = {declaration.name: declaration.sourceline for declaration in prepared.declarations}
        for name, is_violated in scope.violations(scenario.root).items():
            message = f"line {lines.get(name)}: the value of {name} breaks a constraint of its <ParameterDeclaration>"
            self._world.fail(is_violated, message)
        drivers_by_entity = {**scenario.drivers, **drivers}
        for e, name in enumerate(self._world.names):
            driver = drivers_by_entity.get(name)
            if driver is None:
                continue
            with placed(None if name in drivers else objects[e], scope.source):
                driver_object = registered_driver(driver, scope.source) if isinstance(driver, str) else driver
            number = Driving(self._world, e, driver_object).number
            self._world.kept[e] = name in drivers
            self._world.control(e, np.ones(scope.scenarios, dtype=np.bool_), number, True)
        self._storyboard = Storyboard(scenario, scope, self._world)
        # Again, as catalog entries have been read meanwhile.
        refuse_unusable(prepared)
        for message, mask in scope.refused():
            self._world.fail(mask, message)

    @property
    def _drivings(self) -> list[Driving]:
        return [driver for driver in self._world.drivers if isinstance(driver, Driving)]

    @property
    def in_python(self) -> bool:
        """Whether a driver is not compiled, as users' drivers are."""
        return not all(driving.in_fleet for driving in self._drivings)

    @property
    def remarks(self) -> list[str]:
        """Sentences about drivers that exceeded vehicle limits, and about deviations from the file, after the run."""
        if self.failure is not None and self._world.scenarios > 1:
            return []
        # Actions name their line, and their file only if it is not the scenario file.
        remarks = [remark.replace("(line ", f"({self._name}, line ", 1) for remark in self._world.remarks]
        return [*remarks, *(text for remark in self._drivings for text in remark.exceeded.values())]

    def run(self, threads: int = 1, turn: Lock | None = None) -> None:
        """Step until every scenario has ended, or a driver fails.

        `gil_lock` is held in Python and released in compiled code.
        """
        # Failed scenarios are still computed, but their results are not used.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            try:
                for driving in self._drivings:
                    driving.begin()
                self._stepper.run(threads, turn)
            except DriverError as failure:
                self.failure = failure
                if self._world.scenarios == 1:
                    self._world.errors[0] = failure.error

    def halt(self) -> None:
        """Let `run`, in another thread, end soon; its results are unusable then."""
        self._stepper.halted = True

    def results(self, chosen: Sequence[int], turn: Lock | None = None) -> list[Recording | SimulationError]:
        """Recordings or errors of some scenarios once the batch has run, each with memory of its own."""
        world, scene = self._world, self._stepper.scene
        motion, placed = motion_of(scene, np.array(chosen, dtype=np.int64), turn)
        names, object_types = tuple(world.names), tuple(entity.kind for entity in world.entities)
        boxes = np.ascontiguousarray(scene.boxes[:, [LENGTH, WIDTH, CENTER_X]].T)
        time = np.arange(scene.frames.max(initial=0)) * self._time_step
        results: list[Recording | SimulationError] = []
        for i, motion_of_scenario, was_placed in zip(chosen, motion, placed.tolist(), strict=True):
            if i in world.errors:
                results.append(world.errors[i])
                continue
            if not was_placed:
                end_time = format_instant(time[motion_of_scenario.shape[2] - 1])
                message = f"{self._init}: no action places an entity on the map up to{end_time[3:]}"
                results.append(SimulationError(message))
                continue
            length, width, center_x = boxes.copy()
            results.append(
                Recording(
                    time=time[: motion_of_scenario.shape[2]].copy(),
                    names=names,
                    kinds=object_types,
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
                    cut_off=bool(self._cut_off[i]),
                )
            )
        return results

    def bytes_of(self, i: int) -> int:
        """Bytes of a scenario's recording, once the batch has run."""
        return self._bytes[i]

    @cached_property
    def _bytes(self) -> list[int]:
        scene = self._stepper.scene
        sizes: list[int] = (scene.frames * scene.pages[0, :, :, 0].nbytes).tolist()
        return sizes

    @cached_property
    def _cut_off(self) -> BoolArray:
        """Scenarios ended by the maximum duration before their storyboard did, shape (N,)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray((self._stepper.scene.frames == self._stepper.most) & self._storyboard.unfinished())

    @cached_property
    def _collisions(self) -> dict[int, tuple[Collision, ...]]:
        collision_time, names = self._stepper.scene.collided, self._world.names
        scenarios, firsts, seconds = np.nonzero(~np.isnan(collision_time))
        # The clock sums up steps; times of a recording are multiples of one.
        times = np.rint(collision_time[scenarios, firsts, seconds] / self._time_step) * self._time_step
        columns = (scenarios, times, firsts, seconds)
        collisions: dict[int, list[Collision]] = {}
        for i, time, a, b in sorted(zip(*(column.tolist() for column in columns), strict=True)):
            collisions.setdefault(i, []).append(Collision(time, (names[a], names[b])))
        return {i: tuple(of_scenario) for i, of_scenario in collisions.items()}


def _held(value: Any, scenarios: int) -> Any:
    if isinstance(value, bool | np.bool_ | str):
        text = str(value).lower() if not isinstance(value, str) else value
        return np.full(scenarios, text)
    array = np.asarray(value)
    if array.dtype.kind == "b":
        return np.broadcast_to(np.where(array, "true", "false"), (scenarios,)).copy()
    return np.broadcast_to(array.astype(np.float64), (scenarios,)).copy()


def _selections(root: etree._Element, world: World, scope: Scope) -> dict[str, list[int]]:
    """Rows of the members of each entity selection: named entities, or all of a type."""
    selections: dict[str, list[int]] = {}
    for selection in root.iterfind("Entities/EntitySelection"):
        members = selection.find("Members")
        if members is None:
            continue
        rows = entities_in(members, scope, world)
        for by_type in members.iterfind("ByType"):
            object_type = scope.text(by_type, "objectType")
            of_type = [
                k for k, entity in enumerate(world.entities) if _OBJECT_TYPES.get(entity.kind, "vehicle") == object_type
            ]
            rows += [k for k in of_type if k not in rows]
        selections[scope.text(selection, "name")] = rows
    return selections
