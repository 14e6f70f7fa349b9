"""Tolerances from a published test protocol, for the entities on a test card.

The numbers were read from an unofficial copy of the protocol. Testers have to compare the numbers with the protocol of
the actual test. The tolerances apply from the start of the test to the first intervention of the tested system. They
depend on the kind of target: ``VUT`` (vehicle under test), ``GVT`` (global vehicle target), ``EPT`` (pedestrian),
``EBT`` (bicyclist), ``EMT`` (motorcyclist).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

SOURCE: Final = (
    "Tolerances after Euro NCAP, Crash Avoidance – Frontal Collisions, protocol version 1.1 (October 2025), section"
    " 4.3.2, from the start of the test to the first intervention of the system; read from a third party’s copy, not"
    " official: compare them with the protocol of the actual test."
)
NO_TOLERANCE: Final = "tolerance to be agreed"

_CROSSING: Final = "0 ± 0.05 m"
_LONGITUDINAL: Final = "0 ± 0.15 m"


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of an entity in a test, as texts; a text is empty if the protocol has no tolerance."""

    target: str
    speed: str
    lateral: str
    others: tuple[str, ...] = ()


_VUT: Final = Tolerances(
    "VUT",
    "+1.0 / −0 km/h",
    "0 ± 0.05 m; 0 ± 0.10 m while turning",
    ("yaw velocity 0 ± 1.0 °/s, steering wheel velocity 0 ± 15.0 °/s, until it turns",),
)
_TARGETS: Final = {
    **dict.fromkeys(("car", "van", "truck", "semitrailer", "trailer", "bus"), ("GVT", "± 1.0 km/h", "0 ± 0.10 m", ())),
    "motorbike": ("EMT", "± 1.0 km/h", "0 ± [0.15] m, in brackets in the protocol", ()),
    "pedestrian": ("EPT", "± 0.2 km/h", None, ("lateral velocity 0 ± 0.15 m/s",)),
    "bicycle": ("EBT", "± 0.5 km/h", None, ("lateral velocity 0 ± 0.15 m/s",)),
}


def find_tolerances(object_type: str, *, is_ego: bool, crosses: bool | None) -> Tolerances | None:
    """Return the tolerances of an entity in a test; None if the protocol has no target for this type of entity.

    `crosses` says whether the paths of the entity and the ego cross; None if that is unknown.
    """
    if is_ego:
        return _VUT if object_type in ("car", "van") else None
    if object_type not in _TARGETS:
        return None
    target, speed, lateral, others = _TARGETS[object_type]
    if lateral is None:
        both = f"{_CROSSING} crossing, {_LONGITUDINAL} along the road"
        lateral = both if crosses is None else _CROSSING if crosses else _LONGITUDINAL
    return Tolerances(target, speed, lateral, others)
