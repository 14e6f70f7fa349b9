"""Recordings of other tools: ASAM OSI traces and CommonRoad scenarios."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from cornercase._common.errors import InputError
from cornercase.cli import app
from cornercase.metrics import Ttc
from cornercase.recordings import read_recording
from helpers.foreign_recordings import TIMES, commonroad, multi_channel, osi_messages, single_channel, state


@pytest.mark.parametrize("kind", ["GroundTruth", "SensorView"])
@pytest.mark.parametrize("ending", [".osi", ".osi.xz", ".mcap"])
def test_osi_traces_of_all_forms(tmp_path, kind, ending):
    path = tmp_path / f"trace{ending}"
    path = multi_channel(path, kind) if ending == ".mcap" else single_channel(path, osi_messages(kind))
    read = read_recording(path)
    assert read.names == ("4", "17", "5")
    assert read.object_types == ("car", "truck", "pedestrian")
    np.testing.assert_allclose(read.time, TIMES, atol=1e-9)
    np.testing.assert_allclose(read.speed[:2], np.array([[20.0] * 20, [10.0] * 20]))
    assert np.isnan(read.x[2, :10]).all()
    # The pedestrian's speed follows from its positions.
    np.testing.assert_allclose(read.speed[2, 10:], 1.0)
    np.testing.assert_allclose(Ttc().course(read, "4", "17"), 3.0 - TIMES, atol=1e-9)


def test_osi_traces_that_are_cut_off_or_of_something_else(tmp_path):
    whole = single_channel(tmp_path / "whole.osi", osi_messages("GroundTruth")).read_bytes()
    for share in range(1, 10):
        path = tmp_path / f"cut{share}.osi"
        path.write_bytes(whole[: len(whole) * share // 10 + 1])
        with pytest.raises(InputError, match=rf"cut{share}\.osi: .*(cut off|holds no)"):
            read_recording(path)
    mcap = multi_channel(tmp_path / "whole.mcap", "GroundTruth").read_bytes()
    for share in range(1, 10):
        path = tmp_path / f"cut{share}.mcap"
        path.write_bytes(mcap[: len(mcap) * share // 10])
        with pytest.raises(InputError, match=rf"cut{share}\.mcap: "):
            read_recording(path)
    for name in ("noise.osi", "noise.mcap", "noise.xz"):
        (tmp_path / name).write_bytes(b"\x10\x00\x00\x00" + bytes(range(200)))
        with pytest.raises(InputError, match=name):
            read_recording(tmp_path / name)
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(InputError, match=name):
            read_recording(tmp_path / name)
    with pytest.raises(InputError, match=r"missing\.osi: cannot be read"):
        read_recording(tmp_path / "missing.osi")


def test_commonroad_scenarios(tmp_path):
    read = read_recording(commonroad(tmp_path / "scene.xml"))
    assert read.names == ("42", "43", "44")
    assert read.object_types == ("car", "car", "car")
    np.testing.assert_allclose(read.time, np.arange(21) * 0.1)
    np.testing.assert_allclose(Ttc().course(read, "42", "43"), 3.0 - read.time, atol=1e-9)
    assert (read.x[2] == 20.0).all()
    assert (read.speed[2] == 0.0).all()
    np.testing.assert_allclose(read.acceleration, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("extra", "head", "sentence"),
    [
        ("", "<!DOCTYPE a [<!ENTITY b 'c'>]>", "document type declaration"),
        ("<dynamicObstacle id='7'><type>car</type></dynamicObstacle>", "", "cannot read it"),
        (
            "<dynamicObstacle id='7'><type>car</type><shape><polygon>"
            + "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in ((0, 0), (4, 0), (4, 2), (0, 2)))
            + f"</polygon></shape>{state('initialState', '60.0', '0.0', 0, 5.0)}"
            + f"<trajectory>{state('state', '60.5', '0.0', 1, 5.0)}</trajectory></dynamicObstacle>",
            "",
            "obstacle 7 has the shape Polygon",
        ),
    ],
)
def test_commonroad_files_that_cannot_be_measured(tmp_path, extra, head, sentence):
    with pytest.raises(InputError, match=sentence):
        read_recording(commonroad(tmp_path / "scene.xml", extra, head))


def test_without_the_extra_the_message_names_it(tmp_path, monkeypatch):
    trace = single_channel(tmp_path / "trace.osi", osi_messages("GroundTruth"))
    monkeypatch.setitem(sys.modules, "osi3", None)
    with pytest.raises(InputError, match=r"pip install 'cornercase\[osi\]'"):
        read_recording(trace)
    monkeypatch.setitem(sys.modules, "commonroad.common.file_reader", None)
    with pytest.raises(InputError, match=r"pip install 'cornercase\[commonroad\]'"):
        read_recording(commonroad(tmp_path / "scene.xml"))


def test_a_trace_is_measured_on_the_command_line(tmp_path):
    trace = single_channel(tmp_path / "trace.osi", osi_messages("SensorView"))
    run = CliRunner().invoke(
        app, ["measure", str(trace), "--ego", "4", "--other", "17", "--metric", "ttc", "-o", str(tmp_path / "c.csv")]
    )
    assert run.exit_code == 0, run.output
    rows = (tmp_path / "c.csv").read_text().splitlines()
    assert rows[0] == "time,ttc"
    assert float(rows[-1].split(",")[1]) == pytest.approx(1.1)
