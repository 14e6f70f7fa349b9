"""An output folder of recordings, with notes on each recording so that it can be resumed."""

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

# Notes on the recordings.
NOTES: Final = "simulation.json"
# Parameter values of the recordings, as `cornercase.study.import_recordings` reads them.
TABLE: Final = "parameters.csv"

_FORMAT: Final = 1
_SCENARIO: Final = "scenario"


@dataclass(frozen=True)
class Planned:
    """A recording to be written: its file name, and its scenario with the file as it was read."""

    file: str
    concrete: ConcreteScenario

    def to_json(self) -> dict[str, Any]:
        """Return the notes on the recording as plain values."""
        values = {name: value_text(value) for name, value in self.concrete.values.items()}
        return {_SCENARIO: self.concrete.path.name, "fingerprint": self.concrete.scenario().fingerprint()} | {
            "values": values
        }


class RecordingsFolder:
    """A folder of recordings with notes; `settings` are what else the recordings depend on.

    Raises `InputError` if a file name is taken by a recording of another scenario or settings, or by another file.
    """

    def __init__(self, path: Path, planned: Sequence[Planned], settings: Mapping[str, object]) -> None:
        self._path = path
        # Normalized as they will be read again.
        self._settings: dict[str, Any] = loaded_json(json_text(dict(settings)))
        self._planned = {recording.file: recording.to_json() for recording in planned}
        notes = self._known()
        # Names of the recordings that exist already.
        self.there = frozenset(file for file in self._planned if (path / file).exists())
        for file in sorted(self.there):
            self._require_same(file, notes["recordings"].get(file))
        existing = {file: entry for file, entry in notes["recordings"].items() if (path / file).exists()}
        if existing:
            self._require_same_settings(notes["settings"])
        # Planned recordings first, in the order of the table.
        self._recordings = self._planned | {
            file: entry for file, entry in existing.items() if file not in self._planned
        }

    def place(self, file: str) -> Path:
        """Path of a recording."""
        return self._path / file

    def note(self) -> None:
        """Write the notes; called before the first recording is written."""
        notes = {"format": _FORMAT, "version": __version__, "settings": self._settings, "recordings": self._recordings}
        with written_whole(self._path / NOTES) as temporary:
            temporary.write_text(json_text(notes) + "\n", encoding="utf-8")

    def write_table(self, files: Sequence[str]) -> None:
        """Write the parameter values of finished recordings as a table."""
        names = list(dict.fromkeys(name for file in files for name in self._planned[file]["values"]))
        several = len({self._planned[file][_SCENARIO] for file in files}) > 1
        with (
            written_whole(self._path / TABLE) as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as opened,
        ):
            writer = csv.writer(opened, lineterminator="\n")
            writer.writerow((FILE_COLUMN, *([_SCENARIO] if several else ()), *map(cell_text, names)))
            for file in files:
                notes = self._planned[file]
                cells = [notes["values"].get(name, "") for name in names]
                writer.writerow(map(cell_text, (file, *([notes[_SCENARIO]] if several else ()), *cells)))

    def _known(self) -> dict[str, Any]:
        """Read the notes on existing recordings."""
        notes = self._path / NOTES
        if not notes.exists():
            for file in (*self._planned, TABLE):
                if (self._path / file).exists():
                    raise InputError(
                        f"`folder` {self._path}: contains a file {file}, but no {NOTES} that describes it; choose"
                        " another folder."
                    )
            return {"settings": {}, "recordings": {}}
        content = read_file(notes)
        document: Any = None
        with suppress(ValueError, RecursionError):
            document = loaded_json(content.decode())
        entries: dict[str, Any] = document if isinstance(document, dict) else {}
        if entries.get("format") != _FORMAT or not all(
            isinstance(entries.get(key), dict) for key in ("settings", "recordings")
        ):
            raise InputError(f"{notes}: does not describe the recordings in its folder; choose another folder.")
        return entries

    def _require_same(self, file: str, before: Any) -> None:
        own_notes = self._planned[file]
        if before != own_notes:
            difference = "another scenario"
            if isinstance(before, dict) and before.get(_SCENARIO) == own_notes[_SCENARIO]:
                same = before.get("fingerprint") == own_notes["fingerprint"]
                difference = f"{'other values' if same else 'another version'} of {own_notes[_SCENARIO]}"
            raise InputError(
                f"{self._path / file}: is a recording of {difference}; choose another folder, or remove the file."
            )

    def _require_same_settings(self, before: Mapping[str, Any]) -> None:
        own_settings = self._settings
        different = [name for name in sorted({*own_settings, *before}) if own_settings.get(name) != before.get(name)]
        if different:
            changes = driver_changes(before.get("drivers"), own_settings.get("drivers"))
            drivers = "".join(f"; {stored} drove {entity}, not {current}" for entity, stored, current, _ in changes)
            raise InputError(
                f"`folder` {self._path}: contains recordings with another {', '.join(different)}{drivers}; choose"
                " another folder."
            )
