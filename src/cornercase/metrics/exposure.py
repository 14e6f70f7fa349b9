"""For how long, and by how much, a recording was below a time to collision."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from cornercase.errors import InputError, suggestion
from cornercase.metrics.base import PairMetric, checked
from cornercase.metrics.ttc import Ttc
from cornercase.recording import Recording
from cornercase.typing import FloatArray

Rule = Literal["linear", "samples"]


class Tet(PairMetric):
    """Time exposed time to collision: for how long the time to collision has been at most τ.

    ``∫ 1[TTC <= τ] dt`` in s, from the beginning up to each instant, so the course never falls and ends in the
    value of the recording; the time to collision is that of `Ttc`. Defined wherever there are instants: while
    one of the two does not exist nothing is added, and two that stand apart add nothing. Cap: 0 s.

    Parameters
    ----------
    threshold : float, default 1.5
        τ in s.
    rule : {"linear", "samples"}, default "linear"
        How to sum up between the instants: the time to collision changes evenly, or each instant counts for the
        step that follows it (the last for as long as the one before).

    Notes
    -----
    Source: M. M. Minderhoud, P. H. L. Bovy, "Extended time-to-collision measures for road traffic safety
    assessment", Accident Analysis and Prevention 33 (2001).
    """

    name = "tet"
    unit = "s"
    lower_is_critical = False
    cap = 0.0
    source = "Minderhoud and Bovy 2001"

    def __init__(self, threshold: float = 1.5, rule: Rule = "linear") -> None:
        self.threshold, self.rule = _options(self.name, threshold, rule)

    def _course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        below = _shortfall(recording, ego, other, self.threshold)
        if self.rule == "samples":
            return _samples(recording.time, (below >= 0.0).astype(np.float64))
        before, after = below[:-1], below[1:]
        low, high = np.minimum(before, after), np.maximum(before, after)
        crosses = (low < 0.0) & (high > 0.0)
        # Towards a time to collision of inf the straight line leaves the threshold at once.
        part = np.where(crosses, high / _between(low, high), (low >= 0.0).astype(np.float64))
        return np.append(0.0, np.cumsum(part * np.diff(recording.time)))


class Tit(PairMetric):
    """Time integrated time to collision: for how long, and by how much, it has been below τ.

    ``∫ (τ - TTC)₊ dt`` in s², from the beginning up to each instant, so the course never falls and ends in the
    value of the recording; the time to collision is that of `Ttc`. Defined wherever there are instants: while
    one of the two does not exist nothing is added, and two that stand apart add nothing. Cap: 0 s².

    Parameters
    ----------
    threshold : float, default 1.5
        τ in s.
    rule : {"linear", "samples"}, default "linear"
        How to sum up between the instants, as in `Tet`.

    Notes
    -----
    Source: M. M. Minderhoud, P. H. L. Bovy, "Extended time-to-collision measures for road traffic safety
    assessment", Accident Analysis and Prevention 33 (2001).
    """

    name = "tit"
    unit = "s²"
    lower_is_critical = False
    cap = 0.0
    source = "Minderhoud and Bovy 2001"

    def __init__(self, threshold: float = 1.5, rule: Rule = "linear") -> None:
        self.threshold, self.rule = _options(self.name, threshold, rule)

    def _course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        below = _shortfall(recording, ego, other, self.threshold)
        if self.rule == "samples":
            return _samples(recording.time, np.maximum(below, 0.0))
        before, after = below[:-1], below[1:]
        low, high = np.minimum(before, after), np.maximum(before, after)
        crosses = (low < 0.0) & (high > 0.0)
        triangle = 0.5 * np.where(crosses, high, 0.0) ** 2 / _between(low, high)
        mean = np.where(crosses, triangle, np.maximum(0.5 * (np.maximum(low, 0.0) + high), 0.0))
        return np.append(0.0, np.cumsum(mean * np.diff(recording.time)))


def _options(name: str, threshold: float, rule: Rule) -> tuple[float, Rule]:
    checked(name, threshold=threshold)
    if rule not in get_args(Rule):
        raise InputError(f"{name} has no rule '{rule}'; {suggestion(rule, get_args(Rule))}")
    return threshold, rule


def _shortfall(recording: Recording, ego: str, other: str, threshold: float) -> FloatArray:
    """How far the time to collision is below the threshold, (T,); negative above it, -inf for never."""
    below = threshold - Ttc().course(recording, ego, other)
    return np.where(np.isnan(below), -np.inf, below)


def _between(low: FloatArray, high: FloatArray) -> FloatArray:
    """Difference where the line from `low` to `high` crosses the threshold, 1 elsewhere."""
    crosses = (low < 0.0) & (high > 0.0)
    return np.where(crosses, np.where(crosses, high, 1.0) - np.where(crosses, low, 0.0), 1.0)


def _samples(time: FloatArray, values: FloatArray) -> FloatArray:
    """Sum of values up to each instant, each times the step that follows it."""
    steps = np.diff(time)
    steps = np.append(steps, steps[-1:] if len(steps) else 0.0)
    return np.cumsum(values * steps)
