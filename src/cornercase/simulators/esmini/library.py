"""esmini's library, by ctypes."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.platform import bytes_of_path
from cornercase.scenario import Value

VARIABLE: Final = "CORNERCASE_ESMINI"
MISSING: Final = (
    f"esmini's library is not known; download esmini from github.com/esmini/esmini and set {VARIABLE} to its"
    " libesminiLib.so, esminiLib.dll or libesminiLib.dylib."
)
_FILL: Final = 0xAA


class State(ctypes.Structure):
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


CALLBACK: Final = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


def library_path(given: str | None) -> Path:
    """Find esmini's library.

    Parameters
    ----------
    given : str or None
        Its path; None for that of the environment variable ``CORNERCASE_ESMINI``.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        It is not known, or there is no such file.
    """
    text = given or os.environ.get(VARIABLE, "")
    if not text:
        raise InputError(MISSING)
    path = Path(text)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; {VARIABLE} has to be the path of esmini's library.")
    return path.resolve()


def load_library(path: Path) -> ctypes.CDLL:
    """Load esmini's library, and declare its functions.

    Parameters
    ----------
    path : Path

    Returns
    -------
    CDLL

    Raises
    ------
    InputError
        It cannot be loaded, or lacks a function.
    """
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
        "SE_RegisterParameterDeclarationCallback": (None, [CALLBACK, ctypes.c_void_p]),
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


def state_of(lib: ctypes.CDLL, one: int) -> State:
    """Read the state of an object.

    Parameters
    ----------
    lib : CDLL
    one : int
        Number of the object.

    Returns
    -------
    State

    Raises
    ------
    InputError
        esmini does not tell it.
    """
    state = State()
    if lib.SE_GetObjectState(one, ctypes.addressof(state)) != 0:
        raise InputError("esmini does not report the state of one of its objects; use another version.")
    return state


def require_layout(lib: ctypes.CDLL, one: int) -> None:
    """Refuse a library that writes more or less of a state than is expected.

    Parameters
    ----------
    lib : CDLL
    one : int
        Number of an object.

    Raises
    ------
    InputError
        It does.
    """
    size = ctypes.sizeof(State)
    buffer = (ctypes.c_ubyte * (2 * size)).from_buffer_copy(bytes([_FILL]) * (2 * size))
    if lib.SE_GetObjectState(one, ctypes.addressof(buffer)) != 0:
        raise InputError("esmini does not report the state of one of its objects; use another version.")
    written = bytes(buffer)
    # The last field is an int, which is followed by padding up to the next multiple of 8.
    if written[size - 8 : size - 4] == bytes([_FILL]) * 4 or written[size:] != bytes([_FILL]) * size:
        raise InputError("esmini's library has another layout than that of esmini 3.6; use esmini 3.6.")
    if State.from_buffer_copy(written[:size]).id != one:
        raise InputError("esmini's library has another layout than that of esmini 3.6; use esmini 3.6.")


def set_parameter(lib: ctypes.CDLL, name: str, value: Value, kind: str) -> int:
    """Set a parameter of the scenario.

    Parameters
    ----------
    lib : CDLL
    name : str
    value : float or str
    kind : str
        Type of its declaration.

    Returns
    -------
    int
        0 where esmini takes it.
    """
    key = name.encode()
    if kind == "double":
        return int(lib.SE_SetParameterDouble(key, float(value)))
    if kind in ("integer", "int", "unsignedInt", "unsignedShort"):
        return int(lib.SE_SetParameterInt(key, round(float(value))))
    if kind == "boolean":
        return int(lib.SE_SetParameterBool(key, str(value).lower() in ("true", "1")))
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return int(lib.SE_SetParameterString(key, text.encode()))


def encoded_path(path: Path) -> bytes:
    """Return a path as esmini opens it.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        It has characters that esmini cannot open on this platform.
    """
    try:
        return bytes_of_path(path)
    except UnicodeEncodeError:
        raise InputError(f"{path}: esmini cannot open a path with such characters here; move the scenario.") from None
