"""Tests of whether two versions differ, for scores with caps and ties, and for what is so or not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics import METRICS
from cornercase.suite.comparing_results import ChangeTest, Direction, Pair
from cornercase.suite.verdict import Verdict

FEWEST: Final = 20
"""Scenarios that fill the space, from which shares of it are told."""

# Part of its size by which a score may move and still counts as the same.
_ROUNDING: Final = 1e-9


def moved_by(before: FloatArray, after: FloatArray) -> FloatArray:
    """Differences of scores, 0 where they are the same but for rounding.

    Parameters
    ----------
    before, after : ndarray of float64, shape (n,)
        Finite.

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    found = after - before
    size = np.maximum(np.maximum(np.abs(before), np.abs(after)), 1.0)
    return np.where(np.abs(found) <= _ROUNDING * size, 0.0, found)


def signed_ranks(differences: FloatArray) -> float:
    """Test whether differences of pairs lie around 0, by Wilcoxon's signed-rank test.

    Pairs that did not move are left out, as Wilcoxon did: where scores stay at a cap or at 0 they say nothing of which
    version scores lower. Ties get their mean rank. What a cap cuts off makes a difference smaller, and keeps its sign.

    Parameters
    ----------
    differences : ndarray of float64, shape (n,)

    Returns
    -------
    float
        Two-sided p; 1 where none moved.

    Notes
    -----
    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945); by `scipy.stats.wilcoxon`,
    which is exact for few pairs, by all ways to choose their signs where there are ties.
    """
    moved = differences[differences != 0.0]
    if not len(moved):
        return 1.0
    from scipy.stats import wilcoxon

    return float(wilcoxon(moved).pvalue)


def discordant(before: BoolArray, after: BoolArray) -> float:
    """Test whether something is so as often before as after, in pairs: McNemar's test, exact.

    Parameters
    ----------
    before, after : ndarray of bool, shape (n,)

    Returns
    -------
    float
        Two-sided p; 1 where no pair changed.

    Notes
    -----
    Q. McNemar, "Note on the sampling error of the difference between correlated proportions or percentages",
    Psychometrika 12 (1947), with the binomial distribution in place of its limit.
    """
    from scipy.stats import binomtest

    gained, lost = int((after & ~before).sum()), int((before & ~after).sum())
    return float(binomtest(gained, gained + lost).pvalue) if gained + lost else 1.0


def correct(tests: Sequence[ChangeTest]) -> tuple[ChangeTest, ...]:
    """Correct the p of tests for their number, so that one of several is as rarely wrong as a single one.

    Parameters
    ----------
    tests : sequence of ChangeTest

    Returns
    -------
    tuple of ChangeTest
        In the same order.

    Notes
    -----
    S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6 (1979).
    """
    order = np.argsort([one.p for one in tests], kind="stable").tolist()
    found, least = list(tests), 0.0
    for rank, k in enumerate(order):
        least = max(least, min((len(tests) - rank) * tests[k].p, 1.0))
        found[k] = replace(tests[k], corrected=least)
    return tuple(found)


def tests_of_pairs(pairs: Sequence[Pair], metrics: Sequence[str]) -> list[ChangeTest]:
    """Test pairs of scenarios.

    Parameters
    ----------
    pairs : sequence of Pair
        At least one.
    metrics : sequence of str

    Returns
    -------
    list of ChangeTest
        Not corrected yet.
    """
    ran = [one for one in pairs if one.ran]
    found = []
    for name in metrics if ran else ():
        scores = np.array([one.scores[name] for one in ran])
        differences = moved_by(scores[:, 0], scores[:, 1])
        differ = int((differences != 0.0).sum())
        p, direction = signed_ranks(differences), _direction(name, _sum_of_ranks(differences))
        method, shift = "Wilcoxon signed-rank", float(differences.mean())
        found.append(ChangeTest(name, method, len(ran), len(ran), differ, p, p, direction, shift))
    facts: dict[str, list[tuple[bool, bool]]] = {"collision": [one.collides for one in ran]}
    facts["critical"] = [one.critical for one in ran if one.critical is not None]
    judged = [one.verdicts for one in ran if one.verdicts[0]]
    facts["failed verdict"] = [(_failed(old), _failed(new)) for old, new in judged]
    if len(ran) < len(pairs):
        facts["not run"] = [(one.errors[0] is not None, one.errors[1] is not None) for one in pairs]
    for about, states in facts.items():
        if states:
            before, after = np.array(states, dtype=np.bool_).T
            p = discordant(before, after)
            differ, shift = int((before != after).sum()), float(after.mean() - before.mean())
            count, direction = len(states), _direction("", -shift)
            found.append(ChangeTest(about, "exact McNemar", count, count, differ, p, p, direction, shift))
    return found


def _sum_of_ranks(differences: FloatArray) -> float:
    """Sum of the ranks of what moved up, less that of what moved down: what Wilcoxon's test looks at."""
    from scipy.stats import rankdata

    moved = differences[differences != 0.0]
    return float((np.sign(moved) * rankdata(np.abs(moved))).sum()) if len(moved) else 0.0


def _direction(metric: str, moved: float) -> Direction | None:
    """Whether a move of scores is for the worse; without a metric, less is worse."""
    oriented = METRICS.create(metric).oriented(moved) if metric else moved
    return "worse" if oriented < 0.0 else "better" if oriented > 0.0 else None


def _failed(verdicts: Sequence[Verdict]) -> bool:
    return any(one.state == "failed" for one in verdicts)


def tests_of_samples(
    scores: tuple[dict[str, FloatArray], dict[str, FloatArray]],
    facts: tuple[dict[str, BoolArray], dict[str, BoolArray]],
) -> list[ChangeTest]:
    """Test scenarios of each study that fill the space, where these are not the same ones.

    Points of a Sobol' sequence lie more evenly than random ones, so that the tests say that something changed more
    rarely than they may.

    Parameters
    ----------
    scores : tuple of (dict, dict) of str to ndarray of float64, shape (n,)
        By metric.
    facts : tuple of (dict, dict) of str to ndarray of bool, shape (n,)
        What is so or not, by name.

    Returns
    -------
    list of ChangeTest
        Not corrected yet.

    Notes
    -----
    H. B. Mann, D. R. Whitney, "On a test of whether one of two random variables is stochastically larger than the
    other", Annals of Mathematical Statistics 18 (1947); R. A. Fisher, "The design of experiments" (1935).
    """
    from scipy.stats import fisher_exact, mannwhitneyu

    found = []
    for name, old in scores[0].items():
        new = scores[1][name]
        same = len(np.unique(np.concatenate([old, new]))) < 2
        test = None if same else mannwhitneyu(old, new)
        p = 1.0 if test is None else float(test.pvalue)
        # Pairs of an old and a new score in which the new one is higher, less half of all.
        lead = 0.0 if test is None else len(old) * len(new) / 2.0 - float(test.statistic)
        direction, shift = _direction(name, lead), float(new.mean() - old.mean())
        found.append(ChangeTest(name, "Mann-Whitney", len(old), len(new), None, p, p, direction, shift))
    for name, before in facts[0].items():
        after = facts[1][name]
        table = np.array([[one.sum(), (~one).sum()] for one in (before, after)], dtype=np.int64)
        p, shift = float(fisher_exact(table).pvalue), float(after.mean() - before.mean())
        direction = _direction("", -shift)
        found.append(ChangeTest(name, "exact Fisher", len(before), len(after), None, p, p, direction, shift))
    return found
