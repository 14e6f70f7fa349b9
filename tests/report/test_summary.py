"""What a study holds: as typed values, in words, and as a page."""

from __future__ import annotations

import json
import shutil
import warnings
from dataclasses import replace
from html import unescape
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.clustering import Profile, analyze
from cornercase.clustering._headline_aspect import has_useful_clusters
from cornercase.evidence import Estimate
from cornercase.report import summarize, write_report
from cornercase.report._estimates import CriticalEstimates, CriticalSetEstimates
from cornercase.report._report_data import read_report_data
from cornercase.report.figures._example_scenarios import draw_example_scenarios
from cornercase.report.figures._export import render_figure
from cornercase.report.figures._parameter_space import draw_kernel_and_parameter_space
from cornercase.report.html._tables import render_clustering_settings
from cornercase.report.text._answers import page_answers
from cornercase.report.text._phrases import (
    describe_informativeness,
    format_cluster_name,
    format_cluster_title,
    format_criterion,
    format_range,
)
from cornercase.report.text._summary_dict import summary_to_dict
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.study import StudyFile
from helpers.encounter_recordings import PASSES, entity, recording
from helpers.synthetic_study import LOGICAL, SPACE, about, explorer, opened


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "s.db"
    with opened(path) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
    # The synthetic distances have no structure of their own.
    analyze(path, "distance", gamma=4.0, eps=0.2, min_samples=3)
    return path


@pytest.fixture
def path(whole, tmp_path):
    """A copy, since some tests change it."""
    return Path(shutil.copy(whole, tmp_path / "s.db"))


@pytest.fixture(scope="module")
def summary(whole):
    return summarize(whole)


def test_a_summary_holds_values_and_says_what_it_is(path, summary):
    with StudyFile.open(path, readonly=True) as study:
        assert summary.n_run + summary.n_failed == len(study.rows())
        scores = study.scores("distance")
        worst = study.finished_rows()[int(scores.argmin())]
    one = summary.metrics["distance"]
    assert (one.most_critical, one.most_critical_id, one.parameters) == (scores.min(), worst.id, worst.values)
    assert one.repeat_spread is None
    assert list(summary.analyses) == ["distance"]
    assert summary.estimates.pareto_front is None
    assert summary.reduced_set is None
    assert f"synthetic: {summary.n_run} scenarios run, {summary.n_collisions} collisions" in repr(summary)
    assert f"{len(summary.analyses['distance'].sizes)} clusters by distance" in repr(summary)


def test_words_are_plain_values_in_a_fixed_order(summary):
    words = summary_to_dict(summary)
    assert list(words)[:8] == ["scenario", "ego", "other", "optimizer", "seed", "simulator", "parameters", "run"]
    assert words["parameters"] == {"a": "0 to 1", "b": "0 to 1"}
    assert words["clusters"]["distance"]["cluster_0"]["scenarios"] == words["clusters"]["distance"]["sizes"][0]
    assert json.loads(json.dumps(words)) == words
    assert "kept" not in words


def test_scenarios_that_were_run_since_are_told_with_what_mends_it(path, summary, tmp_path):
    before = summary_to_dict(summary)
    with opened(path) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=60).run()
    grown = summarize(path)
    later = grown.n_run - before["run"]
    assert later > 0
    told = summary_to_dict(grown)["clusters"]["distance"]
    command = "cornercase analyze STUDY.db --by distance --keep-clusters"
    assert told["run_since_in_no_cluster_yet"] == later
    assert told["they_join_with"] == command
    assert set(told) - set(before["clusters"]["distance"]) == {"run_since_in_no_cluster_yet", "they_join_with"}
    page = write_report(path, tmp_path / "r.html").read_text(encoding="utf-8")
    assert f"{later} of {grown.n_run} scenarios were run since and are in no cluster yet" in page
    assert command in page
    analyze(path, "distance", keep_clusters=True)
    assert "they_join_with" not in summary_to_dict(summarize(path))["clusters"]["distance"]
    assert "in no cluster yet" not in write_report(path, tmp_path / "r.html").read_text(encoding="utf-8")


def test_no_stability_is_told_where_all_are_one_group(path):
    with StudyFile.open(path, readonly=False) as study:
        found = analyze(study, "distance")["distance"].clustering
        assert found.n_clusters == 1
        # It was measured, and is 1.
        assert any(one.stability == 1.0 and one.clusters == 1 for one in found.candidates)
        told = json.loads(json.dumps(summary_to_dict(summarize(study))))["clusters"]["distance"]
    assert told["stability"] is None
    one = next(one for one in found.candidates if one.stability == 1.0)
    two = replace(one, clusters=2, stability=0.75, eps=2.0 * one.eps)
    table = render_clustering_settings(replace(found, candidates=(one, two)))
    assert "<td>0.75</td>" in table
    assert "<td>1.00</td>" not in table.replace(f"<td>{one.score:.2f}</td></tr>", "")


def test_a_front_is_told_by_id(tmp_path):
    meta = replace(about(SPACE, "distance", "wttc"), pareto=True)
    with StudyFile.create(tmp_path / "s.db", meta) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
        summary, ids = summarize(study), [row.id for row in study.finished_rows()]
    front = summary.estimates.pareto_front
    assert front
    assert len(front) == 1
    assert set(front) <= set(ids)
    assert (summary.estimates.critical, summary.estimates.sensitivity) == (None, None)
    assert list(summary_to_dict(summary)["front"]) == [f"scenario {scenario}" for scenario in front]
    page = write_report(tmp_path / "s.db", tmp_path / "r.html")
    assert "One scenario is as critical as any other in every metric" in page.read_text(encoding="utf-8")


def test_what_is_known_of_the_critical_set_is_told_with_its_threshold():
    share = Estimate(0.2, 0.1, 0.3)
    known = CriticalEstimates(1.5, False, "m/s²", 20, 7, CriticalSetEstimates(share, share, 0.0, 0.5, 0.01, 0.02))
    assert format_criterion(known.criterion, "drac") == "drac >= 1.5 m/s²"
    known = replace(known, lower_is_critical=True, unit="")
    assert format_criterion(known.criterion, "ttc + 2 pet") == "ttc + 2 pet <= 1.5"


@pytest.mark.parametrize(
    ("optimizer", "judge"),
    [pytest.param("sobol", "a Gaussian process", marks=pytest.mark.slow), ("committee", "a committee")],
)
def test_a_page_says_what_predicts_whether_scenarios_are_critical(optimizer, judge, tmp_path):
    with StudyFile.create(
        tmp_path / "s.db", replace(about(SPACE, "distance"), optimizer=optimizer, critical=1.0)
    ) as study:
        explorer(study, optimizer=optimizer).run()
        sizes = [missed.n_run for missed in read_report_data(study).missed_fractions]
        n_run = len(study.finished_rows())
    page = write_report(tmp_path / "s.db", tmp_path / "r.html").read_text(encoding="utf-8")
    assert f"what is overlooked come from {judge} of " in page
    # How the search went is shown whatever judges it.
    assert sizes[-1] == n_run
    assert sizes[-2] == pytest.approx(n_run / 2, abs=10)


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        (Parameter("a", 20.0, 80.0, unit="m"), "20 to 80 m"),
        (Parameter("a", 0.0, 1.0), "0 to 1"),
        (Parameter("a", 5_400_000.0, 5_400_000.005, unit="m"), "5400000 to 5400000.005 m"),
        (Parameter("a", 0, 1, choices=("car", "truck")), "car, truck"),
    ],
)
def test_a_range_is_told_with_its_unit(parameter, words):
    assert format_range(parameter) == words
    assert (format_cluster_name(-1), format_cluster_name(3)) == ("noise", "cluster 3")


@pytest.mark.parametrize("figures", at_night([False, True], {True}))
def test_a_page_is_written_of_a_study_and_of_a_path(path, tmp_path, figures):
    pages = []
    with StudyFile.open(path, readonly=True) as study:
        pages.append(write_report(study, tmp_path / "one" / "r.html", figures=figures))
    pages.append(write_report(str(path), tmp_path / "two" / "r.html", figures=figures))
    one, two = ({file.name: file.read_bytes() for file in page.parent.rglob("*.*")} for page in pages)
    assert one == two
    if not figures:
        assert set(one) == {"r.html"}
        return
    drawn = {
        "criticality-distance",
        "criticality-wttc",
        "sensitivity",
        *(f"{what}-distance" for what in ("examples", "clusters", "courses")),
    }
    assert set(one) == {"r.html", "captions.txt", *(f"{name}.{ending}" for name in drawn for ending in ("png", "svg"))}
    told = dict(line.split(": ", 1) for line in one["captions.txt"].decode().splitlines())
    assert set(told) == drawn


def test_kinds_are_drawn_and_named(path, summary, tmp_path):
    kinds = summary.analyses["distance"]
    assert kinds.clustering.n_clusters > 1
    page = write_report(path, tmp_path / "r.html").read_text(encoding="utf-8")
    for one in kinds.profiles:
        assert one.name in unescape(page)
        assert (f"scenario {one.example}</td>" in page) == (one.cluster >= 0)


def test_where_all_are_one_kind_the_page_says_so_and_draws_none(path, tmp_path):
    with StudyFile.open(path, readonly=False) as study:
        # So wide a neighbourhood holds all.
        analyze(study, "distance", gamma=0.25, eps=10.0, min_samples=3)
        assert describe_informativeness(summarize(study).analyses["distance"]) == (
            "No separate kinds: by distance all scenarios are one group."
        )
        page = write_report(study, tmp_path / "r.html", figures=tmp_path / "f").read_text(encoding="utf-8")
    assert "No separate kinds: by distance" in page
    assert [one.name for one in (tmp_path / "f").glob("*-distance.png")] == ["criticality-distance.png"]


@pytest.mark.parametrize(
    ("tells", "words"),
    [
        (
            {"outcome": 0.95, "stopped": 0.5, "first": 0.2},
            "say much about outcome (0.95), and something about stopped (0.50).",
        ),
        ({"outcome": 0.3, "stopped": 0.0}, "say little about how scenarios end (mutual information of at most 0.30)."),
        ({"outcome": -0.01}, "say nothing about how scenarios end (mutual information of at most 0.00)."),
    ],
)
def test_what_kinds_tell_is_said_in_a_sentence(summary, tells, words):
    kinds = summary.analyses["distance"]
    told = replace(kinds, fact_agreement=tells)
    assert describe_informativeness(told) == f"The kinds by distance {words}"
    ends_alike = len({outcome for profile in kinds.profiles for outcome in profile.outcomes}) < 2
    assert has_useful_clusters(told) == (ends_alike or "something" in words)
    assert "All scenarios end in the same way" in describe_informativeness(replace(kinds, fact_agreement={}))
    # Of a study of an early version.
    assert describe_informativeness(replace(kinds, fact_agreement={}, profiles=())) == ""


def test_kinds_that_tell_no_endings_apart_are_not_listed_in_the_answer(path):
    with StudyFile.open(path, readonly=True) as study:
        data = read_report_data(study)
    kinds = data.summary.analyses["distance"]
    profiles = tuple(replace(profile, outcomes={"A first": 3, "B first": 3}) for profile in kinds.profiles)
    for agreement, n_listed in ((0.1, 0), (0.9, kinds.clustering.n_clusters)):
        analysis = replace(kinds, fact_agreement={"outcome": agreement}, profiles=profiles)
        summary = replace(data.summary, analyses={"distance": analysis}, bands={})
        (answer,) = (one for one in page_answers(replace(data, summary=summary)) if one.name == "kinds")
        assert answer.text.startswith("No useful kinds: ") == (not n_listed)
        assert len(answer.points) == n_listed


def test_nothing_is_said_of_a_study_in_which_nothing_was_run(tmp_path):
    opened(tmp_path / "s.db").close()
    summary = summarize(tmp_path / "s.db")
    assert (summary.n_run, dict(summary.metrics), dict(summary.analyses)) == (0, {}, {})
    assert summary.estimates.sensitivity is None
    with pytest.raises(InputError, match="no scenario was run yet"):
        write_report(tmp_path / "s.db", tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_a_name_never_hides_collisions():
    outcomes = {"Pedestrian first": 117, "Ego and Pedestrian collide": 3}
    kind = Profile(0, 120, {}, outcomes, (), "Ego passes after Pedestrian", 0.975, 0.0, 1)
    assert kind.label == "Ego passes after Pedestrian; 3 of 120 collide"
    assert format_cluster_title(kind, "bearing") == f"bearing 0: {kind.label}"
    crash = replace(kind, size=3, outcomes={"Ego and Pedestrian collide": 3}, name="Ego collides with Pedestrian")
    assert crash.label == crash.name


LONG = (
    "Ego runs into the rear of Pedestrian or is hit from behind by Pedestrian or stops for Pedestrian, comes within 2 m"
    " of Pedestrian, faster than 12.5 m/s on average; 17 of 120 collide"
)


def test_no_name_of_a_kind_is_cut_in_figures():
    figure = draw_kernel_and_parameter_space(
        np.eye(4), np.array([0, 0, 1, 1]), np.eye(4)[:, :2], [Parameter("a", 0, 1), Parameter("b " * 40, 0, 1)], (0, 1),
        {0: f"cluster 0: {LONG}", 1: "cluster 1: Ego stands"},
    )  # fmt: skip
    render_figure(figure)
    shown = [text.get_text() for text in figure.findobj(Text)]
    assert f"cluster 0: {LONG} (2)" in [" ".join(text.split()) for text in shown]
    assert max(len(line) for text in shown for line in text.split("\n")) <= 60
    assert "b " * 39 + "b" in [" ".join(text.split()) for text in shown]


def test_no_name_makes_a_huge_figure():
    sizes = []
    for times in (1, 10_000):
        figure = Figure(figsize=(4.0, 3.0))
        figure.add_subplot().set_title("Ego yields to nobody" * times)
        image = imread(BytesIO(render_figure(figure)["png"]))
        sizes.append(image.shape)
    assert sizes[1][0] < 2 * sizes[0][0]
    assert sizes[1][1] < 2 * sizes[0][1]


def test_signs_that_the_font_lacks_are_no_reason_to_warn():
    figure = Figure(figsize=(4.0, 3.0))
    figure.add_subplot().set_title("自车 stops for 行人")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert render_figure(figure)["png"].startswith(b"\x89PNG")


def test_in_a_drawn_example_both_are_to_be_seen():
    for aside in (6.0, 60.0, 300.0):
        away = recording(Ego=PASSES, P=entity(40.0, aside, 0.0, (0, 1.5)))
        axis = draw_example_scenarios({"apart": away}, "Ego", "P").axes[0]
        for box in axis.patches:
            x, y = np.asarray(box.get_path().vertices).T
            assert axis.get_xlim()[0] < x.min() < x.max() < axis.get_xlim()[1]
            assert axis.get_ylim()[0] < y.min() < y.max() < axis.get_ylim()[1]
        assert len(axis.patches) == 2


def test_of_a_space_that_was_run_whole_the_page_claims_no_bound(tmp_path):
    space = ParameterSpace.from_ranges(["a=0:0.8:0.2", "b=0:0.9:0.3"])
    with opened(tmp_path / "s.db", space, critical=-1.0) as study:
        logical = replace(LOGICAL, space=space)
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", logical=logical, critical=-1.0).run()
    critical = summary_to_dict(summarize(tmp_path / "s.db"))["critical"]
    assert critical["share"] == critical["missed"] == {"value": 0.0, "low": 0.0, "high": 0.0}
    page = write_report(tmp_path / "s.db", tmp_path / "r.html").read_text(encoding="utf-8")
    assert "These are all scenarios of the space." in page
    assert "Nothing: all scenarios of the space were run, and none is critical." in page


@pytest.mark.parametrize(("threshold", "share"), [(100.0, 1.0), (-1.0, 0.0)])
def test_of_a_few_scenarios_that_are_the_whole_space_everything_is_known(tmp_path, threshold, share):
    space = ParameterSpace.from_ranges(["a=0:0.2:0.2", "b=0:0.3:0.3"])
    with opened(tmp_path / "s.db", space, critical=threshold) as study:
        logical = replace(LOGICAL, space=space)
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", logical=logical, critical=threshold).run()
    critical = summary_to_dict(summarize(tmp_path / "s.db"))["critical"]
    assert critical["share"] == dict.fromkeys(("value", "low", "high"), share)
    assert critical["missed"] == dict.fromkeys(("value", "low", "high"), 0.0)
    page = write_report(tmp_path / "s.db", tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Nothing: all scenarios of the space were run" in page


def test_where_all_scores_are_the_same_it_is_said_that_they_tell_nothing(tmp_path):
    with StudyFile.create(tmp_path / "s.db", about(SPACE, "delta-v", critical=1.0)) as study:
        explorer(study, metrics=("delta-v",), optimizer="sobol", critical=1.0).run()
    critical = summary_to_dict(summarize(tmp_path / "s.db"))["critical"]
    assert critical["scenarios"] == 0
    assert "too few different scores" in critical["note"]
