"""What an FMU may be given about the traffic: quantities by name, for all scenarios of a batch at once."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.drivers._base import Situation
from cornercase.drivers._function import Body
from cornercase.drivers._view import SharedView

_FAR: Final = 1000.0


class Traffic:
    """The situation of N scenarios, with the A others sorted by their distance."""

    def __init__(self, situation: Situation, body: Body) -> None:
        self.situation, self.body, self.shared = situation, body, SharedView(situation)

    @cached_property
    def _order(self) -> IntArray:
        """Others from the nearest on, those that do not exist last, (N, A)."""
        x, y, _ = self.shared.relative
        return np.argsort(np.hypot(x, y), axis=1, kind="stable")

    @cached_property
    def _leader(self) -> IntArray:
        """Rank of the leader among the sorted ones, (N,); A if there is none."""
        x, gap, in_path = self.field("x"), self.field("gap"), self.field("in_path")
        if not x.shape[1]:
            return np.zeros(len(x), dtype=np.int64)
        is_ahead = (in_path > 0.0) & (gap >= 0.0) & (x > 0.0)
        nearest = np.argmin(np.where(is_ahead, gap, np.inf), axis=1)
        return np.where(is_ahead.any(axis=1), nearest, x.shape[1])

    def field(self, name: str) -> FloatArray:
        """Return what is known about the others, sorted, (N, A); NaN for those that do not exist."""
        if name not in self._fields:
            values: FloatArray = np.take_along_axis(_OTHER_FIELDS[name](self), self._order, axis=1)
            self._fields[name] = values
        return self._fields[name]

    @cached_property
    def _fields(self) -> dict[str, FloatArray]:
        return {}

    def of_rank(self, name: str, rank: int) -> FloatArray:
        """Return what is known about the other with a rank, the nearest having 0, (N,); NaN where there is none."""
        values = self.field(name)
        return values[:, rank] if rank < values.shape[1] else np.full(len(values), np.nan)

    def of_leader(self, name: str) -> FloatArray:
        """Return what is known about the leader, (N,); NaN where there is none."""
        values = self.field(name)
        padded: FloatArray = np.column_stack((values, np.full(len(values), np.nan)))
        of_leader: FloatArray = padded[np.arange(len(values)), self._leader]
        return of_leader

    @property
    def exists(self) -> FloatArray:
        """1 for the others that exist, NaN for all others, (N, A)."""
        return np.where(np.isnan(self.situation.others_x), np.nan, 1.0)


@dataclass(frozen=True)
class InputQuantity:
    """Something that an FMU may be given.

    `unit` is that of SI. `none` is what stands for it where it does not exist, as the speed of a leader without one.
    `compute` returns it, (N,), with NaN or infinity where it does not exist.
    """

    name: str
    unit: str
    none: float
    compute: Callable[[Traffic], FloatArray]

    def __reduce__(self) -> tuple[Callable[[str], InputQuantity | None], tuple[str]]:
        return find_quantity, (self.name,)


def _time_to_collision(traffic: Traffic) -> FloatArray:
    gap, closing, _, _ = traffic.shared.along_path
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((gap >= 0.0) & (closing > 0.0), gap / closing, np.nan)


def _in_path(traffic: Traffic) -> FloatArray:
    return np.where(traffic.shared.along_path[3], 1.0, 0.0) * traffic.exists


def _type_codes(traffic: Traffic) -> FloatArray:
    types = traffic.situation.others_object_type
    return np.array([_TYPE_CODES.get(name, 1.0) for name in types]) * traffic.exists


_TYPE_CODES: Final = {"pedestrian": 2.0, "misc": 3.0}
_OTHER_FIELDS: Final[Mapping[str, Callable[[Traffic], FloatArray]]] = {
    "exists": lambda traffic: traffic.exists,
    "x": lambda traffic: traffic.shared.relative[0],
    "y": lambda traffic: traffic.shared.relative[1],
    "heading": lambda traffic: traffic.shared.relative[2],
    "speed": lambda traffic: traffic.situation.others_speed,
    "length": lambda traffic: traffic.situation.others_length * traffic.exists,
    "width": lambda traffic: traffic.situation.others_width * traffic.exists,
    "gap": lambda traffic: traffic.shared.along_path[0],
    "closing": lambda traffic: traffic.shared.along_path[1],
    "lateral": lambda traffic: traffic.shared.along_path[2],
    "ttc": _time_to_collision,
    "in_path": _in_path,
    "type": _type_codes,
}
# Unit, and what stands for it without such an object.
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


def _fill(value: Callable[[Traffic], float]) -> Callable[[Traffic], FloatArray]:
    return lambda traffic: np.full(len(traffic.situation.speed), value(traffic))


_EGO: Final = (
    InputQuantity("time", "s", 0.0, _fill(lambda traffic: traffic.situation.time)),
    InputQuantity("target_speed", "m/s", 100.0, lambda traffic: traffic.situation.target_speed),
    InputQuantity("ego.speed", "m/s", 0.0, lambda traffic: traffic.situation.speed),
    InputQuantity("ego.acceleration", "m/s²", 0.0, lambda traffic: traffic.situation.acceleration),
    InputQuantity("ego.x", "m", 0.0, lambda traffic: traffic.situation.x),
    InputQuantity("ego.y", "m", 0.0, lambda traffic: traffic.situation.y),
    InputQuantity("ego.heading", "rad", 0.0, lambda traffic: traffic.situation.heading),
    InputQuantity("ego.distance", "m", 0.0, lambda traffic: traffic.shared.own_pose_on_path[0]),
    InputQuantity("ego.offset", "m", 0.0, lambda traffic: traffic.shared.own_pose_on_path[1]),
    InputQuantity("ego.length", "m", 0.0, _fill(lambda traffic: traffic.body.length)),
    InputQuantity("ego.width", "m", 0.0, _fill(lambda traffic: traffic.body.width)),
    InputQuantity("ego.wheelbase", "m", 0.0, _fill(lambda traffic: traffic.body.wheelbase)),
    InputQuantity(
        "object.count", "1", 0.0, lambda traffic: (~np.isnan(traffic.situation.others_x)).sum(axis=1).astype(np.float64)
    ),
)
_LEADER: Final = tuple(
    InputQuantity(f"leader.{name}", unit, none, lambda traffic, name=name: traffic.of_leader(name))  # type: ignore[misc]
    for name, (unit, none) in _OTHER_UNITS.items()
)
QUANTITIES: Final[Mapping[str, InputQuantity]] = {quantity.name: quantity for quantity in (*_EGO, *_LEADER)}
"""Quantities by name, without those of the list of objects."""
_OBJECT_NAME: Final = re.compile(r"object\[([1-9]\d{0,2})\]\.(\w+)")
_OBJECT_ARRAY: Final = re.compile(r"object\.(\w+)")


def find_quantity(name: str) -> InputQuantity | None:
    """Return a quantity by its name, such as ``"ego.speed"`` or ``"object[1].x"``."""
    if (match := _OBJECT_NAME.fullmatch(name)) is not None and match[2] in _OTHER_UNITS:
        unit, none = _OTHER_UNITS[match[2]]
        return InputQuantity(name, unit, none, partial(_of_rank, match[2], int(match[1]) - 1))
    return QUANTITIES.get(name)


def find_quantities(name: str, count: int) -> list[InputQuantity] | None:
    """Return the quantities of an array by its name, such as ``"object.x"``, from the nearest object on."""
    match = _OBJECT_ARRAY.fullmatch(name)
    if match is None or match[1] not in _OTHER_UNITS:
        return None
    named = (find_quantity(f"object[{k}].{match[1]}") for k in range(1, count + 1))
    return [quantity for quantity in named if quantity is not None]


def _of_rank(field: str, rank: int, traffic: Traffic) -> FloatArray:
    return traffic.of_rank(field, rank)


# Further names by which a variable of an FMU is recognized.
_ALIASES: Final = {
    "ego.speed": ("v", "v_ego", "speed", "velocity", "ego_velocity"),
    "ego.acceleration": ("a_ego", "ego_accel"),
    "target_speed": ("set_speed", "desired_speed", "v_set", "v_target", "v_desired"),
    "leader.gap": ("gap", "leader_distance"),
    "leader.closing": ("closing", "closing_speed", "leader_closing_speed"),
    "leader.speed": ("v_leader", "v_lead", "leader_velocity"),
    "leader.exists": ("has_leader", "leader_valid"),
}
OUTPUTS: Final[Mapping[str, str]] = {
    "acceleration": "m/s²", "steering": "rad", "throttle": "1", "brake": "1", "lane_change": "1",
}  # fmt: skip
"""Units of what an FMU may decide, by name."""
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


def recognize_input(variable: str, *, is_array: bool) -> str | None:
    """Return the name of the quantity that a variable of an FMU seems to mean; None if its name says nothing."""
    name = _normalize(variable)
    if not is_array and name in _INPUT_BY_NAME:
        return _INPUT_BY_NAME[name]
    pattern = _LISTED_ARRAY if is_array else _LISTED_OBJECT
    if (match := pattern.fullmatch(name)) is None or match[match.lastindex or 0] not in _FIELD_BY_NAME:
        return None
    field = _FIELD_BY_NAME[match[match.lastindex or 0]]
    return f"object.{field}" if is_array else f"object[{match[1]}].{field}"


def recognize_output(variable: str) -> str | None:
    """Return the decision that a variable of an FMU seems to mean; None if its name says nothing."""
    return _OUTPUT_BY_NAME.get(_normalize(variable))
