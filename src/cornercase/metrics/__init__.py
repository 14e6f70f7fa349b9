"""Criticality metrics by name."""

from cornercase.metrics.base import METRICS, Metric, capped
from cornercase.metrics.distance import Distance
from cornercase.metrics.pet import Pet
from cornercase.metrics.traffic_quality import TrafficQuality
from cornercase.metrics.trajectory_distance import TrajectoryDistance
from cornercase.metrics.ttc import Ttc
from cornercase.metrics.wttc import Wttc

for _metric in (Distance, Pet, TrafficQuality, TrajectoryDistance, Ttc, Wttc):
    METRICS.register(_metric.name, _metric)

__all__ = [
    "METRICS",
    "Distance",
    "Metric",
    "Pet",
    "TrafficQuality",
    "TrajectoryDistance",
    "Ttc",
    "Wttc",
    "capped",
]
