"""Recordings made to do harm, on `measure` and `import`: one sentence each, and nothing is written."""

from __future__ import annotations

import lzma
import os
import struct
from importlib.util import find_spec

import pytest

from cornercase.recordings._recording import CSV_COLUMNS
from helpers import foreign_recordings as foreign
from helpers.command_line import cornercase

HEADER = ",".join(CSV_COLUMNS)
OSI = pytest.mark.skipif(find_spec("osi3") is None, reason="needs the extra 'osi'")
COMMONROAD = pytest.mark.skipif(find_spec("commonroad") is None, reason="needs the extra 'commonroad'")


def row(time, name, x="0"):
    return f"{time},{name},car,{x},0,0,1,0,4,2,1"


def written(name, content):
    def make(folder):
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / name

    return make


def table(*rows, header=HEADER):
    return written("r.csv", "\n".join((header, *rows)) + "\n")


def erg(about=lambda text: text, data=lambda data: data):
    def make(folder):
        path = folder / "r.erg"
        foreign.erg(path)
        path.write_bytes(data(path.read_bytes()))
        info = path.with_name("r.erg.info")
        info.write_text(about(info.read_text()))
        return path

    return make


def carla(change):
    def make(folder):
        foreign.carla(folder / "r.log")
        (folder / "r.log").write_bytes(change((folder / "r.log").read_bytes()))
        return folder / "r.log"

    return make


def without_info(folder):
    path = erg()(folder)
    path.with_name("r.erg.info").unlink()
    return path


def endless(name):
    def make(folder):
        (folder / name).symlink_to("/dev/zero")
        return folder / name

    return make


def a_folder(folder):
    (folder / "r.csv").mkdir()
    return folder / "r.csv"


def fcd(vehicle='x="0" y="0" angle="90" speed="1"', before="", times=("0", "1")):
    steps = "".join(
        f'<timestep time="{t}"><vehicle id="Ego" {vehicle}/><vehicle id="B" {vehicle}/></timestep>' for t in times
    )
    return written("r.xml", f"{before}<fcd-export>{steps}</fcd-export>")


BOMB = "<!DOCTYPE a [<!ENTITY a0 'ha'>" + "".join(f"<!ENTITY a{i} '{10 * f'&a{i - 1};'}'>" for i in range(1, 12)) + "]>"
CUT = "is cut off or damaged"

HOSTILE = {
    "no text": (written("r.csv", b"\0" * 1000), "the header lacks"),
    "no UTF-8": (written("r.csv", b"\xff\xfe" * 100), "not a CSV table in UTF-8"),
    "a short row": (table(row(0, "Ego"), "0,B,car"), "line 3: has too many or too few fields"),
    "a long row": (table(row(0, "Ego") + ",1,2"), "line 2: has too many or too few fields"),
    "an endless field": (table(row(0, "E" * 200_000)), "field larger than field limit"),
    "an endless quote": (table('"abc' + "\n" * 1000), "has too many or too few fields"),
    "each entity at an instant of its own": (table(*(row(k, f"n{k}") for k in range(6000))), "at most 20000000 states"),
    "a time without end": (table(row("inf", "Ego"), row("inf", "B")), "every row needs a finite time"),
    "a table with an infinite position": (table(row(0, "Ego", "inf"), row(0, "B")), "has a position of inf"),
    "a table with a position of 1e300": (table(row(0, "Ego"), row(0, "B", "-1e300")), "has a position of 1e+300"),
    "a table with an infinite speed": (
        table(*(row(0, name).replace(",0,0,1,0,4", ",0,0,inf,0,4") for name in ("Ego", "B"))),
        "has a speed of inf",
    ),
    "a folder": (a_folder, "is not a file"),
    "a device as a table": (endless("r.csv"), "is not a file"),
    "a device as a CarMaker result": (endless("r.erg"), "is not a file"),
    "a device as a CARLA log": (endless("r.log"), "is not a file"),
    "a device as XML": (endless("r.xml"), "is not a file"),
    "records of 100 GB": (erg(lambda text: text.replace("3 Bytes", "99999999999 Bytes")), "which is not known"),
    "records without content": (
        erg(
            lambda _: "File.At.1.Name = Time\nFile.At.1.Type = 0 Bytes\n", lambda data: data[:10] + b"\0\0" + data[12:]
        ),
        "all quantities have a size of 0 bytes",
    ),
    "a quantity twice": (erg(lambda text: text.replace("Car.v", "Time")), "names a quantity twice"),
    "blanks without end": (erg(lambda text: text + "File.At.1.Type =" + " " * 200_000 + "x" + "\n" * 200_000), "'x'"),
    "no quantities": (erg(lambda _: ""), "names no quantity"),
    "half a record": (erg(data=lambda data: data[:-5]), "is cut in the middle"),
    "records of NaN": (erg(data=lambda data: data[:16] + b"\xff" * (len(data) - 16)), "a time that is not finite"),
    "positions of 1e308": (erg(data=lambda data: data[:24] + b"\x7f" * (len(data) - 24)), "are read|not finite"),
    "no info": (without_info, "cannot be read"),
    "a packet of 4 GB": (carla(lambda data: data + struct.pack("<BI", 6, 0xFFFFFFFF)), CUT),
    "a count without content": (carla(lambda data: data + struct.pack("<BIH", 6, 2, 0xFFFF)), CUT),
    "a cut log": (carla(lambda data: data[:-3]), CUT),
    "entities in XML": (fcd(before=BOMB), "document type|not well-formed"),
    "an infinite angle": (fcd('x="0" y="0" angle="inf" speed="1"'), "needs a number in 'angle', not 'inf'"),
    "an infinite position": (fcd('x="-inf" y="0" angle="0" speed="1"'), "needs a number in 'x'"),
    "a position of 1e308": (fcd('x="1e308" y="0" angle="0" speed="1"'), "has a position of 1e+308"),
    "cut XML": (written("r.xml", "<fcd-export><timestep"), "not well-formed"),
    "deep XML": (written("r.xml", "<fcd-export>" + "<a>" * 5000), "not well-formed"),
    "an esmini log without numbers": (
        written("r.csv", "esmini GIT REV\nIndex [-], TimeStamp [s], #x Entity_Name [-], #\n0, 0, a, \n"),
        "holds no moving entity",
    ),
}
OF_OSI = {
    "a message of 4 GB": (written("r.osi", struct.pack("<I", 0xFFFFFFFF) + b"x"), "a message of 4294967295 bytes"),
    "junk": (written("r.osi", b"\x05\0\0\0" + b"\xff" * 1000), "broken or cut off|a message of"),
    "nothing": (written("r.osi", b""), "holds no GroundTruth"),
    "a packed message of 2 GB": (
        written("r.xz", lzma.compress(struct.pack("<I", 0x7FFFFFFF) + bytes(10_000_000), preset=0)),
        "a message of 2147483647 bytes",
    ),
    "no packed file": (written("r.xz", b"x" * 100), "broken or cut off"),
    "no channels": (written("r.mcap", b"\x89MCAP0\r\n" + b"\xff" * 200), "not an MCAP file"),
    "an empty file of channels": (written("r.mcap", b""), "not an MCAP file"),
    "nothing between the magic words": (written("r.mcap", b"\x89MCAP0\r\n\x89MCAP0\r\n"), "cannot be read"),
}
OF_COMMONROAD = {
    "an included file": (
        written(
            "r.xml",
            '<commonRoad xmlns:xi="http://www.w3.org/2001/XInclude"><xi:include href="file:///etc/passwd"'
            ' parse="text"/></commonRoad>',
        ),
        "commonroad-io cannot read it",
    ),
    "a scenario of nothing": (written("r.xml", '<commonRoad timeStepSize="x"/>'), "commonroad-io cannot read it"),
}
CASES = [
    *(pytest.param(*one, id=name) for name, one in HOSTILE.items()),
    *(pytest.param(*one, id=name, marks=OSI) for name, one in OF_OSI.items()),
    *(pytest.param(*one, id=name, marks=COMMONROAD) for name, one in OF_COMMONROAD.items()),
]


@pytest.mark.parametrize(("make", "said"), CASES)
def test_a_hostile_recording_is_refused_in_one_sentence(tmp_path, make, said):
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    out.mkdir()
    path = make(folder)
    (folder / "good.csv").write_text("\n".join((HEADER, *(row(t, n) for t in (0, 1) for n in ("Ego", "C")))))
    (folder / "parameters.csv").write_text(f"file,v\n{path.name},1\ngood.csv,2\n")
    names = ("--ego", "Ego", "--other", "B", "--metric", "distance")
    measured = cornercase("measure", path, *names, "-o", out / "courses.csv")
    imported = cornercase("import", folder, *names, "-o", out / "s.db")
    for result in (measured, imported):
        assert result.returncode == 2
        lines = result.stderr.strip().splitlines()
        assert len(lines) == 1
        assert lines[0].startswith("cornercase: ")
        assert len(lines[0]) < 1500
    assert any(word in measured.stderr for word in said.split("|"))
    assert not list(out.iterdir())


def test_a_table_of_recordings_may_be_hostile_too(tmp_path):
    (tmp_path / "r.csv").write_text("\n".join((HEADER, *(row(t, n) for t in (0, 1) for n in ("Ego", "B")))))
    for content in (
        b"\0" * 100,
        b"file,v\n" + b'"' * 200_001,
        b"file,v\nr.csv,1\n../../etc/passwd\0,2\n",
        b"file,v\nr.csv\n",
    ):
        (tmp_path / "parameters.csv").write_bytes(content)
        result = cornercase(
            "import", tmp_path, "--ego", "Ego", "--other", "B", "--metric", "distance", "-o", tmp_path / "s.db"
        )
        assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
    assert not (tmp_path / "s.db").exists()


PIPES = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes in folders here")


@PIPES
@pytest.mark.parametrize("name", ["r.csv", "r.erg", "r.log", "r.xml", "r.osi", "r.xz", "r"])
def test_a_pipe_is_no_recording_and_nobody_waits_for_it(tmp_path, name):
    os.mkfifo(tmp_path / name)
    result = cornercase("measure", tmp_path / name, "--ego", "Ego", "--other", "B", "-o", tmp_path / "out.csv")
    assert result.returncode == 2
    assert "is not a file" in result.stderr
    assert not (tmp_path / "out.csv").exists()


@PIPES
def test_a_table_of_recordings_is_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "endless.csv").symlink_to("/dev/zero")
    (tmp_path / "long.csv").write_text(",".join(f"column{k}" for k in range(10_000)) + "\n")
    options = ("--ego", "Ego", "--other", "B", "--metric", "ttc", "-o", tmp_path / "s.db")
    for name, said in (("pipe", "is not a file"), ("endless", "is not a file"), ("long", "needs a header with 'file'")):
        result = cornercase("import", tmp_path, "--parameters", tmp_path / f"{name}.csv", *options)
        assert (result.returncode, len(result.stderr.splitlines())) == (2, 1)
        assert said in result.stderr
        assert len(result.stderr) < 1500
    assert not (tmp_path / "s.db").exists()


def test_a_link_that_leads_to_itself_is_no_output(tmp_path):
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    table(row(0, "Ego"), row(0, "B", "9"), row(1, "Ego"), row(1, "B", "9"))(tmp_path)
    result = cornercase(
        "measure",
        tmp_path / "r.csv",
        "--ego",
        "Ego",
        "--other",
        "B",
        "--metric",
        "distance",
        "-o",
        tmp_path / "loop.csv",
    )
    assert (result.returncode, len(result.stderr.splitlines())) == (2, 1)
    assert "is a broken link" in result.stderr
