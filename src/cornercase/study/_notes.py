"""Write notes about scenarios, even while an exploration writes to the study."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.validation import check_int, check_path
from cornercase.study._checksums import delete_rows, insert_rows
from cornercase.study._database import open_note_transaction

MAX_NOTE_LENGTH: Final = 2000
"""Largest number of characters of a note."""

# Largest integer of SQLite.
_MAX_ID: Final = 2**63 - 1


def write_note(study: Path | str, scenario: int, note: str) -> None:
    """Write a note about a scenario into its study.

    This works while an exploration writes to the study: the note is written in a separate transaction that takes
    milliseconds, and that does not need the exclusive right to write.

    Parameters
    ----------
    study : path
        Path of the study.
    scenario : int
        Id of the scenario.
    note : str
        At most 2,000 characters. An earlier note is replaced; an empty text removes the earlier note.

    Raises
    ------
    InputError
        There is no such study, there is no such scenario and the note is not empty, the note is too long or cannot be
        stored as text, or the file cannot be written.

    Examples
    --------
    >>> from cornercase.study import write_note
    >>> write_note("missing.db", 3, "brakes late")
    Traceback (most recent call last):
        ...
    cornercase._common.errors.InputError: missing.db: there is no such study; make one with `Study.create`.
    """
    file = check_path("study", study)
    scenario_id = check_int("scenario", scenario, maximum=_MAX_ID)
    text = _check_note(note)
    with open_note_transaction(file) as connection:
        if not text:
            delete_rows(connection, "notes", "scenario = ?", scenario_id)
            return
        if connection.execute("SELECT 1 FROM scenarios WHERE id = ?", (scenario_id,)).fetchone() is None:
            raise InputError(f"{file}: holds no scenario {scenario_id}.")
        insert_rows(connection, "notes", [(scenario_id, text)])


def _check_note(note: object) -> str:
    if not isinstance(note, str):
        raise InputError(f"`note`: is {type(note).__name__}, not a text.")
    text = note.strip()
    if len(text) > MAX_NOTE_LENGTH:
        raise InputError(f"`note`: has {len(text)} characters; the limit is {MAX_NOTE_LENGTH}.")
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError("`note`: contains a character that cannot be encoded as UTF-8.") from None
    if "\0" in text:
        raise InputError("`note`: contains a null character.")
    return text
