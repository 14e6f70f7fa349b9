"""The page of a study while it grows: what its server answers, to whom, and what it tells of an explorer that is killed."""

from __future__ import annotations

import json
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from contextlib import closing, contextmanager
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from cornercase._common.errors import InputError
from cornercase.recordings import read_recording
from cornercase.recordings._compact_encoding import encode_rounded
from cornercase.report._report_data import read_report_data
from cornercase.report._report_payload import page_payload
from cornercase.report.live._analysis_worker import AnalysisWorker
from cornercase.report.live._follower import StudyFollower, StudyProgress
from cornercase.report.live._page_event_stream import Cursor, EventStream
from cornercase.study import StudyFile, write_note
from helpers.command_line import SPACE, X, cornercase
from helpers.untrusted_files import whole_study
from helpers.waiting import until

pytest.importorskip("starlette")
from starlette.testclient import TestClient

from cornercase.report.live._server import create_app

TOKEN = "a-token"
ENDED = "SELECT COUNT(*) FROM scenarios WHERE state <> 'pending'"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return whole_study(tmp_path_factory.mktemp("whole"))


@contextmanager
def followed(path):
    follower = StudyFollower(path)
    finder = AnalysisWorker(follower)
    follower.start()
    finder.start()
    try:
        yield EventStream(follower, finder)
    finally:
        finder.stop()
        follower.stop()


@pytest.fixture(scope="module")
def client(whole):
    with followed(whole) as teller:
        until(lambda: teller.contents().get("details"))
        app = create_app(whole, teller, TOKEN, None, lambda: False)
        made = TestClient(app, base_url="http://127.0.0.1:80")
        made.params = {"token": TOKEN}
        yield made


def test_live_contents_are_those_of_the_report(whole, client):
    found = client.get("/contents").json()
    with StudyFile.open(whole, readonly=True) as study:
        expected = json.loads(json.dumps(page_payload(read_report_data(study))))
    # The page counts its scenarios itself, as they come.
    assert expected.pop("about") == found["about"].replace("Search:", "12 scenarios were run. Search:")
    for name, value in expected.items():
        assert found[name] == value, name
    assert {"answers", "scenarios", "courses", "kinds", "kept"} <= set(expected)
    assert found["live"]["run"] == 12
    assert found["roads"] is not None


def test_a_scenario_is_given_exactly(whole, client, tmp_path):
    with StudyFile.open(whole, readonly=True) as study:
        recording = study.recording(7)
        metrics = [cc.metrics.METRICS.create(name) for name in study.meta.metrics]
        courses = {one.name: one.clip_course(study.course(7, one.name)) for one in metrics}
    assert client.get("/recordings/7").content == encode_rounded(recording, courses)
    (tmp_path / "r.csv").write_bytes(client.get("/recordings/7.csv").content)
    read = read_recording(tmp_path / "r.csv")
    np.testing.assert_array_equal(read.x, recording.x)
    manifest = json.loads((whole.parent / "reduced" / "manifest.json").read_text())
    for one in manifest["scenarios"]:
        answer = client.get(f"/scenarios/{one['id']}.xosc")
        assert answer.content == (whole.parent / "reduced" / one["file"]).read_bytes()
        assert answer.headers["content-disposition"].startswith("attachment")


def test_nothing_is_given_or_written_of_a_study_that_replaced_the_one_that_is_shown(client):
    epoch = client.get("/contents").json()["live"]["cursor"].partition(".")[0]
    assert client.get("/recordings/1", params={"epoch": epoch}).status_code == 200
    assert client.get("/recordings/1", params={"epoch": "another"}).status_code == 404
    answer = client.put("/notes/1", content=b"of the other", params={"epoch": "another"})
    assert answer.status_code == 400
    assert "replaced by another" in answer.text


@pytest.mark.parametrize(
    "path",
    [
        "/recordings/99",
        "/recordings/99.csv",
        "/scenarios/99.xosc",
        "/recordings/x",
        "/recordings/-1",
        f"/recordings/{'9' * 5000}",
        "/s.db",
        "/../s.db",
    ],
)
def test_what_is_not_there_is_not_found(client, path):
    answer = client.get(path)
    assert answer.status_code == 404
    assert "Traceback" not in answer.text


def test_only_who_knows_the_token_comes_in(client, whole):
    app = client.app
    stranger = TestClient(app, base_url="http://127.0.0.1:80")
    for path in ("/", "/contents", "/events", "/recordings/1", "/recordings/1.csv", "/scenarios/1.xosc", "/missing"):
        for token in ("", "?token=", "?token=a-tokem", "?token=%ff", "?" + "a=1&" * 50, "?token=a-token&token=x"):
            assert stranger.get(path + token).status_code == 403, (path, token)
    assert stranger.put("/notes/1", content="x").status_code == 403
    with StudyFile.open(whole, readonly=True) as study:
        assert 1 not in study.notes()


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "localhost.evil.example:80", ""]
)
def test_a_name_of_elsewhere_is_refused(client, host):
    assert client.get("/contents", headers={"host": host}).status_code == 403


@pytest.mark.parametrize("host", ["127.0.0.1:80", "localhost:80", "[::1]:80", "192.168.1.5:80"])
def test_an_address_of_the_machine_is_taken(client, host):
    assert client.get("/contents", headers={"host": host}).status_code == 200


def test_another_page_is_refused(client):
    for origin in ("http://evil.example", "null", "http://127.0.0.1:81"):
        assert client.put("/notes/1", content="x", headers={"origin": origin}).status_code == 403
        assert client.get("/contents", headers={"origin": origin}).status_code == 403
    assert client.get("/contents", headers={"origin": "http://127.0.0.1", "host": "127.0.0.1"}).status_code == 200


def test_nothing_is_kept_framed_or_sent_on(client):
    for path in ("/", "/contents", "/missing"):
        headers = client.get(path).headers
        assert headers["cache-control"] == "no-store"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["x-content-type-options"] == "nosniff"
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "access-control-allow-origin" not in headers
    page = client.get("/").text
    assert 'data-live="true"' in page
    assert TOKEN not in page


def test_notes_are_all_that_is_written(client, whole):
    before = {name: (whole.parent / name).read_bytes() for name in ("scenario.xosc", "road.xodr")}
    assert client.put("/notes/2", content="brakes <b>late</b> 行人".encode()).status_code == 204
    with StudyFile.open(whole, readonly=True) as study:
        assert study.notes()[2] == "brakes <b>late</b> 行人"
    until(lambda: client.get("/contents").json()["notes"].get("2") == "brakes <b>late</b> 行人")
    for path, body in (
        ("/notes/99", b"x"),
        ("/notes/2", b"x" * 2001),
        ("/notes/2", b"x" * 10**6),
        ("/notes/2", b"\xff\xfe"),
    ):
        answer = client.put(path, content=body)
        assert answer.status_code == 400
        assert len(answer.text.strip().splitlines()) == 1
    assert client.put("/notes/2", content=b"").status_code == 204
    for method in ("post", "delete", "patch", "put"):
        for path in ("/contents", "/", "/recordings/1", "/scenarios/1.xosc"):
            assert getattr(client, method)(path).status_code == 405
    with StudyFile.open(whole, readonly=True) as study:
        assert study.notes() == {}
    assert before == {name: (whole.parent / name).read_bytes() for name in before}


def news(teller, cursor):
    """All that a page with a cursor is told by now: events with their data."""
    text = "".join(teller.event_writer(cursor)())
    return [(event, json.loads(data)) for event, data in re.findall(r"event: (\w+)\ndata: (.*)\n", text)]


def test_a_page_is_told_of_each_scenario_once(tmp_path, whole):
    with StudyFile.open(whole, readonly=True) as study:
        meta, rows = study.meta, study.finished_rows()
        recording = study.recording(1)
        courses = {name: (study.course(1, name), 1.0) for name in meta.metrics}
    with followed(tmp_path / "new.db") as teller:
        until(lambda: teller.follower.state.why == "new.db is not there yet.")
        assert set(teller.contents()) == {"live"}
        with StudyFile.create(tmp_path / "new.db", meta) as study:
            points = np.array([row.point for row in rows])
            study.writer.add_pending(1, points, [row.values for row in rows])
            until(lambda: teller.follower.state.name == "live")
            study.writer.record_result(3, recording, courses)
            # What is known of all is found in the background, and told with everything when it is first there.
            until(lambda: teller.contents().get("details"))
            contents = teller.contents()
            assert contents["scenarios"]["id"] == [3]
            cursor = Cursor.parse(contents["live"]["cursor"])
            study.writer.record_failure(1, cc.SimulationError("the road <ends>"))
            study.writer.record_result(2, recording, courses)
            until(lambda: teller.follower.state.run == 2 and teller.follower.state.failed == 1)
            events = news(teller, cursor)
            ((_, columns),) = [one for one in events if one[0] == "scenarios"]
            assert columns["scenarios"]["id"] == [1, 2]
            assert columns["scenarios"]["failed"] == [1, 0]
            assert columns["errors"] == {"1": "the road <ends>"}
            assert columns["courses"]["distance"][0] is None
            assert len(columns["courses"]["distance"][1]) == contents["courses"]["distance"]["points"]
            # Whoever asks again with the cursor after them is not told of them again.
            again = Cursor.parse(teller.contents()["live"]["cursor"])
            assert not [one for one in news(teller, again) if one[0] == "scenarios"]
            assert teller.contents()["scenarios"]["id"] == [1, 2, 3]
        # Something else of that name: everything is asked for anew.
        (tmp_path / "new.db").unlink()
        until(lambda: teller.follower.state.name == "waiting")
        with StudyFile.create(tmp_path / "new.db", meta) as study:
            study.writer.add_pending(1, points[:1], [rows[0].values])
            study.writer.record_result(1, recording, courses)
            until(lambda: teller.follower.state.run == 1)
        assert news(teller, again)[0][0] == "contents"
        write_note(tmp_path / "new.db", 1, "seen")
        until(lambda: teller.follower.notes == {1: "seen"})


class Growing(StudyFollower):
    """Of a study that grows by a scenario at each look at what is new."""

    grow: Callable[[], object] | None = None

    def scenarios_since(self, *arguments, **options):
        found = super().scenarios_since(*arguments, **options)
        if self.grow is not None:
            self.grow()
        return found


def parts_of(study, count):
    """A study of which so many scenarios ended, with what it takes to end the others."""
    with StudyFile.open(study, readonly=True) as opened:
        meta, rows, recording = opened.meta, opened.finished_rows(), opened.recording(1)
        courses = {name: (opened.course(1, name), 1.0) for name in meta.metrics}
    return meta, np.array([row.point for row in rows])[:count], [row.values for row in rows][:count], recording, courses


def test_42_16_what_is_told_counts_what_was_told(tmp_path, whole):
    meta, points, values, recording, courses = parts_of(whole, 12)
    follower = Growing(tmp_path / "s.db")
    finder = AnalysisWorker(follower)
    with StudyFile.create(tmp_path / "s.db", meta) as study:
        study.writer.add_pending(1, points, values)
        study.writer.record_result(1, recording, courses)
        follower.start()
        finder.start()
        teller = EventStream(follower, finder)
        until(lambda: teller.contents().get("known_of") == 1)
        left = iter(range(2, 9))

        def grow():
            scenario = next(left, None)
            if scenario is None:
                return
            if scenario % 3:
                study.writer.record_result(scenario, recording, courses)
            else:
                study.writer.record_failure(scenario, cc.SimulationError("no"))
            until(lambda: follower.state.run + follower.state.failed == scenario)

        follower.grow = grow
        contents = teller.contents()
        assert contents["live"]["run"] + contents["live"]["failed"] == len(contents["scenarios"]["id"])
        count, failed = 1, 0
        told = []
        write = teller.event_writer(Cursor.parse(contents["live"]["cursor"]))
        # What is known of all follows seconds later.
        for _ in range(2):
            for event, data in re.findall(r"event: (\w+)\ndata: (.*)\n", "".join(write())):
                data = json.loads(data)
                if event == "scenarios":
                    count += len(data["scenarios"]["id"])
                    failed += sum(data["scenarios"]["failed"])
                state = data if event == "state" else (data or {}).get("state")
                if state is not None:
                    assert (state["run"], state["failed"], state["pending"]) == (count - failed, failed, 12 - count)
                    told.append(count)
                if event == "knowledge":
                    assert data["known_of"] <= count
                    assert str(count) not in data["about"]
            until(lambda: teller.contents()["known_of"] == 8)
        assert told[-1] == 8
        assert len(told) > 2
        finder.stop()
        follower.stop()


def test_42_16_nothing_is_told_of_scenarios_that_were_not_read_yet(tmp_path, whole):
    meta, points, values, recording, courses = parts_of(whole, 12)
    follower = StudyFollower(tmp_path / "s.db")
    finder = AnalysisWorker(follower)
    teller = EventStream(follower, finder)
    with StudyFile.create(tmp_path / "s.db", meta) as study:
        study.writer.add_pending(1, points, values)
        for scenario in range(1, 6):
            study.writer.record_result(scenario, recording, courses)
    # As far as it has read by now; what is known of all is found in the file.
    follower.state, follower.n_changes = StudyProgress("live", run=3), 1
    finder.start()

    def event():
        found = teller.next_event(Cursor(follower.epoch))
        return None if found is None else found[1]

    for _ in range(15):
        assert event() in (None, "state")
        time.sleep(0.1)
    follower.state = StudyProgress("live", run=5)
    until(lambda: event() == "contents")
    finder.stop()


def test_what_could_not_be_read_is_read_again_without_a_further_change(tmp_path, whole):
    follower = StudyFollower(tmp_path / "s.db")
    follower.state, follower.n_changes = StudyProgress("live", run=12), 1
    finder = AnalysisWorker(follower)
    finder.start()
    # Long enough for a first look; on a busy machine the first one may already find the study.
    time.sleep(1.0)
    shutil.copy(whole, tmp_path / "s.db")
    until(lambda: finder.latest.parts)
    finder.stop()


def test_42_16_scenarios_that_are_run_again_are_counted_once(tmp_path, whole):
    meta, points, values, recording, courses = parts_of(whole, 3)
    with followed(tmp_path / "s.db") as teller, StudyFile.create(tmp_path / "s.db", meta) as study:
        study.writer.add_pending(1, points, values)
        study.writer.record_result(1, recording, courses)
        study.writer.record_failure(2, cc.SimulationError("no road"))
        study.writer.record_result(3, recording, courses)
        until(lambda: teller.contents()["live"]["failed"] == 1)
        cursor = Cursor.parse(teller.contents()["live"]["cursor"])
        study.writer.retry_failed()
        until(lambda: teller.follower.state.pending == 1)
        study.writer.record_result(2, recording, courses)
        until(lambda: teller.follower.state.run == 3)
        assert teller.follower.state.failed == 0
        assert sorted(teller.contents()["scenarios"]["id"]) == [1, 2, 3]
        assert news(teller, cursor)[0][0] == "contents"


@pytest.mark.parametrize(
    "text", ["", "x", "a.b.c.d", "a.1.2", "a.-1.0.0", "a.1.2.3.4", "..." * 1000, "a.１.0.0", "a.99999.0.0"]
)
def test_a_cursor_that_was_made_up_asks_for_everything(whole, text):
    with followed(whole) as teller:
        until(lambda: "scenarios" in teller.contents())
        assert news(teller, Cursor.parse(text))[0][0] == "contents"


def test_what_is_no_study_is_waited_for(tmp_path):
    (tmp_path / "s.db").write_text("no study")
    with followed(tmp_path / "s.db") as teller:
        until(lambda: "not a database" in teller.follower.state.why)
        assert "s.db" in teller.follower.state.why


def test_a_port_that_is_taken_is_said(tmp_path):
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        done = cornercase("watch", tmp_path / "s.db", "--port", taken.getsockname()[1], "--no-browser")
    assert done.returncode == 2
    assert re.fullmatch(r"cornercase: --port \d+: nothing can be served at 127\.0\.0\.1 .*\n", done.stderr)


@pytest.mark.parametrize(
    "options",
    [
        {"host": "example.org"},
        {"host": ""},
        {"host": "192.0.2.1"},
        {"port": -1},
        {"port": 65536},
        {"scenario": "missing.xosc"},
    ],
)
def test_what_cannot_be_served_is_said(tmp_path, options):
    with pytest.raises(InputError, match=f"`{next(iter(options))}`"):
        cc.watch(tmp_path / "s.db", **options)
    with pytest.raises(InputError, match="is not a file"):
        cc.watch(tmp_path)
    (tmp_path / "page.html").write_text("no study")
    with pytest.raises(InputError, match="not a database"):
        cc.watch(tmp_path / "page.html")


def test_without_the_extra_the_error_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(InputError, match=r"cornercase\[live\]"):
        cc.watch(tmp_path / "s.db")


class Listener(threading.Thread):
    """Hears the events of a server, as a browser does."""

    def __init__(self, address):
        super().__init__(daemon=True)
        self.heard: list[tuple[str, Any]] = []
        self._address = address

    def run(self):
        with urllib.request.urlopen(self._address, timeout=60) as stream:
            event = ""
            for raw in stream:
                line = raw.decode()
                if line.startswith("event: "):
                    event = line[7:].strip()
                elif line.startswith("data: "):
                    self.heard.append((event, json.loads(line[6:])))

    def run_by_now(self):
        """How many scenarios the page says were run."""
        states = [data for event, data in self.heard if event == "state"]
        return states[-1]["run"] if states else 0


def started(*arguments):
    run = [sys.executable, "-c", "from cornercase.cli import main; main()", *map(str, arguments)]
    return subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(path):
    if not path.exists():
        return 0
    try:
        with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as connection:
            return int(connection.execute(ENDED).fetchone()[0])
    except sqlite3.Error:
        return 0


@pytest.mark.skipif(sys.platform == "win32", reason="it asks as Unix does")
@pytest.mark.parametrize(
    ("number", "code", "words"),
    [
        (signal.SIGTERM, 143, "Interrupted by SIGTERM"),
        pytest.param("SIGHUP", 129, "Interrupted by SIGHUP", marks=pytest.mark.slow),
    ],
)
def test_it_ends_when_it_is_asked_to(tmp_path, number, code, words):
    with started("watch", tmp_path / "s.db", "--no-browser") as server:
        said = server.stdout.readline()
        assert "The page of" in said
        # Once it answers, it looks for signals.
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(said.split()[-1][:-1])
        server.send_signal(getattr(signal, number) if isinstance(number, str) else number)
        _, err = server.communicate(timeout=120)
    assert server.returncode == code
    assert err.startswith(words)
    assert err.count("\n") == 1


@pytest.mark.slow
def test_the_page_grows_with_an_exploration_that_is_killed_and_started_again(tmp_path):
    study = tmp_path / "s.db"
    explore = ("explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol",
               "--batch", "4", "--budget", "400", "-o", study)  # fmt: skip
    with started("watch", study, "--no-browser") as server:
        assert server.stdout is not None
        address = server.stdout.readline().split()[-1]
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=[\w-]{32}", address)
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(address[:-1])
        listener = Listener(address.replace("/?", "/events?"))
        listener.start()
        with started(*explore) as explorer:
            until(lambda: ended(study) >= 8)
            explorer.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
        killed = ended(study)
        assert killed < 400
        until(lambda: listener.run_by_now() == killed)
        with started(*explore) as explorer:
            until(lambda: ended(study) >= killed + 8)
            seen = ended(study)
            until(lambda: listener.run_by_now() >= seen)
            explorer.terminate()
        server.send_signal(signal.SIGINT)
        out, err = server.communicate(timeout=120)
        assert (server.returncode, out, err) == (0, "", "")
