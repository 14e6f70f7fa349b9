"""Detect the result files that a run writes in a CarMaker project."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


class ResultFiles:
    """The result files that a project has now, before a run."""

    def __init__(self, project: Path) -> None:
        self._folder = project / "SimOutput"
        self._before = self._now()

    def written(self) -> list[Path]:
        """Return files that are new or changed since, sorted by name."""
        return sorted(path for path, stamp in self._now().items() if self._before.get(path) != stamp)

    def is_old(self, path: Path) -> bool:
        """Return whether a file existed before and is unchanged."""
        with suppress(OSError):
            return self._before.get(path.resolve()) == _stamp(path)
        return False

    def _now(self) -> dict[Path, tuple[int, int]]:
        stamps = {}
        for path in self._folder.rglob("*.erg"):
            # CarMaker may delete a file meanwhile.
            with suppress(OSError):
                stamps[path.resolve()] = _stamp(path)
        return stamps


def _stamp(path: Path) -> tuple[int, int]:
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_size
