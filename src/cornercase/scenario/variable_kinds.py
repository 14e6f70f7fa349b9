"""Numbers of OpenSCENARIO files that can be varied: names, units, bounds, proposed ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True)
class Kind:
    """What numbers of one physical quantity have in common.

    The proposed range is the value ± `half_width` if that is not 0, else ± `relative_width` times the value; for a
    value of 0 it is ± `half_width_at_zero`. `minimum` is what the standard allows.
    """

    unit: str = ""
    share: float = 0.0
    half: float = 0.0
    zero: float = 0.0
    least: float | None = None
    whole: bool = False

    def proposed(self, value: float, least: float | None, most: float | None) -> tuple[float, float] | None:
        """Propose a range around a value, within bounds; None if hardly anything would be left."""
        reach = self.half or abs(value) * self.share or self.zero
        if self.whole:
            low, high = value - round(reach), value + round(reach)
        else:
            low, high = value - reach, value + reach
            # Do not let a standing car drive backwards.
            low = max(low, 0.0) if value == 0.0 and self.unit == "m/s" else low
            low, high = (_readable(bound, reach) for bound in (low, high))
        low = low if least is None else max(low, least)
        high = high if most is None else min(high, most)
        return (low, high) if low < high and low <= value <= high else None


def _readable(value: float, reach: float) -> float:
    """Round to about two digits of the width, so that the range is easy to read."""
    digits = 1
    while digits < 6 and reach * 10**digits < 50.0:
        digits += 1
    return round(value, digits)


_SPEED: Final = Kind("m/s", share=0.3, zero=5.0)
_SPEED_LIMIT: Final = replace(_SPEED, least=0.0)
_TIME: Final = Kind("s", share=0.5, zero=2.0, least=0.0)
_DISTANCE: Final = Kind("m", share=0.3, zero=10.0, least=0.0)
_BETWEEN: Final = Kind("m", share=0.3, zero=5.0)
_ALONG: Final = Kind("m", half=20.0, least=0.0)
_ASIDE: Final = Kind("m", half=0.5)
_PLACE: Final = Kind("m", half=5.0)
_HEADING: Final = Kind("rad", half=0.1)
_ANGLE: Final = Kind("rad", share=0.3, zero=0.1)
_ACCELERATION: Final = Kind("m/s²", share=0.3, zero=1.0)
_LIMIT: Final = replace(_ACCELERATION, least=0.0)
_JERK: Final = Kind("m/s³", share=0.3, zero=1.0, least=0.0)
_FACTOR: Final = Kind("", share=0.3, zero=0.5)
LANE: Final = Kind(whole=True)
"""Lane number; the possible ones depend on the road."""
_LANES: Final = Kind("lanes", whole=True)

NUMBERS: Final[Mapping[str, Mapping[str, tuple[str, Kind]]]] = {
    "LanePosition": {"s": ("s", _ALONG), "offset": ("offset", _ASIDE), "laneId": ("lane", LANE)},
    "RoadPosition": {"s": ("s", _ALONG), "t": ("t", _ASIDE)},
    "RelativeLanePosition": {
        "ds": ("ds", _BETWEEN), "dsLane": ("ds", _BETWEEN), "offset": ("offset", _ASIDE), "dLane": ("lanes", _LANES),
    },
    "RelativeRoadPosition": {"ds": ("ds", _BETWEEN), "dt": ("dt", _ASIDE)},
    "WorldPosition": {"x": ("x", _PLACE), "y": ("y", _PLACE), "h": ("h", _HEADING)},
    "RelativeWorldPosition": {"dx": ("dx", _BETWEEN), "dy": ("dy", _BETWEEN)},
    "RelativeObjectPosition": {"dx": ("dx", _BETWEEN), "dy": ("dy", _BETWEEN)},
    "FromLaneCoordinates": {
        "pathS": ("path_s", _ALONG), "laneOffset": ("offset", _ASIDE), "laneId": ("lane", LANE),
    },
    "FromRoadCoordinates": {"pathS": ("path_s", _ALONG), "t": ("t", _ASIDE)},
    "TrajectoryPosition": {"s": ("path_s", _ALONG), "t": ("t", _ASIDE)},
    "Orientation": {"h": ("h", _HEADING)},
    "AbsoluteTargetSpeed": {"value": ("speed", _SPEED)},
    "RelativeTargetSpeed": {"value": ("speed_difference", _SPEED)},
    "AbsoluteSpeed": {"value": ("final_speed", _SPEED)},
    "RelativeSpeedToMaster": {"value": ("final_difference", _SPEED)},
    "DynamicConstraints": {
        "maxSpeed": ("max_speed", _SPEED_LIMIT), "maxAcceleration": ("max_acceleration", _LIMIT),
        "maxDeceleration": ("max_deceleration", _LIMIT), "maxAccelerationRate": ("max_jerk", _JERK),
        "maxDecelerationRate": ("max_braking_jerk", _JERK),
    },
    "SpeedProfileEntry": {"speed": ("speed", _SPEED), "time": ("time", _TIME)},
    "LongitudinalDistanceAction": {"distance": ("distance", _DISTANCE), "timeGap": ("time_gap", _TIME)},
    "LateralDistanceAction": {"distance": ("distance", _DISTANCE)},
    "LaneChangeAction": {"targetLaneOffset": ("target_offset", _ASIDE)},
    "AbsoluteTargetLane": {"value": ("lane", LANE)},
    "RelativeTargetLane": {"value": ("lanes", _LANES)},
    "AbsoluteTargetLaneOffset": {"value": ("offset", _ASIDE)},
    "RelativeTargetLaneOffset": {"value": ("offset", _ASIDE)},
    "LaneOffsetActionDynamics": {"maxLateralAcc": ("lateral_limit", _LIMIT)},
    "SynchronizeAction": {
        "targetToleranceMaster": ("master_tolerance", _DISTANCE), "targetTolerance": ("target_tolerance", _DISTANCE),
    },
    "TargetDistanceSteadyState": {"distance": ("steady_distance", _DISTANCE)},
    "TargetTimeSteadyState": {"time": ("steady_time", _TIME)},
    "FollowTrajectoryAction": {"initialDistanceOffset": ("start", _DISTANCE)},
    "Timing": {"offset": ("time_offset", Kind("s", share=0.5, zero=2.0)), "scale": ("time_scale", _FACTOR)},
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
    "AngleCondition": {"angle": ("angle", _ANGLE), "angleTolerance": ("tolerance", replace(_ANGLE, least=0.0))},
    "RelativeAngleCondition": {
        "angle": ("angle", _ANGLE), "angleTolerance": ("tolerance", replace(_ANGLE, least=0.0)),
    },
}  # fmt: skip
"""Last part of the name, and quantity, by element and attribute."""

DYNAMICS: Final = {"time": ("duration", _TIME), "distance": ("length", _DISTANCE), "rate": ("rate", _LIMIT)}
"""Name and quantity of a transition's value, by its dimension."""

RATE_OF_LANES: Final = ("rate", _SPEED_LIMIT)
"""The same for the rate of a lane change."""

SPEED_FACTOR: Final = ("speed_factor", _FACTOR)
"""The same for a `RelativeTargetSpeed` that is a factor."""

ELSEWHERE: Final = frozenset({"Trajectory", "Route", "TrafficAction", "EnvironmentAction", "ControllerAction"})
"""Elements whose numbers are not listed."""
