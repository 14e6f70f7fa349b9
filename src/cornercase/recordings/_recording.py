"""Recorded motion of all entities of a concrete scenario."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from itertools import chain, cycle, repeat
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import atomic_write
from cornercase._common.text.sanitize import escape_csv_cell
from cornercase._common.typing import FloatArray
from cornercase.recordings._svg import TRACK_COLORS, draw_tracks

if TYPE_CHECKING:
    import pandas

CSV_COLUMNS = (
    "time", "entity", "kind", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x",
)  # fmt: skip
MOTION_ARRAYS = ("x", "y", "heading", "speed", "acceleration")
"""Arrays of a recording with its motion, shape (A, T)."""
BOX_ARRAYS = ("length", "width", "center_x")
"""Arrays of a recording with its bounding boxes, shape (A,)."""


@dataclass(frozen=True)
class Collision:
    """The first instant at which the boxes of two entities touch.

    Attributes
    ----------
    time : float
        Time in s.
    entities : tuple of str
        Names of the two entities, in the order of the recording.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_in.xosc", drivers={"Ego": "simple"})
    >>> collision = recording.collisions[0]
    >>> round(collision.time, 2), collision.entities
    (3.4, ('Ego', 'Other'))
    """

    time: float
    entities: tuple[str, str]


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """Motion of A entities at T instants.

    Attributes
    ----------
    time : ndarray of float64, shape (T,)
        Times of the instants in s, increasing.
    names : tuple of str, length A
        Names of the entities.
    object_types : tuple of str, length A
        Vehicle category (``"car"``, ``"truck"``, …), ``"pedestrian"``, ``"animal"`` or ``"misc"``, by entity.
    x, y : ndarray of float64, shape (A, T)
        Reference point of OpenSCENARIO in m: for vehicles, the center of the rear axle on the ground. All motion is NaN
        while an entity does not exist.
    heading : ndarray of float64, shape (A, T)
        Direction in rad, counter-clockwise from +x.
    speed : ndarray of float64, shape (A, T)
        Speed in m/s along the heading, negative when reversing.
    acceleration : ndarray of float64, shape (A, T)
        Acceleration in m/s² along the heading.
    length, width : ndarray of float64, shape (A,)
        Size of the bounding box in m.
    center_x : ndarray of float64, shape (A,)
        Distance of the box center ahead of the reference point, in m.
    collisions : tuple of Collision
        In order of time.
    is_truncated : bool or None
        Whether the run ended at the maximum duration, before its storyboard had ended. None if the simulator does not
        report this, and for recordings that were read from a file, since files do not contain it.
    road_file : Path or None
        OpenDRIVE file of the scenario. None for recordings that were read from a file, since files do not contain it.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.recordings import Recording
    >>> still, one = np.zeros((1, 3)), np.ones(1)
    >>> Recording(
    ...     time=np.array([0.0, 0.1, 0.2]), names=("Ego",), object_types=("car",),
    ...     x=np.array([[0.0, 1.0, 2.0]]), y=still, heading=still, speed=still + 10.0, acceleration=still,
    ...     length=4.5 * one, width=1.8 * one, center_x=1.4 * one,
    ... )
    <Recording of Ego (car), 0.2 s in 3 instants, no collision>
    """

    time: FloatArray
    names: tuple[str, ...]
    object_types: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    length: FloatArray
    width: FloatArray
    center_x: FloatArray
    collisions: tuple[Collision, ...] = ()
    is_truncated: bool | None = None
    road_file: Path | None = None

    def __repr__(self) -> str:
        entities = ", ".join(f"{name} ({kind})" for name, kind in zip(self.names, self.object_types, strict=True))
        return f"<Recording of {entities}, {self._describe_duration()}, {self._describe_collisions()}>"

    def _repr_html_(self) -> str:
        """Show entities, collisions and tracks in a notebook."""
        rows = []
        for a, name in enumerate(self.names):
            present = np.flatnonzero(np.isfinite(self.x[a]))
            when = f"{self.time[present[0]]:g} s to {self.time[present[-1]]:g} s" if len(present) else "never"
            speeds = self.speed[a, present]
            how = f"{speeds.min():.1f} to {speeds.max():.1f} m/s" if len(present) else ""
            dot = f'<span style="color:{TRACK_COLORS[a % len(TRACK_COLORS)]}">●</span>'
            rows.append(
                f"<td>{dot} {escape(name)}</td><td>{escape(self.object_types[a])}</td><td>{when}</td><td>{how}</td>"
            )
        head = "<th>entity</th><th>kind</th><th>there</th><th>speed</th>"
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        summary = escape(f"{self._describe_duration()}; {self._describe_collisions()}")
        return f"<p>{summary}</p><table><tr>{head}</tr>{body}</table>{draw_tracks(self.x, self.y)}"

    def _describe_duration(self) -> str:
        duration = float(self.time[-1] - self.time[0]) if len(self.time) else 0.0
        return f"{duration:g} s in {len(self.time)} instants"

    def _describe_collisions(self) -> str:
        return "; ".join(
            f"{' and '.join(collision.entities)} collide at {collision.time:g} s" for collision in self.collisions
        ) or ("no collision")

    def entity_index(self, name: str) -> int:
        """Return the index of an entity, its row in the arrays of the recording.

        Parameters
        ----------
        name : str
            Name of the entity.

        Returns
        -------
        int

        Raises
        ------
        InputError
            There is no such entity.
        """
        if name not in self.names:
            raise InputError(f"The recording has no entity '{name}'; {suggest_name(name, self.names)}")
        return self.names.index(name)

    def box_center(self, name: str) -> FloatArray:
        """Return the center of an entity's bounding box over time.

        Parameters
        ----------
        name : str
            Name of the entity.

        Returns
        -------
        ndarray of float64, shape (T, 2)
            x and y in m.

        Raises
        ------
        InputError
            There is no such entity.
        """
        i = self.entity_index(name)
        ahead = self.center_x[i]
        return np.stack([self.x[i] + ahead * np.cos(self.heading[i]), self.y[i] + ahead * np.sin(self.heading[i])], -1)

    def first_collision(self, name: str, other_name: str) -> Collision | None:
        """Return the first collision of two entities with each other.

        Parameters
        ----------
        name, other_name : str
            Names of the entities, in any order.

        Returns
        -------
        Collision or None
        """
        collisions = (collision for collision in self.collisions if set(collision.entities) == {name, other_name})
        return min(collisions, key=attrgetter("time"), default=None)

    def with_absent_entities(self, names: Iterable[str]) -> Recording:
        """Return the recording with additional entities that exist at no instant.

        Parameters
        ----------
        names : iterable of str
            Names of entities to add. Entities that exist in the recording are not changed.

        Returns
        -------
        Recording
            The same object if no entity is missing.
        """
        missing = tuple(dict.fromkeys(name for name in names if name not in self.names))
        if not missing:
            return self
        nowhere = np.full((len(missing), len(self.time)), np.nan)
        return replace(
            self,
            names=self.names + missing,
            object_types=self.object_types + ("misc",) * len(missing),
            **{name: np.concatenate((getattr(self, name), nowhere)) for name in MOTION_ARRAYS},
            **{name: np.concatenate((getattr(self, name), np.zeros(len(missing)))) for name in BOX_ARRAYS},
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the recording as a table.

        Returns
        -------
        pandas.DataFrame
            One row per instant and entity, with the columns of the CSV: ``time`` in s, ``entity``, ``kind``, ``x``,
            ``y``, ``heading``, ``speed``, ``acceleration``, ``length``, ``width``, ``center_x`` in m, rad, m/s and
            m/s², and ``collision``: entities that the entity begins to touch at that instant, separated by semicolons.
            Each contact is only in the row of its first entity, in the order of `names`.
        """
        import pandas

        entities, instants = len(self.names), len(self.time)
        touched = self._first_contacts()
        columns: dict[str, object] = {
            "time": np.repeat(self.time, entities),
            "entity": self.names * instants,
            "kind": self.object_types * instants,
        }
        columns |= {column: getattr(self, column).T.ravel() for column in MOTION_ARRAYS}
        columns |= {column: np.tile(getattr(self, column), instants) for column in BOX_ARRAYS}
        columns["collision"] = [";".join(touched.get((t, name), ())) for t in range(instants) for name in self.names]
        return pandas.DataFrame(columns)

    def _first_contacts(self) -> dict[tuple[int, str], list[str]]:
        """Return which entities each entity begins to touch at an instant, by index of the instant and entity name.

        Each contact is listed only for the first of its two entities.
        """
        touched: dict[tuple[int, str], list[str]] = {}
        for collision in self.collisions:
            first, second = collision.entities
            # A simulator's clock may differ from the recording's in the last digits.
            nearest = int(np.abs(self.time - collision.time).argmin())
            touched.setdefault((nearest, first), []).append(second)
        return touched

    def _csv_lines(self, contacts: Mapping[tuple[int, str], Sequence[str]]) -> Iterator[str]:
        """Yield the lines of the CSV; repeated cells are formatted only once, to save time."""
        entities = len(self.names)
        boxes = np.array([getattr(self, column) for column in BOX_ARRAYS], dtype=np.float64).T.tolist()
        begins = [
            f",{_format_csv_cells(escape_csv_cell(name), escape_csv_cell(kind))},"
            for name, kind in zip(self.names, self.object_types, strict=True)
        ]
        ends = [f",{_format_csv_cells(*box)}," for box in boxes]
        met = {
            instant * entities + row: _format_csv_cells(escape_csv_cell(";".join(contacts[instant, name])))
            for instant in sorted({index for index, _ in contacts})
            for row, name in enumerate(self.names)
            if (instant, name) in contacts
        }
        rows = zip(
            chain.from_iterable(repeat(str(time), entities) for time in self.time.tolist()),
            cycle(begins),
            *(getattr(self, column).T.ravel().astype(np.float64).tolist() for column in MOTION_ARRAYS),
            cycle(ends),
            strict=False,
        )
        for k, (time, begin, x, y, heading, speed, acceleration, end) in enumerate(rows):
            yield f"{time}{begin}{x!r},{y!r},{heading!r},{speed!r},{acceleration!r}{end}{met.get(k, '')}\n"

    def to_csv(self, path: Path | str) -> None:
        """Write one row per instant and entity, with the columns `CSV_COLUMNS` and ``collision``.

        Reading the file with `cornercase.recordings.read_recording` gives the same numbers, bit by bit. The column
        ``collision`` has the entities that an entity begins to touch at this instant, separated by semicolons; each
        contact is only in the row of the first of its two entities. A text that a spreadsheet would take for a formula
        gets an apostrophe in front, which is removed when the file is read.

        Parameters
        ----------
        path : path

        Raises
        ------
        InputError
            The file cannot be written, or the name of an entity that collides has a semicolon.
        """
        touched = self._first_contacts()
        for second in (name for names in touched.values() for name in names):
            if ";" in second:
                raise InputError(f"{path}: the name '{second}' contains a semicolon; rename the entity.")
        with atomic_write(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
            file.write(_format_csv_cells(*CSV_COLUMNS, "collision") + "\n")
            file.writelines(self._csv_lines(touched))


def _format_csv_cells(*cells: object) -> str:
    """Format cells of a CSV line, without line end."""
    line = io.StringIO()
    # Cells with a line terminator are quoted.
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue().removesuffix("\n")


def read_only(recording: Recording) -> Recording:
    """Return the recording with read-only arrays, which other code cannot change."""
    views = {name: getattr(recording, name).view() for name in ("time", *MOTION_ARRAYS, *BOX_ARRAYS)}
    for view in views.values():
        view.flags.writeable = False
    return replace(recording, **views)
