"""Registry of criticality metrics by name."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry
from cornercase.metrics._base import Metric

METRICS: Final[Registry[Metric]] = Registry("metric", "cornercase.metrics", Metric)
"""Criticality metrics by name.

A registry: ``METRICS.names()`` are the names, ``METRICS.create("ttc:accelerating=true")`` makes a metric, and
``METRICS.get_class("ttc")`` is its class. A metric has the attributes ``unit``, ``lower_is_critical``,
``default_threshold`` and ``cap``: ``METRICS.create("wttc").unit`` is ``"s"``. ``METRICS.register`` adds a class of your
own, so that texts can name it.
"""

for _name, _target in (
    ("a-lat-req", "_steering:LateralAcceleration"),
    ("a-long-req", "_braking:LongitudinalAcceleration"),
    ("btn", "_braking:Btn"),
    ("clearance", "_distance:Clearance"),
    ("critical-if", "_critical_if:CriticalIf"),
    ("conflict-severity", "_severity:ConflictSeverity"),
    ("dce", "_closest_encounter:Dce"),
    ("delta-v", "_severity:DeltaV"),
    ("distance", "_distance:Distance"),
    ("drac", "_braking:Drac"),
    ("dst", "_braking:Dst"),
    ("encroachment-time", "_pet:EncroachmentTime"),
    ("gap-time", "_gap_time:GapTime"),
    ("hw", "_headway:Headway"),
    ("lane-margin", "_lane_margin:LaneMargin"),
    ("mdrac", "_braking:Mdrac"),
    ("msd", "_braking:StoppingDistance"),
    ("pet", "_pet:Pet"),
    ("pttc", "_headway:Pttc"),
    ("rss", "_rss:Rss"),
    ("spret", "_gap_time:Spret"),
    ("stl", "_stl:Stl"),
    ("stn", "_steering:Stn"),
    ("tet", "_tet_tit:Tet"),
    ("thw", "_headway:Thw"),
    ("tit", "_tet_tit:Tit"),
    ("traffic-quality", "_traffic_quality:TrafficQuality"),
    ("trajectory-distance", "_trajectory_distance:TrajectoryDistance"),
    ("ttc", "_ttc:Ttc"),
    ("ttce", "_closest_encounter:Ttce"),
    ("wttc", "_wttc:Wttc"),
):
    METRICS.register(_name, f"cornercase.metrics.{_target}")
for _term in ("macro", "micro", "nano", "individual", "penalty"):
    METRICS.register(f"traffic-quality-{_term}", "cornercase.metrics._traffic_quality:TrafficQuality", term=_term)
