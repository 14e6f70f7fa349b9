"""The few scenarios that tell two versions apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics import METRICS
from cornercase.suite.comparing_results import Pair, Telling
from cornercase.suite.comparing_tests import moved_by

MOST: Final = 5
"""Scenarios that tell versions apart, at most."""

# Of those that changed alike in kind, the ones that come into question: part of the largest change of a score.
_CLOSE: Final = 0.5
# Root mean square of the differences of all parameters, in parts of their ranges, below which a scenario shows the
# same thing again.
_NEAR: Final = 0.05
# How important a manner of change is, 0 is most, and whether it is one for the worse: those have False.
_Tier: TypeAlias = tuple[int, bool]


def choose_telling(pairs: Sequence[Pair], metrics: Sequence[str], searched: str = "") -> tuple[Telling, ...]:
    """Choose scenarios that show what changed, spread over the space.

    First those with another verdict, or that ran with one version only; then those of which one collides; then another
    outcome; then critical or not; then a score, in units of the spread of its old scores. Of each manner those come
    first that became worse. Among those that changed in the same manner it begins with the largest change, and goes on
    with the one that is farthest from all that are chosen, of those that changed half as much as the largest or more.

    Parameters
    ----------
    pairs : sequence of Pair
    metrics : sequence of str
    searched : str, default ""
        The one of them whose score says what is critical; empty where several do.

    Returns
    -------
    tuple of Telling
        At most `MOST`.
    """
    spreads = _spreads(pairs, metrics)
    tiers: dict[_Tier, list[tuple[float, Pair, str]]] = {}
    for pair in pairs:
        tier, size, why = _change(pair, spreads, searched)
        if why:
            tiers.setdefault(tier, []).append((size, pair, why))
    chosen: list[Telling] = []
    for tier in sorted(tiers):
        left = sorted(tiers[tier], key=lambda one: (-one[0], one[1].ids))
        left = [one for one in left if one[0] >= _CLOSE * left[0][0]]
        while left and len(chosen) < MOST:
            away = [_distance(one[1], chosen) for one in left]
            # The first of a tier is its largest change, unless that shows again what is there.
            k = 0 if not chosen or (left[0][0] > 0.0 and _first(tier, tiers, chosen)) else int(np.argmax(away))
            if chosen and away[k] < _NEAR:
                k = int(np.argmax(away))
                if away[k] < _NEAR:
                    break
            _, pair, why = left.pop(k)
            chosen.append(Telling(pair, why))
        if len(chosen) >= MOST:
            break
    return tuple(chosen)


def _first(tier: _Tier, tiers: Mapping[_Tier, list[tuple[float, Pair, str]]], chosen: Sequence[Telling]) -> bool:
    of_tier = {id(pair) for _, pair, _ in tiers[tier]}
    return not any(id(one.pair) in of_tier for one in chosen)


def _distance(pair: Pair, chosen: Sequence[Telling]) -> float:
    at = np.array(pair.point)
    return min((float(np.sqrt(np.mean((at - np.array(one.pair.point)) ** 2))) for one in chosen), default=np.inf)


def _spreads(pairs: Sequence[Pair], metrics: Sequence[str]) -> dict[str, float]:
    """Half the range that holds the middle 90 % of the old scores; their whole range where that is 0."""
    ran = [one for one in pairs if one.ran]
    found = {}
    for name in metrics if ran else ():
        scores: FloatArray = np.array([one.scores[name][0] for one in ran])
        scores = scores[np.isfinite(scores)]
        low, high = np.quantile(scores, (0.05, 0.95)).tolist() if len(scores) else (0.0, 0.0)
        found[name] = (high - low) / 2.0 or float(np.ptp(scores) if len(scores) else 0.0) or 1.0
    return found


def _change(pair: Pair, spreads: Mapping[str, float], searched: str) -> tuple[_Tier, float, str]:
    """How important a change is, how large, and what it is in words; no words where nothing changed."""
    if pair.run == "not in one":
        which = "old" if pair.errors[0] is not None else "new"
        return (0, which == "old"), 0.0, f"could not be run with the {which} version"
    if not pair.ran:
        return (9, True), 0.0, ""
    size, moved, worse = _largest(pair, spreads)
    if pair.turned:
        # One that newly fails, if there is one.
        old, new = min(pair.turned, key=lambda one: one[1].state != "failed")
        return (0, new.state != "failed"), size, f"{old.requirement}: {old.state}, now {new.state}"
    tell = f"{pair.outcomes[0]}; now {pair.outcomes[1]}"
    if pair.collides[0] != pair.collides[1]:
        return (1, pair.collides[0]), size, tell
    if pair.outcomes[0] != pair.outcomes[1]:
        return (2, not worse), size, tell
    if pair.critical is not None and pair.critical[0] != pair.critical[1]:
        why = _moved(searched, *pair.scores[searched]) if searched else moved
        return (3, pair.critical[0]), size, f"{'critical now' if pair.critical[1] else 'critical no more'}, {why}"
    return (4, not worse), size, moved


def _largest(pair: Pair, spreads: Mapping[str, float]) -> tuple[float, str, bool]:
    """Largest change of a score in units of its spread, which, and whether it is one for the worse."""
    found, words, worse = 0.0, "", False
    for name, spread in spreads.items():
        old, new = pair.scores[name]
        (change,) = np.abs(moved_by(np.array([old]), np.array([new]))).tolist()
        if change / spread > found:
            found, words = change / spread, _moved(name, old, new)
            metric = METRICS.create(name)
            worse = metric.oriented(new) < metric.oriented(old)
    return found, words, worse


def _moved(name: str, old: float, new: float) -> str:
    unit = METRICS.create(name).unit
    return f"{name} {old:.4g} → {new:.4g} {'' if unit == '1' else unit}".rstrip()
