"""What changed between two versions, in the sentences at the top of the command's output and of the page."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import cornercase as cc
from cornercase.cli import app
from cornercase.drivers import NORMAL, BehaviourDriver
from cornercase.optimizers import Sobol
from cornercase.recordings import Collision, Recording
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile
from cornercase.suite.compare._change_sentences import describe_changes, describe_unpaired_scenarios, describe_verdict
from helpers.synthetic_study import about

SPACE = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])
POINTS = Sobol().start(SPACE, 1).ask(40)
GAPS = 1.5 + 3.0 * POINTS[:, 0]


def recording(gap: float, hit: bool) -> Recording:
    """An ego that drives towards a car that stands so far away."""
    still, one = np.zeros((2, 3)), np.full(2, 1.0)
    return Recording(
        time=np.arange(3.0), names=("Ego", "B"), object_types=("car", "car"),
        x=np.stack([np.arange(3.0), np.full(3, gap + 3.0)]), y=still, heading=still,
        speed=np.stack([np.ones(3), np.zeros(3)]), acceleration=still,
        length=one, width=one, center_x=0.0 * one, collisions=(Collision(1.0, ("Ego", "B")),) if hit else (),
    )  # fmt: skip


def written(path, gaps, hits=(), points=POINTS, **more):
    meta = about(
        SPACE, "distance", **({"critical": 1.0, "simulator": "builtin", "optimizer": "sobol", "seed": 1} | more)
    )
    with StudyFile.create(path, meta) as study:
        for k, row in enumerate(study.writer.add_pending(1, points, SPACE.values(points))):
            gap = float(gaps[k])
            study.writer.record_result(row.id, recording(gap, k in hits), {"distance": (np.full(3, gap), gap)})
    return path


def compared(*studies) -> Any:
    """What is optional in a comparison is there where a test looks at it."""
    return cc.compare(*studies)


def changes_of(found) -> str:
    return "\n".join(describe_changes(found))


def test_collisions_come_first_with_their_scenarios_and_whose_fault_they_are(tmp_path):
    old = written(tmp_path / "old.db", GAPS, hits={3, 4})
    new = written(tmp_path / "new.db", GAPS, hits={4, 7})
    found = compared(old, new)
    first, *_ = describe_changes(found)
    assert first.startswith("Collisions: 1 new (8)")
    assert "1 gone (4)" in first
    assert first.endswith("of 40 scenarios that ran with both, 1 collides in both versions.")
    faults = {pair.ids[0]: pair.faults for pair in found.pairs if any(pair.collides)}
    assert set(faults) == {4, 5, 8}
    with StudyFile.open(new) as study:
        fault = study.digest(8).outcomes[0].fault
    assert fault is not None
    assert faults[8] == ("", fault.describe("Ego", "B"))
    assert f"1 new (8), {faults[8][1]}; 1 gone (4), {faults[4][0]}" in first
    assert describe_changes(compared(old, old))[0].startswith("Collisions: none is new and none is gone; of 40 ")


def test_the_change_of_the_critical_share_has_an_interval_that_holds_both_ends(tmp_path):
    old = written(tmp_path / "old.db", np.where(np.arange(40) < 20, 0.5, 3.0))
    new = written(tmp_path / "new.db", np.where(np.arange(40) < 5, 0.5, 3.0))
    found = compared(old, new)
    share = describe_changes(found)[1]
    assert share.startswith(
        "Critical share of the space: 50.0 % before, 12.5 % now; change -37.5 percentage points (90 %"
    )
    assert "so it has shrunk; from 40 scenarios that fill the space and ran with both." in share
    change = found.space.change
    assert change.low < change.value < change.high < 0.0
    back = compared(new, old).space.change
    assert (back.low, back.high) == (pytest.approx(-change.high), pytest.approx(-change.low))
    same = compared(old, old)
    assert same.space.change.low < 0.0 < same.space.change.high
    assert "it may have grown or shrunk, or be the same" in describe_changes(same)[1]


def test_the_interval_of_a_change_is_right_in_nine_of_ten_studies():
    from cornercase.suite.compare._critical_region_change import _estimate_difference

    random = np.random.default_rng(3)
    held = 0
    for _ in range(300):
        both = random.choice(3, size=40, p=[0.7, 0.1, 0.2])
        change = _estimate_difference((int((both == 1).sum()), 40), (int((both == 2).sum()), 40))
        held += change.low <= -0.1 <= change.high
    assert held >= 270


def test_mcnemar_says_what_it_tests_how_often_and_what_follows(tmp_path):
    old = written(tmp_path / "old.db", GAPS, hits=range(12))
    many = compared(old, written(tmp_path / "many.db", GAPS, hits={20}))
    (line,) = [each for each in describe_changes(many) if each.startswith("McNemar")]
    assert "on 40 pairs, whether as many scenarios began to collide as collide no longer: 1 and 12; p = " in line
    assert line.endswith("after correction for 3 tests; more than chance.")
    few = compared(old, written(tmp_path / "few.db", GAPS, hits=range(11)))
    (line,) = [each for each in describe_changes(few) if each.startswith("McNemar")]
    assert line.endswith("0 and 1; p = 1, 1 after correction for 3 tests; that may be chance.")
    # Where no pair changed, there is nothing to test.
    assert "McNemar" not in changes_of(compared(old, old))


def test_scenarios_without_a_partner_are_counted_with_why_and_what_follows(tmp_path):
    old = written(tmp_path / "old.db", GAPS, hits={0, 39})
    new = written(tmp_path / "new.db", GAPS[:30], points=POINTS[:30])
    found = compared(old, new)
    assert found.n_unmatched == (10, 0)
    assert [(one.count, one.collisions) for one in found.unpaired] == [(10, 1), (0, 0)]
    text = "\n".join(describe_unpaired_scenarios(found))
    assert (
        "Without a partner: 10 of old.db (1 collide, none critical, none chosen by the scores of this version)" in text
    )
    assert "Why: one study ran scenarios that the other did not" in text
    assert "What follows: what changed in them is not known" in text
    assert "of new.db" not in text.splitlines()[0]
    assert list(describe_unpaired_scenarios(compared(old, old))) == []


def test_tests_of_scenarios_without_a_partner_are_not_hidden(tmp_path):
    others = Sobol().start(SPACE, 2).ask(40)
    old = written(tmp_path / "old.db", GAPS)
    new = written(tmp_path / "new.db", 1.5 + 3.0 * others[:, 0], hits=range(20), points=others, seed=2)
    found = compared(old, new)
    assert any(test.differ is None and test.corrected <= 0.05 for test in found.tests)
    (fisher,) = [line for line in describe_changes(found) if line.startswith("Fisher") and "collide" in line]
    assert "as many collide in both samples (" in fisher
    assert "scenarios that fill the space)" in fisher
    text = "\n".join(describe_unpaired_scenarios(found))
    assert "What follows: what changed in them is not known, and in the verdict only tests of samples" in text


@pytest.fixture(scope="module")
def searched(tmp_path_factory, x_intersection):
    """Two versions of the X-intersection by one search with the same seed; the old one has kinds."""
    folder, found = tmp_path_factory.mktemp("searched"), []
    for name, time in (("old", 0.5), ("new", 2.0)):
        found.append(folder / f"{name}.db")
        cc.explore(
            x_intersection, found[-1], ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="level-set",
            budget=50, seed=1, critical=0.2, drivers={"Ego": BehaviourDriver(NORMAL._replace(reaction_time=time))},
        )  # fmt: skip
    cc.analyze(found[0], ["interaction"])
    return found


@pytest.fixture(scope="module")
def found(searched):
    return compared(*searched)


def test_each_version_says_what_it_does_in_a_kind_that_is_named_after_the_old_one(searched, found):
    kinds = found.clusters[found.main_aspect]
    for side, name in enumerate(("old", "new")):
        assert sum(getattr(kind, name) for kind in kinds) == sum(
            sum(getattr(kind, f"{name}_outcomes").values()) for kind in kinds
        )
        told = {outcome for kind in kinds for outcome in getattr(kind, f"{name}_outcomes")}
        assert told == {pair.outcomes[side] for pair in found.pairs if pair.both_ran}
    result = CliRunner().invoke(app, ["compare", *map(str, searched)])
    assert "named by what they are in old.db; what they do with new.db may be something else" in result.stdout
    assert f"Kinds by {found.main_aspect}, by the names of old.db, among the pairs: " in result.stdout
    # What moved out of a kind or into one is named.
    for kind in kinds:
        assert len(kind.ids) >= abs(kind.new - kind.old)


def test_the_command_says_what_the_page_says_in_the_same_order(searched, found):
    result = CliRunner().invoke(app, ["compare", *map(str, searched)])
    places = [result.stdout.index(sentence) for sentence in describe_changes(found)]
    assert places == sorted(places)
    starts = [sentence.split()[0].rstrip(":") for sentence in describe_changes(found)]
    assert starts[:2] == ["Collisions", "Critical"]
    assert starts[-1] == "Kinds"
    assert "Why: a search goes where its own scores lead it" in result.stdout
    assert "cornercase reduce old.db -o suite" in result.stdout


@pytest.mark.parametrize("verdict", ["better", "worse", "mixed", "the same", "cannot say"])
def test_a_verdict_is_a_sentence(found, verdict):
    assert len(describe_verdict(replace(found, verdict=verdict)).split()) >= 4
