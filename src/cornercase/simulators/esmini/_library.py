"""ctypes binding of esmini's library."""

from __future__ import annotations

import ctypes
import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.platform import encode_path
from cornercase.scenario import Value

LIBRARY_VARIABLE: Final = "CORNERCASE_ESMINI"
NOT_FOUND_MESSAGE: Final = (
    f"esmini's library is not found; download esmini from github.com/esmini/esmini and set {LIBRARY_VARIABLE} to its"
    " libesminiLib.so, esminiLib.dll or libesminiLib.dylib."
)
_FILL_BYTE: Final = 0xAA
# Variables of the library in which its build stores where its source comes from.
_VERSION_VARIABLES: Final = {
    "esmini": "ESMINI_GIT_TAG",
    "esmini's revision": "ESMINI_GIT_REV",
    "esmini's build": "ESMINI_BUILD_VERSION",
}
_UNKNOWN_VERSION: Final = "N/A"


class ObjectState(ctypes.Structure):
    """State of an object, in the memory layout of esmini 3.6."""

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


class RoutePoint(ctypes.Structure):
    """A waypoint of a route, in the memory layout of esmini 3.6."""

    _fields_ = (
        ("x", ctypes.c_double), ("y", ctypes.c_double), ("z", ctypes.c_double), ("h", ctypes.c_double),
        ("road", ctypes.c_uint32), ("junction", ctypes.c_uint32), ("lane", ctypes.c_int), ("osi_lane", ctypes.c_int),
        ("lane_offset", ctypes.c_double), ("s", ctypes.c_double), ("t", ctypes.c_double),
    )  # fmt: skip


PARAMETER_CALLBACK: Final = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
_OBJECT_CALLBACK: Final = ctypes.CFUNCTYPE(None, ctypes.POINTER(ObjectState), ctypes.c_void_p)
# What to call when an object has been moved, by its id.
_RECEIVERS: Final = dict[int, Callable[[ObjectState], None]]()
# Loaded libraries and ids of objects for which esmini has `_RECEIVER_CALLBACK`, which it never forgets.
_REGISTERED: Final = set[tuple[int, int]]()


def _call_receiver(state: ctypes._Pointer[ObjectState], _: object) -> None:
    _RECEIVERS[state.contents.id](state.contents)


_RECEIVER_CALLBACK: Final = _OBJECT_CALLBACK(_call_receiver)


def register_move_callback(lib: ctypes.CDLL, object_id: int, receiver: Callable[[ObjectState], None]) -> None:
    """Let esmini call `receiver` in each step of this run, after esmini has moved an object.

    The receiver gets the state of the object. It must not raise an exception.
    """
    _RECEIVERS[object_id] = receiver
    # esmini wants a function in each run, and calls all functions of earlier runs, too: let the later ones do nothing.
    key = lib._handle, object_id
    nothing = ctypes.cast(lib.SE_GetQuitFlag, _OBJECT_CALLBACK)
    lib.SE_RegisterObjectCallback(object_id, nothing if key in _REGISTERED else _RECEIVER_CALLBACK, None)
    _REGISTERED.add(key)


def find_library_path(library: str | None) -> Path:
    """Return the path of esmini's library: `library`, or else the environment variable ``CORNERCASE_ESMINI``."""
    text = library or os.environ.get(LIBRARY_VARIABLE, "")
    if not text:
        raise InputError(NOT_FOUND_MESSAGE)
    path = Path(text)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; set {LIBRARY_VARIABLE} to the path of esmini's library.")
    return path.resolve()


def load_library(path: Path) -> ctypes.CDLL:
    """Load esmini's library and declare its functions; `InputError` if that fails, or if a function is missing."""
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
        "SE_RegisterParameterDeclarationCallback": (None, [PARAMETER_CALLBACK, ctypes.c_void_p]),
        "SE_SetParameterString": (number, [text, text]),
        "SE_SetParameterDouble": (number, [text, ctypes.c_double]),
        "SE_SetParameterInt": (number, [text, number]),
        "SE_SetParameterBool": (number, [text, ctypes.c_bool]),
        "SE_RegisterObjectCallback": (None, [number, _OBJECT_CALLBACK, ctypes.c_void_p]),
        "SE_ReportObjectSpeed": (number, [number, ctypes.c_double]),
        "SE_ReportObjectPosXYH": (number, [number, ctypes.c_double, ctypes.c_double, ctypes.c_double]),
        "SE_ReportObjectRoadPos": (number, [number, ctypes.c_uint32, number, ctypes.c_double, ctypes.c_double]),
        "SE_GetRoadIdString": (text, [ctypes.c_uint32]),
        "SE_GetRoadIdFromString": (ctypes.c_uint32, [text]),
        "SE_GetNumberOfRoutePoints": (number, [number]),
        "SE_GetRoutePoint": (number, [number, ctypes.c_uint, ctypes.POINTER(RoutePoint)]),
    }
    for name, (result, arguments) in signatures.items():
        try:
            function = getattr(lib, name)
        except AttributeError:
            raise InputError(f"{path}: has no function {name}; use esmini 3.6 or a version close to it.") from None
        function.restype, function.argtypes = result, arguments
    lib.SE_SetOptionPersistent(b"disable_stdout")
    lib.SE_SetOptionPersistent(b"disable_log")
    return lib


def read_versions(path: Path) -> Mapping[str, str]:
    """Return version, revision and build of esmini's library (empty if unknown), and its checksum.

    esmini's interface has no function for the versions, so they are read from variables of the library. A library that
    was built outside of a Git repository does not contain them, and on Windows a library does not export them.
    """
    versions = dict.fromkeys(_VERSION_VARIABLES, "")
    try:
        lib = ctypes.CDLL(str(path))
    except OSError:
        return versions
    for name, variable in _VERSION_VARIABLES.items():
        try:
            text = ctypes.c_char_p.in_dll(lib, variable).value or b""
        except ValueError:
            continue
        version = text.decode("utf-8", "replace")
        versions[name] = "" if version.startswith(_UNKNOWN_VERSION) else version
    return {**versions, "esmini's library": f"SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"}


def read_state(lib: ctypes.CDLL, object_id: int) -> ObjectState:
    """Read the state of an object by its id; `InputError` if esmini does not report it."""
    state = ObjectState()
    if lib.SE_GetObjectState(object_id, ctypes.addressof(state)) != 0:
        raise InputError("esmini does not report the state of one of its objects; use another version of esmini.")
    return state


def read_road_name(lib: ctypes.CDLL, road: int) -> str:
    """Return the id that a road has in the road file; `road` is its number in esmini."""
    return (lib.SE_GetRoadIdString(road) or b"").decode("utf-8", "replace")


def read_route(lib: ctypes.CDLL, object_id: int) -> tuple[tuple[str, int, float], ...]:
    """Return the waypoints of an object's route, as road id, lane and road coordinate s (m); empty without a route."""
    points, point = list[tuple[str, int, float]](), RoutePoint()
    for k in range(max(lib.SE_GetNumberOfRoutePoints(object_id), 0)):
        if lib.SE_GetRoutePoint(object_id, k, ctypes.byref(point)) == 0:
            points.append((read_road_name(lib, point.road), point.lane, point.s))
    return tuple(points)


def check_state_layout(lib: ctypes.CDLL, object_id: int) -> None:
    """Raise `InputError` if the library does not store object states in the memory layout of esmini 3.6."""
    size = ctypes.sizeof(ObjectState)
    buffer = (ctypes.c_ubyte * (2 * size)).from_buffer_copy(bytes([_FILL_BYTE]) * (2 * size))
    if lib.SE_GetObjectState(object_id, ctypes.addressof(buffer)) != 0:
        raise InputError("esmini does not report the state of one of its objects; use another version of esmini.")
    written = bytes(buffer)
    # The last field is an int, followed by padding up to the next multiple of 8 bytes.
    is_shorter = written[size - 8 : size - 4] == bytes([_FILL_BYTE]) * 4
    is_longer = written[size:] != bytes([_FILL_BYTE]) * size
    if is_shorter or is_longer or ObjectState.from_buffer_copy(written[:size]).id != object_id:
        raise InputError("esmini's library stores object states in another layout than esmini 3.6; use esmini 3.6.")


def set_parameter(lib: ctypes.CDLL, name: str, value: Value, parameter_type: str) -> int:
    """Set a scenario parameter of the declared type `parameter_type`; return 0 if esmini accepts the value."""
    key = name.encode()
    if parameter_type == "double":
        return int(lib.SE_SetParameterDouble(key, float(value)))
    if parameter_type in ("integer", "int", "unsignedInt", "unsignedShort"):
        return int(lib.SE_SetParameterInt(key, round(float(value))))
    if parameter_type == "boolean":
        return int(lib.SE_SetParameterBool(key, str(value).lower() in ("true", "1")))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return int(lib.SE_SetParameterString(key, text.encode()))


def encode_esmini_path(path: Path) -> bytes:
    """Encode a path as esmini expects it; `InputError` if esmini cannot open such characters on this platform."""
    try:
        return encode_path(path)
    except UnicodeEncodeError:
        raise InputError(
            f"{path}: esmini cannot open a path with such special characters on this platform; move the scenario to"
            " another folder."
        ) from None
