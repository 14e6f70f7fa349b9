"""FMUs that drive: values in and out, faults, and that nothing depends on processes."""

from __future__ import annotations

import math
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES, at_night
from cornercase.drivers import DRIVERS, Body, DrivenPath, FmuDriver, Situation
from cornercase.drivers._resolve import create_driver_named_in_file, may_be_named_in_file
from cornercase.drivers._serialization import driver_command_option, format_driver, serialize_driver
from cornercase.drivers.fmu._input_quantities import QUANTITIES, Traffic, recognize_input, recognize_output
from cornercase.drivers.fmu._instance import Fmu, FmuError
from cornercase.drivers.fmu._instance_server import InstanceServer
from cornercase.drivers.fmu._mapping import VariableMap
from cornercase.drivers.fmu._model import read_fmu
from cornercase.drivers.fmu._processes import FmuProcesses, MessageLayouts
from cornercase.study import StudyFile
from helpers.command_line import cornercase
from helpers.fmus import PYTHON_AEB, make_fmu, make_python_fmu, make_steering_fmu, step_instance

DECELERATION = EXAMPLES / "r157" / "deceleration.xosc"
NCAP = Path(__file__).parents[3] / "shared" / "reference" / "openscenario" / "ncap" / "OpenSCENARIO" / "NCAP"
CCRS = NCAP / "CA-FC_2026" / "CCRs.xosc"
NOTICES = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
RANGES = ("--range", "ego_kmh=60:130", "--range", "gap=15:90", "--range", "deceleration=0.5:8", "--other", "Other")
CCRS_RANGES = ("--range", "Ego_speed_kph=10:80", "--range", "ImpactLocation=0:100", "--other", "Target")


def explore(
    folder: Path,
    driver: str,
    *more: object,
    budget: int = 60,
    duration: float = 12.0,
    scenario: Path = DECELERATION,
    ranges=RANGES,
):
    return cornercase(
        "-q", "explore", scenario, "--ego", "Ego", *ranges, "--metric", "ttc", "--optimizer", "sobol",
        "--budget", budget, "--duration", duration, "--driver", f"Ego={driver}", *more, cwd=folder,
    )  # fmt: skip


def recordings(study: Path) -> list[bytes]:
    """All motion in a study, as bytes."""
    with StudyFile.open(study, readonly=True) as opened:
        return [opened.recording(k).speed.tobytes() + opened.recording(k).x.tobytes() for k in opened.table().index]


def drive(driver, duration: float = 6.0, **options):
    return cc.simulate(
        DECELERATION, {"gap": 30, "deceleration": 6}, drivers={"Ego": driver}, duration=duration, **options
    )


def ego(recording, quantity: str = "acceleration"):
    return getattr(recording, quantity)[recording.entity_index("Ego")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """FMUs of both versions, and one that can be instantiated once per process."""
    folder = tmp_path_factory.mktemp("fmus")
    make_fmu(folder / "aeb2.fmu", 2)
    make_fmu(folder / "aeb3.fmu", 3)
    make_fmu(folder / "once.fmu", 2, once=True)
    return folder


class Aeb(cc.SystemUnderTest):
    """As ``tests/data/fmu/aeb.c``."""

    def __init__(self, reaction: float = 0.1):
        self.reaction, self.since, self.braking = reaction, 0.0, False

    def step(self, view, dt):
        leader = view.leader
        is_short = leader is not None and leader.closing > 0.0 and leader.gap / leader.closing < 2.0
        self.since = self.since + dt if is_short else 0.0
        self.braking = self.braking or self.since > self.reaction
        return -8.0 if self.braking else 0.0


@NOTICES
@pytest.mark.parametrize("version", [2, 3])
def test_it_drives_as_the_same_function_in_python(folder, version):
    fmu, python = drive(FmuDriver(str(folder / f"aeb{version}.fmu"), reaction=0.17)), drive(Aeb(reaction=0.17))
    assert ego(fmu).min() == pytest.approx(-8.0)
    np.testing.assert_allclose(ego(fmu, "x"), ego(python, "x"), rtol=0.0, atol=1e-9)


class Pursuit(cc.SystemUnderTest):
    """As ``tests/data/fmu/pursuit.c``."""

    def start(self, ego, road, rng):
        self.wheelbase = ego.wheelbase

    def step(self, view, dt):
        x, y, _, _ = view.path(6.0)
        return cc.Control(acceleration=0.0, steering=math.atan(2.0 * self.wheelbase * y / (x * x + y * y)))


class Cruise(cc.SystemUnderTest):
    def step(self, view, dt):
        return 0.0


@NOTICES
def test_it_steers_along_a_turn_as_the_same_function_in_python(tmp_path):
    fmu, python, along_path = (
        cc.simulate(EXAMPLES / "x_intersection" / "x_intersection.xosc", drivers={"Ego": driver}, duration=9.0)
        for driver in (f"fmu:{make_steering_fmu(tmp_path / 'pursuit.fmu')}", Pursuit(), Cruise())
    )
    # As without steering, where the ego is on its path.
    aside = np.hypot(*(ego(fmu, axis) - ego(along_path, axis) for axis in ("x", "y")))
    assert aside.max() < 2.0
    assert aside[-1] < 0.5
    assert np.ptp(np.unwrap(ego(fmu, "heading"))) > 1.0
    for quantity in ("x", "y", "heading"):
        np.testing.assert_allclose(ego(fmu, quantity), ego(python, quantity), rtol=0.0, atol=1e-9)


@NOTICES
def test_both_versions_of_the_interface_drive_alike(folder):
    one, other = (drive(f"fmu:{folder / name}:reaction=0.3") for name in ("aeb2.fmu", "aeb3.fmu"))
    assert ego(one).min() < -7.0
    assert ego(one, "x").tobytes() == ego(other, "x").tobytes()


@NOTICES
@pytest.mark.parametrize("scenario", ["example", pytest.param("ccrs", marks=pytest.mark.slow)])
def test_many_scenarios_have_the_same_bytes_with_any_workers_and_a_delay_is_found(folder, tmp_path, scenario):
    given: dict[str, Any] = {}
    if scenario == "ccrs":
        if not CCRS.exists():
            pytest.skip("Euro NCAP's files are not beside the checkout")
        given = {"scenario": CCRS, "ranges": CCRS_RANGES}
    aeb = f"fmu:{folder / 'aeb2.fmu'}"
    for name, more in {"one": [], "two": ["--workers", 2]}.items():
        ended = explore(tmp_path, aeb, *more, "-o", f"{name}.db", budget=16, duration=8.0, **given)
        assert ended.returncode == 0, ended.stderr
    one = recordings(tmp_path / "one.db")
    assert len(one) == 16
    assert recordings(tmp_path / "two.db") == one
    late = explore(tmp_path, f"{aeb}:reaction=0.4", "-o", "late.db", budget=16, duration=8.0, **given)
    assert late.returncode == 0
    told = cornercase("compare", "one.db", "late.db", cwd=tmp_path)
    assert told.stdout.startswith("Worse"), told.stdout
    assert "reaction=0.4" in told.stdout


@NOTICES
@pytest.mark.slow
@pytest.mark.parametrize("name", ["aeb3.fmu", "once.fmu"])
def test_a_cluster_gives_the_same_bytes(folder, tmp_path, name):
    pytest.importorskip("distributed")
    aeb = f"fmu:{folder / name}"
    for study, more in {"here": [], "there": ["--cluster", "local", "--workers", 2]}.items():
        ended = explore(tmp_path, aeb, *more, "-o", f"{study}.db")
        assert ended.returncode == 0, ended.stderr
    assert recordings(tmp_path / "there.db") == recordings(tmp_path / "here.db")


@NOTICES
def test_a_process_for_each_instance_if_the_fmu_wants_it(folder, tmp_path):
    """Also with more scenarios than there may be processes."""
    for name in ("aeb2", "once"):
        assert (
            explore(tmp_path, f"fmu:{folder / name}.fmu", "-o", f"{name}.db", budget=40, duration=3.0).returncode == 0
        )
    assert recordings(tmp_path / "once.db") == recordings(tmp_path / "aeb2.db")


@NOTICES
@pytest.mark.parametrize("name", ["aeb2.fmu", "once.fmu"])
@pytest.mark.parametrize("fault", at_night([0, 6], {0}))
def test_a_batch_leaves_nothing_to_the_next_one(folder, name, fault):
    """Fault 6 is an instance that remembers, after a reset, that it has braked."""
    driver = FmuDriver(str(folder / name), fault=fault)
    first, second, third = (drive(driver) for _ in range(3))
    assert ego(first)[5] == 0.0
    assert ego(first, "x").tobytes() == ego(second, "x").tobytes() == ego(third, "x").tobytes()


FAULTS = {
    1: "crashed at t = 0.95 s: its process was ended by SIGABRT; its log: about to crash 1",
    2: "hung at t = 0.95 s: a call took more than 2 s; its log: about to hang 2",
    3: r"failed at t = 0.95 s: fmi{}DoStep returned fmi{}Error; its log: lost the\x1b[31m sensor 3",
    4: "failed at t = 0.95 s: fmi{}DoStep returned fmi{}Fatal; its log: broken 4",
    5: "failed at t = 0.95 s: its output acceleration is NaN, which is not usable as acceleration",
}


@NOTICES
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("version", at_night([2, 3], {2}))
def test_a_fault_says_its_instant_and_the_log(folder, version, fault):
    driver = f"fmu:{folder}/aeb{version}.fmu:fault={fault},timeout=2"
    with pytest.raises(cc.InputError) as raised:
        drive(driver)
    assert FAULTS[fault].format(version, version) in str(raised.value)
    assert f"the driver of Ego (fmu:aeb{version}.fmu:fault={fault}" in str(raised.value)
    assert str(folder) not in str(raised.value)


def test_a_process_that_has_finished_does_not_hang_while_another_one_is_slow(folder, tmp_path):
    """Fault 7 is an instance whose steps take 0.15 s; its ten steps take longer than a call may."""
    processes = FmuProcesses(read_fmu(folder / "once.fmu").unpack(tmp_path), once_per_process=True, timeout=1.0)
    parameters: Any = [("Integer", 20, [7, 0]), ("Real", 5, [0.0])]
    try:
        processes.begin_batch(2, [], [], parameters, 0.005, 10, MessageLayouts())
        assert processes.step(np.array([True, False]), [], [[], []]) == {}
        assert processes.step(np.array([False, True]), [], [[], []]) == {}
    finally:
        processes.close()


class UnresettableFmu:
    """FMU whose instances return an error when they are reset; `freed` says of each whether it was terminated."""

    version, component = 2, 0

    def __init__(self):
        self.freed: list[bool] = []

    def instantiate(self, name):
        return self

    def bind_step(self, time, size):
        return lambda: None

    def enter_initialization(self): ...

    exit_initialization = enter_initialization

    def reset(self):
        raise FmuError("fmi2Reset returned fmi2Error")

    def free(self, *, terminate=True):
        self.freed.append(terminate)


@pytest.mark.parametrize(("reset", "failures"), [(None, {}), (True, {0: ("fmi2Reset returned fmi2Error", [], False)})])
def test_an_instance_that_cannot_be_reset_is_freed_without_another_call(tmp_path, reset, failures):
    fmu: Any = UnresettableFmu()
    server, memory = InstanceServer(fmu), tmp_path / "memory"
    memory.write_bytes(b"\0" * 16 + b"\1")
    names = ("inputs", "outputs", "parameters", "static", "message_inputs", "message_outputs")
    message = {"memory": memory, "scenarios": 1, "step": 0.05, "steps": 1, **{name: [] for name in names}}
    server.begin({**message, "reset": reset})
    assert server.step() == {}
    server.end(reset)
    server.begin({**message, "reset": reset})
    assert server.step() == failures
    assert fmu.freed == [False]


@NOTICES
@pytest.mark.parametrize("fault", [1, 3])
def test_a_fault_costs_only_the_scenarios_in_which_it_happens(folder, tmp_path, fault):
    aeb, more = f"fmu:{folder / 'aeb2.fmu'}", ("--max-failures", 0)
    assert explore(tmp_path, aeb, "-o", "good.db", budget=8, duration=1.5).returncode == 0
    ended = explore(tmp_path, f"{aeb}:fault={fault},fault_time=-1", "-o", "bad.db", *more, budget=8, duration=1.5)
    assert ended.returncode == 0, ended.stderr
    with StudyFile.open(tmp_path / "good.db") as good, StudyFile.open(tmp_path / "bad.db") as bad:
        states = dict(bad.table()["state"])
        for k, state in states.items():
            recording = good.recording(k)
            has_braked = ego(recording).min() < -7.0
            assert (state == "failed") == has_braked
            if not has_braked:
                assert ego(bad.recording(k), "x").tobytes() == ego(recording, "x").tobytes()
    assert set(states.values()) == {"done", "failed"}


@NOTICES
def test_units_and_sub_steps(tmp_path, folder):
    """Closing speed in an own unit of 1/3.6 m/s, and three steps within one."""
    make_fmu(tmp_path / "kmh.fmu", rename={"closing": "rate"}, units={"closing": "speed"}, step_size=0.01)
    (tmp_path / "aeb.toml").write_text(
        '[inputs]\nv_ego = 1\ngap = { from = "object[1].gap", none = 500 }\nrate = { from = "leader.closing", factor = 0.2777777777777778 }\n'
    )
    mapped = FmuDriver(str(tmp_path / "kmh.fmu"), map=str(tmp_path / "aeb.toml"), reaction=0.3)
    assert [(one.name, one.unit, one.source) for one in mapped.variables()[:4]] == [
        ("v_ego", "m/s", "1"),
        ("gap", "m", "object[1].gap"),
        ("rate", "speed", "0.277778 * leader.closing"),
        ("acceleration", "m/s2", "acceleration"),
    ]
    # The factor undoes the unit, so it brakes as the other does, but for the steps within a step.
    fine, plain = drive(mapped), drive(f"fmu:{folder / 'aeb2.fmu'}:step=0.01,reaction=0.3")
    assert ego(fine).min() < -7.0
    assert ego(fine, "x").tobytes() == ego(plain, "x").tobytes()


@NOTICES
def test_what_names_do_not_say_is_listed(tmp_path):
    path = make_fmu(tmp_path / "odd.fmu", rename={"gap": "foo"}, units={"v_ego": ""})
    listed = {one.name: one for one in FmuDriver(str(path), reaction=0.3).variables()}
    assert (listed["v_ego"].source, listed["v_ego"].remark) == ("ego.speed", "has no unit: taken as m/s")
    assert (listed["foo"].source, listed["foo"].remark) == ("", "keeps its start value 1000")
    assert (listed["reaction"].causality, listed["reaction"].source) == ("parameter", "0.3")
    assert (listed["threshold"].source, listed["threshold"].remark) == ("", "start value 2")
    # So it never brakes.
    assert ego(drive(f"fmu:{path}")).min() == 0.0


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[inputs", "is no TOML file"),
        ("[ins]\na = 1", "has 'ins'; a map has only the tables [inputs] and [outputs]"),
        ('[inputs]\ngaap = "leader.gap"', "the FMU has no input 'gaap'; did you mean 'gap'?"),
        ('[inputs]\ngap = "leader.gab"', "there is no quantity 'leader.gab'; did you mean 'leader.gap'?"),
        (
            '[inputs]\ngap = "path[10.5].z"',
            "there is no quantity 'path[10.5].z'; did you mean 'path[10.5].y'?",
        ),
        ('[inputs]\ngap = "ego.lateral"', "there is no quantity 'ego.lateral'; did you mean 'ego.offset'?"),
        ('[inputs]\ngap = "lane[-1].widht"', "did you mean 'lane[-1].width'?"),
        ('[inputs]\ngap = "object[0].x"', "did you mean 'object[1].x'?"),
        ('[inputs]\ngap = "path[10].curvature"', "'gap' has the unit 'm', which does not fit 1/m"),
        ('[inputs]\ngap = "leader.speed"', "input 'gap': 'gap' has the unit 'm', which does not fit m/s"),
        ('[inputs]\ngap = { from = "leader.gap", unit = "km" }', "has the unit 'km', but the FMU says 'm'"),
        ('[inputs]\ngap = { from = "leader.gap", unit = "furlong" }', "has the unknown unit 'furlong'; known are"),
        ('[inputs]\ngap = { from = "leader.gap", factor = 0 }', "`factor` is 0; give a number other than 0"),
        ('[inputs]\ngap = { from = "leader.gap", none = "far" }', "`none` is 'far'; give a number"),
        ('[inputs]\ngap = { form = "leader.gap" }', "give a name, as in"),
        ('[inputs]\ngap = { from = "leader.gap", scale = 2 }', "has the unknown key 'scale'"),
        ('[inputs]\ngap = "object.gap"', "there is no quantity 'object.gap'"),
        ('[outputs]\nspeed = "acceleration"', "there is no decision 'speed'"),
        ('[outputs]\nacceleration = "acc"', "the FMU has no output 'acc'; known are: acceleration."),
        ('[outputs]\nsteering = "acceleration"', "'acceleration' has the unit 'm/s2', which does not fit rad"),
        ("[outputs]", "none of the outputs (acceleration) is recognized as a decision"),
    ],
)
def test_a_bad_map_gives_a_sentence(folder, tmp_path, content, says):
    (tmp_path / "map.toml").write_text(content)
    with pytest.raises(cc.InputError, match=r"map\.toml: ") as raised:
        FmuDriver(str(folder / "aeb2.fmu"), map=str(tmp_path / "map.toml"))
    assert says in str(raised.value)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"units": {"gap": "kg"}}, "'gap' has the unit 'kg', which the FMU does not define by m, s and rad"),
        ({"units": {"gap": "furlong"}}, "'gap' has the unit 'furlong', which the FMU does not define by m, s and rad"),
        ({"units": {"gap": "m/s"}}, "'gap' has the unit 'm/s', which does not fit m"),
        ({"rename": {"acceleration": "torque"}}, "none of the outputs (torque) is recognized as a decision"),
        (
            {"rename": {"acceleration": "lane_change"}, "units": {"acceleration": ""}},
            "the outputs decide lane_change, but a driver must also decide the acceleration, or throttle and brake",
        ),
    ],
)
def test_an_fmu_that_does_not_say_what_it_means_gives_a_sentence(tmp_path, changes, says):
    path = make_fmu(tmp_path / "aeb.fmu", library=False, **changes)
    with pytest.raises(cc.InputError) as raised:
        FmuDriver(str(path))
    assert says in str(raised.value)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (":reactoin=1", "the FMU has no parameter 'reactoin'; did you mean 'reaction'?"),
        (":gap=1", "'gap' is not a parameter of the FMU; its causality is input"),
        (":fault=0.5", "the parameter 'fault' is a Integer, not '0.5'"),
        (":reaction=soon", "the parameter 'reaction' is a Real, not 'soon'"),
        (":reaction", "has the option 'reaction' without a name or value"),
        (":reaction=1,reaction=2", "has the option 'reaction' twice"),
        (":step=fast", "takes a number for 'step', not 'fast'"),
        (":step=0", "step"),
        (":", "names no FMU"),
        (":map=nowhere.toml", "nowhere.toml: cannot be read"),
    ],
)
def test_a_bad_option_gives_a_sentence(folder, options, says):
    with pytest.raises(cc.InputError) as raised:
        DRIVERS.create(f"fmu:{folder / 'aeb2.fmu'}{options}")
    assert says in str(raised.value)


@NOTICES
def test_files_that_are_no_such_fmu_give_a_sentence(tmp_path):
    (tmp_path / "text.fmu").write_text("no zip")
    with pytest.raises(cc.InputError, match="is not an FMU"):
        FmuDriver(str(tmp_path / "text.fmu"))
    with pytest.raises(cc.InputError, match="cannot be read"):
        FmuDriver(str(tmp_path / "nowhere.fmu"))
    with pytest.raises(cc.InputError, match=r"has no library for .*, nor for another platform"):
        drive(FmuDriver(str(make_fmu(tmp_path / "source.fmu", library=False))))
    with pytest.raises(cc.InputError, match="names no FMU; give its file"):
        DRIVERS.create("fmu")


@NOTICES
def test_the_fmus_steps_divide_the_time_step(folder, tmp_path):
    with pytest.raises(cc.InputError, match=r"the option `step`, 0\.03 s, does not divide the time step of 0\.05 s"):
        drive(f"fmu:{folder / 'aeb2.fmu'}:step=0.03")
    path = make_fmu(tmp_path / "slow.fmu", step_size=0.1)
    with pytest.raises(cc.InputError, match=r"the FMU's own step size, 0\.1 s, does not divide the time step of 0\.05"):
        drive(f"fmu:{path}")
    assert ego(drive(f"fmu:{path}", time_step=0.1)).min() < -7.0


def test_a_file_never_names_an_fmu(folder):
    for name in (
        "fmu:aeb2.fmu",
        "fmu:aeb2.fmu:reaction=0.3",
        "fmu:aeb2.fmu=1",
        f"fmu:{folder}/aeb2.fmu:fault=1",
        "fmu",
    ):
        assert not may_be_named_in_file(name)
        with pytest.raises(cc.InputError):
            create_driver_named_in_file(name)


@NOTICES
def test_a_study_says_what_drove(folder, tmp_path):
    (tmp_path / "map.toml").write_text('[inputs]\ngap = "leader.gap"\nclosing = "leader.closing"\n')
    spec = f"fmu:{folder / 'aeb2.fmu'}:map=map.toml,reaction=0.3"
    ended = explore(tmp_path, spec, "-o", "s.db", budget=2)
    assert ended.returncode == 0, ended.stderr
    with StudyFile.open(tmp_path / "s.db") as study:
        stored = study.meta.settings["drivers"]["Ego"]
    model = read_fmu(folder / "aeb2.fmu")
    assert stored["sha256"] == model.sha256
    assert (stored["model"], stored["fmi"], stored["guid"]) == ("Emergency brake", "2.0", "{aeb}")
    assert len(stored["map_sha256"]) == 64
    assert driver_command_option(stored) == spec
    assert format_driver(stored) == f"{spec}, sha256 {model.sha256[:8]}…"
    (tmp_path / "map.toml").write_text('[inputs]\ngap = "leader.gap"\n')
    again = explore(tmp_path, spec, "-o", "s.db", budget=4)
    assert again.returncode == 2
    assert "driver" in again.stderr


def test_an_object_and_a_name_are_the_same_driver(folder):
    path = str(folder / "aeb2.fmu")
    named, made = DRIVERS.create(f"fmu:{path}:reaction=0.3"), FmuDriver(path, reaction=0.3)
    assert serialize_driver(named) == serialize_driver(made)
    assert str(made.with_options(reaction=0.4)) == f"fmu:{path}:reaction=0.4"
    assert made.parameters == {"reaction": "0.1", "threshold": "2", "fault_time": "1", "fault": "0"}


@pytest.mark.parametrize(
    ("version", "name", "kind", "given"),
    [
        (3, "leader.gap", "Int8", [127, 7]),
        (3, "object[1].x", "UInt8", [255, 10]),
        (3, "leader.gap", "UInt16", [1000, 7]),
        (3, "ego.x", "UInt32", [0, 0]),
        (3, "leader.type", "Boolean", [False, True]),
        (2, "leader.gap", "Integer", [1000, 7]),
        (2, "leader.type", "Boolean", [0, 1]),
        (2, "ego.speed", "Boolean", [1, 1]),
    ],
)
def test_an_integer_stays_in_its_range_and_a_boolean_is_0_or_1(tmp_path, version, name, kind, given):
    start = f'start="{"false" if kind == "Boolean" else 0}"'
    text = (
        f'<ScalarVariable name="{name}" valueReference="0" causality="input"><{kind} {start}/></ScalarVariable>'
        '<ScalarVariable name="a" valueReference="1" causality="output"><Real/></ScalarVariable>'
        if version == 2
        else f'<{kind} name="{name}" valueReference="0" causality="input" {start}/>'
        '<Float64 name="a" valueReference="1" causality="output"/>'
    )
    head = 'fmiVersion="2.0" guid="x"' if version == 2 else 'fmiVersion="3.0" instantiationToken="x"'
    with zipfile.ZipFile(tmp_path / "numbers.fmu", "w") as archive:
        archive.writestr(
            "modelDescription.xml",
            f'<fmiModelDescription {head} modelName="x"><CoSimulation modelIdentifier="x"/>'
            f"<ModelVariables>{text}</ModelVariables><ModelStructure/></fmiModelDescription>",
        )
    # A misc object of 4 m stands ahead in the second scenario, nothing in the first.
    ahead, still = np.array([[np.nan], [10.0]]), np.array([[np.nan], [0.0]])
    own = [np.full(2, value) for value in (10.0, -10.0, 0.0, 0.0, 3.4, 0.0, 10.0)]
    along = np.array([0.0, 200.0])
    path = DrivenPath(along, along - 20.0, 0.0 * along, 0.0 * along, 0.0 * along)
    situation = Situation(
        0.0, 0.05, path, own[0], own[1], own[2], own[3], own[4], own[5], 2.0, 1.8, 0.0, own[6], ahead - 10.0, still,
        still, still, np.array([4.0]), np.array([1.8]), np.array([0.0]), ("misc",), np.ones(2, dtype=bool), ("Object",),
    )  # fmt: skip
    mapped = VariableMap(read_fmu(tmp_path / "numbers.fmu"), None)
    (table,) = mapped.fill_inputs(Traffic(situation, Body("Ego", "car", 2.0, 1.8, 0.0, 1.2, 0.6)))
    assert table[:, 0].tolist() == given


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_in_this_process(folder, tmp_path, version):
    """What other adapters build on."""
    lines: list[str] = []
    fmu = Fmu(read_fmu(folder / f"aeb{version}.fmu").unpack(tmp_path), lines.append)
    real, integer = ("Real", "Integer") if version == 2 else ("Float64", "Int32")
    instance = fmu.instantiate("aeb")
    instance.set(integer, [20], [3])
    instance.enter_initialization()
    instance.exit_initialization()
    instance.set(real, [1, 2], [10.0, 20.0])
    assert instance.get(real, [2, 1]) == [20.0, 10.0]
    assert instance.get(integer, [20]) == [3]
    for k in range(3):
        step_instance(instance, 0.05 * k, 0.05)
    assert instance.get(real, [6]) == [-8.0]
    with pytest.raises(FmuError, match=rf"fmi{version}DoStep returned fmi{version}Error"):
        step_instance(instance, 1.0, 0.05)
    assert lines[-1].endswith("sensor 3")
    instance.reset()
    assert instance.get(integer, [20]) == [0]
    instance.free()


def test_the_page_lists_what_is_known():
    page = (EXAMPLES.parent / "docs" / "fmu.md").read_text(encoding="utf-8")
    given, decided = page.split("## What it decides")[0], page.split("## What it decides")[1].split("## Units")[0]
    listed = {cell for row in given.split("| name |")[1].splitlines() for cell in re.findall(r"`([^`]+)`", row)}
    assert set(QUANTITIES) <= listed
    for row in given.splitlines():
        if row.startswith("| `") and row.count("|") == 5 and "object" not in row:
            name, *_ = re.findall(r"`([^`]+)`", row)
            aliases = re.findall(r"`([^`]+)`", row.split("|")[3])
            assert {recognize_input(alias, is_array=False) for alias in aliases} <= {name}
            none = row.split("|")[4].strip()
            if none and not none.startswith("as of"):
                assert QUANTITIES[name].none == float(none)
    for row in decided.splitlines():
        if row.startswith("| `"):
            name, *aliases = re.findall(r"`([^`]+)`", row)
            assert {recognize_output(alias) for alias in (name, *aliases)} == {name}
    assert {recognize_input(name, is_array=False) for name in ("EgoSpeed", "ego_speed", "v_ego")} == {"ego.speed"}
    assert recognize_input("target[3].x", is_array=False) == "object[3].x"
    assert recognize_input("objects_in_path", is_array=True) == "object.in_path"
    assert recognize_input("torque", is_array=False) is None
    # The nearest object has the number 1.
    assert recognize_input("objects[0].x", is_array=False) is None


@NOTICES
def test_an_fmu_made_by_pythonfmu_drives_as_the_one_in_c(folder, tmp_path):
    path = make_python_fmu(tmp_path)
    given = [drive(f"fmu:{one}:reaction=0.3") for one in (path, folder / "aeb2.fmu")]
    assert ego(given[0]).min() < -7.0
    assert math.isclose(float(np.abs(ego(given[0], "x") - ego(given[1], "x")).max()), 0.0, abs_tol=1e-9)


@NOTICES
@pytest.mark.parametrize(
    ("code", "instant"),
    [
        (PYTHON_AEB.replace("is_short = ", "is_short = time > 1.0 and 1 / 0 or "), "1.05"),
        (PYTHON_AEB + "\n    def enter_initialization_mode(self):\n        1 / 0\n", "0"),
    ],
)
def test_an_exception_in_an_fmu_made_by_pythonfmu_is_shown(tmp_path, code, instant):
    with pytest.raises(cc.InputError, match=rf"failed at t = {instant} s: .*; its log: .*division by zero"):
        drive(f"fmu:{make_python_fmu(tmp_path, code)}")


@NOTICES
def test_a_parameter_is_a_dimension_of_a_search(folder, tmp_path):
    """Scenarios with different parameters share a batch, and drive as alone."""
    ended = explore(tmp_path, f"fmu:{folder / 'aeb2.fmu'}", "--range", "Ego.reaction=0.1:0.6", "-o", "s.db", budget=4)
    assert ended.returncode == 0, ended.stderr
    with StudyFile.open(tmp_path / "s.db") as study:
        for k, row in enumerate(study.table().to_dict("records"), 1):
            aeb = FmuDriver(str(folder / "aeb2.fmu"), reaction=float(row["Ego.reaction"]))
            values = {name: float(row[name]) for name in ("ego_kmh", "gap", "deceleration")}
            alone = cc.simulate(DECELERATION, values, drivers={"Ego": aeb}, duration=12)
            assert ego(alone, "x").tobytes() == ego(study.recording(k), "x").tobytes()
