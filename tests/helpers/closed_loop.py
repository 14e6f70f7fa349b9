"""A driver in a closed loop with road users whose motion is given."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase._common.geometry.boxes import box_corners, boxes_overlap
from cornercase.drivers import AGGRESSIVE, CAUTIOUS, NORMAL, DrivenPath, Situation
from cornercase.drivers._kernels.visibility import find_visible_others

DT = 0.05
PRESETS = {"cautious": CAUTIOUS, "normal": NORMAL, "aggressive": AGGRESSIVE}
EGO: dict[str, Any] = {"length": 4.6, "width": 1.8, "center_x": 1.4}
FRONT = EGO["center_x"] + EGO["length"] / 2

BOXES = {
    "car": (4.5, 1.8, 1.4),
    "truck": (9.0, 2.5, 3.5),
    "pedestrian": (0.5, 0.5, 0.0),
    "misc": (1.0, 1.0, 0.0),
}


def straight(length=200.0, step=0.25) -> DrivenPath:
    s = np.arange(0.0, length + step / 2, step)
    return DrivenPath(s, s.copy(), np.zeros_like(s), np.zeros_like(s), np.zeros_like(s))


def right_turn(before=60.0, radius=7.5, after=60.0, step=0.1) -> DrivenPath:
    """North along x = 0, then right, ending eastwards along y = before + radius."""
    arc = radius * math.pi / 2
    s = np.linspace(0.0, before + arc + after, int((before + arc + after) / step) + 1)
    turned = np.clip((s - before) / radius, 0.0, math.pi / 2)
    beyond = np.maximum(s - before - arc, 0.0)
    x = radius * (1 - np.cos(turned)) + beyond
    y = np.minimum(s, before) + radius * np.sin(turned)
    curvature = np.where((s >= before) & (s <= before + arc), -1.0 / radius, 0.0)
    return DrivenPath(s, x, y, math.pi / 2 - turned, curvature)


@dataclass
class Other:
    """Goes straight at constant speed from `start` on; everything is a number or an array over scenarios."""

    kind: str
    x: npt.ArrayLike
    y: npt.ArrayLike
    heading: float = 0.0
    speed: npt.ArrayLike = 0.0
    start: npt.ArrayLike = 0.0
    until: npt.ArrayLike = np.inf

    def at(self, time):
        moving = (time >= np.asarray(self.start)) & (time < np.asarray(self.until))
        way = np.asarray(self.speed) * np.clip(np.minimum(time, self.until) - np.asarray(self.start), 0.0, None)
        speed = np.where(moving, self.speed, 0.0)
        return (
            self.x + way * math.cos(self.heading),
            self.y + way * math.sin(self.heading),
            self.heading,
            speed,
        )


class Run:
    """N scenarios of one driven car among others."""

    def __init__(
        self, driver, path, others=(), *, scenarios=1, speed=0.0, start=0.0, target=13.9, duration=30.0
    ) -> None:
        driver.start(scenarios, len(others))
        full = np.ones(scenarios)
        v, s = speed * full, start * full
        sizes = np.array([BOXES[o.kind] for o in others]).reshape(-1, 3)
        a = 0.0 * full
        self.touched = np.zeros((scenarios, len(others)), bool)
        rows, known, yielding = [], [], []
        self.time = np.arange(round(duration / DT)) * DT
        for time in self.time:
            x, y, heading = (np.interp(s, path.distance, c) for c in (path.x, path.y, path.heading))
            state = np.zeros((4, scenarios, len(others)))
            for k, other in enumerate(others):
                for row, value in zip(state, other.at(time), strict=True):
                    row[:, k] = value
            situation = Situation(
                float(time), DT, path, s, x, y, heading, v, a, **EGO, target_speed=target * full,
                others_x=state[0], others_y=state[1], others_heading=state[2], others_speed=state[3],
                others_length=sizes[:, 0], others_width=sizes[:, 1], others_center_x=sizes[:, 2],
                others_object_type=tuple(o.kind for o in others), active=np.ones(scenarios, bool),
            )  # fmt: skip
            ego, boxes = corners(situation)
            self.touched |= boxes_overlap(ego[:, None], boxes)
            a = driver.acceleration(situation)
            rows.append((s, v, a))
            known.append(getattr(driver, "known_mask", np.zeros((scenarios, len(others)), bool)).copy())
            yielding.append(getattr(driver, "yielding_mask", known[-1]).copy())
            v = v + a * DT
            s = s + v * DT
        # Each (instants, scenarios).
        self.distance, self.speed, self.acceleration = (np.array(column) for column in zip(*rows, strict=True))
        self.known, self.yielding = np.array(known), np.array(yielding)


def corners(s: Situation):
    ego = box_corners(
        s.x + s.center_x * np.cos(s.heading),
        s.y + s.center_x * np.sin(s.heading),
        s.heading,
        s.length,
        s.width,
    )
    boxes = box_corners(
        s.others_x + s.others_center_x * np.cos(s.others_heading),
        s.others_y + s.others_center_x * np.sin(s.others_heading),
        s.others_heading, s.others_length, s.others_width,
    )  # fmt: skip
    return ego, boxes


def line_is_free(eye, others, k, time):
    """The same by brute force: points along the lines of sight against the boxes."""
    boxes = []
    for other in others:
        x, y, heading, _ = other.at(time)
        length, width, center_x = BOXES[other.kind]
        boxes.append(
            box_corners(x + center_x * np.cos(heading), y + center_x * np.sin(heading), heading, length, width)
        )
    targets = np.vstack([boxes[k], boxes[k].mean(0)])
    blockers = [box for b, box in enumerate(boxes) if b != k]
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    return any(not any(inside(eye + along * (t - eye), box).any() for box in blockers) for t in targets)


def inside(points, box):
    """Whether points are within a box given by its corners, counter-clockwise."""
    sides = np.roll(box, -1, axis=0) - box
    to = points[:, None, :] - box
    return (sides[:, 0] * to[..., 1] - sides[:, 1] * to[..., 0] > 0.0).all(-1)


def who_is_seen(situation: Situation, **options) -> list[bool]:
    s = situation
    seen = find_visible_others(
        np.stack((s.x, s.y, s.heading), axis=1), np.array([s.length, s.width, s.center_x]),
        np.stack((s.others_x, s.others_y, s.others_heading), axis=1),
        np.stack((s.others_length, s.others_width, s.others_center_x)), **options,
    )  # fmt: skip
    return [bool(one) for one in seen[0]]


def looking(others_x, others_y, others_heading, kinds) -> Situation:
    sizes = np.array([BOXES[kind] for kind in kinds])
    zero = np.zeros(1)
    return Situation(
        0.0, DT, straight(), zero, zero, zero, zero, zero, zero, **EGO, target_speed=zero,
        others_x=np.atleast_2d(others_x), others_y=np.atleast_2d(others_y),
        others_heading=np.atleast_2d(others_heading), others_speed=np.zeros((1, len(kinds))),
        others_length=sizes[:, 0], others_width=sizes[:, 1], others_center_x=sizes[:, 2],
        others_object_type=tuple(kinds), active=np.ones(1, bool),
    )  # fmt: skip
