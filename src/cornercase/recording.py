"""What came out of one concrete scenario: the motion of all entities."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cornercase.errors import InputError, suggestion
from cornercase.files import written_whole
from cornercase.typing import FloatArray, IntArray

COLUMNS = (
    "time", "entity", "kind", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x",
)  # fmt: skip
_MOTION = ("x", "y", "heading", "speed", "acceleration")
_BOX = ("length", "width", "center_x")


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
                    motion = [float(getattr(self, column)[a, t]) for column in _MOTION]
                    box = [float(getattr(self, column)[a]) for column in _BOX]
                    others = ";".join(touched.get((time, name), ()))
                    writer.writerow((time, name, self.kinds[a], *motion, *box, others))


def read_recording(path: Path | str) -> Recording:
    """Read a recording, of cornercase or of another tool.

    Parameters
    ----------
    path : path
        By its ending an ASAM OSI trace (``.osi``, ``.mcap``; extra ``osi``), a CommonRoad scenario (``.xml``;
        extra ``commonroad``), floating car data of SUMO (``.xml``), a result file of CarMaker (``.erg``), a file of
        CARLA's recorder (``.log``), or else CSV: a log of esmini, or a table with at least the columns `COLUMNS`. Its
        rows may come in any order; an entity without a row at an instant of another's does not exist then.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a field is no number, or an entity has two rows of one
        time; the message names the line. Or the extra that reads it is not installed.
    """
    path = Path(path)
    if path.suffix.lower() in (".osi", ".mcap", ".xz", ".lzma"):
        from cornercase.readers.osi import read_osi

        return read_osi(path)
    if path.suffix.lower() == ".erg":
        from cornercase.readers.erg import read_erg

        return read_erg(path)
    if path.suffix.lower() == ".log":
        from cornercase.readers.carla_log import read_carla_log

        return read_carla_log(path)
    if path.suffix.lower() == ".xml":
        from cornercase.readers.commonroad import read_commonroad
        from cornercase.readers.sumo_fcd import read_sumo_fcd

        return read_sumo_fcd(path) if _begins(path, "<fcd-export") else read_commonroad(path)
    from cornercase.readers.esmini import FIRST_WORDS, read_esmini

    if _begins(path, FIRST_WORDS):
        return read_esmini(path)
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            missing = [column for column in COLUMNS if column not in (reader.fieldnames or ())]
            if missing:
                raise InputError(
                    f"{path}: the header lacks {', '.join(missing)}; a recording has the columns {', '.join(COLUMNS)}."
                )
            rows = [(reader.line_num, row) for row in reader]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is not a CSV table in UTF-8 ({error}).") from error
    if not rows:
        raise InputError(f"{path}: has a header but no rows.")

    numbers = np.array([[_number(path, line, row, c) for c in ("time", *_MOTION, *_BOX)] for line, row in rows])
    if not np.isfinite(numbers[:, 0]).all():
        raise InputError(f"{path}: every row needs a finite time.")
    time, instant = np.unique(numbers[:, 0], return_inverse=True)
    names = tuple(dict.fromkeys(row["entity"] for _, row in rows))
    entity = np.array([names.index(row["entity"]) for _, row in rows])
    _refuse_doubles(path, [line for line, _ in rows], entity * len(time) + instant)
    motion = np.full((len(_MOTION), len(names), len(time)), np.nan)
    motion[:, entity, instant] = numbers[:, 1 : 1 + len(_MOTION)].T
    first = [int(np.flatnonzero(entity == a)[0]) for a in range(len(names))]
    box = numbers[first, 1 + len(_MOTION) :].T
    if not (np.isfinite(box).all() and (box[:2] >= 0).all()):
        raise InputError(f"{path}: length and width must be finite and not negative for every entity.")
    x, y, heading, speed, acceleration = motion
    length, width, center_x = box
    collisions = tuple(
        Collision(float(numbers[i, 0]), (row["entity"], other))
        for i, (line, row) in enumerate(rows)
        for other in _touched(path, line, row.get("collision") or "", names)
    )
    return Recording(
        time,
        names,
        tuple(rows[i][1]["kind"] for i in first),
        x,
        y,
        heading,
        speed,
        acceleration,
        length,
        width,
        center_x,
        tuple(sorted(collisions, key=lambda c: c.time)),
    )


def _refuse_doubles(path: Path, lines: list[int], place: IntArray) -> None:
    """Refuse a second row of one entity at one instant."""
    order = np.argsort(place, kind="stable")
    double = np.flatnonzero(np.diff(place[order]) == 0)
    if len(double):
        first, second = order[double[0]], order[double[0] + 1]
        raise InputError(
            f"{path}, line {lines[second]}: the entity has a row of this time in line {lines[first]} already; "
            "leave one of the two."
        )


def _touched(path: Path, line: int, text: str, names: tuple[str, ...]) -> list[str]:
    """Entities named in the column ``collision``."""
    found = [part.strip() for part in text.split(";") if part.strip()]
    for name in found:
        if name not in names:
            raise InputError(f"{path}, line {line}: collision names '{name}'; {suggestion(name, names)}")
    return found


def _number(path: Path, line: int, row: dict[str, str | None], column: str) -> float:
    text = (row[column] or "").strip()
    if text == "":
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{path}, line {line}: {column} is '{text}', which is not a number.") from None


def _begins(path: Path, words: str) -> bool:
    """Whether some words stand at the beginning of a file."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return words in file.read(8192)
    except OSError:
        return False
