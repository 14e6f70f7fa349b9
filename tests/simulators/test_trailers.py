"""Vehicles that pull others."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import car, ran, scenario_file, speed_action, teleport
from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import BuiltinSimulator

HITCH = '<TrailerHitch dx="-1"/>'
COUPLER = '<TrailerCoupler dx="4"/>'


def with_parts(entity, parts):
    return entity.replace("<Properties/>", f"{parts}<Properties/>")


def pulling(trailer):
    """A car that pulls a trailer of its own."""
    vehicle = trailer[trailer.index("<Vehicle") : trailer.index("</ScenarioObject>")]
    return with_parts(car("Ego"), f'{HITCH}<Trailer><Trailer name="t">{vehicle}</Trailer></Trailer>')


def run(folder, entities, *, init=None, duration=5.0):
    init = init or f'<Private entityRef="Ego">{teleport("50")}{speed_action("10")}</Private>'
    path = scenario_file(folder, init=init, entities=entities)
    (recording,) = ran(BuiltinSimulator(duration=duration), [ConcreteScenario(path)])
    return recording


def test_a_trailer_comes_along_straight_behind(tmp_path):
    recording = run(tmp_path, pulling(with_parts(car("unnamed"), COUPLER)))
    assert recording.names == ("Ego", "Ego+")
    np.testing.assert_allclose(recording.x[1], recording.x[0] - 5.0)
    np.testing.assert_allclose(recording.y[1], recording.y[0])
    np.testing.assert_allclose(recording.speed[1], 10.0)


def test_a_trailer_of_its_own_turns_into_line_as_on_a_rod(tmp_path):
    # Placed after its vehicle, 3 m to the left of it: a tractrix, whose distance from the line falls with exp(-s / l).
    entities = with_parts(car("Ego"), f'{HITCH}<Trailer><TrailerRef entityRef="T"/></Trailer>') + with_parts(
        car("T"), COUPLER
    )
    init = "".join(f'<Private entityRef="{name}">{place}</Private>' for name, place in (
        ("Ego", teleport("50") + speed_action("10")), ("T", teleport("46", "1")),
    ))  # fmt: skip
    recording = run(tmp_path, entities, init=init)
    assert recording.names == ("Ego", "T")
    rod = np.hypot(recording.x[1] - (recording.x[0] - 1.0), recording.y[1] - recording.y[0])
    np.testing.assert_allclose(rod, 4.0)
    beside = recording.y[1][1:] + 2.0
    assert beside[-1] == pytest.approx(0.0, abs=1e-3)
    assert (np.diff(beside) <= 1e-12).all()


def test_what_cannot_be_pulled_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot pull 'Ego\\+', as it has no <TrailerCoupler>"):
        run(tmp_path, pulling(car("unnamed")))
    with pytest.raises(InputError, match="pulls 'Nobody', which does not exist"):
        run(tmp_path, with_parts(car("Ego"), f'{HITCH}<Trailer><TrailerRef entityRef="Nobody"/></Trailer>'))
