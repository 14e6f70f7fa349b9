"""Files of each format, small, and the commands that take them."""

from __future__ import annotations

import lzma
import re
import shlex
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzz_mutations import (
    mutated_bytes,
    mutated_database,
    mutated_json,
    mutated_text,
    mutated_words,
    mutated_xml,
)

from conftest import EXAMPLES
from helpers import foreign_recordings as foreign
from helpers.untrusted_files import whole_study

DATA = Path(__file__).parents[1] / "data"
EVERYTHING = DATA / "everything"
SHORT = "--duration 1 --time-step 0.1"
SEARCH = f"--metric distance --metric ttc --optimizer sobol --budget 2 --batch 2 {SHORT} -o out/s.db"


@dataclass(frozen=True)
class Target:
    """A file that is changed, files beside it, and commands on them; a word after ``~`` is changed instead of a file."""

    name: str
    weight: float
    make: Callable[[Path], object]
    changed: str
    mutate: Callable[..., Any]
    commands: tuple[str, ...]

    def mutant(self, folder: Path, rng) -> list[str]:
        """Change the file, and give a command."""
        words = shlex.split(rng.choice(self.commands))
        if any(one.startswith("~") for one in words):
            values = iter(mutated_words([one[1:] for one in words if one.startswith("~")], rng))
            return [next(values) if one.startswith("~") else one for one in words]
        path = folder / self.changed
        if self.mutate is mutated_database:
            mutated_database(path, rng)
        else:
            path.write_bytes(self.mutate(path.read_bytes(), rng))
        return words

    def all_commands(self) -> list[list[str]]:
        return [[word.removeprefix("~") for word in shlex.split(one)] for one in self.commands]


def copies(*sources: Path):
    def make(folder: Path) -> None:
        for one in sources:
            if one.is_dir():
                shutil.copytree(one, folder / one.name)
            else:
                shutil.copy(one, folder / one.name)

    return make


def fewer(path: Path, instants: int = 8) -> None:
    """Leave out rows of a table, so that it is quick to read."""
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:instants]))


def scenario_commands(file: str, space: str, ego: str, other: str, value: str) -> tuple[str, ...]:
    return (
        *[f"check {file}"] * 8,
        *[f"simulate {file} {SHORT} -o out/r.csv"] * 6,
        f"simulate {file} --set {value} {SHORT} -o out/r.csv",
        f"convert {file} --ego {ego} -o out/c.xosc",
        f"explore {file} {space} --ego {ego} --other {other} {SEARCH}",
    )


def recording(
    name: str, write: Callable[[Path], object], ego: str, other: str
) -> tuple[Callable[[Path], object], tuple[str, ...]]:
    def make(folder: Path) -> None:
        (folder / "runs").mkdir()
        # Two at least can be compared.
        for one in (name, f"other-{name}"):
            write(folder / "runs" / one)
        (folder / "runs" / "parameters.csv").write_text(f"file,v\n{name},1\nother-{name},2\n")

    measures = f"--ego {ego} --other {other} --metric distance --metric ttc"
    return make, (
        f"measure runs/{name} {measures} -o out/courses.csv",
        f"measure runs/{name} {measures} -o out/courses.csv",
        f"measure runs/{name} --ego {ego} --other '*' --metric wttc --metric pet -o out/courses.csv",
        f"import runs {measures} -o out/s.db",
    )


def osi_field(data, rng):
    """A field of one message made extreme."""
    import struct

    from osi3.osi_groundtruth_pb2 import GroundTruth

    if rng.random() < 0.3:
        return mutated_bytes(data, rng)
    messages, place = [], 0
    while place < len(data):
        (size,) = struct.unpack_from("<L", data, place)
        messages.append(GroundTruth.FromString(data[place + 4 : place + 4 + size]))
        place += 4 + size
    fields = []

    def look(message):
        for field, value in message.ListFields():
            if field.type == field.TYPE_MESSAGE:
                for one in value if hasattr(value, "append") or hasattr(value, "add") else (value,):
                    look(one)
            else:
                fields.append((message, field))

    look(rng.choice(messages))
    for _ in range(rng.choice((1, 1, 3))):
        message, field = rng.choice(fields)
        if field.cpp_type in (field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT):
            value = rng.choice((float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0, 0.0, -1.0, 1e9))
        elif field.cpp_type == field.CPPTYPE_ENUM:
            value = rng.choice((0, 1, 2))
        else:
            value = rng.choice((0, 1, 17, 2**31 - 1, 2**32 - 1))
        try:
            setattr(message, field.name, value)
        except ValueError:
            message.ClearField(field.name)
    return b"".join(struct.pack("<L", len(one)) + one for one in (each.SerializeToString() for each in messages))


def erg_field(data, rng):
    """A quantity of one record made extreme."""
    import struct

    if rng.random() < 0.4:
        return mutated_bytes(data, rng)
    size = struct.unpack_from("<H", data, 10)[0]
    rows = (len(data) - 16) // size
    place = 16 + size * rng.randrange(rows) + rng.choice((0, 8, 16, 24, 28, 32, 40, 48, 52, 56))
    piece = rng.choice((
        struct.pack("<d", float(rng.choice(("nan", "inf", "-inf", "1e308", "-1e308", "1e9", "-1e9", "5e-324", "-0", "1e12")))),
        struct.pack("<f", float(rng.choice(("nan", "inf", "-inf", "1e30", "-1e9", "0")))),
    ))  # fmt: skip
    return data[:place] + piece + data[place + len(piece) :]


def packed(data, rng):
    """What a packed file holds changed, or the packed file."""
    if rng.random() < 0.5:
        return mutated_bytes(data, rng)
    return lzma.compress(mutated_bytes(lzma.decompress(data), rng))


TABLE = "time,entity,kind,x,y,heading,speed,acceleration,length,width,center_x\n" + "".join(
    f"{t},{name},car,{x + t * 5},0,0,5,0,4,2,1\n" for t in (0.0, 0.1, 0.2) for name, x in (("Ego", 0), ("B", 20))
)


SPACE = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<ParameterValueDistribution><ScenarioFile filepath="scenario.xosc"/><Deterministic>
<DeterministicSingleParameterDistribution parameterName="v"><DistributionRange stepWidth="0.5">
<Range lowerLimit="5" upperLimit="20"/></DistributionRange></DeterministicSingleParameterDistribution>
</Deterministic></ParameterValueDistribution></OpenSCENARIO>"""


def osi(path: Path) -> None:
    foreign.single_channel(path, foreign.osi_messages("GroundTruth", foreign.TIMES[:4]))


def short_esmini(path: Path) -> None:
    foreign.esmini(path)
    fewer(path, 9)


RECORDINGS = {
    "table": ("r.csv", lambda path: path.write_text(TABLE), "Ego", "B", mutated_text, 8),
    "esmini": ("r.csv", short_esmini, "Ego", "Other", mutated_text, 5),
    "erg": ("r.erg", foreign.erg, "Ego", "T00", erg_field, 6),
    "carla": ("r.log", foreign.carla, "hero", "walker.pedestrian.0001", mutated_bytes, 6),
    "fcd": ("r.xml", foreign.fcd, "Ego", "P", mutated_xml, 5),
    "osi": ("r.osi", osi, "4", "17", osi_field, 6),
    "osi-packed": ("r.osi.xz", osi, "4", "17", packed, 2),
    "mcap": ("r.mcap", lambda path: foreign.multi_channel(path, "GroundTruth"), "4", "17", mutated_bytes, 3),
    "commonroad": ("r.xml", foreign.commonroad, "42", "43", mutated_xml, 3),
}


def recording_targets():
    for name, (file, write, ego, other, mutate, weight) in RECORDINGS.items():
        make, commands = recording(file, write, ego, other)
        yield Target(name, weight, make, f"runs/{file}", mutate, commands)
    make, commands = recording("r.erg", foreign.erg, "Ego", "T00")
    yield Target("erg-info", 4, make, "runs/r.erg.info", mutated_text, commands)

    def with_table(folder: Path) -> None:
        (folder / "runs").mkdir()
        for one in ("a.csv", "b.csv"):
            (folder / "runs" / one).write_text(TABLE)
        (folder / "runs" / "parameters.csv").write_text("file,v,w\na.csv,1,2.5\nb.csv,2,-1e3\n")

    command = "import runs --ego Ego --other B --metric distance -o out/s.db"
    yield Target("import-table", 4, with_table, "runs/parameters.csv", mutated_text, (command,))


def shorter(make: Callable[[Path], object], road: str) -> Callable[[Path], object]:
    """With 8 km of a motorway cut to 800 m, as what drives on it looks at all of it."""

    def made(folder: Path) -> None:
        make(folder)
        (folder / road).write_text((folder / road).read_text().replace('"8000"', '"800"'))

    return made


def scenario_targets():
    x, t, r = EXAMPLES / "x_intersection", EXAMPLES / "t_intersection", EXAMPLES / "r157"
    files = {
        "everything": ([*EVERYTHING.iterdir()], "everything.xosc", "--space deterministic.space.xosc", "Ego", "'Other cone'", "speed=9", 4),
        "x-intersection": ([*x.iterdir()], "x_intersection.xosc", "--space x_intersection.space.xosc", "Ego", "Pedestrian", "ego_start=40", 2),
        "t-intersection": ([*t.iterdir()], "t_intersection.xosc", "--space t_intersection.space.xosc", "Ego", "C", "c_start_time=1", 2),
        "cut-in": ([r / "cut_in.xosc", r / "motorway.xodr"], "cut_in.xosc", "--range gap=10:20", "Ego", "Other", "gap=11", 1.5),
    }  # fmt: skip
    roads = {
        "everything": "road.xodr",
        "x-intersection": "x_intersection.xodr",
        "t-intersection": "t_intersection.xodr",
        "cut-in": "motorway.xodr",
    }
    for name, (sources, file, space, ego, other, value, weight) in files.items():
        make = shorter(copies(*sources), roads[name])
        commands = scenario_commands(file, space, ego, other, value)
        yield Target(f"scenario-{name}", weight, make, file, mutated_xml, commands)
        yield Target(f"road-{name}", 0.6 * weight, make, roads[name], mutated_xml, commands)
        if space.startswith("--space"):
            searched = f"explore {file} {space} --ego {ego} --other {other} {SEARCH}"
            checked = f"check {file} {space}"
            yield Target(
                f"space-{name}", 0.4 * weight, make, space.split()[1], mutated_xml, (checked, checked, searched)
            )
    sources = copies(*EVERYTHING.iterdir())
    checked = "check everything.xosc --space stochastic.space.xosc"
    yield Target("space-stochastic", 0.3, sources, "stochastic.space.xosc", mutated_xml, (checked,))
    commands = ("check everything.xosc", f"simulate everything.xosc {SHORT} -o out/r.csv")
    yield Target("catalog", 3, sources, "catalogs/everything.xosc", mutated_xml, commands)


def study_targets(study: Path):
    """Of a study of 12 scenarios with its analyses, and of what was kept of it."""
    beside = [study, study.parent / "scenario.xosc", study.parent / "road.xodr"]
    quick = (
        "show s.db",
        "show s.db --json",
        "export s.db -o out/tables",
        "compare s.db second.db",
        "compare second.db s.db --json",
    )
    pages = (
        "report s.db -o out/r.html",
        "replay s.db 3 -o out/run.html",
        "analyze s.db",
        "reduce s.db -o out/kept --size 4",
    )

    def two(folder: Path) -> None:
        copies(*beside)(folder)
        shutil.copy(study, folder / "second.db")

    def small(folder: Path) -> None:
        copies(*beside[1:])(folder)
        (folder / "space.xosc").write_text(SPACE)

    searched = f"explore scenario.xosc --range v=5:20 --ego Ego --other B {SEARCH}"
    simulated = f"simulate scenario.xosc {SHORT} -o out/r.csv"
    commands = (
        *["check scenario.xosc"] * 8,
        *[simulated] * 6,
        f"{simulated} --driver Ego=normal",
        *[searched] * 2,
        "convert scenario.xosc --ego Ego -o out/c.xosc",
    )
    yield Target("scenario-small", 14, small, "scenario.xosc", mutated_xml, commands)
    yield Target("road-small", 12, small, "road.xodr", mutated_xml, commands)
    checked = "check scenario.xosc --space space.xosc"
    searched = f"explore scenario.xosc --space space.xosc --ego Ego --other B {SEARCH}"
    yield Target("space-small", 6, small, "space.xosc", mutated_xml, (checked, checked, searched))
    yield Target("study", 6, two, "s.db", mutated_database, quick)
    yield Target("study-pages", 0.3, two, "s.db", mutated_database, pages)

    again = "explore scenario.xosc --ego Ego --other B --metric distance --metric ttc --range v=5:20 --optimizer sobol"
    again += " --duration 4 --time-step 0.2"
    # An estimate takes as long as fifty of the others.
    goes_on = (
        *[
            f"{again} --budget 14 -o s.db",
            f"{again} --budget 12 --check-proposals -o s.db",
            f"{again.replace('sobol', 'level-set')} --critical 10 --budget 2 --warm-start s.db -o out/begun.db",
            "test reduced --against s.db -o out/run.db",
            "replay s.db 3 --beside 4 -o out/run.html",
            "export s.db -o out/tables",
        ]
        * 5,
        "estimate s.db --budget 100 --critical 10 -o out/estimate.db",
    )

    def with_reduced(folder: Path) -> None:
        copies(*beside, study.parent / "reduced")(folder)

    yield Target("study-goes-on", 2, with_reduced, "s.db", mutated_database, goes_on)

    def kept(folder: Path) -> None:
        shutil.copytree(study.parent / "reduced", folder / "reduced")
        (folder / "asked.toml").write_text('require = ["no collision", "ttc > 0.5 s"]\n[kind]\n"*" = ["ttc > 0.1 s"]\n')
        (folder / "asked.yaml").write_text(
            'require:\n  - no collision\n  - "ttc > 0.5 s"\nkind:\n  "*": ["ttc > 0.1 s"]\n'
        )

    run = 'test reduced --require "no collision" -o out/run.db --junit out/j.xml'
    first = min(one.name for one in (study.parent / "reduced").glob("*.xosc"))
    yield Target("manifest", 3, kept, "reduced/manifest.json", mutated_json, (run, "test reduced --json -o out/run.db"))
    yield Target("kept", 1.5, kept, f"reduced/{first}", mutated_xml, (run,))
    for ending, weight in (("toml", 1.5), ("yaml", 1.5)):
        asked = f"test reduced --requirements asked.{ending} -o out/run.db"
        yield Target(f"requirements-{ending}", weight, kept, f"asked.{ending}", mutated_text, (asked,))
    run = "test reduced -o out/run.db --require"
    required = tuple(
        f"{run} ~'{one}'" for one in (
            "no collision", "reach 30,2,1 within 5", "ttc > 1.5 s", "always[0,2](ego.speed < 30 m/s) and not (ttc < 0.1)",
            "ego.acceleration > -4 m/s²", 'for kind "*": no collision at fault',
        )
    )  # fmt: skip
    yield Target("requirement-words", 2, kept, "", mutated_bytes, required)
    named = " --ego Ego --other B"
    words = (
        f"measure r.csv{named} --metric ~ttc:accelerating=true -o out/c.csv",
        f"measure r.csv{named} --metric '~stl:always[0,1](distance > 3)' -o out/c.csv",
        "measure r.csv --ego ~Ego --other ~B --metric distance -o out/c.csv",
        f"simulate scenario.xosc --set ~v=10 {SHORT} --driver ~Ego=normal:horizon=4 -o out/r.csv",
        "simulate scenario.xosc --duration ~1 --time-step 0.1 -o out/r.csv",
        "simulate scenario.xosc --duration 1 --time-step ~0.1 -o out/r.csv",
        f"explore scenario.xosc --range ~v=5:20:5{named} {SEARCH}",
        f"explore scenario.xosc --range v=5:20{named} --critical-if '~ttc < 1 and not collision' {SEARCH}",
        f"explore scenario.xosc --range v=5:20{named} --weight ~ttc=0.5 --weight ~distance=1 {SEARCH}",
        f"explore scenario.xosc --range v=5:20 --critical 1{named} --stop-when '~overlooked(0.01)<0.05' --audit ~0.1 {SEARCH}",
        f"explore scenario.xosc --range v=5:20{named} --optimizer ~sobol --critical ~1 --metric distance --budget 2 {SHORT} -o out/s.db",
        "show ~s.db",
        "replay s.db ~3 -o out/run.html",
        "compare s.db ~s.db --metric ~ttc",
        "check ~scenario.xosc",
        "convert scenario.xosc --ego ~Ego --set ~v=10 -o out/c.xosc",
        "analyze s.db --by ~ttc --gamma ~auto --eps ~0.5 --min-samples ~3 --window ~1 --memory ~2GB",
        "reduce s.db --by ~ttc --cover ~0.5 --within ~0.5 -o out/kept --memory ~4GB",
        "reduce s.db --by distance --archetypes ~2 -o out/kept",
    )

    def given(folder: Path) -> None:
        copies(*beside)(folder)
        (folder / "r.csv").write_text(TABLE)

    yield Target("words", 8, given, "", mutated_bytes, words)


def all_targets(folder: Path) -> dict[str, Target]:
    """All of them, by name; a study is made in the folder for those that take one."""
    study = whole_study(folder)
    found = (*recording_targets(), *scenario_targets(), *study_targets(study))
    assert all(re.fullmatch(r"[a-z0-9-]+", one.name) for one in found)
    return {one.name: one for one in found}
