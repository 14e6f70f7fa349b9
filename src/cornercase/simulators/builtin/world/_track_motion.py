"""Motion of entities along their tracks in Python, not in kernels."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Track, Trajectory
from cornercase.simulators.builtin.world._lane_following import extend_lane_path
from cornercase.simulators.builtin.world._road_position import is_on_road
from cornercase.simulators.builtin.world._world import World


def update_off_road_since(world: World, where: BoolArray) -> None:
    """Update the time in s since which each entity has been off the road, in the scenarios of a mask.

    The time is infinite while the entity is on the road or absent.
    """
    # As in esmini, no entity is off the road before the first time step.
    current_time = np.where(world.last_step > 0.0, world.time, np.inf)
    for e, since in enumerate(world.off_road_since):
        is_off = world.present[e] if world.network is None else world.present[e] & ~is_on_road(world, e)
        since[where] = np.where(is_off, np.minimum(since, current_time), np.inf)[where]


def extend_lane_paths(world: World) -> None:
    """Make entities near the end of their lane path follow the next part of the path."""
    for e, tracks in enumerate(world.tracks):
        for k, track in enumerate([*tracks]):
            if isinstance(track, LaneTrack) and track.is_continued:
                extend_lane_path(world, e, k)


def heading_velocity(world: World) -> tuple[FloatArray, FloatArray]:
    """Return the x and y components of entities' velocities in m/s, shape (E, N) each.

    Each velocity points along the heading, also in a bend or a lane change.
    """
    return world.speed * np.cos(world.heading), world.speed * np.sin(world.heading)


def heading_acceleration(world: World) -> FloatArray:
    """Return the acceleration of entities along their headings in the last step, in m/s², shape (E, N)."""
    return np.asarray(
        world.step_acceleration[0] * np.cos(world.heading) + world.step_acceleration[1] * np.sin(world.heading)
    )


def update_pose_on_track(world: World, entity: int, where: BoolArray) -> None:
    """Set the pose of an entity from its distance and offset on its track, in the scenarios of a mask."""
    for _, track, at in world.iter_followed_tracks(entity, where):
        _set_pose_from_track(world, entity, track, at)


def shift_along_track(world: World, entity: int, where: BoolArray, distance: FloatArray) -> None:
    """Shift an entity along its track by `distance` m, shape (N,), in addition to the motion of the frame."""
    for _, track, at in world.iter_followed_tracks(entity, where):
        before = world.distance[entity][at]
        world.distance[entity][at] = (
            track.advance(before, world.offset[entity][at], distance[at])
            if isinstance(track, LaneTrack)
            else before + distance[at]
        )
        _set_pose_from_track(world, entity, track, at)


def shift_along_trajectory(world: World, entity: int, where: BoolArray, distance: FloatArray) -> None:
    """Shift an entity on a trajectory forwards by `distance` m, shape (N,), at most to an end of the trajectory."""
    for _, track, at in world.iter_followed_tracks(entity, where):
        if isinstance(track, Trajectory):
            ahead = distance[at] * np.cos(world.turn[entity][at])
            world.distance[entity][at] = np.clip(world.distance[entity][at] + ahead, 0.0, track.lengths[at])
            _set_pose_from_track(world, entity, track, at)


def move_to_pose(
    world: World, entity: int, x: FloatArray, y: FloatArray, heading: FloatArray, where: BoolArray
) -> None:
    """Move an entity to a pose that its driver or another simulator gives for the end of the coming step, arrays (N,).

    If the entity follows a track, its distance, offset and angle to the track are updated.
    """
    for state, values in ((world.x, x), (world.y, y), (world.heading, heading)):
        state[entity][where] = values[where]
    world.moved[entity] |= where
    for _, track, at in world.iter_followed_tracks(entity, where):
        along = track.project_moving_point(x[at], y[at], at, world.distance[entity][at])
        on_x, on_y, track_heading = track.pose_at(along, np.zeros(len(at)), at)
        world.distance[entity][at] = along
        world.offset[entity][at] = (y[at] - on_y) * np.cos(track_heading) - (x[at] - on_x) * np.sin(track_heading)
        world.turn[entity][at] = wrap_angle(heading[at] - track_heading)


def _set_pose_from_track(world: World, entity: int, track: Track, rows: IntArray) -> None:
    x, y, heading = track.pose_at(world.distance[entity][rows], world.offset[entity][rows], rows)
    world.x[entity][rows], world.y[entity][rows] = x, y
    world.heading[entity][rows] = heading + world.turn[entity][rows]
