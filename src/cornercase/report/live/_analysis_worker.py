"""Background thread that computes the analysis shown on the live page again whenever the study changes."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase.report._report_data import ReportData, read_report_data
from cornercase.report._report_page import render_details
from cornercase.report._report_payload import scenario_table_payload, whole_study_payload
from cornercase.report._rerun import rerun_payload
from cornercase.report._road_drawing import encode_road_outline, find_road_outline, is_missing_map
from cornercase.report.html._overview_sections import render_provenance
from cornercase.report.live._follower import StudyFollower
from cornercase.report.text._answers import describe_study
from cornercase.roads._outline import Region
from cornercase.study import StudyFile

# Pause between two computations: at least this many seconds, and this many times the computation time.
_MIN_INTERVAL: Final = 3.0
_INTERVAL_FACTOR: Final = 4.0
# Seconds between two polls for changes.
_POLL_SECONDS: Final = 0.25
# Parts whose change makes the browser reload all contents.
_LAYOUT_KEYS: Final = ("kinds", "kept", "outcomes", "roads", "rerun", "default_aspect")

# Additional margin in m, so that the road is not redrawn for each scenario.
_EXTRA_MARGIN: Final = 60.0


@dataclass(frozen=True)
class PageAnalysis:
    """Analysis (results from all scenarios together) of the live page at one moment."""

    epoch: str = ""  # identifier of the study (`StudyFollower.epoch`); empty without a study
    revision: int = 0  # grows with each change
    layout_revision: int = 0  # grows with each change of the endings or of a part in `_LAYOUT_KEYS`
    parts: dict[str, Any] = field(default_factory=dict)  # page contents with detail sections as HTML; empty at first
    outcomes: dict[int, str] = field(default_factory=dict)  # endings by id

    def for_epoch(self, epoch: str) -> PageAnalysis:
        """Return this analysis if it belongs to the study with the identifier `epoch`, else an empty analysis."""
        return self if self.epoch == epoch else PageAnalysis(epoch, self.revision, self.layout_revision)


class RoadDrawingCache:
    """Cache for the drawing of the road, redrawn if it is missing, if scenarios leave it, or for another scenario."""

    def __init__(self, scenario: Path | None) -> None:
        self._scenario = scenario
        self._fingerprint = ""
        self._region: Region | None = None
        self._roads: dict[str, Any] = {}
        self._warned: set[str] = set()

    def road_and_rerun_payload(self, study: StudyFile, data: ReportData) -> dict[str, Any]:
        """Return the drawing of the road and the commands to run scenarios again, as JSON values for the page."""
        new, old = data.region, self._region
        is_known = study.meta.fingerprint == self._fingerprint and bool(self._roads.get("roads"))
        if not is_known or not _contains_region(old, new):
            region = (
                None
                if new is None
                else (new[0] - _EXTRA_MARGIN, new[1] - _EXTRA_MARGIN, new[2] + _EXTRA_MARGIN, new[3] + _EXTRA_MARGIN)
            )
            sketch, missing = find_road_outline(study, region, self._scenario, data.rows[0].values)
            self._roads = {"roads": None if sketch is None else encode_road_outline(sketch), "roads_missing": missing}
            if is_missing_map(missing) and missing not in self._warned:
                self._warned.add(missing)
                issue_notice_warning(missing.removesuffix("."))
            self._fingerprint, self._region = study.meta.fingerprint, region
        return self._roads | {"rerun": rerun_payload(study, self._scenario, include_file=False)}


def _contains_region(outer: Region | None, inner: Region | None) -> bool:
    if outer is None or inner is None:
        return inner is None
    return outer[0] <= inner[0] and outer[1] <= inner[1] and outer[2] >= inner[2] and outer[3] >= inner[3]


class AnalysisWorker:
    """Thread that computes the analysis of a study again whenever the study changes, with pauses in between.

    `latest` is the last result. It never contains more scenarios than the `StudyFollower`, another thread, has read.
    """

    def __init__(self, follower: StudyFollower, scenario: Path | None = None) -> None:
        self.latest = PageAnalysis()
        self._follower = follower
        self._road_and_rerun = RoadDrawingCache(scenario)
        self._stop_event = threading.Event()
        self._thread = threading.Thread(target=self._run, name="finder of knowledge", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Tell the thread to stop, without waiting for the current computation."""
        self._stop_event.set()

    def _run(self) -> None:
        last_change: tuple[str, int] | None = None
        while not self._stop_event.wait(_POLL_SECONDS):
            change = (self._follower.epoch, self._follower.n_changes)
            if change == last_change or not self._follower.state.run:
                continue
            start = time.monotonic()
            # A study that cannot be read now may be complete the next time.
            with suppress(InputError):
                result = _analyze_study(self._follower.path, self._road_and_rerun)
                if result is not None and self._wait_for_follower(change[0], result[0]["known_of"]):
                    self._publish(change[0], *result)
                last_change = change
            self._stop_event.wait(max(_MIN_INTERVAL, _INTERVAL_FACTOR * (time.monotonic() - start)))

    def _wait_for_follower(self, epoch: str, n_scenarios: int) -> bool:
        """Wait until the `StudyFollower` has read `n_scenarios`; False if the study is replaced or the worker stops."""
        while self._follower.epoch == epoch and not self._stop_event.is_set():
            if self._follower.state.ended >= n_scenarios:
                return True
            self._stop_event.wait(_POLL_SECONDS)
        return False

    def _publish(self, epoch: str, parts: dict[str, Any], outcomes: dict[int, str]) -> None:
        old = self.latest
        has_same_layout = (
            old.epoch == epoch
            and old.outcomes == outcomes
            and all(old.parts.get(name) == parts[name] for name in _LAYOUT_KEYS)
        )
        if not has_same_layout or old.parts != parts:
            self.latest = PageAnalysis(
                epoch, old.revision + 1, old.layout_revision + (not has_same_layout), parts, outcomes
            )


def _key_clusters_by_id(clusters: dict[str, Any], ids: list[int]) -> dict[str, Any]:
    """Key labels and embedding by scenario id: the page may load them later, when the study has more rows."""
    assigned = [k for k, label in enumerate(clusters["labels"]) if label is not None]
    return clusters | {
        "labels": {ids[k]: clusters["labels"][k] for k in assigned},
        "embedding": [{ids[k]: column[k] for k in assigned} for column in clusters["embedding"]],
    }


def _analyze_study(path: Path, road_cache: RoadDrawingCache) -> tuple[dict[str, Any], dict[int, str]] | None:
    # The explorer continues to write; its write-ahead log grows during this snapshot.
    with StudyFile.open(path, readonly=True) as study, study.snapshot():
        if not study.finished_rows():
            return None
        data = read_report_data(study)
        road_and_rerun = road_cache.road_and_rerun_payload(study, data)
    parts, scenarios = whole_study_payload(data) | road_and_rerun, scenario_table_payload(data)
    ids, outcome_names = scenarios["scenarios"]["id"], scenarios["outcomes"]
    indices = zip(ids, scenarios["scenarios"]["outcome"], strict=True)
    outcomes = {scenario: outcome_names[index] for scenario, index in indices if index is not None}
    parts["kinds"] = {name: _key_clusters_by_id(clusters, ids) for name, clusters in parts["kinds"].items()}
    parts["outcomes"] = outcome_names
    parts["known_of"] = len(ids)
    # The page counts its scenarios itself, as they come.
    parts["about"] = describe_study(data, include_counts=False)
    parts["details"] = [
        {"name": section.name, "title": section.title, "html": str(section.html)} for section in render_details(data)
    ]
    parts["provenance"] = str(render_provenance(data.file_name, data.summary))
    return parts, outcomes
