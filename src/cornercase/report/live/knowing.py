"""Background worker that recomputes the analysis part of the live page."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.ledger import warn
from cornercase.report.answers import tell_about
from cornercase.report.contents import knowledge_part, scenario_part
from cornercase.report.data import ReportData, read_report_data
from cornercase.report.live.follower import Follower
from cornercase.report.page import page_details
from cornercase.report.rerun import tell_rerun
from cornercase.report.roads import find_roads, is_of_map, pack_roads
from cornercase.report.sections.overview import tell_provenance
from cornercase.roads import Region
from cornercase.study import Study

# Pause between two computations: at least this many seconds, and this many times the computation time.
_LEAST: Final = 3.0
_TIMES: Final = 4.0
# Seconds between two polls for changes.
_PAUSE: Final = 0.25
# Parts whose change makes the browser reload all contents.
_COLUMNS: Final = ("kinds", "kept", "outcomes", "roads", "rerun", "default_aspect")

# Additional margin in m, so that the road is not redrawn for each scenario.
_MORE: Final = 60.0


@dataclass(frozen=True)
class Knowledge:
    """Analysis part of the page at one moment."""

    epoch: str = ""  # study, as `StudyFollower.epoch`; empty for none
    number: int = 0  # grows with each change
    layout: int = 0  # grows with each change of clusters, outcomes or the reduced set
    parts: dict[str, Any] = field(default_factory=dict)  # study payload with the HTML of the details; empty at first
    outcomes: dict[int, str] = field(default_factory=dict)  # endings by id

    def of(self, epoch: str) -> Knowledge:
        """Return this analysis if it belongs to `epoch`, else an empty one."""
        return self if self.epoch == epoch else Knowledge(epoch, self.number, self.layout)


class Surroundings:
    """Caches the road drawing and redraws it only if scenarios leave the drawn region."""

    def __init__(self, scenario: Path | None) -> None:
        self._scenario = scenario
        self._fingerprint = ""
        self._region: Region | None = None
        self._roads: dict[str, Any] = {}
        self._said: set[str] = set()

    def of(self, study: Study, data: ReportData) -> dict[str, Any]:
        """Return ``roads``, ``roads_missing`` and ``rerun`` of the page's contents."""
        new, old = data.region, self._region
        is_known = study.meta.fingerprint == self._fingerprint and bool(self._roads.get("roads"))
        if not is_known or not _holds(old, new):
            region = None if new is None else (new[0] - _MORE, new[1] - _MORE, new[2] + _MORE, new[3] + _MORE)
            sketch, missing = find_roads(study, region, self._scenario, data.rows[0].values)
            self._roads = {"roads": None if sketch is None else pack_roads(sketch), "roads_missing": missing}
            if is_of_map(missing) and missing not in self._said:
                self._said.add(missing)
                warn(missing.removesuffix("."))
            self._fingerprint, self._region = study.meta.fingerprint, region
        return self._roads | {"rerun": tell_rerun(study, self._scenario, whole=False)}


def _holds(old: Region | None, new: Region | None) -> bool:
    if old is None or new is None:
        return new is None
    return old[0] <= new[0] and old[1] <= new[1] and old[2] >= new[2] and old[3] >= new[3]


class Finder:
    """Recomputes the analysis in a thread whenever the study changes, but never most of the time.

    `latest` holds the last result, which never covers more scenarios than the follower has read.
    """

    def __init__(self, follower: Follower, scenario: Path | None = None) -> None:
        self.known = Knowledge()
        self._follower = follower
        self._surroundings = Surroundings(scenario)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._find_always, name="finder of knowledge", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop without waiting for the current computation."""
        self._end.set()

    def _find_always(self) -> None:
        last_change: tuple[str, int] | None = None
        while not self._end.wait(_PAUSE):
            change = (self._follower.epoch, self._follower.changes)
            if change == last_change or not self._follower.state.run:
                continue
            start = time.monotonic()
            # A study that cannot be read now may be complete the next time.
            with suppress(InputError):
                result = _find(self._follower.path, self._surroundings)
                if result is not None and self._is_followed(change[0], result[0]["known_of"]):
                    self._take(change[0], *result)
            last_change = change
            self._end.wait(max(_LEAST, _TIMES * (time.monotonic() - start)))

    def _is_followed(self, epoch: str, count: int) -> bool:
        """Wait until the follower has read `n_scenarios`; False if it never will."""
        while self._follower.epoch == epoch and not self._end.is_set():
            if self._follower.state.ended >= count:
                return True
            self._end.wait(_PAUSE)
        return False

    def _take(self, epoch: str, parts: dict[str, Any], outcomes: dict[int, str]) -> None:
        old = self.known
        has_same_layout = (
            old.epoch == epoch
            and old.outcomes == outcomes
            and all(old.parts.get(name) == parts[name] for name in _COLUMNS)
        )
        if not has_same_layout or old.parts != parts:
            self.known = Knowledge(epoch, old.number + 1, old.layout + (not has_same_layout), parts, outcomes)


def _by_id(kinds: dict[str, Any], ids: list[int]) -> dict[str, Any]:
    """Key the clusters by scenario id, as rows may have been added when the page asks."""
    assigned = [k for k, label in enumerate(kinds["labels"]) if label is not None]
    return kinds | {
        "labels": {ids[k]: kinds["labels"][k] for k in assigned},
        "embedding": [{ids[k]: column[k] for k in assigned} for column in kinds["embedding"]],
    }


def _find(path: Path, surroundings: Surroundings) -> tuple[dict[str, Any], dict[int, str]] | None:
    # The explorer continues to write; its write-ahead log grows during this snapshot.
    with Study.open(path, readonly=True) as study, study.snapshot():
        if not study.done():
            return None
        data = read_report_data(study)
        road_and_rerun = surroundings.of(study, data)
    parts, scenarios = knowledge_part(data) | road_and_rerun, scenario_part(data)
    ids, outcome_names = scenarios["scenarios"]["id"], scenarios["outcomes"]
    indices = zip(ids, scenarios["scenarios"]["outcome"], strict=True)
    outcomes = {scenario: outcome_names[index] for scenario, index in indices if index is not None}
    parts["kinds"] = {name: _by_id(clusters, ids) for name, clusters in parts["kinds"].items()}
    parts["outcomes"] = outcome_names
    parts["known_of"] = len(ids)
    # The page counts its scenarios itself, as they come.
    parts["about"] = tell_about(data, counts=False)
    parts["details"] = [
        {"name": section.name, "title": section.title, "html": str(section.html)} for section in page_details(data)
    ]
    parts["provenance"] = str(tell_provenance(data.study, data.summary))
    return parts, outcomes
