"""Answers of the page: where collisions lie, what was held fixed, and what to do next."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

import cornercase as cc
from cornercase.evidence import Estimate
from cornercase.report._near_misses import ClosestApproach, find_closest_approach
from cornercase.report._report_data import read_report_data
from cornercase.report.text._answers import page_answers
from cornercase.report.text._phrases import describe_dangers, format_range
from cornercase.report.text._what_next import describe_next_steps_after_suite
from cornercase.study import StudyFile
from cornercase.suite import Verdict


def answer(data, name):
    return next(one for one in page_answers(data) if one.name == name)


@pytest.fixture(scope="module")
def crossing(tmp_path_factory, x_intersection):
    """A study with collisions, whose scenario file lies beside it."""
    path = tmp_path_factory.mktemp("crossing") / "s.db"
    cc.explore(
        x_intersection,
        path,
        ego="Ego",
        other="Pedestrian",
        metrics=["wttc"],
        critical=0.2,
        optimizer="sobol",
        budget=80,
    )
    with StudyFile.open(path, readonly=True) as study:
        return read_report_data(study)


def test_what_to_drive_on_the_track_lies_beside_a_collision(crossing):
    told = answer(crossing, "next")
    colliding = {row.id for row in crossing.rows if crossing.entities_hit[row.id]}
    pairs = [re.fullmatch(r"Scenario (\d+): .*; it collides in scenario (\d+), with .*\.", one) for one in told.points]
    found = [(int(one[1]), int(one[2])) for one in pairs if one]
    assert 3 <= len(found) <= 5
    assert all(safe not in colliding and hit in colliding for safe, hit in found)
    (hardest,) = re.findall(r"hardest in scenario (\d+)", answer(crossing, "collisions").text)
    assert told.text.startswith(f"Give scenario {hardest}, the hardest collision, to the developer")
    assert all(f"scenario {safe}" in told.text for safe, _ in found)
    assert f"--ids {hardest}" in told.points[0]
    assert "--one-page" in told.points[1]


def test_a_collision_with_an_entity_that_is_not_measured_is_none_of_the_answers(tmp_path, x_intersection):
    cc.explore(
        x_intersection, tmp_path / "s.db", ego="Ego", other="Truck", metrics=["wttc"], optimizer="sobol", budget=32
    )
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        data = read_report_data(study, charts=False)
    assert data.summary.unmeasured_collisions.keys() == {"Pedestrian"}
    assert answer(data, "collisions").text.startswith("No: Ego touches Truck in none of the 32 scenarios.")
    assert data.summary.faults == {}
    assert "collision, to the developer" not in answer(data, "next").text


def test_a_critical_scenario_with_an_inconclusive_verdict_did_not_pass(crossing):
    critical = [row.id for row, is_critical in zip(crossing.rows, crossing.is_critical, strict=True) if is_critical]
    verdicts = {row.id: [Verdict("passed", "no collision", "")] for row in crossing.rows}
    verdicts[critical[0]] = [Verdict("inconclusive", "no collision", "")]
    text, points = describe_next_steps_after_suite(replace(crossing, verdicts=verdicts))
    passed = len(critical) - 1
    assert text == f"Give the developer {passed} that passed but are critical and 1 that is critical but inconclusive."
    assert f"scenario {critical[1]}, " in points[-1]


def test_no_scenario_of_none_is_critical():
    assert describe_dangers(0, 0, 0, "Ego") == "None of them is critical and in none Ego collides."


def test_the_ranges_and_what_was_held_fixed_stand_beside_what_is_missed(crossing):
    searched, fixed, *_ = answer(crossing, "missed").points
    assert all(f"{one.name} {format_range(one)}" in searched for one in crossing.parameters)
    assert "Pedestrian as the file says, simulator builtin with a time step of 0.05 s" in fixed


def test_the_range_in_which_all_collisions_lie_is_told_rounded_outwards(crossing):
    parameter = crossing.parameters[0]
    limit = parameter.low + 0.7 * (parameter.high - parameter.low)
    hits = crossing.values[:, 0] > limit
    assert hits.sum() > 10
    touched = {row.id: frozenset(["Pedestrian"] * bool(hit)) for row, hit in zip(crossing.rows, hits, strict=True)}
    text = " ".join(answer(replace(crossing, entities_hit=touched), "parameters").points)
    ((count, low),) = re.findall(
        rf"All (\d+) collisions that were found have {parameter.name} from ([\d.]+) m up, of", text
    )
    assert int(count) == hits.sum()
    assert limit - 1.0 < float(low) <= crossing.values[hits, 0].min()
    # Neither do the other parameters differ, nor a few scenarios say anything.
    assert text.count("collisions that were found have") == 1
    few = {row.id: frozenset(["Pedestrian"] * (k < 2)) for k, row in enumerate(crossing.rows)}
    assert "collisions that were found have" not in " ".join(
        answer(replace(crossing, entities_hit=few), "parameters").points
    )


def test_a_share_that_rounds_to_all_is_not_said_to_be_missed_beside_what_was_found(crossing):
    whole = Estimate(1.0, 1.0, 1.0)
    critical = crossing.summary.estimates.critical
    critical = replace(critical, critical_set=replace(critical.critical_set, missed_fraction=whole))
    summary = replace(crossing.summary, estimates=replace(crossing.summary.estimates, critical=critical))
    text = answer(replace(crossing, summary=summary), "missed").text
    assert "100 %" not in text.partition(". ")[0]
    assert f"even around the {critical.n_critical} that were found" in text


def test_an_entity_that_is_nearest_where_it_was_placed_is_no_near_miss():
    placed = {"nearest": 1.4, "nearest time": 0.0}
    passed = {"nearest": 2.5, "nearest time": 3.0}
    assert find_closest_approach([placed], ["Van"], 0.0) is None
    assert find_closest_approach([placed, passed], ["Van", "Car"], 0.0) == ClosestApproach("Car", 2.5, 3.0)
