"""The page while a search runs: it grows with its study, and outlives the explorer."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from browser.conftest import shared
from browser.studies import X
from cornercase.study import StudyFile
from helpers.command_line import cornercase
from helpers.waiting import until

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


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Address of the live page of a study that does not change."""
    with serving(shared(tmp_path_factory, "plain")[0]) as address:
        yield address


def pane_of(scenario):
    return f"#replay [data-replay=selected][data-scenario='{scenario}']"


def wait_for_replay(page, scenario):
    """Until the scenario is drawn, or that it cannot be is said."""
    page.wait_for_selector(f"{pane_of(scenario)}:is([data-time], :has(.pane-message:not([hidden])))")
    assert page.locator(f"{pane_of(scenario)} .pane-message:visible").all_inner_texts() == []
    page.wait_for_selector(f"{pane_of(scenario)}[data-time] canvas.scene:visible")


def test_42_14_the_first_replay_is_there_and_when_one_comes_back_to_it(tab, plain):
    page = tab.open(plain)
    first = page.evaluate("() => cornercase.store.selected")
    assert first is not None
    wait_for_replay(page, first)
    page.locator(f"{pane_of(first)} .pane-facts").get_by_text(re.compile(r"[a-z] \d+\b|noise")).wait_for()
    other = 1 + first % 60
    for scenario in (other, first):
        page.evaluate("(id) => cornercase.store.select(id)", scenario)
        wait_for_replay(page, scenario)


def test_42_14_the_scenario_of_the_address_is_the_first_replay(tab, plain):
    page = tab.open(f"{plain}#id=17&beside=23")
    wait_for_replay(page, 17)
    page.wait_for_selector("#replay [data-replay=beside][data-scenario='23'][data-time]")


def test_42_14_a_recording_that_did_not_come_is_asked_for_again(tab, plain):
    page = tab.open(f"{plain}#id=1")
    wait_for_replay(page, 1)
    message = page.locator("#replay .pane-message:visible")
    page.route("**/recordings/*", lambda route: route.abort("connectionrefused"))
    page.evaluate("() => cornercase.store.select(5)")
    message.get_by_text("The server does not answer").wait_for()
    page.unroute("**/recordings/*")
    page.evaluate("() => cornercase.store.select(1)")
    wait_for_replay(page, 1)
    page.evaluate("() => cornercase.store.select(5)")
    wait_for_replay(page, 5)
    # Why it is refused is said, and what is selected is shown once the server is there again.
    refusal = "The study was replaced by another one."
    page.route("**/recordings/*", lambda route: route.fulfill(status=404, body=f"{refusal}\n"))
    page.evaluate("() => cornercase.store.select(6)")
    message.get_by_text(refusal).wait_for()
    page.unroute("**/recordings/*")
    assert all("404" in fault for fault in tab.faults)
    tab.faults.clear()
    page.evaluate("() => cornercase.following.events.dispatchEvent(new Event('open'))")
    page.wait_for_selector(f"{pane_of(6)}[data-time]")
    wait_for_replay(page, 6)


def wait_for(page, count):
    page.wait_for_function("(count) => cornercase.store.n >= count", arg=count, timeout=120_000)


def run(study):
    with StudyFile.open(study, readonly=True) as opened:
        return len(opened.finished_rows())


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


# All that counts scenarios on the page, each time that something of it has changed.
COUNT = """() => {
  window.counts = [];
  const number = (text, pattern) => Number(pattern.exec(text)?.[1] ?? 0);
  const look = () => {
    const live = document.querySelector("#live-state").textContent;
    const shown = document.querySelector("#shown-count").textContent;
    const answers = document.querySelector("#answers .columns").textContent;
    counts.push({
      n: cornercase.store.n,
      live: number(live, /live: (\\d+)/) + number(live, /(\\d+) failed/),
      shown: number(shown, /^(\\d+) of/),
      of: number(shown, /of (\\d+) scenario/),
      known: number(answers, /all (\\d+) scenarios/),
      about: document.querySelector("#about").textContent,
      old: [...document.querySelectorAll(".how-old")].filter((one) => !one.hidden).map((one) => one.textContent),
      space: document.querySelector("#view-space figcaption").textContent,
    });
  };
  look();
  new MutationObserver(look).observe(document.body, { subtree: true, childList: true, characterData: true });
}"""


def require_one_moment(count):
    """All numbers are of one moment, or say of which scenarios they are."""
    n, known = count["n"], count["known"]
    assert count["live"] == count["shown"] == count["of"] == n, count
    assert not re.search(r"\d+ scenarios were run", count["about"]), count
    old = [] if known in (0, n) else [f"Of the first {known} of {n} scenarios; the others follow."] * 3
    assert count["old"] == old, count
    assert (f"Of the first {known} scenarios:" in count["space"]) == bool(old), count


def test_42_16_all_numbers_are_of_one_moment(tab, plain):
    page = tab.open(plain)
    page.locator("#answers").get_by_text("all 60 scenarios").wait_for()
    page.evaluate(COUNT)
    page.evaluate("""() => {
      const { following, store } = cornercase;
      const { contents } = store;
      const { live } = contents;
      const dispatch = (name, data) =>
        following.events.dispatchEvent(new MessageEvent(name, { data: JSON.stringify(data), lastEventId: following.cursor }));
      window.dispatchState = (run) => dispatch("state", { ...live, run });
      window.dispatchKnowledge = (count) => {
        const text = (one) => one.text.replaceAll("60 scenarios", `${count} scenarios`);
        dispatch("knowledge", { known_of: count, answers: contents.answers.map((one) => ({ ...one, text: text(one) })) });
      };
      window.dispatchScenario = (id, isLast) => {
        const first = (column) => [column[0]];
        const { scenarios, courses } = contents;
        const row = Object.fromEntries(Object.entries(scenarios).map(([name, column]) => [name, first(column)]));
        row.id = [id];
        row.values = scenarios.values.map(first);
        row.scores = Object.fromEntries(Object.entries(scenarios.scores).map(([name, column]) => [name, first(column)]));
        const none = Object.fromEntries(Object.keys(courses).map((name) => [name, [null]]));
        const state = isLast ? { ...live, run: id } : null;
        dispatch("scenarios", { scenarios: row, errors: {}, courses: none, spans: [[0, 1]], state });
      };
    }""")
    count = page.locator("#shown-count")
    # More follow at once: they are shown with the others.
    page.evaluate("() => dispatchScenario(61, false)")
    page.evaluate("() => dispatchScenario(62, true)")
    count.get_by_text("62 of 62").wait_for()
    # What counts others than are here is not told.
    page.evaluate("() => dispatchState(61)")
    page.evaluate("() => dispatchScenario(63, true)")
    count.get_by_text("63 of 63").wait_for()
    page.evaluate("() => dispatchKnowledge(62)")
    page.locator("#answers .how-old").get_by_text("first 62 of 63").wait_for()
    page.evaluate("() => dispatchKnowledge(63)")
    page.locator("#answers .how-old").wait_for(state="hidden")
    counts = page.evaluate("() => counts")
    for one in counts:
        require_one_moment(one)
    assert {one["n"] for one in counts} == {60, 62, 63}
    assert {one["known"] for one in counts} == {60, 62, 63}


@pytest.mark.slow
def test_42_16_all_numbers_are_of_one_moment_while_a_study_is_explored(tab, tmp_path):
    study = tmp_path / "s.db"
    fast = ["128" if one == "1" else one for one in EXPLORE]
    assert cornercase(*fast, "128", "-o", study).returncode == 0
    with serving(study) as address:
        page = tab.open(address)
        page.evaluate(COUNT)
        explorer = subprocess.Popen([*CLI, *fast, "20000", "-o", str(study)], stderr=subprocess.DEVNULL)
        try:
            seen = "(name) => new Set(counts.map((one) => one[name]).filter(Boolean)).size > 1"
            page.wait_for_function(seen, arg="known", timeout=400_000)
        finally:
            explorer.kill()
            explorer.wait()
        counts = page.evaluate("() => counts")
    for one in counts:
        require_one_moment(one)
    assert len({one["n"] for one in counts}) > 2
    assert any(one["old"] for one in counts)


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
            with StudyFile.open(study, readonly=True) as opened:
                return opened.notes()

        assert until(notes) == {2: "look here <b>again</b>"}


def test_42_14_a_replay_has_its_events_once_they_are_found(tab, plain):
    page = tab.open(plain)
    wait_for_replay(page, page.evaluate("() => cornercase.store.selected"))
    page.locator(".replay-events .event").first.wait_for(timeout=60_000)
    page.locator(".replay-events .event").last.click()
    clicked = page.locator(".replay-events .event").last.get_attribute("data-time")
    assert abs(page.evaluate("() => cornercase.replay.clock.time") - float(clicked)) < 1e-6
