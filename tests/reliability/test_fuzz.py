"""Mutants of files of all formats: one sentence each, soon, in little memory, and nothing left behind."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
NEEDED = ("osi3", "mcap", "commonroad", "yaml", "resource")
MISSING = [name for name in NEEDED if find_spec(name) is None]
pytestmark = [
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the memory of a process is limited as on Linux"),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]
# Those that need neither a page nor an analysis, so that little has to be imported and compiled.
QUICK = "^(table|esmini|erg|carla|fcd|osi|import-table|scenario-small|road-small|space-small|study|requirements-toml)$"


def fuzzed(tmp_path, *arguments, timeout):
    figures = tmp_path / "figures.json"
    command = [sys.executable, str(HERE / "fuzz.py"), "--json", str(figures), *map(str, arguments)]
    done = subprocess.run(command, text=True, timeout=timeout, stdout=subprocess.PIPE)
    return json.loads(figures.read_text()), done.stdout


def told(found):
    return "\n".join(f"{one['number']} {one['target']}: {one['trouble']} {one['command']}" for one in found["failed"])


@pytest.mark.slow
def test_some_mutants(tmp_path):
    count = 150
    seed = os.environ.get("CORNERCASE_TORTURE_SEED", "1")
    found, said = fuzzed(tmp_path, "--seed", seed, "--count", count, "--only", QUICK, "--cold", timeout=300)
    assert not found["failed"], f"{told(found)}\n{said}"
    assert found["mutants"] == count
    # Mutants that none of the readers takes, or all of them, would try little.
    assert min(found["exit codes"].get(code, 0) for code in ("0", "2")) > count / 15


def test_what_failed_once(tmp_path):
    found, said = fuzzed(tmp_path, "--corpus", HERE / "corpus", "--cold", timeout=300)
    assert not found["failed"], f"{told(found)}\n{said}"
    assert found["mutants"] == sum(one.is_file() for one in (HERE / "corpus").rglob("*")) > 10


def test_what_must_not_be_is_seen():
    """The judge of the others: of how a command ended, and of the files there are."""
    from fuzz_judging import trouble_of

    before = {"a.csv"}
    good = (2, "", "cornercase: a.csv: is no table.\n", before, before | {"s.db.lock"})
    assert trouble_of(*good) == []
    changes: tuple[dict[int, Any], ...] = (
        {0: 3}, {0: "ZeroDivisionError: no"}, {1: "a\x1b[2J"}, {2: ""}, {2: "cornercase: a\ncornercase: b\n"},
        {2: "cornercase: a met a fault; please report it.\n"}, {2: f"cornercase: {'x' * 2000}\n"}, {2: "cornercase: \u202e\n"},
        {2: "cornercase: a.csv\n/a/b.py:3: RuntimeWarning: overflow\n"}, {4: before | {"out/r.csv"}}, {4: set()},
        {4: before | {".r.csv.x7"}},
    )  # fmt: skip
    for change in changes:
        assert trouble_of(*(change.get(k, one) for k, one in enumerate(good))), change


@pytest.mark.torture
def test_100_000_mutants(tmp_path):
    seed = os.environ.get("CORNERCASE_TORTURE_SEED", "24")
    count = int(os.environ.get("CORNERCASE_TORTURE_MUTANTS", "100000"))
    kept = tmp_path / "kept"
    found, said = fuzzed(tmp_path, "--seed", seed, "--count", count, "--kept", kept, timeout=None)
    print(f"\n{said}\n{shlex.quote(str(kept))}")
    assert not found["failed"], told(found)
    assert found["mutants"] == count
