"""Poses of all boxes of a recording, computed once and shared by all analyses of the recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.recordings import Recording


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses and sizes of the boxes of A entities at T instants.

    `time` in s, shape (T,). `exists`, shape (A, T), says whether an entity exists at an instant. `x` and `y` of the
    centres in m, and `cos` and `sin` of the headings, have shape (A, T). `size`, shape (A, 2), is length and width in
    m.
    """

    time: FloatArray
    exists: BoolArray
    x: FloatArray
    y: FloatArray
    cos: FloatArray
    sin: FloatArray
    size: FloatArray

    @classmethod
    def from_recording(cls, recording: Recording) -> Poses:
        """Compute the poses of all entities of a recording."""
        cos, sin, ahead = np.cos(recording.heading), np.sin(recording.heading), recording.center_x[:, None]
        return cls(
            # Kernels are compiled for arrays that can be written to; those of a stored recording cannot.
            time=np.array(recording.time),
            # A sum is finite if all its terms are.
            exists=np.isfinite(recording.x + recording.y + recording.heading + recording.speed),
            x=recording.x + ahead * cos,
            y=recording.y + ahead * sin,
            cos=cos,
            sin=sin,
            size=np.array([recording.length, recording.width], dtype=np.float64).T.copy(),
        )
