"""Scenes written as the oracle of metrics has them, and what it expects of them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cornercase.recordings import Recording

ORACLE = Path(__file__).parents[1] / "data" / "metrics.json"
CASES = {case["id"]: case for case in json.loads(ORACLE.read_text(encoding="utf-8"))["cases"]}

# The tracks that these regression values belong to are files of another project that are not at hand.
WITHOUT_TRACKS = {name for name in CASES if name.startswith("FX-")}


def cases(metric: str) -> list[Any]:
    chosen = [c for c in CASES.values() if c["metric"] == metric]
    return [pytest.param(c, id=c["id"]) for c in chosen if c["id"] not in WITHOUT_TRACKS]


def actor(x=0.0, y=0.0, yaw=0.0, v=0.0, a=0.0, length=4.0, width=2.0, cls="car", **_):
    return {"x": x, "y": y, "yaw": yaw, "v": v, "a": a, "length": length, "width": width, "cls": cls}


def recorded(actors, time) -> Recording:
    """Actors that go straight with constant acceleration until they stand; names are "0", "1", …."""
    time = np.asarray(time, dtype=float)
    columns = {k: np.array([[float(actor(**a)[k])] for a in actors]) for k in ("x", "y", "yaw", "v", "a")}
    v, a, yaw = columns["v"], columns["a"], columns["yaw"]
    stop = np.where(a * v < 0, -v / np.where(a == 0, 1, a), np.inf)
    driven = np.minimum(time, stop)
    way = v * driven + 0.5 * a * driven**2
    return Recording(
        time=time,
        names=tuple(str(i) for i in range(len(actors))),
        object_types=tuple(actor(**a)["cls"] for a in actors),
        x=columns["x"] + way * np.cos(yaw),
        y=columns["y"] + way * np.sin(yaw),
        heading=yaw + 0 * time,
        speed=np.where(time < stop, v + a * time, 0.0),
        acceleration=np.where(time < stop, a, 0.0) + 0 * time,
        length=np.array([actor(**a)["length"] for a in actors]),
        width=np.array([actor(**a)["width"] for a in actors]),
        center_x=np.zeros(len(actors)),
    )


def agrees(found, expected, tolerance) -> None:
    if expected is None:
        assert math.isnan(found)
    elif expected == "inf":
        assert found == math.inf
    else:
        assert found == pytest.approx(expected, abs=tolerance)


def follows(course_at, case) -> None:
    """The expected value now, and the time course where the case has one."""
    agrees(course_at([case["t"]])[0], case["expected"], case["tol"])
    instants = [t for t, _ in case.get("series", [])]
    for found, (_, expected) in zip(course_at(instants) if instants else [], case.get("series", []), strict=True):
        agrees(found, expected, case["tol"])


# --- oracle -------------------------------------------------------------------------------------------------
