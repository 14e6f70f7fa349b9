"""Notes that people write about scenarios, also while an explorer writes to the study."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from cornercase._common.arguments import path, whole_number
from cornercase._common.errors import InputError
from cornercase.study.database import written_beside
from cornercase.study.seals import put, remove

LONGEST_NOTE: Final = 2000
"""Characters that a note may have."""

# SQLite counts no further.
_LARGEST_ID: Final = 2**63 - 1


def write_note(study: Path | str, scenario: int, note: str) -> None:
    """Write what somebody thinks of a scenario into its study.

    An explorer may be writing to the study: the note is a transaction of its own that takes milliseconds, for which the
    lock of the explorer is not needed.

    Parameters
    ----------
    study : path
        Of the study.
    scenario : int
        Its id.
    note : str
        At most 2,000 characters; it takes the place of the one that was there, and an empty one removes it.

    Raises
    ------
    InputError
        There is no such study or scenario, the note is too long or no text that a file can hold, or the file cannot be
        written.

    Examples
    --------
    >>> from cornercase.study import write_note
    >>> write_note("missing.db", 3, "brakes late")
    Traceback (most recent call last):
        ...
    cornercase._common.errors.InputError: missing.db: there is no such study; make one with `explore`.
    """
    file = path("study", study)
    one = whole_number("scenario", scenario, most=_LARGEST_ID)
    text = _checked(note)
    with written_beside(file) as connection:
        if not text:
            remove(connection, "notes", "scenario = ?", one)
            return
        if connection.execute("SELECT 1 FROM scenarios WHERE id = ?", (one,)).fetchone() is None:
            raise InputError(f"{file}: holds no scenario {one}.")
        put(connection, "notes", [(one, text)])


def _checked(note: object) -> str:
    if not isinstance(note, str):
        raise InputError(f"`note`: is {type(note).__name__}, not a text.")
    text = note.strip()
    if len(text) > LONGEST_NOTE:
        raise InputError(f"`note`: has {len(text)} characters; at most {LONGEST_NOTE} are kept.")
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError("`note`: holds half a character, which no file can hold.") from None
    if "\0" in text:
        raise InputError("`note`: holds the character 0, which no note can hold.")
    return text
