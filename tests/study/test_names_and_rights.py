"""Studies under names of any bytes, and where nobody may write."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import cornercase as cc
from cornercase import SimulationError
from cornercase._common.errors import InputError
from cornercase.study import StudyFile
from helpers.command_line import cornercase
from helpers.synthetic_study import SPACE, about

EXAMPLE = Path(cc.__file__).parents[2] / "examples" / "x_intersection"
POINTS = np.array([[0.25, 0.5], [0.5, 0.25]])
NO_TEXT = os.fsdecode(b"\xff\xfe.db")


def made(path):
    with StudyFile.create(path, about(SPACE, "distance")) as study:
        study.writer.add_pending(1, POINTS, SPACE.values(POINTS))
        study.writer.record_failure(1, SimulationError("told"))
    return path


@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
@pytest.mark.skipif(sys.platform != "linux", reason="names are text there")
def test_a_study_may_have_a_name_that_is_no_text(tmp_path):
    path = tmp_path / NO_TEXT
    cc.explore(
        EXAMPLE / "x_intersection.xosc", path, ego="Ego", other="Pedestrian", metrics=["distance"], optimizer="sobol",
        space=EXAMPLE / "x_intersection.space.xosc", budget=3, duration=4.0, time_step=0.2,
    )  # fmt: skip
    assert cornercase("show", path).returncode == cornercase("verify", path).returncode == 0
    assert cornercase("report", path, "-o", tmp_path / "page.html").returncode == 0
    assert "\\udcff" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.skipif(sys.platform != "linux", reason="names are text there")
def test_a_scenario_file_whose_name_is_no_text_is_refused_before_a_study_is_made(tmp_path):
    for one in EXAMPLE.iterdir():
        shutil.copy(one, tmp_path / one.name)
    scenario = tmp_path / os.fsdecode(b"\xff.xosc")
    (tmp_path / "x_intersection.xosc").rename(scenario)
    result = cornercase(
        "explore", scenario, "--space", tmp_path / "x_intersection.space.xosc", "--ego", "Ego", "--other", "Pedestrian",
        "--metric", "distance", "-o", tmp_path / "s.db",
    )  # fmt: skip
    assert result.returncode == 2
    assert "holds half a character" in result.stderr
    assert not (tmp_path / "s.db").exists()
    result = cornercase("convert", EXAMPLE / "x_intersection.xosc", "--ego", "Ego", "-o", scenario.with_name(NO_TEXT))
    assert result.returncode == 2
    assert "its name has characters that XML cannot hold" in result.stderr
    result = cornercase("vary", EXAMPLE / "x_intersection.xosc", "--all", "-o", scenario.with_name(NO_TEXT))
    assert (result.returncode, "its name has characters that XML cannot contain" in result.stderr) == (2, True)


def test_a_study_that_may_only_be_read_is_not_written_and_nothing_is_left_beside_it(tmp_path):
    path = made(tmp_path / "s.db")
    path.chmod(0o444)
    if os.access(path, os.W_OK):
        pytest.skip("whoever may do anything may write")
    with StudyFile.open(path) as study:
        assert len(study.rows()) == 2
    with pytest.raises(InputError, match="is read-only"):
        StudyFile.open(path, readonly=False)
    # What a reader left would be only for reading too, and keep its owner out.
    assert [one.name for one in tmp_path.iterdir()] == ["s.db"]
    path.chmod(0o644)
    StudyFile.open(path, readonly=False).close()
