"""The figures of the paper, drawn from a study."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image

from cornercase.clustering import analyze, read_analysis
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.report import PAPER_SCENARIOS
from cornercase.report.figures import _paper_figures as paper_figures
from cornercase.study import StudyFile
from helpers.command_line import cornercase

FIGURES = {"scenario-1": "figure-5", "scenario-2": "figure-6"}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Folder that the command wrote for scenario 1."""
    folder = tmp_path_factory.mktemp("scenario-1")
    ended = cornercase("paper", "scenario-1", "--budget", "20", "-o", folder)
    assert ended.returncode == 0, ended.stderr
    assert str(folder) in ended.stdout
    return folder


def figure_of(study, name):
    layout = PAPER_SCENARIOS[name]
    with StudyFile.open(study, readonly=True) as opened:
        data = paper_figures._read_data(opened, layout)
    return {one.name: one.figure for one in paper_figures._draw_paper_figures(data, layout)}


def check_written(folder, name):
    captions = (folder / "captions.txt").read_text(encoding="utf-8").splitlines()
    assert [line.partition(":")[0] for line in captions] == [FIGURES[name], "criticality"]
    for figure in (FIGURES[name], "criticality"):
        assert "<svg" in (folder / f"{figure}.svg").read_text(encoding="utf-8")
        assert image.imread(folder / f"{figure}.png").std() > 0.01
    with StudyFile.open(folder / "study.db", readonly=True) as study:
        assert study.meta.optimizer == "bayes:filling=0"
        analysis = read_analysis(study, PAPER_SCENARIOS[name].aspects[0])
    n = analysis.clustering.n_clusters
    assert f"ego-trajectory, gamma {analysis.clustering.gamma:.3g}" in captions[0]
    assert f": {n} cluster{'s' if n != 1 else ''}" in captions[0]


def test_one_command_explores_and_draws(drawn):
    check_written(drawn, "scenario-1")


@pytest.mark.slow
def test_one_command_explores_and_draws_scenario_2(tmp_path):
    assert cornercase("paper", "scenario-2", "--budget", "60", "-o", tmp_path).returncode == 0
    check_written(tmp_path, "scenario-2")


def test_figure_5_has_the_panels_of_the_paper(drawn):
    study = drawn / "study.db"
    figures = figure_of(study, "scenario-1")
    panels = [axis for axis in figures["figure-5"].axes if axis.get_title()]
    assert sorted(axis.get_title()[:3] for axis in panels) == [f"({letter})" for letter in "abcdefgh"]
    by_letter = {axis.get_title()[1]: axis for axis in panels}
    # (a)-(d) in space, (e)-(h) in the plane, in two rows of four.
    assert [by_letter[letter].name == "3d" for letter in "abcdefgh"] == [True] * 4 + [False] * 4
    rows = [by_letter[letter].get_subplotspec().get_topmost_subplotspec().rowspan.start for letter in "abcdefgh"]
    assert rows == [0] * 4 + [1] * 4
    for axis in panels:
        labels = [axis.get_xlabel(), axis.get_ylabel(), *([axis.get_zlabel()] if axis.name == "3d" else [])]
        assert all(label.endswith("]") for label in labels), labels
    with StudyFile.open(study, readonly=True) as opened:
        count = len(opened.finished_rows())
        scores = opened.scores("wttc")
    # Every scenario is in each panel; (h) has all scores.
    for letter in "abcefgh":
        assert sum(len(part.get_offsets()) for part in by_letter[letter].collections) == count
    np.testing.assert_allclose(np.sort(by_letter["h"].collections[0].get_array()), np.sort(scores))
    assert len([axis for axis in figures["criticality"].axes if axis.get_title()]) == 2


def test_figure_6_has_the_panels_of_the_paper(tmp_path):
    study = tmp_path / "study.db"
    explore_config(paper_experiment_config("t-intersection", budget=20), study)
    analyze(study, PAPER_SCENARIOS["scenario-2"].aspects)
    figures = figure_of(study, "scenario-2")
    panels = [axis for axis in figures["figure-6"].axes if axis.get_title()]
    assert [axis.name for axis in panels] == ["3d"] * 6
    places = {axis.get_title()[1]: axis.get_subplotspec() for axis in panels}
    assert [(places[c].rowspan.start, places[c].colspan.start) for c in "abcdef"] == [
        (row, column) for row in (0, 1) for column in range(3)
    ]
    assert {axis.get_zlabel() for axis in panels} == {"c_routing_distance [m]", "component 3 [–]"}
    shown = [axis.get_title() for axis in figures["criticality"].axes if axis.get_title()]
    assert shown == ["(a) ttc", "(b) distance", "(c) traffic-quality", "(d) wttc"]


def test_hulls_enclose_their_cluster_and_have_at_most_fifteen_corners(drawn, tmp_path):
    study = shutil.copy(drawn / "study.db", tmp_path / "study.db")
    analyze(study, "trajectory-distance", gamma=0.5, eps=0.3, min_samples=3)
    with StudyFile.open(study, readonly=True) as opened:
        n = read_analysis(opened, "trajectory-distance").clustering.n_clusters
    panel = next(axis for axis in figure_of(study, "scenario-1")["figure-5"].axes if axis.get_title()[:3] == "(d)")
    names = panel.get_legend_handles_labels()[1]
    corners = [int(name.split()[0]) for name in names if "archetypes" in name]
    assert len(corners) == n >= 1
    assert max(corners) <= 15
    assert sum("prototype" in name for name in names) == n
    assert len(panel.lines) >= 3


def test_the_same_study_gives_the_same_bytes(drawn, tmp_path):
    study = drawn / "study.db"
    ended = cornercase("paper", "scenario-1", study, "-o", tmp_path / "again")
    assert ended.returncode == 0, ended.stderr
    files = sorted(path.name for path in (tmp_path / "again").iterdir())
    assert files == ["captions.txt", "criticality.png", "criticality.svg", "figure-5.png", "figure-5.svg"]
    for file in files:
        assert (tmp_path / "again" / file).read_bytes() == (drawn / file).read_bytes()


def test_clusters_set_by_hand_are_drawn(drawn, tmp_path):
    study = shutil.copy(drawn / "study.db", tmp_path / "study.db")
    analyze(study, "wttc", gamma=2.0, eps=0.15, min_samples=3)
    layout = PAPER_SCENARIOS["scenario-1"]
    with StudyFile.open(study, readonly=True) as opened:
        data = paper_figures._read_data(opened, layout)
        labels = read_analysis(opened, "wttc").labels
    assert "wttc, gamma 2, eps 0.15, min. points 3:" in paper_figures._caption_figure_5(data, layout)
    panels = {axis.get_title()[:3]: axis for axis in figure_of(study, "scenario-1")["figure-5"].axes}
    sizes = [len(part.get_offsets()) for part in panels["(g)"].collections]
    assert sizes == np.unique(labels, return_counts=True)[1].tolist()


def test_all_noise_and_one_parameter_are_drawn_too(drawn, tmp_path):
    study = shutil.copy(drawn / "study.db", tmp_path / "study.db")
    analyze(study, ["ego-trajectory", "trajectory-distance", "wttc"], gamma=1.0, eps=1e-6, min_samples=9)
    layout = PAPER_SCENARIOS["scenario-1"]
    with StudyFile.open(study, readonly=True) as opened:
        data = paper_figures._read_data(opened, layout)
    drawings = list(paper_figures._draw_paper_figures(data, layout))
    assert "0 clusters and 20 scenarios of noise" in drawings[0].caption
    single = replace(
        data, parameters=data.parameters[:1], influential=(0,), values=data.values[:, :1], points=data.points[:, :1]
    )
    assert len(list(paper_figures._draw_paper_figures(single, layout))) == 2


def test_what_cannot_be_drawn_is_one_sentence(drawn, tmp_path):
    study = drawn / "study.db"
    for given, said in (
        (("scenario-3",), "choose scenario-1 or scenario-2"),
        (("scenario-2", study), "was not measured by distance, which the figure of scenario-2 shows"),
        (("scenario-1", study, "--budget", "9"), "--budget: is only for a new exploration"),
        (("scenario-1", study, "--seed", "9"), "--seed: is only for a new exploration"),
        (("scenario-1", tmp_path / "none.db"), "none.db"),
    ):
        ended = cornercase("paper", *given, "-o", tmp_path / "out")
        assert (ended.returncode, ended.stderr.count("\n")) == (2, 1), ended.stderr
        assert said in ended.stderr
