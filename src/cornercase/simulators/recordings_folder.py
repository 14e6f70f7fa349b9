"""A folder of recordings that says what each of them is of, so that it can be gone on with."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.files import read_file, written_whole
from cornercase._common.texts import cell_text, json_text, loaded_json
from cornercase._common.version import __version__
from cornercase.drivers import driver_changes
from cornercase.scenario import FILE_COLUMN, ConcreteScenario, value_text

NOTES: Final = "simulation.json"
"""File that says what the recordings are of."""

TABLE: Final = "parameters.csv"
"""File with the values of the recordings, as `cornercase.study.import_recordings` reads it."""

_FORMAT: Final = 1
_SCENARIO: Final = "scenario"


@dataclass(frozen=True)
class Planned:
    """A recording that is to be in the folder.

    Attributes
    ----------
    file : str
        Its name.
    concrete : ConcreteScenario
        What it is of, with the scenario file as it was read.
    """

    file: str
    concrete: ConcreteScenario

    def to_json(self) -> dict[str, Any]:
        """Say what it is of.

        Returns
        -------
        dict
            Plain values.
        """
        values = {name: value_text(value) for name, value in self.concrete.values.items()}
        return {_SCENARIO: self.concrete.path.name, "fingerprint": self.concrete.scenario().fingerprint()} | {
            "values": values
        }


class RecordingsFolder:
    """Recordings in a folder, with notes of what each is of.

    Parameters
    ----------
    path : Path
        It need not be there.
    planned : sequence of Planned
        What it is to hold.
    settings : mapping of str to object
        Everything else that the recordings depend on.

    Raises
    ------
    InputError
        A recording of another scenario, or with other settings, has one of the names, or a file of somebody else has.
    """

    def __init__(self, path: Path, planned: Sequence[Planned], settings: Mapping[str, object]) -> None:
        self._path = path
        # As they will be read again.
        self._settings: dict[str, Any] = loaded_json(json_text(dict(settings)))
        self._planned = {one.file: one.to_json() for one in planned}
        known = self._known()
        self.there = frozenset(file for file in self._planned if (path / file).exists())
        """Names of the recordings that were made before."""
        for file in sorted(self.there):
            self._require_same(file, known["recordings"].get(file))
        kept = {file: one for file, one in known["recordings"].items() if (path / file).exists()}
        if kept:
            self._require_same_settings(known["settings"])
        # Theirs is the order of the table, whichever were there before.
        self._recordings = self._planned | {file: one for file, one in kept.items() if file not in self._planned}

    def place(self, file: str) -> Path:
        """Give the path of a recording.

        Parameters
        ----------
        file : str

        Returns
        -------
        Path
        """
        return self._path / file

    def note(self) -> None:
        """Write down what the recordings are of, before the first of them is written."""
        notes = {"format": _FORMAT, "version": __version__, "settings": self._settings, "recordings": self._recordings}
        with written_whole(self._path / NOTES) as temporary:
            temporary.write_text(json_text(notes) + "\n", encoding="utf-8")

    def write_table(self, files: Sequence[str]) -> None:
        """Write the values of recordings as a table.

        Parameters
        ----------
        files : sequence of str
            Names of those that were made.
        """
        names = list(dict.fromkeys(name for file in files for name in self._planned[file]["values"]))
        several = len({self._planned[file][_SCENARIO] for file in files}) > 1
        with (
            written_whole(self._path / TABLE) as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as opened,
        ):
            writer = csv.writer(opened, lineterminator="\n")
            writer.writerow((FILE_COLUMN, *([_SCENARIO] if several else ()), *map(cell_text, names)))
            for file in files:
                about = self._planned[file]
                cells = [about["values"].get(name, "") for name in names]
                writer.writerow(map(cell_text, (file, *([about[_SCENARIO]] if several else ()), *cells)))

    def _known(self) -> dict[str, Any]:
        """What is written down of earlier recordings."""
        notes = self._path / NOTES
        if not notes.exists():
            for file in (*self._planned, TABLE):
                if (self._path / file).exists():
                    raise InputError(
                        f"`folder` {self._path}: has a file {file} already, and no {NOTES} that says what it is of;"
                        " choose another folder."
                    )
            return {"settings": {}, "recordings": {}}
        content = read_file(notes)
        found: Any = None
        with suppress(ValueError, RecursionError):
            found = loaded_json(content.decode())
        known: dict[str, Any] = found if isinstance(found, dict) else {}
        if known.get("format") != _FORMAT or not all(
            isinstance(known.get(key), dict) for key in ("settings", "recordings")
        ):
            raise InputError(f"{notes}: does not say what the recordings beside it are of; choose another folder.")
        return known

    def _require_same(self, file: str, before: Any) -> None:
        mine = self._planned[file]
        if before != mine:
            what = "another scenario"
            if isinstance(before, dict) and before.get(_SCENARIO) == mine[_SCENARIO]:
                same = before.get("fingerprint") == mine["fingerprint"]
                what = f"other values of {mine[_SCENARIO]}" if same else f"another version of {mine[_SCENARIO]}"
            raise InputError(f"{self._path / file}: is a recording of {what}; choose another folder, or remove it.")

    def _require_same_settings(self, before: Mapping[str, Any]) -> None:
        mine = self._settings
        other = [name for name in sorted({*mine, *before}) if mine.get(name) != before.get(name)]
        if other:
            changes = driver_changes(before.get("drivers"), mine.get("drivers"))
            drivers = "".join(f"; {there} drove {entity}, not {here}" for entity, there, here, _ in changes)
            raise InputError(
                f"`folder` {self._path}: holds recordings with another {', '.join(other)}{drivers}; choose another"
                " folder."
            )
