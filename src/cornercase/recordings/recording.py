"""What came out of one concrete scenario: the motion of all entities."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.files import written_whole
from cornercase._common.typing import FloatArray

COLUMNS = (
    "time", "entity", "kind", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x",
)  # fmt: skip
MOTION = ("x", "y", "heading", "speed", "acceleration")
BOX = ("length", "width", "center_x")


@dataclass(frozen=True)
class Collision:
    """The first instant at which two entities' boxes touch.

    Attributes
    ----------
    time : float
        s.
    entities : tuple of str
        The two names, in the recording's order.
    """

    time: float
    entities: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Recording:
    """Motion of A entities at T instants.

    Attributes
    ----------
    time : ndarray of float64, shape (T,)
        s, increasing.
    names : tuple of str, length A
    kinds : tuple of str, length A
        Vehicle category (``"car"``, ``"truck"``, …), ``"pedestrian"`` or ``"misc"``.
    x, y : ndarray of float64, shape (A, T)
        OpenSCENARIO's reference point in m: the rear axle on the ground for vehicles. NaN where an entity does
        not exist; so with all that follow.
    heading : ndarray of float64, shape (A, T)
        rad, counter-clockwise from +x.
    speed : ndarray of float64, shape (A, T)
        m/s along the heading, negative when reversing.
    acceleration : ndarray of float64, shape (A, T)
        m/s² along the heading.
    length, width : ndarray of float64, shape (A,)
        Bounding box in m.
    center_x : ndarray of float64, shape (A,)
        How far the centre of the bounding box lies ahead of the reference point, in m.
    collisions : tuple of Collision
        In order of time.
    """

    time: FloatArray
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    length: FloatArray
    width: FloatArray
    center_x: FloatArray
    collisions: tuple[Collision, ...] = ()

    def index(self, name: str) -> int:
        """Row of the entity called `name`.

        Raises
        ------
        InputError
            There is no such entity.
        """
        if name not in self.names:
            raise InputError(f"The recording has no entity '{name}'; {suggestion(name, self.names)}")
        return self.names.index(name)

    def center(self, name: str) -> FloatArray:
        """Centre of the bounding box over time, in m, shape (T, 2)."""
        i = self.index(name)
        ahead = self.center_x[i]
        return np.stack([self.x[i] + ahead * np.cos(self.heading[i]), self.y[i] + ahead * np.sin(self.heading[i])], -1)

    def to_csv(self, path: Path | str) -> None:
        """Write one row per entity and instant, with the columns `COLUMNS` and ``collision``.

        Numbers are written so that reading gives the same bits. ``collision`` names the entities whose box is
        first touched at that instant, separated by semicolons.

        Raises
        ------
        InputError
            The name of an entity that collides has a semicolon in it.
        """
        touched: dict[tuple[float, str], list[str]] = {}
        for collision in self.collisions:
            first, second = collision.entities
            touched.setdefault((collision.time, first), []).append(second)
            if ";" in second:
                raise InputError(f"{path}: the name '{second}' has a semicolon in it; rename the entity.")
        with written_whole(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow((*COLUMNS, "collision"))
            for t, time in enumerate(self.time.tolist()):
                for a, name in enumerate(self.names):
                    motion = [float(getattr(self, column)[a, t]) for column in MOTION]
                    box = [float(getattr(self, column)[a]) for column in BOX]
                    others = ";".join(touched.get((time, name), ()))
                    writer.writerow((time, name, self.kinds[a], *motion, *box, others))
