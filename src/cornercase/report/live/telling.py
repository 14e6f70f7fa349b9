"""Contents and events of the live page."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from cornercase.exploration import Objective
from cornercase.report.contents import tell_subject
from cornercase.report.live.digests import tell_courses, tell_scenarios
from cornercase.report.live.follower import Follower
from cornercase.report.live.knowing import Finder, Knowledge
from cornercase.report.words import tell_roles
from cornercase.study import StudyMeta

# Sent with all contents or as separate events, not with the analysis.
_APART: Final = ("kinds", "outcomes", "kept", "notes", "roads", "rerun")


@dataclass(frozen=True)
class Cursor:
    """How much of the study a page has received."""

    epoch: str = ""  # study, as `StudyFollower.epoch`
    count: int = 0  # number of scenarios, in read order
    knowledge: int = 0  # revision of the analysis
    layout: int = 0  # layout revision of the analysis

    def __str__(self) -> str:
        return f"{self.epoch}.{self.count}.{self.knowledge}.{self.layout}"

    @classmethod
    def of(cls, text: str) -> Cursor:
        """Parse the output of `str`; an empty cursor for any other text."""
        parts = text[:100].split(".")
        if len(parts) != 4 or not all(number.isascii() and number.isdecimal() for number in parts[1:]):
            return cls()
        return cls(parts[0], *(int(number) for number in parts[1:]))


class Teller:
    """Creates the contents and events of live pages from the follower and the analysis worker."""

    def __init__(self, follower: Follower, finder: Finder) -> None:
        self.follower = follower
        self._finder = finder

    def contents(self) -> dict[str, Any]:
        """Return all contents of the page except recordings, with the progress in ``live``.

        Only ``live`` while no scenario has ended.
        """
        # In this order, so that the analysis never covers scenarios that are not in the contents.
        analysis = self._finder.known
        epoch, meta, digests, state = self.follower.known()
        current = analysis.of(epoch)
        live = {"cursor": str(Cursor(epoch, len(digests), current.number, current.layout))} | asdict(state)
        if meta is None or not digests:
            return {"live": live}
        digests.sort(key=lambda one: one.row.id)
        contents = _plain(meta, self.follower.path) | current.parts | tell_scenarios(meta, digests)
        contents["courses"] = tell_courses(meta, digests)
        contents["notes"] = {str(scenario): note for scenario, note in self.follower.notes.items()}
        _add_knowledge(contents, current)
        return contents | {"recordings": {}, "live": live}

    def news(self, cursor: Cursor, shown: Mapping[str, Any] | None = None) -> tuple[Cursor, str, Any] | None:
        """Return the next event for a page: new cursor, event name, data; None if there is nothing new.

        ``contents``: reload everything; ``scenarios``: new digests, with ``state`` if complete; ``knowledge``: new
        analysis; ``state``: progress that differs from `last_state`, the last one sent.
        """
        analysis = self._finder.known
        epoch, meta, digests, _ = self.follower.known()
        current = analysis.of(epoch)
        update = self.follower.since(cursor.epoch, cursor.count)
        if update is None or cursor.layout != current.layout:
            return Cursor(epoch, len(digests), current.number, current.layout), "contents", None
        new_digests, state = update
        if new_digests and meta is not None:
            courses = {name: [_rounded(digest.courses.get(name)) for digest in new_digests] for name in meta.metrics}
            spans = [digest.span for digest in new_digests]
            progress = None if state is None else asdict(state)
            columns = tell_scenarios(meta, new_digests) | {"courses": courses, "spans": spans, "state": progress}
            return Cursor(epoch, cursor.count + len(new_digests), cursor.knowledge, cursor.layout), "scenarios", columns
        if cursor.knowledge != current.number:
            parts = {name: value for name, value in current.parts.items() if name not in _APART}
            return Cursor(epoch, cursor.count, current.number, current.layout), "knowledge", parts
        if state is not None and asdict(state) != shown:
            return cursor, "state", asdict(state)
        return None

    def write_events(self, cursor: Cursor) -> Callable[[], Iterator[str]]:
        """Return a function that yields the server-sent events since its last call."""
        shown_state: dict[str, Any] | None = None
        shown_notes: dict[int, str] | None = None

        def write() -> Iterator[str]:
            nonlocal cursor, shown_state, shown_notes
            while (news := self.news(cursor, shown_state)) is not None:
                cursor, event, data = news
                if event == "state":
                    shown_state = data
                yield _event(event, data, str(cursor))
            if (notes := self.follower.notes) != shown_notes:
                shown_notes = notes
                yield _event("notes", notes)

        return write


def _event(name: str, data: Any, number: str | None = None) -> str:
    first = "" if number is None else f"id: {number}\n"
    return f"{first}event: {name}\ndata: {json.dumps(data, separators=(',', ':'))}\n\n"


def _rounded(course: Any) -> list[float] | None:
    return None if course is None else [float(f"{value:.6g}") for value in course]


def _plain(meta: StudyMeta, path: Path) -> dict[str, Any]:
    """Return the contents that are known before any analysis."""
    objective = Objective.of_study(meta)
    critical = None
    if meta.critical is not None and not meta.pareto:
        lower = objective.lower_is_critical
        critical = {"threshold": meta.critical, "lower_is_critical": lower, "unit": objective.unit}
    influential = list(range(len(meta.space.parameters)))
    return tell_subject(meta, path.name) | {
        "about": tell_roles(meta), "critical": critical, "default_aspect": None, "influential": influential,
        "outcomes": [], "answers": [], "captions": {}, "recordings_left_out": "", "roads": None, "roads_missing": "",
        "rerun": None, "details": [], "provenance": "", "kept": {}, "kinds": {},
    }  # fmt: skip


def _add_knowledge(contents: dict[str, Any], knowledge: Knowledge) -> None:
    """Fill the columns that depend on an analysis or a reduction."""
    columns, outcomes = contents["scenarios"], contents["outcomes"]
    ids = columns["id"]
    indices = {outcome: k for k, outcome in enumerate(outcomes)}
    columns["outcome"] = [indices.get(knowledge.outcomes.get(scenario, "")) for scenario in ids]
    columns["kept"] = [int(str(scenario) in contents["kept"]) for scenario in ids]
    contents["kinds"] = {
        name: clusters
        | {
            "labels": [clusters["labels"].get(scenario) for scenario in ids],
            "embedding": [[column.get(scenario) for scenario in ids] for column in clusters["embedding"]],
        }
        for name, clusters in contents["kinds"].items()
    }
