"""Pairs of old and new scenarios that a comparison page replays, and the instants that show their differences."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
from markupsafe import Markup, escape

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.recordings._compact_encoding import encode_rounded
from cornercase.report._event_payload import find_events_of_scenario
from cornercase.study import StudyFile
from cornercase.suite import Comparison, ScenarioPair

MAX_CHARACTERS: Final = 8_000_000
"""Size beyond which recordings are left out; the examples and the scenarios that the verdict names come first."""
# Distance in m between the positions of an entity in both runs from which the runs count as different.
_MIN_DISTANCE: Final = 0.1
# Number of scenarios that a list names; the rest is hidden until the user opens it.
_MAX_SHOWN: Final = 40
# A list of scenarios in a sentence, as "(4, 9→12 and 3 more)".
_LISTED: Final = re.compile(r"(?<=\()\d+(?:→\d+)?(?:, \d+(?:→\d+)?)*(?=\)| and \d+ more\))")

Ids: TypeAlias = tuple[int, int]


@dataclass
class ReplayedPairs:
    """Pairs of an old and a new scenario with recordings on a comparison page.

    Each scenario has a number of its own on the page, since both studies may use the same ids.
    """

    pairs: list[ScenarioPair] = field(default_factory=list)
    recordings: list[Recording] = field(default_factory=list)
    texts: dict[int, str] = field(default_factory=dict)  # encoded recordings by number
    events: dict[str, dict[str, Any]] = field(default_factory=dict)  # by number
    # Instant and sentence by number of the old scenario.
    differences: dict[str, dict[str, Any]] = field(default_factory=dict)
    # Number of the old scenario by ids of the pair; the new scenario has the next number.
    numbers_by_ids: dict[Ids, int] = field(default_factory=dict)
    n_left_out: int = 0

    def link(self, ids: Ids, text: str) -> Markup:
        """Render the name of a scenario as a link to its replay, or as text if the page has no recording."""
        number = self.numbers_by_ids.get(ids)
        if number is None:
            return escape(text)
        return Markup('<a class="pair-link" href="#pair={}" data-old="{}" title="Play scenario {}">{}</a>').format(
            ",".join(map(str, ids)), number, text, text
        )

    def link_all(self, all_ids: Sequence[Ids], limit: int = _MAX_SHOWN) -> Markup:
        """Render a list of scenarios as links to their replays; links after the first `limit` are hidden at first."""
        links = [self.link(ids, format_ids(ids)) for ids in all_ids]
        text = Markup(", ").join(links[:limit])
        if len(links) <= limit:
            return text
        return Markup("{} <details><summary>and {} more</summary>{}</details>").format(
            text, len(links) - limit, Markup(", ").join(links[limit:])
        )

    def link_sentence(self, sentence: str) -> Markup:
        """Escape a sentence as HTML, and link scenario ids in brackets to the replays."""
        by_name = {format_ids(pair.ids): pair.ids for pair in self.pairs}

        def link_list(match: re.Match[str]) -> str:
            names = match[0].split(", ")
            return str(Markup(", ").join(self.link(by_name.get(name, (0, 0)), name) for name in names))

        return Markup(_LISTED.sub(link_list, str(escape(sentence))))


def read_replayed_pairs(
    comparison: Comparison, old: StudyFile, new: StudyFile, max_characters: int = MAX_CHARACTERS
) -> ReplayedPairs:
    """Read the recordings of pairs of scenarios that differ, most important first, up to about `max_characters`."""
    replayed, size = ReplayedPairs(), 0
    for pair in _order_pairs(comparison):
        if size > max_characters:
            replayed.n_left_out += 1
            continue
        number = 2 * len(replayed.pairs) + 1
        recordings: list[Recording | None] = []
        for offset, study, scenario, ran in zip((0, 1), (old, new), pair.ids, _ran(pair), strict=True):
            recordings.append(study.recording(scenario) if ran else None)
            if (recording := recordings[-1]) is not None:
                packed = encode_rounded(recording, _read_courses(study, scenario, comparison))
                text = base64.b64encode(packed).decode()
                replayed.texts[number + offset] = text
                replayed.events[str(number + offset)] = find_events_of_scenario(study, scenario, recording)
                replayed.recordings.append(recording)
                size += len(text)
        replayed.pairs.append(pair)
        replayed.numbers_by_ids[pair.ids] = number
        replayed.differences[str(number)] = _describe_difference(
            pair, recordings[0], recordings[1], old.meta.ego, comparison.metrics
        )
    return replayed


def _order_pairs(comparison: Comparison) -> Iterator[ScenarioPair]:
    """Yield the pairs of scenarios that differ, without repetition, the most important pairs first.

    The examples of the comparison come first, then pairs that the verdict names, then the others.
    """
    by_ids = {pair.ids: pair for pair in comparison.pairs}
    named = [ids for finding in (*comparison.worse, *comparison.better) for ids in finding.ids]
    differing = [pair.ids for pair in comparison.pairs if pair.run in ("otherwise", "not in one", "within rounding")]
    examples = [example.pair.ids for example in comparison.examples]
    for ids in dict.fromkeys((*examples, *named, *differing)):
        if any(_ran(by_ids[ids])):
            yield by_ids[ids]


def _ran(pair: ScenarioPair) -> tuple[bool, bool]:
    return (True, True) if pair.both_ran else (pair.errors[0] is None, pair.errors[1] is None)


def _read_courses(study: StudyFile, scenario: int, comparison: Comparison) -> dict[str, FloatArray]:
    names = [score.metric for score in comparison.scores]
    return {name: comparison.metrics[name].clip_course(study.course(scenario, name)) for name in names}


def _describe_difference(
    pair: ScenarioPair, old: Recording | None, new: Recording | None, ego: str, metrics: Mapping[str, Any]
) -> dict[str, Any]:
    """Return which run and instant the replay shows first, and a sentence on the difference of a pair.

    The side is 0 for the old run and 1 for the new run. If the ego collides in only one version, the instant is the
    time of its first collision. Else no instant is returned, and the replay shows the most critical instant of the more
    critical version, or of the old version if no score changed.
    """
    if old is None or new is None:
        return {"side": 0 if new is None else 1, "text": "One version only could run it."}
    part = _find_divergence_time(old, new)
    parting = "Both runs are alike." if part is None else f"Both runs part at {part:.4g} s, by more than 0.1 m."
    if pair.collides[0] != pair.collides[1]:
        side = int(pair.collides[1])
        version, other = (("old", "new"), ("new", "old"))[side]
        collision = next(item for item in (old, new)[side].collisions if ego in item.entities)
        fault = f", {pair.faults[side]}" if pair.faults[side] else ""
        return {
            "side": side,
            "time": round(collision.time, 3),
            "text": f"{parting} Shown is {collision.time:.4g} s, when the {version} version collides{fault}; the"
            f" {other} one does not.",
        }
    shown = f"{parting} Shown is the most critical instant of the"
    changed = next((name for name, (before, after) in pair.scores.items() if before != after), None)
    if changed is None:
        return {"side": 0, "text": f"{shown} old version; the new one has the same scores."}
    before, after = map(metrics[changed].to_minimize, pair.scores[changed])
    side = int(after < before)
    return {"side": side, "text": f"{shown} {('old', 'new')[side]} version, which is the more critical."}


def _find_divergence_time(old: Recording, new: Recording) -> float | None:
    """Return the first time in s at which the positions of an entity differ by more than 0.1 m; None if never."""
    names = [name for name in old.names if name in new.names]
    end = min(old.time[-1], new.time[-1])
    times = old.time[old.time <= end]
    distances = np.zeros(len(times))
    for name in names:
        i, j = old.entity_index(name), new.entity_index(name)
        steps = [
            np.interp(times, new.time, getattr(new, axis)[j]) - getattr(old, axis)[i, : len(times)]
            for axis in ("x", "y")
        ]
        distances = np.fmax(distances, np.hypot(*steps))
    indices = np.flatnonzero(distances > _MIN_DISTANCE)
    return float(times[indices[0]]) if len(indices) else None


def format_ids(ids: Ids) -> str:
    """Return the ids of a scenario in both studies as text: ``"4"``, or ``"4→7"`` if both ids differ."""
    return str(ids[0]) if ids[0] == ids[1] else f"{ids[0]}→{ids[1]}"
