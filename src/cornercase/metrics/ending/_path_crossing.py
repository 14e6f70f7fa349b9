"""Fast search for the crossing of two entities' paths, and for the times at which each entity is on the crossing.

The metric post-encroachment time computes these times exactly, since its scores are compared with thresholds: it uses
the whole area that a box sweeps between two instants. This module only has to find who is first and by about how much,
for every pair of entities in a study. So boxes are sampled along the paths, and only the instant of contact is refined.
In 200 recordings of the X-intersection, the times differed by less than 2 ms from the exact times, and the search was
five times as fast. Paths can also be extrapolated after the end of a recording, which the metric never does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics.ending._path_overlap import find_first_crossing, sample_path
from cornercase.metrics.ending._poses import Poses

# Length of the straight extrapolation in m: a waiting car may stand this far before the crossing.
_EXTRAPOLATED_LENGTH: Final = 20.0
# Largest distance of successive boxes along a path, as a share of their smaller side: no box slips through between.
_BOX_SPACING: Final = 0.5


@dataclass(frozen=True, eq=False)
class BoxPath:
    """Boxes of an entity at n points of its path.

    `time` in s, shape (n,). `poses`, shape (4, n), has x and y of the centre in m, and cosine and sine of the heading.
    `size` is length and width in m. Times after `end_time` in s were extrapolated.
    """

    time: FloatArray
    poses: FloatArray
    size: FloatArray
    end_time: float

    @classmethod
    def from_poses(cls, poses: Poses, entity_index: int) -> BoxPath:
        """Sample the path of an entity so densely that no other box slips through between two successive boxes."""
        i = entity_index
        time, boxes = sample_path(
            poses.time, poses.exists[i], poses.x[i], poses.y[i], poses.cos[i], poses.sin[i],
            _BOX_SPACING * float(poses.size[i].min()),
        )  # fmt: skip
        return cls(time, boxes, poses.size[i], float(poses.time[-1]))

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
    """Times in s at which an entity and another entity enter and leave the overlap of their paths.

    If an entity does not leave the overlap, its time of leaving is the last instant of its path.
    """

    enters: float
    leaves: float
    other_enters: float
    other_leaves: float


def find_path_crossing(path: BoxPath, other_path: BoxPath) -> Crossing | None:
    """Return when two entities enter and leave the first overlap of their paths; None if the paths do not overlap."""
    if not len(path.time) or not len(other_path.time):
        return None
    crosses, *times = find_first_crossing(
        path.time, path.poses, path.size, other_path.time, other_path.poses, other_path.size
    )
    return Crossing(*times) if crosses else None
