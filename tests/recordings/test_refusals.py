"""Recordings of other tools that cannot be used are refused in one sentence."""

from __future__ import annotations

import pytest

from cornercase._common.errors import InputError
from cornercase.metrics import measure
from cornercase.recordings import read_recording
from cornercase.recordings._from_samples import EntitySamples, recording_from_samples
from cornercase.recordings.formats._esmini_log import ESMINI_LOG_START

HEADER = f"{ESMINI_LOG_START}\nIndex [-], TimeStamp [s], #1 Entity_Name [-]"
FCD = '<fcd-export><timestep time="{}"><vehicle id="a" x="{}" y="0" angle="90" speed="1"{}/></timestep></fcd-export>'


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("log.csv", ESMINI_LOG_START.encode() + b"\n\xff", "cannot be read"),
        ("log.csv", f"{HEADER},\n".encode(), "the header lacks '#1 "),
        ("log.csv", ESMINI_LOG_START.encode(), "has no header beginning with 'Index"),
        ("fcd.xml", FCD.format("0", "here", "").encode(), "line 1: <vehicle> needs a number in 'x', not 'here'"),
        ("fcd.xml", FCD.format("nan", "0", "").encode(), "a time that is not finite"),
        ("fcd.xml", FCD.format("0", "0", ' length="-1" width="2"').encode(), "a has a box of -1.0 m x 2.0 m"),
        ("fcd.xml", b"<fcd-export><timestep time='0'/></fcd-export>", "holds no moving entity"),
        ("run.log", b"something else", "is not a file of CARLA's recorder"),
    ],
)
def test_a_file_that_cannot_be_used(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words) as refused:
        read_recording(tmp_path / name)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["run.log", "run.erg", "trace.osi", "trace.mcap", "fcd.xml", "table.csv"])
def test_a_file_that_is_not_there(tmp_path, name):
    with pytest.raises(InputError, match=r"cannot be read|no such file|No such file"):
        read_recording(tmp_path / name)


def test_the_attributes_of_a_vehicle_go_before_its_type(tmp_path):
    (tmp_path / "fcd.xml").write_text(FCD.format("0", "0", ' length="7" width="2.5"'))
    read = read_recording(tmp_path / "fcd.xml")
    assert (read.length[0], read.width[0]) == (7.0, 2.5)


def test_one_sample_is_a_recording_without_speed(tmp_path):
    track = EntitySamples("car", 4.0, 2.0)
    track.samples[1.0] = (3.0, 4.0, 0.0, float("nan"), float("nan"))
    read = recording_from_samples(tmp_path / "one", {"A": track})
    assert (read.x[0, 0], read.y[0, 0], read.time.tolist()) == (3.0, 4.0, [1.0])


@pytest.mark.parametrize("wrong", [None, 3, ""])
def test_what_is_no_path_is_refused(wrong):
    with pytest.raises(InputError, match="`path` "):
        read_recording(wrong)
    with pytest.raises(InputError, match="`recording` "):
        measure(wrong, "Ego", "Other")
