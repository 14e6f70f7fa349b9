"""What must not be, of how a command ended."""

from __future__ import annotations

import re
from pathlib import Path

_ORDERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
# Beside a study.
_BESIDE = (".lock", "-wal", "-shm")
_LONGEST = 1500


def files_in(folder: Path) -> set[str]:
    return {str(one.relative_to(folder)) for one in folder.rglob("*") if one.is_file()}


def trouble_of(code: object, said: str, told: str, before: set[str], after: set[str]) -> list[str]:
    """Name all that must not be: of exit code, output, errors, and the files before and after."""
    found = [] if code in (0, 1, 2) else [f"exit code {code}"]
    lines = [one for one in told.splitlines() if one.startswith("cornercase: ")]
    usage = told.startswith("Usage: ")
    found += [
        word
        for word in ("please report", "Traceback", "MemoryError", "needs more memory than available")
        if word in told
    ]
    if re.search(r"\w+Warning: ", told):
        found.append("a warning of a library")
    if len(lines) > 1 or (code == 2 and not lines and not usage):
        found.append(f"{len(lines)} sentences")
    if any(len(one) > _LONGEST for one in lines):
        found.append("a long sentence")
    if _ORDERS.search(said) or _ORDERS.search(told):
        found.append("orders to the terminal")
    new = {one for one in after - before if not one.endswith(_BESIDE)}
    if any(Path(one).name.startswith(".") for one in new):
        found.append("a temporary file left behind")
    if code == 2 and new:
        found.append("a file of a command that failed")
    if before - after:
        found.append("a file that is gone")
    return found
