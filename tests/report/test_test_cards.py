"""Test cards: values on steps within their ranges, numbers of the recordings, and what rounding changes."""

from __future__ import annotations

import itertools
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES
from cornercase.report import write_test_cards
from cornercase.report.cards._card_contents import CardSource, make_card_values
from cornercase.report.cards._layout import CardTexts, choose_layout
from cornercase.report.cards._meeting import find_meeting
from cornercase.report.cards._movements import list_movements
from cornercase.report.cards._rounded_runs import RoundedRun, RoundedRunner, read_stored_run, reason_not_to_run
from cornercase.report.cards._rounding import count_roundings, iter_roundings
from cornercase.report.cards._settable_quantity import SettableQuantity, find_settable_quantity
from cornercase.report.cards._tolerances import find_tolerances
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._scenario_file import find_explored_scenario
from helpers.command_line import cornercase

X = EXAMPLES / "x_intersection"


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    """The X-intersection with values between the steps, reduced."""
    folder: Path = tmp_path_factory.mktemp("cards")
    shutil.copytree(X, folder / "scenario")
    path = folder / "study.db"
    logical = cc.LogicalScenario.read(folder / "scenario" / "x_intersection.xosc", X / "x_intersection.space.xosc")
    assert [parameter.unit for parameter in logical.space.parameters] == ["m", "s", "m/s"]
    continuous = replace(logical, space=logical.space.as_continuous())
    cc.explore(
        continuous, path, ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol", budget=64, critical=0.2
    )
    cc.analyze(path, ["wttc"])
    cc.reduce(path, folder / "reduced", size=6)
    return path


def cells(page: str, row: str) -> list[str]:
    """The cells of the first row of a table with this name."""
    found = re.search(rf"<tr><th scope=\"row\">{row}(?:<br>.*?)?</th>(.*?)</tr>", page)
    assert found, row
    return [unescape(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", found[1])]


def test_values_are_on_steps_and_within_their_ranges(study):
    with StudyFile.open(study) as opened:
        parameters = opened.space.parameters
        quantities = [find_settable_quantity(parameter, None) for parameter in parameters]
        units = [quantity.unit or "?" for quantity in quantities]
        for row in opened.finished_rows():
            roundings = list(iter_roundings(parameters, quantities, row.values))
            assert [rounding.distance for rounding in roundings] == sorted(rounding.distance for rounding in roundings)
            for rounding in roundings:
                for parameter, unit in zip(parameters, units, strict=True):
                    value = float(rounding.values[parameter.name])
                    assert parameter.low - 1e-9 <= value <= parameter.high + 1e-9
                    on_step = value * {"m": 10.0, "s": 10.0, "m/s": 3.6, "?": np.nan}[unit]
                    assert np.isnan(on_step) or on_step == pytest.approx(round(on_step), abs=1e-6)


def test_a_bound_that_is_on_no_step_is_not_passed():
    parameter = Parameter("speed", 5.0, 12.1, unit="m/s")
    (quantity,) = [find_settable_quantity(parameter, None)]
    (only,) = iter_roundings([parameter], [quantity], {"speed": 12.1})
    assert only.values["speed"] == pytest.approx(43 / 3.6)


@pytest.mark.parametrize(
    ("name", "unit", "low", "high", "expected"),
    [
        ("Ego_speed_kph", "", 10.0, 60.0, ("km/h", 1.0)),
        ("v", "m/s", 0.0, 20.0, ("m/s", 1 / 3.6)),
        ("lateral", "m/s", 0.8, 1.5, ("m/s", 0.1 / 3.6)),
        ("gap", "m", 0.0, 20.0, ("m", 0.1)),
        ("something", "", 0.0, 1.0, ("", None)),
        ("mu", "1", 0.0, 1.0, ("1", None)),
    ],
)
def test_what_a_parameter_measures(name, unit, low, high, expected):
    quantity = find_settable_quantity(Parameter(name, low, high, unit=unit), None)
    assert quantity.unit == expected[0]
    assert quantity.step == (None if expected[1] is None else pytest.approx(expected[1]))
    assert bool(quantity.note) == (expected[1] is None)


def test_a_unit_is_found_where_the_scenario_uses_the_parameter():
    scenario = ScenarioFile.read(X / "x_intersection.xosc")
    assert find_settable_quantity(Parameter("p1_speed", 1.0, 9.0), scenario).unit == "m/s"


def test_numbers_are_those_of_a_run_of_the_rounded_values(study, tmp_path):
    page_path = write_test_cards(study, tmp_path / "cards.html", ids=[3])
    page = page_path.read_text(encoding="utf-8")
    settings = {name: cells(page, name) for name in ("ego_start", "pedestrian_wait", "p1_speed")}
    numbers = {name: float(row[1].split()[0]) for name, row in settings.items()}
    assert settings["p1_speed"][1].split()[1] == "km/h"
    values = numbers | {"p1_speed": numbers["p1_speed"] / 3.6}
    run = cc.simulate(study.parent / "scenario" / "x_intersection.xosc", values)
    ego, other = run.entity_index("Ego"), run.entity_index("Pedestrian")

    speed, speed_tolerance, _, position, heading, _ = cells(page, "Ego")
    assert speed == f"{3.6 * run.speed[ego, 0]:.1f} km/h ({run.speed[ego, 0]:.2f} m/s)"
    assert speed_tolerance == "+1.0 / −0 km/h"
    assert position.replace("−", "-") == f"{run.x[ego, 0]:.1f}, {run.y[ego, 0]:.1f} m"
    assert heading.replace("−", "-") == f"{np.degrees(run.heading[ego, 0]):.1f}°"

    when = float(cells(page, "time of that")[1].split()[0])
    instant = int(np.argmin(np.abs(run.time - when)))
    for row, entity in (("speed of Ego", ego), ("speed of Pedestrian", other)):
        assert cells(page, row)[1].startswith(f"{3.6 * run.speed[entity, instant]:.1f} km/h")
    hit = run.first_collision("Ego", "Pedestrian")
    assert cells(page, "contact")[1] == ("none" if hit is None else "with Pedestrian")
    velocity = run.speed * np.exp(1j * run.heading)
    relative = abs(velocity[ego, instant] - velocity[other, instant])
    assert float(cells(page, "relative speed")[1].split()[0]) == pytest.approx(3.6 * relative, abs=0.06)


def test_the_closest_approach_is_that_of_the_boxes(study):
    with StudyFile.open(study) as opened:
        for row in opened.finished_rows()[:20]:
            recording = opened.recording(row.id)
            meeting = find_meeting(recording, "Ego", ("Pedestrian",))
            hits = [hit for hit in recording.collisions if set(hit.entities) == {"Ego", "Pedestrian"}]
            assert meeting.collides == bool(hits)
            if hits:
                assert meeting.time == hits[0].time
            else:
                ends = recording.box_center("Ego") - recording.box_center("Pedestrian")
                reach = np.hypot(recording.length, recording.width).max()
                assert meeting.gap <= np.hypot(*ends.T).min()
                assert meeting.gap >= np.hypot(*ends.T).min() - reach


def test_a_rounding_that_keeps_the_outcome_is_preferred(study):
    """No scenario is said to end as before unless it does, and the nearest rounding is not left without need."""
    with StudyFile.open(study) as opened:
        # Some of these end otherwise by the nearest rounding, and one by all.
        rows = [opened.finished_rows()[k] for k in (20, 21, 22, 26, 36, 37)]
        scenario = find_explored_scenario(opened)
        assert scenario is not None
        parameters = opened.space.parameters
        quantities = [find_settable_quantity(parameter, scenario) for parameter in parameters]
        kept = changed = otherwise = 0
        with RoundedRunner(opened, scenario) as runner:
            for row in rows:
                original = read_stored_run(opened, row.id, row.values)
                roundings = list(iter_roundings(parameters, quantities, row.values))
                chosen = runner.choose_rounding(original, roundings, len(roundings))
                assert chosen.run is not None
                again = cc.simulate(scenario, chosen.values)
                collides = again.first_collision("Ego", "Pedestrian") is not None
                assert collides == chosen.run.meeting.collides
                assert chosen.keeps_outcome == chosen.run.ends_like(original)
                kept += bool(chosen.keeps_outcome and chosen.is_nearest)
                otherwise += bool(chosen.keeps_outcome and not chosen.is_nearest)
                changed += not chosen.keeps_outcome
                if chosen.is_nearest:
                    assert chosen.values == roundings[0].values
                else:
                    assert chosen.values != roundings[0].values
    assert kept > 2
    assert otherwise > 0
    assert kept + otherwise + changed == 6


def test_a_changed_outcome_is_said(study, tmp_path, monkeypatch):
    """With steps of 30 in each parameter hardly any scenario stays as it is."""
    coarse = SettableQuantity("m", 30.0)
    monkeypatch.setattr("cornercase.report.cards._test_cards.find_settable_quantity", lambda parameter, _: coarse)
    page = write_test_cards(study, tmp_path / "cards.html", ids=[2, 3]).read_text(encoding="utf-8")
    assert "ROUNDING CHANGES THE OUTCOME: in the study" in page
    assert 'class="verdict changed"' in page


@pytest.fixture(scope="module")
def unmeasured(study) -> Path:
    """The same scenarios, in which the ego is measured against the truck only, and touches the pedestrian."""
    path: Path = study.parent / "unmeasured.db"
    logical = cc.LogicalScenario.read(X / "x_intersection.xosc", X / "x_intersection.space.xosc")
    continuous = replace(logical, space=logical.space.as_continuous())
    cc.explore(continuous, path, ego="Ego", other="Truck", metrics=["wttc"], optimizer="sobol", budget=64, critical=0.2)
    return path


def ids_by_contact(study: Path) -> dict[bool, list[int]]:
    """Ids of the scenarios in which the ego touches the pedestrian, and of the others."""
    with StudyFile.open(study) as opened:
        hits = {row: any("Ego" in hit.entities for hit in hits) for row, hits in opened.collisions().items()}
    return {touches: [row for row, hit in hits.items() if hit == touches] for touches in (True, False)}


def test_a_contact_that_the_study_does_not_measure_is_named(unmeasured, tmp_path):
    touching = ids_by_contact(unmeasured)[True][0]
    page = write_test_cards(unmeasured, tmp_path / "cards.html", ids=[touching]).read_text(encoding="utf-8")
    verdict = re.search(r'class="verdict \w+">(.*?)</p>', page)
    assert verdict
    assert "contact with Pedestrian (not measured in the study)" in verdict[1]
    assert "no contact" not in verdict[1]
    before, after, _ = cells(page, "contact")
    assert (before, after) == ("none measured", "none measured")
    before, after, _ = cells(page, "unmeasured contact")
    assert before.startswith("Pedestrian, ")
    assert after.startswith("Pedestrian, ")
    assert "In the simulation Ego touches Pedestrian, which the study does not measure" in page
    assert re.search(r'<th scope="row">Pedestrian<br>', page), "where it starts"


def test_a_card_without_such_a_contact_says_nothing_of_it(unmeasured, study, tmp_path):
    without = write_test_cards(unmeasured, tmp_path / "a.html", ids=ids_by_contact(unmeasured)[False][:1])
    measured = write_test_cards(study, tmp_path / "b.html", ids=ids_by_contact(study)[True][:1])
    for page in (without, measured):
        assert "not measure" not in page.read_text(encoding="utf-8")


def test_a_rounded_run_that_touches_an_entity_more_does_not_end_as_before(unmeasured):
    ids = ids_by_contact(unmeasured)
    with StudyFile.open(unmeasured) as opened:
        values = {row.id: row.values for row in opened.finished_rows()}
        touches, does_not = (read_stored_run(opened, ids[key][0], values[ids[key][0]]) for key in (True, False))
    assert not touches.meeting.collides
    assert not does_not.meeting.collides
    assert not replace(touches, is_critical=None).ends_like(replace(does_not, is_critical=None))
    assert touches.ends_like(touches)


def test_the_contact_of_the_rounded_run_alone_is_named(unmeasured, tmp_path, monkeypatch):
    """With steps of 30 many a scenario ends otherwise."""
    coarse = SettableQuantity("m", 30.0)
    monkeypatch.setattr("cornercase.report.cards._test_cards.find_settable_quantity", lambda parameter, _: coarse)
    ids = ids_by_contact(unmeasured)[True]
    page = write_test_cards(unmeasured, tmp_path / "cards.html", ids=ids).read_text(encoding="utf-8")
    assert "in the study contact with Pedestrian (not measured in the study)" in page
    assert "rounded no contact" in page


def test_the_64_nearest_roundings_are_tried_and_no_more_is_said():
    """With eight parameters there are 256 roundings; which are nearest is known from all of them."""
    parameters = [Parameter(f"d{k}", 0.0, 10.0, unit="m") for k in range(8)]
    quantities = [SettableQuantity("m", 1.0)] * 8
    values = {f"d{k}": 5.0 + 0.03 + 0.06 * k for k in range(8)}
    roundings = list(iter_roundings(parameters, quantities, values))
    assert count_roundings(parameters, quantities, values) == 256
    assert len(roundings) == len({tuple(rounding.values.values()) for rounding in roundings}) == 64
    everything = sorted(
        np.hypot.reduce([value - corner for value, corner in zip(values.values(), corners, strict=True)])
        for corners in itertools.product((5.0, 6.0), repeat=8)
    )
    assert [rounding.distance for rounding in roundings] == pytest.approx(everything[:64])


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        ({"n_tried": 1, "n_possible": 1}, "there is no other rounding (1 tried)."),
        ({"n_tried": 8, "n_possible": 8}, "no rounding up or down keeps the outcome (8 tried)."),
        (
            {"n_tried": 64, "n_possible": 256},
            "none of the 64 roundings nearest to the study's values, of 256, keeps the outcome.",
        ),
        (
            {"n_tried": 8, "n_possible": 8, "n_failed": 2},
            "of the 8 roundings up or down, 2 could not be run, and no other one keeps the outcome.",
        ),
        (
            {"n_tried": 64, "n_possible": 256, "n_failed": 2},
            "of the 64 nearest of 256 roundings, 2 could not be run, and no other one keeps the outcome.",
        ),
    ],
)
def test_no_more_is_said_of_roundings_than_was_tried(study, counts, expected):
    with StudyFile.open(study) as opened:
        row = opened.finished_rows()[0]
        run = read_stored_run(opened, row.id, row.values)
        rounded = RoundedRun(row.values, run, keeps_outcome=False, **counts)
        card = make_card_values(
            opened, CardSource(row.id, run, rounded, "", ""), None, [SettableQuantity("", None)] * 3
        )
    assert card["verdict"]["text"].endswith(expected)


def test_a_nearest_rounding_that_could_not_be_run_is_not_said_to_change_the_outcome(study):
    with StudyFile.open(study) as opened:
        row = opened.finished_rows()[0]
        run = read_stored_run(opened, row.id, row.values)
        rounded = RoundedRun(row.values, run, True, 8, 8, n_failed=1, is_nearest=False, reason="no road at x 3 m")
        card = make_card_values(
            opened, CardSource(row.id, run, rounded, "", ""), None, [SettableQuantity("", None)] * 3
        )
    assert "The nearest rounding could not be run (no road at x 3 m)" in card["verdict"]["text"]
    assert "changed the outcome" not in card["verdict"]["text"]


def test_what_starts_what_is_in_words_and_numbers_of_the_scenario():
    scenario = ScenarioFile.read(EXAMPLES / "t_intersection" / "t_intersection.xosc")
    values = {"ego_sync_s": 12.0, "c_start_time": 3.6, "c_routing_distance": 67.4}
    movements = {movement.what.partition(" (“")[2]: movement for movement in list_movements(scenario, values)}
    starts = movements["C starts”)"]
    assert (starts.who, starts.when) == ("C", "3.60 s since the start")
    synchronises = movements["C synchronises”)"]
    assert synchronises.when == "3.60 s since the start and Ego has gone 67.4 m"
    assert "s 12.0 m" in synchronises.what
    assert movements["C goes on”)"].when == "“C synchronises” has ended"


def test_events_of_entities_that_the_ego_touches_are_shown_before_others():
    """Where there is no room for all; those that are shown stay in the order of the storyboard."""
    triggers = [(who, "goes to 27.0 km/h at once, for as long as it takes " * 3, "at the start") for who in "ABCDEF"]
    texts = CardTexts(
        lines=[""], bold=False, parameters=[["speed", "1 m/s", "4 km/h"]] * 4, parties=[{"time": ""}] * 4,
        triggers=triggers, trigger_ranks=[2, 2, 1, 2, 2, 0], results=[("contact", "none", "none")] * 9,
        below_results="", conditions=["No contact of Ego with F."],
    )  # fmt: skip
    layout = choose_layout(texts)
    assert 2 <= len(layout.triggers) < 6
    assert [who for who, _, _ in layout.triggers][-1] == "F"
    assert "C" in [who for who, _, _ in layout.triggers]
    assert layout.drawing_height >= 30.0


def test_a_long_value_that_has_to_be_set_is_on_the_card_as_a_whole(tmp_path):
    shutil.copytree(X, tmp_path / "scenario")
    scenario = tmp_path / "scenario" / "x_intersection.xosc"
    value = "StraightRoad_noRoadmarks_Streetlights_Nearside"
    text = scenario.read_text(encoding="utf-8")
    declared = f'<ParameterDeclarations><ParameterDeclaration name="road" parameterType="string" value="{value}"/>'
    scenario.write_text(text.replace("<ParameterDeclarations>", declared, 1), encoding="utf-8")
    space = ParameterSpace(
        (Parameter("ego_start", 40.0, 41.0, unit="m"), Parameter("road", 0.0, 1.0, choices=(value, "another")))
    )
    logical = replace(cc.LogicalScenario.read(scenario, ranges=["ego_start=40:41"]), space=space)
    cc.explore(logical, tmp_path / "study.db", ego="Ego", other="Pedestrian", metrics=["wttc"], budget=8)
    page = write_test_cards(tmp_path / "study.db", tmp_path / "cards.html", ids=range(1, 9))
    assert f'<td class="set">{value}</td>' in page.read_text(encoding="utf-8")


def test_tolerances_are_those_of_the_kind_of_target():
    ego = find_tolerances("car", is_ego=True, crosses=None)
    pedestrian = find_tolerances("pedestrian", is_ego=False, crosses=True)
    assert ego is not None
    assert pedestrian is not None
    assert (ego.target, pedestrian.target, pedestrian.speed, pedestrian.lateral) == (
        "VUT", "EPT", "± 0.2 km/h", "0 ± 0.05 m",
    )  # fmt: skip
    assert find_tolerances("train", is_ego=False, crosses=True) is None
    assert find_tolerances("bus", is_ego=True, crosses=None) is None


def test_cards_are_of_the_kept_scenarios_and_the_same_each_time(study, tmp_path):
    first = cornercase("report", study, "--test-cards", "-o", tmp_path / "a.html")
    assert first.returncode == 0, first.stderr
    assert "The test cards are" in first.stdout
    cornercase("report", study, "--test-cards", "-o", tmp_path / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert page.count('<section class="sheet"') == 6
    assert "was run again and ends as the study" in page
    assert "Tolerances after Euro NCAP" in page
    assert "version 1.1 (October 2025), section 4.3.2" in page
    assert "compare them with the protocol of the actual test" in page
    assert "wttc ≤ 0.2 s" in page


def test_without_the_scenario_file_nothing_is_run_and_it_is_said(study, tmp_path, monkeypatch):
    alone = tmp_path / "elsewhere" / "study.db"
    alone.parent.mkdir()
    shutil.copy(study, alone)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("cornercase.study._scenario_file.find_remembered_path", lambda fingerprint: None)
    monkeypatch.chdir(alone.parent)
    page = write_test_cards(alone, tmp_path / "cards.html", ids=[1]).read_text(encoding="utf-8")
    assert "was not run again: the scenario file x_intersection.xosc was not found" in page
    assert '<th scope="col">rounded</th>' not in page


def test_a_program_that_a_study_names_is_not_started(study):
    with StudyFile.open(study) as opened:
        meta = opened.meta
        assert reason_not_to_run(meta) == ""
        own = replace(meta, settings={**meta.settings, "drivers": {"Ego": "exec:./driver"}})
        assert "not started" in reason_not_to_run(own)
        assert "carla" in reason_not_to_run(replace(meta, simulator="carla"))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--test-cards", "--ids", "9999"), "scenario 9999 was not run"),
        (("--test-cards", "--ids", "x"), "give ids and ranges of ids"),
        (("--ids", "3"), "add --test-cards"),
        (
            ("--test-cards", "--one-page"),
            "--test-cards and --one-page: each writes a page of its own; give one of them at a time, each with its own --output.",
        ),
        (
            ("--test-cards", "--figures", "--against", "other.db"),
            "--test-cards: has no figures and shows no other study; leave --figures and --against out.",
        ),
    ],
)
def test_bad_input_gets_a_sentence(study, tmp_path, options, expected):
    told = cornercase("report", study, *options, "-o", tmp_path / "cards.html")
    assert told.returncode == 2
    assert expected in " ".join(told.stderr.split())
    assert "Traceback" not in told.stderr


def test_a_folder_has_no_test_cards(study, tmp_path):
    told = cornercase("report", study.parent, "--test-cards", "-o", tmp_path / "cards.html")
    assert told.returncode == 2
    assert "is a folder" in told.stderr


def test_a_study_that_was_not_reduced_is_named(study, tmp_path):
    fresh = tmp_path / "fresh.db"
    cc.explore(
        X / "x_intersection.xosc", fresh, ego="Ego", other="Pedestrian", metrics=["wttc"], ranges=["ego_start=40:41"],
        budget=1,
    )  # fmt: skip
    told = cornercase("report", fresh, "--test-cards", "-o", tmp_path / "cards.html")
    assert told.returncode == 2
    assert "cornercase reduce" in told.stderr
    named = cornercase("report", fresh, "--test-cards", "--ids", "1", "-o", tmp_path / "cards.html")
    assert named.returncode == 0, named.stderr
