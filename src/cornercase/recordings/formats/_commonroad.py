"""CommonRoad scenarios."""

from __future__ import annotations

import logging
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase.recordings._from_samples import EntitySamples, recording_from_samples
from cornercase.recordings._recording import Recording
from cornercase.scenario._xml import read_xml

# Largest number, and largest angle in rad.
_MAX_NUMBER, _MAX_ANGLE = 1e12, 1e4
_OBJECT_TYPES = {
    "truck": "truck",
    "bus": "bus",
    "bicycle": "bicycle",
    "pedestrian": "pedestrian",
    "motorcycle": "motorbike",
    "train": "train",
    "priorityVehicle": "car",
    "car": "car",
    "parkedVehicle": "car",
    "taxi": "car",
}


def read_commonroad(path: Path | str) -> Recording:
    """Read the obstacles of a CommonRoad scenario, named by their ids; requires the extra ``commonroad``.

    The prediction of a dynamic obstacle must be a trajectory; without a prediction, only its initial state is read.
    Static obstacles stand at all times. A CommonRoad scenario does not contain the motion of the ego, since finding it
    is the task of a planner. So add the ego as an obstacle with the planned trajectory.
    """
    path = Path(path)
    # Refuse what commonroad-io would accept: document types, huge files, huge numbers.
    _refuse_huge_numbers(path, read_xml(path))
    try:
        from commonroad.common.file_reader import CommonRoadFileReader
    except ImportError as error:
        raise InputError(
            f"{path}: reading CommonRoad files needs the extra 'commonroad'; {describe_install('commonroad')}."
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scenario, _ = CommonRoadFileReader(str(path)).open()
    except Exception as error:
        # The library may raise anything.
        logging.getLogger(__name__).debug("commonroad-io", exc_info=True)
        raise InputError(f"{path}: commonroad-io cannot read it ({type(error).__name__}: {error}).") from error

    tracks: dict[str, EntitySamples] = {}
    steps: set[int] = set()
    for obstacle in scenario.dynamic_obstacles:
        states = [obstacle.initial_state, *_trajectory_states(path, obstacle)]
        if not all(isinstance(getattr(state, "time_step", None), int) for state in states):
            raise InputError(f"{path}: obstacle {obstacle.obstacle_id} has a state without an exact time.")
        steps.update(state.time_step for state in states)
        track = tracks[str(obstacle.obstacle_id)] = _create_entity_samples(path, obstacle)
        for state in states:
            track.samples[state.time_step * scenario.dt] = _sample_from_state(path, obstacle, state)
    for obstacle in scenario.static_obstacles:
        track = tracks[str(obstacle.obstacle_id)] = _create_entity_samples(path, obstacle)
        x, y, heading, _, _ = _sample_from_state(path, obstacle, obstacle.initial_state)
        for step in sorted(steps or {0}):
            track.samples[step * scenario.dt] = (x, y, heading, 0.0, 0.0)
    return recording_from_samples(path, tracks)


def _refuse_huge_numbers(path: Path, root: etree._Element) -> None:
    """Refuse huge numbers, since commonroad-io normalizes angles in a loop that would not end."""
    for element in root.iter("*"):
        try:
            number = abs(float(element.text or ""))
        except ValueError:
            continue
        limit = (
            _MAX_ANGLE
            if any(ancestor.tag == "orientation" for ancestor in (element, *element.iterancestors()))
            else _MAX_NUMBER
        )
        if not number <= limit:
            raise InputError(
                f"{path}, line {element.sourceline}: <{element.tag}> is {element.text}; at most {limit:g} is read."
            )


def _trajectory_states(path: Path, obstacle: Any) -> list[Any]:
    if obstacle.prediction is None:
        return []
    if not hasattr(obstacle.prediction, "trajectory"):
        raise InputError(
            f"{path}: obstacle {obstacle.obstacle_id} has predicted occupancies instead of a trajectory; "
            "only trajectories are read."
        )
    states: list[Any] = obstacle.prediction.trajectory.state_list
    return states


def _create_entity_samples(path: Path, obstacle: Any) -> EntitySamples:
    shape = obstacle.obstacle_shape
    kind = _OBJECT_TYPES.get(obstacle.obstacle_type.value, "misc")
    if hasattr(shape, "length") and hasattr(shape, "width"):
        return EntitySamples(kind, float(shape.length), float(shape.width))
    if hasattr(shape, "radius"):
        return EntitySamples(kind, 2.0 * float(shape.radius), 2.0 * float(shape.radius))
    raise InputError(
        f"{path}: obstacle {obstacle.obstacle_id} has the shape {type(shape).__name__}; only rectangles and "
        "circles are read."
    )


def _sample_from_state(path: Path, obstacle: Any, state: Any) -> tuple[float, float, float, float, float]:
    position, heading = getattr(state, "position", None), getattr(state, "orientation", None)
    if not isinstance(position, np.ndarray) or not isinstance(heading, int | float | np.floating):
        raise InputError(
            f"{path}: obstacle {obstacle.obstacle_id} has no exact position and orientation at step {state.time_step}."
        )
    shape = obstacle.obstacle_shape
    ahead, left = getattr(shape, "center", (0.0, 0.0))
    if not math.isfinite(heading):
        raise InputError(f"{path}: obstacle {obstacle.obstacle_id} has an orientation of {heading}.")
    cos, sin = math.cos(heading), math.sin(heading)
    speed, acceleration = (getattr(state, name, None) for name in ("velocity", "acceleration"))
    return (
        float(position[0] + cos * ahead - sin * left),
        float(position[1] + sin * ahead + cos * left),
        float(heading) + float(getattr(shape, "orientation", 0.0)),
        math.nan if speed is None else float(speed),
        math.nan if acceleration is None else float(acceleration),
    )
