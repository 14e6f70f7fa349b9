"""A full or broken disk at any order to the system: one sentence, nothing half written, and the same result afterwards."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
COMPILER = shutil.which("cc")
SEED = os.environ.get("CORNERCASE_TORTURE_SEED", "0")

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or COMPILER is None, reason="needs a C compiler, and a C library that others are put before"
)


def let_fail(folder: Path, *options: str) -> dict[str, Any]:
    shim = folder / "faults.so"
    subprocess.run(
        [str(COMPILER), "-shared", "-fPIC", "-O1", "-o", str(shim), str(HERE / "faults.c"), "-ldl"], check=True
    )
    (folder / "place").mkdir()
    environment = os.environ | {"LD_PRELOAD": str(shim), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(HERE / "faults.py"), str(shim), str(folder / "place"), "--seed", SEED, *options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize(
    ("commands", "sample"), [("convert", 2), pytest.param("convert,explore,reduce", 6, marks=pytest.mark.slow)]
)
def test_an_order_that_fails_is_a_sentence_and_nothing_is_lost(tmp_path, commands, sample):
    found = let_fail(tmp_path, "--commands", commands, "--sample", str(sample))
    assert not found["wrong"]
    assert sum(found["tried"].values()) == (commands.count(",") + 1) * sample
    # If none were counted, none could fail.
    assert all(count > 30 for count in found["orders"].values())


@pytest.mark.torture
@pytest.mark.parametrize("error", ["EIO", "full"])
def test_every_order_of_every_command_fails_in_turn(tmp_path, error):
    found = let_fail(tmp_path, "--errors", error)
    print(json.dumps({error: {key: found[key] for key in ("tried", "seconds")} | {"wrong": len(found["wrong"])}}))
    assert not found["wrong"]
    assert found["tried"] == found["orders"]
