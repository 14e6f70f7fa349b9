"""Entities that move along trajectories, sampled from a run of the builtin simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.places import of_file
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value
from cornercase.simulators.builtin.simulator import BuiltinSimulator
from cornercase.simulators.carla.storyboard import at_time, plain, speed_action, world_position

# m and rad by which what lies between two vertices may differ from the run.
_NEAR, _TURN = 0.001, 0.001
# rad by which the heading may change from one vertex to the next: not all players turn evenly between them.
_BEND: Final = 0.03
# m/s by which the speed may differ from that of the way, and how many jumps there may be.
_SPEED, _MOST = 0.2, 20
# s; no run takes this long.
_NEVER: Final = 1e6


def sample(scenario: Scenario, values: Mapping[str, Value], time_step: float, duration: float) -> Recording:
    """Run a concrete scenario on the builtin simulator.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str
    time_step, duration : float
        s.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        It cannot be run there, or an entity is not there at the beginning.
    """
    simulator = BuiltinSimulator(time_step=time_step, duration=duration)
    (found,) = simulator.run([ConcreteScenario(scenario.path, dict(values), scenario)])
    if isinstance(found, SimulationError):
        raise InputError(of_file(scenario.path, f"{found}."))
    for k, name in enumerate(found.names):
        if not np.isfinite(found.x[k, 0]):
            raise InputError(
                f"{scenario.path}: '{name}' does not exist at the beginning, when ScenarioRunner needs all entities;"
                " give it a <TeleportAction> in <Init>."
            )
    return found


def add_trajectories(root: etree._Element, recording: Recording | None, names: list[str], ego: str) -> list[str]:
    """Let entities move as they did in a run, from the beginning to the end.

    Parameters
    ----------
    root : lxml element
        Changed in place: a story is added.
    recording : Recording or None
        None where no entity moves along one.
    names : list of str
    ego : str

    Returns
    -------
    list of str
        What is not quite the same.
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
    notes = [] if recording is None else [note for name in names for note in _move(act, recording, name)]
    # Keeps the act, and so ScenarioRunner, going until the stop trigger; itself it never happens.
    never = _group(act, ego, "never")
    _event(never, "never", _speed(0.0), at_time("never", _NEVER))
    etree.SubElement(act, "StartTrigger").append(at_time("from the beginning", -1.0))
    return notes


def _group(act: etree._Element, entity: str, name: str) -> etree._Element:
    """Add a group of one entity, and return its maneuver."""
    holder = etree.SubElement(act, "ManeuverGroup", name=name, maximumExecutionCount="1")
    actors = etree.SubElement(holder, "Actors", selectTriggeringEntities="false")
    etree.SubElement(actors, "EntityRef", entityRef=entity)
    return etree.SubElement(holder, "Maneuver", name=name)


def _event(maneuver: etree._Element, name: str, action: etree._Element, group: etree._Element) -> None:
    event = etree.SubElement(maneuver, "Event", name=name, priority="overwrite")
    outer = etree.SubElement(event, "Action", name=name)
    etree.SubElement(outer, "PrivateAction").append(action)
    etree.SubElement(event, "StartTrigger").append(group)


def _speed(speed: float) -> etree._Element:
    holder = etree.Element("LongitudinalAction")
    holder.append(speed_action(speed))
    return holder


def _move(act: etree._Element, recording: Recording, name: str) -> list[str]:
    """Add the trajectories of an entity: one, and another one wherever it jumps."""
    k = recording.names.index(name)
    there = np.isfinite(recording.x[k])
    count = len(there) if there.all() else int(np.argmin(there))
    time, x, y = recording.time[:count], recording.x[k, :count], recording.y[k, :count]
    heading, speed = np.unwrap(recording.heading[k, :count]), recording.speed[k, :count]
    notes = []
    maneuver = _group(act, name, f"{name} along its trajectory")
    jumps = _jumps(time, x, y, speed)
    if len(jumps) > _MOST:
        notes.append(f"{name} has the speed of its way, from which its own differs at {len(jumps)} instants.")
        jumps = []
    begins = at_time(f"{name} starts", -1.0)
    if jumps and jumps[0] == 0:
        # The speed of the first instant is none of the way that follows.
        event = f"{name} has its first speed"
        _event(maneuver, event, _speed(max(float(speed[0]), 0.0)), begins)
        begins = _after(event)
    starts = [0, *(i for i in jumps if i)]
    for part, start in enumerate(starts):
        end = starts[part + 1] if part + 1 < len(starts) else count
        rows = np.arange(start, end)
        way = np.stack([time[rows], x[rows], y[rows], heading[rows]], axis=1)
        chosen = way[_vertices(way)]
        if part:
            # The first step from here leads to where it jumps.
            chosen = np.concatenate([[_moved(way[0], speed[start], time[start - 1])], chosen])
            begins = at_time(f"{name} jumps", 0.5 * float(time[start - 1] + time[max(start - 2, 0)]))
        if part + 1 < len(starts):
            chosen = np.concatenate([chosen, [_moved(way[-1], speed[end - 1], 2.0 * time[end] - time[end - 1])]])
        number = f"{name} moves" if part == 0 else f"{name} moves on from {time[start]:g} s"
        _event(maneuver, number, _follow(chosen, number), begins)
    if count < len(there):
        _vanish(maneuver, name, 0.5 * float(time[-1] + time[max(count - 2, 0)]))
    return notes


def _vanish(maneuver: etree._Element, entity: str, seconds: float) -> None:
    name = f"{entity} vanishes"
    event = etree.SubElement(maneuver, "Event", name=name, priority="overwrite")
    holder = etree.SubElement(etree.SubElement(event, "Action", name=name), "GlobalAction")
    etree.SubElement(etree.SubElement(holder, "EntityAction", entityRef=entity), "DeleteEntityAction")
    etree.SubElement(event, "StartTrigger").append(at_time(name, seconds))


def _after(event: str) -> etree._Element:
    group = etree.Element("ConditionGroup")
    condition = etree.SubElement(group, "Condition", name=f"{event} before", delay="0", conditionEdge="none")
    etree.SubElement(
        etree.SubElement(condition, "ByValueCondition"), "StoryboardElementStateCondition",
        storyboardElementType="event", storyboardElementRef=event, state="completeState",
    )  # fmt: skip
    return group


def _moved(place: FloatArray, speed: float, time: float) -> FloatArray:
    """A vertex straight ahead of or behind another one, where it is at another time."""
    way = speed * (time - place[0])
    return np.array([time, place[1] + way * np.cos(place[3]), place[2] + way * np.sin(place[3]), place[3]])


def _jumps(time: FloatArray, x: FloatArray, y: FloatArray, speed: FloatArray) -> list[int]:
    """Instants that are reached otherwise than at the speed of that instant; 0 where that of the first is another."""
    if len(time) < 2:
        return []
    ways = np.hypot(np.diff(x), np.diff(y)) / np.diff(time)
    found = (np.flatnonzero(np.abs(ways - np.abs(speed[1:])) > _SPEED) + 1).tolist()
    return [0, *found] if abs(ways[0] - abs(speed[0])) > _SPEED else found


def _follow(way: FloatArray, name: str) -> etree._Element:
    """Make the action that follows a way, in rows of time, x, y and heading."""
    routing = etree.Element("RoutingAction")
    action = etree.SubElement(routing, "FollowTrajectoryAction")
    trajectory = etree.SubElement(action, "Trajectory", name=name, closed="false")
    etree.SubElement(trajectory, "ParameterDeclarations")
    line = etree.SubElement(etree.SubElement(trajectory, "Shape"), "Polyline")
    for time, x, y, heading in way if len(way) > 1 else np.repeat(way, 2, axis=0):
        vertex = etree.SubElement(line, "Vertex", time=plain(time))
        vertex.append(world_position(x, y, heading))
    reference = etree.SubElement(action, "TimeReference")
    # Times from the beginning of the run, so that it does not matter when ScenarioRunner comes to the action.
    etree.SubElement(reference, "Timing", domainAbsoluteRelative="absolute", scale="1", offset="0")
    etree.SubElement(action, "TrajectoryFollowingMode", followingMode="position")
    return routing


def _vertices(way: FloatArray) -> list[int]:
    """Rows between which an entity moves as good as straight on, at one speed."""
    chosen, last = [0], len(way) - 1
    limit = np.array([_NEAR, _NEAR, _TURN])
    while chosen[-1] < last:
        start, end = chosen[-1], chosen[-1] + 1
        while end < last:
            inner = way[start + 1 : end + 1]
            part = ((inner[:, 0] - way[start, 0]) / (way[end + 1, 0] - way[start, 0]))[:, None]
            if abs(way[end + 1, 3] - way[start, 3]) > _BEND:
                break
            if (np.abs(way[start, 1:] + part * (way[end + 1, 1:] - way[start, 1:]) - inner[:, 1:]) > limit).any():
                break
            end += 1
        chosen.append(end)
    return chosen
