"""Reading of the roads of recordings; the roads of the last 8 files are kept."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from cornercase.roads._network import RoadNetwork


def read_recorded_roads(path: Path) -> RoadNetwork:
    """Read the roads of a recording from an OpenDRIVE file.

    If the file is one of the last 8 files and did not change, it is not read again.
    """
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        changed = 0
    return _read_unchanged_roads(path, changed)


@lru_cache(maxsize=8)
def _read_unchanged_roads(path: Path, changed: int) -> RoadNetwork:
    return RoadNetwork.read(path)
