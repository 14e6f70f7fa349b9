"""Running one batch: concrete scenarios of one file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from threading import Lock
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.parts import format_instant
from cornercase._common.places import placed
from cornercase._common.typing import BoolArray
from cornercase.drivers import Driver
from cornercase.recordings import Collision, Recording
from cornercase.scenario import Scope, Value, later_version
from cornercase.simulators.builtin.actions.controller import DriverError, Driving, registered_driver
from cornercase.simulators.builtin.entities import read_entities
from cornercase.simulators.builtin.frames.recorded import motion_of
from cornercase.simulators.builtin.frames.scene import CENTER_X, LENGTH, WIDTH
from cornercase.simulators.builtin.openscenario import refuse_unusable
from cornercase.simulators.builtin.paths.positions import entities_in
from cornercase.simulators.builtin.prepared import PreparedScenario, UnusableError
from cornercase.simulators.builtin.stepping import Coupling, Stepper
from cornercase.simulators.builtin.storyboard.storyboard import Storyboard
from cornercase.simulators.builtin.world.signals import read_signal_controllers
from cornercase.simulators.builtin.world.state import World

_MOST_ENTITIES: Final = 500


class Batch:
    """All concrete scenarios that share a file and everything that shapes its storyboard.

    Parameters
    ----------
    prepared : PreparedScenario
        The file.
    values : sequence of mapping of str to float or str, length N
        Parameters of each concrete scenario.
    time_step : float
        s.
    duration : float
        s after which a scenario ends at the latest.
    stop_at_collision : bool
    drivers : mapping of str to Driver or str
        Who drives which entity; a name is one of `DRIVERS`. Beats the file's own controller properties.
    coupling : Coupling, optional
        Another simulator that moves some of the entities.

    Raises
    ------
    UnusableError
        The file cannot be used with the values of these scenarios.
    VariesError
        The scenarios have to be split further.

    Attributes
    ----------
    failure : DriverError or None
        Why the batch ended early, once it has run. It is the result of a scenario that is alone; of several it tells
        nothing, and nothing else that came out is of use.
    """

    def __init__(
        self,
        prepared: PreparedScenario,
        values: Sequence[Mapping[str, Value]],
        time_step: float,
        duration: float,
        stop_at_collision: bool,
        drivers: Mapping[str, Driver | str],
        coupling: Coupling | None = None,
    ) -> None:
        scope, self._name = prepared.scope(values), prepared.scenario.path.name
        self._time_step = time_step
        self.failure: DriverError | None = None
        try:
            self._read(prepared, scope, drivers)
        except InputError as error:
            minor, words = later_version(prepared.scenario.root), str(error)
            if minor is not None and "not supported" in words:
                words = f"{words.removesuffix('.')}. OpenSCENARIO XML 1.{minor}, of which the file is, may have it."
            raise UnusableError(words, scope.used) from None
        self._stepper = Stepper(self._world, self._storyboard, time_step, duration, stop_at_collision, coupling)

    def _read(self, prepared: PreparedScenario, scope: Scope, drivers: Mapping[str, Driver | str]) -> None:
        scenario = prepared.scenario
        refuse_unusable(prepared)
        board = scenario.root.find("Storyboard")
        init = None if board is None else board.find("Init")
        first = board if init is None else init
        self._init = "" if first is None else f"line {first.sourceline}: <{first.tag}>"
        file = scenario.root.find("RoadNetwork/LogicFile")
        road_file = "" if file is None else scope.text(file, "filepath", "")
        with placed(file, scope.source):
            network = prepared.network(road_file) if road_file else None
        objects = list(scenario.root.iterfind("Entities/ScenarioObject"))
        with placed(scenario.root.find("Entities"), scope.source):
            if not objects:
                raise InputError("has no entities, so there is nothing to simulate.")
            if len(objects) > _MOST_ENTITIES:
                raise InputError(f"has {len(objects)} entities; the builtin simulator moves {_MOST_ENTITIES}.")
        entities, tows = read_entities(objects, scope)
        self._world = World(entities, scope.scenarios, network, tows)
        self._world.signal_controllers = read_signal_controllers(scenario.root, scope)
        self._world.selections = _selections(scenario.root, self._world, scope)
        self._world.parameters = {name: _held(value, scope.scenarios) for name, value in scope.values.items()}
        self._world.variables = scope.declared(
            scenario.root, "VariableDeclarations/VariableDeclaration", "variableType"
        )
        lines = {one.name: one.sourceline for one in prepared.declarations}
        for name, broken in scope.violations(scenario.root).items():
            why = f"line {lines.get(name)}: the value of {name} breaks a constraint of its <ParameterDeclaration>"
            self._world.fail(broken, why)
        chosen = {**scenario.drivers, **drivers}
        for e, name in enumerate(self._world.names):
            driver = chosen.get(name)
            if driver is None:
                continue
            with placed(None if name in drivers else objects[e], scope.source):
                built = registered_driver(driver, scope.source) if isinstance(driver, str) else driver
            number = Driving(self._world, e, built).number
            self._world.kept[e] = name in drivers
            self._world.control(e, np.ones(scope.scenarios, dtype=np.bool_), number, True)
        self._storyboard = Storyboard(scenario, scope, self._world)
        # Once more, now that it is known which entries of catalogs there are.
        refuse_unusable(prepared)
        for why, where in scope.refused():
            self._world.fail(where, why)

    @property
    def _drivings(self) -> list[Driving]:
        return [one for one in self._world.drivers if isinstance(one, Driving)]

    @property
    def in_python(self) -> bool:
        """Whether a driver decides in Python, as those of users do."""
        return not all(one.in_fleet for one in self._drivings)

    @property
    def remarks(self) -> list[str]:
        """Sentences on drivers that asked for more than their vehicles can do, and on what is not as the file says.

        Once the batch has run; without a full stop.
        """
        if self.failure is not None and self._world.scenarios > 1:
            return []
        # Actions know their line, and where they do not stand in the scenario file the name of theirs.
        remarks = [one.replace("(line ", f"({self._name}, line ", 1) for one in self._world.remarks]
        return [*remarks, *(text for one in self._drivings for text in one.exceeded.values())]

    def run(self, threads: int = 1, turn: Lock | None = None) -> None:
        """Step until every scenario has ended, or a driver fails.

        Parameters
        ----------
        threads : int, default 1
            At most.
        turn : Lock, optional
            What only one thread may have that is in Python; held here, but for while compiled code runs.
        """
        # What has failed goes on to be computed, and is not looked at.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            try:
                for driving in self._drivings:
                    driving.begin()
                self._stepper.run(threads, turn)
            except DriverError as failure:
                self.failure = failure
                if self._world.scenarios == 1:
                    self._world.errors[0] = failure.error

    def halt(self) -> None:
        """Let `run`, in another thread, come to an end soon; nothing that came out is of use then."""
        self._stepper.halted = True

    def results(self, chosen: Sequence[int], turn: Lock | None = None) -> list[Recording | SimulationError]:
        """Give what came out of some scenarios, once the batch has run.

        Parameters
        ----------
        chosen : sequence of int
        turn : Lock, optional
            What only one thread may have that is in Python; held here, but for while compiled code runs.

        Returns
        -------
        list of Recording or SimulationError
            Each with memory of its own.
        """
        world, scene = self._world, self._stepper.scene
        motion, placed = motion_of(scene, np.array(chosen, dtype=np.int64), turn)
        names, kinds = tuple(world.names), tuple(entity.kind for entity in world.entities)
        boxes = np.ascontiguousarray(scene.boxes[:, [LENGTH, WIDTH, CENTER_X]].T)
        time = np.arange(scene.frames.max(initial=0)) * self._time_step
        result: list[Recording | SimulationError] = []
        for i, moved, there in zip(chosen, motion, placed.tolist(), strict=True):
            if i in world.errors:
                result.append(world.errors[i])
                continue
            if not there:
                ended = format_instant(time[moved.shape[2] - 1])
                result.append(SimulationError(f"{self._init}: no action places an entity on the map up to{ended[3:]}"))
                continue
            length, width, center_x = boxes.copy()
            result.append(
                Recording(
                    time=time[: moved.shape[2]].copy(),
                    names=names,
                    kinds=kinds,
                    # Iterating over an array takes twice as long.
                    x=moved[0],
                    y=moved[1],
                    heading=moved[2],
                    speed=moved[3],
                    acceleration=moved[4],
                    length=length,
                    width=width,
                    center_x=center_x,
                    collisions=self._collisions.get(i, ()),
                    cut_off=bool(self._cut_off[i]),
                )
            )
        return result

    def bytes_of(self, i: int) -> int:
        """Say how much memory the recording of a scenario takes, once the batch has run."""
        return self._bytes[i]

    @cached_property
    def _bytes(self) -> list[int]:
        scene = self._stepper.scene
        sizes: list[int] = (scene.frames * scene.pages[0, :, :, 0].nbytes).tolist()
        return sizes

    @cached_property
    def _cut_off(self) -> BoolArray:
        """Where the longest duration ended a run before its storyboard did, shape (N,)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray((self._stepper.scene.frames == self._stepper.most) & self._storyboard.unfinished())

    @cached_property
    def _collisions(self) -> dict[int, tuple[Collision, ...]]:
        """Who collided, in order of time, in scenarios with collisions."""
        begun, names = self._stepper.scene.collided, self._world.names
        scenarios, firsts, seconds = np.nonzero(~np.isnan(begun))
        # The clock adds up steps; the instants of a recording are multiples of one.
        times = np.rint(begun[scenarios, firsts, seconds] / self._time_step) * self._time_step
        columns = (scenarios, times, firsts, seconds)
        found: dict[int, list[Collision]] = {}
        for i, time, a, b in sorted(zip(*(column.tolist() for column in columns), strict=True)):
            found.setdefault(i, []).append(Collision(time, (names[a], names[b])))
        return {i: tuple(each) for i, each in found.items()}


def _held(value: Any, scenarios: int) -> Any:
    if isinstance(value, bool | np.bool_ | str):
        text = str(value).lower() if not isinstance(value, str) else value
        return np.full(scenarios, text)
    array = np.asarray(value)
    if array.dtype.kind == "b":
        return np.broadcast_to(np.where(array, "true", "false"), (scenarios,)).copy()
    return np.broadcast_to(array.astype(np.float64), (scenarios,)).copy()


def _selections(root: etree._Element, world: World, scope: Scope) -> dict[str, list[int]]:
    """Rows of the members of each entity selection, of entities named or of a type."""
    found: dict[str, list[int]] = {}
    for selection in root.iterfind("Entities/EntitySelection"):
        members = selection.find("Members")
        if members is None:
            continue
        rows = entities_in(members, scope, world)
        for by_type in members.iterfind("ByType"):
            kind = scope.text(by_type, "objectType")
            rows += [k for k, one in enumerate(world.entities) if _object_type(one.kind) == kind and k not in rows]
        found[scope.text(selection, "name")] = rows
    return found


def _object_type(kind: str) -> str:
    return {"pedestrian": "pedestrian", "misc": "miscellaneous"}.get(kind, "vehicle")
