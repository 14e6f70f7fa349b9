"""Explanation in one sentence why an expression is fulfilled in a run, or not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cornercase._common.text.sanitize import quote_name
from cornercase.metrics._evaluation import Evaluation
from cornercase.metrics._outcome import Fault
from cornercase.metrics.expressions._ast import (
    Bound,
    EgoCollides,
    EgoDrives,
    EgoLeaves,
    EgoReaches,
    Operation,
    ReferenceCollides,
    Statement,
    format_node,
)
from cornercase.metrics.expressions._leaf_evaluation import (
    TIME_TOLERANCE,
    distance_within_time_limit,
    driven_distance,
    fault_of,
    find_collisions,
    is_present,
    recording_of,
)
from cornercase.metrics.expressions._recorded_signals import Signals
from cornercase.recordings import Collision, Recording


class Reason(NamedTuple):
    """Reason why an expression is fulfilled or not.

    `text` is a sentence without full stop. `time` in s is the decisive instant, and `value` the compared value then.
    """

    text: str
    time: float | None = None
    value: float | None = None


def explain(evaluation: Evaluation, reference_texts: Mapping[str, str]) -> Reason:
    """Explain why an expression is fulfilled or not.

    `reference_texts` maps the name of each reference driver to a sentence that says whether the driver collides.
    """
    root, fulfilled = evaluation.root, evaluation.is_fulfilled()
    bounds = {leaf: values for leaf, values in evaluation.leaves.items() if isinstance(leaf, Bound)}
    unobserved = [format_node(bound) for bound, values in bounds.items() if not values.is_known]
    if fulfilled is None and unobserved:
        return Reason(f"what {' and '.join(unobserved)} refers to never occurred")
    if isinstance(root, Bound):
        return _explain_bound(root, evaluation, fulfilled is False)
    if isinstance(root, Operation) and root.operator == "unless":
        statements = [leaf for leaf in root.operands if isinstance(leaf, Statement)]
        collision, reference = (_explain_statement(leaf, evaluation, reference_texts) for leaf in statements)
        collides = collision.time is not None and collision.value is not None
        return collision._replace(text=f"{collision.text}; {reference.text}") if collides else collision
    statement = root.operands[0] if isinstance(root, Operation) and root.operator in ("no", "not") else root
    if isinstance(statement, Statement):
        return _explain_statement(statement, evaluation, reference_texts)
    return _explain_by_decisive_leaf(evaluation, reference_texts)


def _explain_by_decisive_leaf(evaluation: Evaluation, reference_texts: Mapping[str, str]) -> Reason:
    fulfilled = evaluation.is_fulfilled()
    verb = {True: "holds", False: "does not hold", None: "may hold or not"}[fulfilled]
    text = f"'{format_node(evaluation.root)}' {verb}"
    leaf, k = (evaluation.find_decisive_leaf() if fulfilled is not None else None) or (None, 0)
    if isinstance(leaf, Bound):
        at, value = float(evaluation.signals.time[k]), float(leaf.left.values(evaluation.signals)[k])
        left = f"{leaf.left.text} is {leaf.left.format_value(value)} at {at:.6g} s"
        right = leaf.describe_right_side(evaluation.signals, k)
        return Reason(f"{text}: {left}, compared with {right}", at, value)
    statements = [leaf] if leaf is not None else [item for item in evaluation.leaves if isinstance(item, Statement)]
    reasons = [_explain_statement(statement, evaluation, reference_texts) for statement in statements]
    if not reasons:
        return Reason(f"{text}; the decisive value is infinite, or the interval contains no sample")
    return reasons[0]._replace(text=f"{text}: {'; '.join(reason.text for reason in reasons)}")


def _explain_bound(bound: Bound, evaluation: Evaluation, failed: bool) -> Reason:
    signals, (margin, truth, _) = evaluation.signals, evaluation.leaves[bound]
    values = bound.left.values(signals)
    worst = int(np.nanargmin(margin))
    at, value = float(signals.time[worst]), float(values[worst])
    lower = bound.is_lower
    if all(signal.is_score for signal in bound.signals):
        # A score is one number for the whole run.
        compared = f", which is compared with {bound.describe_right_side(signals, worst)}" if failed else ""
        return Reason(f"{bound.left.text} is {bound.left.format_value(value)}{compared}", value=value)
    if not failed and np.isinf(value):
        return Reason(f"{bound.left.text} is infinite throughout")
    if not failed:
        text = f"{bound.left.text} is {bound.left.format_value(value)} at {'least' if lower else 'most'}, at {at:.6g} s"
        return Reason(text, at, value)
    verb, side = ("falls", "below") if lower else ("rises", "above")
    if margin[worst] == 0.0:
        side = f"not {'above' if lower else 'below'}"
    text = f"{bound.left.text} {verb} to {bound.left.format_value(value)} at {at:.6g} s"
    text += f", {side} {bound.describe_right_side(signals, worst)}"
    first = float(signals.time[np.flatnonzero(truth < 0.0)[0]])
    return Reason(f"{text}{f', first at {first:.6g} s' if first < at else ''}", at, value)


def _explain_statement(leaf: Statement, evaluation: Evaluation, reference_texts: Mapping[str, str]) -> Reason:
    if isinstance(leaf, ReferenceCollides):
        return Reason(reference_texts.get(leaf.driver, f"{leaf.driver} was not run"))
    recording, ego = recording_of(evaluation.signals), evaluation.signals.ego
    if not is_present(recording, ego).any():
        return Reason(f"{quote_name(ego)} is never present")
    if isinstance(leaf, EgoCollides):
        return _explain_collision(leaf, evaluation.signals)
    if isinstance(leaf, EgoReaches):
        return _explain_position(leaf, recording, ego, evaluation.leaves[leaf].is_known)
    if isinstance(leaf, EgoLeaves):
        return _explain_leaving(leaf, evaluation, ego)
    return _explain_distance(leaf, recording, ego)


def _explain_collision(statement: EgoCollides, signals: Signals) -> Reason:
    recording, ego, entity = recording_of(signals), signals.ego, statement.entity
    if entity and not is_present(recording, ego, entity).any():
        return Reason(f"{quote_name(ego)} and {quote_name(entity)} are never present together")
    if collisions := find_collisions(statement, signals):
        reason = _describe_collision(collisions[0], recording, ego)
        if not statement.at_fault:
            return reason
        return reason._replace(text=f"{reason.text}: {_describe_fault(fault_of(collisions[0], signals), ego)}")
    if statement.at_fault and (harmless := find_collisions(replace(statement, at_fault=False), signals)):
        # If the fault of a collision is undecided, this collision is the reason.
        first = min(harmless, key=lambda collision: fault_of(collision, signals).who != "undecided")
        text = f"{_format_entities(first, ego)} collide at {first.time:.6g} s"
        return Reason(f"{text}, but {_describe_fault(fault_of(first, signals), ego)}", first.time)
    return Reason(f"{quote_name(ego)} does not collide{f' with {quote_name(entity)}' if entity else ''}")


def _describe_fault(fault: Fault, ego: str) -> str:
    whose = {
        "ego": f"at fault is {quote_name(ego)}",
        "both": "both are at fault",
        "other": f"{quote_name(ego)} is not at fault",
        "undecided": "whose fault it is is undecided",
    }
    return f"{whose[fault.who]}, as {' and '.join(fault.reasons)}"


def _describe_collision(collision: Collision, recording: Recording, ego: str) -> Reason:
    i, j = (recording.entity_index(name) for name in collision.entities)
    at = int(np.abs(recording.time - collision.time).argmin())
    vx, vy = (
        recording.speed[i, at] * part(recording.heading[i, at])
        - recording.speed[j, at] * part(recording.heading[j, at])
        for part in (np.cos, np.sin)
    )
    speed = float(np.hypot(vx, vy))
    text = f"{_format_entities(collision, ego)} collide at {collision.time:.6g} s with {speed:.3g} m/s to each other"
    return Reason(text, collision.time, speed)


def _format_entities(collision: Collision, ego: str) -> str:
    (partner,) = (name for name in collision.entities if name != ego)
    return f"{quote_name(ego)} and {quote_name(partner)}"


def _explain_position(statement: EgoReaches, recording: Recording, ego: str, is_known: bool) -> Reason:
    position, distances = (
        f"({statement.x:.6g}, {statement.y:.6g})",
        distance_within_time_limit(statement, recording, ego),
    )
    elapsed = recording.time - recording.time[0]
    if np.isnan(distances).all():
        present = elapsed[is_present(recording, ego)]
        return Reason(f"{quote_name(ego)} is absent before {present[0]:.6g} s")
    arrivals = np.flatnonzero(distances <= statement.radius)
    nearest = int(arrivals[0] if len(arrivals) else np.nanargmin(distances))
    at, value = float(recording.time[nearest]), float(distances[nearest])
    if len(arrivals):
        return Reason(f"{quote_name(ego)} reaches {position} at {at:.6g} s", at, value)
    text = f"{quote_name(ego)} comes no nearer to {position} than {value:.4g} m, at {at:.6g} s"
    if is_known:
        return Reason(f"{text}, within {statement.time_limit:.6g} s", at, value)
    return Reason(f"{text}, but was observed for {elapsed[-1]:.6g} s only", at, value)


def _explain_leaving(statement: EgoLeaves, evaluation: Evaluation, ego: str) -> Reason:
    values, is_lane = evaluation.leaves[statement], statement.what == "lane"
    if not values.is_known:
        return Reason(f"the roads on which {quote_name(ego)} drives are not known")
    time, worst = evaluation.signals.time, int(values.margin.argmax())
    at, margin = float(time[worst]), float(values.margin[worst])
    if margin <= 0.0:
        stays = "stays in its lane" if is_lane else "stays on the road"
        return Reason(f"{quote_name(ego)} {stays}, {-margin:.4g} m from the edge at {at:.6g} s", at, -margin)
    first = float(time[np.flatnonzero(values.truth > 0.0)[0]])
    leaves = "leaves its lane" if is_lane else "leaves the road"
    return Reason(f"{quote_name(ego)} {leaves} at {first:.6g} s, by {margin:.4g} m at {at:.6g} s", first, -margin)


def _explain_distance(statement: EgoDrives, recording: Recording, ego: str) -> Reason:
    driven, required = driven_distance(recording, ego), statement.distance
    reached = np.flatnonzero(driven >= required - TIME_TOLERANCE)
    if len(reached):
        at = float(recording.time[reached[0]])
        return Reason(f"{quote_name(ego)} has driven {required:.6g} m at {at:.6g} s", at, float(driven[reached[0]]))
    at, total = float(recording.time[-1]), float(driven[-1])
    text = f"{quote_name(ego)} drives {total:.4g} m until {at:.6g} s, less than {required:.6g} m"
    return Reason(text, at, total)
