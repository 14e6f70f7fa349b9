"""What the ego touches, in the words of a test card; contacts that the study does not measure are told apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cornercase._common.text.sanitize import escape_control_characters, quote_name, shorten
from cornercase.report.cards._meeting import Meeting

# What fits on the page: characters of a name, and names in a sentence.
_MAX_NAME: Final = 26
_MAX_NAMES: Final = 5
_NOT_MEASURED: Final = "(not measured in the study)"
_FURTHER_CONTACT: Final = "further contact"
_UNMEASURED_CONTACT: Final = "unmeasured contact"
_NONE: Final = "none"


def clean(text: str, length: int = _MAX_NAME) -> str:
    """Return a text from a file or a user as it can be shown."""
    return shorten(escape_control_characters(text), length)


def list_names(names: Sequence[str], word: str = "and") -> str:
    """List names as they stand in a sentence; those for which there is no room are counted."""
    texts = [quote_name(clean(name)) for name in names[:_MAX_NAMES]]
    if len(names) > _MAX_NAMES:
        texts.append(f"{len(names) - _MAX_NAMES} more")
    *first, last = texts
    return f"{', '.join(first)} {word} {last}" if first else last


def describe_contacts(meeting: Meeting) -> str:
    """Describe, as part of a sentence, all contacts of the ego, measured or not."""
    contacts = []
    if meeting.collides:
        contacts.append(f"with {list_names([meeting.other, *_names(meeting.further_contacts)])}")
    if meeting.unmeasured_contacts:
        contacts.append(f"with {list_names(_names(meeting.unmeasured_contacts))} {_NOT_MEASURED}")
    return f"contact {', and '.join(contacts)}" if contacts else "no contact"


def list_contacts(meetings: Sequence[Meeting | None]) -> list[dict[str, str]]:
    """Return rows about contacts by name, for each of some runs; None is no run, and has no rows."""
    # Of a contact that one run has, the others say that they have none.
    has_further = any(meeting is not None and meeting.further_contacts for meeting in meetings)
    has_unmeasured = any(meeting is not None and meeting.unmeasured_contacts for meeting in meetings)
    columns: list[dict[str, str]] = []
    for meeting in meetings:
        rows = {}
        if meeting is not None:
            none = "none measured" if meeting.unmeasured_contacts else _NONE
            rows["contact"] = f"with {clean(meeting.other, 20)}" if meeting.collides else none
            if has_further:
                rows[_FURTHER_CONTACT] = _format_contacts(meeting.further_contacts)
            if has_unmeasured:
                rows[_UNMEASURED_CONTACT] = _format_contacts(meeting.unmeasured_contacts)
        columns.append(rows)
    return columns


def ask_about_unmeasured(meetings: Sequence[Meeting], ego: str) -> str:
    """Say what the ego touches in any of some runs without being measured against it; empty if nothing.

    Whether that fails a run is for those who test, as the study does not judge it.
    """
    names = list(dict.fromkeys(name for meeting in meetings for name in _names(meeting.unmeasured_contacts)))
    if not names:
        return ""
    return (
        f"In the simulation {quote_name(clean(ego))} touches {list_names(names)}, which the study does not measure:"
        f" agree whether a contact with {'it' if len(names) == 1 else 'them'} fails a run."
    )


def _names(contacts: Sequence[tuple[str, float]]) -> list[str]:
    return [name for name, _ in contacts]


def _format_contacts(contacts: Sequence[tuple[str, float]]) -> str:
    """Return the first of some contacts, and the number of the others."""
    if not contacts:
        return _NONE
    (name, time), n_more = contacts[0], len(contacts) - 1
    return f"{clean(name, 10)}, {time:.2f} s{f', {n_more} more' if n_more else ''}"
