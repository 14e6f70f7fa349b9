"""Machine code that comes with the package: what a wheel of this Python and platform holds, compiled when it was built.

It is taken if it was made of the same source by the same versions of Python, numba and LLVM, for a level of the
processor family that this machine has. Levels do not affect results, since no operation is reordered or fused.
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

FOLDER: Final = Path(__file__).parents[2] / "_compiled"
"""Folder of machine code in the package."""

LEVELS: Final = {
    "x86_64": {
        "x86-64-v4": ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"),
        "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    },
    "arm64": {"generic": ()},
}
"""Processor levels by family, the highest first, and the features that tell whether a machine has them."""

SHIP_VARIABLE: Final = "CORNERCASE_SHIP"
"""Environment variable: while a wheel is built, the folder into which machine code is written, too."""


def runnable_levels() -> list[str]:
    """Levels of this machine's processor, the highest first."""
    machine = platform.machine().lower()
    levels = LEVELS.get({"amd64": "x86_64", "aarch64": "arm64"}.get(machine, machine), {})
    present = llvm.get_host_cpu_features()
    lacking = {level for level, features in levels.items() if not all(map(present.get, features))}
    return [level for k, level in enumerate(levels) if not lacking.intersection(list(levels)[k:])]


@cache
def _folder() -> Path | None:
    """Folder with machine code of the highest level that this machine has."""
    if SHIP_VARIABLE in os.environ or not FOLDER.is_dir():
        return None
    return next((FOLDER / level for level in runnable_levels() if (FOLDER / level).is_dir()), None)


class ShippedCode:
    """Machine code of one function that comes with the package, by argument types."""

    def __init__(self, function: Any) -> None:
        self._function = function

    def load(self, source_digest: str, signature: Any, target_context: Any) -> Any:
        """Compile result for argument types; None if there is none, or its file is damaged."""
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
        """Whether there seems to be machine code for argument types."""
        path = self._path(source_digest, signature)
        return path is not None and path.is_file()

    def save(self, source_digest: str, signature: Any, result: Any) -> None:
        """Write a compile result to where `SHIP_VARIABLE` says, if a wheel is being built."""
        folder = os.environ.get(SHIP_VARIABLE)
        if folder:
            Path(folder, self._file_name(source_digest, signature)).write_bytes(dumps(result._reduce()))

    def _path(self, source_digest: str, signature: Any) -> Path | None:
        folder = _folder()
        return None if folder is None else folder / self._file_name(source_digest, signature)

    def _file_name(self, source_digest: str, signature: Any) -> str:
        function = self._function
        cells = dumps(tuple(cell.cell_contents for cell in function.__closure__ or ()))
        kinds = [(str(kind), tuple_fields(kind)) for kind in signature]
        versions = sys.version_info[:2], numba.__version__, llvmlite.__version__, llvm.get_process_triple()
        name = function.__module__, function.__qualname__, source_digest, kinds, versions
        return hashlib.sha256(repr(name).encode() + cells).hexdigest()[:32]


def tuple_fields(numba_type: Any) -> tuple[Any, ...]:
    """Names of the fields of a tuple and of those in it; machine code accesses them by position."""
    inner: Any = numba_type
    if not isinstance(numba_type, types.BaseTuple):
        return ()
    named = inner.fields if isinstance(numba_type, types.BaseNamedTuple) else ()
    return (named, *map(tuple_fields, inner))
