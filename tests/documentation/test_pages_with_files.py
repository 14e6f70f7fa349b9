"""Commands of the pages that begin with files of the user: typed where such files are, page by page."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
import tomllib
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from conftest import EXAMPLES
from documentation.test_documentation import BLOCKS, PAGES, ROOT, blocks_of
from documentation.test_pages_in_order import MAY_SAY_NO
from documentation.test_pages_in_order import PAGES as IN_ORDER
from helpers.command_line import cornercase

REFERENCE = ROOT.parent / "shared" / "reference" / "openscenario"
NCAP = REFERENCE / "ncap" / "OpenSCENARIO" / "NCAP" / "CA-FC_2026"
CUT_IN = REFERENCE / "esmini" / "resources" / "xosc" / "cut-in.xosc"
# Where the dots of a command stand for the scenario, and for the simulator that is not here.
SEARCHED = "x/scenario/x_intersection.xosc --space x/scenario/x_intersection.space.xosc --ego Ego --other Pedestrian"
SCENARIOS, SCENARIOS_OF_AN_ESTIMATE, MUTANTS = 20, 100, 4
DRIVER = "from cornercase.drivers import SimpleDriver\n\n\nclass MyDriver(SimpleDriver):\n    pass\n"


def lines_of(page: Path) -> Iterator[tuple[str, str]]:
    for block in blocks_of(page):
        if block.language == "python" and page.name in ("compare.md", "mutants.md", "study-format.md"):
            yield "python", block.text
        elif block.language in ("", "sh"):
            lines = block.text.replace("\\\n", " ").splitlines()
            yield from (
                ("command", line) for line in lines if line.startswith("cornercase ") and "cornercase -" not in line
            )
            if block.text.startswith("sqlite3 "):
                yield "sql", shlex.split(block.text)[2]


FURNISHED = [page for page in PAGES if page not in IN_ORDER and any(lines_of(page))]


@pytest.fixture(scope="session")
def house(tmp_path_factory):
    """What the pages suppose: examples, both demonstrations, studies, a reduced set, a recording, a driver."""
    folder = tmp_path_factory.mktemp("house")
    shutil.copytree(EXAMPLES, folder / "examples")
    for name, place in (("x-intersection", "x"), ("t-intersection", "t")):
        done = cornercase("demo", name, "--budget", 48, "-o", folder / place)
        assert done.returncode == 0, done.stderr
    shutil.copytree(folder / "x" / "reduced", folder / "reduced")
    for study in ("study.db", "old.db", "previous.db"):
        shutil.copy(folder / "x" / "study.db", folder / study)
    words = f"explore {SEARCHED} --metric wttc --metric trajectory-distance --driver Ego=aggressive --budget 20 --critical 0.2 -o new.db"
    shutil.copy(EXAMPLES / "x_intersection" / "x_intersection.xosc", folder / "scenario.xosc")
    for file in (EXAMPLES / "x_intersection").glob("*.xodr"):
        shutil.copy(file, folder)
    for command in (shlex.split(words), ["simulate", "scenario.xosc", "-o", "recording.csv"]):
        done = cornercase(*command, cwd=folder)
        assert done.returncode == 0, done.stderr
    (folder / "mypackage").mkdir()
    (folder / "mypackage" / "__init__.py").touch()
    (folder / "mypackage" / "mymodule.py").write_text(DRIVER, encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def scheduler():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def completed(line: str) -> list[str]:
    """The words of a command: with what its dots stand for, and with few scenarios."""
    line = re.sub(r"--simulator carla\S*|> \S+\.toml$", "", line)
    line = line.replace("SCENARIO.xosc --space SPACE.xosc", " ".join(SEARCHED.split()[:3]))
    if line.startswith("cornercase explore"):
        line = line.replace("…", SEARCHED, 1).replace("…", "")
        line += "" if "--metric" in line or "--config" in line else " --metric wttc"
        line += "" if " -o " in line else " -o another.db"
    words = shlex.split(line.replace("/opt/esmini/resources/xosc/cut-in.xosc", str(CUT_IN)))[1:]
    words = [str(NCAP / word) if word.startswith("Variations/") else word for word in words]
    budget = SCENARIOS_OF_AN_ESTIMATE if words[0] == "estimate" else SCENARIOS
    least = {"--budget": budget, "--mutants": MUTANTS, "--kill-mutants": MUTANTS, "--timeout": 60}
    for i, word in enumerate(words[:-1]):
        if word in least:
            words[i + 1] = str(min(int(words[i + 1]), least[word]))
    return words + (["--budget", str(SCENARIOS)] if words[0] == "demo" else [])


def make_room(words: list[str]) -> None:
    """Let a command write where the house, or an earlier command of the page, has another study."""
    if words[0] in ("explore", "test", "estimate", "demo") and not {"--check-proposals", "--config"} & set(words):
        target = Path(words[words.index("-o") + 1])
        if target.is_dir():
            shutil.rmtree(target)
        target.unlink(missing_ok=True)


def watched(words: list[str]) -> None:
    """Serve until Ctrl-C, once the page has been opened."""
    command = [sys.executable, "-m", "cornercase", *words, "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as running:
        assert running.stdout is not None
        address = re.search(r"http://127\.0\.0\.1:\S+", running.stdout.readline())
        assert address is not None
        with urllib.request.urlopen(address[0]) as page:
            assert b"<title>cornercase" in page.read()
        running.send_signal(signal.SIGINT)
        assert running.wait(60) == 0


def can_run(line: str) -> bool:
    """Whether the program, the files and the package that a command needs are here."""
    if "Variations/" in line:
        return NCAP.exists()
    if "esmini" in line:
        return CUT_IN.exists() and "CORNERCASE_ESMINI" in os.environ
    return "--simulator carmaker" not in line


@pytest.mark.slow
@pytest.mark.parametrize("page", FURNISHED, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_is_printed_works_where_its_files_are(page, house, tmp_path, monkeypatch, request):
    place = tmp_path / "here"
    shutil.copytree(EXAMPLES / "suite" if page.name == "ci.md" else house, place)
    monkeypatch.chdir(place)
    names: dict[str, object] = {"__name__": "__main__"}
    for kind, text in lines_of(page):
        if kind == "python":
            exec(compile(text, str(page), "exec"), names)
        elif kind == "sql":
            assert sqlite3.connect("study.db").execute(text).fetchall()
        elif can_run(text):
            words = completed(text)
            if "tcp://" in text:
                address = request.getfixturevalue("scheduler")
                words = [address if word.startswith("tcp://") else word for word in words]
            if page.name == "ci.md":
                prepare_for_ci(words)
            make_room(words)
            if words[0] == "watch":
                watched(words)
                continue
            done = cornercase(*words, cwd=place)
            assert done.returncode in ((0, 1) if words[0] in MAY_SAY_NO else (0,)), f"{text}\n{words}\n{done.stderr}"
            if (file := re.search(r"> (\S+\.toml)$", text)) is not None:
                Path(file[1]).write_text(done.stdout, encoding="utf-8")


def prepare_for_ci(words: list[str]) -> None:
    """Yesterday's study and the run of the main branch, which another job has left."""
    if words[0] == "compare":
        shutil.copy("study.db", "previous.db")
    if "../main/run.db" in words:
        shutil.copytree(".", "../main")


def test_all_settings_can_be_read():
    yaml = pytest.importorskip("yaml")
    readers = {"toml": tomllib.loads, "yaml": yaml.safe_load, "py": lambda text: compile(text, "", "exec")}
    found = [readers[block.language](block.text) for block in BLOCKS if block.language in readers]
    assert len(found) > 10
    assert all(one is None or one for one in found)
