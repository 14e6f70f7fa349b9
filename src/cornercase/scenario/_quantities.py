"""Kinds of numbers in OpenSCENARIO files that can be varied: names, units, bounds and proposed ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True)
class Quantity:
    """A physical quantity: its unit, its smallest allowed value, and the width of proposed ranges.

    A range is proposed around the value in the file: value ± `half_width`. If `half_width` is 0, the range is value ±
    `relative_width` times value. If the value is 0, too, the range is ± `half_width_at_zero`. `minimum` is the smallest
    value that the standard allows.
    """

    unit: str = ""
    relative_width: float = 0.0
    half_width: float = 0.0
    half_width_at_zero: float = 0.0
    minimum: float | None = None
    is_integer: bool = False

    def propose_range(self, value: float, minimum: float | None, maximum: float | None) -> tuple[float, float] | None:
        """Propose a range around a value that stays within `minimum` and `maximum`; None if there is no such range."""
        reach = self.half_width or abs(value) * self.relative_width or self.half_width_at_zero
        if self.is_integer:
            low, high = value - round(reach), value + round(reach)
        else:
            low, high = value - reach, value + reach
            # Do not let a standing car drive backwards.
            low = max(low, 0.0) if value == 0.0 and self.unit == "m/s" else low
            low, high = (_round_range_bound(bound, reach) for bound in (low, high))
        low = low if minimum is None else max(low, minimum)
        high = high if maximum is None else min(high, maximum)
        return (low, high) if low < high and low <= value <= high else None


def _round_range_bound(value: float, half_width: float) -> float:
    """Round a bound so that a range with this half width is easy to read.

    The bound is rounded to the decimal place of about the second digit of the half width, to 1 to 6 decimals.
    """
    digits = 1
    while digits < 6 and half_width * 10**digits < 50.0:
        digits += 1
    return round(value, digits)


_SPEED: Final = Quantity("m/s", relative_width=0.3, half_width_at_zero=5.0)
_SPEED_LIMIT: Final = replace(_SPEED, minimum=0.0)
_TIME: Final = Quantity("s", relative_width=0.5, half_width_at_zero=2.0, minimum=0.0)
_DISTANCE: Final = Quantity("m", relative_width=0.3, half_width_at_zero=10.0, minimum=0.0)
_RELATIVE_DISTANCE: Final = Quantity("m", relative_width=0.3, half_width_at_zero=5.0)
_ROAD_COORDINATE: Final = Quantity("m", half_width=20.0, minimum=0.0)
_LATERAL_OFFSET: Final = Quantity("m", half_width=0.5)
_WORLD_COORDINATE: Final = Quantity("m", half_width=5.0)
_HEADING: Final = Quantity("rad", half_width=0.1)
_ANGLE: Final = Quantity("rad", relative_width=0.3, half_width_at_zero=0.1)
_ACCELERATION: Final = Quantity("m/s²", relative_width=0.3, half_width_at_zero=1.0)
_ACCELERATION_LIMIT: Final = replace(_ACCELERATION, minimum=0.0)
_JERK: Final = Quantity("m/s³", relative_width=0.3, half_width_at_zero=1.0, minimum=0.0)
_FACTOR: Final = Quantity("", relative_width=0.3, half_width_at_zero=0.5)
LANE_NUMBER: Final = Quantity(is_integer=True)
"""Quantity of lane numbers; the road determines the possible numbers."""
_LANE_COUNT: Final = Quantity("lanes", is_integer=True)

QUANTITIES: Final[Mapping[str, Mapping[str, tuple[str, Quantity]]]] = {
    "LanePosition": {
        "s": ("s", _ROAD_COORDINATE),
        "offset": ("offset", _LATERAL_OFFSET),
        "laneId": ("lane", LANE_NUMBER),
    },
    "RoadPosition": {"s": ("s", _ROAD_COORDINATE), "t": ("t", _LATERAL_OFFSET)},
    "RelativeLanePosition": {
        "ds": ("ds", _RELATIVE_DISTANCE),
        "dsLane": ("ds", _RELATIVE_DISTANCE),
        "offset": ("offset", _LATERAL_OFFSET),
        "dLane": ("lanes", _LANE_COUNT),
    },
    "RelativeRoadPosition": {"ds": ("ds", _RELATIVE_DISTANCE), "dt": ("dt", _LATERAL_OFFSET)},
    "WorldPosition": {"x": ("x", _WORLD_COORDINATE), "y": ("y", _WORLD_COORDINATE), "h": ("h", _HEADING)},
    "RelativeWorldPosition": {"dx": ("dx", _RELATIVE_DISTANCE), "dy": ("dy", _RELATIVE_DISTANCE)},
    "RelativeObjectPosition": {"dx": ("dx", _RELATIVE_DISTANCE), "dy": ("dy", _RELATIVE_DISTANCE)},
    "FromLaneCoordinates": {
        "pathS": ("path_s", _ROAD_COORDINATE),
        "laneOffset": ("offset", _LATERAL_OFFSET),
        "laneId": ("lane", LANE_NUMBER),
    },
    "FromRoadCoordinates": {"pathS": ("path_s", _ROAD_COORDINATE), "t": ("t", _LATERAL_OFFSET)},
    "TrajectoryPosition": {"s": ("path_s", _ROAD_COORDINATE), "t": ("t", _LATERAL_OFFSET)},
    "Orientation": {"h": ("h", _HEADING)},
    "AbsoluteTargetSpeed": {"value": ("speed", _SPEED)},
    "RelativeTargetSpeed": {"value": ("speed_difference", _SPEED)},
    "AbsoluteSpeed": {"value": ("final_speed", _SPEED)},
    "RelativeSpeedToMaster": {"value": ("final_difference", _SPEED)},
    "DynamicConstraints": {
        "maxSpeed": ("max_speed", _SPEED_LIMIT),
        "maxAcceleration": ("max_acceleration", _ACCELERATION_LIMIT),
        "maxDeceleration": ("max_deceleration", _ACCELERATION_LIMIT),
        "maxAccelerationRate": ("max_jerk", _JERK),
        "maxDecelerationRate": ("max_braking_jerk", _JERK),
    },
    "SpeedProfileEntry": {"speed": ("speed", _SPEED), "time": ("time", _TIME)},
    "LongitudinalDistanceAction": {"distance": ("distance", _DISTANCE), "timeGap": ("time_gap", _TIME)},
    "LateralDistanceAction": {"distance": ("distance", _DISTANCE)},
    "LaneChangeAction": {"targetLaneOffset": ("target_offset", _LATERAL_OFFSET)},
    "AbsoluteTargetLane": {"value": ("lane", LANE_NUMBER)},
    "RelativeTargetLane": {"value": ("lanes", _LANE_COUNT)},
    "AbsoluteTargetLaneOffset": {"value": ("offset", _LATERAL_OFFSET)},
    "RelativeTargetLaneOffset": {"value": ("offset", _LATERAL_OFFSET)},
    "LaneOffsetActionDynamics": {"maxLateralAcc": ("lateral_limit", _ACCELERATION_LIMIT)},
    "SynchronizeAction": {
        "targetToleranceMaster": ("master_tolerance", _DISTANCE),
        "targetTolerance": ("target_tolerance", _DISTANCE),
    },
    "TargetDistanceSteadyState": {"distance": ("steady_distance", _DISTANCE)},
    "TargetTimeSteadyState": {"time": ("steady_time", _TIME)},
    "FollowTrajectoryAction": {"initialDistanceOffset": ("start", _DISTANCE)},
    "Timing": {
        "offset": ("time_offset", Quantity("s", relative_width=0.5, half_width_at_zero=2.0)),
        "scale": ("time_scale", _FACTOR),
    },
    "Condition": {"delay": ("delay", _TIME)},
    "SimulationTimeCondition": {"value": ("time", _TIME)},
    "TimeHeadwayCondition": {"value": ("headway", _TIME)},
    "TimeToCollisionCondition": {"value": ("ttc", _TIME)},
    "DistanceCondition": {"value": ("distance", _DISTANCE)},
    "RelativeDistanceCondition": {"value": ("distance", _DISTANCE)},
    "TraveledDistanceCondition": {"value": ("travelled", _DISTANCE)},
    "ReachPositionCondition": {"tolerance": ("tolerance", _DISTANCE)},
    "RelativeClearanceCondition": {"distanceForward": ("ahead", _DISTANCE), "distanceBackward": ("behind", _DISTANCE)},
    "SpeedCondition": {"value": ("speed", _SPEED)},
    "RelativeSpeedCondition": {"value": ("speed_difference", _SPEED)},
    "AccelerationCondition": {"value": ("acceleration", _ACCELERATION)},
    "StandStillCondition": {"duration": ("standstill", _TIME)},
    "EndOfRoadCondition": {"duration": ("end_of_road", _TIME)},
    "OffroadCondition": {"duration": ("offroad", _TIME)},
    "AngleCondition": {"angle": ("angle", _ANGLE), "angleTolerance": ("tolerance", replace(_ANGLE, minimum=0.0))},
    "RelativeAngleCondition": {
        "angle": ("angle", _ANGLE),
        "angleTolerance": ("tolerance", replace(_ANGLE, minimum=0.0)),
    },
}
"""Last part of a variable's name, and its quantity, by element and attribute."""

DYNAMICS_QUANTITIES: Final = {
    "time": ("duration", _TIME),
    "distance": ("length", _DISTANCE),
    "rate": ("rate", _ACCELERATION_LIMIT),
}
"""Name and quantity of a transition's value, by its dimension."""

LANE_CHANGE_RATE: Final = ("rate", _SPEED_LIMIT)
"""Name and quantity of the rate of a lane change."""

SPEED_FACTOR: Final = ("speed_factor", _FACTOR)
"""Name and quantity of a `RelativeTargetSpeed` that is a factor."""

SKIPPED_ELEMENTS: Final = frozenset({"Trajectory", "Route", "TrafficAction", "EnvironmentAction", "ControllerAction"})
"""Elements whose numbers are not listed."""
