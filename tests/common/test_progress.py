"""Progress bars, and lines without a terminal."""

from __future__ import annotations

import sys

import pytest

from cornercase._common.progress import ProgressBar, format_duration, progress_step, show_bars


class Clock:
    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr("cornercase._common.progress.time.monotonic", lambda: self.now)


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.2, "0 s"), (40, "40 s"), (250, "4 min 10 s"), (7500, "2 h 5 min"), (90_000, "25 h 0 min")]
)
def test_stumble_8_hours_are_hours(seconds, words):
    assert format_duration(seconds) == words


def test_stumble_8_the_time_that_it_takes_to_get_ready_is_no_rate(monkeypatch, capsys):
    clock = Clock(monkeypatch)
    bar = ProgressBar(10_001, "exploring", "scenarios")
    bar.update(0, "")
    # Compilation at the beginning takes a minute.
    clock.now += 60.0
    bar.update(1, "")
    clock.now += 10.0
    bar.update(21, "best 0.3 s")
    bar.stop()
    first, second, third = capsys.readouterr().err.splitlines()
    assert first == "0 of 10001 scenarios"
    assert second == "1 of 10001 scenarios"
    assert third == "21 of 10001 scenarios, 2.0/s, 1 h 23 min left, best 0.3 s"


def test_stumble_8_a_long_step_gets_a_bar_and_a_short_one_none(monkeypatch, capsys):
    clock = Clock(monkeypatch)
    for wanted, each, lines in ((True, 3.0, 6), (True, 0.1, 0), (False, 3.0, 0)):
        with show_bars(wanted), progress_step(10, "choosing", "sets") as tell:
            for done in range(1, 11):
                clock.now += each
                tell(done)
        said = capsys.readouterr().err.splitlines()
        assert len(said) == lines, said
        assert not said or said[0] == "1 of 10 sets, 0.3/s, 27 s left"


def test_what_is_slow_has_a_rate_by_the_minute(monkeypatch, capsys):
    clock = Clock(monkeypatch)
    bar = ProgressBar(3, "judging", "sets", start_time=clock.now)
    clock.now += 60.0
    bar.update(1, "")
    assert capsys.readouterr().err == "1 of 3 sets, 1.0/min, 2 min 0 s left\n"


def test_a_notebook_gets_one_bar_that_is_updated(monkeypatch, capsys, tmp_path):
    interactive = pytest.importorskip("IPython.core.interactiveshell")
    # The shell keeps its history in a database, which shells of other processes may have locked.
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    clock, shell = Clock(monkeypatch), interactive.InteractiveShell.instance()
    try:
        # A terminal's shell runs without a kernel.
        monkeypatch.setitem(sys.modules, "ipykernel", sys)
        shown = []
        monkeypatch.setattr(shell.display_pub, "publish", lambda **message: shown.append(message))
        bar = ProgressBar(20, "exploring", "scenarios")
        for n_done in range(20):
            bar.update(n_done, "best <b> s")
            clock.now += 0.1
        bar.update(20, "best <b> s")
        bar.stop()
    finally:
        interactive.InteractiveShell.clear_instance()
    pages = [message["data"]["text/html"] for message in shown]
    assert capsys.readouterr().err == ""
    assert [message.get("update", False) for message in shown] == [False] + [True] * (len(shown) - 1)
    assert len({message["transient"]["display_id"] for message in shown}) == 1
    assert pages[0].startswith('<progress value="0" max="20">')
    assert pages[-1].startswith('<progress value="20" max="20">')
    assert pages[-1].endswith("exploring: 20 of 20 scenarios, 10.0/s, best &lt;b&gt; s")
    # Five a second.
    assert len(shown) <= 12
