"""Machine code that the installed wheel contains, compiled when the wheel was built.

The machine code is used if the source code and the versions of Python, numba and LLVM are the same as at the build, and
if the processor has the features of a processor level, such as x86-64-v3. Results are the same on all levels, since no
operation is reordered or fused.
"""

# numba's internals have no type hints.
# mypy: disable-error-code="no-untyped-call, misc"

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final

import llvmlite
import llvmlite.binding as llvm
import numba
from numba import types
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from cornercase._common.numba.tuple_pointers import Reference

FOLDER: Final = Path(__file__).parents[2] / "_compiled"
"""Folder of machine code in the package."""

LEVELS: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "x86_64": {
        "x86-64-v4": ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"),
        "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    },
    "arm64": {"generic": ()},
}
"""Processor levels by processor family, the highest first, and the processor features that each level adds."""

SHIP_VARIABLE: Final = "CORNERCASE_SHIP"
"""Environment variable with the folder that machine code is also written to while a wheel is built."""


def list_runnable_cpu_levels() -> list[str]:
    """Return the processor levels that this machine can run, the highest first."""
    machine = platform.machine().lower()
    levels = LEVELS.get({"amd64": "x86_64", "aarch64": "arm64"}.get(machine, machine), {})
    present = llvm.get_host_cpu_features()
    lacking = {level for level, features in levels.items() if not all(map(present.get, features))}
    return [level for k, level in enumerate(levels) if not lacking.intersection(list(levels)[k:])]


@cache
def _find_shipped_folder() -> Path | None:
    """Return the folder with the machine code of the highest level that this machine can run; None if there is none."""
    if SHIP_VARIABLE in os.environ or not FOLDER.is_dir():
        return None
    return next((FOLDER / level for level in list_runnable_cpu_levels() if (FOLDER / level).is_dir()), None)


class ShippedCode:
    """Machine code of one function that the installed wheel contains, by argument types."""

    def __init__(self, function: Any) -> None:
        self._function = function

    def load(self, source_digest: str, signature: Any, target_context: Any) -> Any:
        """Return numba's compile result for argument types; None if its file is missing or damaged."""
        path = self._path(source_digest, signature)
        if path is None or not path.is_file():
            return None
        rtsys.initialize(target_context)
        target_context.refresh()
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(path.read_bytes()))
        except Exception:  # what pickle raises for a part of a file is not one kind of error
            return None

    def has(self, source_digest: str, signature: Any) -> bool:
        """Return whether a file with machine code for argument types exists."""
        path = self._path(source_digest, signature)
        return path is not None and path.is_file()

    def save(self, source_digest: str, signature: Any, result: Any) -> None:
        """Write a compile result to the folder in the environment variable `SHIP_VARIABLE`, which wheel builds set."""
        folder = os.environ.get(SHIP_VARIABLE)
        if folder:
            Path(folder, self._file_name(source_digest, signature)).write_bytes(dumps(result._reduce()))

    def _path(self, source_digest: str, signature: Any) -> Path | None:
        folder = _find_shipped_folder()
        return None if folder is None else folder / self._file_name(source_digest, signature)

    def _file_name(self, source_digest: str, signature: Any) -> str:
        function = self._function
        cells = dumps(tuple(cell.cell_contents for cell in function.__closure__ or ()))
        kinds = [(str(kind), nested_field_names(kind)) for kind in signature]
        versions = sys.version_info[:2], numba.__version__, llvmlite.__version__, llvm.get_process_triple()
        name = function.__module__, function.__qualname__, source_digest, kinds, versions
        return hashlib.sha256(repr(name).encode() + cells).hexdigest()[:32]


def nested_field_names(numba_type: Any) -> tuple[Any, ...]:
    """Return the field names of a numba tuple type and of its nested tuples; of a `Reference`, those of its tuple.

    Other types give an empty tuple. The names belong to the cache key: machine code accesses fields by position, so it
    would be wrong for tuples with reordered fields.
    """
    if isinstance(numba_type, Reference):
        return nested_field_names(numba_type.table)
    inner: Any = numba_type
    if not isinstance(numba_type, types.BaseTuple):
        return ()
    named = inner.fields if isinstance(numba_type, types.BaseNamedTuple) else ()
    return (named, *map(nested_field_names, inner))
