"""What a live page is told: its contents at a moment, and what happens from then on."""

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

# What is not told with the rest of what is known: it comes with all contents, or by itself.
_APART: Final = ("kinds", "outcomes", "kept", "notes", "roads", "rerun")


@dataclass(frozen=True)
class Cursor:
    """How far a page knows the study.

    Attributes
    ----------
    epoch : str
        Which study, as `Follower.epoch`.
    count : int
        How many scenarios, in the order in which they were read.
    knowledge, layout : int
        Numbers of what it knows of all of them.
    """

    epoch: str = ""
    count: int = 0
    knowledge: int = 0
    layout: int = 0

    def __str__(self) -> str:
        return f"{self.epoch}.{self.count}.{self.knowledge}.{self.layout}"

    @classmethod
    def of(cls, text: str) -> Cursor:
        """Read what `str` gave.

        Parameters
        ----------
        text : str

        Returns
        -------
        Cursor
            One that knows nothing where it is another text.
        """
        parts = text[:100].split(".")
        if len(parts) != 4 or not all(one.isascii() and one.isdecimal() for one in parts[1:]):
            return cls()
        return cls(parts[0], *(int(one) for one in parts[1:]))


class Teller:
    """Tells pages what is known.

    Parameters
    ----------
    follower : Follower
    finder : Finder
    """

    def __init__(self, follower: Follower, finder: Finder) -> None:
        self.follower = follower
        self._finder = finder

    def contents(self) -> dict[str, Any]:
        """Give everything that the page shows by now, but the recordings.

        Returns
        -------
        dict of str to object
            As `cornercase.report.contents.page_contents`, with ``live``: how far this is. Only that while no scenario
            has ended.
        """
        # In this order, so that nothing is known of scenarios that are not there.
        known = self._finder.known
        epoch, meta, digests, state = self.follower.known()
        knowledge = known.of(epoch)
        live = {"cursor": str(Cursor(epoch, len(digests), knowledge.number, knowledge.layout))} | asdict(state)
        if meta is None or not digests:
            return {"live": live}
        digests.sort(key=lambda one: one.row.id)
        contents = _plain(meta, self.follower.path) | knowledge.parts | tell_scenarios(meta, digests)
        contents["courses"] = tell_courses(meta, digests)
        contents["notes"] = {str(scenario): note for scenario, note in self.follower.notes.items()}
        _add_knowledge(contents, knowledge)
        return contents | {"recordings": {}, "live": live}

    def state(self) -> dict[str, Any]:
        """Tell how far the study is.

        Returns
        -------
        dict of str to object
            The fields of `cornercase.report.live.follower.State`.
        """
        return asdict(self.follower.state)

    def news(self, cursor: Cursor, shown: Mapping[str, Any] | None = None) -> tuple[Cursor, str, Any] | None:
        """Tell the next thing that a page does not know.

        Parameters
        ----------
        cursor : Cursor
            How far it knows the study.
        shown : mapping of str to object, optional
            The last state that it was told.

        Returns
        -------
        cursor : Cursor
            How far it knows the study then.
        event : {"contents", "scenarios", "knowledge", "state"}
            Of the first, everything has to be asked for again. The last counts what the page was told by then.
        data : object
            Plain values; scenarios come with ``state``, which counts them, or is None where more follow at once.
            None is returned where there is nothing new.
        """
        known = self._finder.known
        epoch, meta, digests, _ = self.follower.known()
        knowledge = known.of(epoch)
        since = self.follower.since(cursor.epoch, cursor.count)
        if since is None or cursor.layout != knowledge.layout:
            return Cursor(epoch, len(digests), knowledge.number, knowledge.layout), "contents", None
        some, state = since
        if some and meta is not None:
            courses = {name: [_rounded(one.courses.get(name)) for one in some] for name in meta.metrics}
            spans = [one.span for one in some]
            counted = None if state is None else asdict(state)
            columns = tell_scenarios(meta, some) | {"courses": courses, "spans": spans, "state": counted}
            return Cursor(epoch, cursor.count + len(some), cursor.knowledge, cursor.layout), "scenarios", columns
        if cursor.knowledge != knowledge.number:
            parts = {name: value for name, value in knowledge.parts.items() if name not in _APART}
            return Cursor(epoch, cursor.count, knowledge.number, knowledge.layout), "knowledge", parts
        if state is not None and asdict(state) != shown:
            return cursor, "state", asdict(state)
        return None

    def write_events(self, cursor: Cursor) -> Callable[[], Iterator[str]]:
        """Give a function that writes what has happened since its last call, as server-sent events.

        Parameters
        ----------
        cursor : Cursor
            How far the page knows the study.

        Returns
        -------
        callable
            Gives the events as text.
        """
        shown_state: dict[str, Any] | None = None
        shown_notes: dict[int, str] | None = None

        def write() -> Iterator[str]:
            nonlocal cursor, shown_state, shown_notes
            while (found := self.news(cursor, shown_state)) is not None:
                cursor, event, data = found
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
    return None if course is None else [float(f"{one:.6g}") for one in course]


def _plain(meta: StudyMeta, path: Path) -> dict[str, Any]:
    """Give what the page needs before anything is known of all scenarios together."""
    objective = Objective.of_study(meta)
    critical = None
    if meta.critical is not None and not meta.pareto:
        lower = objective.lower_is_critical
        critical = {"threshold": meta.critical, "lower_is_critical": lower, "unit": objective.unit}
    return tell_subject(meta, path.name) | {
        "about": tell_roles(meta),
        "critical": critical,
        "default_aspect": None,
        "influential": list(range(len(meta.space.parameters))),
        "outcomes": [],
        "answers": [],
        "captions": {},
        "recordings_left_out": "",
        "roads": None,
        "roads_missing": "",
        "rerun": None,
        "details": [],
        "provenance": "",
        "kept": {},
        "kinds": {},
    }


def _add_knowledge(contents: dict[str, Any], knowledge: Knowledge) -> None:
    """Fill the columns of which only an analysis and a reduction know something."""
    columns, named = contents["scenarios"], contents["outcomes"]
    ids = columns["id"]
    place = {outcome: k for k, outcome in enumerate(named)}
    columns["outcome"] = [place.get(knowledge.outcomes.get(one, "")) for one in ids]
    columns["kept"] = [int(str(one) in contents["kept"]) for one in ids]
    contents["kinds"] = {
        name: one
        | {
            "labels": [one["labels"].get(scenario) for scenario in ids],
            "embedding": [[column.get(scenario) for scenario in ids] for column in one["embedding"]],
        }
        for name, one in contents["kinds"].items()
    }
