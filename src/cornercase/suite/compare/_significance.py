"""Significance tests for differences between two versions, in scores (also capped or equal ones) and yes/no facts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.evidence import CriticalSetDifference
from cornercase.metrics import Metric
from cornercase.suite._verdict import Verdict
from cornercase.suite.compare._comparison import CRITICAL_SETS_METHOD, ChangeDirection, ChangeTest, ScenarioPair

MIN_SAMPLE_SIZE: Final = 20
"""Smallest number of space-filling scenarios for estimates and tests."""

# Relative change of a score that counts as rounding.
_RELATIVE_ROUNDING: Final = 1e-9


def score_difference(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the differences of finite scores, shape (n,); scores that are equal up to rounding differ by 0."""
    change = after - before
    size = np.maximum(np.maximum(np.abs(before), np.abs(after)), 1.0)
    return np.where(np.abs(change) <= _RELATIVE_ROUNDING * size, 0.0, change)


def wilcoxon_p_value(differences: FloatArray) -> float:
    """Return the two-sided p-value of Wilcoxon's signed-rank test that differences, shape (n,), are centered on 0.

    Differences of 0 are left out, as in Wilcoxon's paper: if both versions score 0, or both score the cap (the limit of
    the metric's scores), nobody can say which version is better. Differences of equal size get their mean rank. A cap
    can shrink a difference, but never changes its sign. p is 1 if all differences are 0.

    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945). For few pairs the test is
    exact: `scipy.stats.wilcoxon` enumerates all signs if there are ties.
    """
    moved = differences[differences != 0.0]
    if not len(moved):
        return 1.0
    from scipy.stats import wilcoxon

    return float(wilcoxon(moved).pvalue)


def mcnemar_p_value(before: BoolArray, after: BoolArray) -> float:
    """Return the two-sided p-value of McNemar's exact test of paired yes/no facts, shape (n,); 1 if no pair changed.

    Q. McNemar, "Note on the sampling error of the difference between correlated proportions or percentages",
    Psychometrika 12 (1947), with the binomial distribution instead of its limit.
    """
    from scipy.stats import binomtest

    gained, lost = int((after & ~before).sum()), int((before & ~after).sum())
    return float(binomtest(gained, gained + lost).pvalue) if gained + lost else 1.0


def holm_correct(tests: Sequence[ChangeTest]) -> tuple[ChangeTest, ...]:
    """Correct the p-values of several tests by Holm's weighted method; the order of the tests stays.

    The test of the critical sets has as much weight as all other tests together, since only this test uses all
    scenarios of both studies.

    S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6 (1979),
    section 4.
    """
    are_sets = np.array([test.method == CRITICAL_SETS_METHOD for test in tests], dtype=np.bool_)
    weights = np.where(are_sets, max(np.count_nonzero(~are_sets), 1), 1)
    weighted = np.array([test.p for test in tests]) / weights
    corrected, smallest, rest = list(tests), 0.0, weights.sum()
    for k in np.argsort(weighted, kind="stable").tolist():
        smallest = max(smallest, min(float(rest * weighted[k]), 1.0))
        corrected[k] = replace(tests[k], corrected=smallest)
        rest -= weights[k]
    return tuple(corrected)


def test_pairs(pairs: Sequence[ScenarioPair], metrics: Mapping[str, Metric]) -> list[ChangeTest]:
    """Test whether scores and facts, such as collisions, differ between the versions; p-values are not corrected."""
    both_ran = [pair for pair in pairs if pair.both_ran]
    results = []
    for name in metrics if both_ran else ():
        scores = np.array([pair.scores[name] for pair in both_ran])
        differences = score_difference(scores[:, 0], scores[:, 1])
        differ = int((differences != 0.0).sum())
        p, direction = wilcoxon_p_value(differences), change_direction(metrics[name], _signed_rank_sum(differences))
        method, shift = "Wilcoxon signed-rank", float(differences.mean())
        results.append(ChangeTest(name, method, len(both_ran), len(both_ran), differ, p, p, direction, shift))
    facts: dict[str, list[tuple[bool, bool]]] = {"collision": [pair.collides for pair in both_ran]}
    facts["critical"] = [pair.is_critical for pair in both_ran if pair.is_critical is not None]
    verdicts = [pair.verdicts for pair in both_ran if pair.verdicts[0]]
    facts["failed verdict"] = [(_has_failed_verdict(old), _has_failed_verdict(new)) for old, new in verdicts]
    if len(both_ran) < len(pairs):
        facts["not run"] = [(pair.errors[0] is not None, pair.errors[1] is not None) for pair in pairs]
    for about, states in facts.items():
        if states:
            before, after = np.array(states, dtype=np.bool_).T
            p = mcnemar_p_value(before, after)
            differ, shift = int((before != after).sum()), float(after.mean() - before.mean())
            count, direction = len(states), change_direction(None, shift)
            results.append(ChangeTest(about, "exact McNemar", count, count, differ, p, p, direction, shift))
    return results


def _signed_rank_sum(differences: FloatArray) -> float:
    """Return the statistic of Wilcoxon's test: the rank sum of increases minus the rank sum of decreases."""
    from scipy.stats import rankdata

    moved = differences[differences != 0.0]
    return float((np.sign(moved) * rankdata(np.abs(moved))).sum()) if len(moved) else 0.0


def change_direction(metric: Metric | None, change: float) -> ChangeDirection | None:
    """Tell whether a change is better or worse; None for no change.

    Without a metric, the change is one of the proportion of bad scenarios, so an increase is worse.
    """
    oriented = -change if metric is None else metric.to_minimize(change)
    return "worse" if oriented < 0.0 else "better" if oriented > 0.0 else None


def _has_failed_verdict(verdicts: Sequence[Verdict]) -> bool:
    return any(verdict.state == "failed" for verdict in verdicts)


def test_unpaired_samples(
    scores: tuple[dict[str, FloatArray], dict[str, FloatArray]],
    facts: tuple[dict[str, BoolArray], dict[str, BoolArray]],
    metrics: Mapping[str, Metric],
    sets: CriticalSetDifference | None,
) -> list[ChangeTest]:
    """Test whether scores and yes/no facts differ between two samples of the space, one per study, without pairs.

    For each study, `scores` has an array of shape (n,) by metric, and `facts` by name ("collision", "critical"). Points
    of a Sobol' sequence are more even than random points, so the tests are conservative. If `sets` is given, the change
    of the critical set is tested instead of the fact "critical", since `sets` uses all scenarios of both studies.
    p-values are not corrected.

    H. B. Mann, D. R. Whitney, "On a test of whether one of two random variables is stochastically larger than the
    other", Annals of Mathematical Statistics 18 (1947); R. A. Fisher, "The design of experiments" (1935).
    """
    from scipy.stats import fisher_exact, mannwhitneyu

    results = []
    for name, old in scores[0].items():
        new = scores[1][name]
        is_constant = len(np.unique(np.concatenate([old, new]))) < 2
        result = None if is_constant else mannwhitneyu(old, new)
        p = 1.0 if result is None else float(result.pvalue)
        # Number of (old, new) pairs with a higher new score, minus half of all.
        lead = 0.0 if result is None else len(old) * len(new) / 2.0 - float(result.statistic)
        direction, shift = change_direction(metrics[name], lead), float(new.mean() - old.mean())
        results.append(ChangeTest(name, "Mann-Whitney", len(old), len(new), None, p, p, direction, shift))
    for name, before in facts[0].items():
        after = facts[1][name]
        if name == "critical" and sets is not None:
            method, p, shift = CRITICAL_SETS_METHOD, sets.p, sets.change.value
        else:
            table = np.array([[facts_.sum(), (~facts_).sum()] for facts_ in (before, after)], dtype=np.int64)
            method, p = "exact Fisher", float(fisher_exact(table).pvalue)
            shift = float(after.mean() - before.mean())
        direction = change_direction(None, shift)
        results.append(ChangeTest(name, method, len(before), len(after), None, p, p, direction, shift))
    return results
