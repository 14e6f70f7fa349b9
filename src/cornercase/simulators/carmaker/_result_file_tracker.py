"""Result files that a run writes into a CarMaker project."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


class ResultFileTracker:
    """List of the result files that exist in a project before a run, to recognize the files of the run."""

    def __init__(self, project: Path) -> None:
        self._folder = project / "SimOutput"
        self._stamps_before = self._current_stamps()

    def new_files(self) -> list[Path]:
        """Return the result files that were added or changed after this object was created, sorted by path."""
        return sorted(path for path, stamp in self._current_stamps().items() if self._stamps_before.get(path) != stamp)

    def is_old(self, path: Path) -> bool:
        """Return whether a file existed before the run and has not changed since."""
        with suppress(OSError):
            return self._stamps_before.get(path.resolve()) == _file_stamp(path)
        return False

    def _current_stamps(self) -> dict[Path, tuple[int, int]]:
        stamps = {}
        for path in self._folder.rglob("*.erg"):
            # CarMaker may delete a file meanwhile.
            with suppress(OSError):
                stamps[path.resolve()] = _file_stamp(path)
        return stamps


def _file_stamp(path: Path) -> tuple[int, int]:
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_size
