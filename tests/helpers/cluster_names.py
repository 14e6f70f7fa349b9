"""What names of kinds say, read anew: whether a name is true of a recording, by code of its own.

Boxes are looked at at each instant alone, so times may be an instant off; bounds are taken with that tolerance.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import label
from scipy.spatial.distance import cdist

from cornercase.metrics.fault._find_fault import find_fault
from cornercase.recordings import Recording

TOLERANCE = 0.11
NUMBER = r"(-?[\d.]+)"
# A text between quotation marks, in which those of its own are escaped.
QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"')


def bare(name):
    """What stands between quotation marks."""
    return json.loads(name) if QUOTED.fullmatch(name) else name


def parts_of(name, mark):
    """Parts of a text between marks that are not in quotation marks."""
    masked = QUOTED.sub(lambda found: "\0" * len(found[0]), name)
    starts = [0, *(one.end() for one in re.finditer(mark, masked))]
    ends = [*(one.start() for one in re.finditer(mark, masked)), len(name)]
    return [name[start:end] for start, end in zip(starts, ends, strict=True)]


def written(name):
    """How an entity is called in a name of a kind."""
    return name if re.fullmatch(r"[\w./:#+-]+", name) else json.dumps(name, ensure_ascii=False)


def turned(angle):
    return abs(math.remainder(angle, 2 * math.pi))


def corners(x, y, heading, length, width):
    along = 0.5 * length * np.array([1, 1, -1, -1])
    across = 0.5 * width * np.array([1, -1, -1, 1])
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    return np.stack([x[:, None] + c * along - s * across, y[:, None] + s * along + c * across], -1)


def gap_along_axes(a, b):
    """Widest gap between boxes (n, 4, 2) on the axes of both; negative where they overlap."""
    widest = np.full(len(a), -np.inf)
    for box in (a, b):
        for k in (0, 1):
            axis = box[:, k + 1] - box[:, k]
            axis = axis / np.maximum(np.hypot(*axis.T), 1e-12)[:, None]
            on_a, on_b = (a * axis[:, None]).sum(-1), (b * axis[:, None]).sum(-1)
            widest = np.maximum(widest, np.maximum(on_a.min(1) - on_b.max(1), on_b.min(1) - on_a.max(1)))
    return widest


def to_segments(points, box):
    """Smallest distance from the corners of a box to the sides of another."""
    ends = np.roll(box, -1, axis=0)
    side = ends - box
    share = ((points[:, None] - box) * side).sum(-1) / np.maximum((side**2).sum(-1), 1e-12)
    return np.linalg.norm(points[:, None] - (box + np.clip(share, 0, 1)[..., None] * side), axis=-1).min()


class Scene:
    """One scenario, as an onlooker sees it."""

    def __init__(self, recording: Recording, ego: str, other: str, values: Mapping[str, Any]) -> None:
        self.recording, self.ego, self.other = recording, ego, other
        # Of values that go together each by itself, too.
        sets = [zip(name.split(", "), str(one).split(", "), strict=False) for name, one in values.items()]
        self.values = {name: one for each in sets for name, one in each} | dict(values)
        self.there = [bool(np.isfinite(recording.x[recording.names.index(one)]).any()) for one in (ego, other)]
        self.i, self.time = recording.names.index(ego), recording.time
        self.v = np.abs(recording.speed[self.i])

    def track(self, name, carried):
        r = self.recording
        k = r.names.index(name)
        there = np.isfinite(r.x[k] + r.y[k] + r.heading[k] + r.speed[k])
        x = (r.x[k] + r.center_x[k] * np.cos(r.heading[k]))[there]
        y = (r.y[k] + r.center_x[k] * np.sin(r.heading[k]))[there]
        time, heading = r.time[there], r.heading[k][there]
        if carried and len(time) and time[-1] == r.time[-1] and np.nanmax(np.abs(r.speed[k])) >= 0.1:
            way = np.arange(0.25, 20.01, 0.25)
            x, y = np.append(x, x[-1] + way * np.cos(heading[-1])), np.append(y, y[-1] + way * np.sin(heading[-1]))
            time, heading = np.append(time, time[-1] + 1 + way), np.append(heading, np.full(len(way), heading[-1]))
        return time, np.stack([x, y], -1), heading, corners(x, y, heading, r.length[k], r.width[k])

    def cross(self, name, carried):
        """When ego and another first enter and leave what both sweep; None where they sweep nothing together."""
        (ta, pa, _, a), (tb, pb, _, b) = self.track(self.ego, carried), self.track(name, carried)
        r = self.recording
        reach = sum(np.hypot(r.length[k], r.width[k]) / 2 for k in (self.i, r.names.index(name)))
        meets = cdist(pa, pb) <= reach
        i, j = np.nonzero(meets)
        meets[i, j] = gap_along_axes(a[i], b[j]) <= 0
        parts, count = label(meets, structure=np.ones((3, 3)))
        spans = [np.nonzero(parts == k) for k in range(1, count + 1)]
        spans = [(ta[i.min()], ta[i.max()], tb[j.min()], tb[j.max()]) for i, j in spans]
        return min(spans, key=lambda one: min(one[0], one[2]), default=None)

    def seen(self, name, at):
        """How far another is ahead of the ego and to its left, and how much it is turned."""
        r, k = self.recording, self.recording.names.index(name)
        h = r.heading[self.i, at]
        away = (r.box_center(name) - r.box_center(self.ego))[at]
        ahead, left = away @ (np.cos(h), np.sin(h)), away @ (-np.sin(h), np.cos(h))
        return ahead, left, turned(r.heading[k, at] - h)

    def meet(self, name):
        """Relation, who is first, and the times of entering, leaving and between (NaN where there are none)."""
        r, k = self.recording, self.recording.names.index(name)
        both = np.flatnonzero(np.isfinite(r.x[k] + r.x[self.i]))
        nobody = ("apart", None, None, math.nan, math.nan, math.nan)
        if not len(both):
            return nobody
        begin, end = self.seen(name, both[0]), self.seen(name, both[-1])
        span = self.cross(name, False)
        if max(begin[2], end[2]) < math.pi / 4 and (max(abs(begin[1]), abs(end[1])) <= 5 or span):
            begins, ends = (name if one[0] > 0 else self.ego for one in (begin, end))
            return ("lane", ends, begins, math.nan, math.nan, math.nan)
        if max(begin[2], end[2]) < math.pi / 4:
            return nobody
        last = self.time[-1]
        if span is None:
            span = self.cross(name, True)
            if span is None or min(span[0], span[2]) > last:
                return nobody
            first = self.ego if span[0] < span[2] else name
            enters, leaves = (span[0], math.nan) if first == self.ego else (math.nan, min(span[3], last))
            return ("crossing", first, None, enters, leaves, math.nan)
        enters, exits, comes, leaves = span
        first = self.ego if enters < comes else name
        between = comes - exits if first == self.ego else enters - leaves
        return ("crossing", first, None, enters, leaves, between)

    @cached_property
    def met(self):
        return self.meet(self.other)

    @cached_property
    def distances(self):
        r, o = self.recording, self.recording.names.index(self.other)
        boxes = []
        for k in (self.i, o):
            x, y = r.box_center(r.names[k]).T
            boxes.append(corners(x, y, r.heading[k], r.length[k], r.width[k]))
        apart = gap_along_axes(*boxes) > 0
        known = np.isfinite(boxes[0]).all((1, 2)) & np.isfinite(boxes[1]).all((1, 2))
        found = np.full(len(self.time), np.nan)
        for t in np.flatnonzero(known):
            a, b = boxes[0][t], boxes[1][t]
            found[t] = min(to_segments(a, b), to_segments(b, a)) if apart[t] else 0.0
        return found

    @cached_property
    def impact(self):
        """Whom the ego hits first: name, time, speed between both; None where it hits nobody."""
        hits = [one for one in self.recording.collisions if self.ego in one.entities]
        if not hits:
            return None
        first = min(hits, key=lambda one: one.time)
        (name,) = set(first.entities) - {self.ego}
        r, k = self.recording, self.recording.names.index(name)
        at = min(range(len(r.time)), key=lambda t: abs(r.time[t] - first.time))
        way = [r.speed[q, at] * np.array([np.cos(r.heading[q, at]), np.sin(r.heading[q, at])]) for q in (self.i, k)]
        return name, first.time, float(np.linalg.norm(way[0] - way[1])), at

    @property
    def stops(self):
        moved = np.maximum.accumulate(self.v >= 0.1)
        return bool((moved & (self.v < 0.1)).any())

    def gives_way(self, share):
        """Whether the ego, second, is that slow before it enters and before the other has left."""
        relation, first, _, enters, leaves, _ = self.met
        if relation != "crossing" or first == self.ego:
            return False
        until = np.nanmin([self.time[-1], enters, leaves]) + TOLERANCE
        moved = np.maximum.accumulate(self.v >= 0.1)
        before = np.flatnonzero(moved & (self.time <= until))
        if not len(before):
            return False
        slowest = before[self.v[before].argmin()]
        if self.v[slowest] < 0.1:
            return True
        again = math.isnan(enters) or self.v[slowest] <= (share + 0.03) * np.interp(enters, self.time, self.v)
        return share > 0 and self.v[slowest] <= (share + 0.03) * self.v[: slowest + 1].max() and again

    @property
    def turn(self):
        h = np.unwrap(self.recording.heading[self.i])
        return h[-1] - h[0]

    @property
    def shift(self):
        r, h = self.recording, self.recording.heading[self.i, 0]
        x, y = r.x[self.i], r.y[self.i]
        return (y[-1] - y[0]) * np.cos(h) - (x[-1] - x[0]) * np.sin(h)

    @property
    def braking(self):
        r = self.recording
        slows = -np.sign(r.speed[self.i]) * r.acceleration[self.i]
        return max(slows[self.v >= 0.1].max(initial=0.0), 0.0)

    def mean(self, name):
        return float(np.nanmean(np.abs(self.recording.speed[self.recording.names.index(name)])))

    def hit_manner(self):
        if self.impact is None:
            return None
        name, _, _, at = self.impact
        ahead, _, angle = self.seen(name, at)
        if self.v[at] < 0.1:
            return "standing"
        return "other" if angle >= math.pi / 4 else "behind" if ahead > 0 else "rear"


def ending(scene, said):
    """Whether one of the endings at the beginning of a name is true."""
    hit, other, ego = scene.impact, written(scene.other), scene.ego
    if said == "stands all the time":
        return scene.there[0] and bool(np.nanmax(scene.v) < 0.1)
    manners = {
        r"runs into the rear of (.*)": "behind",
        r"is hit from behind by (.*)": "rear",
        r"is hit by (.*) while it stands": "standing",
        r"collides with (.*)": None,
    }
    for pattern, manner in manners.items():
        if found := re.fullmatch(pattern, said):
            return hit is not None and hit[0] == bare(found[1]) and manner in (None, scene.hit_manner())
    if hit is not None:
        return False
    relation, first, ahead, enters, _, between = scene.met
    crossing, second = relation == "crossing", relation == "crossing" and first == scene.other
    checks = {
        "is never there": not scene.there[0],
        f"is there without {other}": scene.there == [True, False],
        f"does not meet {other}": relation == "apart",
        f"stays ahead of {other}": relation == "lane" and first == ahead == ego,
        f"stays behind {other}": relation == "lane" and first == ahead == scene.other,
        f"overtakes {other}": relation == "lane" and first == ego != ahead,
        f"is overtaken by {other}": relation == "lane" and first == scene.other != ahead,
        f"passes before {other}": crossing and first == ego,
        f"passes while {other} waits": crossing and first == ego and math.isnan(between),
        f"passes after {other}": second and not math.isnan(enters),
        f"comes after {other}": second,
        f"stops for {other}": scene.gives_way(0.0),
        f"yields to {other}": scene.gives_way(0.8),
    }
    return checks[said]


def speeds(low: float, high: float) -> Callable[[Scene], bool]:
    return lambda s: s.impact is not None and low <= s.impact[2] < high


WORDS: dict[str, Callable[[Scene], bool]] = {
    "at low speed": speeds(0, 5),
    "at medium speed": speeds(5, 10),
    "at high speed": speeds(10, math.inf),
    "closely": lambda s: -TOLERANCE <= s.met[5] < 1.5 + TOLERANCE,
    "clear": lambda s: s.met[5] >= 3.0 - TOLERANCE,
    "after a stop": lambda s: s.stops,
    "without a stop": lambda s: s.v.max() >= 0.1 and not s.stops,
    "brakes hard": lambda s: s.braking >= 5,
    "brakes softly": lambda s: 0.5 <= s.braking < 3,
    "without braking": lambda s: s.braking < 0.5 and s.v.max() >= 0.1,
    "moves to the left": lambda s: abs(s.turn) < math.pi / 9 and s.shift > 1.5,
    "moves to the right": lambda s: abs(s.turn) < math.pi / 9 and s.shift < -1.5,
    "goes straight on": lambda s: abs(s.turn) < math.pi / 9 and abs(s.shift) <= 1.5 and s.v.max() >= 0.1,
    "turns left": lambda s: s.turn >= math.pi / 4,
    "turns right": lambda s: s.turn <= -math.pi / 4,
}
MEASURED: dict[str, tuple[str, Callable[[Scene], float]]] = {
    "s impact": (r"hits (before|after) # s", lambda s: s.impact[1] if s.impact else math.nan),
    "impact": (r"hits (slower|faster) than # m/s", lambda s: s.impact[2] if s.impact else math.nan),
    "entry": (r"enters (before|after) # s", lambda s: s.met[3]),
    "gap": (r"gap (below|above) # s", lambda s: s.met[5]),
    "nearest": (r"(?:comes|stays) (within|more than) # m (?:of|from) OTHER", lambda s: np.nanmin(s.distances)),
    "when": (r"nearest (before|after) # s", lambda s: s.time[np.nanargmin(s.distances)]),
    "lowest": (r"(?:slows|stays) (below|above) # m/s", lambda s: np.nanmin(s.v)),
    "never": (r"(never above) # m/s", lambda s: np.nanmax(s.v)),
    "reaches": (r"reaches (more than) # m/s", lambda s: np.nanmax(s.v)),
    "mean": (r"(slower|faster) than # m/s on average", lambda s: s.mean(s.ego)),
    "first": (r"begins (slower|faster) than # m/s", lambda s: s.v[0]),
    "last": (r"ends (slower|faster) than # m/s", lambda s: s.v[-1]),
    "stands": (r"stands (less|more) than # s", lambda s: np.diff(s.time)[s.v[:-1] < 0.1].sum()),
    "brakes": (r"brakes (less|more) than # m/s²", lambda s: s.braking),
    "way": (
        r"goes (less|more) than # m",
        lambda s: np.hypot(np.diff(s.recording.x[s.i]), np.diff(s.recording.y[s.i])).sum(),
    ),
    "over": (r"over (before|after) # s", lambda s: s.time[-1] - s.time[0]),
    "begins": (
        r"begins (within|more than) # m (?:of|from) OTHER",
        lambda s: s.distances[np.isfinite(s.distances)][0],
    ),
    "other": (r"OTHER (slower|faster) than # m/s on average", lambda s: s.mean(s.other)),
}
LESS = {"before", "slower", "below", "within", "never above", "less"}
TIMES = ("entry", "gap")


def qualifier(scene, said):
    if said in WORDS:
        return bool(WORDS[said](scene))
    for name, (pattern, value) in MEASURED.items():
        pattern = pattern.replace("#", NUMBER).replace("OTHER", re.escape(written(scene.other)))
        if found := re.fullmatch(pattern, said):
            tolerance = TOLERANCE if name in TIMES else 0.0
            number, bound = value(scene), float(found[2])
            return bool(number < bound + tolerance if found[1] in LESS else number > bound - tolerance)
    if found := re.fullmatch(r"(before|after|ahead of|behind) (.*)", said):
        _, first, *_ = scene.meet(bare(found[2]))
        return first == (scene.ego if found[1] in ("before", "ahead of") else bare(found[2]))
    if found := re.fullmatch(r"(.*) and (.*) collide", said):
        return any(set(one.entities) == {bare(found[1]), bare(found[2])} for one in scene.recording.collisions)
    if found := re.fullmatch(r"(.*) first", said):
        return scene.met[1] == bare(found[1])
    if found := re.fullmatch(r"(.*) at fault", said):
        hit = next((hit for hit in scene.recording.collisions if scene.ego in hit.entities), None)
        who = None if hit is None else find_fault(scene.recording, scene.ego, hit).who
        return who == ("both" if found[1] == "both" else "ego" if bare(found[1]) == scene.ego else "other")
    if found := re.fullmatch(r"as in scenario \d+", said):
        return True
    if found := re.fullmatch(rf"(.*?) ([<>]) {NUMBER}( \S+)?", said):
        value, bound = scene.values[bare(found[1])], float(found[3])
        return value < bound if found[2] == "<" else value > bound
    if found := re.fullmatch(r"(.*) from the (left|right)", said):
        r, o = scene.recording, scene.recording.names.index(bare(found[1]))
        _, left, _ = scene.seen(bare(found[1]), np.flatnonzero(np.isfinite(r.x[o] + r.x[scene.i]))[0])
        return scene.met[0] == "crossing" and left * (1 if found[2] == "left" else -1) > 1.5
    name, choice = map(bare, parts_of(said, " is "))
    return str(scene.values[name]) == choice


def is_true(name, scene):
    """Whether a name of a kind is true of a scenario; it is taken apart at commas."""
    head, *parts = parts_of(name, ", ")
    ego = f"{written(scene.ego)} "
    assert head.startswith(ego)
    endings = parts_of(head.removeprefix(ego), " or ")
    if endings != ["ends in several ways"] and not any(ending(scene, one) for one in endings):
        return False
    return all(qualifier(scene, one) for one in parts)
