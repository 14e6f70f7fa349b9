"""Texts of a test card on all contacts of the ego, including contacts that no metric of the study measures."""

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


def escape_and_shorten(text: str, length: int = _MAX_NAME) -> str:
    """Escape control characters in a text from a file or user, and shorten the text to `length` characters."""
    return shorten(escape_control_characters(text), length)


def join_names(names: Sequence[str], conjunction: str = "and") -> str:
    """Join names for a sentence: ``"A, B and C"``; after five names, only the number of further names follows."""
    texts = [quote_name(escape_and_shorten(name)) for name in names[:_MAX_NAMES]]
    if len(names) > _MAX_NAMES:
        texts.append(f"{len(names) - _MAX_NAMES} more")
    *first, last = texts
    return f"{', '.join(first)} {conjunction} {last}" if first else last


def describe_contacts(meeting: Meeting) -> str:
    """Describe all contacts of the ego as part of a sentence, including contacts that the study does not measure."""
    contacts = []
    if meeting.collides:
        contacts.append(f"with {join_names([meeting.other, *_contact_names(meeting.further_contacts)])}")
    if meeting.unmeasured_contacts:
        contacts.append(f"with {join_names(_contact_names(meeting.unmeasured_contacts))} {_NOT_MEASURED}")
    return f"contact {', and '.join(contacts)}" if contacts else "no contact"


def list_contact_rows_by_run(meetings: Sequence[Meeting | None]) -> list[dict[str, str]]:
    """Return, for each run, texts about the contacts of the run by name of the table row; a None run has no texts."""
    # If one run has a row, all runs have it; the text is "none" in runs without this kind of contact.
    has_further = any(meeting is not None and meeting.further_contacts for meeting in meetings)
    has_unmeasured = any(meeting is not None and meeting.unmeasured_contacts for meeting in meetings)
    columns: list[dict[str, str]] = []
    for meeting in meetings:
        rows = {}
        if meeting is not None:
            none = "none measured" if meeting.unmeasured_contacts else _NONE
            rows["contact"] = f"with {escape_and_shorten(meeting.other, 20)}" if meeting.collides else none
            if has_further:
                rows[_FURTHER_CONTACT] = _format_contacts(meeting.further_contacts)
            if has_unmeasured:
                rows[_UNMEASURED_CONTACT] = _format_contacts(meeting.unmeasured_contacts)
        columns.append(rows)
    return columns


def describe_unmeasured_contacts(meetings: Sequence[Meeting], ego: str) -> str:
    """Return a sentence on contacts of the ego with unmeasured entities; empty if no run has such a contact.

    An entity is unmeasured if no metric measures the ego against the entity. The study does not judge contacts with
    unmeasured entities, so the sentence asks the testers to agree whether these contacts fail a run.
    """
    names = list(dict.fromkeys(name for meeting in meetings for name in _contact_names(meeting.unmeasured_contacts)))
    if not names:
        return ""
    return (
        f"In the simulation {quote_name(escape_and_shorten(ego))} touches {join_names(names)}, which the study does not"
        f" measure: agree whether a contact with {'it' if len(names) == 1 else 'them'} fails a run."
    )


def _contact_names(contacts: Sequence[tuple[str, float]]) -> list[str]:
    return [name for name, _ in contacts]


def _format_contacts(contacts: Sequence[tuple[str, float]]) -> str:
    """Format the name and time in s of the first contact, and the number of further contacts."""
    if not contacts:
        return _NONE
    (name, time), n_more = contacts[0], len(contacts) - 1
    return f"{escape_and_shorten(name, 10)}, {time:.2f} s{f', {n_more} more' if n_more else ''}"
