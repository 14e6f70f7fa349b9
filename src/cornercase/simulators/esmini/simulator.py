"""esmini, by its library."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from cornercase._common.errors import InputError, SimulationError
from cornercase.drivers import Driver
from cornercase.recordings import Collision, Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value
from cornercase.simulators.base import Availability, Simulator, checked_seed, checked_settings
from cornercase.simulators.esmini.library import (
    CALLBACK,
    MISSING,
    State,
    encoded_path,
    library_path,
    load_library,
    require_layout,
    set_parameter,
    state_of,
)

_CATEGORIES: Final = (
    "car", "van", "truck", "semitrailer", "trailer", "bus", "motorbike", "bicycle", "train", "tram",
)  # fmt: skip
_VEHICLE, _PEDESTRIAN = 1, 2


class EsminiSimulator(Simulator):
    """Runs concrete scenarios with esmini, of which a process can hold only one.

    Parameters
    ----------
    time_step : float, default 0.05
        s.
    duration : float, default 60
        s after which a scenario ends at the latest.
    on_collision : {"continue", "stop"}, default "continue"
        Collisions are those that esmini finds.
    drivers : mapping, optional
        None: esmini has controllers of its own, which the scenario file names.
    seed : int, default 0
    controllers : bool, default True
        Whether esmini's controllers drive the entities that have one; else all follow the storyboard alone.
    undriven : bool, default False
        Whether a scenario may run here that asks for a driver of cornercase, which esmini does not have.
    library : str, optional
        Path of esmini's library; by default that of the environment variable ``CORNERCASE_ESMINI``.

    Raises
    ------
    InputError
        The library is not known or cannot be used, or an option is out of range.
    """

    name = "esmini"
    repeats_itself = True
    values_by = "file"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, str | Driver] | None = None,
        seed: int = 0,
        controllers: bool = True,
        undriven: bool = False,
        library: str | None = None,
    ) -> None:
        if drivers:
            raise InputError("`drivers`: esmini has none of cornercase's drivers; its own stand in the scenario file.")
        self._path = library_path(library)
        self._time_step, self._duration, self._stops = time_step, duration, on_collision == "stop"
        self._seed, self._controllers, self._undriven = seed, bool(controllers), bool(undriven)
        self._loaded: ctypes.CDLL | None = None
        self._fits = False
        self._read: Scenario | None = None
        self.settings: dict[str, object] = {
            **checked_settings(time_step, duration, on_collision, None),
            "seed": checked_seed(seed, "esmini"),
            "controllers": self._controllers,
            "library": self._path.name,
            "library size": self._path.stat().st_size,
        }

    @classmethod
    def availability(cls) -> Availability:
        """Say whether it can run here."""
        try:
            missing = "" if library_path(None) else MISSING
        except InputError as error:
            missing = str(error)
        abilities = ("pedestrians", "its own controllers", "collisions go on or end the run", "deterministic")
        return Availability("", missing, abilities)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario

        Yields
        ------
        Recording or SimulationError
            One for each scenario, in order.

        Raises
        ------
        InputError
            The scenario file cannot be used, or the library has another layout.
        """
        if self._loaded is None:
            self._loaded = load_library(self._path)
        for concrete in concretes:
            scenario = self._read = concrete.scenario(self._read)
            self.require_means(scenario)
            try:
                yield self._run(self._loaded, scenario, concrete.values)
            finally:
                self._loaded.SE_Close()

    def require_means(self, scenario: Scenario) -> None:
        """Refuse a scenario that asks for what esmini does not have.

        Parameters
        ----------
        scenario : Scenario

        Raises
        ------
        InputError
            It names a driver of cornercase, its axes are left-handed, or its road was found by its name alone.
        """
        if scenario.is_left_handed:
            raise InputError(
                f"{scenario.path}: its description begins with 'CARLA:', so that its axes are left-handed, which esmini"
                " does not know; `cornercase convert` writes the scenario in other axes."
            )
        reference = scenario.road_reference()
        road = scenario.road_at(reference) if reference else None
        if road not in (None, scenario.beside(reference, "road file"), scenario.path.with_name(Path(reference).name)):
            raise InputError(
                f"{scenario.path}: names the road '{reference}', which was found as {road}, but esmini does not look"
                " there; name that file in <LogicFile>."
            )
        if self._undriven or not scenario.drivers:
            return
        name, driver = next(iter(scenario.drivers.items()))
        raise InputError(
            f"{scenario.path}: '{name}' asks for the driver '{driver}', which esmini does not have; `simulator`"
            " esmini:undriven=true runs it by the storyboard alone."
        )

    def _run(self, lib: ctypes.CDLL, scenario: Scenario, values: Mapping[str, Value]) -> Recording | SimulationError:
        kinds = {
            e.get("name", ""): e.get("parameterType", "")
            for e in scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
        }
        refused: list[str] = []

        def declare(_: object) -> None:
            for name, value in values.items():
                if set_parameter(lib, name, value, kinds.get(name, "")) != 0:
                    refused.append(name)

        # Has to live until the run is over, as esmini keeps only its address.
        callback = CALLBACK(declare)
        lib.SE_RegisterParameterDeclarationCallback(callback, None)
        lib.SE_SetSeed(self._seed)
        lib.SE_CollisionDetection(True)
        if lib.SE_Init(encoded_path(scenario.path), 0 if self._controllers else 1, 0, 0, 0) != 0:
            return SimulationError("esmini cannot load the scenario; run it with esmini to see why")
        if refused:
            return SimulationError(f"esmini does not take the parameter {refused[0]}")
        if not self._fits and lib.SE_GetNumberOfObjects() > 0:
            require_layout(lib, lib.SE_GetId(0))
            self._fits = True
        log = _Log(lib)
        steps = round(self._duration / self._time_step)
        cut_off = False
        for step in range(steps + 1):
            begun = log.note(step * self._time_step)
            if step == steps or (begun and self._stops):
                cut_off = step == steps and scenario.root.find("Storyboard/StopTrigger//Condition") is not None
                break
            lib.SE_StepDT(self._time_step)
            # The step in which the storyboard stops gives no row.
            if lib.SE_GetQuitFlag() != 0:
                break
        return log.recording(self._time_step, cut_off)


class _Log:
    """What esmini tells of each instant."""

    def __init__(self, lib: ctypes.CDLL) -> None:
        self._lib = lib
        self._rows: list[dict[str, tuple[float, float, float, float]]] = []
        self._about: dict[str, tuple[str, float, float, float]] = {}
        self._touching: set[tuple[str, str]] = set()
        self._collisions: dict[tuple[str, str], float] = {}

    def note(self, time: float) -> bool:
        """Note the present instant; return whether two entities begin to collide."""
        lib, row, names = self._lib, {}, {}
        ids = [lib.SE_GetId(k) for k in range(lib.SE_GetNumberOfObjects())]
        for one in ids:
            state = state_of(lib, one)
            name = names[one] = (lib.SE_GetObjectName(one) or b"").decode("utf-8", "replace")
            row[name] = (state.x, state.y, state.h, state.speed)
            self._about.setdefault(name, (_kind(state), state.length, state.width, state.center_x))
        self._rows.append(row)
        touching = set()
        for one in ids:
            for k in range(max(lib.SE_GetObjectNumberOfCollisions(one), 0)):
                if (other := lib.SE_GetObjectCollision(one, k)) in names:
                    first, second = sorted((names[one], names[other]), key=list(self._about).index)
                    touching.add((first, second))
        begun = touching - self._touching
        self._touching = touching
        for pair in sorted(begun):
            self._collisions.setdefault(pair, time)
        return bool(begun)

    def recording(self, time_step: float, cut_off: bool) -> Recording | SimulationError:
        """All instants as a recording."""
        if not self._about:
            return SimulationError("no entity is ever placed on the map")
        missing = (np.nan,) * 4
        motion = np.array([[row.get(name, missing) for row in self._rows] for name in self._about])
        x, y, heading, speed = np.moveaxis(motion, -1, 0)
        acceleration = np.zeros_like(speed)
        acceleration[:, 1:] = np.diff(speed, axis=1) / time_step
        there = np.isfinite(x)
        # At its first instant an entity has no speed before.
        acceleration = np.where(there, np.nan_to_num(acceleration), np.nan)
        kinds, lengths, widths, centers = zip(*self._about.values(), strict=True)
        touched = sorted(self._collisions.items(), key=lambda one: one[1])
        return Recording(
            time=np.arange(len(self._rows)) * time_step,
            names=tuple(self._about),
            kinds=kinds,
            x=x,
            y=y,
            heading=heading,
            speed=speed,
            acceleration=acceleration,
            length=np.array(lengths),
            width=np.array(widths),
            center_x=np.array(centers),
            collisions=tuple(Collision(time, pair) for pair, time in touched),
            cut_off=cut_off,
        )


def _kind(state: State) -> str:
    if state.kind == _PEDESTRIAN:
        return "pedestrian"
    if state.kind != _VEHICLE:
        return "misc"
    return _CATEGORIES[state.category] if 0 <= state.category < len(_CATEGORIES) else "car"
