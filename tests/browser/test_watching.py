"""The page while a search runs: it grows with its study, and outlives the explorer."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from browser.studies import X
from command_line import cornercase
from cornercase.study import Study
from waiting import until

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

CLI = (sys.executable, "-c", "from cornercase.cli import main; main()")
# It simulates a scenario at a time, each some hundredths of a second, so that there is something to watch.
EXPLORE = (
    "explore", str(X / "x_intersection.xosc"), "--space", str(X / "x_intersection.space.xosc"), "--ego", "Ego",
    "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--batch", "1", "--budget",
)  # fmt: skip


def explore(budget, study):
    """Run so many scenarios, if there are not as many yet."""
    assert cornercase(*EXPLORE, budget, "-o", study).returncode == 0


@contextmanager
def serving(study):
    process = subprocess.Popen(
        [*CLI, "watch", str(study), "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    try:
        lines = ""
        while (found := re.search(r"http://127\.0\.0\.1:\d+/\?token=[\w-]+", lines.replace("\n", ""))) is None:
            line = process.stdout.readline()
            assert line, lines
            lines += line
        yield found[0]
    finally:
        process.send_signal(signal.SIGINT)
        try:
            assert process.wait(timeout=120) in (0, 130)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        finally:
            process.stdout.close()


def wait_for(page, count):
    page.wait_for_function("(count) => cornercase.store.n >= count", arg=count, timeout=120_000)


def run(study):
    with Study.open(study, readonly=True) as opened:
        return len(opened.done())


@pytest.mark.slow
def test_scenarios_appear_while_the_search_runs_is_killed_and_goes_on(tab, tmp_path):
    study = tmp_path / "s.db"
    explore("8", study)
    with serving(study) as address:
        page = tab.open(address)
        assert page.evaluate("() => cornercase.store.n") == 8
        assert "8" in page.locator("#live-state").inner_text()
        page.evaluate("() => cornercase.store.select(3)")
        explorer = subprocess.Popen([*CLI, *EXPLORE, "2000", "-o", str(study)], stderr=subprocess.DEVNULL)
        try:
            wait_for(page, 12)
        finally:
            explorer.kill()
            explorer.wait()
        known = run(study)
        wait_for(page, known)
        assert page.evaluate("() => cornercase.store.selected") == 3
        explore(str(known + 4), study)
        wait_for(page, known + 4)
        assert run(study) == known + 4
        tab.settle()
        assert page.locator("#shown-count").inner_text() == f"{known + 4} of {known + 4} scenarios"
        page.evaluate("(id) => cornercase.store.select(id)", known + 4)
        page.wait_for_selector(f"#replay [data-replay=selected][data-scenario='{known + 4}'][data-time]")


@pytest.mark.slow
def test_nothing_is_served_without_the_token(tab, studies):
    with serving(studies("plain")) as address:
        base, _, token = address.partition("?token=")
        for path in ("", "contents", "events", "recordings/1"):
            for given in ("", "?token=", f"?token={token[:-1]}"):
                answer = tab.page.request.get(f"{base}{path}{given}")
                assert answer.status in (401, 403), path
        assert tab.page.request.get(f"{base}contents?token={token}").status == 200


@pytest.mark.slow
def test_a_page_that_nobody_looks_at_makes_up_for_it(tab, tmp_path):
    study = tmp_path / "s.db"
    explore("2", study)
    turn = """(hidden) => {
      Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
      document.dispatchEvent(new Event("visibilitychange"));
    }"""
    with serving(study) as address:
        page = tab.open(address)
        page.evaluate(turn, True)
        # A browser has six connections for all tabs of a server.
        assert page.evaluate("() => cornercase.following.events.readyState === EventSource.CLOSED")
        explore("5", study)
        page.evaluate(turn, False)
        wait_for(page, 5)


@pytest.mark.slow
def test_another_study_takes_the_place_of_the_one_that_is_watched(tab, tmp_path):
    study, other = tmp_path / "s.db", tmp_path / "other.db"
    explore("12", study)
    one = ["explore", X / "x_intersection.xosc", "--range", "ego_start=20:60", "--ego", "Ego"]
    options = ["--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--budget", "5", "-o", other]
    assert cornercase(*one, *options).returncode == 0
    with serving(study) as address:
        page = tab.open(address)
        page.evaluate("() => cornercase.store.select(12)")
        page.wait_for_function("() => document.querySelector('#answers').innerText.includes('12 scenarios')")
        other.replace(study)
        page.wait_for_function("() => window.cornercase?.store?.contents.parameters.length === 1", timeout=120_000)
        page.wait_for_function("() => cornercase.store.n === 5 && cornercase.store.selected !== 12", timeout=120_000)
        page.wait_for_function("() => !document.querySelector('#answers').innerText.includes('12 scenarios')")


def test_a_note_goes_to_the_study(tab, tmp_path):
    study = tmp_path / "s.db"
    explore("4", study)
    with serving(study) as address:
        page = tab.open(f"{address}#id=2")
        page.fill("#note", "look here <b>again</b>")
        page.locator("#note").blur()

        def notes():
            with Study.open(study, readonly=True) as opened:
                return opened.notes()

        assert until(notes) == {2: "look here <b>again</b>"}
