"""Where the paths of two entities cross, and when each is there; fast enough for every pair in a study.

`cornercase.metrics` finds the same exactly: it uses the whole area that a box sweeps between two instants, since
post-encroachment time is a score that is compared with thresholds. Here boxes are sampled along the paths and only the
instant of contact is refined, since the question is who is first and by about how much. In 200 recordings of the
X-intersection the times differed by less than 2 ms, at a fifth of the time. Paths are also extrapolated after the end
of a recording, which no score may do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.geometry.aabb_tree import build_aabb_tree
from cornercase._common.geometry.overlap_runs import OverlapRuns
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics.ending._path_overlap import contact_fraction, find_overlap_runs
from cornercase.recordings import Recording

# Length of the straight extrapolation in m: a waiting car may stand this far before the crossing.
_EXTRAPOLATED_LENGTH: Final = 20.0
# Largest distance of boxes along a path as a share of their smaller side, so that none slips through between two, and
# largest number of parts of a time step.
_BOX_SPACING: Final = 0.5
_MAX_SUBSTEPS: Final = 50
# Largest change of a pose between two instants of a standing entity.
_STANDING_TOLERANCE: Final = 1e-9


@dataclass(frozen=True, eq=False)
class BoxPath:
    """Boxes of an entity along its path.

    `time` in s, shape (n,); `poses`, shape (4, n), has x and y of the centre in m, and cosine and sine of the heading;
    `size` is length and width in m. Times after `end_time` in s were extrapolated.
    """

    time: FloatArray
    poses: FloatArray
    size: FloatArray
    end_time: float

    @classmethod
    def from_recording(cls, recording: Recording, entity: str, exists: BoolArray) -> BoxPath:
        """Sample the path of an entity in a recording; `exists`, shape (T,), says when it exists."""
        i, instants = recording.entity_index(entity), np.flatnonzero(exists)
        size = np.array([recording.length[i], recording.width[i]], dtype=np.float64)
        if not len(instants):
            return cls(np.empty(0), np.empty((4, 0)), size, float(recording.time[-1]))
        heading = recording.heading[i, instants]
        poses = np.stack([*recording.box_center(entity)[instants].T, np.cos(heading), np.sin(heading)])
        time, steps = recording.time[instants], np.diff(instants) == 1
        # While it stands, the first and the last instant are enough.
        is_still = steps & (np.abs(np.diff(poses)) <= _STANDING_TOLERANCE).all(axis=0)
        is_kept = ~(np.append(False, is_still) & np.append(is_still, False))
        time, poses = time[is_kept], poses[:, is_kept]
        time, poses = _insert_boxes(time, poses, _BOX_SPACING * float(size.min()))
        return cls(time, np.ascontiguousarray(poses), size, float(recording.time[-1]))

    def extrapolate(self) -> BoxPath:
        """Extrapolate the path 20 m straight on after the end of the recording, unless the entity vanished before."""
        if not len(self.time) or self.time[-1] < self.end_time:
            return self
        count = math.ceil(_EXTRAPOLATED_LENGTH / max(_BOX_SPACING * float(self.size.min()), 0.1))
        steps = np.arange(1, count + 1) / count
        x, y, cos, sin = self.poses[:, -1, None]
        distance = _EXTRAPOLATED_LENGTH * steps
        ahead = np.stack([x + distance * cos, y + distance * sin, np.repeat(cos, count), np.repeat(sin, count)])
        return BoxPath(
            np.append(self.time, self.end_time + steps), np.hstack([self.poses, ahead]), self.size, self.end_time
        )


@dataclass(frozen=True)
class Crossing:
    """When two entities are in the overlap of both paths, in s; `leaves` is the last instant if one does not leave."""

    enters: float
    leaves: float
    other_enters: float
    other_leaves: float


def find_path_crossing(path: BoxPath, other_path: BoxPath) -> Crossing | None:
    """Return the overlap of two paths that is reached first; None if there is none."""
    if not len(path.time) or not len(other_path.time) or _bounding_boxes_are_apart(path, other_path):
        return None
    centres = build_aabb_tree(np.tile(other_path.poses[:2].T, 2))
    runs = find_overlap_runs(path.poses, path.size, other_path.poses, other_path.size, centres)
    meetings = OverlapRuns(runs, (len(path.time), len(other_path.time)))
    crossings = [
        Crossing(
            *_time_in_overlap(path, meeting.overlapping_steps(), meeting.overlaps_of_step, other_path),
            *_time_in_overlap(other_path, meeting.overlapped_steps(), meeting.steps_overlapping, path),
        )
        for meeting in meetings.connected_components()
    ]
    if not crossings:
        return None
    return min(crossings, key=lambda place: min(place.enters, place.other_enters))


def _bounding_boxes_are_apart(path: BoxPath, other_path: BoxPath) -> bool:
    reach = 0.5 * float(np.hypot(*path.size) + np.hypot(*other_path.size))
    low, high = (
        np.stack([end(box_path.poses[:2], axis=1) for box_path in (path, other_path)]) for end in (np.min, np.max)
    )
    return bool(((low[0] > high[1] + reach) | (low[1] > high[0] + reach)).any())


def _insert_boxes(time: FloatArray, poses: FloatArray, max_spacing: float) -> tuple[FloatArray, FloatArray]:
    """Insert boxes wherever two successive ones are farther apart than `max_spacing`."""
    step_lengths = np.hypot(*np.diff(poses[:2]))
    counts = np.clip(np.ceil(step_lengths / max(max_spacing, 1e-3)), 1, _MAX_SUBSTEPS).astype(np.int64)
    if (counts == 1).all():
        return time, poses
    step = np.repeat(np.arange(len(counts)), counts)
    share = (np.arange(len(step)) - np.repeat(counts.cumsum() - counts, counts)) / counts[step]
    positions, indices = np.append(step + share, float(len(counts))), np.arange(len(time), dtype=np.float64)
    x, y, cos, sin = (np.interp(positions, indices, row) for row in poses)
    norm = np.maximum(np.hypot(cos, sin), 1e-12)
    return np.interp(positions, indices, time), np.stack([x, y, cos / norm, sin / norm])


def _time_in_overlap(
    path: BoxPath, step_indices: IntArray, touched_by: Callable[[int], BoolArray], other_path: BoxPath
) -> tuple[float, float]:
    """When an entity is in an overlap: first and last contact of its boxes with boxes of the other."""

    def find_contact_time(before: int, after: int) -> float:
        share = contact_fraction(
            path.poses, path.size, before, after, other_path.poses, other_path.size, touched_by(after)
        )
        return float(path.time[before] + share * (path.time[after] - path.time[before]))

    first, last = int(step_indices[0]), int(step_indices[-1])
    enters = find_contact_time(first - 1, first) if first > 0 else float(path.time[first])
    leaves = find_contact_time(last + 1, last) if last + 1 < len(path.time) else float(path.time[last])
    return enters, leaves
