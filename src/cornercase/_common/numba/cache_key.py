"""Cache key of a kernel: a digest of its code, of the functions that it calls, and of the constants that it uses."""

from __future__ import annotations

import enum
import hashlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher


def kernel_digest(function: Callable[..., Any], options: dict[str, Any]) -> str:
    """Return a digest of everything that the machine code of a function depends on, including code in other modules.

    Closure variables are left out, because numba stores separate code for each of their values. TypeError for a global
    variable of an unsupported type.
    """
    digest = hashlib.sha256(repr(sorted(options.items())).encode())
    for part in _DependencyWalker().iter_bytes(function, frozenset()):
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


# Only names count for these packages: numba discards the cache of its other versions, and refers to functions of the
# others by name.
_EXTERNAL_PACKAGES = sys.stdlib_module_names | {"numba", "numpy"}


class _DependencyWalker:
    """Walk through a function and everything that it uses; each function is visited once, as calls may be circular."""

    def __init__(self) -> None:
        self.seen: set[Any] = set()

    def iter_bytes(self, value: Any, names: frozenset[str]) -> Iterator[bytes]:
        """Yield bytes that identify a value; of a module, only the attributes in `names` count."""
        if isinstance(value, Dispatcher):
            yield repr(sorted(value.targetoptions.items())).encode()
            value = value.py_func
        if isinstance(value, bool | int | float | complex | str | bytes | np.generic | np.dtype | None):
            yield f"{type(value).__name__} {value!r}".encode()
        elif isinstance(value, tuple):
            yield f"{type(value).__name__} {len(value)}".encode()
            for item in value:
                yield from self.iter_bytes(item, names)
        elif isinstance(value, np.ndarray):
            yield f"{value.dtype.str} {value.shape}".encode() + value.tobytes()
        elif isinstance(value, enum.EnumMeta):
            members: dict[str, Any] = dict(value.__members__)
            yield repr([(name, member.value) for name, member in members.items()]).encode()
        elif isinstance(value, ModuleType):
            if not _is_external(value.__name__):
                yield from self._walk_names(vars(value), names)
        elif not hasattr(value, "__module__"):
            raise TypeError(f"a numba function uses the value {value!r}, whose type cannot be hashed.")
        elif _is_external(value.__module__):
            yield f"{value.__module__} {getattr(value, '__qualname__', value)}".encode()
        elif value not in self.seen:
            self.seen.add(value)
            yield from (
                self._walk_function(value)
                if isinstance(value, FunctionType)
                else self._yield_source_file(value.__module__)
            )

    def _walk_names(self, namespace: dict[str, Any], names: frozenset[str]) -> Iterator[bytes]:
        for name in sorted(names & namespace.keys()):
            yield name.encode()
            yield from self.iter_bytes(namespace[name], names)

    def _walk_function(self, function: FunctionType) -> Iterator[bytes]:
        names: set[str] = set()
        yield from _walk_bytecode(function.__code__, names, function.__doc__)
        yield from self._walk_names(function.__globals__, frozenset(names))
        yield repr(function.__defaults__).encode()

    def _yield_source_file(self, module: str) -> Iterator[bytes]:
        """Yield the source file of a module whose objects have no bytecode, such as numba's intrinsics."""
        if module not in self.seen:
            self.seen.add(module)
            yield Path(str(sys.modules[module].__file__)).read_bytes()


def _is_external(module: str) -> bool:
    return module.partition(".")[0] in _EXTERNAL_PACKAGES


def _walk_bytecode(code: CodeType, names: set[str], docstring: str | None = None) -> Iterator[bytes]:
    """Yield the instructions and constants of a code object, and add the names that the code uses to `names`.

    Line numbers and the docstring are left out, because they do not change the machine code.
    """
    names.update(code.co_names)
    yield f"{code.co_varnames} {code.co_freevars} {code.co_names} {code.co_argcount}".encode()
    yield code.co_code + code.co_exceptiontable
    for k, constant in enumerate(code.co_consts):
        if k == 0 and docstring is not None and constant == docstring:
            yield b"docstring"
        elif isinstance(constant, CodeType):
            yield from _walk_bytecode(constant, names)
        elif isinstance(constant, frozenset):
            yield repr(sorted(map(repr, constant))).encode()
        else:
            yield repr(constant).encode()
