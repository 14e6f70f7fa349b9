"""Recordings of esmini, SUMO, CarMaker and CARLA."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.recordings import read_recording
from cornercase.recordings.formats._erg import read_erg_columns
from helpers import foreign_recordings as foreign
from helpers.command_line import cornercase
from helpers.foreign_recordings import HEADING, SPEED, TIME, way

SAMPLES = Path(__file__).parents[3] / "shared" / "reference" / "simulators"
beside = pytest.mark.skipif(not SAMPLES.is_dir(), reason="the real samples are not beside the checkout")
# Offset of the box center from the position in the file, boxes, and names.
FILES = {
    "a.csv": (foreign.esmini, (1.4, 1.4), ((5.0, 2.0), (5.0, 2.0)), ("Ego", "Other"), ("car", "car")),
    "a.erg": (foreign.erg, (2.25, 2.25), ((4.5, 1.8), (4.5, 1.8)), ("Ego", "T00"), ("car", "car")),
    "a.log": (
        foreign.carla, (0.1, 0.0), ((5.0, 2.0), (0.4, 0.6)), ("hero", "walker.pedestrian.0001"), ("car", "pedestrian")
    ),
    "a.xml": (foreign.fcd, (-2.5, 0.0), ((5.0, 1.8), (0.215, 0.478)), ("Ego", "P"), ("car", "pedestrian")),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_motion_and_boxes(tmp_path, name):
    write, ahead, boxes, names, kinds = FILES[name]
    write(tmp_path / name)
    found = read_recording(tmp_path / name)
    assert found.names == names
    assert found.object_types == kinds
    np.testing.assert_allclose(found.time, TIME, atol=1e-9)
    for k, (beyond, apart) in enumerate(zip(ahead, (0.0, 30.0), strict=True)):
        x, y = way(TIME, apart + beyond)
        np.testing.assert_allclose(found.x[k], x, atol=2e-5)
        np.testing.assert_allclose(found.y[k], y, atol=2e-5)
        np.testing.assert_allclose(found.heading[k], HEADING, atol=1e-5)
        np.testing.assert_allclose(found.speed[k], SPEED, atol=2e-3)
        assert (found.length[k], found.width[k]) == pytest.approx(boxes[k], abs=1e-6)
    assert not found.center_x.any()


@beside
def test_a_real_result_of_carmaker():
    columns = read_erg_columns(SAMPLES / "carmaker" / "example.erg")
    assert (len(columns), columns["Time"].size, columns["Time"][-1]) == (29, 5000, pytest.approx(4.999))
    # Redundant quantities of CarMaker agree: acceleration and speed, wheel rotation.
    moves = columns["Vhcl.v"] > 2.0
    gained = np.gradient(columns["Vhcl.v"].astype(float), columns["Time"])
    np.testing.assert_allclose(gained[moves], columns["Car.ax"][moves], atol=0.35)
    radius = columns["Vhcl.v"][moves] / columns["Car.WheelSpd_RL"][moves]
    assert 0.28 < radius.min() <= radius.max() < 0.36
    with pytest.raises(InputError, match=r"has no Car.tx, Car.ty, Car.Yaw, Car.v; add it to the quantities"):
        read_recording(SAMPLES / "carmaker" / "example.erg")


@beside
def test_a_real_recording_of_carla():
    found = read_recording(SAMPLES / "carla" / "DistanceToLaneCenter.log")
    assert (found.names, found.object_types, found.time.size) == (("hero",), ("car",), 431)
    # Lincoln MKZ 2017, from CARLA's vehicle catalogue.
    assert (found.length[0], found.width[0]) == pytest.approx((4.9017, 2.1283), abs=1e-3)
    way = np.hypot(np.diff(found.x[0]), np.diff(found.y[0]))
    assert way.sum() == pytest.approx((found.speed[0][1:] * np.diff(found.time)).sum(), rel=0.01)
    assert found.collisions == ()


@pytest.mark.parametrize(
    ("roles", "names"),
    [
        (("my car", "my truck"), ("my car", "my truck")),
        (("my car", "my car"), ("my car 5", "my car 6")),
        (("hero", "hero 5"), ("hero", "hero 5 6")),
    ],
)
def test_carlas_roles_may_have_spaces(tmp_path, roles, names):
    foreign.carla(tmp_path / "a.log", roles)
    assert read_recording(tmp_path / "a.log").names == names


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("tenth", range(10))
def test_what_is_cut_off_is_said_in_one_sentence(tmp_path, name, tenth):
    FILES[name][0](tmp_path / name)
    data = (tmp_path / name).read_bytes()
    # A cut at the end of a record cannot be detected.
    (tmp_path / name).write_bytes(data[: len(data) * tenth // 10 + 3])
    with pytest.raises(InputError) as caught:
        read_recording(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_carmakers_files_have_to_fit(tmp_path):
    path = tmp_path / "a.erg"
    foreign.erg(path)
    columns = read_erg_columns(path)
    assert "Padding" not in columns
    assert columns["Driver.GearNo"].tolist() == TIME.astype(int).tolist()
    about = tmp_path / "a.erg.info"
    text = about.read_text()
    for change, words in (
        (("= Int", "= Double"), "has records of"),
        (("= Int", "= Word"), "type 'Word', which is not known"),
        (("File.At", "File.On"), "names no quantity"),
    ):
        about.write_text(text.replace(*change))
        with pytest.raises(InputError, match=words):
            read_recording(path)
    about.unlink()
    with pytest.raises(InputError, match=r"a\.erg\.info: cannot be read"):
        read_recording(path)
    foreign.erg(path, without=("Car.tx", "Car.Yaw"))
    with pytest.raises(InputError, match=r"has no Car.tx, Car.Yaw; add it to the quantities"):
        read_recording(path)
    # Without velocities, the heading is the direction of motion.
    foreign.erg(path, without=("Traffic.T00.v_0.x",))
    found = read_recording(path)
    np.testing.assert_allclose(found.heading[1], HEADING, atol=1e-4)
    np.testing.assert_allclose(found.speed[1], SPEED, atol=1e-3)


def test_files_that_are_something_else(tmp_path):
    for name, text in (("a.log", "log of a server"), ("a.erg", "x" * 99), ("a.csv", "esmini GIT REV: 1\nno header\n")):
        (tmp_path / name).write_text(text)
        (tmp_path / f"{name}.info").write_text("")
        with pytest.raises(InputError, match=r"recorder|CM-ERG|Index"):
            read_recording(tmp_path / name)
    (tmp_path / "b.xml").write_text("<fcd-export><timestep time='x'/></fcd-export>")
    with pytest.raises(InputError, match="line 1: <timestep> needs a number in 'time'"):
        read_recording(tmp_path / "b.xml")


def test_what_sumo_really_writes(tmp_path):
    pytest.importorskip("libsumo", reason="SUMO comes with the extra 'sumo'")
    from shutil import which

    (tmp_path / "n.nod.xml").write_text("<nodes><node id='a' x='0' y='0'/><node id='b' x='300' y='0'/></nodes>")
    (tmp_path / "e.edg.xml").write_text("<edges><edge id='ab' from='a' to='b' speed='20'/></edges>")
    (tmp_path / "r.rou.xml").write_text(
        "<routes><vehicle id='v' depart='0' departPos='50' departSpeed='10'><route edges='ab'/></vehicle></routes>"
    )
    from cornercase.simulators.sumo._network import _find_netconvert

    net = tmp_path / "n.net.xml"
    subprocess.run(
        [_find_netconvert(), "-n", tmp_path / "n.nod.xml", "-e", tmp_path / "e.edg.xml", "-o", net,
         "--offset.disable-normalization", "true"], check=True, capture_output=True,
    )  # fmt: skip
    sumo = which("sumo") or _find_netconvert().replace("netconvert", "sumo")
    subprocess.run(
        [sumo, "-n", net, "-r", tmp_path / "r.rou.xml", "--fcd-output", tmp_path / "f.xml", "--step-length", "0.1",
         "--end", "5"], check=True, capture_output=True,
    )  # fmt: skip
    found = read_recording(tmp_path / "f.xml")
    assert found.names == ("v",)
    # Its front is at 50 m.
    assert found.x[0, 0] == pytest.approx(47.5, abs=0.01)
    assert found.heading[0] == pytest.approx(np.zeros(found.time.size), abs=1e-6)
    assert np.diff(found.x[0]) == pytest.approx(0.1 * found.speed[0, 1:], abs=0.05)


@pytest.mark.parametrize("name", FILES)
def test_measure_reads_them(tmp_path, name):
    write, _, _, names, _ = FILES[name]
    write(tmp_path / name)
    done = cornercase(
        "measure", tmp_path / name, "--ego", names[0], "--other", names[1], "--metric", "distance",
        "-o", tmp_path / "courses.csv",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "courses.csv").read_text().startswith("time,distance")
