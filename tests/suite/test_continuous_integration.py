"""The example of a suite in continuous integration: its set is made again, and its files run what they say."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lxml import etree
from typer.testing import CliRunner

from conftest import EXAMPLES
from cornercase import InputError
from cornercase.cli import app
from cornercase.study import StudyFile
from integration.test_golden import same

EXAMPLE = EXAMPLES / "suite"
FILES = (".github/workflows/suite.yml", ".gitlab-ci.yml", "Jenkinsfile", "Dockerfile")
README = (EXAMPLE / "README.md").read_text("utf-8")
LATER = ('"reaction_time": 0.3', '"reaction_time": 0.5')


@pytest.fixture
def repository(tmp_path, monkeypatch) -> Iterator[Path]:
    """A user's repository, as the current folder."""
    shutil.copytree(EXAMPLE, tmp_path / "own", ignore=shutil.ignore_patterns("*.db*", "__pycache__"))
    monkeypatch.chdir(tmp_path / "own")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "own" / "summary.md"))
    yield tmp_path / "own"
    sys.modules.pop("ads", None)


def change_driver() -> None:
    text = Path("ads.py").read_text("utf-8")
    assert LATER[0] in text
    Path("ads.py").write_text(text.replace(*LATER), "utf-8")
    sys.modules.pop("ads", None)


def run(command: str) -> int:
    """Run a line of cornercase here."""
    program, *words = shlex.split(os.path.expandvars(command))
    assert program == "cornercase"
    result = CliRunner().invoke(app, words)
    return 2 if isinstance(result.exception, InputError) else result.exit_code


def run_as_installed(command: str) -> subprocess.CompletedProcess[str]:
    """Run it like the console script, which does not import modules from the current folder."""
    words = shlex.split(os.path.expandvars(command))[1:]
    starting = [sys.executable, "-P", "-c", "from cornercase.cli import main; main()"]
    return subprocess.run([*starting, *words], capture_output=True, text=True, timeout=300, check=False)


def lines_of(name: str) -> list[str]:
    """Commands of cornercase in a file of a service."""
    yaml = pytest.importorskip("yaml")
    plain: Any = yaml.safe_load((EXAMPLE / name).read_text("utf-8"))
    if name.startswith(".github"):
        given = [step["run"] for job in plain["jobs"].values() for step in job["steps"] if "run" in step]
    else:
        jobs = [one for one in plain.values() if isinstance(one, dict) and "script" in one]
        given = [line for one in jobs for line in (*one["script"], *one.get("after_script", ()))]
    found = re.findall(r"(?<!install \")\bcornercase (?!@)[^\n;|]*", "\n".join(given))
    return [one.strip() for one in found]


def command_of(lines: list[str], name: str) -> str:
    return next(one for one in lines if one.startswith(f"cornercase {name} "))


def test_the_scenario_is_that_of_the_regulation():
    for name in ("cut_in.xosc", "motorway.xodr"):
        assert (EXAMPLE / "scenario" / name).read_bytes() == (EXAMPLES / "r157" / name).read_bytes()


@pytest.mark.slow
def test_the_commands_make_the_suite_again(repository):
    lines = README.replace("\\\n", " ")
    commands = re.findall(r"^    (cornercase (?:explore|analyze|reduce) .*)$", lines, re.MULTILINE)
    assert len(commands) == 3
    before = {file.name: file.read_bytes() for file in Path("suite").iterdir()}
    shutil.rmtree("suite")
    assert [run(one) for one in commands] == [0, 0, 0]
    after = {file.name: file.read_bytes() for file in Path("suite").iterdir()}
    # A few numbers come from a surrogate, whose fit depends on the last digits of sums.
    same(json.loads(after.pop("manifest.json")), json.loads(before.pop("manifest.json")), "manifest")
    assert after == before
    with StudyFile.open("study.db", readonly=True) as study:
        assert not any(study.recording(row.id).collisions for row in study.finished_rows())


@pytest.mark.slow
def test_the_job_passes_and_fails_with_a_later_planner_and_shows_both(repository):
    commands = lines_of(FILES[0])
    passed = run_as_installed(command_of(commands, "test").replace("--workers 2", ""))
    assert passed.returncode == 0, passed.stderr
    assert "6 passed of 6 scenarios" in Path("summary.md").read_text("utf-8")
    change_driver()
    Path("run.db").rename("before.db")
    assert run(command_of(commands, "test").replace("--workers 2", "")) == 1
    assert run(command_of(commands, "report")) == 0
    assert "5 passed, 1 failed of 6 scenarios" in Path("report.html").read_text("utf-8")
    assert "5 passed, 1 failed of 6 scenarios" in Path("summary.md").read_text("utf-8")
    # In the words of its README.
    name, *_, why = re.split(r"  +", next(line for line in README.splitlines() if ".xosc  failed  " in line).strip())
    cases = etree.parse("results.xml").findall(".//testcase[failure]")
    assert [(f"{case.get('name')}.xosc", case[0].get("message")) for case in cases] == [(name, f"ttc > 0.5 s: {why}")]
    assert run("cornercase compare before.db run.db") == 1
    Path("requirements.toml").unlink()
    assert run(command_of(commands, "test")) == 2


@pytest.mark.slow
def test_the_search_of_each_night_is_compared_with_the_one_before(repository):
    commands = lines_of(FILES[0])
    search = command_of(commands, "explore").replace("--budget 200", "--budget 12").replace("--workers 2", "")
    assert run(search) == 0
    Path("study.db").rename("previous.db")
    assert run(search) == 0
    assert run(command_of(commands, "compare")) == 0
    change_driver()
    Path("study.db").unlink()
    assert run(search) == 0
    assert run(command_of(commands, "compare")) == 1
    assert Path("compare.html").exists()


def test_all_services_run_the_same_commands():
    github, gitlab = (lines_of(name) for name in FILES[:2])
    assert sorted(one.replace(' --summary "$GITHUB_STEP_SUMMARY"', "") for one in github) == sorted(gitlab)
    assert command_of(gitlab, "test") in (EXAMPLE / "Jenkinsfile").read_text("utf-8")
    (started,) = re.findall(r"CMD \[(.*)\]", (EXAMPLE / "Dockerfile").read_text("utf-8").replace("\\\n", ""))
    assert " ".join(re.findall(r'"(.*?)"', started)).replace("/results/", "") == command_of(gitlab, "test")


def test_all_install_the_same_version_that_is_still_to_be_named():
    places = {
        place for name in FILES for place in re.findall(r"https://\S+?\.tar\.gz", (EXAMPLE / name).read_text("utf-8"))
    }
    assert places == {"https://github.com/OWNER/cornercase/archive/COMMIT.tar.gz"}
