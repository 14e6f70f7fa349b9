"""Logical scenarios all the way: explored, analysed, reduced, run again as suites, and compared with a slower driver."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES, ROAD, car, moving, same_recording, scenario_file
from cornercase.metrics import METRICS
from cornercase.metrics._measure import evaluate_metrics
from cornercase.scenario import LogicalScenario
from cornercase.study import StudyFile

pytestmark = pytest.mark.filterwarnings("ignore::cornercase._common.errors.NoticeWarning")

REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"
NCAP = REFERENCE / "ncap" / "OpenSCENARIO" / "NCAP"
# All that vary something; the rest are single scenarios.
NCAP_FILES = sorted(
    [
        *NCAP.glob("CA-FC_2026/Variations/*Range/*.xosc"),
        *NCAP.glob("AEB_*_2023/Variations/*_Variation_2023.xosc"),
    ]
)
# Of UN Regulation No. 157; in the first scenario the ego is alone.
ALKS_FILES = sorted((REFERENCE / "alks" / "logical_scenarios").glob("alks_scenario_4_[2-6]*.xosc"))
ALKS_FILES += sorted((REFERENCE / "alks" / "logical_scenarios").glob("alks_scenario_4_1_[23]*.xosc"))
R157 = {
    "cut_in": ("ego_kmh=60:130", "other_kmh=20:60", "gap=20:70", "lateral_speed=0.4:1.5"),
    "cut_out": ("ego_kmh=60:130", "front_gap=20:80", "lateral_speed=0.5:2"),
    "deceleration": ("ego_kmh=60:130", "gap=20:60", "deceleration=0.3:1"),
}
OTHERS = ("Target", "VRU", "GVT", "TargetBlocking", "LeadVehicle", "SideVehicle", "CutInVehicle")
METRIC_NAMES = ("ttc", "clearance")
BOUNDS = {"ttc": 1.0, "clearance": 0.5}
REQUIRED = ["no collision", *(f"{name} > {bound}" for name, bound in BOUNDS.items())]
# Reacts later, and brakes less.
DRIVER, SLOWER = "normal", "normal:reaction_time=1.5,max_deceleration=4"
# m by which boxes have to overlap, or be apart, so that there is no doubt.
CLEARLY = 1e-3
# By which a score may differ and not count as moved.
ROUNDING = 1e-6
# By how much one may move and the versions still count as the same: m or s.
TOLERANCE = 0.1
VERDICTS = {(False, False): "the same", (True, False): "worse", (False, True): "better", (True, True): "mixed"}


def overlaps(recording, one, other):
    """By how many m the boxes of two overlap at most, along the axis along which they do least; below 0 apart."""
    a, b = (recording.names.index(name) for name in (one, other))
    places, corners = [], []
    for k in (a, b):
        heading = recording.heading[k]
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        beside = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        middle = np.stack([recording.x[k], recording.y[k]], axis=-1) + recording.center_x[k] * ahead
        half = ahead * recording.length[k] / 2, beside * recording.width[k] / 2
        corners.append(np.stack([middle + i * half[0] + j * half[1] for i in (-1, 1) for j in (-1, 1)], axis=1))
        places += [ahead, beside]
    depth = np.full(recording.time.shape, np.inf)
    for axis in places:
        low_high = [(p.min(axis=1), p.max(axis=1)) for p in (np.einsum("tcd,td->tc", c, axis) for c in corners)]
        depth = np.minimum(depth, np.minimum(low_high[0][1] - low_high[1][0], low_high[1][1] - low_high[0][0]))
    return float(np.nanmax(depth)) if np.isfinite(depth).any() else -math.inf


def touched(recording, ego):
    """Whether the ego touches another entity by positions; the collisions of the recording have to agree."""
    said = any(ego in hit.entities for hit in recording.collisions)
    depths = [overlaps(recording, ego, other) for other in recording.names if other != ego]
    if max(depths) > CLEARLY:
        assert said
    if max(depths) < -CLEARLY:
        assert not said
    return said


def expected_states(recording, ego, other):
    """What each requirement comes to, by the recording."""
    states = {"no collision": "failed" if touched(recording, ego) else "passed"}
    found = evaluate_metrics([METRICS.create(name) for name in METRIC_NAMES], recording, ego, other)
    for name, bound in BOUNDS.items():
        course = found[name].course
        known = course[np.isfinite(course)]
        verdict = "inconclusive" if np.isnan(course).all() else "passed"
        states[f"{name} > {bound}"] = "failed" if (known <= bound).any() else verdict
    return states


def read(path):
    """Of each scenario of a study its values, recording and scores, computed anew from the recording."""
    with StudyFile.open(path, readonly=True) as study:
        metrics = [METRICS.create(name) for name in METRIC_NAMES]
        rows = study.rows()
        assert [row.state for row in rows] == ["done"] * len(rows)
        found = {}
        for row in rows:
            recording = study.recording(row.id)
            made = evaluate_metrics(metrics, recording, study.meta.ego, study.meta.others)
            scores = {name: one.score for name, one in made.items()}
            assert scores == pytest.approx(study.scenario_scores(row.id), nan_ok=True)
            found[tuple(sorted(row.values.items()))] = (row.id, recording, scores)
        return found


def require_told(old, new, ego):
    """The comparison of two studies agrees with their recordings."""
    told = cc.compare(old, new)
    before, after = read(old), read(new)
    both = {one: (before[one], after[one]) for one in before if one in after}
    assert len(told.pairs) == len(both)
    assert told.n_unmatched == (len(before) - len(both), len(after) - len(both))
    for pair in told.pairs:
        (old_id, first, scores), (new_id, last, others) = both[tuple(sorted(pair.values.items()))]
        assert pair.ids == (old_id, new_id)
        assert (pair.run == "the same") == same_recording(first, last)
        assert pair.collides == (touched(first, ego), touched(last, ego))
        for name in METRIC_NAMES:
            assert pair.scores[name] == pytest.approx((scores[name], others[name]), nan_ok=True)
        if pair.verdicts[0]:
            whom = others_of(old)
            for verdicts, recording in zip(pair.verdicts, (first, last), strict=True):
                assert {one.requirement: one.state for one in verdicts} == expected_states(recording, ego, whom)
    for change in told.scores:
        moves = [b[2][change.metric] - a[2][change.metric] for a, b in both.values()]
        assert change.pairs == len(both)
        # A lower score of either metric is more critical.
        assert sum(one < -ROUNDING for one in moves) <= change.worse <= sum(one < 0 for one in moves)
        assert sum(one > ROUNDING for one in moves) <= change.better <= sum(one > 0 for one in moves)
    assert sum(told.outcomes.values()) == len(both)
    if both:
        ends = [(touched(a[1], ego), touched(b[1], ego)) for a, b in both.values()]
        moves = [b[2][name] - a[2][name] for a, b in both.values() for name in METRIC_NAMES]
        worse = (False, True) in ends or min(moves) < -TOLERANCE
        better = (True, False) in ends or max(moves) > TOLERANCE
        assert told.verdict == VERDICTS[worse, better], told.verdict_reason
    return told


def others_of(path):
    with StudyFile.open(path, readonly=True) as study:
        return study.meta.others


def require_suite(result, path, ego, other, origin=None):
    """Verdicts of a suite are what its recordings say; where nothing else drives, these are the ones it was made of."""
    with StudyFile.open(path, readonly=True) as study:
        for one in result.scenarios:
            recording = study.recording(one.id)
            assert {verdict.requirement: verdict.state for verdict in one.verdicts} == expected_states(
                recording, ego, other
            ), one.file
            states = [verdict.state for verdict in one.verdicts]
            assert one.state == next(state for state in ("failed", "inconclusive", "passed") if state in states)
            if origin is not None:
                assert one.difference is not None
                assert one.difference.same
                assert same_recording(recording, origin.recording(one.origin)), one.file
                assert dict(one.values) == dict(next(row.values for row in origin.rows() if row.id == one.origin))


def go_through(logical, folder, ego, other, size=6):
    """Explore, analyse, reduce, test and compare; gives a row of what came of it."""
    about = {"ego": ego, "other": other, "metrics": METRIC_NAMES, "budget": 30, "time_step": 0.1, "duration": 30.0}
    old, new, run, slow = (folder / f"{name}.db" for name in ("old", "new", "run", "slow"))
    cc.explore(logical, old, drivers={ego: DRIVER}, **about)
    cc.explore(logical, new, drivers={ego: SLOWER}, **about)
    cc.analyze(old)
    kept = cc.reduce(old, folder / "set", size=size, scenario=logical.scenario_file)
    tested = cc.run_suite(folder / "set", run, require=REQUIRED)
    slower = cc.run_suite(folder / "set", slow, require=REQUIRED, drivers={ego: SLOWER})
    with StudyFile.open(old, readonly=True) as study:
        require_suite(tested, run, ego, other, study)
        critical = int((study.scores("ttc") <= float(study.critical or 0.0)).sum())
        explored = len(study.rows())
    require_suite(slower, slow, ego, other)
    suites = require_told(run, slow, ego)
    verdicts = [[verdict for one in each.scenarios for verdict in one.verdicts] for each in (tested, slower)]
    assert suites.verdicts == Counter((a.requirement, a.state, b.state) for a, b in zip(*verdicts, strict=True))
    require_told(old, slow, ego)
    told = require_told(old, new, ego)
    ends = Counter(pair.collides for pair in told.pairs)
    return {
        "parameters": len([one for one in logical.space.parameters if one.size != 1]),
        "explored": explored,
        "critical": critical,
        "kept": len(kept.scenarios),
        "test": tested.summary,
        "slower": slower.summary,
        "pairs": len(told.pairs),
        "collides with the slower only": ends[False, True],
        "with the other only": ends[True, False],
        "worse": [one.worse for one in told.scores],
        "better": [one.better for one in told.scores],
        "verdict": told.verdict,
        "verdict of the suites": suites.verdict,
    }


SPACE = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<ParameterValueDistribution><ScenarioFile filepath="scenario.xosc"/><Deterministic>
<DeterministicMultiParameterDistribution><ValueSetDistribution>
<ParameterValueSet><ParameterAssignment parameterRef="Light" value="Sunny"/><ParameterAssignment parameterRef="Road"
value="road.xodr"/><ParameterAssignment parameterRef="Lane" value="-1"/></ParameterValueSet>
<ParameterValueSet><ParameterAssignment parameterRef="Light" value="Night"/><ParameterAssignment parameterRef="Road"
value="roads/narrow.xodr"/><ParameterAssignment parameterRef="Lane" value="-1"/></ParameterValueSet>
</ValueSetDistribution></DeterministicMultiParameterDistribution>
<DeterministicSingleParameterDistribution parameterName="speed"><DistributionRange stepWidth="2.5"><Range lowerLimit="10"
upperLimit="25"/></DistributionRange></DeterministicSingleParameterDistribution>
<DeterministicSingleParameterDistribution parameterName="count"><DistributionSet><Element value="2.0"/><Element value="3"/>
</DistributionSet></DeterministicSingleParameterDistribution>
</Deterministic></ParameterValueDistribution></OpenSCENARIO>"""


def declared(name, kind, value):
    return f'<ParameterDeclaration name="{name}" parameterType="{kind}" value="{value}"/>'


@pytest.fixture
def value_sets(tmp_path):
    """A car that comes to one at rest, on one of two roads, which a value set names."""
    kinds = {"Light": ("string", "Dusk"), "Road": ("string", "road.xodr"), "Lane": ("integer", "-1")}
    kinds |= {"speed": ("double", "10"), "count": ("integer", "2"), "gap": ("double", "${$speed * $count}")}
    path = scenario_file(
        tmp_path,
        init=moving("20", "$speed", lane="$Lane") + moving("${30 + $gap}", "0", "Other", "$Lane"),
        entities=car("Ego") + car("Other"),
        parameters="".join(declared(name, *one) for name, one in kinds.items()),
    )
    path.write_text(path.read_text().replace('filepath="road.xodr"', 'filepath="$Road"'))
    (tmp_path / "roads").mkdir()
    (tmp_path / "roads" / "narrow.xodr").write_text(ROAD.replace('a="4"', 'a="3"'))
    (tmp_path / "space.xosc").write_text(SPACE)
    return LogicalScenario.read(None, tmp_path / "space.xosc")


def test_42_2_a_suite_of_a_space_with_value_sets_is_run(value_sets, tmp_path):
    row = go_through(value_sets, tmp_path, "Ego", "Other")
    # All that there are; of them some end otherwise with a driver who reacts later.
    assert row["explored"] == row["pairs"] == 28
    assert row["collides with the slower only"] > 0 == row["with the other only"]
    assert 0 < row["critical"] < 28
    assert {one.name for one in (tmp_path / "set").glob("*.xodr")} == {"road.xodr", "narrow.xodr"}


def test_42_2_values_that_no_value_set_has_are_refused(value_sets, tmp_path):
    who: dict[str, Any] = {"ego": "Ego", "other": "Other", "metrics": ["clearance"]}
    cc.explore(value_sets, tmp_path / "s.db", duration=1.0, optimizer="sobol", budget=4, **who)
    cc.analyze(tmp_path / "s.db", "clearance")
    cc.reduce(tmp_path / "s.db", tmp_path / "set", size=1)
    place = tmp_path / "set" / "manifest.json"
    manifest = json.loads(place.read_text())
    first = manifest["scenarios"][0]
    own = first["values"]
    for wrong in ({"Light": "Dusk"}, {"Lane": "1"}, {"another": 1.0}):
        first["values"] = own | wrong
        place.write_text(json.dumps(manifest))
        with pytest.raises(cc.InputError, match=r"manifest\.json: the values of scenario-0000\d\.xosc do not fit its"):
            cc.run_suite(tmp_path / "set", tmp_path / "run.db")


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [*NCAP_FILES, *ALKS_FILES] or [pytest.param(REFERENCE, marks=pytest.mark.skip(reason="needs ../shared/reference"))],
    ids=lambda path: "/".join(path.parts[-2:]),
)
def test_42_2_every_published_logical_scenario_goes_all_the_way(path, tmp_path):
    logical = LogicalScenario.read(None, path)
    other = next(name for name in OTHERS if name in logical.scenario_file.entities)
    print(path.relative_to(REFERENCE), go_through(logical, tmp_path, "Ego", other))


@pytest.mark.slow
@pytest.mark.parametrize("name", R157)
def test_42_2_every_encounter_of_r157_goes_all_the_way(name, tmp_path):
    logical = LogicalScenario.read(EXAMPLES / "r157" / f"{name}.xosc", ranges=R157[name])
    row = go_through(logical, tmp_path, "Ego", "Other")
    print(name, row)
    assert row["explored"] == 30
    assert row["pairs"] > 0
