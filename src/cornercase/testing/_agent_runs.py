"""Plausibility checks of a run in which an agent (a driver of the simulator) drives the ego."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.testing._corrections import box_centers
from cornercase.testing._small_scenarios import AGENT_SPEED, LANE_Y

AGENT_LIMITS: Final = {
    "end": 0.3,
    "first_speed": 0.5,
    "speed_change": 0.5,
    "speed_sum": 0.5,
    "distance": 5.0,
    "back": 0.5,
    "offset": 1.0,
    "offset_at_van": 4.5,
    "heading": 0.3,
    "gap_with_collision": 0.5,
    "gap_without_collision": -0.3,
}
"""Limits for a plausible run of an agent, in m, s, m/s and rad."""

# Fraction of a distance by which the integral of the speed may differ from the distance.
_SPEED_ERROR: Final = 0.05
_EGO: Final = "Ego"


@dataclass(frozen=True)
class AgentMotion:
    """Motion of an ego that an agent drives, up to the first contact, in m, m/s and rad."""

    first_speed: float
    last_speed: float
    speed_change: float  # largest minus smallest speed
    distance: float  # along the lane
    back: float  # largest distance backwards
    offset: float  # largest distance from the middle of the first lane
    heading: float  # largest angle to the lane
    speed_sum: float  # difference between the distance and the integral of the speed
    gap: float | None  # smallest gap to the van ahead at any time, below 0 if boxes overlap; None without a van
    collision: float | None  # s, time of the ego's first collision; None without a collision


def measure_agent_motion(recording: Recording) -> AgentMotion:
    """Measure the motion of the ego in a small scenario for agents, on a road along the x axis."""
    e = recording.entity_index(_EGO)
    centers_x, centers_y = box_centers(recording)
    gaps = _measure_gaps_to_van(recording, centers_x, centers_y)
    times = [collision.time for collision in recording.collisions if _EGO in collision.entities]
    touching = np.zeros(len(recording.time), bool) if gaps is None else gaps <= 0.0
    touching |= recording.time >= min(times, default=np.inf)
    # After a contact the vehicle goes where it is pushed.
    count = max(int(np.argmax(touching)) if touching.any() else len(recording.time), 2)
    x, y = centers_x[e, :count], centers_y[e, :count]
    speed, heading = recording.speed[e, :count], wrap_angle(recording.heading[e, :count])
    # Along the lane, since some agents change lanes at once.
    forward = speed * np.cos(heading)
    distance = float(x[-1] - x[0])
    sum_of_speeds = float((0.5 * (forward[1:] + forward[:-1]) * np.diff(recording.time[:count])).sum())
    return AgentMotion(
        first_speed=float(speed[0]),
        last_speed=float(speed[-1]),
        speed_change=float(np.ptp(speed)),
        distance=distance,
        back=float(np.max(np.maximum.accumulate(x) - x)),
        offset=float(np.abs(y - LANE_Y).max()),
        heading=float(np.abs(heading).max()),
        speed_sum=abs(distance - sum_of_speeds),
        gap=None if gaps is None else float(gaps.min()),
        collision=min(times, default=None),
    )


def describe_agent_problems(motion: AgentMotion, end: float, duration: float) -> str:
    """Return a sentence that lists what is implausible in an agent's run; empty if nothing is.

    `end` is the last instant of the recording, and `duration` the duration of the scenario, both in s.
    """
    clauses = list(_iter_problems(motion, end, duration))
    return f"The ego {'; it '.join(clauses)}." if clauses else ""


def _iter_problems(motion: AgentMotion, end: float, duration: float) -> Iterator[str]:
    limits = AGENT_LIMITS
    if abs(end - duration) > limits["end"]:
        yield f"is recorded up to {end:.2f} s instead of {duration:g} s"
    if abs(motion.first_speed - AGENT_SPEED) > limits["first_speed"]:
        yield f"begins at {motion.first_speed:.2f} m/s instead of the {AGENT_SPEED:g} m/s of the storyboard"
    # On a free lane, some agents keep the speed of the storyboard.
    if motion.gap is not None and motion.speed_change < limits["speed_change"] and motion.offset < limits["offset"]:
        yield "neither changes its speed nor its lane before the van, as if nobody drove it"
    if motion.distance < limits["distance"]:
        yield f"goes {motion.distance:.1f} m along its lane (at least {limits['distance']:g})"
    if motion.back > limits["back"]:
        yield f"goes back by {motion.back:.1f} m"
    # The ego may pass the van on the next lane.
    largest_offset = limits["offset" if motion.gap is None else "offset_at_van"]
    if motion.offset > largest_offset:
        yield f"is {motion.offset:.2f} m beside the middle of its lane (at most {largest_offset:g})"
    if motion.heading > limits["heading"]:
        yield f"points {motion.heading:.2f} rad away from its lane (at most {limits['heading']:g})"
    if motion.speed_sum > limits["speed_sum"] + _SPEED_ERROR * abs(motion.distance):
        yield f"moves by {motion.distance:.1f} m, but its speeds add up to something else"
    if motion.gap is None:
        if motion.collision is not None:
            yield f"collides at {motion.collision:.2f} s, where nothing is"
    elif motion.collision is None and motion.gap < limits["gap_without_collision"]:
        yield f"is {-motion.gap:.2f} m inside the van without a collision"
    elif motion.collision is not None and motion.gap > limits["gap_with_collision"]:
        yield f"collides at {motion.collision:.2f} s, though it is never nearer to the van than {motion.gap:.2f} m"


def _measure_gaps_to_van(recording: Recording, centers_x: FloatArray, centers_y: FloatArray) -> FloatArray | None:
    """Return the gap in m between the ego's front and the rear of the van ahead, at each instant; None without a van.

    The van is the only other entity. The gap is infinite while the ego is laterally beside the van, or past it.
    """
    others = [k for k, name in enumerate(recording.names) if name != _EGO]
    if not others:
        return None
    e, other = recording.entity_index(_EGO), others[0]
    length, width = (0.5 * float(sizes[e] + sizes[other]) for sizes in (recording.length, recording.width))
    ahead = centers_x[other] - centers_x[e]
    is_behind = (np.abs(centers_y[other] - centers_y[e]) < width) & (ahead > -length)
    return np.where(is_behind, ahead - length, np.inf)
