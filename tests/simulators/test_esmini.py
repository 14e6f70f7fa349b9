"""esmini as a simulator: with the real library if ``CORNERCASE_ESMINI`` is set, otherwise with a replacement."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import moving, ran, scenario_file
from cornercase._common.errors import InputError, SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import SIMULATORS, Esmini
from cornercase.simulators.pool._simulator import WorkerSimulator
from helpers.command_line import cornercase

REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"
T = Path(__file__).parents[2] / "examples" / "t_intersection" / "t_intersection.xosc"
LIBRARY = os.environ.get("CORNERCASE_ESMINI", "")
needs_library = pytest.mark.skipif(not Path(LIBRARY).is_file(), reason="CORNERCASE_ESMINI names no library")


def expected(path):
    """Rows of each entity: time, x, y, heading, speed."""
    rows: dict[str, list[list[float]]] = {}
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            values = [float(row[key] or "nan") for key in ("time", "x", "y", "heading", "speed")]
            track = rows.setdefault(row["entity"], [])
            # The step in which the storyboard stops is recorded too, with the previous time.
            if not track or values[0] > track[-1][0]:
                track.append(values)
    return {name: np.array(track) for name, track in rows.items()}


def cases():
    index = REFERENCE / "index.json"
    return json.loads(index.read_text()) if index.is_file() else []


@needs_library
@pytest.mark.skipif(not cases(), reason="the expected recordings are not beside the checkout")
def test_it_gives_the_recordings_that_are_known_to_the_last_digit():
    simulator = WorkerSimulator(
        "esmini:controllers=false", {"time_step": 0.05, "duration": 120.0, "undriven": True}, timeout=60.0
    )
    known = [(case, expected(REFERENCE / "expected" / case["expected"])) for case in cases()]
    concretes = [ConcreteScenario(REFERENCE / case["scenario"], case["parameters"]) for case, _ in known]
    found = list(simulator.run(concretes))
    simulator.close()
    wrong = []
    for (case, tracks), recording in zip(known, found, strict=True):
        if isinstance(recording, SimulationError) or not all(same(recording, *one) for one in tracks.items()):
            wrong.append(case["expected"])
    assert wrong == []
    assert len(known) >= 90


def same(recording, name, rows):
    if name not in recording.names:
        return False
    k, at = recording.names.index(name), np.round(rows[:, 0] / 0.05).astype(int)
    if at[-1] >= recording.time.size:
        return False
    got = np.stack([recording.x[k, at], recording.y[k, at], recording.heading[k, at], recording.speed[k, at]], axis=1)
    # Six digits were printed.
    digit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(rows[:, 1:]), 1e-5))) - 5)
    return bool((np.abs(got - rows[:, 1:]) <= 0.51 * digit + 1e-9).all())


@needs_library
def test_parameters_collisions_and_the_same_again():
    pedestrian = REFERENCE / "esmini" / "resources" / "xosc" / "pedestrian_collision.xosc"
    if not pedestrian.is_file():
        pytest.skip("the scenario is not beside the checkout")
    simulator = Esmini(controllers=False)
    first, again = ran(simulator, [ConcreteScenario(pedestrian, {})] * 2)
    np.testing.assert_array_equal(first.x, again.x)
    assert first.collisions == again.collisions
    assert len(first.collisions) == 1
    (stopped,) = ran(Esmini(controllers=False, on_collision="stop"), [ConcreteScenario(pedestrian, {})])
    assert stopped.time[-1] == pytest.approx(first.collisions[0].time)
    (slow,) = ran(Esmini(undriven=True), [ConcreteScenario(T, {"ego_speed": 3.0})])
    assert slow.speed[slow.names.index("Ego")].max() == pytest.approx(3.0)
    (wrong,) = Esmini(undriven=True).run([ConcreteScenario(T, {"no_such": 3.0})])
    assert str(wrong) == "esmini does not take the parameter no_such"
    # A text where a number belongs costs its scenario alone.
    nonsense, well = Esmini(undriven=True).run([ConcreteScenario(T, {"ego_speed": one}) for one in ("nonsense", 3.0)])
    assert str(nonsense) == "esmini does not take the parameter ego_speed"
    assert isinstance(well, Recording)


@needs_library
def test_explores(tmp_path):
    done = cornercase(
        "explore", T, "--range", "ego_speed=5:12", "--range", "c_speed=5:12", "--ego", "Ego", "--other", "C", "--metric",
        "ttc", "--simulator", "esmini:undriven=true", "--optimizer", "sobol", "--budget", "8", "--workers", "2",
        "-o", tmp_path / "s.db",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "8 scenarios" in done.stdout
    assert "[info]" not in done.stdout + done.stderr


# A library with one car, whose speed an action sets to 7 m/s in the 4th step if ``ACTION`` is defined. ``MORE`` makes its
# states longer, like those of another version.
STUB = r"""
#include <string.h>
#ifndef HEADING
#define HEADING 0
#endif
typedef struct { int id, model, ctrl; double t0, x, y, z, h, p, r; unsigned road, junction; double t; int lane;
  double offset, s, speed, cx, cy, cz, width, length, height; int kind, category; double wa, wr; int visible;
#ifdef MORE
  double more[4];
#endif
} State;
static int step; static double speed = 5, x, y, heading; static void (*callback)(void *); static void *user;
static struct { int id; void (*function)(State *, void *); } moved[99]; static int registered, of_run;
int SE_Init(const char *f, int a, int b, int c, int d) { step = of_run = 0; speed = 5; x = 50; y = -2; heading = HEADING;
  if (callback) callback(user); callback = 0; return strstr(f, "broken") ? -1 : 0; }
int SE_GetObjectState(int k, State *s) { memset(s, 0, sizeof *s); s->id = 7; s->x = x; s->y = y; s->h = heading; s->s = x;
  s->lane = -1; s->road = 1; s->speed = speed; s->cx = 1.4; s->width = 2; s->length = 5; s->kind = 1; s->category = 2;
  s->visible = 7; return 0; }
int SE_StepDT(double dt) { step++;
#ifdef ACTION
  if (step == 4) speed = 7;
#endif
  x += speed * dt;
#ifndef SILENT
  State state; SE_GetObjectState(7, &state);
  /* As in esmini, functions of earlier runs are called, too. */
  for (int r = 0; r < of_run; r++) for (int k = 0; k < registered; k++) moved[k].function(&state, 0);
#endif
  return 0; }
void SE_RegisterObjectCallback(int id, void (*f)(State *, void *), void *u) { moved[registered].id = id;
  moved[registered++].function = f; of_run++; }
int SE_ReportObjectSpeed(int k, double v) { speed = v; return 0; }
int SE_ReportObjectPosXYH(int k, double at_x, double at_y, double h) { x = at_x; y = at_y; heading = h;
  return 0; }
int SE_ReportObjectRoadPos(int k, unsigned r, int l, double offset, double at) { x = at; return 0; }
const char *SE_GetRoadIdString(unsigned r) { return "1"; }
unsigned SE_GetRoadIdFromString(const char *r) { return 1; }
int SE_GetNumberOfRoutePoints(int k) { return 0; }
int SE_GetRoutePoint(int k, unsigned i, void *p) { return -1; }
void SE_Close(void) {}
int SE_GetQuitFlag(void) { return step > 10; }
int SE_GetNumberOfObjects(void) { return 1; }
int SE_GetId(int k) { return 7; }
const char *SE_GetObjectName(int k) { return "Ego"; }
int SE_GetObjectNumberOfCollisions(int k) { return 0; }
int SE_GetObjectCollision(int k, int i) { return -1; }
void SE_SetSeed(unsigned s) {}
void SE_CollisionDetection(_Bool on) {}
int SE_SetOptionPersistent(const char *o) { return 0; }
void SE_RegisterParameterDeclarationCallback(void (*f)(void *), void *u) { callback = f; user = u; }
int SE_SetParameterDouble(const char *n, double v) { if (strcmp(n, "ego_speed")) return -1; speed = v; return 0; }
#ifndef LESS
int SE_SetParameterString(const char *n, const char *v) { return -1; }
int SE_SetParameterInt(const char *n, int v) { return -1; }
int SE_SetParameterBool(const char *n, _Bool v) { return -1; }
#endif
#ifdef TAGGED
const char *ESMINI_GIT_TAG = "v3.6.0", *ESMINI_GIT_REV = "v3.6.0-0-abcdef", *ESMINI_BUILD_VERSION = "N/A - client build";
#endif
"""


@pytest.fixture(scope="module")
def stub(tmp_path_factory):
    """Builds a replacement for the library, with compiler definitions."""
    folder = tmp_path_factory.mktemp("stub")
    (folder / "stub.c").write_text(STUB)

    def build(*defined):
        path = folder / ("_".join(["lib", *defined]) + ".so")
        path = path.with_name(path.name.replace("=", "_"))
        command = ["cc", "-shared", "-fPIC", *(f"-D{one}" for one in defined), folder / "stub.c", "-o", path]
        try:
            subprocess.run(command, check=True, capture_output=True)
        except FileNotFoundError:
            pytest.skip("there is no C compiler")
        return str(path)

    return build


def test_the_interface_against_a_stand_in(stub):
    simulator = Esmini(library=stub("HEADING=0.1"), undriven=True)
    fast, usual = ran(simulator, [ConcreteScenario(T, {"ego_speed": 8.0}), ConcreteScenario(T, {})])
    assert fast.names == ("Ego",)
    assert fast.object_types == ("truck",)
    np.testing.assert_allclose(fast.time, np.arange(11) * 0.05)
    np.testing.assert_allclose(fast.x[0], 50.0 + 8.0 * 0.05 * np.arange(11))
    np.testing.assert_allclose(usual.speed[0], 5.0)
    assert (fast.length[0], fast.width[0], fast.center_x[0]) == (5.0, 2.0, 1.4)


def test_the_version_is_what_the_library_says_of_itself(stub):
    found = Esmini(library=stub("TAGGED")).component_versions()
    assert (found["esmini"], found["esmini's revision"], found["esmini's build"]) == ("v3.6.0", "v3.6.0-0-abcdef", "")
    # One that says nothing, as those that users build themselves, can still be told apart.
    silent = Esmini(library=stub("HEADING=0.1")).component_versions()
    assert silent["esmini"] == ""
    assert silent["esmini's library"].startswith("SHA-256 ")
    assert silent["esmini's library"] != found["esmini's library"]


class Slowing(cc.SystemUnderTest):
    """Brakes at 1 m/s², and writes down the target speeds."""

    def __init__(self, steers: bool = False) -> None:
        self.steers = steers

    def step(self, view, dt):
        TARGETS.append(view.target_speed)
        return cc.Control(acceleration=-1.0, steering=0.1) if self.steers else -1.0


TARGETS: list[float] = []


def of_ego(driver: Any) -> Any:
    return {"Ego": driver}


def test_a_driver_against_a_stand_in(stub, tmp_path):
    concrete = ConcreteScenario(scenario_file(tmp_path, init=moving(speed="5")), {})
    simulator = Esmini(library=stub("ACTION"), drivers=of_ego(Slowing()))
    TARGETS.clear()
    first, again = ran(simulator, [concrete] * 2)
    speeds = 5.0 - 0.05 * np.arange(11)
    for recording in (first, again):
        np.testing.assert_allclose(recording.speed[0], speeds, atol=1e-12)
        # Each step is made with the speed at its end.
        np.testing.assert_allclose(recording.x[0], 50.0 + 0.05 * np.cumsum([0.0, *speeds[1:]]), atol=1e-9)
    np.testing.assert_array_equal(TARGETS[:11], [5.0] * 4 + [7.0] * 7)
    (steered,) = ran(Esmini(library=stub("ACTION"), drivers=of_ego(Slowing(steers=True))), [concrete])
    assert steered.y[0, -1] > -1.95
    with pytest.raises(InputError, match="does not say when it has moved 'Ego'"):
        list(Esmini(library=stub("SILENT"), drivers=of_ego(Slowing())).run([concrete]))


def test_another_layout_and_missing_functions_are_refused(stub, tmp_path):
    with pytest.raises(InputError, match=r"another layout than esmini 3\.6"):
        list(Esmini(library=stub("MORE"), undriven=True).run([ConcreteScenario(T, {})]))
    with pytest.raises(InputError, match="has no function SE_SetParameterString"):
        list(Esmini(library=stub("LESS"), undriven=True).run([ConcreteScenario(T, {})]))
    (tmp_path / "no.so").write_text("no library")
    with pytest.raises(InputError, match=r"no\.so: cannot be loaded"):
        list(Esmini(library=str(tmp_path / "no.so"), undriven=True).run([ConcreteScenario(T, {})]))
    broken = tmp_path / "broken.xosc"
    broken.write_text(T.read_text())
    (failed,) = Esmini(library=stub(), undriven=True).run([ConcreteScenario(broken, {})])
    assert "esmini cannot load the scenario" in str(failed)


def test_refuses_in_one_sentence(monkeypatch, tmp_path):
    monkeypatch.delenv("CORNERCASE_ESMINI", raising=False)
    with pytest.raises(InputError, match=r"esmini's library is not found; download esmini"):
        _ = SIMULATORS.create("esmini").settings
    with pytest.raises(InputError, match="no such file"):
        list(Esmini(library=str(tmp_path / "none.so")).run([]))
    with pytest.raises(InputError, match="no driver 'normall'"):
        Esmini(drivers={"Ego": "normall"})
    assert "download esmini" in Esmini.availability().problem
    done = subprocess.run(
        [sys.executable, "-c", "from cornercase.cli import main; main()", "simulators"],
        capture_output=True, text=True, env={**os.environ, "CORNERCASE_ESMINI": ""}, check=True,
    )  # fmt: skip
    assert "esmini" in done.stdout
