"""Criticality metrics by name."""

from functools import partial
from typing import get_args

from cornercase.metrics.base import METRICS, Metric, capped
from cornercase.metrics.deceleration import Btn, Drac, Dst, LongitudinalAcceleration, Mdrac, StoppingDistance
from cornercase.metrics.distance import Clearance, Distance
from cornercase.metrics.encounter import Dce, Ttce
from cornercase.metrics.exposure import Tet, Tit
from cornercase.metrics.following import Headway, Pttc, Thw
from cornercase.metrics.gap_time import GapTime, SquaredGapTime
from cornercase.metrics.lateral import LateralAcceleration, Stn
from cornercase.metrics.pet import EncroachmentTime, Pet
from cornercase.metrics.rss import Rss
from cornercase.metrics.severity import ConflictSeverity, DeltaV
from cornercase.metrics.traffic_quality import Term, TrafficQuality
from cornercase.metrics.trajectory_distance import TrajectoryDistance
from cornercase.metrics.ttc import Ttc
from cornercase.metrics.wttc import Wttc

for _metric in (
    Btn,
    Clearance,
    ConflictSeverity,
    Dce,
    DeltaV,
    Distance,
    Drac,
    Dst,
    EncroachmentTime,
    GapTime,
    Headway,
    LateralAcceleration,
    LongitudinalAcceleration,
    Mdrac,
    Pet,
    Pttc,
    Rss,
    SquaredGapTime,
    Stn,
    StoppingDistance,
    Tet,
    Thw,
    Tit,
    TrafficQuality,
    TrajectoryDistance,
    Ttc,
    Ttce,
    Wttc,
):
    METRICS.register(_metric.name, _metric)
for _term in get_args(Term)[1:]:
    METRICS.register(f"traffic-quality-{_term}", partial(TrafficQuality, _term))

__all__ = [
    "METRICS",
    "Btn",
    "Clearance",
    "ConflictSeverity",
    "Dce",
    "DeltaV",
    "Distance",
    "Drac",
    "Dst",
    "EncroachmentTime",
    "GapTime",
    "Headway",
    "LateralAcceleration",
    "LongitudinalAcceleration",
    "Mdrac",
    "Metric",
    "Pet",
    "Pttc",
    "Rss",
    "SquaredGapTime",
    "Stn",
    "StoppingDistance",
    "Tet",
    "Thw",
    "Tit",
    "TrafficQuality",
    "TrajectoryDistance",
    "Ttc",
    "Ttce",
    "Wttc",
    "capped",
]
