"""What commands say and leave when they are asked to end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from cornercase._common.process.signals import install_signal_handlers
from helpers.command_line import SPACE, X, cornercase

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="it asks as Unix does")

# Its first argument is a signal, the second a function at whose first call the signal comes; where it begins with ~, the
# signal comes while an object is cleared up, where Python ignores exceptions; where it begins with +, while compiled code
# loads NumPy, which prints the exception and goes on with an ImportError.
PROGRAM = """
import builtins, signal, sys, time
from importlib import import_module
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from cornercase.cli import main

number, (place, name), sys.argv[1:] = int(sys.argv[1]), sys.argv[2].split(":"), sys.argv[3:]
module = import_module(place.lstrip("~+"))
was = getattr(module, name)

class ClearedUp:
    def __del__(self):
        signal.raise_signal(number)

def asked(*given, **more):
    if place.startswith("~"):
        ClearedUp()
        time.sleep(10)
    elif place.startswith("+"):
        usual = builtins.__import__
        def loaded(name, *given, **more):
            if name.startswith(("numpy._core", "numpy.core")):
                builtins.__import__ = usual
                signal.raise_signal(number)
            return usual(name, *given, **more)
        (file,) = Path(find_spec("scipy").origin).parent.glob("sparse/_sparsetools.*.so")
        spec = spec_from_file_location("_sparsetools", file)
        builtins.__import__ = loaded
        spec.loader.exec_module(module_from_spec(spec))
    else:
        signal.raise_signal(number)
    return was(*given, **more)

signal.signal(signal.SIGINT, signal.default_int_handler)
# Under nohup, tests would go on ignoring it.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
setattr(module, name, asked)
main()
"""

SUMMARIZE = "cornercase.report._summarize:summarize"
SHOW = ("show", "--all")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("interrupted") / "study.db"
    done = cornercase(
        "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer",
        "sobol", "--budget", 24, "--duration", 10, "-o", path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return path


def asked(number, place, *command, cwd):
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(int(number)), place, *map(str, command)],
        capture_output=True, text=True, cwd=cwd, timeout=120,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("number", "place", "command", "words"),
    [
        (signal.SIGINT, "cornercase.clustering._analyze:_cluster_by_aspect", ("analyze",), "Interrupted;"),
        pytest.param(
            signal.SIGTERM,
            "cornercase.report.html._templates:atomic_write",
            ("report", "-o", "page.html"),
            "by SIGTERM;",
            marks=pytest.mark.slow,
        ),
        pytest.param(signal.SIGHUP, SUMMARIZE, SHOW, "by SIGHUP;", marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, "typer.core:_main", SHOW, "by SIGTERM;", marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, f"~{SUMMARIZE}", SHOW, "Interrupted;", marks=pytest.mark.slow),
        (signal.SIGTERM, f"~{SUMMARIZE}", SHOW, "by SIGTERM;"),
        pytest.param(signal.SIGINT, f"+{SUMMARIZE}", SHOW, "Interrupted;", marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, f"+{SUMMARIZE}", SHOW, "by SIGTERM;", marks=pytest.mark.slow),
    ],
)
def test_stumble_8_an_interrupted_command_says_a_word(number, place, command, words, study, tmp_path):
    name, *options = command
    done = asked(number, place, name, study, *options, cwd=tmp_path)
    assert done.returncode == 128 + number, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert os.listdir(tmp_path) == []


def test_who_ignores_a_signal_goes_on_ignoring_it():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        install_signal_handlers()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
