"""Named quantities of the traffic that can be inputs of an FMU, computed for a whole batch of scenarios."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.errors import suggest_name
from cornercase._common.typing import FloatArray, IntArray
from cornercase.drivers._base import Situation
from cornercase.drivers._driving_function import Body
from cornercase.drivers._view import SharedView, SignalView, View

if TYPE_CHECKING:
    from cornercase.drivers._surroundings import LaneView
    from cornercase.roads._network import RoadNetwork

_FAR: Final = 1000.0
_FAST: Final = 100.0


class Traffic:
    """Traffic around the ego in N scenarios, with access to the A other entities in the order of their distance."""

    def __init__(self, situation: Situation, body: Body, network: RoadNetwork | None = None) -> None:
        self.situation, self.body, self.shared = situation, body, SharedView(situation, network)
        self._path_points: dict[float, tuple[FloatArray, ...]] = {}

    @cached_property
    def _distance_order(self) -> IntArray:
        """Indices of the others by increasing distance, shape (N, A); others that do not exist come last."""
        x, y, _ = self.shared.relative_poses
        return np.argsort(np.hypot(x, y), axis=1, kind="stable")

    def get_others_field(self, name: str) -> FloatArray:
        """Return a property of the A other entities, such as ``"gap"``, the nearest first, shape (N, A).

        Values are NaN for entities that do not exist, or that do not have the property.
        """
        if name not in self._fields:
            values: FloatArray = np.take_along_axis(_OTHER_FIELDS[name](self), self._distance_order, axis=1)
            self._fields[name] = values
        return self._fields[name]

    @cached_property
    def _fields(self) -> dict[str, FloatArray]:
        return {}

    def get_ranked_field(self, name: str, rank: int) -> FloatArray:
        """Return a property of the entity at a rank in distance (0: nearest), shape (N,); NaN without an entity."""
        values = self.get_others_field(name)
        return values[:, rank] if rank < values.shape[1] else np.full(len(values), np.nan)

    def get_leader_field(self, name: str) -> FloatArray:
        """Return a property of the leader (entity ahead in the ego's path), shape (N,); NaN if there is none."""
        leader, values = self.shared.leader, _OTHER_FIELDS[name](self)
        if not values.shape[1]:
            return np.full(len(values), np.nan)
        of_leader: FloatArray = np.where(leader < 0, np.nan, values[np.arange(len(values)), leader])
        return of_leader

    def get_path_point_field(self, field: str, ahead: float) -> FloatArray:
        """Return a property of the point of the path `ahead` m ahead of the ego, such as ``"x"``, shape (N,)."""
        if ahead not in self._path_points:
            self._path_points[ahead] = tuple(self.shared.path_points(np.array([ahead])))
        return self._path_points[ahead][[*_PATH_UNITS].index(field)][:, 0]

    def get_lane_field(self, field: str, number: int) -> FloatArray:
        """Return a property of a lane by its number (0: the ego's lane), such as ``"width"``, shape (N,)."""
        return self._per_scenario(lambda view: _LANE_FIELDS[field](_find_lane(view, number)))

    def get_signal_field(self, field: str) -> FloatArray:
        """Return a property of the next traffic signal along the path, such as ``"gap"`` or ``"state"``, shape (N,)."""
        return self._per_scenario(lambda view: _SIGNAL_FIELDS[field](_next_signal(view)))

    @cached_property
    def speed_limit(self) -> FloatArray:
        """Speed limit of the ego's lane in m/s, shape (N,) for N scenarios."""
        return self._per_scenario(lambda view: view.speed_limit)

    def _per_scenario(self, compute: Callable[[View], float]) -> FloatArray:
        values = np.full(len(self.situation.speed), np.nan)
        for n in np.flatnonzero(self.situation.active).tolist():
            values[n] = compute(View(self.shared, n))
        return values

    @property
    def exists(self) -> FloatArray:
        """1 where an other entity exists in a scenario, NaN where it does not, shape (N, A) for A other entities."""
        return np.where(np.isnan(self.situation.others_x), np.nan, 1.0)


@dataclass(frozen=True)
class InputQuantity:
    """Quantity of the traffic that an input of an FMU can be given, such as the gap to the leader.

    `unit` is an SI unit. `compute` returns the values in N scenarios, shape (N,); NaN or infinity in scenarios without
    the quantity. In these scenarios the FMU is given the value `none` instead, such as a large gap.
    """

    name: str
    unit: str
    none: float
    compute: Callable[[Traffic], FloatArray]

    def __reduce__(self) -> tuple[Callable[[str], InputQuantity | None], tuple[str]]:
        return find_quantity, (self.name,)


def _time_to_collision(traffic: Traffic) -> FloatArray:
    gap, closing, _, _ = traffic.shared.objects_along_path
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((gap >= 0.0) & (closing > 0.0), gap / closing, np.nan)


def _in_path(traffic: Traffic) -> FloatArray:
    return np.where(traffic.shared.objects_along_path[3], 1.0, 0.0) * traffic.exists


def _type_codes(traffic: Traffic) -> FloatArray:
    types = traffic.situation.others_object_type
    return np.array([_TYPE_CODES.get(name, 1.0) for name in types]) * traffic.exists


def _find_lane(view: View, number: int) -> LaneView | None:
    return next((lane for lane in view.lanes if lane.number == number), None)


def _next_signal(view: View) -> SignalView | None:
    return next((signal for signal in view.signals.values() if signal.gap >= 0.0), None)


_TYPE_CODES: Final = {"pedestrian": 2.0, "misc": 3.0}
_OTHER_FIELDS: Final[Mapping[str, Callable[[Traffic], FloatArray]]] = {
    "exists": lambda traffic: traffic.exists,
    "x": lambda traffic: traffic.shared.relative_poses[0],
    "y": lambda traffic: traffic.shared.relative_poses[1],
    "heading": lambda traffic: traffic.shared.relative_poses[2],
    "speed": lambda traffic: traffic.situation.others_speed,
    "length": lambda traffic: traffic.situation.others_length * traffic.exists,
    "width": lambda traffic: traffic.situation.others_width * traffic.exists,
    "gap": lambda traffic: traffic.shared.objects_along_path[0],
    "closing": lambda traffic: traffic.shared.objects_along_path[1],
    "lateral": lambda traffic: traffic.shared.objects_along_path[2],
    "ttc": _time_to_collision,
    "in_path": _in_path,
    "type": _type_codes,
}
# Unit, and value that an FMU is given if there is no such object.
_OTHER_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "exists": ("1", 0.0),
    "x": ("m", _FAR),
    "y": ("m", 0.0),
    "heading": ("rad", 0.0),
    "speed": ("m/s", 0.0),
    "length": ("m", 0.0),
    "width": ("m", 0.0),
    "gap": ("m", _FAR),
    "closing": ("m/s", 0.0),
    "lateral": ("m", 0.0),
    "ttc": ("s", _FAR),
    "in_path": ("1", 0.0),
    "type": ("1", 0.0),
}

# Units of the properties of a point of the path, in the order of `SharedView.path_points`.
_PATH_UNITS: Final[Mapping[str, str]] = {"x": "m", "y": "m", "heading": "rad", "curvature": "1/m"}
_STATE_CODES: Final = {"red": 1.0, "yellow": 2.0, "amber": 2.0, "green": 3.0}
_LANE_FIELDS: Final[Mapping[str, Callable[[LaneView | None], float]]] = {
    "exists": lambda lane: float(lane is not None),
    "same_direction": lambda lane: np.nan if lane is None else float(lane.same_direction),
    "width": lambda lane: np.nan if lane is None else lane.width,
    "offset": lambda lane: np.nan if lane is None else lane.offset,
    "curvature": lambda lane: np.nan if lane is None else lane.curvature,
    "speed_limit": lambda lane: np.nan if lane is None else lane.speed_limit,
}
_SIGNAL_FIELDS: Final[Mapping[str, Callable[[SignalView | None], float]]] = {
    "exists": lambda signal: float(signal is not None),
    "gap": lambda signal: np.nan if signal is None else signal.gap,
    "state": lambda signal: np.nan if signal is None else _STATE_CODES.get(signal.state.casefold(), 0.0),
}
# Unit, and value that an FMU is given if there is no such lane or signal.
_LANE_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "exists": ("1", 0.0),
    "same_direction": ("1", 0.0),
    "width": ("m", 0.0),
    "offset": ("m", 0.0),
    "curvature": ("1/m", 0.0),
    "speed_limit": ("m/s", _FAST),
}
_SIGNAL_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "exists": ("1", 0.0),
    "gap": ("m", _FAR),
    "state": ("1", 0.0),
}


def _repeat_per_scenario(value: Callable[[Traffic], float]) -> Callable[[Traffic], FloatArray]:
    return lambda traffic: np.full(len(traffic.situation.speed), value(traffic))


def _get_leader_field(field: str, traffic: Traffic) -> FloatArray:
    return traffic.get_leader_field(field)


def _get_signal_field(field: str, traffic: Traffic) -> FloatArray:
    return traffic.get_signal_field(field)


def _get_path_point_field(field: str, ahead: float, traffic: Traffic) -> FloatArray:
    return traffic.get_path_point_field(field, ahead)


def _get_lane_field(field: str, number: int, traffic: Traffic) -> FloatArray:
    return traffic.get_lane_field(field, number)


def _get_ranked_field(field: str, rank: int, traffic: Traffic) -> FloatArray:
    return traffic.get_ranked_field(field, rank)


_EGO: Final = (
    InputQuantity("time", "s", 0.0, _repeat_per_scenario(lambda traffic: traffic.shared.time)),
    InputQuantity("target_speed", "m/s", _FAST, lambda traffic: traffic.situation.target_speed),
    InputQuantity("ego.speed", "m/s", 0.0, lambda traffic: traffic.situation.speed),
    InputQuantity("ego.acceleration", "m/s²", 0.0, lambda traffic: traffic.situation.acceleration),
    InputQuantity("ego.x", "m", 0.0, lambda traffic: traffic.situation.x),
    InputQuantity("ego.y", "m", 0.0, lambda traffic: traffic.situation.y),
    InputQuantity("ego.heading", "rad", 0.0, lambda traffic: traffic.situation.heading),
    InputQuantity("ego.distance", "m", 0.0, lambda traffic: traffic.shared.own_pose_on_path[0]),
    InputQuantity("ego.offset", "m", 0.0, lambda traffic: traffic.shared.own_pose_on_path[1]),
    InputQuantity("ego.turn", "rad", 0.0, lambda traffic: traffic.shared.turn),
    InputQuantity("ego.length", "m", 0.0, _repeat_per_scenario(lambda traffic: traffic.body.length)),
    InputQuantity("ego.width", "m", 0.0, _repeat_per_scenario(lambda traffic: traffic.body.width)),
    InputQuantity("ego.wheelbase", "m", 0.0, _repeat_per_scenario(lambda traffic: traffic.body.wheelbase)),
    InputQuantity(
        "object.count", "1", 0.0, lambda traffic: (~np.isnan(traffic.situation.others_x)).sum(axis=1).astype(np.float64)
    ),
)
_LEADER: Final = tuple(
    InputQuantity(f"leader.{name}", unit, none, partial(_get_leader_field, name))
    for name, (unit, none) in _OTHER_UNITS.items()
)
_ROAD: Final = (
    InputQuantity("speed_limit", "m/s", _FAST, lambda traffic: traffic.speed_limit),
    *(
        InputQuantity(f"lane.{name}", unit, none, partial(_get_lane_field, name, 0))
        for name, (unit, none) in _LANE_UNITS.items()
    ),
    *(
        InputQuantity(f"signal.{name}", unit, none, partial(_get_signal_field, name))
        for name, (unit, none) in _SIGNAL_UNITS.items()
    ),
)
QUANTITIES: Final[Mapping[str, InputQuantity]] = {quantity.name: quantity for quantity in (*_EGO, *_LEADER, *_ROAD)}
"""Quantities by name, except names with a number in brackets, such as ``object[1].x``."""
_PATH_NAME: Final = re.compile(r"path\[(-?\d{1,4}(?:\.\d{1,6})?)\]\.(\w+)")
_LANE_NAME: Final = re.compile(r"lane\[(-?\d{1,2})\]\.(\w+)")
_OBJECT_NAME: Final = re.compile(r"object\[([1-9]\d{0,2})\]\.(\w+)")
_OBJECT_ARRAY: Final = re.compile(r"object\.(\w+)")


def find_quantity(name: str) -> InputQuantity | None:
    """Return the quantity with a name such as ``"ego.speed"`` or ``"object[1].x"``; None if there is none."""
    if (match := _OBJECT_NAME.fullmatch(name)) is not None and match[2] in _OTHER_UNITS:
        unit, none = _OTHER_UNITS[match[2]]
        return InputQuantity(name, unit, none, partial(_get_ranked_field, match[2], int(match[1]) - 1))
    if (match := _PATH_NAME.fullmatch(name)) is not None and match[2] in _PATH_UNITS:
        return InputQuantity(
            name, _PATH_UNITS[match[2]], 0.0, partial(_get_path_point_field, match[2], float(match[1]))
        )
    if (match := _LANE_NAME.fullmatch(name)) is not None and match[2] in _LANE_UNITS:
        unit, none = _LANE_UNITS[match[2]]
        return InputQuantity(name, unit, none, partial(_get_lane_field, match[2], int(match[1])))
    return QUANTITIES.get(name)


def find_object_quantities(name: str, count: int) -> list[InputQuantity] | None:
    """Return a quantity such as ``"object.x"`` of each of the `count` nearest objects; None if the name is unknown."""
    match = _OBJECT_ARRAY.fullmatch(name)
    if match is None or match[1] not in _OTHER_UNITS:
        return None
    named = (find_quantity(f"object[{k}].{match[1]}") for k in range(1, count + 1))
    return [quantity for quantity in named if quantity is not None]


def suggest_quantity(unknown: str) -> str:
    """Return a hint for an error message about an unknown quantity: the name that was meant, or all known names."""
    meant = recognize_input(unknown, is_array=False)
    if meant is not None and find_quantity(meant) is not None:
        return f"did you mean '{meant}'?"
    # Names with the number that was given, if the number is allowed.
    numbers = re.findall(r"\[\s*(-?[\d.]+)\s*\]", unknown)
    numbered = [
        next(name for index in (*numbers, example) if find_quantity(name := f"{what}[{index}].{field}") is not None)
        for what, example, names in (("object", 1, _OTHER_UNITS), ("path", 10, _PATH_UNITS), ("lane", 1, _LANE_UNITS))
        for field in names
    ]
    hint = suggest_name(unknown, [*QUANTITIES, *numbered])
    return hint if hint.startswith("did you mean") else f"known are: {', '.join(QUANTITIES)}, {', '.join(numbered)}."


# Further names by which a variable of an FMU is recognized.
_ALIASES: Final = {
    "ego.speed": ("v", "v_ego", "speed", "velocity", "ego_velocity"),
    "ego.acceleration": ("a_ego", "ego_accel"),
    "target_speed": ("set_speed", "desired_speed", "v_set", "v_target", "v_desired"),
    "ego.offset": ("ego.lateral",),
    "leader.gap": ("gap", "leader_distance"),
    "leader.closing": ("closing", "closing_speed", "leader_closing_speed"),
    "leader.speed": ("v_leader", "v_lead", "leader_velocity"),
    "leader.exists": ("has_leader", "leader_valid"),
}
OUTPUTS: Final[Mapping[str, str]] = {
    "acceleration": "m/s²", "steering": "rad", "throttle": "1", "brake": "1", "lane_change": "1",
}  # fmt: skip
"""Decisions that an FMU can make, by name, with their SI units."""
_OUTPUT_ALIASES: Final = {
    "acceleration": ("a", "a_cmd", "a_req", "acc_cmd", "acceleration_command", "acceleration_request",
                     "desired_acceleration"),
    "steering": ("steering_angle", "delta", "delta_cmd"),
    "throttle": ("throttle_pedal", "accelerator"),
    "brake": ("brake_pedal",),
    "lane_change": (),
}  # fmt: skip


def _normalize(name: str) -> str:
    return re.sub(r"[\s_.]", "", name).casefold()


_INPUT_BY_NAME: Final = {_normalize(name): name for name in QUANTITIES} | {
    _normalize(alias): name for name, aliases in _ALIASES.items() for alias in aliases
}
_OUTPUT_BY_NAME: Final = {
    _normalize(alias): name for name, aliases in _OUTPUT_ALIASES.items() for alias in (name, *aliases)
}
_LISTED_OBJECT: Final = re.compile(r"(?:objects?|targets?)\[(\d+)\](\w+)")
_LISTED_ARRAY: Final = re.compile(r"(?:objects?|targets?)([a-z]+)")
_FIELD_BY_NAME: Final = {_normalize(name): name for name in _OTHER_UNITS}
# The number of a point or lane may have a sign and a decimal point, which `_normalize` would remove.
_NUMBERED: Final = re.compile(r"(path|lane)\[(-?[\d.]+)\](.+)")


def recognize_input(variable: str, *, is_array: bool) -> str | None:
    """Return the name of the quantity that the name of an FMU's input suggests; None if the name is not recognized."""
    name = _normalize(variable)
    if not is_array and name in _INPUT_BY_NAME:
        return _INPUT_BY_NAME[name]
    if not is_array and (match := _NUMBERED.fullmatch(re.sub(r"\s", "", variable).casefold())) is not None:
        fields = {_normalize(field): field for field in (_PATH_UNITS if match[1] == "path" else _LANE_UNITS)}
        numbered = f"{match[1]}[{match[2]}].{fields.get(_normalize(match[3]), '')}"
        return numbered if find_quantity(numbered) is not None else None
    pattern = _LISTED_ARRAY if is_array else _LISTED_OBJECT
    if (match := pattern.fullmatch(name)) is None or match[match.lastindex or 0] not in _FIELD_BY_NAME:
        return None
    field = _FIELD_BY_NAME[match[match.lastindex or 0]]
    if is_array:
        return f"object.{field}"
    numbered = f"object[{match[1]}].{field}"
    return numbered if find_quantity(numbered) is not None else None


def recognize_output(variable: str) -> str | None:
    """Return the decision that the name of an FMU's output suggests; None if the name is not recognized."""
    return _OUTPUT_BY_NAME.get(_normalize(variable))
