"""The page of a comparison of two versions."""

from __future__ import annotations

import importlib.resources
import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import cornercase as cc
from cornercase import InputError
from cornercase.cli import app
from cornercase.drivers import NORMAL, BehaviourDriver
from cornercase.metrics import METRICS
from cornercase.recordings import Collision
from cornercase.report import write_comparison
from cornercase.report.comparison import _comparison_page as versions_page
from cornercase.report.comparison._charts import draw_charts
from cornercase.report.comparison._replayed_pairs import _describe_difference
from cornercase.study import StudyFile
from cornercase.suite import ScenarioPair
from helpers.synthetic_study import SPACE, about, explorer
from helpers.two_cars import met

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


@pytest.fixture(scope="module")
def found(versions):
    return cc.compare(*versions)


@pytest.fixture(scope="module")
def page(versions, tmp_path_factory):
    """The page of both, which is written once."""
    return page_of(versions, tmp_path_factory.mktemp("page") / "page.html").read_text(encoding="utf-8")


def contents_of(page):
    found = re.search(r'<script type="application/json" id="contents">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_it_holds_each_telling_scenario_with_both_versions(found, page):
    assert found.reason in page
    assert f"<h2>{found.verdict.capitalize()}: " in page
    shown = re.findall(r"<b>(.*?)</b>: (.*?)</li>", page.partition('id="next"')[0], re.DOTALL)
    told = [(what, re.sub(r"<[^>]*>|\n", "", scenarios)) for what, scenarios in shown]
    assert told == [(one.change_text, one.format_scenario_ids(40)) for one in (*found.worse, *found.better)]
    contents = contents_of(page)
    count = len(found.examples)
    assert 1 <= count <= 5
    # Each pair that differs can be played, and is a link wherever it is named.
    differing = [one.ids for one in found.pairs if one.run != "the same"]
    assert contents["scenarios"]["id"] == sorted(contents["recordings"]) == list(range(1, 2 * len(differing) + 1))
    called = {int(number): name for number, name in contents["called"].items()}
    linked = re.findall(r'href="#pair=(\d+),(\d+)" data-old="(\d+)" title="Play scenario (\d+)"', page)
    named = {ids for one in (*found.worse, *found.better) for ids in one.ids}
    assert named <= {(int(old), int(new)) for old, new, _, _ in linked} <= set(differing)
    assert all(called[int(number)] == f"Old: scenario {old} of old.db" for old, _, number, _ in linked)
    assert count <= len(differing)
    first = found.examples[0].pair
    assert contents["called"]["1"] == f"Old: scenario {first.ids[0]} of old.db"
    assert contents["called"]["2"] == f"New: scenario {first.ids[1]} of new.db"
    assert contents["scenarios"]["scores"]["wttc"][:2] == pytest.approx(list(first.scores["wttc"]), abs=1e-3)
    # Of each point of a chart: who it is, and what it was.
    moved = [one for one in found.pairs if one.scores["wttc"][0] != one.scores["wttc"][1]]
    assert found.scores[0].moved == len(moved) > 0
    for one in moved:
        old, new = one.scores["wttc"]
        number = contents["called"]
        mark = re.search(rf'data-old="(\d+)"[^>]*><title>{one.ids[0]}, {one.ids[1]}: {old:.4g} → {new:.4g}<', page)
        assert mark is not None
        assert number[mark[1]] == f"Old: scenario {one.ids[0]} of old.db"
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
    assert "<h2>The same: nothing is better or worse</h2>" in page
    assert "<p>All 30 scenarios that both ran have identical recordings</p>" in page
    assert 'id="replay"' not in page


def test_it_says_how_both_were_made_and_what_differs(versions, page):
    origins = page.partition('id="origins"')[2]
    rows = re.findall(r"<tr( class=\"differs\")?><td>(.*?)</td><td>(.*?)</td><td>(.*?)</td>", origins)
    facts = {name: (old, new, bool(differs)) for differs, name, old, new in rows}
    assert facts["study"] == ("old.db", "new.db", False)
    assert [name for name, (_, _, differs) in facts.items() if differs] == ["driver of Ego"]
    assert facts["seed"] == ("1", "1", False)
    assert facts["cornercase that made the study"] == (cc.__version__, cc.__version__, False)
    commands = re.findall(r"<pre tabindex=\"0\"><code>(.*?)</code>", origins, re.DOTALL)
    assert [one.split()[1] for one in commands] == ["explore", "explore", "compare"]
    assert [one.split(" -o ")[1].split()[0] for one in commands] == ["old.db", "new.db", "compare.html"]
    assert str(versions[0].parent) not in page


def test_it_says_what_to_fix_and_what_was_not_tested(found, page):
    steps = re.sub(r"<[^>]*>", "", page.partition('id="next"')[2].partition("</section>")[0])
    fresh = [pair.ids[1] for pair in found.pairs if pair.collides == (False, True)]
    if fresh:
        assert any(f"A new collision ({ident}), with Pedestrian at " in steps for ident in fresh)
    assert "cornercase replay new.db " in steps
    assert "miss a region of 9.5 % of the space with a probability of 5 %" in steps
    assert "Anything outside of the ranges of the parameters" in steps


def test_the_most_important_replays_stay_where_all_are_too_many(versions, found):
    with StudyFile.open(versions[0]) as old, StudyFile.open(versions[1]) as new:
        page = versions_page._render_page(found, old, new, None, max_characters=1)
    first = found.examples[0].pair.ids
    assert set(re.findall(r'href="#pair=(\d+),(\d+)"', page)) == {tuple(map(str, first))}
    n_differing = sum(pair.run != "the same" for pair in found.pairs)
    assert f"{n_differing - 1} more scenarios differ, whose replays would make this page too large" in page
    # An example without a replay is no button.
    assert page.count('aria-pressed="false"><b>') == 1


def test_the_replay_shows_the_collision_of_the_ego_and_not_an_earlier_one_of_others():
    calm = met(ego=(np.linspace(0.0, 3.0, 31), 0.0, 0.0, 1.0), other=(np.full(31, 50.0), 0.0, 0.0, 0.0))
    hits = (Collision(1.0, ("Walker", "Third")), Collision(2.5, ("Ego", "Other")))
    pair = ScenarioPair((1, 1), {}, (0.5,), "otherwise", True, scores={"wttc": (1.0, 0.5)}, collides=(False, True))
    told = _describe_difference(pair, calm, replace(calm, collisions=hits), "Ego", {"wttc": METRICS.create("wttc")})
    assert (told["side"], told["time"]) == (1, 2.5)
    assert "Shown is 2.5 s, when the new version collides" in told["text"]


@pytest.mark.parametrize(
    ("scores", "side", "words"),
    [
        ((1.0, 1.0), 0, "of the old version; the new one has the same scores."),
        ((1.0, 0.5), 1, "of the new version, which is the more critical."),
        ((0.5, 1.0), 0, "of the old version, which is the more critical."),
    ],
)
def test_the_replay_calls_no_version_more_critical_where_the_scores_are_the_same(scores, side, words):
    calm = met(ego=(np.linspace(0.0, 3.0, 31), 0.0, 0.0, 1.0), other=(np.full(31, 50.0), 0.0, 0.0, 0.0))
    pair = ScenarioPair((1, 1), {}, (0.5,), "otherwise", True, scores={"wttc": scores})
    told = _describe_difference(pair, calm, calm, "Ego", {"wttc": METRICS.create("wttc")})
    assert told["side"] == side
    assert told["text"].endswith(words)


def test_scenarios_that_failed_in_both_are_no_change_to_draw(tmp_path):
    path = tmp_path / "s.db"
    with StudyFile.create(path, about(SPACE, "distance", optimizer="sobol", seed=7)) as study:
        explorer(study, optimizer="sobol", budget=16).run()
    same = cc.compare(path, path)
    assert {pair.run for pair in same.pairs} == {"the same", "in neither"}
    assert list(draw_charts(same, SPACE.parameters)) == []


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
