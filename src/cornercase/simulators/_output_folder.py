"""Output folder of recordings, with notes that allow an interrupted command to be resumed."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write, read_file
from cornercase._common.text.sanitize import escape_csv_cell, format_json, parse_json
from cornercase._common.version import __version__
from cornercase.drivers._serialization import iter_driver_changes
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._types import format_value
from cornercase.scenario._value_table import FILE_COLUMN

# Notes on the recordings.
NOTES_FILE: Final = "simulation.json"
# Parameter values of the recordings, as `cornercase.study.import_recordings` reads them.
TABLE_FILE: Final = "parameters.csv"

_FORMAT: Final = 1
_SCENARIO_KEY: Final = "scenario"


@dataclass(frozen=True)
class PlannedRecording:
    """A recording that the folder is to contain: its file name, and its scenario, whose file is already parsed."""

    file: str
    concrete_scenario: ConcreteScenario

    def to_json(self) -> dict[str, Any]:
        """Return the notes on the recording (scenario, its fingerprint, parameter values) as plain JSON values."""
        values = {name: format_value(value) for name, value in self.concrete_scenario.values.items()}
        return {
            _SCENARIO_KEY: self.concrete_scenario.path.name,
            "fingerprint": self.concrete_scenario.load_file().fingerprint(),
        } | {"values": values}


class RecordingsFolder:
    """A folder of recordings, with a single file of notes on all recordings.

    `settings` has everything that determines the recordings besides their scenarios. Raises `InputError` if a file name
    is taken by another file, or by a recording of another scenario or with other settings.
    """

    def __init__(self, path: Path, planned: Sequence[PlannedRecording], settings: Mapping[str, object]) -> None:
        self._path = path
        # Normalized as they will be read again.
        self._settings: dict[str, Any] = parse_json(format_json(dict(settings)))
        self._planned = {recording.file: recording.to_json() for recording in planned}
        notes = self._read_notes()
        # Names of the recordings that exist already.
        self.existing_files = frozenset(file for file in self._planned if (path / file).exists())
        for file in sorted(self.existing_files):
            self._require_same_scenario(file, notes["recordings"].get(file))
        existing = {file: entry for file, entry in notes["recordings"].items() if (path / file).exists()}
        if existing:
            self._require_same_settings(notes["settings"])
        # Planned recordings first, in the order of the table.
        self._recordings = self._planned | {
            file: entry for file, entry in existing.items() if file not in self._planned
        }

    def path_of(self, file: str) -> Path:
        """Return the path of a recording, given its file name."""
        return self._path / file

    def write_notes(self) -> None:
        """Write the notes; call this before the first recording is written."""
        notes = {"format": _FORMAT, "version": __version__, "settings": self._settings, "recordings": self._recordings}
        with atomic_write(self._path / NOTES_FILE) as temporary:
            temporary.write_text(format_json(notes) + "\n", encoding="utf-8")

    def write_table(self, files: Sequence[str]) -> None:
        """Write a table of the parameter values of finished recordings, and of others that have the same parameters."""
        names = list(dict.fromkeys(name for file in files for name in self._planned[file]["values"]))
        # `import_recordings` reads no table with empty fields.
        others = (
            file
            for file, notes in self._recordings.items()
            if file not in self._planned and notes["values"].keys() == {*names}
        )
        files = [*files, *others]
        several = len({self._recordings[file][_SCENARIO_KEY] for file in files}) > 1
        with (
            atomic_write(self._path / TABLE_FILE) as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as opened,
        ):
            writer = csv.writer(opened, lineterminator="\n")
            writer.writerow((FILE_COLUMN, *([_SCENARIO_KEY] if several else ()), *map(escape_csv_cell, names)))
            for file in files:
                notes = self._recordings[file]
                cells = [notes["values"].get(name, "") for name in names]
                writer.writerow(map(escape_csv_cell, (file, *([notes[_SCENARIO_KEY]] if several else ()), *cells)))

    def _read_notes(self) -> dict[str, Any]:
        notes = self._path / NOTES_FILE
        if not notes.exists():
            for file in (*self._planned, TABLE_FILE):
                if (self._path / file).exists():
                    raise InputError(
                        f"`folder` {self._path}: contains a file {file}, but no {NOTES_FILE} that describes it; choose"
                        " another folder."
                    )
            return {"settings": {}, "recordings": {}}
        content = read_file(notes)
        document: Any = None
        with suppress(ValueError, RecursionError):
            document = parse_json(content.decode())
        entries: dict[str, Any] = document if isinstance(document, dict) else {}
        if (
            entries.get("format") != _FORMAT
            or not all(isinstance(entries.get(key), dict) for key in ("settings", "recordings"))
            or not all(map(_describes_recording, entries["recordings"].values()))
        ):
            raise InputError(f"{notes}: does not describe the recordings in its folder; choose another folder.")
        return entries

    def _require_same_scenario(self, file: str, stored_notes: Any) -> None:
        own_notes = self._planned[file]
        if stored_notes != own_notes:
            difference = "another scenario"
            if isinstance(stored_notes, dict) and stored_notes.get(_SCENARIO_KEY) == own_notes[_SCENARIO_KEY]:
                same = stored_notes.get("fingerprint") == own_notes["fingerprint"]
                difference = f"{'other values' if same else 'another version'} of {own_notes[_SCENARIO_KEY]}"
            raise InputError(
                f"{self._path / file}: is a recording of {difference}; choose another folder, or remove the file."
            )

    def _require_same_settings(self, stored_settings: Mapping[str, Any]) -> None:
        own_settings = self._settings
        different = [
            name
            for name in sorted({*own_settings, *stored_settings})
            if own_settings.get(name) != stored_settings.get(name)
        ]
        if different:
            changes = iter_driver_changes(stored_settings.get("drivers"), own_settings.get("drivers"))
            drivers = "".join(f"; {stored} drove {entity}, not {current}" for entity, stored, current, _ in changes)
            raise InputError(
                f"`folder` {self._path}: contains recordings with another {', '.join(different)}{drivers}; choose"
                " another folder."
            )


def _describes_recording(entry: object) -> bool:
    """Return whether an entry of the notes has what the table of parameter values takes from it."""
    return (
        isinstance(entry, dict)
        and isinstance(entry.get(_SCENARIO_KEY), str)
        and isinstance(entry.get("values"), dict)
        and all(isinstance(value, str) for value in entry["values"].values())
    )
