"""Replays of single scenarios, as films and as pages."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageSequence

import cornercase as cc
from conftest import EXAMPLES
from cornercase import InputError
from cornercase.recordings import Collision, Recording
from cornercase.report._road_drawing import find_road_outline, recorded_bounds
from cornercase.report.replays import _film_files as film_files
from cornercase.report.replays import _interpolation as interpolation
from cornercase.report.replays._frames import FrameRenderer
from cornercase.report.replays._replay_data import read_replay_data
from cornercase.report.replays._replay_page import render_replay_page
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from helpers.command_line import cornercase
from helpers.synthetic_study import SPACE, about, explorer

X = EXAMPLES / "x_intersection"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Four scenarios of the X-intersection."""
    path = tmp_path_factory.mktemp("replay") / "study.db"
    logical = cc.LogicalScenario.read(X / "x_intersection.xosc", X / "x_intersection.space.xosc")
    with pytest.warns(cc.NoticeWarning):
        cc.explore(logical, path, ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol", budget=4)
    return path


@pytest.fixture(scope="module")
def failing(tmp_path_factory):
    """A study of no scenario file, of which some scenarios failed."""
    path = tmp_path_factory.mktemp("failing") / "study.db"
    with StudyFile.create(path, about(SPACE, "distance")) as one:
        explorer(one, metrics=("distance",), optimizer="sobol").run()
    return path


def recording(**changes):
    """An ego that turns through a half turn, and a pedestrian that comes later and stands."""
    gone = np.nan
    values: dict[str, Any] = {
        "time": np.array([0.0, 0.5, 1.0]),
        "names": ("Ego", "P"),
        "object_types": ("car", "pedestrian"),
        "x": np.array([[0.0, 4.0, 8.0], [gone, 20.0, 20.0]]),
        "y": np.array([[0.0, 0.0, 0.0], [gone, 3.0, 3.0]]),
        "heading": np.array([[3.0, 3.0, -3.0], [gone, 0.0, 0.0]]),
        "speed": np.array([[8.0, 8.0, 8.0], [gone, 0.0, 0.0]]),
        "acceleration": np.zeros((2, 3)),
        "length": np.array([4.0, 0.5]),
        "width": np.array([2.0, 0.5]),
        "center_x": np.array([1.5, 0.0]),
    }
    return Recording(**(values | changes))


def contents(page):
    found = re.search(r'<script type="application/json" id="contents">(.*?)</script>', page.read_text("utf-8"), re.S)
    assert found is not None
    return json.loads(found[1])


def test_a_page_holds_the_replay_and_nothing_else(study, tmp_path):
    page = cc.replay(study, 3, tmp_path / "run.html", beside=1)
    text = page.read_text("utf-8")
    assert contents(page)["shown"] == [3, 1]
    assert contents(page)["scenarios"]["id"] == [1, 3]
    assert contents(page)["roads"]["areas"]
    assert "Plotly" not in text
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", text)
    assert len(text) < 200_000
    again = cc.replay(study, 3, tmp_path / "again.html", beside=1)
    assert again.read_bytes() == page.read_bytes()


def test_the_threshold_is_the_one_that_is_given(study, tmp_path):
    own = contents(cc.replay(study, 3, tmp_path / "run.html"))["critical"]["threshold"]
    other = contents(cc.replay(study, 3, tmp_path / "other.html", critical=own + 9.0))
    assert other["critical"]["threshold"] == own + 9.0
    assert other["scenarios"]["critical"] == [1]


def test_a_scenario_beside_itself_is_held_once(study, tmp_path):
    page = cc.replay(study, 2, tmp_path / "run.html", beside=2)
    assert contents(page)["scenarios"]["id"] == [2]


def test_a_gif_lasts_as_long_as_its_recording(study, tmp_path):
    path = cc.replay(study, 2, tmp_path / "run.gif", fps=4, speed=2.0)
    with StudyFile.open(study, readonly=True) as opened:
        time = opened.recording(2).time
    with Image.open(path) as film:
        lasts = sum(frame.info["duration"] for frame in ImageSequence.Iterator(film))
    # Twice as fast; the last frame comes a part of a step early or late.
    assert abs(lasts / 1000.0 - (time[-1] - time[0]) / 2.0) < 0.75
    assert path.read_bytes() == cc.replay(study, 2, tmp_path / "again.gif", fps=4, speed=2.0).read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_an_mp4_shows_one_frame_for_each_step(study, tmp_path):
    path = cc.replay(study, 2, tmp_path / "run.mp4", beside=1, fps=2, speed=4.0)
    assert path.read_bytes()[4:8] == b"ftyp"
    if shutil.which("ffprobe"):
        asked = ["-count_frames", "-show_entries", "stream=nb_read_frames,width,height", "-of", "csv=p=0"]
        command = ["ffprobe", "-v", "error", *asked, str(path)]
        told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        with StudyFile.open(study, readonly=True) as opened:
            end = max(opened.recording(one).time[-1] for one in (1, 2))
        width, height, frames = map(int, told.strip().split(","))
        # Two frames per second stand for 2 s each, then the last one stays for 1.5 s.
        assert (width, height) == (1440, 720)
        assert abs(frames - (end / 2.0 + 4)) <= 2


def test_frames_show_the_entities_where_they_were(study):
    with StudyFile.open(study, readonly=True) as opened:
        footage = read_replay_data(opened, [2])
    drawn = footage.items[0].recording
    # A time at which the two are apart, and in view.
    k = int(np.abs(drawn.time - footage.items[0].most_critical_time(footage.metrics[0])).argmin()) - 5
    film = FrameRenderer(footage)
    (frame,) = film.render_frames(drawn.time[k : k + 1])
    axes = film._scenes[0]._axes
    for name, colour in (("Ego", (0, 90, 148)), ("Pedestrian", (184, 74, 0))):
        heading = drawn.heading[drawn.entity_index(name), k]
        # A place on the box behind its nose, and off the trail and the line of sight.
        behind = -0.4 * drawn.length[drawn.entity_index(name)] if name == "Ego" else 0.0
        aside = 0.3 * drawn.width[drawn.entity_index(name)] if name == "Ego" else 0.0
        place = drawn.box_center(name)[k] + behind * np.array([math.cos(heading), math.sin(heading)])
        place = place + aside * np.array([-math.sin(heading), math.cos(heading)])
        x, y = axes.transData.transform(place)
        pixel = frame[frame.shape[0] - 1 - int(y), int(x)].astype(int)
        assert np.abs(pixel - colour).sum() < 60, name


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"path": "run.avi"}, r"must end with one of \.html, \.gif, \.mp4"),
        ({"id": 99}, "has no scenario 99; its scenarios are 1 to 4"),
        ({"beside": 0}, "`beside` 0"),
        ({"path": "run.gif", "fps": 100.0}, "`fps` 100: give at most 60"),
        ({"path": "run.gif", "speed": 0.0}, "`speed` 0"),
        ({"fps": 25.0}, "`fps` and `speed` only apply to films"),
        ({"speed": 2.0}, "`fps` and `speed` only apply to films"),
        ({"path": "run.gif", "speed": 1e-5}, "frames, more than 20000"),
        ({"scenario": EXAMPLES / "t_intersection" / "t_intersection.xosc"}, "changed since|restore them"),
    ],
)
def test_what_cannot_be_shown_is_said_in_a_sentence_and_nothing_is_left(study, tmp_path, given, message):
    options = {"id": 1, "path": "run.html"} | given
    with pytest.raises(InputError, match=message):
        cc.replay(study, options.pop("id"), tmp_path / options.pop("path"), **options)
    assert list(tmp_path.iterdir()) == []


def test_without_ffmpeg_one_learns_how_to_get_it(study, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name, path: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'cornercase\[video\]'"):
        cc.replay(study, 1, tmp_path / "run.mp4")
    assert list(tmp_path.iterdir()) == []


def test_an_ffmpeg_that_fails_leaves_nothing(study, tmp_path, monkeypatch):
    monkeypatch.setattr(film_files, "find_ffmpeg", lambda: shutil.which("false"))
    with pytest.raises(InputError, match="could not write the film"):
        cc.replay(study, 1, tmp_path / "run.mp4", fps=1, speed=10.0)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_scenario_says_why(failing, tmp_path):
    with StudyFile.open(failing, readonly=True) as opened:
        failed, done = opened.failed_rows()[0], opened.finished_rows()[0]
    with pytest.raises(InputError, match=f"scenario {failed.id} failed") as told:
        cc.replay(failing, failed.id, tmp_path / "run.html")
    assert str(failed.error) in str(told.value)
    page = cc.replay(failing, done.id, tmp_path / "run.html")
    assert contents(page)["roads"] is None
    assert contents(page)["roads_missing"].startswith("The road is not drawn")


def test_a_film_without_a_road_says_so_in_a_sentence(failing, tmp_path):
    with StudyFile.open(failing, readonly=True) as opened:
        done = opened.finished_rows()[0].id
    ran = cornercase("replay", failing, done, "--fps", "1", "--speed", "4", "-o", tmp_path / "run.gif")
    assert ran.returncode == 0, ran.stderr
    assert re.search(r"The road is not drawn, .*[^.]\.$", ran.stderr, re.MULTILINE)


def test_the_command_writes_what_it_says(study, tmp_path):
    ran = cornercase("replay", study, "2", "--beside", "1", "-o", tmp_path / "run.html")
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "run.html").exists()
    assert "The replay is" in ran.stdout
    refused = cornercase("replay", study, "2", "-o", tmp_path / "run.txt")
    assert refused.returncode == 2
    assert "-o" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_a_recording_or_a_study_without_an_id_leads_to_a_replay(study, tmp_path):
    recording = cornercase("replay", "run.csv", "-o", tmp_path / "run.html")
    assert recording.returncode == 2
    assert "run.csv: is a recording, and a replay is made from a study" in recording.stderr
    no_id = cornercase("replay", study, "-o", tmp_path / "run.html")
    assert no_id.returncode == 2
    assert f"give the id of a scenario, too, as in 'cornercase replay {study} 1 -o " in no_id.stderr


def test_between_instants_entities_move_straight_and_turn_the_short_way():
    found = interpolation.interpolate_motion(recording(), np.array([0.0, 0.5, 0.75, 1.0]))
    centers = recording().box_center("Ego")
    assert np.allclose(np.stack([found.x[0], found.y[0]], axis=1)[[0, 1, 3]], centers)
    assert abs(abs(found.heading[0, 2]) - math.pi) < 1e-9
    assert np.isnan(found.x[1, 0])
    assert found.x[1, 1] == 20.0


def test_who_comes_between_two_instants_is_there_from_the_middle_on():
    found = interpolation.interpolate_motion(recording(), np.array([0.2, 0.3]))
    assert np.isnan(found.x[1, 0])
    assert found.x[1, 1] == 20.0


def test_boxes_touch_between_them():
    place = interpolation.contact_point(
        recording(
            x=np.array([[0.0, 4.0, 8.0], [20.0, 20.0, 9.0]]),
            y=np.zeros((2, 3)),
            heading=np.zeros((2, 3)),
            center_x=np.zeros(2),
            collisions=(Collision(1.0, ("Ego", "P")),),
        ),
        1.0,
        0,
        1,
    )
    # The front of the ego is at 10 m, the back of the other at 8.75 m.
    assert place.tolist() == [8.875, 0.0]


def test_the_ego_sees_past_a_box_but_not_through_it():
    at = {"heading": np.zeros((3, 2)), "speed": np.zeros((3, 2))}
    moving = interpolation.Motion(
        np.array([[0.0, 0.0], [20.0, 20.0], [10.0, np.nan]]), np.zeros((3, 2)), **at,
        length=np.array([4.0, 4.0, 4.0]), width=np.array([2.0, 2.0, 2.0]),
    )  # fmt: skip
    assert not interpolation.is_visible(moving, 0, 1, 0)
    assert interpolation.is_visible(moving, 0, 2, 0)
    # The third one is gone.
    assert interpolation.is_visible(moving, 0, 1, 1)


def test_a_shadow_lies_behind_the_box_as_wide_as_it_is_seen():
    at = {"y": np.zeros((2, 1)), "heading": np.zeros((2, 1)), "speed": np.zeros((2, 1))}
    ahead = interpolation.Motion(
        np.array([[0.0], [11.0]]), **at, length=np.array([4.0, 2.0]), width=np.array([2.0, 4.0])
    )
    area = interpolation.hidden_area(ahead, 0, 1, 0)
    assert area is not None
    # The eye is at 1 m, the near corners at 10 m to both sides by 2 m.
    assert np.allclose(area[[0, 3]], [[10.0, -2.0], [10.0, 2.0]])
    assert np.allclose(
        (area[2] - [1.0, 0.0]) / np.hypot(*(area[2] - [1.0, 0.0])), np.array([9.0, 2.0]) / np.hypot(9, 2)
    )
    around = interpolation.Motion(
        np.array([[0.0], [1.5]]), **at, length=np.array([4.0, 2.0]), width=np.array([2.0, 4.0])
    )
    assert interpolation.hidden_area(around, 0, 1, 0) is None


def test_the_road_is_found_beside_the_study_or_told_why_not(study, failing, tmp_path):
    with StudyFile.open(study, readonly=True) as opened:
        region = recorded_bounds([opened.recording(1)])
        sketch, missing = find_road_outline(opened, region, X / "x_intersection.xosc")
        assert sketch is not None
        assert missing == ""
        assert find_road_outline(opened, None) == (None, "")
        # Who has a file of that name at hand, but another one, is not shown its road.
        with pytest.raises(InputError):
            find_road_outline(opened, region, EXAMPLES / "t_intersection" / "t_intersection.xosc")
    with StudyFile.open(failing, readonly=True) as opened:
        sketch, missing = find_road_outline(opened, (0.0, 0.0, 1.0, 1.0))
        assert sketch is None
        assert str(failing.parent) not in missing


def test_a_value_of_a_study_leads_to_no_other_road(study, tmp_path):
    for name in ("x_intersection.xosc", "x_intersection.xodr"):
        text = (X / name).read_text(encoding="utf-8")
        declared = '<ParameterDeclaration name="Road" parameterType="string" value="x_intersection.xodr"/>'
        text = text.replace("<ParameterDeclarations>", f"<ParameterDeclarations>{declared}", 1)
        text = text.replace('<LogicFile filepath="x_intersection.xodr"', '<LogicFile filepath="$Road"')
        (tmp_path / name).write_text(text, encoding="utf-8")
    shutil.copy(X / "x_intersection.xodr", tmp_path / "secret.xodr")
    scenario = ScenarioFile.read(tmp_path / "x_intersection.xosc")
    with StudyFile.open(study, readonly=True) as opened:
        meta = replace(opened.meta, fingerprint=scenario.fingerprint())
    with StudyFile.create(tmp_path / "s.db", meta) as sent:
        sketch, missing = find_road_outline(sent, (0.0, 0.0, 9.0, 9.0), scenario, {"Road": "secret.xodr"})
        assert sketch is None
        assert missing == "The road is not drawn, as it is none of those that belong to x_intersection.xosc."
        assert find_road_outline(sent, (0.0, 0.0, 9.0, 9.0), scenario, {"Road": "x_intersection.xodr"})[0] is not None


@pytest.mark.parametrize("what", ["one instant", "no ego", "nobody"])
def test_recordings_that_hold_little_are_shown_all_the_same(study, what):
    with StudyFile.open(study, readonly=True) as opened:
        footage = read_replay_data(opened, [1])
    take = footage.items[0]
    drawn, course = take.recording, take.courses["wttc"]
    names = ("x", "y", "heading", "speed", "acceleration")
    if what == "one instant":
        changes = {name: getattr(drawn, name)[:, :1] for name in names} | {"time": drawn.time[:1], "collisions": ()}
        course = course[:1]
    else:
        gone = np.array([what == "nobody" or name == "Ego" for name in drawn.names])
        changes = {name: np.where(gone[:, None], np.nan, getattr(drawn, name)) for name in names}
        course = np.full(len(course), np.nan) if what == "nobody" else course
    little = replace(footage, items=(replace(take, recording=replace(drawn, **changes), courses={"wttc": course}),))
    frames = list(FrameRenderer(little, dpi=50).render_frames(np.array([little.start_time, little.end_time])))
    assert [frame.shape for frame in frames] == [(360, 480, 3)] * 2
    assert "contents" in render_replay_page(little)
