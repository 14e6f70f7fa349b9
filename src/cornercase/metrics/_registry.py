"""Metrics by name."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry
from cornercase.metrics._base import Metric

METRICS: Final[Registry[Metric]] = Registry("metric", "cornercase.metrics", Metric)
"""Criticality metrics by name."""

for _name, _target in (
    ("a-lat-req", "lateral:LateralAcceleration"),
    ("a-long-req", "deceleration:LongitudinalAcceleration"),
    ("btn", "deceleration:Btn"),
    ("clearance", "distance:Clearance"),
    ("critical-if", "conditions.critical_if:CriticalIf"),
    ("conflict-severity", "severity:ConflictSeverity"),
    ("dce", "encounter:Dce"),
    ("delta-v", "severity:DeltaV"),
    ("distance", "distance:Distance"),
    ("drac", "deceleration:Drac"),
    ("dst", "deceleration:Dst"),
    ("encroachment-time", "pet:EncroachmentTime"),
    ("gap-time", "gap_time:GapTime"),
    ("hw", "following:Headway"),
    ("mdrac", "deceleration:Mdrac"),
    ("msd", "deceleration:StoppingDistance"),
    ("pet", "pet:Pet"),
    ("pttc", "following:Pttc"),
    ("rss", "rss:Rss"),
    ("spret", "gap_time:SquaredGapTime"),
    ("stl", "stl:Stl"),
    ("stn", "lateral:Stn"),
    ("tet", "exposure:Tet"),
    ("thw", "following:Thw"),
    ("tit", "exposure:Tit"),
    ("traffic-quality", "traffic_quality:TrafficQuality"),
    ("trajectory-distance", "trajectory_distance:TrajectoryDistance"),
    ("ttc", "ttc:Ttc"),
    ("ttce", "encounter:Ttce"),
    ("wttc", "wttc:Wttc"),
):
    METRICS.register(_name, f"cornercase.metrics.{_target}")
for _term in ("macro", "micro", "nano", "individual", "penalty"):
    METRICS.register(f"traffic-quality-{_term}", "cornercase.metrics._traffic_quality:TrafficQuality", term=_term)
