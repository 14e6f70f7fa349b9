"""What tests every change and each night: neither ends the other, and nothing that it needs is missing in silence."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import warnings
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from conftest import without
from cornercase import NoticeWarning
from helpers.command_line import X, cornercase

ROOT = Path(__file__).parents[2]
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8"))


def filled(text: str, **github: str) -> str:
    """A text of the workflow with its expressions evaluated."""

    def value(match: re.Match[str]) -> str:
        expression = match[1].replace("&&", " and ").replace("||", " or ")
        expression = re.sub(r"github\.(\w+)", r"github['\1']", expression)
        found = eval(expression, {}, {"github": {"workflow": "tests", **github}})
        return str(found).lower() if isinstance(found, bool) else str(found)

    return re.sub(r"\$\{\{(.*?)\}\}", value, str(text))


def group_of(event: str, ref: str, run: str) -> tuple[str, str]:
    """Runs of the same group wait for each other, or end each other."""
    rule = WORKFLOW["concurrency"]
    given = {"event_name": event, "ref": ref, "run_id": run}
    return filled(rule["group"], **given), filled(rule["cancel-in-progress"], **given)


def test_42_17_neither_a_push_nor_the_night_ends_another_run():
    main = "refs/heads/main"
    runs = [group_of("push", main, "1"), group_of("push", main, "2"), group_of("schedule", main, "3")]
    assert len({group for group, _ in runs}) == 3
    older, newer = (
        group_of("pull_request", "refs/pull/7/merge", "4"),
        group_of("pull_request", "refs/pull/7/merge", "5"),
    )
    assert older == newer == (older[0], "true")
    assert group_of("pull_request", "refs/pull/8/merge", "6")[0] != older[0]


def test_42_17_every_machine_gets_a_browser():
    steps = [step.get("run", "") for step in WORKFLOW["jobs"]["tests"]["steps"]]
    installs = next(k for k, run in enumerate(steps) if "playwright install" in run and "chromium" in run)
    assert installs < next(k for k, run in enumerate(steps) if "-m pytest" in run)


@pytest.mark.parametrize(("ci", "outcome"), [("", pytest.skip), ("false", pytest.skip), ("true", pytest.fail)])
def test_42_17_what_is_missing_is_a_failure_in_ci(monkeypatch, ci, outcome):
    monkeypatch.setenv("CI", ci)
    with pytest.raises(outcome.Exception, match="no browser"):
        without("no browser")


@pytest.mark.slow
@pytest.mark.parametrize(("ci", "summary"), [("", "1 skipped"), ("true", "1 error")])
def test_42_17_without_chromium_tests_fail_in_ci(tmp_path, ci, summary):
    environment = {**os.environ, "CI": ci, "PATH": str(tmp_path), "PLAYWRIGHT_BROWSERS_PATH": str(tmp_path)}
    environment.pop("CORNERCASE_CHROMIUM", None)
    test = "tests/browser/test_loading.py::test_numbers_far_from_zero_are_told_apart"
    command = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", test, "-o", "addopts="]
    ran = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert summary in ran.stdout.splitlines()[-1]
    assert ci == "" or "there is no Chromium: install it" in ran.stdout


def test_42_17_ci_has_all_packages_that_tests_need():
    """Tests of a package that is not there are skipped, wherever it is not there for this Python."""
    dev = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"][
        "dev"
    ]
    missing = []
    for one in map(Requirement, dev):
        if one.marker is None or one.marker.evaluate():
            try:
                metadata.version(one.name)
            except metadata.PackageNotFoundError:
                missing.append(one.name)
    if missing:
        without(f"packages of the extra 'dev' are not installed: {', '.join(missing)}")


def test_42_17_a_warning_that_no_test_expects_is_an_error():
    for category in (UserWarning, NoticeWarning, RuntimeWarning, FutureWarning, ResourceWarning, DeprecationWarning):
        with pytest.raises(category, match="careless"):
            warnings.warn("careless", category, stacklevel=1)
    # What scenario files hold for others; others' own use of what will be gone.
    warnings.warn("without effect: <Axles>", NoticeWarning, stacklevel=1)
    with pytest.warns(DeprecationWarning, match="old"):
        warnings.warn_explicit("old", DeprecationWarning, "elsewhere.py", 1, module="elsewhere")


def test_42_17_a_command_within_a_test_prints_its_notices(tmp_path):
    done = cornercase("simulate", X, "--set", "ego_start=40", "-o", tmp_path / "recording.csv")
    assert (done.returncode, done.stderr.count("parts of the files are ignored")) == (0, 1)


@pytest.mark.skipif(sys.platform == "win32", reason="it is a script of Unix")
@pytest.mark.parametrize("works", [True, False])
def test_42_17_chromium_that_cannot_be_installed_is_said(tmp_path, works):
    """On a machine of which it is root, whose first try to get packages fails."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("env", "bash", "dirname", "mktemp", "cat", "rm"):
        (programs / name).symlink_to(shutil.which(name))
    first = f'[ -e {tmp_path}/tried ] || {{ touch() {{ : >"$1"; }}; touch {tmp_path}/tried; echo "E: no network" >&2; exit 100; }}'
    scripts = {
        "id": "echo 0",
        "sleep": "exit 0",
        "make": 'echo "make $1 with CI=$CI"',
        "apt-get": first if works else 'echo "E: no network" >&2; exit 100',
    }
    for name, script in scripts.items():
        (programs / name).write_text(f"#!{programs}/bash\n{script}\n")
        (programs / name).chmod(0o755)
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci" / "run")
    environment = {"PATH": str(programs), "TMPDIR": str(tmp_path)}
    ran = subprocess.run([programs / "bash", tmp_path / ".ci" / "run"], env=environment, capture_output=True, text=True)
    if works:
        assert (ran.returncode, ran.stdout) == (0, "make test with CI=true\nmake lint with CI=true\n")
    else:
        assert ran.returncode == 1
        assert "E: no network" in ran.stderr
        assert "Chromium, which tests need, could not be installed" in ran.stderr
        assert ran.stdout == ""
