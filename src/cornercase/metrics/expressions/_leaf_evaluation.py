"""Evaluation of the bounds (``ttc < 1``) and statements (``collision``) of an expression in one run."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics._distance import Clearance
from cornercase.metrics._outcome import Fault
from cornercase.metrics.expressions._ast import (
    Bound,
    EgoCollides,
    EgoLeaves,
    EgoReaches,
    Leaf,
    ReferenceCollides,
    Signal,
)
from cornercase.metrics.expressions._recorded_signals import Signals
from cornercase.recordings import Collision, Recording

TIME_TOLERANCE: Final = 1e-6
"""Tolerance of a simulator's clock in s, and of a driven distance in m."""


class LeafValues(NamedTuple):
    """Margin and truth (1 or -1) of a bound (``ttc < 1``) or a statement (``collision``) at each of T instants.

    Both arrays have the shape (T,), with NaN where a bound is undefined. `is_known` is False if a bound is undefined at
    all instants, or if it is unknown whether a statement is true, for example without the run of a reference driver.
    """

    margin: FloatArray
    truth: FloatArray
    is_known: bool


def evaluate_leaf(leaf: Leaf, signals: Signals) -> LeafValues:
    """Compute margin and truth of a bound (``ttc < 1``) or a statement (``collision``) at each instant.

    Raises InputError if a statement needs a recording and the signals have none.
    """
    if isinstance(leaf, Bound):
        return _evaluate_bound(leaf, signals)
    if isinstance(leaf, ReferenceCollides):
        collides = signals.references.get(leaf.driver)
        truth = np.full(signals.time.shape, 1.0 if collides else -1.0)
        return LeafValues(truth * np.inf, truth, collides is not None)
    if isinstance(leaf, EgoLeaves):
        margin = 0.0 - signals.values[leaf.metric]
        truth = np.where(margin > 0.0, 1.0, -1.0)
        is_known = not np.isnan(margin).all()
        return LeafValues(np.where(np.isnan(margin), -np.inf, margin), truth, is_known)
    recording = recording_of(signals)
    if isinstance(leaf, EgoCollides):
        return _evaluate_collision(leaf, signals, recording)
    if isinstance(leaf, EgoReaches):
        return _evaluate_position(leaf, recording, signals.ego)
    margin = driven_distance(recording, signals.ego) - leaf.distance
    truth = np.where(margin >= -TIME_TOLERANCE, 1.0, -1.0)
    return LeafValues(margin, truth, bool(is_present(recording, signals.ego).any()))


def _evaluate_bound(bound: Bound, signals: Signals) -> LeafValues:
    left = bound.left.values(signals)
    right = bound.right.values(signals) if isinstance(bound.right, Signal) else np.full_like(left, bound.right)
    # The difference of two infinite values would be NaN, though they are equal.
    same = left == right
    gap = np.where(same, 0.0, left - np.where(same, 0.0, right))
    margin = gap if bound.is_lower else 0.0 - gap
    reached = margin >= 0.0 if bound.relation in ("<=", ">=") else margin > 0.0
    truth = np.where(np.isnan(margin), np.nan, np.where(reached, 1.0, -1.0))
    return LeafValues(margin, truth, not bool(np.isnan(margin).all()))


def recording_of(signals: Signals) -> Recording:
    """Return the recording of the signals; InputError if they have none."""
    if signals.recording is None:
        raise InputError(
            "These signals have no recording, but statements on collisions, positions and driven distances need one;"
            " make the signals with `signals_from_recording`."
        )
    return signals.recording


def is_present(recording: Recording, ego: str, entity: str = "") -> BoolArray:
    """Return whether the ego, and `entity` if it is not empty, exists at each instant, shape (T,)."""
    rows = [recording.entity_index(name) for name in (ego, entity) if name]
    return np.asarray(np.isfinite(recording.x[rows]).all(axis=0))


def find_collisions(statement: EgoCollides, signals: Signals) -> list[Collision]:
    """Return the collisions in the recording to which a statement applies, in order of time."""
    return [
        collision
        for collision in recording_of(signals).collisions
        if signals.ego in collision.entities
        and (not statement.entity or statement.entity in collision.entities)
        and (not statement.at_fault or fault_of(collision, signals).who in ("ego", "both"))
    ]


def fault_of(collision: Collision, signals: Signals) -> Fault:
    """Return whose fault a collision of the ego is; the verdict is stored in the signals and found only once."""
    if collision not in signals.faults:
        from cornercase.metrics.fault._find_fault import find_fault

        signals.faults[collision] = find_fault(recording_of(signals), signals.ego, collision)
    return signals.faults[collision]


def driven_distance(recording: Recording, ego: str) -> FloatArray:
    """Return the distance in m that the ego has driven until each instant, shape (T,)."""
    i = recording.entity_index(ego)
    steps = np.hypot(np.diff(recording.x[i], prepend=np.nan), np.diff(recording.y[i], prepend=np.nan))
    return np.asarray(np.cumsum(np.where(np.isfinite(steps), steps, 0.0)))


def distance_within_time_limit(statement: EgoReaches, recording: Recording, ego: str) -> FloatArray:
    """Return the distance in m between the ego's box centre and the position that it has to reach, shape (T,).

    NaN after the time limit of the statement, and at instants at which the ego does not exist.
    """
    distances = np.hypot(*(recording.box_center(ego) - (statement.x, statement.y)).T)
    elapsed = recording.time - recording.time[0]
    return np.where((elapsed <= statement.time_limit + TIME_TOLERANCE) & np.isfinite(distances), distances, np.nan)


def _evaluate_collision(statement: EgoCollides, signals: Signals, recording: Recording) -> LeafValues:
    ego, metric = signals.ego, Clearance()
    others = (statement.entity,) if statement.entity else signals.others
    courses = (metric.course(recording, ego, name) for name in others if name in recording.names)
    clearances = [metric.clip_course(course) for course in courses]
    margin = 0.0 - np.minimum.reduce([np.full(recording.time.shape, metric.cap), *clearances])
    truth = np.full(recording.time.shape, -1.0)
    hits = find_collisions(statement, signals)
    for collision in hits:
        instant = int(np.abs(recording.time - collision.time).argmin())
        margin[instant], truth[instant] = 0.0, 1.0
    is_known = bool(is_present(recording, ego, statement.entity).any())
    if statement.at_fault and not hits:
        any_hits = find_collisions(replace(statement, at_fault=False), signals)
        is_known &= all(fault_of(collision, signals).who != "undecided" for collision in any_hits)
    return LeafValues(margin, truth, is_known)


def _evaluate_position(statement: EgoReaches, recording: Recording, ego: str) -> LeafValues:
    distances = distance_within_time_limit(statement, recording, ego)
    margin = np.where(np.isnan(distances), -np.inf, statement.radius - distances)
    truth = np.where(margin >= 0.0, 1.0, -1.0)
    # An ego that left the scenario before its end can no longer arrive.
    could_arrive = (
        recording.time[-1] - recording.time[0] < statement.time_limit - TIME_TOLERANCE
        and is_present(recording, ego)[-1]
    )
    is_observed = not np.isnan(distances).all() and not could_arrive
    return LeafValues(margin, truth, bool((truth > 0.0).any() or is_observed))
