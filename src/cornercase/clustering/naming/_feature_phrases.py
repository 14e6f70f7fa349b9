"""Phrases in the names of clusters that say whether a feature is larger or smaller than in other clusters."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

FEATURE_PHRASES: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "impact speed": ("hits slower than {} m/s", "hits faster than {} m/s"),
        "impact time": ("hits before {} s", "hits after {} s"),
        "entry": ("enters before {} s", "enters after {} s"),
        "gap": ("gap below {} s", "gap above {} s"),
        "nearest": ("comes within {} m of {other}", "stays more than {} m from {other}"),
        "nearest time": ("nearest before {} s", "nearest after {} s"),
        "lowest speed": ("slows below {} m/s", "stays above {} m/s"),
        "highest speed": ("never above {} m/s", "reaches more than {} m/s"),
        "mean speed": ("slower than {} m/s on average", "faster than {} m/s on average"),
        "first speed": ("begins slower than {} m/s", "begins faster than {} m/s"),
        "last speed": ("ends slower than {} m/s", "ends faster than {} m/s"),
        "standing": ("stands less than {} s", "stands more than {} s"),
        "braking": ("brakes less than {} m/s²", "brakes more than {} m/s²"),
        "way": ("goes less than {} m", "goes more than {} m"),
        "duration": ("over before {} s", "over after {} s"),
        "first distance": ("begins within {} m of {other}", "begins more than {} m from {other}"),
        "mean speed of the other": ("{other} slower than {} m/s on average", "{other} faster than {} m/s on average"),
    }
)
"""Phrases for a value below and above a bound, by feature; `cornercase.metrics.ending` defines the features."""
