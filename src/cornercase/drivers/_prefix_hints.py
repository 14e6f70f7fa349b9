"""Hints on drivers that were given as a file or command, but without the prefix ``fmu:`` or ``exec:``."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Final

_FMU: Final = re.compile(r".+\.fmu(:.*)?", re.IGNORECASE)
_CLASS_FILE: Final = re.compile(r"(?P<module>[^:\s]+)\.py(:(?P<options>.+))?")


def suggest_prefix(name: str) -> str | None:
    """Return how to name a driver that was given as a file or command without a prefix; None for other names."""
    if _FMU.fullmatch(name):
        return f"an FMU is named as 'fmu:{name}'"
    if file := _CLASS_FILE.fullmatch(name):
        module, options = Path(file["module"]), file["options"]
        folder = "" if module.parent == Path() else f" in the folder {module.parent}"
        program = "" if options else f", a program as 'exec:python {name}'"
        return f"a class is named as '{module.name}:{options or 'Class'}'{folder}{program}"
    if name.endswith(".toml"):
        return f"give a file that names the drivers without an entity, as in --sut {name}"
    if name.isidentifier() and Path(f"{name}.py").is_file():
        return f"a class of {name}.py is named as '{name}:Class'"
    command = _as_command(name)
    return None if command is None else f"a program is named as '{command}'"


def add_prefix(name: str) -> str:
    """Add the prefix ``fmu:`` or ``exec:`` to a file or command; any other text is returned unchanged."""
    if name.startswith(("fmu:", "exec:")):
        return name
    return f"fmu:{name}" if _FMU.fullmatch(name) else _as_command(name) or name


def _as_command(name: str) -> str | None:
    # A folder with a class is no program.
    program, *arguments = name.split() if not re.fullmatch(r"[^:]*:[A-Za-z_]\w*", name) else [""]
    path = program.partition(":")[0]
    is_here = Path(path).name == path and Path(path).is_file() and not shutil.which(program)
    if not (is_here or re.match(r"[^:]*[/\\]|[A-Za-z]:\\|tcp:", program) or (arguments and shutil.which(program))):
        return None
    return f"exec:{'./' if is_here else ''}{name}"
