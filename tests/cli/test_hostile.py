"""Files made to do harm: one sentence each, soon, and in little memory."""

from __future__ import annotations

import json
import os
import re
import sys
from functools import partial
from importlib.util import find_spec

import pytest

from conftest import ROAD, at_night, car, scenario_file, speed_action, teleport
from cornercase.study import StudyFile
from helpers.command_line import cornercase, process_of_all

INIT = f'<Private entityRef="Ego">{teleport("10")}{speed_action("10")}</Private>'


def speed(value):
    return f'<Private entityRef="Ego">{teleport("10")}{speed_action(value)}</Private>'


def declared(value):
    return f'<ParameterDeclaration name="v" parameterType="double" value="{value}"/>'


def with_text(folder, change):
    path = scenario_file(folder, init=INIT)
    path.write_text(change(path.read_text()))
    return path


def with_road(folder, change):
    path = scenario_file(folder, init=INIT)
    (folder / "road.xodr").write_text(change(ROAD))
    return path


BOMB = "<!DOCTYPE a [<!ENTITY a0 'ha'>" + "".join(f"<!ENTITY a{i} '{10 * f'&a{i - 1};'}'>" for i in range(1, 12))

CATALOG = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<Catalog name="C"><Route name="R" closed="false">
<Waypoint routeStrategy="shortest"><Position><RoutePosition><RouteRef><CatalogReference catalogName="C" entryName="R"/>
</RouteRef><InRoutePosition><FromLaneCoordinates pathS="0" laneId="-1"/></InRoutePosition></RoutePosition></Position></Waypoint>
<Waypoint routeStrategy="shortest"><Position><LanePosition roadId="1" laneId="-1" s="5"/></Position></Waypoint>
</Route></Catalog></OpenSCENARIO>"""


def cyclic_catalog(folder):
    (folder / "catalogs").mkdir()
    (folder / "catalogs" / "c.xosc").write_text(CATALOG)
    route = """<PrivateAction><RoutingAction><AssignRouteAction><CatalogReference catalogName="C" entryName="R"/>
</AssignRouteAction></RoutingAction></PrivateAction>"""
    path = scenario_file(folder, init=f'<Private entityRef="Ego">{teleport("10")}{route}</Private>')
    path.write_text(
        path.read_text().replace(
            "<CatalogLocations/>",
            '<CatalogLocations><RouteCatalog><Directory path="catalogs"/></RouteCatalog></CatalogLocations>',
        )
    )
    return path


def ring(link):
    """Return a road whose end is its own beginning."""
    return ROAD.replace("<planView>", f"<link>{link}</link><planView>").replace(
        '<lane id="-1" type="driving">',
        '<lane id="-1" type="driving"><link><predecessor id="-1"/><successor id="-1"/></link>',
    )


HOSTILE = {
    "entity expansion": (
        lambda f: with_text(f, lambda t: BOMB + "]>" + t.replace('description="d"', 'description="&a11;"')),
        "not well-formed|document type",
    ),
    "entity expansion in a text": (
        lambda f: with_text(f, lambda t: BOMB + "]>" + t.replace("<CatalogLocations/>", "<CatalogLocations/>&a11;")),
        "not well-formed|document type",
    ),
    "external entity": (
        lambda f: with_text(
            f,
            lambda t: (
                "<!DOCTYPE a [<!ENTITY x SYSTEM 'file:///etc/hostname'>]>"
                + t.replace("<CatalogLocations/>", "<CatalogLocations/>&x;")
            ),
        ),
        "document type",
    ),
    "road by URL": (
        lambda f: with_text(f, lambda t: t.replace("road.xodr", "http://198.51.100.1/road.xodr")),
        "network address",
    ),
    "road by file URL": (
        lambda f: with_text(f, lambda t: t.replace("road.xodr", "file:///etc/hostname")),
        "network address",
    ),
    "road on another machine": (
        lambda f: with_text(f, lambda t: t.replace("road.xodr", "\\\\198.51.100.1\\road.xodr")),
        "network address",
    ),
    "10,000-deep nesting": (
        lambda f: with_text(f, lambda t: t.replace("<CatalogLocations/>", 10_000 * "<a>" + 10_000 * "</a>")),
        "not well-formed|nested",
    ),
    "1,000-deep nesting": (
        lambda f: with_text(f, lambda t: t.replace("<CatalogLocations/>", 1_000 * "<a>" + 1_000 * "</a>")),
        "not well-formed|nested",
    ),
    "code in an expression": (
        lambda f: scenario_file(f, init=speed("${__import__('os').system('touch harm')}")),
        "cannot be",
    ),
    "attributes in an expression": (
        lambda f: scenario_file(f, init=speed("${(1).__class__}"), parameters=declared("1")),
        "cannot be",
    ),
    "a power without end": (
        lambda f: scenario_file(f, init=speed("${pow(10,pow(10,pow(10,10)))}")),
        "finite|off the map|number|no value",
    ),
    "an expression nested deep": (
        lambda f: scenario_file(f, init=speed("${" + 4000 * "(" + "1" + 4000 * ")" + "}")),
        "nested|too deep",
    ),
    "a long expression": (lambda f: scenario_file(f, init=speed("${1" + 60_000 * "+1" + "}")), "characters"),
    "many minus signs": (lambda f: scenario_file(f, init=speed("${" + 5000 * "-" + "1}")), "nested|too deep"),
    "parameters in a circle": (
        lambda f: scenario_file(f, init=speed("$v"), parameters=declared("$w") + declared("$v").replace('"v"', '"w"')),
        "there is no parameter",
    ),
    "catalogs in a circle": (cyclic_catalog, "circular"),
    "a road of length 0": (lambda f: with_road(f, lambda t: t.replace('length="500"', 'length="0"')), "length"),
    "a road of negative length": (lambda f: with_road(f, lambda t: t.replace('length="500"', 'length="-5"')), "length"),
    "a road of length NaN": (lambda f: with_road(f, lambda t: t.replace('length="500"', 'length="nan"')), "finite"),
    "a road without end": (lambda f: with_road(f, lambda t: t.replace('length="500"', 'length="1e300"')), "long"),
    "a road at infinity": (lambda f: with_road(f, lambda t: t.replace('x="0"', 'x="inf"')), "finite"),
    "a width of NaN": (lambda f: with_road(f, lambda t: t.replace('a="4"', 'a="nan"')), "finite"),
    "half a million cars": (
        lambda f: scenario_file(f, init=INIT, entities="".join(car(f"c{i}") for i in range(20_000)) + car("Ego")),
        "entities",
    ),
}


LINKS = {
    "to its beginning": '<successor elementType="road" elementId="1" contactPoint="start"/>',
    "to its end": '<successor elementType="road" elementId="1" contactPoint="end"/>',
    "both ways": '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
    '<successor elementType="road" elementId="1" contactPoint="start"/>',
}


def limits():
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
    resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))


# Windows has none.
LIMITS = limits if find_spec("resource") is not None else None


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Folder of each, and how `simulate` ended on it, all in one process that may take a minute and 6 GB."""
    folders, commands = {}, []
    makers = {name: make for name, (make, _) in HOSTILE.items()}
    makers |= {name: partial(with_road, change=lambda _, link=link: ring(link)) for name, link in LINKS.items()}
    for name, make in makers.items():
        folders[name] = tmp_path_factory.mktemp("hostile")
        (folders[name] / "in").mkdir()
        output = folders[name] / "r.csv"
        commands.append(["simulate", make(folders[name] / "in"), "--duration", "2", "-o", output])
    found = dict(zip(folders, process_of_all(commands, limits=LIMITS), strict=False))
    return {name: (folder, found.get(name)) for name, folder in folders.items()}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_in_one_sentence(simulated, name):
    folder, ended = simulated[name]
    assert ended is not None, "one before it took the process with it"
    assert ended.returncode == 2, ended.stderr
    lines = ended.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("cornercase: ")
    assert any(word in lines[0] for word in HOSTILE[name][1].split("|")), lines[0]
    assert len(lines[0]) < 1500
    assert not (folder / "r.csv").exists()
    assert not list(folder.rglob("harm"))


@pytest.mark.parametrize("link", LINKS)
def test_roads_linked_in_a_circle_come_to_an_end(simulated, link):
    _, ended = simulated[link]
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("name", at_night(HOSTILE, {"half a million cars", *list(HOSTILE)[1::2], *list(HOSTILE)[2::4]}))
def test_no_other_command_takes_it_or_leaves_anything_behind(tmp_path, name):
    make, said = HOSTILE[name]
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    path = make(folder)
    entities = ("--ego", "Ego", "--other", "c1")
    checked = cornercase("check", path)
    # What a file holds is told before it turns out that it cannot be run; then the answer is "no".
    assert checked.returncode in (1, 2)
    assert "cannot be run" in checked.stdout or any(word in checked.stderr for word in said.split("|"))
    refused = [
        cornercase("convert", path, "--ego", "Ego", "-o", out / "converted.xosc"),
        cornercase(
            "explore", path, *entities, "--metric", "ttc", "--range", "v=1:2", "--budget", "1", "-o", out / "s.db"
        ),
        # Nothing of it is a recording, a table or a study.
        cornercase("measure", path, *entities, "-o", out / "courses.csv"),
        cornercase("import", folder, "--parameters", path, *entities, "--metric", "ttc", "-o", out / "s.db"),
        *(cornercase(one, path) for one in ("show", "analyze")),
        *(cornercase(one, path, "-o", out / one) for one in ("report", "export", "reduce")),
    ]
    for result in refused:
        assert result.returncode == 2
        assert len(result.stderr.strip().splitlines()) == 1
        assert result.stderr.startswith("cornercase: ")
        assert len(result.stderr) < 1500
    # Numbers may be named of what cannot be run.
    listed = cornercase("vary", path)
    assert listed.returncode == 0 or (listed.returncode, listed.stderr.count("\n")) == (2, 1)
    assert "\x1b" not in listed.stdout
    assert not out.exists()
    assert not list(tmp_path.rglob("harm"))


def driving(folder):
    """A scenario whose cars begin at places of the world, and not of a lane."""
    init = "".join(
        f'<Private entityRef="{name}"><PrivateAction><TeleportAction><Position><WorldPosition x="{x}" y="-2"/></Position>'
        f"</TeleportAction></PrivateAction>{speed_action(v)}</Private>"
        for name, x, v in (("Ego", "10", "$v"), ("B", "60", "8"))
    )
    return scenario_file(folder, init=init, parameters=declared("1"), entities=car("Ego") + car("B"))


def explored(folder, path, *options):
    return cornercase(
        "explore", path, "--ego", "Ego", "--other", "B", "--metric", "distance", "--range", "v=1:2", "--optimizer", "sobol",
        "--budget", "2", "--duration", "1", *options, "-o", folder / "s.db",
    )  # fmt: skip


def test_a_command_that_fails_because_of_what_it_reads_leaves_no_empty_study(tmp_path):
    path = driving(tmp_path)
    (tmp_path / "road.xodr").write_text(re.sub("<(left|right)>.*?</(left|right)>", "", ROAD, flags=re.DOTALL))
    refused = explored(tmp_path, path)
    assert refused.returncode == 2
    assert refused.stderr.splitlines()[-1].startswith("cornercase: ")
    assert not list(tmp_path.glob("s.db*"))
    # What is there already stays, with what was run.
    (tmp_path / "road.xodr").write_text(ROAD)
    assert explored(tmp_path, path).returncode == 0
    assert explored(tmp_path, path, "--metric", "ttc").returncode == 2
    with StudyFile.open(tmp_path / "s.db") as study:
        assert len(study.finished_rows()) == 2


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are texts elsewhere")
def test_names_that_are_no_text_are_refused_or_written_out(tmp_path):
    half = os.fsdecode(b"\xff")
    path = driving(tmp_path)
    strange = path.rename(path.with_name(f"{half}.xosc"))
    refused = explored(tmp_path, strange)
    assert refused.returncode == 2
    assert "holds half a character" in refused.stderr
    assert "please report" not in refused.stderr
    assert not list(tmp_path.glob("s.db*"))
    path = strange.rename(path)
    study = tmp_path / f"{half}.db"
    assert explored(tmp_path, path).returncode == 0
    (tmp_path / "s.db").rename(study)
    assert cornercase("analyze", study).returncode == 0
    assert cornercase("reduce", study, "--size", "2", "-o", tmp_path / "set").returncode == 0
    assert json.loads((tmp_path / "set" / "manifest.json").read_text())["study"] == "\\udcff.db"
    for command in (("show", study), ("export", study, "-o", tmp_path / "out"), ("verify", study)):
        assert cornercase(*command).returncode == 0
    assert cornercase("report", study, "-o", tmp_path / "r.html").returncode == 0
