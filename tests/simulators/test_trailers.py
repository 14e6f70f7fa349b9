"""Vehicles that pull others."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import car, event, private, ran, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin, check

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
    (recording,) = ran(Builtin(duration=duration), [ConcreteScenario(path)])
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
    with pytest.raises(InputError, match="cannot pull 'Ego\\+', as 'Ego\\+' has no <TrailerCoupler>"):
        run(tmp_path, pulling(car("unnamed")))
    with pytest.raises(InputError, match="pulls 'Nobody', which does not exist"):
        run(tmp_path, with_parts(car("Ego"), f'{HITCH}<Trailer><TrailerRef entityRef="Nobody"/></Trailer>'))


@pytest.mark.parametrize("count", [20, 21])
def test_at_most_20_trailers_are_pulled(tmp_path, count):
    trailer = ""
    for _ in range(count):
        body = with_parts(car("unnamed"), f"{HITCH}{COUPLER}{trailer}")
        vehicle = body[body.index("<Vehicle") : body.rindex("</ScenarioObject>")]
        trailer = f'<Trailer><Trailer name="t">{vehicle}</Trailer></Trailer>'
    entities = with_parts(car("Ego"), HITCH + trailer)
    if count > 20:
        with pytest.raises(InputError, match="pulls more than 20 trailers"):
            run(tmp_path, entities, duration=0.1)
    else:
        assert len(run(tmp_path, entities, duration=0.1).names) == 21


CONNECT = "<PrivateAction><TrailerAction><ConnectTrailerAction {}/></TrailerAction></PrivateAction>"
DISCONNECT = "<PrivateAction><TrailerAction><DisconnectTrailerAction/></TrailerAction></PrivateAction>"


def taking_up(folder, *events, hitch=HITCH):
    """A car that is connected to a trailer 5 m behind it."""
    entities = with_parts(car("Ego"), hitch) + with_parts(car("T"), COUPLER) + with_parts(car("U"), COUPLER)
    init = (
        private("Ego", teleport("60"), speed_action("0")) + private("T", teleport("55")) + private("U", teleport("20"))
    )
    path = scenario_file(folder, init=init, story=story_of("".join(events)), entities=entities)
    (recording,) = ran(Builtin(duration=8.0), [ConcreteScenario(path)])
    return path, recording


def at(second, what):
    return event(f"at {second}", what, time_trigger(second))


def test_43_9_a_trailer_is_taken_up_and_left(tmp_path):
    _, found = taking_up(
        tmp_path,
        at("1", CONNECT.format('trailerRef="T"')),
        at("2", speed_action("10")),
        at("4", DISCONNECT),
        at("5", speed_action("0")),
    )
    standing, pulled, left = (found.time <= 1.95), (found.time > 2.05) & (found.time < 3.95), found.time > 5.5
    np.testing.assert_allclose(found.x[1][standing], 55.0)
    np.testing.assert_allclose(found.x[1][pulled], found.x[0][pulled] - 5.0)
    np.testing.assert_allclose(found.speed[1][pulled], 10.0)
    # As in esmini, it rolls on along its lane.
    assert found.speed[0][left].max() == pytest.approx(0.0)
    np.testing.assert_allclose(found.speed[1][left], 10.0)
    np.testing.assert_allclose(np.diff(found.x[1][left]), 0.5)
    np.testing.assert_allclose(found.x[2], 20.0)


def test_43_9_a_vehicle_pulls_one_trailer_at_a_time(tmp_path):
    _, found = taking_up(
        tmp_path,
        at("1", CONNECT.format('trailerRef="T"')),
        at("2", CONNECT.format('trailerRef="U"')),
        at("3", speed_action("10")),
    )
    np.testing.assert_allclose(found.x[1], 55.0)
    assert found.x[2][-1] == pytest.approx(found.x[0][-1] - 5.0)


def test_43_9_scenarios_of_one_file_pull_each_for_itself(tmp_path):
    entities = with_parts(car("Ego"), HITCH) + with_parts(car("T"), COUPLER)
    init = private("Ego", teleport("60"), speed_action("0")) + private("T", teleport("55"))
    connect = event("c", CONNECT.format('trailerRef="T"'), time_trigger("$when"))
    story = story_of(connect + at("2", speed_action("10")))
    when = '<ParameterDeclaration name="when" parameterType="double" value="1"/>'
    path = scenario_file(tmp_path, init=init, story=story, entities=entities, parameters=when)
    early, never = ran(Builtin(duration=5.0), [ConcreteScenario(path, {"when": w}) for w in (1.0, 9.0)])
    assert early.x[1][-1] == pytest.approx(early.x[0][-1] - 5.0)
    np.testing.assert_allclose(never.x[1], 55.0)


@pytest.mark.parametrize(
    ("reference", "hitch", "said"),
    [
        ('trailer="T"', HITCH, "is read as trailerRef"),
        ('trailerRef="T"', "", "cannot pull 'T', as 'Ego' has no <TrailerHitch>"),
        ('trailerRef="Ego"', HITCH, None),
        ('trailerRef="V"', HITCH, None),
    ],
)
def test_43_9_what_cannot_be_taken_up_is_said(tmp_path, reference, hitch, said):
    if said is None:
        with pytest.raises(InputError, match=r"line \d+: ('Ego' cannot pull itself|.*'V', which does not exist)"):
            taking_up(tmp_path, at("1", CONNECT.format(reference)), hitch=hitch)
        return
    path, _ = taking_up(tmp_path, at("1", CONNECT.format(reference)), hitch=hitch)
    assert any(said in str(notice) for notice in check(path).notices)


def written_as_before_1_3(folder, inside, assigned=""):
    """A car of a catalog with a trailer in a form that files had before OpenSCENARIO 1.3, and a trailer T."""

    def body(entity, name):
        return entity[entity.index("<Vehicle") : entity.index("</ScenarioObject>")].replace('"car"', f'"{name}"', 1)

    trailer = body(with_parts(car("T"), COUPLER), "trailer")
    names = "".join(
        f'<ParameterDeclaration name="{name}" parameterType="string" value=""/>' for name in ("TrailerRef", "Entry")
    )
    pulling = body(with_parts(car("Ego"), f"{HITCH}<Trailer>{inside.format(trailer)}</Trailer>"), "car")
    start = pulling.index(">") + 1
    pulling = f"{pulling[:start]}<ParameterDeclarations>{names}</ParameterDeclarations>{pulling[start:]}"
    (folder / "catalogs").mkdir()
    (folder / "catalogs" / "v.xosc").write_text(
        '<OpenSCENARIO><FileHeader revMajor="1" revMinor="1" date="2020-01-01T00:00:00" author="a" description="d"/>'
        f'<Catalog name="V">{pulling}{trailer}</Catalog></OpenSCENARIO>'
    )
    assignments = f"<ParameterAssignments>{assigned}</ParameterAssignments>" if assigned else ""
    reference = f'<CatalogReference catalogName="V" entryName="car">{assignments}</CatalogReference>'
    entities = f'<ScenarioObject name="Ego">{reference}</ScenarioObject>' + with_parts(car("T"), COUPLER)
    init = private("Ego", teleport("50"), speed_action("10")) + private("T", teleport("20"))
    path = scenario_file(folder, init=init, entities=entities)
    location = '<CatalogLocations><VehicleCatalog><Directory path="catalogs"/></VehicleCatalog></CatalogLocations>'
    path.write_text(path.read_text().replace("<CatalogLocations/>", location))
    (recording,) = ran(Builtin(duration=2.0), [ConcreteScenario(path)])
    return path, recording


BY_ENTITY = '<EntityRef entityRef="$TrailerRef"/>'
BY_CATALOG = '<CatalogReference catalogName="V" entryName="$Entry"/>'


@pytest.mark.parametrize(
    ("inside", "assigned", "pulled", "said"),
    [
        (BY_ENTITY, 'parameterRef="$TrailerRef" value="T"', "T", "<EntityRef> in <Trailer>"),
        (BY_ENTITY + BY_CATALOG, 'parameterRef="TrailerRef" value="T"', "T", "<EntityRef> in <Trailer>"),
        (BY_ENTITY + BY_CATALOG, 'parameterRef="Entry" value="trailer"', "Ego+", "<CatalogReference> in <Trailer>"),
        ("{}", "", "Ego+", "<Vehicle> in <Trailer>"),
        (BY_ENTITY + BY_CATALOG, "", None, "<EntityRef> in <Trailer>"),
    ],
)
def test_43_9_trailers_in_the_forms_before_1_3_come_along(tmp_path, inside, assigned, pulled, said):
    assigned = assigned and f"<ParameterAssignment {assigned}/>"
    path, found = written_as_before_1_3(tmp_path, inside, assigned)
    assert found.names == (("Ego", "T", "Ego+") if pulled == "Ego+" else ("Ego", "T"))
    if pulled is not None:
        np.testing.assert_allclose(found.x[found.names.index(pulled)], found.x[0] - 5.0)
    if pulled != "T":
        np.testing.assert_allclose(found.x[1], 20.0)
    notices = [notice for notice in check(path).notices if said in str(notice)]
    assert [str(notice.label) for notice in notices] == ["adapted"]


def test_43_9_a_trailer_that_overlaps_its_vehicle_does_not_collide_with_it(tmp_path):
    # The boxes overlap by 2 m, as those of a semitrailer and its truck; the car behind is run into.
    near = pulling(with_parts(car("unnamed"), '<TrailerCoupler dx="1"/>'))
    init = private("Ego", teleport("50"), speed_action("10")) + private("B", teleport("70"))
    recording = run(tmp_path, near + car("B"), init=init)
    assert recording.names == ("Ego", "B", "Ego+")
    assert [set(one.entities) for one in recording.collisions] == [{"Ego", "B"}, {"B", "Ego+"}]
