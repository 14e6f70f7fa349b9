"""Who causes an accident, by several rules: judged anew, since a study keeps the judgement of when it was explored."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import cornercase.metrics.fault
from cornercase.metrics._outcome import Fault
from cornercase.metrics.fault._find_fault import find_fault
from cornercase.recordings import Collision, Recording

PRIORITY: Final = '    <priority high="1" low="3"/>\n    <priority high="2" low="3"/>\n'
"""Of the example: the side road, from which the ego comes, yields."""
ROADS: Final[Mapping[str, str]] = {
    "fault": PRIORITY,
    "nobody has priority": "",
    "the side road has priority": '    <priority high="3" low="1"/>\n    <priority high="3" low="2"/>\n',
}
"""Priority in the road file, by rule. The rules *contact* and *motion* take no roads."""


def find_causes(
    recordings: Sequence[Recording], collisions: Sequence[Collision | None], ego: str, rule: str, road_file: Path
) -> list[str]:
    """Return who causes the accident of each recording: ``ego``, ``other``, ``both``, ``undecided``; empty if none."""
    roads = road_file if rule in ROADS else None
    faults = [
        None if hit is None else find_fault(replace(one, road_file=roads), ego, hit)
        for one, hit in zip(recordings, collisions, strict=True)
    ]
    if rule == "contact":
        return [_who_ran_into(one) for one in faults]
    return [one.who if one else "" for one in faults]


def write_roads(road_file: Path, folder: Path, rule: str) -> Path:
    """Write a copy of the example's road file with the priority of a rule."""
    text = road_file.read_text("utf-8")
    if PRIORITY not in text:
        raise ValueError(f"{road_file}: has no {PRIORITY.strip()}")
    path = folder / f"{rule.replace(' ', '_')}.xodr"
    path.write_text(text.replace(PRIORITY, ROADS[rule]), "utf-8")
    return path.resolve()


def rules_state(road_file: Path) -> str:
    """Checksum of what a judgement depends on beside the recording: the fault rules, and the road file."""
    rules = sorted(Path(cornercase.metrics.fault.__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(one.read_bytes() for one in (*rules, Path(__file__), road_file))).hexdigest()


def _who_ran_into(fault: Fault | None) -> str:
    """Whoever is hit elsewhere than at its front was there already."""
    return "" if fault is None else "other" if fault.sides[1] == "front" else "ego"
