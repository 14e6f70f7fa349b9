"""Audits: scenarios that are drawn at random to assess a search."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explore import explore_config
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.exploration._study_critical_set import audit_sampler, is_score_independent
from cornercase.metrics import METRICS
from cornercase.optimizers import OPTIMIZERS, Optimizer
from cornercase.report import summarize, write_report
from cornercase.report.text._summary_dict import summary_to_dict
from cornercase.scenario import LogicalScenario, ParameterSpace
from cornercase.study import StudyFile
from helpers.synthetic_study import LOGICAL, SPACE, Synthetic

AUDITED: dict[str, Any] = {"optimizer": "bayes", "audit": 0.2, "budget": 60, "metrics": ("distance",), "critical": 1.0}


class Listening(Optimizer):
    """Records everything that an optimizer was told."""

    def __init__(self, inner):
        super().__init__()
        self._inner, self.told, self.name = inner, [], inner.name

    def prepare(self, space, seed):
        raise AssertionError("it has begun")

    def ask(self, n):
        return self._inner.ask(n)

    def tell(self, points, scores):
        self.told.append(points)
        self._inner.tell(points, scores)


def explored(path, simulator=None, **options):
    """Start or resume the exploration of a synthetic scenario with audits."""
    about = ExplorationConfig(LOGICAL, ego="Ego", other="B", seed=7, **AUDITED | options)
    objective = about.make_objective([METRICS.create("distance")])
    optimizer = Listening(about.search.start(SPACE, 7))
    with (
        StudyFile.open(path, readonly=False)
        if path.exists()
        else StudyFile.create(path, about.make_study_meta(objective, {})) as study
    ):
        ScenarioExplorer(about, simulator or Synthetic(), optimizer, study, objective).run()
    return optimizer


def content(path):
    with StudyFile.open(path, readonly=True) as study:
        rows = study.rows()
        return [(r.id, r.round, r.point.tolist(), r.state) for r in rows], study.scores("distance").tolist()


def test_the_search_is_never_told_of_audits_which_are_drawn_at_random(tmp_path):
    told = np.concatenate(explored(tmp_path / "s.db").told)
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        rows = study.rows()
        audits = [row.point for row in rows if study.meta.is_audit(row.id)]
        table = study.table()
    assert (len(rows), len(audits), len(told)) == (60, 12, 48)
    np.testing.assert_array_equal(audits, audit_sampler(SPACE, 7).ask(12))
    np.testing.assert_array_equal(told, [row.point for row in rows if not study.meta.is_audit(row.id)])
    assert table["audit"].sum() == 12
    # Each round contains its fraction of audits.
    assert table.groupby("round")["audit"].sum().eq(2).all()


def test_an_interrupted_study_with_audits_goes_on_the_same(tmp_path):
    explored(tmp_path / "whole.db")
    explored(tmp_path / "parts.db", Synthetic(interrupts=27))
    assert content(tmp_path / "parts.db") != content(tmp_path / "whole.db")
    explored(tmp_path / "parts.db")
    assert content(tmp_path / "parts.db") == content(tmp_path / "whole.db")
    with StudyFile.open(tmp_path / "parts.db", readonly=False) as study:
        other = replace(study.meta, audit=0.1)
        with pytest.raises(InputError, match="another share of audits"):
            study.writer.check_and_update_meta(other)


def test_what_audits_say_is_told(tmp_path):
    explored(tmp_path / "s.db")
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        words = summary_to_dict(summarize(study))["critical"]["audit"]
        scores, audits = study.scores("distance"), study.audit_mask()
    assert (words["scenarios"], words["critical"]) == (audits.sum(), (scores[audits] <= 1.0).sum())
    assert words["share"]["low"] <= words["critical"] / words["scenarios"] <= words["share"]["high"]
    assert "audits alone" in write_report(tmp_path / "s.db", tmp_path / "r.html").read_text(encoding="utf-8")


def test_a_search_stops_by_its_audits_and_only_with_audits(tmp_path):
    one = replace(paper_experiment_config("x-intersection", budget=120), audit=0.5, critical=5.0, optimizer="sobol")
    result = explore_config(replace(one, stop_when=("audited-missed<0.4",)), tmp_path / "s.db")
    assert 80 <= result.n_finished < 120
    assert "according to the audits" in result.reason
    with pytest.raises(InputError, match="needs audits"):
        explore_config(replace(one, audit=0.0, stop_when=("audited-missed<0.4",)), tmp_path / "n.db")
    with pytest.raises(InputError, match="`audit`"):
        replace(one, audit=0.7)


@pytest.mark.parametrize("name", ["sobol", "random", "bayes", "evolutionary", "bayes:filling=0", "grid"])
def test_what_was_chosen_blindly_is_found_again(name):
    optimizer, told = OPTIMIZERS.create(name).start(SPACE, 3, budget=3375), np.zeros((0, 2))
    for _ in range(7):
        points = optimizer.ask(10)
        optimizer.tell(points, synthetic_scores(points))
        told = np.concatenate([told, points])
    blindly = is_score_independent(name, SPACE, 3, told)
    expected = {"bayes": 20 + 15, "bayes:filling=0": 20, "evolutionary": 40}.get(name, 70)
    assert expected <= blindly.sum() <= expected + 1
    # They are independent of scores: the sequence determines them.
    first = OPTIMIZERS.create("random" if name == "random" else "sobol").start(SPACE, 3).ask(20)
    assert name == "grid" or all(any((one == point).all() for point in told[blindly]) for one in first)


def synthetic_scores(points):
    return np.abs(points[:, 0] - points[:, 1])


def test_a_space_that_is_used_up_ends_the_search_though_audits_are_wanted(tmp_path):
    small = LogicalScenario(Path("synthetic.xosc"), ParameterSpace.from_ranges(["a=0:0.8:0.2", "b=0:1:0.5"]), "0")
    about = ExplorationConfig(small, ego="Ego", other="B", seed=7, **AUDITED | {"optimizer": "sobol", "audit": 0.3})
    objective = about.make_objective([METRICS.create("distance")])
    optimizer = OPTIMIZERS.create("sobol").start(small.space, 7)
    with StudyFile.create(tmp_path / "s.db", about.make_study_meta(objective, {})) as study:
        result = ScenarioExplorer(about, Synthetic(), optimizer, study, objective).run()
        searched = [row.point for row in study.rows() if not study.meta.is_audit(row.id)]
    assert "all" in result.reason
    assert len(np.unique(searched, axis=0)) == len(searched) == 15
