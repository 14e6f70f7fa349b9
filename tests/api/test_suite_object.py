"""A suite as an object: run, judged, written; and comparisons that write their page."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import cornercase as cc
from cornercase.suite import Requirement
from helpers.command_line import SPACE, X, cornercase

pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")


@pytest.fixture(scope="module")
def reduced(tmp_path_factory) -> Path:
    folder: Path = tmp_path_factory.mktemp("suite")
    problem = cc.Problem(cc.LogicalScenario.read(X, SPACE), "Ego", "Pedestrian", ["wttc"], 0.2)
    study = cc.Study.create(folder / "study.db", problem)
    study.explore("sobol", budget=20)
    study.cluster(by="wttc")
    selected = study.reduce(folder / "reduced", size=4)
    assert selected.table().index.tolist() == selected.ids
    return folder / "reduced"


def test_a_suite_runs_beside_its_folder_and_writes_what_the_command_writes(reduced, tmp_path):
    suite = cc.Suite.open(reduced)
    assert (
        suite.table()["file"].tolist() == sorted(path.name for path in reduced.glob("*.xosc"))
        or len(suite.table()) == 4
    )
    result = suite.run(require=["no collision"])
    assert suite.table().index.equals(result.table().index)
    assert result.study == reduced.with_name("reduced.run.db")
    assert result.junit(tmp_path / "verb.xml") == tmp_path / "verb.xml"
    result.markdown(tmp_path / "verb.md")
    done = cornercase(
        "test", reduced, "--require", "no collision", "--junit", tmp_path / "command.xml", "--summary",
        tmp_path / "command.md", "-o", reduced.with_name("command.db"),
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr
    for ending in ("xml", "md"):
        assert (tmp_path / f"verb.{ending}").read_bytes() == (tmp_path / f"command.{ending}").read_bytes()


def test_the_run_of_the_suite_above_the_current_folder_is_beside_the_suite(reduced, tmp_path, monkeypatch):
    suite = shutil.copytree(reduced, tmp_path / "suite")
    (suite / "here").mkdir()
    monkeypatch.chdir(suite / "here")
    assert cc.Suite.open("..").run().study.resolve() == tmp_path / "suite.run.db"


def test_the_run_of_a_suite_cannot_be_searched_on(reduced):
    study = cc.Study.open(cc.Suite.open(reduced).run(require=["no collision"]).study)
    words = "is the run of a suite, which has no search problem; give the study that was explored, or run the suite"
    with pytest.raises(cc.InputError, match=words):
        study.explore(budget=5)
    with pytest.raises(cc.InputError, match=words):
        _ = study.problem


def test_the_table_of_a_result_has_a_row_per_scenario(reduced):
    result = cc.Suite.open(reduced).run(require=["no collision"])
    table = result.table()
    assert table.index.tolist() == [scenario.id for scenario in result.scenarios]
    assert table["state"].value_counts().to_dict() == {
        state: result.count_scenarios(state) for state in set(table["state"])
    }
    assert table["wttc"].tolist() == [scenario.scores["wttc"] for scenario in result.scenarios]
    assert result._repr_html_().count("<tr") == 1 + 1 + len(table)


def test_requirements_can_be_objects(reduced):
    requirement, expression = Requirement.parse("no collision"), cc.metrics.Expression.parse("score(wttc) > 0.5 s")
    condition = cc.metrics.Expression.parse("wttc > 0.5 s", "condition")
    verdicts = cc.Suite.open(reduced).run(require=[requirement, expression]).scenarios[0].verdicts
    assert [verdict.requirement for verdict in verdicts] == [requirement.text, expression.text]
    assert cc.Suite.open(reduced).run(require=[condition]).scenarios[0].verdicts == verdicts[1:]
    assert cc.Suite.open(reduced).run(require=[requirement.text]).scenarios[0].verdicts == verdicts[:1]


def test_what_is_no_suite_is_refused_when_it_is_opened(tmp_path):
    with pytest.raises(cc.InputError, match="does not exist; name a folder of scenarios"):
        cc.Suite.open(tmp_path / "reduced")


def test_a_suite_runs_each_scenario_once(reduced):
    with pytest.raises(cc.InputError, match="a suite runs each scenario once"):
        cc.Suite.open(reduced).run(runs=cc.Runs(repeats=2))


def test_a_comparison_writes_its_page_and_lists_its_pairs(reduced, tmp_path):
    old = cc.Suite.open(reduced).run(tmp_path / "old.db")
    new = cc.Suite.open(reduced).run(tmp_path / "new.db", drivers={"Ego": "cautious"})
    comparison = cc.compare(old, new)
    table = comparison.table()
    assert table.index.tolist() == [pair.ids for pair in comparison.pairs]
    worse = table["new wttc"] < table["old wttc"]
    assert worse.sum() == next(change.worse for change in comparison.scores if change.metric == "wttc")
    page = comparison.write(tmp_path / "compare.html")
    done = cornercase("compare", old.study, new.study, "-o", tmp_path / "command.html")
    assert done.returncode in (0, 1), done.stderr
    assert Path(page).read_bytes() == (tmp_path / "command.html").read_bytes()
