"""The page of a comparison of two versions."""

from __future__ import annotations

import importlib.resources
import json
import re
from collections import Counter
from pathlib import Path

import pytest
from typer.testing import CliRunner

import cornercase as cc
from cornercase import InputError
from cornercase.cli import app
from cornercase.drivers import NORMAL, BehaviourDriver
from cornercase.report import write_comparison
from cornercase.report.comparison import _comparison_page as versions_page

DECLARED = re.compile(r"^(?:async )?(?:function\*? |class |const |let |var )([A-Za-z_$][\w$]*)", re.MULTILINE)


@pytest.fixture(scope="module")
def versions(tmp_path_factory, x_intersection):
    """The X-intersection with a driver, and with one that reacts 0.3 s later."""
    folder, found = tmp_path_factory.mktemp("versions"), []
    for name, time in (("old", 0.5), ("new", 0.8)):
        found.append(folder / f"{name}.db")
        cc.explore(
            x_intersection, found[-1], ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol",
            budget=30, seed=1, critical=0.2, drivers={"Ego": BehaviourDriver(NORMAL._replace(reaction_time=time))},
        )  # fmt: skip
    return found


def page_of(versions, path) -> Path:
    old, new = versions
    return write_comparison(cc.compare(old, new), old, new, path)


def contents_of(page):
    found = re.search(r'<script type="application/json" id="contents">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_it_holds_each_telling_scenario_with_both_versions(versions, tmp_path):
    found = cc.compare(*versions)
    page = page_of(versions, tmp_path / "page.html").read_text(encoding="utf-8")
    assert found.reason in page
    assert f"<h2>{found.verdict.capitalize()}</h2>" in page
    shown = re.findall(r"<b>(.*?)</b>: (.*?)</li>", page.partition('id="telling"')[0], re.DOTALL)
    told = [(what, re.sub(r"<[^>]*>|\n", "", scenarios)) for what, scenarios in shown]
    assert told == [(one.change_text, one.format_scenario_ids(40)) for one in (*found.worse, *found.better)]
    # Those that the page plays can be chosen where they are named.
    numbers = {str(one.pair.ids[0]): str(2 * k + 1) for k, one in enumerate(found.examples)}
    chosen = re.findall(r'data-old="(\d+)" data-new="\d+" title="Play scenario (\d+)"', page)
    assert chosen
    assert all(numbers[name] == old for old, name in chosen)
    contents = contents_of(page)
    count = len(found.examples)
    assert 1 <= count <= 5
    assert contents["scenarios"]["id"] == list(range(1, 2 * count + 1))
    assert sorted(contents["recordings"]) == list(range(1, 2 * count + 1))
    first = found.examples[0].pair
    assert contents["called"]["1"] == f"Old: scenario {first.ids[0]} of old.db"
    assert contents["called"]["2"] == f"New: scenario {first.ids[1]} of new.db"
    assert contents["scenarios"]["scores"]["wttc"][:2] == pytest.approx(list(first.scores["wttc"]), abs=1e-3)
    # Of each point of a chart: who it is, and what it was.
    moved = [one for one in found.pairs if one.scores["wttc"][0] != one.scores["wttc"][1]]
    assert found.scores[0].moved == len(moved) > 0
    for one in moved:
        old, new = one.scores["wttc"]
        assert f"<title>{one.ids[0]}, {one.ids[1]}: {old:.4g} → {new:.4g}</title>" in page
    assert not re.search(r"(src|href)=.?(https?:|//)", page)


@pytest.mark.slow
def test_the_same_comparison_gives_the_same_bytes(versions, tmp_path):
    pages = [page_of(versions, tmp_path / one) for one in ("a.html", "b.html")]
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_versions_that_do_not_differ_have_a_page_too(versions, tmp_path):
    old, _ = versions
    result = CliRunner().invoke(app, ["compare", str(old), str(old), "-o", str(tmp_path / "page.html")])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<h2>The same</h2>" in page
    assert "<p>All 30 scenarios that both ran have identical recordings</p>" in page
    assert 'id="replay"' not in page


def test_it_is_not_written_over_a_study(versions):
    old, new = versions
    with pytest.raises(InputError):
        write_comparison(cc.compare(old, new), old, new, new)


def test_its_scripts_share_one_scope():
    web = importlib.resources.files("cornercase.report.web")
    scripts = [web.joinpath(one).read_text(encoding="utf-8") for one in versions_page._SCRIPTS]
    names = Counter(name for script in scripts for name in DECLARED.findall(script))
    assert [name for name, count in names.items() if count > 1] == []
    assert all(script.startswith('"use strict";') for script in scripts)
