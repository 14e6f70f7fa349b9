"""What lies in the current folder is data: no module of it is run, and no library takes its settings from there."""

from __future__ import annotations

import importlib
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import matplotlib as mpl
import pytest
from numba.core import config

import cornercase as cc
from conftest import at_night
from cornercase._common import platform
from cornercase._common.current_folder import import_from_current_folder
from cornercase.cli import warm_up
from helpers.command_line import SPACE, X, cornercase
from helpers.hostile_folder import HostileFolder
from helpers.untrusted_files import set_meta

GIVEN = (X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol")
EXPLORE = ("explore", *GIVEN, "--budget", "4", "--batch", "4", "--duration", "3", "-o", "new.db")
MINE = ("--driver", "Ego=mine:Calm")

COMMANDS: dict[str, tuple[object, ...]] = {
    "explore": EXPLORE,
    "explore with workers and a driver": (*EXPLORE, "--workers", "2", *MINE),
    "explore with time-outs": (*EXPLORE, "--timeout", "60"),
    "explore without rounds": (*EXPLORE, "--workers", "2", "--asynchronous"),
    "explore on a cluster": (*EXPLORE, "--cluster", "local", "--workers", "2"),
    "explore on a cluster with a driver": (*EXPLORE, "--cluster", "local", *MINE),
    "explore with a driver": (*EXPLORE, *MINE),
    "explore with SUMO": (*EXPLORE, "--simulator", "sumo"),
    "explore with Optuna": (*EXPLORE, "--optimizer", "optuna"),
    "explore with references": (*EXPLORE, "--critical-if", "collision and not reference:cautious", "--workers", "2"),
    "demo": ("demo", "x-intersection", "--budget", "20", "-o", "demo"),
    "paper": ("paper", "scenario-1", "--budget", "20", "-o", "demo"),
    "check": ("check", X),
    "vary": ("vary", X, "--all", "-o", "new/varied.xosc"),
    "convert": ("convert", X, "--ego", "Ego", "-o", "new.xosc"),
    "simulate": ("simulate", X, *MINE, "--duration", "3", "-o", "new.csv"),
    "simulate with SUMO": ("simulate", X, "--simulator", "sumo", "--duration", "3", "-o", "new.csv"),
    "simulate on a cluster": ("simulate", X, "--parameters", "values.csv", "--cluster", "local", "--duration", "3", "-o", "many"),
    "measure": ("measure", "run.csv", "--ego", "Ego", "--other", "Pedestrian", "--metric", "ttc",
                "--metric", "stl:always(clearance > 0.5)", "-o", "courses.csv"),
    "import": ("import", "runs", "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "-o", "new.db"),
    "metrics": ("metrics",),
    "simulators": ("simulators",),
    "analyze": ("analyze", "study.db"),
    "analyze on a cluster": ("analyze", "study.db", "--cluster", "local"),
    "analyze settings": ("analyze", "study.db", "--explore-settings", "new.html"),
    "reduce": ("reduce", "study.db", "--scenario", X, "--size", "2", "-o", "new"),
    "reduce by mutants": ("reduce", "study.db", "--scenario", X, "--size", "2", "--kill-mutants", "2", "-o", "new"),
    "report": ("report", "study.db", "--figures", "-o", "new.html"),
    "replay as a film": ("replay", "study.db", "1", "-o", "new.gif"),
    "replay as a page": ("replay", "study.db", "1", "-o", "new.html"),
    "show": ("show", "study.db"),
    "export": ("export", "study.db", "--parquet", "-o", "tables"),
    "test": ("test", "suite", "--ego", "Ego", "--other", "Pedestrian", "--duration", "3", "--workers", "2", "-o", "new.db"),
    "test with a driver": ("test", "suite", "--ego", "Ego", "--other", "Pedestrian", "--duration", "3", *MINE, "--timeout", "60", "-o", "new.db"),
    "test on a cluster": ("test", "suite", "--ego", "Ego", "--other", "Pedestrian", "--duration", "3", "--cluster", "local", *MINE, "-o", "new.db"),
    "estimate": ("estimate", "study.db", "--scenario", X, "--budget", "100", "--workers", "2", "-o", "new.db"),
    "compare": ("compare", "study.db", "study.db"),
    "verify": ("verify", "study.db"),
    "warm-up": ("warm-up",),
    "repair": ("verify", "damaged.db", "--repair", "--scenario", X, "--workers", "2"),
}  # fmt: skip
BY_DAY = ("explore with workers and a driver", "report")
# So few scenarios may not answer the question.
ANSWERS = {"compare": (0, 1, 2)}


@pytest.fixture(scope="module")
def hostile(tmp_path_factory) -> HostileFolder:
    """A hostile folder that holds what the commands take, too."""
    made = HostileFolder(tmp_path_factory.mktemp("place"))
    folder = made.folder
    cc.explore(X, folder / "study.db", space=SPACE, ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol",
               budget=4, batch=4, duration=3.0)  # fmt: skip
    damage(folder / "study.db", folder / "damaged.db")
    (folder / "suite").mkdir()
    for file in (X, X.with_suffix(".xodr")):
        shutil.copy(file, folder / "suite")
    (folder / "values.csv").write_text("ego_start\n20\n40\n")
    for name, more in (("run.csv", ()), ("runs", ("--parameters", folder / "values.csv"))):
        assert cornercase("simulate", X, *more, "--duration", "3", "-o", folder / name).returncode == 0
    return made


def damage(study: Path, damaged: Path) -> None:
    shutil.copy(study, damaged)
    with closing(sqlite3.connect(damaged)) as changed, changed:
        changed.execute("UPDATE courses SET score = score + 1 WHERE scenario = 2")


@pytest.fixture
def clean(hostile):
    """The hostile folder without what commands have left."""
    for name in ("new.db", "new.csv", "new.xosc", "new.html", "new.gif", "courses.csv"):
        (hostile.folder / name).unlink(missing_ok=True)
    for name in ("new", "tables", "demo", "many"):
        shutil.rmtree(hostile.folder / name, ignore_errors=True)
    hostile.forget()
    return hostile


@pytest.mark.parametrize("name", at_night(COMMANDS, COMMANDS.keys() - BY_DAY))
def test_42_s1_s2_nothing_of_a_strangers_folder_is_run_or_read(clean, name):
    with clean.opened() as opened:
        done = clean.cornercase(*COMMANDS[name])
    assert done.returncode in ANSWERS.get(name, (0,)), done.stderr
    assert (clean.run(), opened) == ([], set())


@pytest.mark.slow
def test_42_s1_s2_a_page_that_is_served_takes_nothing_from_the_folder(clean):
    command = [*clean.command, "watch", "study.db", "--no-browser"]
    with clean.opened() as opened:
        server = subprocess.Popen(command, cwd=clean.folder, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            address = next(found for line in server.stdout if (found := re.search(r"http://\S+", line)))
            with urlopen(address.group(), timeout=60) as answer:
                assert b"</html>" in answer.read()
        finally:
            server.terminate()
            server.communicate()
    assert (clean.run(), opened) == ([], set())


@pytest.mark.slow
def test_42_s1_repair_imports_nothing_that_a_study_names(clean):
    study = clean.folder / "naming.db"
    for given in ({"settings": {"drivers": {"Ego": "evil_entry:Evil"}}}, {"simulator": "evil"}, {"metrics": ["evil"]}):
        shutil.copy(clean.folder / "study.db", study)
        set_meta(study, **given)
        damage(study, clean.folder / "naming-damaged.db")
        done = clean.cornercase("verify", "naming-damaged.db", "--repair", "--scenario", X, "--workers", "2")
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
        assert clean.run() == []


def test_42_s1_the_command_by_its_module_takes_nothing_from_the_folder(tmp_path):
    """But what Python itself needs to find it; with -P, nothing at all."""
    loaded = subprocess.run(
        [sys.executable, "-c", "import runpy, sys; print(*sys.modules)"], capture_output=True, text=True, check=True
    )
    made = HostileFolder(tmp_path, but={"cornercase", *loaded.stdout.split()})
    with made.opened() as opened:
        done = made.python("-m", "cornercase", "metrics")
    assert done.returncode == 0, done.stderr
    assert (made.run(), opened) == ([], set())


def test_42_s1_with_a_safe_path_the_command_by_its_module_takes_nothing_from_the_folder(clean):
    with clean.opened() as opened:
        done = clean.python("-P", "-m", "cornercase", "metrics")
    assert done.returncode == 0, done.stderr
    assert (clean.run(), opened) == ([], set())


# A notebook, or Python at a prompt, has the current folder on its path. By the second search all of it is loaded, so
# that what is run then is run by the workers.
_NOTEBOOK = """
import os, sys
del sys.path[0]
from pathlib import Path
import cornercase as cc

if __name__ == "__main__":
    x, space, notes = sys.argv[1:]
    given = dict(space=space, ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol", duration=3.0)
    cc.explore(x, "new.db", budget=2, batch=2, workers=2, **given)
    for budget, path in ((4, ["", *sys.path]), (6, [os.getcwd(), *sys.path])):
        sys.path = path
        for note in Path(notes).iterdir():
            note.unlink()
        cc.explore(x, "new.db", budget=budget, batch=2, workers=2, **given)
        assert sys.path is path
        print(sorted(one.name for one in Path(notes).iterdir()))
"""


@pytest.mark.slow
def test_42_s1_children_of_a_notebook_take_nothing_from_the_folder(clean):
    done = clean.python("-c", _NOTEBOOK, X, SPACE, clean.notes)
    assert (done.returncode, done.stdout) == (0, "[]\n[]\n"), done.stderr


# What a script needs is loaded again by its children, from its own folder.
_SCRIPT = """
import sys
import cornercase as cc
from beside import Calm

if __name__ == "__main__":
    x, space = sys.argv[1:]
    cc.explore(x, "new.db", space=space, ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol", budget=2,
               duration=3.0, workers=2, drivers={"Ego": Calm()})
    print("done")
"""


@pytest.mark.slow
def test_a_script_finds_what_lies_beside_it_in_its_children_too(hostile, tmp_path):
    (tmp_path / "script.py").write_text(_SCRIPT)
    shutil.copy(hostile.folder / "mine.py", tmp_path / "beside.py")
    command = [sys.executable, "script.py", str(X), str(SPACE)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


def test_42_s1_a_driver_hides_no_module(clean):
    """Its folder comes last, also where it stands on the path for another reason."""
    done = clean.cornercase("simulate", X, "--driver", "Ego=pandas:Calm", "--duration", "1", "-o", "new.csv")
    assert (done.returncode, clean.run()) == (2, [])
    assert "'pandas' has no class 'Calm'" in done.stderr


def test_42_s1_only_what_a_driver_imports_is_found_beside_it(tmp_path, monkeypatch):
    """Other modules try many that need not be there, as on other platforms."""
    files = {
        "driver_here": "import beside_it\nfrom package_here.part import name\nimport elsewhere_it\n"
        "def later():\n    import beside_later\n", "beside_later": "",
        "beside_it": "import importlib\nimportlib.import_module('beside_that')\n",
        "beside_that": "", "tried_here": "raise AssertionError",
    }  # fmt: skip
    for name, code in files.items():
        (tmp_path / f"{name}.py").write_text(code)
    (tmp_path / "package_here").mkdir()
    (tmp_path / "package_here" / "part.py").write_text("from . import other\nname = other.__name__\n")
    (tmp_path / "package_here" / "other.py").touch()
    (tmp_path / "package_here" / "__init__.py").touch()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "elsewhere_it.py").write_text(
        "try:\n    import tried_here\nexcept ImportError:\n    pass\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "elsewhere")
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    import_from_current_folder("driver_here")
    assert {"driver_here", "beside_it", "beside_that", "package_here.other"} <= sys.modules.keys()
    assert str(tmp_path) not in sys.path
    # A driver may import as it drives.
    sys.modules["driver_here"].later()
    assert "beside_later" in sys.modules
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("tried_here")


def test_42_s1_what_compiles_beside_a_demo_takes_nothing_from_the_folder(clean, monkeypatch):
    """It is started only where something is to be compiled."""
    started: list[Any] = []
    popen = subprocess.Popen

    def starting(command: list[str], **given: Any) -> Any:
        # To the end, which it else reaches at that of its input.
        started.append(popen(command, **given, cwd=clean.folder))
        return started[-1]

    monkeypatch.setattr(platform, "count_available_cpus", lambda: 2)
    monkeypatch.setattr("subprocess.Popen", starting)
    starts: list[Any] = []
    monkeypatch.setattr("cornercase._common.numba.kernel._COMPILATION_LISTENER.start_callbacks", starts)
    with warm_up.compile_in_parallel("import cornercase.clustering, cornercase.dtw; print('done')"):
        starts[0]()
        (one,) = started
        one.stdin.close()
        assert one.wait(120) == 0
        one.stdin = None
        starts.clear()
    assert clean.run() == []


def test_42_s2_numba_takes_no_settings_as_it_compiles(clean, monkeypatch):
    """It looks for them again whenever it does."""
    monkeypatch.chdir(clean.folder)
    with clean.opened() as opened:
        config.reload_config()
    assert opened == set()
    # Also where it was loaded first.
    (clean.folder / ".numba_config.yaml").rename(clean.folder / "kept")
    try:
        code = (
            "from numba.core import config; import cornercase, os; os.rename('kept', '.numba_config.yaml');"
            " config.reload_config(); os.rename('.numba_config.yaml', 'kept')"
        )
        done = clean.python("-P", "-c", code)
        assert done.returncode == 0, done.stderr
    finally:
        os.replace(clean.folder / "kept", clean.folder / ".numba_config.yaml")


# What somebody may have set for figures, in a file of settings or in a program.
_LOOKS: Any = {
    "font.size": 21.0, "font.family": ["serif"], "axes.facecolor": "red", "lines.linewidth": 7.0, "savefig.dpi": 30.0,
    "figure.dpi": 41.0, "axes.grid": True, "image.cmap": "gray", "svg.fonttype": "none", "text.antialiased": False,
    "savefig.transparent": True, "path.simplify": False, "axes.spines.top": False, "legend.fontsize": 3.0,
}  # fmt: skip


def test_42_s2_figures_and_films_are_the_same_whatever_is_set_for_others(hostile, tmp_path):
    study, drawn = hostile.folder / "study.db", []
    for name, looks in (("plain", {}), ("other", _LOOKS)):
        with mpl.rc_context(looks):
            cc.write_report(study, tmp_path / f"{name}.html", figures=tmp_path / name)
            cc.replay(study, 1, tmp_path / f"{name}.gif", speed=8.0)
        files = {one.name: one.read_bytes() for one in (tmp_path / name).iterdir()}
        assert len(files) >= 3
        drawn.append((files, (tmp_path / f"{name}.gif").read_bytes()))
    assert drawn[0] == drawn[1]


def test_42_s1_a_program_in_the_current_folder_is_not_found_on_windows(tmp_path, monkeypatch):
    for name in ("here", "installed"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "netconvert.EXE").touch()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(platform, "_WINDOWS", True)
    monkeypatch.setenv("PATHEXT", os.pathsep.join([".COM", ".EXE"]))
    monkeypatch.setenv("PATH", os.pathsep.join(["", str(tmp_path / "installed")]))
    assert platform.find_program("netconvert") == str(tmp_path / "installed" / "netconvert.EXE")
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    assert platform.find_program("netconvert") is None
