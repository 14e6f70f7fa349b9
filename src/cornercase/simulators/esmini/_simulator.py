"""esmini as a simulator, through its library."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.geometry.boxes import box_corners, boxes_overlap
from cornercase.drivers import Driver
from cornercase.drivers._attached_driver import DriverError
from cornercase.drivers._resolve import DriverLike, check_drivers
from cornercase.recordings import Collision, Recording
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Availability, Simulator, check_seed, check_settings
from cornercase.simulators._driver_parameters import find_parameters_of_drivers
from cornercase.simulators.builtin.actions._controller import create_file_driver
from cornercase.simulators.esmini._driven_entity import DrivenEntity, start_drivers
from cornercase.simulators.esmini._driver_support import check_driver_support
from cornercase.simulators.esmini._library import (
    NOT_FOUND_MESSAGE,
    PARAMETER_CALLBACK,
    ObjectState,
    check_state_layout,
    encode_esmini_path,
    find_library_path,
    load_library,
    read_state,
    read_versions,
    set_parameter,
)

_VEHICLE_CATEGORIES: Final = (
    "car", "van", "truck", "semitrailer", "trailer", "bus", "motorbike", "bicycle", "train", "tram",
)  # fmt: skip
_VEHICLE_TYPE, _PEDESTRIAN_TYPE = 1, 2


class Esmini(Simulator):
    """Simulator that runs concrete scenarios with esmini, one at a time per process.

    Parameters
    ----------
    time_step : float, default 0.05
        Time step in s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether the first collision of two entities ends the run. esmini detects collisions.
    drivers : mapping of str to str, Driver or Behaviour, optional
        Driver of each entity, as for the builtin simulator. The driver decides the entity's speed, and also its
        pose if the driver steers; otherwise esmini keeps the entity on its lane or trajectory.
    seed : int, default 0
        Seed of esmini.
    controllers : bool, default True
        Whether esmini's controllers drive the entities that have one; otherwise these entities follow the storyboard
        or their driver.
    undriven : bool, default False
        Whether the drivers that the scenario file names for entities are left out.
    library : str, optional
        Path of esmini's library. Default: the path in the environment variable ``CORNERCASE_ESMINI``.

    Raises
    ------
    InputError
        An option is out of range. `run` raises it if the library is not found or cannot be used.

    Examples
    --------
    >>> import cornercase as cc
    >>> simulator = cc.simulators.Esmini(drivers={"Ego": "normal"})
    >>> study = cc.Study.create("study.db", problem, simulator)  # doctest: +SKIP
    """

    name = "esmini"
    deterministic = True
    takes_driver_parameters = True
    parameter_passing = "file"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, DriverLike] | None = None,
        seed: int = 0,
        controllers: bool = True,
        undriven: bool = False,
        library: str | None = None,
    ) -> None:
        self._common_settings = check_settings(time_step, duration, on_collision, drivers)
        self._drivers = check_drivers(drivers)
        self._time_step, self._duration, self._stop_on_collision = time_step, duration, on_collision == "stop"
        self._seed, self._library_path = check_seed(seed, "esmini"), library
        self._controllers, self._undriven = bool(controllers), bool(undriven)
        self._library: ctypes.CDLL | None = None
        self._layout_checked = False
        self._last_scenario: ScenarioFile | None = None

    @cached_property
    def settings(self) -> dict[str, object]:  # type: ignore[override]
        """Settings that recordings depend on; `InputError` if the library is not found."""
        path = find_library_path(self._library_path)
        return {
            **self._common_settings,
            "seed": self._seed,
            "controllers": self._controllers,
            "library": path.name,
            "library size": path.stat().st_size,
        }

    @classmethod
    def availability(cls) -> Availability:
        """Return whether esmini's library is found."""
        try:
            missing = "" if find_library_path(None) else NOT_FOUND_MESSAGE
        except InputError as error:
            missing = str(error)
        abilities = (
            "pedestrians", "drivers of your own", "its own controllers", "collisions go on or end the run",
            "deterministic",
        )  # fmt: skip
        return Availability("", missing, abilities)

    def component_versions(self) -> Mapping[str, str]:
        """Return the versions in esmini's library, empty if it does not contain them, and its checksum."""
        return read_versions(find_library_path(self._library_path))

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios; also raises `InputError` if the library has an unexpected memory layout."""
        if self._library is None:
            self._library = load_library(find_library_path(self._library_path))
        for concrete in concretes:
            scenario = self._last_scenario = concrete.load_file(self._last_scenario)
            self.check_supported(scenario)
            for entity in self._drivers:
                scenario.require_entity(entity, "driven entity")
            self._refuse_parameters_of_absent_drivers(scenario, concrete.values)
            try:
                yield self._run_scenario(self._library, scenario, concrete)
            finally:
                self._library.SE_Close()

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Refuse left-handed axes, a road file that esmini does not find, or an entity that its driver cannot drive."""
        if scenario.has_left_handed_axes:
            raise InputError(
                f"{scenario.path}: its description begins with 'CARLA:', so its axes are left-handed, which esmini does"
                " not support; `cornercase convert` writes the scenario with right-handed axes."
            )
        reference = scenario.road_reference_for()
        road = scenario.road_path(reference) if reference else None
        if road is not None and road not in (
            scenario.resolve_path(reference, "road file"),
            scenario.path.with_name(Path(reference).name),
        ):
            raise InputError(
                f"{scenario.path}: names the road '{reference}', which was found as {road}, but esmini does not search"
                " in that folder; name that file in <LogicFile>."
            )
        for entity, driver in self._drivers_of(scenario).items():
            if isinstance(driver, str):
                create_file_driver(driver, str(scenario.path))
            check_driver_support(scenario, entity)

    def check_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Refuse values for parameters of a driver that the option `undriven` leaves out."""
        for concrete in concretes:
            self._refuse_parameters_of_absent_drivers(concrete.load_file(), concrete.values)

    def _refuse_parameters_of_absent_drivers(self, scenario: ScenarioFile, values: Mapping[str, Value]) -> None:
        driving = self._drivers_of(scenario)
        for entity, _, names in find_parameters_of_drivers(scenario, driving, values):
            if entity not in driving:
                raise InputError(
                    f"{scenario.path}: {next(iter(names.values()))} is a parameter of the driver that the file names"
                    f" for {entity}, but esmini:undriven=true leaves out this driver; leave out the parameter or this"
                    " option."
                )

    def _drivers_of(self, scenario: ScenarioFile) -> dict[str, str | Driver]:
        return {**({} if self._undriven else scenario.drivers), **self._drivers}

    def _run_scenario(
        self, lib: ctypes.CDLL, scenario: ScenarioFile, concrete: ConcreteScenario
    ) -> Recording | SimulationError:
        values = concrete.values
        # esmini does not know the parameters of drivers.
        own = {name: value for name, value in values.items() if name not in scenario.parse_driver_option_names(values)}
        parameter_types = {
            e.get("name", ""): e.get("parameterType", "")
            for e in scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
        }
        rejected: list[str] = []

        def set_parameters(_: object) -> None:
            for name, value in own.items():
                # A text where a number belongs; an exception in a callback would be printed and forgotten.
                try:
                    is_taken = set_parameter(lib, name, value, parameter_types.get(name, "")) == 0
                except ValueError:
                    is_taken = False
                if not is_taken:
                    rejected.append(name)

        # Keep a reference until the run is over: esmini only stores the address.
        callback = PARAMETER_CALLBACK(set_parameters)
        lib.SE_RegisterParameterDeclarationCallback(callback, None)
        lib.SE_SetSeed(self._seed)
        lib.SE_CollisionDetection(True)
        if lib.SE_Init(encode_esmini_path(scenario.path), 0 if self._controllers else 1, 0, 0, 0) != 0:
            return SimulationError("esmini cannot load the scenario; run it with esmini to see why")
        if rejected:
            return SimulationError(f"esmini does not take the parameter {rejected[0]}")
        if not self._layout_checked and lib.SE_GetNumberOfObjects() > 0:
            check_state_layout(lib, lib.SE_GetId(0))
            self._layout_checked = True
        log = _StateLog(lib)
        collides = log.record_and_detect_collision(0.0)
        try:
            driven = start_drivers(
                lib, self._drivers_of(scenario), scenario, values, concrete.seed, log.states, self._time_step
            )
        except DriverError as failure:
            return failure.error
        try:
            return self._run_steps(lib, scenario, log, collides, driven)
        finally:
            for entity in driven:
                entity.release()
                self.notify(entity.limit_notices.values())

    def _run_steps(
        self, lib: ctypes.CDLL, scenario: ScenarioFile, log: _StateLog, collides: bool, driven: Sequence[DrivenEntity]
    ) -> Recording | SimulationError:
        """Simulate a scenario to its end, and return the recording; the first state must have been recorded already."""
        steps = round(self._duration / self._time_step)
        cut_off = False
        for step in range(steps + 1):
            time = step * self._time_step
            if step:
                collides = log.record_and_detect_collision(time, {entity.name for entity in driven if entity.was_moved})
            if step == steps or (collides and self._stop_on_collision):
                cut_off = step == steps and scenario.root.find("Storyboard/StopTrigger//Condition") is not None
                break
            speeds = dict[str, float]()
            for entity in driven:
                if (failure := entity.decide(log.states, speeds, time)) is not None:
                    return failure
            lib.SE_StepDT(self._time_step)
            # The step in which the storyboard stops is not recorded.
            if lib.SE_GetQuitFlag() != 0:
                break
            for entity in driven:
                entity.raise_step_error()
        return log.make_recording(self._time_step, cut_off)


class _StateLog:
    """Log of the states of all entities at each time step; `states` has the latest states, by name."""

    def __init__(self, lib: ctypes.CDLL) -> None:
        self._lib = lib
        self.states: dict[str, ObjectState] = {}
        self._rows: list[dict[str, tuple[float, float, float, float]]] = []
        self._boxes: dict[str, tuple[str, float, float, float]] = {}
        self._colliding_pairs: set[tuple[str, str]] = set()
        self._collisions: dict[tuple[str, str], float] = {}

    def record_and_detect_collision(self, time: float, moved: Set[str] = frozenset()) -> bool:
        """Record the current state of all entities at a time in s; return whether a collision has begun.

        `moved`: entities that were moved after esmini looked for collisions.
        """
        lib, row, names = self._lib, {}, {}
        ids = [lib.SE_GetId(k) for k in range(lib.SE_GetNumberOfObjects())]
        self.states = {}
        for object_id in ids:
            state = read_state(lib, object_id)
            name = names[object_id] = (lib.SE_GetObjectName(object_id) or b"").decode("utf-8", "replace")
            self.states[name] = state
            row[name] = (state.x, state.y, state.h, state.speed)
            self._boxes.setdefault(name, (_object_type(state), state.length, state.width, state.center_x))
        self._rows.append(row)
        touching = set()
        for object_id in ids:
            for k in range(max(lib.SE_GetObjectNumberOfCollisions(object_id), 0)):
                if (other := lib.SE_GetObjectCollision(object_id, k)) in names:
                    first, second = sorted((names[object_id], names[other]), key=list(self._boxes).index)
                    touching.add((first, second))
        if moved:
            touching = {pair for pair in touching if not moved & {*pair}} | self._find_overlaps(moved)
        new_pairs = touching - self._colliding_pairs
        self._colliding_pairs = touching
        for pair in sorted(new_pairs):
            self._collisions.setdefault(pair, time)
        return bool(new_pairs)

    def _find_overlaps(self, moved: Set[str]) -> set[tuple[str, str]]:
        """Return the pairs of entities whose boxes overlap now, with at least one entity in `moved`."""
        corners = {}
        for name, state in self.states.items():
            x = state.x + state.center_x * math.cos(state.h) - state.center_y * math.sin(state.h)
            y = state.y + state.center_x * math.sin(state.h) + state.center_y * math.cos(state.h)
            corners[name] = box_corners(x, y, state.h, state.length, state.width)
        pairs = combinations([name for name in self._boxes if name in corners], 2)
        return {(a, b) for a, b in pairs if moved & {a, b} and boxes_overlap(corners[a], corners[b])}

    def make_recording(self, time_step: float, cut_off: bool) -> Recording | SimulationError:
        """Create a recording from the recorded states; return an error if no entity was ever present."""
        if not self._boxes:
            return SimulationError("no entity is ever placed on the map")
        missing = (np.nan,) * 4
        motion = np.array([[row.get(name, missing) for row in self._rows] for name in self._boxes])
        x, y, heading, speed = np.moveaxis(motion, -1, 0)
        acceleration = np.zeros_like(speed)
        acceleration[:, 1:] = np.diff(speed, axis=1) / time_step
        is_present = np.isfinite(x)
        # No acceleration at an entity's first instant.
        acceleration = np.where(is_present, np.nan_to_num(acceleration), np.nan)
        object_types, lengths, widths, centers = zip(*self._boxes.values(), strict=True)
        collisions = sorted(self._collisions.items(), key=lambda item: item[1])
        return Recording(
            time=np.arange(len(self._rows)) * time_step,
            names=tuple(self._boxes),
            object_types=object_types,
            x=x,
            y=y,
            heading=heading,
            speed=speed,
            acceleration=acceleration,
            length=np.array(lengths),
            width=np.array(widths),
            center_x=np.array(centers),
            collisions=tuple(Collision(time, pair) for pair, time in collisions),
            is_truncated=cut_off,
        )


def _object_type(state: ObjectState) -> str:
    if state.kind == _PEDESTRIAN_TYPE:
        return "pedestrian"
    if state.kind != _VEHICLE_TYPE:
        return "misc"
    return _VEHICLE_CATEGORIES[state.category] if 0 <= state.category < len(_VEHICLE_CATEGORIES) else "car"
