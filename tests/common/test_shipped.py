"""Machine code that comes with a wheel."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cornercase._common.numba.shipped import SHIP_VARIABLE, list_runnable_cpu_levels

PROGRAM = """
import json, sys
from pathlib import Path
import llvmlite
from numba.core import event
from cornercase._common.numba import shipped
from cornercase._common.numba.kernel import kernel

shipped.FOLDER = Path(sys.argv[1])
llvmlite.__version__ += sys.argv[2]

heard = []
class Listener(event.Listener):
    def on_start(self, event):
        heard.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass
event.register("numba:compile", Listener())

@kernel()
def half(x):
    return x / 2

print(json.dumps([half(5.0), heard, half._cache.has_overload(half.signatures[0], half.targetctx)]))
"""

pytestmark = pytest.mark.skipif(not list_runnable_cpu_levels(), reason="no wheel with machine code fits this processor")


def run(folder, *, program=PROGRAM, version="", ship=False, has_file=True, cache="cache"):
    """The result of a program with a kernel, what it compiled, and whether machine code is on disk afterwards.

    Without a file of its own, a program has no cache; then it finds only what is shipped.
    """
    path = folder / "program.py"
    path.write_text(program)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / cache)}
    if ship:
        level = code_folder(folder)
        level.mkdir(parents=True)
        environment |= {SHIP_VARIABLE: str(level), "NUMBA_CPU_NAME": level.name, "NUMBA_CPU_FEATURES": ""}
    source = [str(path)] if has_file else ["-c", program]
    command = [sys.executable, *source, str(folder / "package"), version]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(ran.stdout)


def code_folder(folder: Path) -> Path:
    return folder / "package" / list_runnable_cpu_levels()[-1]


@pytest.fixture
def shipped(tmp_path):
    """A folder with the machine code of the program's kernel, and nothing in the cache."""
    assert run(tmp_path, ship=True, cache="cache of the builder") == [2.5, ["half"], True]
    assert len(list(code_folder(tmp_path).iterdir())) == 1
    return tmp_path


@pytest.mark.slow
def test_what_is_shipped_is_not_compiled_again(shipped):
    assert run(shipped) == [2.5, [], True]
    assert not list(shipped.glob("cache/**/*.nb?"))


@pytest.mark.slow
def test_no_folder_has_to_be_writable(shipped):
    folder = code_folder(shipped)
    for path in (*folder.iterdir(), folder, folder.parent):
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        assert run(shipped, has_file=False) == [2.5, [], True]
    finally:
        folder.parent.chmod(0o755)
        folder.chmod(0o755)


@pytest.mark.slow
@pytest.mark.parametrize("left", [0, 40])
def test_a_file_that_was_cut_is_compiled_as_usual(shipped, left):
    (path,) = code_folder(shipped).iterdir()
    path.write_bytes(path.read_bytes()[:left])
    assert run(shipped)[:2] == [2.5, ["half"]]
    assert run(shipped)[:2] == [2.5, []]


@pytest.mark.slow
def test_machine_code_of_other_versions_sources_and_processors_is_not_used(shipped):
    assert run(shipped, version=".other", has_file=False) == [2.5, ["half"], False]
    other = PROGRAM.replace("x / 2", "x / 4")
    assert run(shipped, program=other, has_file=False) == [1.25, ["half"], False]
    code_folder(shipped).rename(shipped / "package" / "unknown")
    assert run(shipped, has_file=False) == [2.5, ["half"], False]
