"""Trajectories of entities from a run of the builtin simulator, which replace their motion in the storyboard."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.text.element_locations import prefix_file
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators.builtin._simulator import Builtin
from cornercase.simulators.carla._storyboard_rewrite import (
    E,
    format_number,
    make_condition,
    make_speed_action,
    make_time_condition,
    make_world_position,
)

# Tolerance in m and rad of the interpolation between two vertices.
_MAX_POSITION_ERROR, _MAX_HEADING_ERROR = 0.001, 0.001
# Maximum change of heading in rad between vertices: not all simulators interpolate the heading.
_MAX_HEADING_CHANGE: Final = 0.03
# Tolerance in m/s between recorded speed and speed of the motion, and maximum number of jumps.
_MAX_SPEED_ERROR, _MAX_JUMPS = 0.2, 20
# Time in s that no run reaches.
_NEVER_TIME: Final = 1e6


def simulate_builtin(
    scenario: ScenarioFile, values: Mapping[str, Value], time_step: float, duration: float
) -> Recording:
    """Run a scenario in the builtin simulator, and return its recording.

    `time_step` and `duration` are in s. Raises `InputError` if the run fails, or if an entity does not exist at the
    start.
    """
    simulator = Builtin(time_step=time_step, duration=duration)
    (recording,) = simulator.run([ConcreteScenario(scenario.path, dict(values), scenario)])
    if isinstance(recording, SimulationError):
        raise InputError(prefix_file(scenario.path, f"{recording}."))
    for k, name in enumerate(recording.names):
        if not np.isfinite(recording.x[k, 0]):
            raise InputError(
                f"{scenario.path}: '{name}' does not exist at the start, when ScenarioRunner needs all entities; give"
                " it a <TeleportAction> in <Init>."
            )
    return recording


@dataclass(frozen=True)
class Trajectory:
    """The motion of an entity, in several parts if the entity jumps.

    `parts`: arrays of vertices with the columns time in s, x and y in m, and heading in rad. `starts`: times in s after
    which the parts begin. `first_speed`: initial speed in m/s, if it differs from the speed of the motion that follows.
    `end`: time in s after which the entity vanishes, or None. `note`: a sentence if the trajectory differs from the
    recording, else empty.
    """

    parts: tuple[FloatArray, ...]
    starts: tuple[float, ...]
    first_speed: float | None
    end: float | None
    note: str

    def to_properties(self, *, ends: bool) -> dict[str, str]:
        """Return the trajectory as properties of the controller `cornercase_trajectory.py`.

        `ends`: whether the controller removes the entity at the time `end`, if there is one.
        """
        parts = [[[float(format_number(value)) for value in vertex] for vertex in part.tolist()] for part in self.parts]
        properties = {"parts": json.dumps(parts), "starts": json.dumps([round(start, 6) for start in self.starts])}
        return properties | ({"end": format_number(self.end)} if ends and self.end is not None else {})


def add_trajectories(root: etree._Element, trajectories: Mapping[str, Trajectory], ego: str) -> None:
    """Add a story in which entities follow their trajectories until the stop trigger.

    The story is added even without trajectories, since it keeps ScenarioRunner running until the stop trigger.
    """
    storyboard = root.find("Storyboard")
    assert storyboard is not None
    stop = storyboard.find("StopTrigger")
    story = etree.Element("Story", name="cornercase")
    if stop is None:
        storyboard.append(story)
    else:
        stop.addprevious(story)
    act = etree.SubElement(story, "Act", name="cornercase trajectories")
    for name, trajectory in trajectories.items():
        _add_entity_trajectory(act, trajectory, name)
    # An event that never happens keeps the act, and so ScenarioRunner, running until the stop trigger.
    idle_maneuver = _add_maneuver_group(act, ego, "never")
    _add_event(idle_maneuver, "never", make_speed_action(0.0), make_time_condition("never", _NEVER_TIME))
    etree.SubElement(act, "StartTrigger").append(make_time_condition("from the beginning", -1.0))


def _add_maneuver_group(act: etree._Element, entity: str, name: str) -> etree._Element:
    """Add a maneuver group with one entity to an act, and return the maneuver in the group."""
    actors, maneuver = E.Actors(E.EntityRef(entityRef=entity), selectTriggeringEntities="false"), E.Maneuver(name=name)
    act.append(E.ManeuverGroup(actors, maneuver, name=name, maximumExecutionCount="1"))
    return maneuver


def _add_event(maneuver: etree._Element, name: str, action: etree._Element, trigger: etree._Element) -> None:
    maneuver.append(E.Event(E.Action(action, name=name), E.StartTrigger(trigger), name=name, priority="overwrite"))


def make_trajectory(recording: Recording, name: str) -> Trajectory:
    """Convert the motion of an entity in a recording into a trajectory."""
    k = recording.names.index(name)
    is_present = np.isfinite(recording.x[k])
    count = len(is_present) if is_present.all() else int(np.argmin(is_present))
    time, x, y = recording.time[:count], recording.x[k, :count], recording.y[k, :count]
    heading, speed = np.unwrap(recording.heading[k, :count]), recording.speed[k, :count]
    note, jumps = "", _find_jumps(time, x, y, speed)
    if len(jumps) > _MAX_JUMPS:
        note = f"{name} has the speed of its motion, from which its own differs at {len(jumps)} instants."
        jumps = []
    begins = [0, *(i for i in jumps if i)]
    parts, starts = [], [-1.0]
    for part, begin in enumerate(begins):
        end = begins[part + 1] if part + 1 < len(begins) else count
        rows = np.arange(begin, end)
        trajectory = np.stack([time[rows], x[rows], y[rows], heading[rows]], axis=1)
        vertices = trajectory[_select_vertices(trajectory)]
        if part:
            # The first step leads to the target of the jump.
            vertices = np.concatenate([[_extrapolate(trajectory[0], speed[begin], time[begin - 1])], vertices])
            starts.append(0.5 * float(time[begin - 1] + time[max(begin - 2, 0)]))
        if part + 1 < len(begins):
            vertices = np.concatenate(
                [vertices, [_extrapolate(trajectory[-1], speed[end - 1], 2.0 * time[end] - time[end - 1])]]
            )
        parts.append(vertices if len(vertices) > 1 else np.repeat(vertices, 2, axis=0))
    return Trajectory(
        tuple(parts),
        tuple(starts),
        max(float(speed[0]), 0.0) if jumps and jumps[0] == 0 else None,
        0.5 * float(time[-1] + time[max(count - 2, 0)]) if count < len(is_present) else None,
        note,
    )


def _add_entity_trajectory(act: etree._Element, trajectory: Trajectory, name: str) -> None:
    maneuver = _add_maneuver_group(act, name, f"{name} along its trajectory")
    start_trigger = make_time_condition(f"{name} starts", -1.0)
    if trajectory.first_speed is not None:
        event = f"{name} has its first speed"
        _add_event(maneuver, event, make_speed_action(trajectory.first_speed), start_trigger)
        completed = E.StoryboardElementStateCondition(
            storyboardElementType="event", storyboardElementRef=event, state="completeState"
        )
        start_trigger = make_condition(f"{event} before", completed)
    for k, (vertices, start) in enumerate(zip(trajectory.parts, trajectory.starts, strict=True)):
        if k:
            start_trigger = make_time_condition(f"{name} jumps", start)
        event = f"{name} moves" if k == 0 else f"{name} moves on from {vertices[1, 0]:g} s"
        _add_event(maneuver, event, _make_trajectory_action(vertices, event), start_trigger)
    if trajectory.end is not None:
        event = f"{name} vanishes"
        delete = E.GlobalAction(E.EntityAction(E.DeleteEntityAction(), entityRef=name))
        _add_event(maneuver, event, delete, make_time_condition(event, trajectory.end))


def _extrapolate(vertex: FloatArray, speed: float, time: float) -> FloatArray:
    """Extrapolate a vertex to another time in s, straight ahead at a constant speed in m/s."""
    distance = speed * (time - vertex[0])
    return np.array(
        [time, vertex[1] + distance * np.cos(vertex[3]), vertex[2] + distance * np.sin(vertex[3]), vertex[3]]
    )


def _find_jumps(time: FloatArray, x: FloatArray, y: FloatArray, speed: FloatArray) -> list[int]:
    """Return the indices of samples at which an entity jumps instead of moving at its recorded speed.

    Index 0 means that the initial speed differs from the motion.
    """
    if len(time) < 2:
        return []
    speeds = np.hypot(np.diff(x), np.diff(y)) / np.diff(time)
    indices = (np.flatnonzero(np.abs(speeds - np.abs(speed[1:])) > _MAX_SPEED_ERROR) + 1).tolist()
    return [0, *indices] if abs(speeds[0] - abs(speed[0])) > _MAX_SPEED_ERROR else indices


def _make_trajectory_action(trajectory: FloatArray, name: str) -> etree._Element:
    """Create the action that follows a trajectory.

    The columns of `trajectory` are time in s, x and y in m, and heading in rad.
    """
    vertices = [
        E.Vertex(make_world_position(x, y, heading), time=format_number(time)) for time, x, y, heading in trajectory
    ]
    shape = E.Shape(E.Polyline(*vertices))
    # Times since the start of the run, independent of when ScenarioRunner reaches the action.
    timing = E.Timing(domainAbsoluteRelative="absolute", scale="1", offset="0")
    action = E.FollowTrajectoryAction(
        E.Trajectory(E.ParameterDeclarations(), shape, name=name, closed="false"),
        E.TimeReference(timing),
        E.TrajectoryFollowingMode(followingMode="position"),
    )
    return E.PrivateAction(E.RoutingAction(action))


def _select_vertices(trajectory: FloatArray) -> list[int]:
    """Return the indices of vertices from which linear interpolation reproduces the motion accurately enough."""
    indices, last = [0], len(trajectory) - 1
    limit = np.array([_MAX_POSITION_ERROR, _MAX_POSITION_ERROR, _MAX_HEADING_ERROR])
    while indices[-1] < last:
        start, end = indices[-1], indices[-1] + 1
        while end < last:
            inner = trajectory[start + 1 : end + 1]
            part = ((inner[:, 0] - trajectory[start, 0]) / (trajectory[end + 1, 0] - trajectory[start, 0]))[:, None]
            if abs(trajectory[end + 1, 3] - trajectory[start, 3]) > _MAX_HEADING_CHANGE:
                break
            if (
                np.abs(trajectory[start, 1:] + part * (trajectory[end + 1, 1:] - trajectory[start, 1:]) - inner[:, 1:])
                > limit
            ).any():
                break
            end += 1
        indices.append(end)
    return indices
