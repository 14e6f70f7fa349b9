"""Drivers whose decisions are compiled, and fleets: the state of several drivers as arrays for compiled functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Final, TypeGuard
from weakref import WeakKeyDictionary

import numpy as np

from cornercase._common.numba.pointers import memory_address
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._base import DrivenPath, Driver, Situation
from cornercase.drivers._kernels.decide import DECISION_INPUTS, DRIVER_KERNELS, compute_accelerations
from cornercase.drivers._kernels.structs import (
    AHEAD_FOR,
    BEHAVIOUR,
    CENTER_X,
    CONFLICT_SINCE,
    FIRST_SEEN,
    HALF_LENGTH,
    HALF_WIDTH,
    LAST_SEEN,
    NOT_COMPILED,
    TURN,
    VULNERABLE,
    Fleet,
    Routes,
)
from cornercase.drivers._presets import Behaviour, FollowParameters
from cornercase.drivers._route import count_route_samples, plan_route
from cornercase.drivers._varied_driver import VariedDriver
from cornercase.drivers.vehicles._actuated import ActuatedVehicle
from cornercase.drivers.vehicles._kernels.actuators import ACTUATORS, Vehicles
from cornercase.drivers.vehicles._kernels.steered import MOTION_INPUTS, VEHICLE_KERNELS

_MIN_LIMIT = 1e-3
"""Smallest acceleration limit in m/s² of a driver, even if its vehicle can do less."""
_VULNERABLE_TYPES = ("pedestrian", "bicycle")

# Points and measures of routes along paths that all scenarios share, by path, then by the limits of the driver.
_ROUTE_CACHE: WeakKeyDictionary[DrivenPath, dict[tuple[float, ...], tuple[FloatArray, FloatArray]]] = (
    WeakKeyDictionary()
)
_ROUTE_LIMITS: Final = [Behaviour._fields.index(name) for name in ("lateral_acceleration", "comfortable_deceleration")]
"""Columns of `Fleet.parameters` on which routes depend."""


class CompiledDriver(VariedDriver):
    """Base class of drivers whose decisions are compiled.

    A driver keeps its state in the arrays of a `Fleet`, which compiled functions read: at first in a fleet of its own,
    after `attach_to_fleet` in a fleet that several drivers share.
    """

    kind: ClassVar[int]
    """Number of the kind of driver, as in `Fleet.kind`."""

    parameters: tuple[float, ...]
    """Values of the parameters, in the order that this kind of driver expects."""

    def start(self, scenarios: int, others: int) -> None:
        """Reset all state before `scenarios` scenarios are simulated, each with `others` other entities."""
        self._fleet = _empty_fleet(1, scenarios, others)
        self._fleet.kind[0] = self.kind
        self._fleet.parameters[0, :, : len(self.parameters)] = self.parameters
        # Keep a reference to the path, so that its id stays unique.
        self._routes: dict[int, tuple[DrivenPath, int]] = {}

    def vary(self, options: Sequence[Mapping[str, float]]) -> None:
        """Change options of the started driver; `options` has the changed values by name for each scenario."""
        for n, changed in enumerate(options):
            self._fleet.parameters[0, n, : len(self.parameters)] = self.with_options(**changed).parameters

    def attach_to_fleet(self, fleet: Fleet, row: int) -> None:
        """Move the driver's state into the arrays of a fleet; from then on, the driver uses its rows of these arrays.

        Parameters
        ----------
        fleet : Fleet
            Arrays with the state of several drivers.
        row : int
            Index of this driver in the fleet.
        """
        rows, own_fleet = slice(row, row + 1), self._fleet
        view = Fleet(
            kind=fleet.kind[rows],
            parameters=fleet.parameters[rows],
            own=fleet.own[rows],
            boxes=fleet.boxes[rows],
            memory=fleet.memory[rows],
            awareness=fleet.awareness[rows],
            routes=own_fleet.routes,
            kernels=fleet.kernels,
            vehicles=fleet.vehicles,
            first_vehicle=fleet.first_vehicle[rows],
            vehicle_kind=fleet.vehicle_kind[rows],
            vehicle_kernels=fleet.vehicle_kernels,
            half_widths=fleet.half_widths[rows],
            friction=fleet.friction,
        )
        view.kind[:], view.parameters[:] = own_fleet.kind, own_fleet.parameters
        view.memory[:], view.awareness[:] = own_fleet.memory, own_fleet.awareness
        self._fleet = view

    def acceleration(self, situation: Situation) -> FloatArray:
        """Return the acceleration along the path in m/s², shape (N,); 0 in scenarios that are not active."""
        s, fleet = situation, self._fleet
        fleet.own[0] = 0.5 * s.length, 0.5 * s.width, s.center_x
        fleet.boxes[0, HALF_LENGTH], fleet.boxes[0, HALF_WIDTH] = 0.5 * s.others_length, 0.5 * s.others_width
        fleet.boxes[0, CENTER_X] = s.others_center_x
        fleet.boxes[0, VULNERABLE] = _is_vulnerable(s.others_object_type)
        track = self._find_or_plan_route(s.path)
        # Contiguous arrays, so that kernels are compiled only once.
        own = s.distance, s.x, s.y, s.heading, s.speed, s.target_speed
        driven = np.ascontiguousarray(np.stack(own, axis=1))
        others = np.ascontiguousarray(np.stack((s.others_x, s.others_y, s.others_heading, s.others_speed), axis=1))
        active = np.ascontiguousarray(s.active)
        compile_fleet_kernels(self._fleet)
        result: FloatArray = compute_accelerations(self._fleet, 0, track, s.time, s.time_step, driven, others, active)
        return result

    def _find_or_plan_route(self, path: DrivenPath) -> int:
        """Return the index of the driver's route along a path; plan the route if the path is new."""
        if self.kind != BEHAVIOUR:
            return 0
        if id(path) not in self._routes:
            self._routes[id(path)] = (path, len(self._routes))
            self._fleet = set_route(self._fleet, 0, self._routes[id(path)][1], path)
        return self._routes[id(path)][1]


def is_compiled(driver: Driver) -> TypeGuard[CompiledDriver]:
    """Check whether compiled code makes a driver's decisions; False if a derived class overrides `acceleration`."""
    return isinstance(driver, CompiledDriver) and type(driver).acceleration is CompiledDriver.acceleration


def compile_fleet_kernels(fleet: Fleet) -> None:
    """Compile the functions that decide for the drivers of a fleet and move its vehicles; call this before use."""
    DRIVER_KERNELS.compile_needed(fleet.kind.tolist(), fleet, *DECISION_INPUTS)
    if len(fleet.vehicles.state):
        VEHICLE_KERNELS.compile_needed(fleet.vehicle_kind.tolist(), fleet.vehicles, *MOTION_INPUTS)


def limit_driver_acceleration(
    driver: CompiledDriver, max_acceleration: float, max_deceleration: float
) -> dict[str, float]:
    """Limit the parameters of a started driver to the acceleration and deceleration in m/s² of its vehicle.

    The limits hold until the driver is started again. Call this before the driver joins a fleet. The result has the
    driver's highest value for each exceeded limit, ``"acceleration"`` or ``"deceleration"``.
    """
    fields = Behaviour._fields if driver.kind == BEHAVIOUR else FollowParameters._fields
    parameters, exceeded = driver._fleet.parameters[0], dict[str, float]()
    for limit, bound, names in (
        ("acceleration", max_acceleration, ("acceleration",)),
        ("deceleration", max_deceleration, ("max_deceleration", "comfortable_deceleration")),
    ):
        columns = [fields.index(name) for name in names]
        highest = float(parameters[:, columns[0]].max(initial=0.0))
        if highest > bound:
            exceeded[limit] = highest
        # The formulas divide by these values.
        parameters[:, columns] = np.minimum(parameters[:, columns], max(bound, _MIN_LIMIT))
    return exceeded


def build_fleet(
    drivers: Sequence[Driver | None],
    driven_rows: Sequence[int],
    scenarios: int,
    length: FloatArray,
    width: FloatArray,
    center_x: FloatArray,
    object_types: Sequence[str],
    vehicles: Sequence[ActuatedVehicle | None] = (),
    friction: FloatArray | None = None,
) -> Fleet:
    """Create a fleet: arrays with the state of started drivers, for compiled functions and for `Driver.acceleration`.

    The state of compiled drivers and of their vehicle models moves into the fleet. `drivers` may also have None, or
    drivers that are not compiled. `driven_rows` has the index of each driver's entity among all E entities. `length`,
    `width` and `center_x` (E,) describe the boxes of all entities in m. `vehicles` has the started vehicle model of
    each driver, or None. `friction` (N,) is the friction coefficient of the road in each scenario; the simulator may
    change the values later. The new fleet has no routes.
    """
    fleet = _empty_fleet(len(drivers), scenarios, max(len(object_types) - 1, 0))
    fleet = _add_vehicles(fleet, vehicles, np.ones(scenarios) if friction is None else friction)
    boxes = np.stack((0.5 * length, 0.5 * width, center_x, _is_vulnerable(object_types)))
    for d, (driver, e) in enumerate(zip(drivers, driven_rows, strict=True)):
        fleet.own[d] = boxes[:VULNERABLE, e]
        fleet.boxes[d] = np.delete(boxes, e, axis=1)
        if driver is not None and is_compiled(driver):
            driver.attach_to_fleet(fleet, d)
    return fleet


def set_route(fleet: Fleet, driver: int, track: int, path: DrivenPath) -> Fleet:
    """Plan a driver's route along a path, and return the fleet with this route; the given fleet is then out of date.

    `track` is the number that the caller gives the path; an earlier route with this number is replaced. If the path or
    the driver's limits differ between scenarios, each scenario has a route of its own.
    """
    limits = fleet.parameters[driver][:, _ROUTE_LIMITS]
    is_same_for_all = path.distance.ndim == 1 and bool((limits == limits[:1]).all())
    samples, rows = count_route_samples(path), 1 if is_same_for_all else len(limits)
    routes = fleet.routes
    first = routes.row[driver, track] if track < routes.row.shape[1] else -1
    if first < 0 or (routes.rows[driver, track], routes.samples[first]) != (rows, samples):
        if first >= 0:
            routes = _remove_route(routes, driver, track)
        first = len(routes.begin)
        routes = _append_empty_route(routes, driver, track, rows, samples)
    points = routes.begin[first : first + rows][:, None] + np.arange(samples)
    routes.points[points], routes.measures[first : first + rows] = _plan_cached_routes(path, limits, rows)
    return fleet._replace(routes=routes)


def _plan_cached_routes(path: DrivenPath, limits: FloatArray, rows: int) -> tuple[FloatArray, FloatArray]:
    """Return `Routes.points` and `Routes.measures` of `rows` scenarios; a single route along a lane is cached.

    `limits` (N, 2): lateral acceleration and deceleration of the driver in m/s². A route that is the same in all
    scenarios has one row, and is cached.
    """
    if path.distance.ndim > 1 or rows > 1:
        return _measure_route(path, limits[:rows])
    key, cache = tuple(limits[0].tolist()), _ROUTE_CACHE.setdefault(path, {})
    if key not in cache:
        cache[key] = _measure_route(path, limits[:1])
    return cache[key]


def _measure_route(path: DrivenPath, limits: FloatArray) -> tuple[FloatArray, FloatArray]:
    plan = plan_route(path, lateral_acceleration=limits[:, 0], deceleration=limits[:, 1])
    columns = plan.x, plan.y, plan.cos, plan.sin, plan.max_speed_squared, plan.straight_count
    return np.stack(columns, axis=-1), np.stack((plan.step, plan.max_spacing, plan.max_turn), axis=-1)


def _append_empty_route(routes: Routes, driver: int, track: int, rows: int, samples: int) -> Routes:
    """Return the routes and an empty one for path number `track`, which has `rows` rows of `samples` points."""
    padding = ((0, 0), (0, max(track + 1 - routes.row.shape[1], 0)))
    row, counts = np.pad(routes.row, padding, constant_values=-1), np.pad(routes.rows, padding)
    row[driver, track], counts[driver, track] = len(routes.begin), rows
    return Routes(
        row=row,
        rows=counts,
        begin=np.append(routes.begin, len(routes.points) + samples * np.arange(rows)),
        samples=np.append(routes.samples, np.full(rows, samples)),
        measures=np.concatenate((routes.measures, np.empty((rows, 3)))),
        points=np.concatenate((routes.points, np.empty((rows * samples, 6)))),
    )


def _remove_route(routes: Routes, driver: int, track: int) -> Routes:
    """Return the routes without the route of a driver along path number `track`."""
    first, rows = int(routes.row[driver, track]), int(routes.rows[driver, track])
    removed = slice(first, first + rows)
    points = int(routes.samples[removed].sum())
    begin = int(routes.begin[first])
    row = np.where(routes.row > first, routes.row - rows, routes.row)
    row[driver, track] = -1
    return Routes(
        row=row,
        rows=routes.rows,
        begin=np.delete(np.where(routes.begin > begin, routes.begin - points, routes.begin), removed),
        samples=np.delete(routes.samples, removed),
        measures=np.delete(routes.measures, removed, axis=0),
        points=np.delete(routes.points, slice(begin, begin + points), axis=0),
    )


def _empty_fleet(drivers: int, scenarios: int, others: int) -> Fleet:
    memory = np.full((drivers, scenarios, AHEAD_FOR + 1, others), np.nan)
    memory[:, :, TURN], memory[:, :, AHEAD_FOR] = 0.0, 0.0
    memory[:, :, FIRST_SEEN], memory[:, :, LAST_SEEN], memory[:, :, CONFLICT_SINCE] = np.inf, -np.inf, np.inf
    none = np.empty(0, dtype=np.int64)
    unplanned = np.full((drivers, 1), -1, dtype=np.int64)
    return Fleet(
        kind=np.full(drivers, NOT_COMPILED, dtype=np.int64),
        parameters=np.zeros((drivers, scenarios, len(Behaviour._fields))),
        own=np.zeros((drivers, 3)),
        boxes=np.zeros((drivers, VULNERABLE + 1, others)),
        memory=memory,
        awareness=np.zeros((drivers, scenarios, 3, others), dtype=np.bool_),
        routes=Routes(unplanned, unplanned + 1, none, none, np.empty((0, 3)), np.empty((0, 6))),
        kernels=DRIVER_KERNELS.addresses,
        vehicles=Vehicles(np.empty((0, 0)), np.empty((0, 0)), np.empty((0, 0, 0))),
        first_vehicle=np.full(drivers, -1, dtype=np.int64),
        vehicle_kind=np.full(drivers, ACTUATORS),
        vehicle_kernels=VEHICLE_KERNELS.addresses,
        half_widths=np.zeros((drivers, 1), dtype=np.int64),
        friction=np.ones(scenarios),
    )


def _add_vehicles(fleet: Fleet, vehicles: Sequence[ActuatedVehicle | None], friction: FloatArray) -> Fleet:
    """Return an empty fleet with arrays for the state of the vehicle models, and make the models use these arrays.

    `vehicles` has the model of each driver, None without a model.
    """
    equipped = [(d, vehicle) for d, vehicle in enumerate(vehicles) if vehicle is not None]
    if equipped:
        tables = [vehicle.tables for _, vehicle in equipped]
        widest, size = (max(table.shape[-1] for table in column) for column in list(zip(*tables, strict=True))[::2])
        parameters = [np.pad(rows, ((0, 0), (0, widest - rows.shape[1]))) for rows, *_ in tables]
        # No vehicle has taken a step, so its requests are yet to come.
        requests = np.zeros((len(tables) * len(friction), 2, size))
        shared = Vehicles(np.concatenate(parameters), np.concatenate([state for _, state, _ in tables]), requests)
        fleet = fleet._replace(vehicles=shared)
    for k, (d, vehicle) in enumerate(equipped):
        rows = slice(k * len(friction), (k + 1) * len(friction))
        fleet.first_vehicle[d], fleet.vehicle_kind[d] = rows.start, vehicle.kind
        vehicle.use_tables(Vehicles(*(column[rows] for column in fleet.vehicles)))
    return fleet._replace(friction=friction)


def set_half_widths(fleet: Fleet, driver: int, track: int, half_widths: FloatArray) -> Fleet:
    """Return the fleet with half the lane width in m at each sample of path number `track`.

    The fleet only has the address of the array `half_widths`, so the caller must keep a reference to the array.
    """
    addresses = np.pad(fleet.half_widths, ((0, 0), (0, max(track + 1 - fleet.half_widths.shape[1], 0))))
    addresses[driver, track] = memory_address(half_widths)
    return fleet._replace(half_widths=addresses)


def _is_vulnerable(object_types: Sequence[str]) -> BoolArray:
    return np.array([object_type in _VULNERABLE_TYPES for object_type in object_types], dtype=np.bool_)
