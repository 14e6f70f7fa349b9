"""Which result files of a CarMaker project a run has written."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


class ResultFiles:
    """The result files that a project had before a run.

    Parameters
    ----------
    project : Path
        Folder of the CarMaker project.
    """

    def __init__(self, project: Path) -> None:
        self._folder = project / "SimOutput"
        self._before = self._now()

    def written(self) -> list[Path]:
        """Return the files that are new or have changed since, in the order of their names."""
        return sorted(path for path, stamp in self._now().items() if self._before.get(path) != stamp)

    def is_old(self, path: Path) -> bool:
        """Whether a file was there before and has not changed since.

        Parameters
        ----------
        path : Path

        Returns
        -------
        bool
        """
        with suppress(OSError):
            return self._before.get(path.resolve()) == _stamp(path)
        return False

    def _now(self) -> dict[Path, tuple[int, int]]:
        found = {}
        for path in self._folder.rglob("*.erg"):
            # CarMaker may take one away meanwhile.
            with suppress(OSError):
                found[path.resolve()] = _stamp(path)
        return found


def _stamp(path: Path) -> tuple[int, int]:
    about = path.stat()
    return about.st_mtime_ns, about.st_size
