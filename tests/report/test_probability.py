"""The page of an estimate of rare events: the number first, how sure it is, and what it holds for."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from html import unescape

import pytest

import cornercase as cc
from cornercase.report.html._probability_section import describe_distribution
from cornercase.scenario import LogicalScenario, Parameter
from cornercase.scenario._distributions import Distribution
from cornercase.study import StudyFile


@pytest.fixture(scope="module")
def estimate(tmp_path_factory, x_intersection):
    folder = tmp_path_factory.mktemp("estimate")
    logical = LogicalScenario.read(
        x_intersection.path, ranges=["ego_start=20:60", "pedestrian_wait=0:10", "p1_speed=1:10"]
    )
    cc.explore(
        logical, folder / "study.db", ego="Ego", other="Pedestrian", metrics=["wttc"], critical=0.2, budget=20,
        optimizer="sobol",
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cc.estimate(folder / "study.db", folder / "estimate.db", budget=100, scenario=x_intersection.path)
    return folder / "estimate.db"


def test_the_number_comes_first_and_a_section_says_how_sure_it_is(estimate, tmp_path):
    page = cc.write_report(estimate, tmp_path / "page.html").read_text(encoding="utf-8")
    assert re.findall(r'<div class="answer" data-question="(.*?)">', page)[0] == "probability"
    with StudyFile.open(estimate) as study:
        stored = study.read_estimate()
    assert stored is not None
    section = page.partition('<details data-part="probability" open>')[2].partition("</details>")[0]
    text = unescape(re.sub(r"<[^>]*>", " ", section))
    for event in ("critical", "collision"):
        low, high = stored[event]["95 % interval"]
        assert f"{low:.3g} to {high:.3g}" in text
        assert f"{stored[event]['met in']} of {stored[event]['scenarios']}" in text
    for warning in stored["warnings"]:
        assert warning in text
    assert "the share of the scenarios on this page that collide is not the probability" in text
    # A range without a distribution is uniform, which readers have to know.
    rows = re.findall(r"<tr><td class=text>(\w+)</td><td class=text>(.*?)</td><td class=text>(.*?)</td></tr>", section)
    assert [name for name, _, _ in rows] == ["ego_start", "pedestrian_wait", "p1_speed"]
    assert {distribution for _, _, distribution in rows} == {"uniform, as the file names none"}


@pytest.mark.parametrize(
    ("distribution", "choices", "words"),
    [
        (Distribution("normal", 0.0, 9.0, (4.0, 2.0)), (), "normal, mean 4, standard deviation 2, cut off"),
        (Distribution("lognormal", 0.0, 9.0, (0.2, 0.5)), (), "mean 0.2 and standard deviation 0.5 of the logarithm"),
        (Distribution("poisson", 0.0, 9.0, (3.0,)), (), "Poisson, mean 3"),
        (Distribution("histogram", 0.0, 4.0, (0.0, 1.0, 4.0, 3.0, 1.0)), (), "histogram: 0 to 1 75 %, 1 to 4 25 %"),
        (Distribution("set", 0.0, 1.0, (1.0, 4.0)), ("car", "truck"), "set: car 20 %, truck 80 %"),
        (Distribution("uniform", 0.0, 1.0), (), "uniform"),
    ],
)
def test_each_distribution_is_described_with_its_numbers(distribution, choices, words):
    parameter = replace(Parameter("a", distribution.low, distribution.high, choices=choices), distribution=distribution)
    assert words in describe_distribution(parameter)
