"""Random scenes."""

from __future__ import annotations

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from conftest import examples
from cornercase.recordings import Recording

TIME = np.arange(0, 6, 0.25)
KINDS = ("car", "truck", "bicycle", "pedestrian", "misc")
entity = st.fixed_dictionaries(
    {
        "x": st.integers(-40, 40),
        "y": st.integers(-40, 40),
        "heading": st.integers(-30, 30).map(lambda k: k / 10 + 0.0123),
        "speed": st.sampled_from([0.0, 0.0, 1.5, 4.0, 9.0, 14.0]),
        "turn": st.sampled_from([0.0, 0.0, 0.3, -0.2]),
        "acceleration": st.sampled_from([0.0, 0.0, 1.0, -1.5]),
        "length": st.sampled_from([0.5, 1.8, 4.5, 11.0]),
        "width": st.sampled_from([0.5, 1.9, 2.5]),
        "center_x": st.sampled_from([0.0, 1.4]),
        "kind": st.sampled_from(KINDS),
    }
)
scenes = st.lists(entity, min_size=2, max_size=4).map(lambda entities: drive(entities))
quick = settings(deadline=None, max_examples=examples(60))


def drive(entities) -> Recording:
    """Entities on arcs, with an acceleration until they stand."""
    rows = []
    for e in entities:
        speed = np.maximum(e["speed"] + e["acceleration"] * TIME, 0)
        step = np.append(0.0, np.diff(TIME) * (speed[1:] + speed[:-1]) / 2)
        heading = e["heading"] + np.cumsum(e["turn"] * step / 10)
        x, y = e["x"] + np.cumsum(step * np.cos(heading)), e["y"] + np.cumsum(step * np.sin(heading))
        rows.append((x, y, heading, speed, np.where(speed > 0, e["acceleration"], 0.0)))
    x, y, heading, speed, acceleration = (np.array(column) for column in zip(*rows, strict=True))
    length, width, center_x = (np.array([float(e[k]) for e in entities]) for k in ("length", "width", "center_x"))
    return Recording(
        time=TIME,
        names=tuple(str(i) for i in range(len(rows))),
        object_types=tuple(e["kind"] for e in entities),
        x=x,
        y=y,
        heading=heading,
        speed=speed,
        acceleration=acceleration,
        length=length,
        width=width,
        center_x=center_x,
    )


def same(found, expected, tolerance=1e-7):
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)
