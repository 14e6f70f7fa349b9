"""Coupling of a simulation in SUMO with a storyboard, step by step."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, Final, Self
from xml.sax.saxutils import quoteattr

import numpy as np

from cornercase._common.errors import SimulationError
from cornercase._common.geometry.boxes import wrap_angle
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.world._road_position import is_heading_along_road, road_pose
from cornercase.simulators.builtin.world._track_motion import move_to_pose
from cornercase.simulators.builtin.world._world import Entity, World

# Parameters of SUMO's models, not calibrated. tau: time headway in s. jmTimegapMinor: time gap in s to traffic with the
# right of way. impatience: how much a driver relies on that traffic to brake. jmIgnoreJunctionFoeProb: it completes a
# turn that it has started.
VEHICLE_TYPES: Final[dict[str, dict[str, float]]] = {
    "cautious": {
        "accel": 1.8, "decel": 3.5, "emergencyDecel": 8.0, "tau": 1.8, "minGap": 3.0, "speedFactor": 0.9,
        "jmTimegapMinor": 2.5, "impatience": 0.0,
    },
    "normal": {
        "accel": 2.6, "decel": 4.5, "emergencyDecel": 9.0, "tau": 1.0, "minGap": 2.5, "speedFactor": 1.0,
        "jmTimegapMinor": 1.0, "impatience": 0.5, "jmIgnoreJunctionFoeProb": 1.0,
    },
    "aggressive": {
        "accel": 3.5, "decel": 5.5, "emergencyDecel": 9.0, "tau": 0.6, "minGap": 1.5, "speedFactor": 1.1,
        "jmTimegapMinor": 0.2, "impatience": 1.0, "jmIgnoreJunctionFoeProb": 1.0,
    },
}  # fmt: skip
# Entities that the storyboard moves do not yield, are as fast as it says, and go exactly where they are put.
_MOVED_TYPE: Final = {
    "minGap": 0.0, "jmIgnoreFoeProb": 1.0, "jmIgnoreFoeSpeed": 100.0, "jmIgnoreJunctionFoeProb": 1.0,
    "speedFactor": 100.0,
}  # fmt: skip

_SUMO_OPTIONS: Final = (
    "--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never", "--collision.action", "none",
    "--time-to-teleport", "-1", "--step-method.ballistic", "true", "--default.speeddev", "0",
)  # fmt: skip
# Maximum offset in m from the middle of a lane for an entity that follows it.
_MAX_LANE_OFFSET: Final = 0.3
_REMOTE_OFFSET: Final = 1e5


class SumoCoupling:
    """A run of SUMO that is coupled with a storyboard; a Python process can have only one such run at a time.

    `types`: vehicle types of the entities that SUMO drives, by entity. SUMO also sees each other entity while its box
    reaches into a lane. `error`: the error if SUMO has failed, else None.
    """

    def __init__(self, network: Path, types: Mapping[str, str], time_step: float, seed: int) -> None:
        # libsumo prints warnings about other packages when it is imported.
        with redirect_stdout(io.StringIO()):
            import libsumo

        self._sumo: Any = libsumo
        self._types = types
        self._added: dict[int, str] = {}
        self._lane_cache: dict[int, tuple[tuple[float, float, float], bool]] = {}
        self.error: SimulationError | None = None
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        types_file = Path(self._folder.name) / "types.add.xml"
        types_file.write_text(_format_vehicle_types(), encoding="utf-8")
        arguments = [
            "--additional-files", str(types_file), "--net-file", str(network), "--seed", str(seed), *_SUMO_OPTIONS,
            "--step-length", f"{time_step:g}", "--default.action-step-length", f"{time_step:g}",
        ]  # fmt: skip
        # Loading is far faster than starting again.
        if libsumo.simulation.isLoaded():
            libsumo.simulation.load(arguments)
        else:
            libsumo.simulation.start(["sumo", *arguments])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._folder.cleanup()

    def step(self, world: World, dt: float) -> None:
        """Advance SUMO by a time step `dt` in s.

        Before the step, SUMO gets the positions that the entities of the storyboard will have at the end of the step.
        After the step, the entities that SUMO drives are moved in `world`. If `dt` is 0, entities are only added to
        SUMO. `world` must hold a single scenario.
        """
        if self.error is not None or not world.running[0]:
            return
        try:
            for e in np.flatnonzero(world.present[:, 0]).tolist():
                if e not in self._added:
                    self._add_entity(world, e)
            if dt == 0.0:
                return
            for e, name in self._added.items():
                if name not in self._types:
                    self._move_in_sumo(world, e, name, dt)
                elif name in self._sumo.vehicle.getIDList():
                    self._set_max_speed(world, e, name)
            self._sumo.simulationStep()
            for e, name in self._added.items():
                if name in self._types:
                    self._move_from_sumo(world, e, name)
        except (self._sumo.TraCIException, SimulationError) as error:
            self.error = SimulationError(f"SUMO fails at {world.time[0]:.6g} s ({error})")
            world.running[:] = False

    def _add_entity(self, world: World, e: int) -> None:
        sumo, entity = self._sumo, world.entities[e]
        name = entity.name
        vehicle_type = self._make_vehicle_type(entity)
        start, end = self._route_ends(world, e)
        route = sumo.simulation.findRoute(start[0], end[0]).edges or (start[0],)
        sumo.route.add(f"route {name}", route)
        edge_position = min(start[1], sumo.lane.getLength(f"{start[0]}_{start[2]}"))
        sumo.vehicle.add(
            name, f"route {name}", typeID=vehicle_type, departLane=str(start[2]), departPos=f"{edge_position:.6f}",
        )  # fmt: skip
        # Insert it at once, even if another vehicle is there.
        sumo.vehicle.moveTo(name, *self._lane_position(start, route))
        # As a departure speed, SUMO would refuse what is above the limit of the road.
        sumo.vehicle.setPreviousSpeed(name, max(float(world.speed[e, 0]), 0.0))
        if name in self._types:
            sumo.vehicle.setSpeed(name, max(float(world.speed[e, 0]), 0.0))
        else:
            # No checks: it goes where the storyboard says.
            sumo.vehicle.setSpeedMode(name, 32)
            sumo.vehicle.setLaneChangeMode(name, 0)
        self._added[e] = name

    def _make_vehicle_type(self, entity: Entity) -> str:
        sumo, name, temper = self._sumo, f"type {entity.name}", self._types.get(entity.name)
        sumo.vehicletype.copy(temper or "moved", name)
        sumo.vehicletype.setLength(name, entity.length)
        sumo.vehicletype.setWidth(name, entity.width)
        if temper is not None:
            type_settings = VEHICLE_TYPES[temper]
            sumo.vehicletype.setAccel(name, min(type_settings["accel"], entity.max_acceleration))
            sumo.vehicletype.setDecel(name, min(type_settings["decel"], entity.max_deceleration))
            sumo.vehicletype.setEmergencyDecel(
                name, max(type_settings["decel"], min(type_settings["emergencyDecel"], entity.max_deceleration))
            )
        return name

    def _route_ends(self, world: World, e: int) -> tuple[tuple[str, float, int], tuple[str, float, int]]:
        """Return the start and the end of an entity's route, each as edge, position in m and lane.

        The route starts at the front of the entity. If SUMO drives an entity whose front is on a junction, that is a
        position beyond the end of the edge before the junction.
        """
        x, y = self._front_position(world, e)
        begin = self._sumo.simulation.convertRoad(x, y)
        is_driven = world.entities[e].name in self._types
        track = self._lane_track_of(world, e) or (_lane_track_here(world, e) if is_driven else None)
        if is_driven and begin[0].startswith(":"):
            begin = self._start_before_junction(world, e, track)
        elif not is_driven and (track is None or begin[0].startswith(":")):
            # It may start on a junction. Its position is set in each step, so any edge will do.
            any_edge = next(edge for edge in self._sumo.edge.getIDList() if not edge.startswith(":"))
            return (any_edge, 0.0, 0), (any_edge, 0.0, 0)
        # The very end of a path may be just outside the network.
        return begin, begin if track is None else self._locate_on_track(track, max(track.length - 1.0, 0.0))

    def _start_before_junction(self, world: World, e: int, track: LaneTrack | None) -> tuple[str, float, int]:
        """Return the front of an entity on a junction as edge before the junction, position beyond its end and lane."""
        if track is not None:
            x, y = self._front_position(world, e)
            front = float(track.nearest_distance(np.array([x]), np.array([y]), np.zeros(1, dtype=np.int64))[0])
            for distance in np.arange(front, 0.0, -1.0).tolist():
                edge, position, lane = self._locate_on_track(track, distance)
                if not edge.startswith(":"):
                    return edge, position + front - distance, lane
        raise SimulationError(f"{world.entities[e].name} starts on a junction, and on no lane that leads there")

    def _locate_on_track(self, track: LaneTrack, distance: float) -> tuple[str, float, int]:
        """Return the edge, the position in m and the lane at a distance in m along a track."""
        x, y, _ = track.pose_at(np.array([distance]), np.zeros(1), np.zeros(1, dtype=np.int64))
        road: tuple[str, float, int] = self._sumo.simulation.convertRoad(float(x[0]), float(y[0]))
        return road

    def _lane_position(self, start: tuple[str, float, int], route: Sequence[str]) -> tuple[str, float]:
        """Return the lane and the position in m at a start of a route, which may be beyond the end of its first edge.

        Beyond that end, the route leads along the lanes of a junction to its second edge.
        """
        lane, position = f"{start[0]}_{start[2]}", start[1]
        while position > (length := self._sumo.lane.getLength(lane)):
            links = [link for link in self._sumo.lane.getLinks(lane) if link[0].rpartition("_")[0] in route[1:2]]
            if not links or not links[0][4]:
                return lane, length
            lane, position = links[0][4], position - length
        return lane, position

    def _lane_track_of(self, world: World, e: int) -> LaneTrack | None:
        k = int(world.track[e, 0])
        track = world.tracks[e][k] if 0 <= k < len(world.tracks[e]) else None
        return track if isinstance(track, LaneTrack) else None

    def _set_max_speed(self, world: World, e: int, name: str) -> None:
        self._sumo.vehicle.setSpeed(name, -1.0)
        max_speed = min(float(world.target_speed[e, 0]), world.entities[e].max_speed)
        if math.isfinite(max_speed):
            self._sumo.vehicle.setMaxSpeed(name, max(max_speed, 0.01))

    def _move_in_sumo(self, world: World, e: int, name: str, dt: float) -> None:
        """Move an entity in SUMO to its position at the end of the step, or far away if the entity is on no lane."""
        speed, heading = float(world.speed[e, 0]), float(world.heading[e, 0])
        x, y = self._front_position(world, e)
        # A driver that steers has moved its entity already.
        step = 0.0 if world.steered[e, 0] else speed * dt
        x, y = x + step * math.cos(heading), y + step * math.sin(heading)
        follows_lane = self._lane_track_of(world, e) is not None and abs(float(world.offset[e, 0])) < _MAX_LANE_OFFSET
        if not (follows_lane or self._is_on_lane(world, e)):
            x, y = x + _REMOTE_OFFSET, y + _REMOTE_OFFSET
        self._sumo.vehicle.setSpeed(name, max(speed, 0.0))
        # In degrees clockwise from north.
        angle = (90.0 - math.degrees(heading)) % 360.0
        self._sumo.vehicle.moveToXY(name, "", -1, x, y, angle, keepRoute=1 if follows_lane else 2)

    def _is_on_lane(self, world: World, e: int) -> bool:
        """Return whether an entity's box reaches into a drivable lane; the answer is cached while the entity stands."""
        if world.network is None:
            return True
        pose = (float(world.x[e, 0]), float(world.y[e, 0]), float(world.heading[e, 0]))
        if e not in self._lane_cache or self._lane_cache[e][0] != pose:
            self._lane_cache[e] = (pose, self._reaches_lane(world, e))
        return self._lane_cache[e][1]

    def _reaches_lane(self, world: World, e: int) -> bool:
        assert world.network is not None
        entity = world.entities[e]
        corners = world.box_corners()[e, 0]
        points = np.concatenate([corners, corners.mean(axis=0, keepdims=True)])
        positions = world.network.locate(points[:, 0], points[:, 1])
        for road, lane, s, offset in zip(positions.road, positions.lane, positions.s, positions.offset, strict=True):
            road_object = world.network.roads[int(road)]
            section = int(road_object.section_at(np.array([s]))[0])
            lane_object = road_object.sections[section][1].get(int(lane))
            width = float(road_object.lane_width(section, int(lane), np.array([s]))[0])
            if (
                lane_object is not None
                and lane_object.is_drivable
                and abs(float(offset)) <= 0.5 * width + 0.05 * entity.width
            ):
                return True
        return False

    def _front_position(self, world: World, e: int) -> tuple[float, float]:
        entity, heading = world.entities[e], float(world.heading[e, 0])
        front_offset = entity.center_x + 0.5 * entity.length
        return float(world.x[e, 0]) + front_offset * math.cos(heading), float(world.y[e, 0]) + front_offset * math.sin(
            heading
        )

    def _move_from_sumo(self, world: World, e: int, name: str) -> None:
        sumo = self._sumo
        if name not in sumo.vehicle.getIDList():
            # It has arrived at the end of its route, and stays there.
            move_to_pose(world, e, world.x[e], world.y[e], world.heading[e], world.running)
            world.speed[e] = 0.0
            return
        x, y = sumo.vehicle.getPosition(name)
        heading = math.pi / 2 - math.radians(sumo.vehicle.getAngle(name))
        entity = world.entities[e]
        front_offset = entity.center_x + 0.5 * entity.length
        move_to_pose(
            world,
            e,
            np.array([x - front_offset * math.cos(heading)]),
            np.array([y - front_offset * math.sin(heading)]),
            np.array([wrap_angle(heading)]),
            world.running,
        )
        world.speed[e] = sumo.vehicle.getSpeed(name)


def _lane_track_here(world: World, e: int) -> LaneTrack | None:
    """Return the track along the lane at an entity, in the direction of its heading; None if there is no lane."""
    if world.network is None:
        return None
    pose = road_pose(world, e)
    road, lane, s = pose.road_coordinates()
    along = bool(is_heading_along_road(world, pose)[0])
    route = world.routes[int(world.route[e, 0])]
    return LaneTrack.from_lane(world.network, int(road[0]), int(lane[0]), float(s[0]), along, route)


def _format_vehicle_types() -> str:
    """Return the vehicle types as XML for SUMO; all of them are deterministic."""
    rows = [
        f"<vType id={quoteattr(name)} sigma='0' "
        + " ".join(f"{key}='{value:g}'" for key, value in settings.items())
        + "/>"
        for name, settings in {**VEHICLE_TYPES, "moved": _MOVED_TYPE}.items()
    ]
    return "<additional>\n" + "\n".join(rows) + "\n</additional>\n"
