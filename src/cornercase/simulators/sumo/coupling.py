"""One SUMO simulation in step with a storyboard."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from xml.sax.saxutils import quoteattr

import numpy as np

from cornercase._common.errors import SimulationError
from cornercase._common.geometry import within_half_turn
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.world.contacts import entity_corners
from cornercase.simulators.builtin.world.motion import pull_entity
from cornercase.simulators.builtin.world.state import Entity, World

# Of SUMO's models: tau is the time headway in s, jmTimegapMinor the time in s that a driver leaves to traffic
# with the right of way, and impatience how much it relies on that traffic to brake. With jmIgnoreJunctionFoeProb it
# completes a turn that it has begun. None of them is calibrated.
TYPES: Final[dict[str, dict[str, float]]] = {
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
# An entity that the storyboard moves yields to nobody and goes exactly where it is put.
_MOVED: Final = {
    "minGap": 0.0, "jmIgnoreFoeProb": 1.0, "jmIgnoreFoeSpeed": 100.0, "jmIgnoreJunctionFoeProb": 1.0,
}  # fmt: skip

_OPTIONS: Final = (
    "--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never", "--collision.action", "none",
    "--time-to-teleport", "-1", "--step-method.ballistic", "true", "--default.speeddev", "0",
)  # fmt: skip
# An entity that is further than this from the middle of its lane, in m, does not follow the lane.
_BESIDE: Final = 0.3
_AWAY: Final = 1e5


class SumoCoupling:
    """One run of SUMO, of which there is only one in a process.

    Parameters
    ----------
    network : Path
    types : mapping of str to str
        Vehicle type of each entity that SUMO drives; it shows all others to it.
    time_step : float
        s.
    seed : int

    Attributes
    ----------
    error : SimulationError or None
        Why SUMO could not go on.
    """

    def __init__(self, network: Path, types: Mapping[str, str], time_step: float, seed: int) -> None:
        # libsumo prints warnings about other packages when it is imported.
        with redirect_stdout(io.StringIO()):
            import libsumo

        self._sumo: Any = libsumo
        self._types = types
        self._known: dict[int, str] = {}
        self._looked_up: dict[int, tuple[tuple[float, float, float], bool]] = {}
        self.error: SimulationError | None = None
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        kinds = Path(self._folder.name) / "types.add.xml"
        kinds.write_text(_types(), encoding="utf-8")
        arguments = [
            "--additional-files",
            str(kinds),
            "--net-file",
            str(network),
            "--step-length",
            f"{time_step:g}",
            "--seed",
            str(seed),
            *_OPTIONS,
        ]
        arguments += ["--default.action-step-length", f"{time_step:g}"]
        # Loading again takes far less time than starting.
        if libsumo.simulation.isLoaded():
            libsumo.simulation.load(arguments)
        else:
            libsumo.simulation.start(["sumo", *arguments])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._folder.cleanup()

    def step(self, world: World, dt: float) -> None:
        """Show SUMO the others as they will be at the end of a step, let it step, and take over whom it drives.

        Parameters
        ----------
        world : World
            Of one scenario; changed in place.
        dt : float
            s; with 0 the entities that are there are only made known.
        """
        if self.error is not None or not world.running[0]:
            return
        try:
            for e in np.flatnonzero(world.present[:, 0]).tolist():
                if e not in self._known:
                    self._add(world, e)
            if dt == 0.0:
                return
            for e, name in self._known.items():
                if name in self._types:
                    self._ask(world, e, name)
                else:
                    self._show(world, e, name, dt)
            self._sumo.simulationStep()
            for e, name in self._known.items():
                if name in self._types:
                    self._take(world, e, name)
        except self._sumo.TraCIException as error:
            self._fail(world, f"SUMO cannot go on at {world.time:g} s ({error})")

    def _fail(self, world: World, why: str) -> None:
        self.error = SimulationError(why)
        world.running[:] = False

    def _add(self, world: World, e: int) -> None:
        sumo, one = self._sumo, world.entities[e]
        name = one.name
        kind = self._vehicle_type(one)
        start, end = self._ends(world, e)
        route = sumo.simulation.findRoute(start[0], end[0]).edges or (start[0],)
        sumo.route.add(f"route {name}", route)
        sumo.vehicle.add(
            name, f"route {name}", typeID=kind, departLane=str(start[2]), departPos=f"{start[1]:.6f}",
            departSpeed=f"{max(float(world.speed[e, 0]), 0.0):.6f}",
        )  # fmt: skip
        # Puts it there at once, even where another one is.
        sumo.vehicle.moveTo(name, f"{start[0]}_{start[2]}", start[1])
        if name in self._types:
            sumo.vehicle.setSpeed(name, max(float(world.speed[e, 0]), 0.0))
        else:
            # It goes where the storyboard says and yields to nobody.
            sumo.vehicle.setSpeedMode(name, 32)
            sumo.vehicle.setLaneChangeMode(name, 0)
        self._known[e] = name

    def _vehicle_type(self, one: Entity) -> str:
        sumo, name, temper = self._sumo, f"type {one.name}", self._types.get(one.name)
        sumo.vehicletype.copy(temper or "moved", name)
        sumo.vehicletype.setLength(name, one.length)
        sumo.vehicletype.setWidth(name, one.width)
        if temper is not None:
            kind = TYPES[temper]
            sumo.vehicletype.setAccel(name, min(kind["accel"], one.max_acceleration))
            sumo.vehicletype.setDecel(name, min(kind["decel"], one.max_deceleration))
            sumo.vehicletype.setEmergencyDecel(
                name, max(kind["decel"], min(kind["emergencyDecel"], one.max_deceleration))
            )
        return name

    def _ends(self, world: World, e: int) -> tuple[tuple[str, float, int], tuple[str, float, int]]:
        """Edge, place on it and lane where an entity's front is, and where its way ends."""
        x, y = self._front(world, e)
        begin = self._sumo.simulation.convertRoad(x, y)
        track = self._lane_track(world, e)
        if track is None or begin[0].startswith(":"):
            # It may begin on a junction. As its place is set in each step, any edge will do.
            anywhere = next(edge for edge in self._sumo.edge.getIDList() if not edge.startswith(":"))
            return (anywhere, 0.0, 0), (anywhere, 0.0, 0)
        # The very end of a path may lie just outside the network.
        far = np.array([max(track.length - 1.0, 0.0)])
        end_x, end_y, _ = track.at(far, np.zeros(1), np.zeros(1, dtype=np.int64))
        return begin, self._sumo.simulation.convertRoad(float(end_x[0]), float(end_y[0]))

    def _lane_track(self, world: World, e: int) -> LaneTrack | None:
        k = int(world.track[e, 0])
        track = world.tracks[e][k] if 0 <= k < len(world.tracks[e]) else None
        return track if isinstance(track, LaneTrack) else None

    def _ask(self, world: World, e: int, name: str) -> None:
        """Tell SUMO how fast an entity that it drives may go."""
        self._sumo.vehicle.setSpeed(name, -1.0)
        wanted = min(float(world.target_speed[e, 0]), world.entities[e].max_speed)
        if math.isfinite(wanted):
            self._sumo.vehicle.setMaxSpeed(name, max(wanted, 0.01))

    def _show(self, world: World, e: int, name: str, dt: float) -> None:
        """Put an entity where it will be at the end of the step."""
        speed, heading = float(world.speed[e, 0]), float(world.heading[e, 0])
        x, y = self._front(world, e)
        x, y = x + speed * dt * math.cos(heading), y + speed * dt * math.sin(heading)
        on_way = self._lane_track(world, e) is not None and abs(float(world.offset[e, 0])) < _BESIDE
        if not (on_way or self._on_lane(world, e)):
            x, y = x + _AWAY, y + _AWAY
        self._sumo.vehicle.setSpeed(name, max(speed, 0.0))
        self._sumo.vehicle.moveToXY(name, "", -1, x, y, _compass(heading), keepRoute=1 if on_way else 2)

    def _on_lane(self, world: World, e: int) -> bool:
        """Whether an entity's box reaches into a lane for vehicles; looked up only where it has moved."""
        if world.network is None:
            return True
        pose = (float(world.x[e, 0]), float(world.y[e, 0]), float(world.heading[e, 0]))
        if e not in self._looked_up or self._looked_up[e][0] != pose:
            self._looked_up[e] = (pose, self._reaches(world, e))
        return self._looked_up[e][1]

    def _reaches(self, world: World, e: int) -> bool:
        assert world.network is not None
        one = world.entities[e]
        corners = entity_corners(world)[e, 0]
        places = np.concatenate([corners, corners.mean(axis=0, keepdims=True)])
        found = world.network.locate(places[:, 0], places[:, 1])
        for road, lane, s, offset in zip(found.road, found.lane, found.s, found.offset, strict=True):
            road_ = world.network.roads[int(road)]
            section = int(road_.section_at(np.array([s]))[0])
            known = road_.sections[section][1].get(int(lane))
            width = float(road_.width(section, int(lane), np.array([s]))[0])
            if known is not None and known.drivable and abs(float(offset)) <= 0.5 * width + 0.05 * one.width:
                return True
        return False

    def _front(self, world: World, e: int) -> tuple[float, float]:
        one, heading = world.entities[e], float(world.heading[e, 0])
        ahead = one.center_x + 0.5 * one.length
        return float(world.x[e, 0]) + ahead * math.cos(heading), float(world.y[e, 0]) + ahead * math.sin(heading)

    def _take(self, world: World, e: int, name: str) -> None:
        """Move an entity where SUMO has driven it."""
        sumo = self._sumo
        if name not in sumo.vehicle.getIDList():
            # It has arrived at the end of its way, and stays there.
            pull_entity(world, e, world.x[e], world.y[e], world.heading[e], np.zeros(1))
            return
        x, y = sumo.vehicle.getPosition(name)
        heading = math.pi / 2 - math.radians(sumo.vehicle.getAngle(name))
        one = world.entities[e]
        behind = one.center_x + 0.5 * one.length
        pull_entity(
            world,
            e,
            np.array([x - behind * math.cos(heading)]),
            np.array([y - behind * math.sin(heading)]),
            np.array([within_half_turn(heading)]),
            np.array([sumo.vehicle.getSpeed(name)]),
        )


def _compass(heading: float) -> float:
    """Degrees clockwise from north."""
    return (90.0 - math.degrees(heading)) % 360.0


def _types() -> str:
    """Vehicle types as SUMO reads them; none leaves anything to chance."""
    rows = [
        f"<vType id={quoteattr(name)} sigma='0' " + " ".join(f"{key}='{value:g}'" for key, value in kind.items()) + "/>"
        for name, kind in {**TYPES, "moved": _MOVED}.items()
    ]
    return "<additional>\n" + "\n".join(rows) + "\n</additional>\n"
