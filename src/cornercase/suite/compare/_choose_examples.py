"""Choose example scenarios that show what changed between two versions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics import Metric
from cornercase.suite.compare._comparison import Example, ScenarioPair
from cornercase.suite.compare._significance import change_direction, score_difference

MAX_EXAMPLES: Final = 5
"""Largest number of example scenarios."""

# Smallest change of a score that is considered, relative to the largest one of its tier.
_MIN_RELATIVE_SIZE: Final = 0.5
# RMS difference of the parameters in the unit cube, below which an example would be redundant.
_MIN_DISTANCE: Final = 0.05
# Importance of a change, 0 is most important, and whether it is for the better.
_ChangeTier: TypeAlias = tuple[int, bool]


def choose_examples(
    pairs: Sequence[ScenarioPair], metrics: Mapping[str, Metric], objective_metric: str = ""
) -> tuple[Example, ...]:
    """Choose at most `MAX_EXAMPLES` scenarios that show what changed, spread over the parameter space.

    Changes are ranked by kind: first verdicts and runs that failed with one version only, then collisions, outcomes,
    criticality, and scores. Within a kind, changes for the worse come first. Among changes of equal rank, the largest
    is chosen first. From those at least half as large, the scenario whose parameters differ most from the examples so
    far is chosen next, and so on. The size of a score's change is relative to the spread of the old scores.
    `objective_metric` is the metric that defines criticality; it is empty if several do.
    """
    spreads = _old_score_spreads(pairs, metrics)
    tiers: dict[_ChangeTier, list[tuple[float, ScenarioPair, str]]] = {}
    for pair in pairs:
        tier, size, reason = _classify_change(pair, spreads, metrics, objective_metric)
        if reason:
            tiers.setdefault(tier, []).append((size, pair, reason))
    chosen: list[Example] = []
    for tier in sorted(tiers):
        candidates = sorted(tiers[tier], key=lambda item: (-item[0], item[1].ids))
        candidates = [candidate for candidate in candidates if candidate[0] >= _MIN_RELATIVE_SIZE * candidates[0][0]]
        n_before = len(chosen)
        while candidates and len(chosen) < MAX_EXAMPLES:
            distances = [_distance_to_chosen(candidate[1], chosen) for candidate in candidates]
            # The first of a tier is its largest change, unless that is redundant.
            is_first = not chosen or (candidates[0][0] > 0.0 and len(chosen) == n_before)
            index = 0 if is_first and distances[0] >= _MIN_DISTANCE else int(np.argmax(distances))
            if distances[index] < _MIN_DISTANCE:
                break
            _, pair, reason = candidates.pop(index)
            chosen.append(Example(pair, reason))
        if len(chosen) >= MAX_EXAMPLES:
            break
    return tuple(chosen)


def _distance_to_chosen(pair: ScenarioPair, chosen: Sequence[Example]) -> float:
    """Return the RMS difference of parameters, in the unit cube, to the nearest chosen example; inf without any."""
    point = np.array(pair.point)
    return min(
        (float(np.sqrt(np.mean((point - np.array(example.pair.point)) ** 2))) for example in chosen), default=np.inf
    )


def _old_score_spreads(pairs: Sequence[ScenarioPair], metrics: Iterable[str]) -> dict[str, float]:
    """Return the spread of the old scores by metric: half the range of the middle 90 %; if 0, the full range.

    If the full range is 0, too, or no score is finite, the spread is 1.
    """
    both_ran = [pair for pair in pairs if pair.both_ran]
    spreads = {}
    for name in metrics if both_ran else ():
        scores: FloatArray = np.array([pair.scores[name][0] for pair in both_ran])
        scores = scores[np.isfinite(scores)]
        low, high = np.quantile(scores, (0.05, 0.95)).tolist() if len(scores) else (0.0, 0.0)
        spreads[name] = (high - low) / 2.0 or float(np.ptp(scores) if len(scores) else 0.0) or 1.0
    return spreads


def _classify_change(
    pair: ScenarioPair, spreads: Mapping[str, float], metrics: Mapping[str, Metric], objective_metric: str
) -> tuple[_ChangeTier, float, str]:
    """Return the rank (tier), size and description of a pair's change; the description is empty if nothing changed."""
    if pair.run == "not in one":
        failing = "old" if pair.errors[0] is not None else "new"
        return (0, failing == "old"), 0.0, f"failed with the {failing} version"
    if not pair.both_ran:
        return (9, True), 0.0, ""
    size, description, worse = _largest_score_change(pair, spreads, metrics)
    if pair.changed_verdicts:
        # Prefer one that newly fails.
        old, new = min(pair.changed_verdicts, key=lambda verdicts: verdicts[1].state != "failed")
        return (0, new.state != "failed"), size, f"{old.requirement}: {old.state}, now {new.state}"
    ending = f"{pair.outcomes[0]}; now {pair.outcomes[1]}"
    if pair.collides[0] != pair.collides[1]:
        return (1, pair.collides[0]), size, ending
    if pair.outcomes[0] != pair.outcomes[1]:
        return (2, not worse), size, ending
    if pair.is_critical is not None and pair.is_critical[0] != pair.is_critical[1]:
        reason = (
            _describe_score_change(objective_metric, metrics[objective_metric], *pair.scores[objective_metric])
            if objective_metric
            else description
        )
        return (
            (3, pair.is_critical[0]),
            size,
            f"{'critical now' if pair.is_critical[1] else 'no longer critical'}, {reason}",
        )
    return (4, not worse), size, description


def _largest_score_change(
    pair: ScenarioPair, spreads: Mapping[str, float], metrics: Mapping[str, Metric]
) -> tuple[float, str, bool]:
    """Return a pair's largest score change: size relative to the spread, description, and whether it is worse."""
    largest, description, worse = 0.0, "", False
    for name, spread in spreads.items():
        old, new = pair.scores[name]
        (change,) = np.abs(score_difference(np.array([old]), np.array([new]))).tolist()
        if change / spread > largest:
            metric = metrics[name]
            largest, description = change / spread, _describe_score_change(name, metric, old, new)
            worse = change_direction(metric, new - old) == "worse"
    return largest, description, worse


def _describe_score_change(name: str, metric: Metric, old: float, new: float) -> str:
    return f"{name} {old:.4g} → {new:.4g} {'' if metric.unit == '1' else metric.unit}".rstrip()
