"""Scenarios whose kinds are known, and some that are all of one kind, by plain kinematics.

``SETS[name](count, rng)`` gives recordings of an ego and another at a junction, and the kind of each. The ego drives north
along x = 0, the other east along y = 0. Within a kind, starts, speeds, times and decelerations vary smoothly, as far as
one would still call it one kind. ``ASPECTS_OF[name]`` are aspects in which the kinds differ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from cornercase.recordings import Collision, Recording

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Maker = Callable[[int, np.random.Generator], tuple[list[Recording], Ints]]

STEP: Final = 0.2
INSTANTS: Final = 80
# A recording ends when the ego has driven so many metres beyond the junction.
BEYOND: Final = 30.0


@dataclass(frozen=True)
class Motion:
    """Of one entity: x and y in m, heading in rad, speed in m/s, each (T,)."""

    x: Floats
    y: Floats
    heading: Floats
    speed: Floats


def on_way(way: str, along: Floats, speed: Floats) -> Motion:
    """Of somebody who drives along a way, `along` m past its origin: north, north and left or right, or east."""
    if way == "east":
        return Motion(along, np.zeros_like(along), np.zeros_like(along), speed)
    if way.startswith("lane"):
        # lane:AT,LENGTH,OFFSET
        at, length, offset = (float(one) for one in way[5:].split(","))
        share = np.clip((along - at) / length, 0.0, 1.0)
        slope = offset * np.pi / 2 / length * np.sin(np.pi * share)
        return Motion(-offset * (1 - np.cos(np.pi * share)) / 2, along, np.pi / 2 + np.arctan(slope), speed)
    side = {"straight": 0.0, "left": 1.0, "right": -1.0}[way]
    if side == 0.0:
        return Motion(np.zeros_like(along), along, np.full_like(along, np.pi / 2), speed)
    radius = 10.0 if side > 0 else 6.0
    turned = np.clip(along / radius, 0.0, np.pi / 2)
    beyond = np.maximum(along - radius * np.pi / 2, 0.0)
    x = -side * (radius * (1 - np.cos(turned)) + beyond)
    y = np.where(along < 0, along, radius * np.sin(turned))
    return Motion(x, y, np.pi / 2 + side * turned, speed)


def travelled(accelerations: Sequence[tuple[float, float]], speed: float, start: float) -> tuple[Floats, Floats]:
    """Place and speed of somebody who holds each acceleration from its time on and never drives backwards."""
    time = np.arange(INSTANTS) * STEP
    begins = np.array([0.0, *(one for one, _ in accelerations)])
    which = np.searchsorted(begins, time, side="right") - 1
    held = np.array([0.0, *(one for _, one in accelerations)])[which]
    speeds = np.empty(INSTANTS)
    now = speed
    most = max(speed, 8.0)
    for t in range(INSTANTS):
        speeds[t] = now
        now = min(max(now + held[t] * STEP, 0.0), most)
    return start + np.concatenate(([0.0], np.cumsum(speeds[:-1] * STEP))), speeds


def ego(rng: np.random.Generator, what: str, way: str = "straight", spread: float = 2.0) -> tuple[Motion, float]:
    """An ego that starts some 40 m before the junction, and the time at which the other should be there.

    go: passes; yield: brakes, waits and goes on; stop, soft, hard: brakes and stays; behind: stops behind the junction;
    creep: slows down and rolls on; crash: brakes too late.
    """
    start = -40.0 - spread / 2 + spread * rng.random()
    speed = rng.uniform(8.5, 12.5)
    free = (-start - 8.0) / speed
    if what == "go":
        slow = rng.uniform(0.0, 0.3)
        place, speeds = travelled([(free * 0.6, -slow), (free + 1.0, slow)], speed, start)
        return on_way(way, place, speeds), free + rng.uniform(3.0, 5.0)
    if what == "creep":
        brake = rng.uniform(1.5, 2.2)
        lowest = rng.uniform(3.0, 4.0)
        begin = max((-start - 5.0 - (speed**2 - lowest**2) / (2 * brake)) / speed, 0.2)
        until = begin + (speed - lowest) / brake
        place, speeds = travelled([(begin, -brake), (until, 0.0), (until + rng.uniform(1.5, 2.5), 1.5)], speed, start)
        return on_way(way, place, speeds), until - rng.uniform(1.0, 2.0)
    forces = {
        "yield": (2.0, 4.0),
        "behind": (2.2, 3.5),
        "stop": (2.2, 3.5),
        "hard": (6.5, 8.0),
        "soft": (1.8, 2.4),
        "crash": (3.0, 5.0),
    }
    force = rng.uniform(*forces[what])
    # It stands before the junction, behind it, or too late.
    room = rng.uniform(*{"behind": (-16.0, -13.0), "crash": (-9.0, -5.0)}.get(what, (4.0, 7.0)))
    begin = max((-start - room - speed**2 / (2 * force)) / speed, 0.1)
    stands = begin + speed / force
    plan = [(begin, -force)]
    if what == "yield":
        plan.append((stands + rng.uniform(0.5, 3.5), rng.uniform(1.5, 2.5)))
    place, speeds = travelled(plan, speed, start)
    return on_way(way, place, speeds), stands + rng.uniform(-0.5, 0.5)


def other(rng: np.random.Generator, there: float) -> Motion:
    """Another that passes the junction at a time."""
    speed = rng.uniform(7.0, 9.0)
    place, speeds = travelled([], speed, -speed * there)
    return on_way("east", place, speeds)


def scenario(rng: np.random.Generator, what: str, way: str = "straight", *, spread: float = 2.0) -> Recording:
    moves, there = ego(rng, what, way, spread)
    if what != "crash":
        return ended(moves, other(rng, there))
    # The other comes to where the ego is when that enters the junction, and the recording ends there.
    hit = int(np.argmax(moves.y > -2.0))
    return ended(moves, other(rng, hit * STEP), hit)


def ended(ego: Motion, other: Motion, hit: int | None = None) -> Recording:
    """A recording that ends at a collision, or once the ego is far beyond the junction."""
    beyond = (np.hypot(ego.x, ego.y) > BEYOND) & (np.maximum(ego.y, np.abs(ego.x)) > 0.0)
    last = int(np.argmax(np.append(beyond, True))) if hit is None else hit
    time = np.arange(last) * STEP
    stacked = {
        name: np.stack([getattr(one, name)[:last] for one in (ego, other)]) for name in ("x", "y", "heading", "speed")
    }
    return Recording(
        time=time,
        names=("Ego", "Other"),
        object_types=("car", "car"),
        acceleration=np.gradient(stacked["speed"], STEP, axis=1),
        length=np.full(2, 4.5),
        width=np.full(2, 1.8),
        center_x=np.zeros(2),
        collisions=() if hit is None else (Collision(float(time[-1]), ("Ego", "Other")),),
        **stacked,
    )


def of_kinds(kinds: Sequence[tuple[str, str]], shares: Sequence[float] | None = None, spread: float = 2.0) -> Maker:
    """Set with so many kinds; without shares all are of one size."""

    def make(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
        parts = np.full(len(kinds), 1 / len(kinds)) if shares is None else np.asarray(shares)
        sizes = np.floor(parts * count + 1e-9).astype(np.int64)
        sizes[0] += count - sizes.sum()
        truth = rng.permutation(np.repeat(np.arange(len(kinds)), sizes))
        return [scenario(rng, *kinds[k], spread=spread) for k in truth.tolist()], truth

    return make


def lane_changes(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    truth = rng.permutation(np.arange(count) % 3)
    made = []
    for kind in truth.tolist():
        place, speeds = travelled([], rng.uniform(9.0, 12.0), -20.0 - 4.0 * rng.random())
        way = f"lane:{rng.uniform(-15, -5)},{rng.uniform(20, 32)},{(kind - 1) * rng.normal(3.5, 0.15)}"
        made.append(ended(on_way(way, place, speeds), other(rng, rng.uniform(6.0, 8.0))))
    return made, truth


def five_far(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    truth = rng.permutation(np.where(np.arange(count) < 5, 1, 0))
    return [scenario(rng, ("go", "hard")[k]) for k in truth.tolist()], truth


def one_by_reaction(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    """All brake to a stop, from softly to hard, at a time that varies: no kinds."""
    made = []
    for _ in range(count):
        plan = [(rng.uniform(0.5, 1.5), -rng.uniform(2.0, 6.0))]
        place, speeds = travelled(plan, rng.uniform(9.0, 12.0), -42.0 + 4.0 * rng.random())
        made.append(ended(on_way("straight", place, speeds), other(rng, 6.0)))
    return made, np.zeros(count, dtype=np.int64)


def one_by_speed(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    """All turn left at a speed that varies: one parameter, no kinds."""
    made = []
    for _ in range(count):
        place, speeds = travelled([], rng.uniform(6.0, 12.0), -40.0)
        made.append(ended(on_way("left", place, speeds), other(rng, 6.0)))
    return made, np.zeros(count, dtype=np.int64)


def exits(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    """Left, straight on or right, at speeds from slow to fast."""
    truth = rng.permutation(np.arange(count) % 3)
    made = []
    for kind in truth.tolist():
        place, speeds = travelled([(rng.uniform(0.0, 3.0), rng.uniform(-0.5, 0.5))], rng.uniform(5.0, 9.0), -30.0)
        made.append(
            ended(on_way(("left", "straight", "right")[kind], place, speeds), other(rng, rng.uniform(4.0, 9.0)))
        )
    return made, truth


def who_is_first(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    """Nobody reacts: the ego passes 1.5 to 5 s before the other, or after it."""
    truth = rng.permutation(np.arange(count) % 2)
    made = []
    for kind in truth.tolist():
        speed, start = rng.uniform(7.0, 11.0), -35.0 - 10.0 * rng.random()
        place, speeds = travelled([], speed, start)
        apart = rng.uniform(1.5, 5.0) * (1.0 if kind == 0 else -1.0)
        made.append(ended(on_way("straight", place, speeds), other(rng, -start / speed + apart)))
    return made, truth


def following(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    """The ego comes up behind a slower one: it follows, overtakes, or falls back to a stop."""
    truth = rng.permutation(np.arange(count) % 3)
    made = []
    for kind in truth.tolist():
        slow, begin = rng.uniform(4.0, 6.0), rng.uniform(0.5, 1.5)
        ahead, ahead_speeds = travelled([], slow, -10.0 + rng.uniform(0.0, 4.0))
        before = on_way("straight", ahead, ahead_speeds)
        force = rng.uniform(2.0, 3.0)
        speed = rng.uniform(8.5, 10.5)
        plans: tuple[list[tuple[float, float]], ...] = (
            [(begin, -force), (begin + (speed - slow) / force, 0.0)],
            [],
            [(begin, -force)],
        )
        place, speeds = travelled(plans[kind], speed, -40.0)
        way = f"lane:{rng.uniform(-30, -25)},{rng.uniform(15, 25)},{rng.uniform(3.2, 3.8)}" if kind == 1 else "straight"
        made.append(ended(on_way(way, place, speeds), before))
    return made, truth


def one_by_gap(count: int, rng: np.random.Generator) -> tuple[list[Recording], Ints]:
    """The ego passes well before the other, by a time that varies: no kinds."""
    made = []
    for _ in range(count):
        speed = rng.uniform(8.0, 11.0)
        place, speeds = travelled([], speed, -40.0)
        made.append(ended(on_way("straight", place, speeds), other(rng, 40.0 / speed + rng.uniform(2.0, 6.0))))
    return made, np.zeros(count, dtype=np.int64)


TEN: Final = [
    *((what, way) for way in ("left", "straight", "right") for what in ("go", "yield", "behind")),
    ("crash", "straight"),
]
TWELVE: Final = [(what, way) for way in ("left", "straight", "right") for what in ("go", "yield", "behind", "creep")]
UNEQUAL: Final = [("go", "left"), ("yield", "straight"), ("stop", "right"), ("go", "right")]
SETS: Final[Mapping[str, Maker]] = {
    "yield or go": of_kinds([("go", "straight"), ("yield", "straight")]),
    "starts 20 m apart": of_kinds([("go", "straight"), ("yield", "straight")], spread=20.0),
    "lane changes": lane_changes,
    "braking": of_kinds([("go", "straight"), ("soft", "straight"), ("hard", "straight")]),
    "5 % crashes": of_kinds([("go", "straight"), ("yield", "straight"), ("crash", "straight")], (0.5, 0.45, 0.05)),
    "ten kinds": of_kinds(TEN),
    "twelve kinds": of_kinds(TWELVE),
    "unequal": of_kinds(UNEQUAL, (0.7, 0.15, 0.1, 0.05)),
    "five far": five_far,
    "exits": exits,
    "who is first": who_is_first,
    "following": following,
}
WITHOUT: Final[Mapping[str, Maker]] = {
    "one by speed": one_by_speed,
    "one by reaction": one_by_reaction,
    "one by gap": one_by_gap,
}
ASPECTS_OF: Final[Mapping[str, tuple[str, ...]]] = {
    "yield or go": ("ego-motion", "ego-speed", "interaction"),
    "starts 20 m apart": ("ego-motion", "ego-speed", "interaction"),
    "lane changes": ("ego-trajectory", "ego-motion"),
    "braking": ("ego-motion", "ego-speed"),
    "5 % crashes": ("ego-motion", "interaction"),
    "ten kinds": ("ego-motion", "interaction"),
    "twelve kinds": ("ego-motion", "interaction"),
    "unequal": ("ego-motion", "ego-trajectory", "interaction"),
    "five far": ("ego-motion", "ego-speed", "interaction"),
    "exits": ("ego-trajectory", "ego-motion"),
    "who is first": ("bearing", "interaction"),
    "following": ("ego-motion", "ego-speed"),
    # By bearing these two have kinds: the other passes before the ego or behind it.
    "one by speed": ("ego-trajectory", "ego-speed", "ego-motion", "interaction"),
    "one by reaction": ("ego-trajectory", "ego-speed", "ego-motion", "interaction"),
    "one by gap": ("ego-trajectory", "ego-speed", "ego-motion", "interaction", "bearing"),
}
# Sets that were not made when constants were chosen.
UNSEEN: Final = ("exits", "who is first", "following", "one by gap")
