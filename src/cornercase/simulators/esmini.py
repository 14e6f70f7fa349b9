"""esmini, by its library."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.platform import bytes_of_path
from cornercase.drivers import Driver
from cornercase.recordings import Collision, Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value
from cornercase.simulators.base import Availability, Simulator, checked_seed, checked_settings

VARIABLE: Final = "CORNERCASE_ESMINI"
_MISSING: Final = (
    f"esmini's library is not known; download esmini from github.com/esmini/esmini and set {VARIABLE} to its"
    " libesminiLib.so, esminiLib.dll or libesminiLib.dylib."
)
_CATEGORIES: Final = (
    "car", "van", "truck", "semitrailer", "trailer", "bus", "motorbike", "bicycle", "train", "tram",
)  # fmt: skip
_VEHICLE, _PEDESTRIAN = 1, 2
_FILL: Final = 0xAA


class _State(ctypes.Structure):
    """State of an object, as of esmini 3.6."""

    _fields_ = (
        ("id", ctypes.c_int), ("model_id", ctypes.c_int), ("ctrl_type", ctypes.c_int), ("timestamp", ctypes.c_double),
        ("x", ctypes.c_double), ("y", ctypes.c_double), ("z", ctypes.c_double), ("h", ctypes.c_double),
        ("p", ctypes.c_double), ("r", ctypes.c_double), ("road", ctypes.c_uint32), ("junction", ctypes.c_uint32),
        ("t", ctypes.c_double), ("lane", ctypes.c_int), ("lane_offset", ctypes.c_double), ("s", ctypes.c_double),
        ("speed", ctypes.c_double), ("center_x", ctypes.c_double), ("center_y", ctypes.c_double),
        ("center_z", ctypes.c_double), ("width", ctypes.c_double), ("length", ctypes.c_double),
        ("height", ctypes.c_double), ("kind", ctypes.c_int), ("category", ctypes.c_int),
        ("wheel_angle", ctypes.c_double), ("wheel_rotation", ctypes.c_double), ("visible", ctypes.c_int),
    )  # fmt: skip


class EsminiSimulator(Simulator):
    """Runs concrete scenarios with esmini, whose state there is once in a process.

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
        Whether esmini's controllers drive who has one; else all follow the storyboard alone.
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
            raise InputError("`drivers`: esmini has no drivers of cornercase; its own stand in the scenario file.")
        self._path = _library(library)
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
            missing = "" if _library(None) else _MISSING
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
            self._loaded = _load(self._path)
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
            It names a driver of cornercase.
        """
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
                if _set(lib, name, value, kinds.get(name, "")) != 0:
                    refused.append(name)

        # Has to live until the run is over, as esmini keeps only its address.
        callback = _CALLBACK(declare)
        lib.SE_RegisterParameterDeclarationCallback(callback, None)
        lib.SE_SetSeed(self._seed)
        lib.SE_CollisionDetection(True)
        if lib.SE_Init(_encoded(scenario.path), 0 if self._controllers else 1, 0, 0, 0) != 0:
            return SimulationError("esmini cannot load the scenario; run it with esmini to see why")
        if refused:
            return SimulationError(f"esmini does not take the parameter {refused[0]}")
        if not self._fits and lib.SE_GetNumberOfObjects() > 0:
            _require_layout(lib, lib.SE_GetId(0))
            self._fits = True
        log = _Log(lib)
        steps = round(self._duration / self._time_step)
        for step in range(steps + 1):
            begun = log.note(step * self._time_step)
            if step == steps or (begun and self._stops):
                break
            lib.SE_StepDT(self._time_step)
            # The step in which the storyboard stops gives no row.
            if lib.SE_GetQuitFlag() != 0:
                break
        return log.recording(self._time_step)


def _encoded(path: Path) -> bytes:
    try:
        return bytes_of_path(path)
    except UnicodeEncodeError:
        raise InputError(f"{path}: esmini cannot open a path with such characters here; move the scenario.") from None


class _Log:
    """What esmini tells of each instant."""

    def __init__(self, lib: ctypes.CDLL) -> None:
        self._lib = lib
        self._rows: list[dict[str, tuple[float, float, float, float]]] = []
        self._about: dict[str, tuple[str, float, float, float]] = {}
        self._touching: set[tuple[str, str]] = set()
        self._collisions: dict[tuple[str, str], float] = {}

    def note(self, time: float) -> bool:
        """Note the present instant; whether two begin to collide."""
        lib, row, names = self._lib, {}, {}
        ids = [lib.SE_GetId(k) for k in range(lib.SE_GetNumberOfObjects())]
        for one in ids:
            state = _state(lib, one)
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

    def recording(self, time_step: float) -> Recording | SimulationError:
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
        )


_CALLBACK: Final = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


def _library(given: str | None) -> Path:
    text = given or os.environ.get(VARIABLE, "")
    if not text:
        raise InputError(_MISSING)
    path = Path(text)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; {VARIABLE} has to be the path of esmini's library.")
    return path.resolve()


def _load(path: Path) -> ctypes.CDLL:
    try:
        lib = ctypes.CDLL(str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be loaded ({error}).") from error
    text, number = ctypes.c_char_p, ctypes.c_int
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "SE_Init": (number, [text, number, number, number, number]),
        "SE_StepDT": (number, [ctypes.c_double]),
        "SE_Close": (None, []),
        "SE_GetQuitFlag": (number, []),
        "SE_GetNumberOfObjects": (number, []),
        "SE_GetId": (number, [number]),
        "SE_GetObjectName": (text, [number]),
        "SE_GetObjectState": (number, [number, ctypes.c_void_p]),
        "SE_GetObjectNumberOfCollisions": (number, [number]),
        "SE_GetObjectCollision": (number, [number, number]),
        "SE_SetSeed": (None, [ctypes.c_uint]),
        "SE_CollisionDetection": (None, [ctypes.c_bool]),
        "SE_SetOptionPersistent": (number, [text]),
        "SE_RegisterParameterDeclarationCallback": (None, [_CALLBACK, ctypes.c_void_p]),
        "SE_SetParameterString": (number, [text, text]),
        "SE_SetParameterDouble": (number, [text, ctypes.c_double]),
        "SE_SetParameterInt": (number, [text, number]),
        "SE_SetParameterBool": (number, [text, ctypes.c_bool]),
    }
    for name, (result, arguments) in signatures.items():
        try:
            function = getattr(lib, name)
        except AttributeError:
            raise InputError(f"{path}: has no function {name}; take esmini 3.6 or a version close to it.") from None
        function.restype, function.argtypes = result, arguments
    lib.SE_SetOptionPersistent(b"disable_stdout")
    lib.SE_SetOptionPersistent(b"disable_log")
    return lib


def _state(lib: ctypes.CDLL, one: int) -> _State:
    state = _State()
    if lib.SE_GetObjectState(one, ctypes.addressof(state)) != 0:
        raise InputError("esmini does not tell the state of one of its objects; take another version of it.")
    return state


def _require_layout(lib: ctypes.CDLL, one: int) -> None:
    """Refuse a library that writes more or less of a state than is expected."""
    size = ctypes.sizeof(_State)
    buffer = (ctypes.c_ubyte * (2 * size)).from_buffer_copy(bytes([_FILL]) * (2 * size))
    if lib.SE_GetObjectState(one, ctypes.addressof(buffer)) != 0:
        raise InputError("esmini does not tell the state of one of its objects; take another version of it.")
    written = bytes(buffer)
    # The last field is an int, which is followed by padding up to the next multiple of 8.
    if written[size - 8 : size - 4] == bytes([_FILL]) * 4 or written[size:] != bytes([_FILL]) * size:
        raise InputError(
            "esmini's library has another layout than that of esmini 3.6, which this cornercase knows; take that one."
        )
    if _State.from_buffer_copy(written[:size]).id != one:
        raise InputError("esmini's library has another layout than that of esmini 3.6; take that one.")


def _kind(state: _State) -> str:
    if state.kind == _PEDESTRIAN:
        return "pedestrian"
    if state.kind != _VEHICLE:
        return "misc"
    return _CATEGORIES[state.category] if 0 <= state.category < len(_CATEGORIES) else "car"


def _set(lib: ctypes.CDLL, name: str, value: Value, kind: str) -> int:
    key = name.encode()
    if kind == "double":
        return int(lib.SE_SetParameterDouble(key, float(value)))
    if kind in ("integer", "int", "unsignedInt", "unsignedShort"):
        return int(lib.SE_SetParameterInt(key, round(float(value))))
    if kind == "boolean":
        return int(lib.SE_SetParameterBool(key, str(value).lower() in ("true", "1")))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return int(lib.SE_SetParameterString(key, text.encode()))
