"""Library and instances of an FMU in this process, through the C interface of FMI 2.0 and 3.0 for co-simulation.

This module imports only small modules, so that the child processes that run FMUs start quickly.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint32, c_void_p
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from cornercase._common.platform import add_library_folder, load_c_library

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
_STATUS_NAMES: Final = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
# C types of values, by major version of FMI and FMI type.
C_TYPES: Final[dict[int, dict[str, Any]]] = {
    2: {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p},
    3: {
        "Float32": ctypes.c_float,
        "Float64": c_double,
        "Int8": ctypes.c_int8,
        "UInt8": ctypes.c_uint8,
        "Int16": ctypes.c_int16,
        "UInt16": ctypes.c_uint16,
        "Int32": ctypes.c_int32,
        "UInt32": c_uint32,
        "Int64": ctypes.c_int64,
        "UInt64": ctypes.c_uint64,
        "Boolean": ctypes.c_bool,
        "String": c_char_p,
    },
}
_CO_SIMULATION: Final = 1


class FmuError(Exception):
    """Loading an FMU, or a call of its C functions, failed; `status` is the FMI status."""

    def __init__(self, what: str, status: int = ERROR) -> None:
        super().__init__(what)
        self.status = status


@dataclass(frozen=True)
class FmuSource:
    """Data that are needed to load an unpacked FMU.

    `version` is the major version of FMI, `folder` the folder of the unpacked FMU, `library` the path of its shared
    library, `token` its GUID or instantiation token. `log_categories` are the FMU's own categories of log messages
    about errors and warnings. `log_proxy` is the path of a library that formats the log messages of FMI 2.0, in which
    placeholders such as ``%d`` stand for arguments; empty if there is no such library.
    """

    version: int
    folder: str
    library: str
    token: str
    log_categories: tuple[str, ...] = ()
    log_proxy: str = ""


class _Callbacks2(ctypes.Structure):
    LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
    _fields_ = (
        ("logger", LOGGER),
        ("allocateMemory", c_void_p),
        ("freeMemory", c_void_p),
        ("stepFinished", c_void_p),
        ("componentEnvironment", c_void_p),
    )


_LOGGER_3: Final = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


class Fmu:
    """FMU whose library is loaded into this process; raises `FmuError` if the library cannot be loaded.

    `setters` and `getters` are the C functions by type (``"Real"``, ``"Integer"``, …): they take an instance, the value
    references and their number, a pointer to values, and in FMI 3.0 the number of values. `step_arguments` are the
    arguments of ``DoStep`` after instance, time and size. `has_ended` is set by a step that asks to end the simulation.
    `on_log` is called with each line that the FMU logs.
    """

    def __init__(self, source: FmuSource, on_log: Callable[[str], None] = lambda line: None) -> None:
        self.source, self.version, self.on_log = source, source.version, on_log
        self._prefix = f"fmi{source.version}"
        add_library_folder(Path(source.library).parent)
        try:
            self._dll = ctypes.CDLL(source.library)
        except OSError as error:
            raise FmuError(f"its library cannot be loaded: {error}") from error
        signature = (c_void_p, c_void_p, c_size_t, c_void_p, *((c_size_t,) if self.version == 3 else ()))
        self.setters, self.getters = (
            {
                kind: self.declare_function(f"{verb}{kind}", *signature)
                for kind in C_TYPES[self.version]
                if self._has(verb, kind)
            }
            for verb in ("Set", "Get")
        )
        self.reset = self.declare_function("Reset", c_void_p)
        self._terminate = self.declare_function("Terminate", c_void_p)
        self._free = self.declare_function("FreeInstance", c_void_p, returns=None)
        self._exit_initialization = self.declare_function("ExitInitializationMode", c_void_p)
        # Raises an error now if the function is missing, as for the functions above.
        self.bind("DoStep")
        self.has_ended = ctypes.c_bool()
        if self.version == 2:
            self._setup_experiment = self.declare_function(
                "SetupExperiment", c_void_p, c_int, c_double, c_double, c_int, c_double
            )
            self._enter_initialization = self.declare_function("EnterInitializationMode", c_void_p)
            self.step_arguments: tuple[Any, ...] = (c_int(1),)
            self._callbacks = self._make_callbacks()
        else:
            self._enter_initialization = self.declare_function(
                "EnterInitializationMode", c_void_p, ctypes.c_bool, c_double, c_double, ctypes.c_bool, c_double
            )
            self._flags = ctypes.c_bool(), ctypes.c_bool(), c_double()
            event, early, reached = self._flags
            pointers = (c_void_p(ctypes.addressof(flag)) for flag in (event, self.has_ended, early, reached))
            self.step_arguments = ctypes.c_bool(True), *pointers
            self._logger_3 = _LOGGER_3(self._log_3)

    def _has(self, verb: str, kind: str) -> bool:
        return hasattr(self._dll, f"{self._prefix}{verb}{kind}")

    def declare_function(self, name: str, *arguments: Any, returns: Any = c_int) -> Any:
        """Return a C function by its name without ``fmi2`` or ``fmi3``; declare the types of arguments and result."""
        function = self._find(name)
        function.argtypes, function.restype = arguments, returns
        return function

    def bind(self, name: str, *arguments: Any) -> Callable[[], int]:
        """Return a C function bound to fixed ctypes arguments, so that a call does not convert any."""
        return partial(self._find(name), *arguments)

    def _find(self, name: str) -> Any:
        try:
            # Indexing returns a new function object, so that its argument types hold for this use only.
            return self._dll[f"{self._prefix}{name}"]
        except AttributeError:
            raise FmuError(f"its library has no function {self._prefix}{name}") from None

    def check(self, name: str, status: int) -> None:
        """Raise `FmuError` for a status that is neither OK nor a warning."""
        if status > WARNING:
            meaning = _STATUS_NAMES[status] if status < len(_STATUS_NAMES) else str(status)
            raise FmuError(f"{self._prefix}{name} returned {self._prefix}{meaning}", status)

    def instantiate(self, name: str) -> Instance:
        """Create an instance of the FMU; raises `FmuError` if the library returns none."""
        source, categories = self.source, self.source.log_categories
        resources = Path(source.folder, "resources")
        if self.version == 2:
            instantiate = self.declare_function(
                "Instantiate", c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int, returns=c_void_p
            )
            component = instantiate(
                name.encode(),
                _CO_SIMULATION,
                source.token.encode(),
                resources.as_uri().encode(),
                ctypes.addressof(self._callbacks),
                0,
                bool(categories),
            )
        else:
            bools = (ctypes.c_bool,) * 4
            instantiate = self.declare_function(
                "InstantiateCoSimulation",
                *(c_char_p, c_char_p, c_char_p, *bools, c_void_p, c_size_t, c_void_p, _LOGGER_3, c_void_p),
                returns=c_void_p,
            )
            component = instantiate(
                name.encode(),
                source.token.encode(),
                os.fsencode(os.path.join(resources, "")),
                *(False, bool(categories), False, False),
                None,
                0,
                None,
                self._logger_3,
                None,
            )
        if not component:
            raise FmuError("its library could not create an instance of the FMU")
        if categories:
            names = (c_char_p * len(categories))(*(category.encode() for category in categories))
            flag = c_int if self.version == 2 else ctypes.c_bool
            set_logging = self.declare_function("SetDebugLogging", c_void_p, flag, c_size_t, c_void_p)
            set_logging(component, 1, len(categories), names)
        return Instance(self, component)

    def _make_callbacks(self) -> _Callbacks2:
        c_library = load_c_library()
        memory = (ctypes.cast(function, c_void_p) for function in (c_library.calloc, c_library.free))
        callbacks = _Callbacks2(_Callbacks2.LOGGER(self._log_2), *memory, None, None)
        if self.source.log_proxy:
            with suppress(OSError, AttributeError):
                ctypes.CDLL(self.source.log_proxy).addLoggerProxy(byref(callbacks))
        return callbacks

    def _log_2(self, _: object, name: bytes, status: int, category: bytes, message: bytes) -> None:
        self.on_log((message or b"").decode(errors="replace"))

    def _log_3(self, _: object, status: int, category: bytes, message: bytes) -> None:
        self.on_log((message or b"").decode(errors="replace"))


class Instance:
    """Instance of an FMU; `component` is its C pointer. Methods raise `FmuError` if the FMU returns an error."""

    def __init__(self, fmu: Fmu, component: int) -> None:
        self.fmu, self.component = fmu, component

    def set(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> None:
        """Set variables of one FMI type to Python values: `str`, numbers or `bool`."""
        array = (C_TYPES[self.fmu.version][kind] * len(values))(
            *(value.encode() if isinstance(value, str) else value for value in values)
        )
        self._call("Set", kind, references, array)

    def get(self, kind: str, references: Sequence[int], count: int | None = None) -> list[Any]:
        """Return the values of variables of one FMI type; `count` is the number of values if a variable is an array."""
        array = (C_TYPES[self.fmu.version][kind] * (count or len(references)))()
        self._call("Get", kind, references, array)
        return [value.decode() if isinstance(value, bytes) else value for value in array]

    def _call(self, verb: str, kind: str, references: Sequence[int], array: Any) -> None:
        functions = self.fmu.setters if verb == "Set" else self.fmu.getters
        if kind not in functions:
            raise FmuError(f"its library has no function fmi{self.fmu.version}{verb}{kind}")
        numbers = (c_uint32 * len(references))(*references)
        n_values = (len(array),) if self.fmu.version == 3 else ()
        status = functions[kind](self.component, numbers, len(references), array, *n_values)
        self.fmu.check(f"{verb}{kind}", status)

    def enter_initialization(self) -> None:
        """Begin the initialization at time 0; parameters are set before this call, inputs after this call."""
        fmu = self.fmu
        if fmu.version == 2:
            fmu.check("SetupExperiment", fmu._setup_experiment(self.component, 0, 0.0, 0.0, 0, 0.0))
            status = fmu._enter_initialization(self.component)
        else:
            status = fmu._enter_initialization(self.component, False, 0.0, 0.0, False, 0.0)
        fmu.check("EnterInitializationMode", status)

    def exit_initialization(self) -> None:
        """End the initialization, so that steps can follow."""
        self.fmu.check("ExitInitializationMode", self.fmu._exit_initialization(self.component))

    def bind_step(self, time: c_double, size: float) -> Callable[[], None]:
        """Return a function that does a step of `size` s; the step begins at the time that `time` holds at the call."""
        fmu = self.fmu
        do_step = fmu.bind("DoStep", c_void_p(self.component), time, c_double(size), *fmu.step_arguments)

        def step() -> None:
            status = do_step()
            if status > WARNING:
                fmu.check("DoStep", status)
            if fmu.has_ended.value:
                raise FmuError("fmi3DoStep asked to end the simulation")

        return step

    def reset(self) -> None:
        """Reset the instance to its state after the instantiation."""
        self.fmu.check("Reset", self.fmu.reset(self.component))

    def free(self, *, terminate: bool = True) -> None:
        """Terminate and free the instance; give `terminate=False` for an instance that has returned an error."""
        if terminate:
            self.fmu._terminate(self.component)
        self.fmu._free(self.component)
