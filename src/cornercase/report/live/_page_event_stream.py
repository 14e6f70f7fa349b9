"""Contents of the live page, and server-sent events that update the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from cornercase.report._report_payload import study_info_payload
from cornercase.report.live._analysis_worker import AnalysisWorker, PageAnalysis
from cornercase.report.live._follower import StudyFollower
from cornercase.report.live._live_scenario_reader import course_columns, scenario_columns
from cornercase.study import StudyMeta
from cornercase.study._objective import Objective

# Keys that are sent with all contents or as separate events, not with the analysis.
_SEPARATE_KEYS: Final = ("kinds", "outcomes", "kept", "notes", "roads", "rerun")


@dataclass(frozen=True)
class Cursor:
    """Position in the event stream of a live page: what the page has received so far."""

    epoch: str = ""  # identifier of the study (`StudyFollower.epoch`)
    n_scenarios: int = 0  # number of received scenarios, in the order in which they were read
    analysis_revision: int = 0  # revision of the analysis
    layout_revision: int = 0  # layout revision of the analysis

    def __str__(self) -> str:
        return f"{self.epoch}.{self.n_scenarios}.{self.analysis_revision}.{self.layout_revision}"

    @classmethod
    def parse(cls, text: str) -> Cursor:
        """Parse a text that `str` returned for a cursor; any other text gives an empty cursor."""
        parts = text[:100].split(".")
        if len(parts) != 4 or not all(number.isascii() and number.isdecimal() for number in parts[1:]):
            return cls()
        return cls(parts[0], *(int(number) for number in parts[1:]))


class EventStream:
    """Source of contents and events of live pages, from the data of the follower and the analysis worker."""

    def __init__(self, follower: StudyFollower, analysis_worker: AnalysisWorker) -> None:
        self.follower = follower
        self._analysis_worker = analysis_worker

    def contents(self) -> dict[str, Any]:
        """Return the contents of the live page, except recordings, as JSON values.

        The key ``live`` holds the progress. It is the only key until the first scenario has ended.
        """
        # The analysis is read first, so that it never covers scenarios that are missing from the contents.
        analysis = self._analysis_worker.latest
        epoch, meta, digests, state = self.follower.snapshot()
        current = analysis.for_epoch(epoch)
        live = {"cursor": str(Cursor(epoch, len(digests), current.revision, current.layout_revision))} | asdict(state)
        if meta is None or not digests:
            return {"live": live}
        digests.sort(key=lambda one: one.row.id)
        contents = _initial_contents(meta, self.follower.path) | current.parts | scenario_columns(meta, digests)
        contents["courses"] = course_columns(meta, digests)
        contents["notes"] = {str(scenario): note for scenario, note in self.follower.notes.items()}
        _add_analysis(contents, current)
        return contents | {"recordings": {}, "live": live}

    def next_event(self, cursor: Cursor, last_state: Mapping[str, Any] | None = None) -> tuple[Cursor, str, Any] | None:
        """Return the next event for a live page: new cursor, event name and data; None if nothing is new.

        The event ``contents`` tells the page to reload everything. ``scenarios`` adds new scenarios, with the progress
        if no more scenarios follow. ``knowledge`` replaces the analysis. ``state`` replaces the progress if it differs
        from `last_state`, the progress sent last.
        """
        analysis = self._analysis_worker.latest
        epoch, meta, digests, _ = self.follower.snapshot()
        current = analysis.for_epoch(epoch)
        update = self.follower.scenarios_since(cursor.epoch, cursor.n_scenarios)
        if update is None or cursor.layout_revision != current.layout_revision:
            return Cursor(epoch, len(digests), current.revision, current.layout_revision), "contents", None
        new_digests, state = update
        if new_digests and meta is not None:
            courses = {
                name: [_round_course(digest.courses.get(name)) for digest in new_digests] for name in meta.metrics
            }
            spans = [digest.time_span for digest in new_digests]
            progress = None if state is None else asdict(state)
            columns = scenario_columns(meta, new_digests) | {"courses": courses, "spans": spans, "state": progress}
            return (
                Cursor(epoch, cursor.n_scenarios + len(new_digests), cursor.analysis_revision, cursor.layout_revision),
                "scenarios",
                columns,
            )
        if cursor.analysis_revision != current.revision:
            parts = {name: value for name, value in current.parts.items() if name not in _SEPARATE_KEYS}
            return Cursor(epoch, cursor.n_scenarios, current.revision, current.layout_revision), "knowledge", parts
        if state is not None and asdict(state) != last_state:
            return cursor, "state", asdict(state)
        return None

    def event_writer(self, cursor: Cursor) -> Callable[[], Iterator[str]]:
        """Return a function that yields, as text, all server-sent events that are new since its previous call."""
        shown_state: dict[str, Any] | None = None
        shown_notes: dict[int, str] | None = None

        def write() -> Iterator[str]:
            nonlocal cursor, shown_state, shown_notes
            while (news := self.next_event(cursor, shown_state)) is not None:
                cursor, event, data = news
                if event == "state":
                    shown_state = data
                yield _format_event(event, data, str(cursor))
            if (notes := self.follower.notes) != shown_notes:
                shown_notes = notes
                yield _format_event("notes", notes)

        return write


def _format_event(name: str, data: Any, event_id: str | None = None) -> str:
    first = "" if event_id is None else f"id: {event_id}\n"
    return f"{first}event: {name}\ndata: {json.dumps(data, separators=(',', ':'))}\n\n"


def _round_course(course: Any) -> list[float] | None:
    return None if course is None else [float(f"{value:.6g}") for value in course]


def _initial_contents(meta: StudyMeta, path: Path) -> dict[str, Any]:
    """Return the contents of the live page before any analysis: facts about the study, and empty results."""
    criterion = Objective.from_study_meta(meta).criterion
    critical = None if criterion is None else asdict(criterion)
    influential = list(range(len(meta.space.parameters)))
    return study_info_payload(meta, path.name) | {
        "about": meta.roles_text, "critical": critical, "default_aspect": None, "influential": influential,
        "outcomes": [], "culprits": [], "answers": [], "captions": {}, "recordings_left_out": "",
        "roads": None, "roads_missing": "", "rerun": None, "details": [], "provenance": "", "kept": {}, "kinds": {},
        "most_critical": {},
    }  # fmt: skip


def _add_analysis(contents: dict[str, Any], analysis: PageAnalysis) -> None:
    """Fill in the columns of `contents` that depend on an analysis or a reduced set: outcomes, tests, clusters."""
    columns, outcomes = contents["scenarios"], contents["outcomes"]
    ids = columns["id"]
    indices = {outcome: k for k, outcome in enumerate(outcomes)}
    columns["outcome"] = [indices.get(analysis.outcomes.get(scenario, "")) for scenario in ids]
    columns["kept"] = [int(str(scenario) in contents["kept"]) for scenario in ids]
    contents["kinds"] = {
        name: clusters
        | {
            "labels": [clusters["labels"].get(scenario) for scenario in ids],
            "embedding": [[column.get(scenario) for scenario in ids] for column in clusters["embedding"]],
        }
        for name, clusters in contents["kinds"].items()
    }
