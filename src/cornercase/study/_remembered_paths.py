"""Remember paths of explored scenario files in the user's cache.

A study does not store paths that would reveal private folders, so these paths stay on this machine. Each path is stored
in a small file of its own, whose name is the fingerprint (SHA-256) of the scenario.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

from cornercase._common.io.files import atomic_write
from cornercase._common.platform import user_cache_folder
from cornercase.study._stored_paths import format_stored_path, resolve_stored_path


def remember_scenario_path(file: Path, fingerprint: str, study: Path) -> None:
    """Store the path of a scenario file in the user's cache, unless the path stored in `study` leads to the file.

    Do nothing if the cache cannot be written.
    """
    path = Path(os.path.abspath(file))
    if resolve_stored_path(format_stored_path(file, study), study) == path or find_remembered_path(fingerprint) == path:
        return
    with suppress(OSError, RuntimeError, ValueError), atomic_write(_remembered_path_file(fingerprint)) as temporary:
        temporary.write_text(str(path), encoding="utf-8")


def find_remembered_path(fingerprint: str) -> Path | None:
    """Return the path of the scenario file with this fingerprint from the user's cache; None if there is none."""
    # A study may come from anyone, and so may its fingerprint.
    if not re.fullmatch("[0-9a-f]{64}", fingerprint):
        return None
    try:
        return Path(_remembered_path_file(fingerprint).read_text(encoding="utf-8"))
    except (OSError, RuntimeError, ValueError):
        return None


def _remembered_path_file(fingerprint: str) -> Path:
    return user_cache_folder() / "cornercase" / "scenarios" / f"{fingerprint}.txt"
