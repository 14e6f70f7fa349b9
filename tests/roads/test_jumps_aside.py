"""Roads whose pieces do not quite meet: nobody turns there, and nobody loses time."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import scenario_file, speed_action, teleport
from cornercase import simulate

LANE = (
    '<lanes><laneSection s="0"><center><lane id="0" type="none"/></center><right><lane id="-1" type="driving">'
    '<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes>'
)


def line(s, x, y, length):
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="0" length="{length}"><line/></geometry>'


def pieces(aside):
    """A road of 200 m whose pieces of 2 m lie aside of each other, by turns to both sides."""
    geometries = "".join(line(2 * k, 2 * k, aside * (k % 2), 2) for k in range(100))
    return f'<road id="1" length="200" junction="-1"><planView>{geometries}</planView>{LANE}</road>'


@pytest.mark.filterwarnings("ignore:adapted:UserWarning")
@pytest.mark.parametrize("aside", [0.0, 0.03, 0.3])
def test_43_8_a_jump_aside_neither_turns_nor_delays(tmp_path, aside):
    init = f'<Private entityRef="Ego">{teleport("5")}{speed_action("10")}</Private>'
    path = scenario_file(tmp_path, init=init)
    (tmp_path / "road.xodr").write_text(
        f'<OpenDRIVE><header revMajor="1" revMinor="6"/>{pieces(aside)}</OpenDRIVE>', encoding="utf-8"
    )
    recording = simulate(path, duration=15.0)
    assert np.abs(recording.heading[0]).max() < 0.01
    expected = 5.0 + 10.0 * recording.time
    assert np.abs(recording.x[0] - expected)[1:].max() < 0.08
    assert np.ptp(recording.y[0]) == pytest.approx(aside, abs=1e-6)
