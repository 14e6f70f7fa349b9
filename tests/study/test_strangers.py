"""A study that someone else sent is data: nothing of it is run, and no file is read that it names."""

from __future__ import annotations

import csv
import functools
import io
import json
import os
import pickle
import sqlite3
import sys
import zipfile
import zlib
from contextlib import closing
from typing import Any

import numpy as np
import pandas as pd
import pytest

import cornercase as cc
from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.recordings import read_recording
from cornercase.study import StudyFile
from cornercase.study._codec import pack_arrays, unpack_arrays
from helpers.command_line import cornercase
from helpers.synthetic_study import SPACE, about
from helpers.untrusted_files import change, copied, set_meta, whole_study

HARM = "from pathlib import Path\nPath('harm').touch()\nclass Driver:\n    settings = {}\n"

_OPENED: list[str] = []
_watching = False


def _watch(event, arguments):
    if _watching and event in ("open", "import", "os.listdir", "os.scandir", "exec"):
        _OPENED.append(str(arguments[0]))


# A hook cannot be taken away again.
sys.addaudithook(_watch)


@pytest.fixture
def opened_files(monkeypatch):
    _OPENED.clear()
    monkeypatch.setattr(sys.modules[__name__], "_watching", True)
    return _OPENED


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return whole_study(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def sent(whole, tmp_path, monkeypatch):
    """A copy of the study in the current folder, without the scenario file."""
    study = copied(whole, tmp_path / "sent")
    for name in ("scenario.xosc", "road.xodr"):
        (study.parent / name).unlink()
    monkeypatch.chdir(study.parent)
    return study


def every_command(study):
    folder = study.parent
    yield "show", study
    yield "show", study, "--json"
    yield "export", study, "-o", folder / "tables"
    yield "report", study, "-o", folder / "r.html"
    yield "replay", study, "1", "-o", folder / "run.html"
    yield "reduce", study, "-o", folder / "reduced"
    yield "analyze", study


@pytest.mark.usefixtures("no_cache")
def test_no_path_in_a_study_is_read_and_nothing_in_it_is_imported(sent, tmp_path, opened_files):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for name in ("secret.xosc", "secret.csv", "harmful.py"):
        (elsewhere / name).write_text(HARM)
    (sent.parent / "harmful.py").write_text(HARM)
    named = str(elsewhere / "secret.xosc")
    set_meta(
        sent, scenario=named, simulator=f"harmful:Driver,testrun={named}", optimizer="harmful:Driver",
        settings={"drivers": {"Ego": "harmful:Driver"}, "table": str(elsewhere / "secret.csv"), "library": named},
        files=[str(elsewhere / "secret.csv")] * 12,
    )  # fmt: skip
    opened_files.clear()
    for one in every_command(sent):
        result = cornercase(*one)
        assert result.returncode == (2 if one[0] == "reduce" else 0), result.stderr
        if one[0] == "reduce":
            assert (
                "the scenario file 'secret.xosc' was not found beside the study, in the current folder" in result.stderr
            )
            assert "--scenario" in result.stderr
    assert not [one for one in opened_files if "elsewhere" in one or "harmful" in one]
    assert not list(tmp_path.rglob("harm"))
    assert "harmful" not in sys.modules


@pytest.mark.parametrize("metric", ["harmful:Driver", "harmful", "os:system=touch"])
def test_a_metric_that_is_not_registered_is_refused_and_not_imported(sent, opened_files, metric):
    (sent.parent / "harmful.py").write_text(HARM)
    set_meta(sent, metrics=[metric])
    opened_files.clear()
    result = cornercase("show", sent)
    assert (result.returncode, len(result.stderr.splitlines())) == (2, 1)
    assert not [one for one in opened_files if "harmful" in one]


OWN = {"class": "harmful:Driver", "unit": "s", "lower_is_critical": True, "cap": 1.0}


def describe_wttc(study, description):
    change(
        study,
        ("INSERT INTO meta (key, value, checksum) VALUES ('own_metrics', ?, 0)", (json.dumps({"wttc": description}),)),
    )


def test_a_described_metric_is_read_and_its_class_is_not_imported(sent, opened_files):
    (sent.parent / "harmful.py").write_text(HARM)
    describe_wttc(sent, OWN)
    opened_files.clear()
    assert cornercase("show", sent).returncode == 0
    assert cornercase("report", sent, "-o", sent.parent / "report.html").returncode == 0
    assert not [one for one in opened_files if "harmful" in one]


@pytest.mark.parametrize(
    "description", [1, {}, OWN | {"unit": "<script>"}, OWN | {"cap": None}, OWN | {"lower_is_critical": "yes"}]
)
def test_a_description_of_a_metric_that_was_made_up_is_refused(sent, description):
    describe_wttc(sent, description)
    result = cornercase("show", sent)
    assert (result.returncode, len(result.stderr.splitlines())) == (2, 1)


def test_the_scenario_file_is_asked_for_or_found_beside_the_study(whole, sent, tmp_path):
    result = cornercase("reduce", sent, "--scenario", whole.parent / "scenario.xosc", "-o", tmp_path / "a")
    assert result.returncode == 0, result.stderr
    for name in ("scenario.xosc", "road.xodr"):
        (sent.parent / name).write_bytes((whole.parent / name).read_bytes())
    os.rename(sent.parent / "scenario.xosc", sent.parent / "another name.xosc")
    assert cornercase("reduce", sent, "-o", tmp_path / "b").returncode == 0
    assert [one.read_bytes() for one in sorted((tmp_path / "a").iterdir())] == [
        one.read_bytes() for one in sorted((tmp_path / "b").iterdir())
    ]
    with pytest.raises(cc.InputError, match=r"changed since .* use `scenario` to name the file that was explored"):
        cc.reduce(sent, tmp_path / "c", scenario=_changed(sent.parent / "another name.xosc"))
    assert not (tmp_path / "c").exists()


def _changed(path):
    path.write_text(path.read_text().replace('author="a"', 'author="b"'))
    return path


class Harm:
    def __reduce__(self):
        return os.mkdir, ("harm",)


def objects(name):
    """An archive that holds a pickle where an array has to be."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        header = b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
        body = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + pickle.dumps(np.array([Harm()]))
        archive.writestr(f"{name}.npy", body)
    return stream.getvalue()


def claims(name, shape, body=b"", *, zeros=0):
    """An archive of an array that says how large it is, with so many MiB of zeros."""
    stream, zero = io.BytesIO(), bytes(1 << 20)
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + body
    # All MiB of zeros are packed alike, and packing them one by one takes seconds.
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    begin = packer.compress(content) + packer.flush(zlib.Z_FULL_FLUSH)
    packed = begin + (packer.compress(zero) + packer.flush(zlib.Z_FULL_FLUSH)) * zeros + packer.flush()
    with zipfile.ZipFile(stream, "w") as archive:
        member = zipfile.ZipInfo(f"{name}.npy")
        archive.writestr(member, packed)
        member.compress_type, member.file_size = zipfile.ZIP_DEFLATED, len(content) + zeros * len(zero)
        member.CRC = functools.reduce(lambda crc, block: zlib.crc32(block, crc), (content, *[zero] * zeros), 0)
    return stream.getvalue()


def as_header(name, header, method=zipfile.ZIP_STORED):
    """An archive with the header of an array only."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        archive.writestr(f"{name}.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    return stream.getvalue()


def corrupt(name):
    """An archive that is packed in another way, and damaged."""
    data = bytearray(as_header(name, b" " * 1000, zipfile.ZIP_LZMA))
    data[len(data) // 4] ^= 0xFF
    return bytes(data)


COURSE = "UPDATE courses SET course = ? WHERE scenario = 1 AND metric = 'distance'"
ARRAY = "UPDATE arrays SET data = ? WHERE name = 'labels'"
RECORDING = "UPDATE scenarios SET recording = ? WHERE id = 1"

HOSTILE = {
    "a pickle as a course": (COURSE, lambda: objects("course")),
    "a pickle as an array": (ARRAY, lambda: objects("labels")),
    "a pickle as a recording": (RECORDING, lambda: objects("time")),
    "bare pickle": (COURSE, lambda: pickle.dumps(Harm())),
    "a course that claims to be endless": (COURSE, lambda: claims("course", "(1000000000000,)")),
    "a course that claims more than all": (COURSE, lambda: claims("course", f"({2**62}, {2**62})")),
    "a negative size": (COURSE, lambda: claims("course", "(-1, -8)", bytes(64))),
    "a header that is code": (COURSE, lambda: claims("course", "(__import__('os').mkdir('harm'),)")),
    "a course that grows": (COURSE, lambda: claims("course", f"({1100 << 17},)", zeros=1100)),
    "a header without end": (RECORDING, lambda: as_header("time", b"{'descr': '<U3', 'shape': (1, ")),
    "texts without letters": (
        RECORDING,
        lambda: as_header("kinds", b"{'descr': '<U0', 'fortran_order': False, 'shape': (1000000000000,), }"),
    ),
    "packed in another way": (RECORDING, lambda: corrupt("time")),
    "labels that grow": (ARRAY, lambda: claims("labels", f"({100 << 17},)", zeros=100)),
    "labels of others": (ARRAY, lambda: pack_arrays({"labels": np.arange(3)})),
    "parameters nested deep": ("UPDATE scenarios SET parameters = ?", lambda: "[" * 100_000),
    "parameters that are no numbers": ("UPDATE scenarios SET parameters = ?", lambda: '{"v": [1]}'),
    "no parameters": ("UPDATE scenarios SET parameters = ?", lambda: "{}"),
    "a point of another space": ("UPDATE scenarios SET point = ?", lambda: bytes(80)),
    "no score": ("DELETE FROM courses WHERE scenario = 1 AND ? = ''", lambda: ""),
    "a settings list": ("UPDATE meta SET value = ? WHERE key = 'settings'", lambda: "[1]"),
    "no metrics": ("UPDATE meta SET value = ? WHERE key = 'metrics'", lambda: "[]"),
    "a space without end": (
        "UPDATE meta SET value = ? WHERE key = 'space'",
        lambda: json.dumps({"parameters": [], "declarations": [None]}),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", at_night(HOSTILE, list(HOSTILE)[1::2]))
def test_a_hostile_study_is_refused_in_one_sentence(sent, name):
    statement, value = HOSTILE[name]
    change(sent, (statement, (value(),)))
    results = [cornercase("show", sent), cornercase("export", sent, "-o", sent.parent / "tables")]
    refused = [one for one in results if one.returncode]
    assert refused
    for one in refused:
        assert one.returncode == 2
        assert len(one.stderr.strip().splitlines()) == 1
        assert one.stderr.startswith("cornercase: ")
        assert len(one.stderr) < 1500
    assert not (sent.parent / "harm").exists()
    if results[1].returncode:
        assert not (sent.parent / "tables").exists()


def remade(table, columns):
    """A table without its keys and checks."""
    return (
        f"CREATE TABLE other ({columns})",
        f"INSERT INTO other SELECT * FROM {table}",
        f"DROP TABLE {table}",
        f"ALTER TABLE other RENAME TO {table}",
    )


NO_CLUSTERS = "DELETE FROM analyses", "DELETE FROM arrays"


def test_a_table_without_its_keys_is_refused(sent):
    change(
        sent,
        *remade("scenarios", "id, round, point, parameters, state, error, recording_checksum, checksum, recording"),
    )
    for one in (("export", sent, "-o", sent.parent / "tables"), ("show", sent)):
        result = cornercase(*one)
        assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
        assert "it holds the table 'scenarios'" in result.stderr
    assert not (sent.parent / "tables").exists()


def test_scenarios_are_numbered_from_1_on(sent):
    change(sent, "UPDATE scenarios SET id = -id", "UPDATE courses SET scenario = -scenario", *NO_CLUSTERS)
    for one in (("export", sent, "-o", sent.parent / "tables"), ("show", sent)):
        result = cornercase(*one)
        assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
    assert "is numbered '-12'" in result.stderr


def test_an_analysis_of_no_scenario_is_refused(sent):
    nothing = {
        "ids": np.zeros(0, int),
        "labels": np.zeros(0, int),
        "embedding": np.zeros((0, 2)),
        "distances": np.zeros((0, 0)),
    }
    change(sent, *(("UPDATE arrays SET data = ? WHERE name = ?", (pack_arrays({k: v}), k)) for k, v in nothing.items()))
    for one in (("show", sent), ("report", sent, "-o", sent.parent / "r.html")):
        result = cornercase(*one)
        assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
        assert "an analysis without scenarios" in result.stderr


def test_a_course_that_is_longer_than_its_recording_is_refused(sent):
    change(sent, (COURSE, (pack_arrays({"course": np.zeros(10_000)}),)))
    result = cornercase("export", sent, "-o", sent.parent / "tables")
    assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
    assert "the course of distance in the scenario 1 has 10000 instants, and its recording has 21" in result.stderr


def varies(sent, **values):
    with StudyFile.open(sent, readonly=True) as study:
        space = study.space.to_json()
    space["parameters"][0].update(values)
    set_meta(sent, space=space)


@pytest.mark.parametrize("step", [1e-300, 5e-324])
def test_a_parameter_with_more_steps_than_can_be_counted_is_refused(sent, step):
    varies(sent, step=step)
    result = cornercase("show", sent)
    assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
    assert "the parameter v has more steps than can be counted" in result.stderr


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"critical": 10**400}, "too large"),
        ({"critical": float("nan")}, "not finite"),
        ({"weights": {"distance": float("inf")}}, "not finite"),
        ({"settings": {"drivers": "x"}}, "drivers"),
        ({"ego": "\ud800"}, "half a character"),
    ],
)
def test_facts_that_cannot_be_used_are_refused(sent, values, words):
    set_meta(sent, **values)
    for one in (("show", sent), ("report", sent, "-o", sent.parent / "r.html")):
        result = cornercase(*one)
        assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
        assert words in result.stderr


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ({"settings": {"drivers": {"Ego": "a\x00b"}}}, 2),
        # It is a part of a description, where it is written out.
        ({"scenario": "a\x00b.xosc"}, 0),
        ({"simulator": "imported", "files": ["a.csv"]}, 2),
    ],
)
def test_names_that_xml_cannot_hold_are_refused_or_written_out(whole, sent, values, code):
    set_meta(sent, **values)
    result = cornercase("reduce", sent, "--scenario", whole.parent / "scenario.xosc", "-o", sent.parent / "reduced")
    assert (result.returncode, len(result.stderr.strip().splitlines())) == (code, bool(code)), result.stderr
    assert (sent.parent / "reduced").exists() == (not code)


@pytest.mark.parametrize(
    ("name", "made_up", "words"),
    [
        ("ttc", lambda info: info.update(method="another"), "an unknown clustering method"),
        ("reduction", lambda info: info["kept"][0].update(values={}), "KeyError"),
        ("reduction", lambda info: info["kept"][0]["values"].update(v="x"), "a v of the wrong type"),
    ],
)
def test_an_analysis_that_was_made_up_is_refused(sent, name, made_up, words):
    with StudyFile.open(sent, readonly=True) as study:
        info = study.read_reduction() if name == "reduction" else study.read_analysis(name)[1]
    made_up(info)
    change(sent, ("UPDATE analyses SET info = ? WHERE name = ?", (json.dumps(info), name)))
    result = cornercase("report", sent, "-o", sent.parent / "r.html")
    assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
    assert words in result.stderr


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE TRIGGER t AFTER INSERT ON outcomes BEGIN DELETE FROM scenarios; END",
        "CREATE VIEW v AS SELECT * FROM meta",
        "CREATE VIRTUAL TABLE repeated USING fts5(x)",
        "CREATE TABLE another (x)",
        "CREATE INDEX i ON scenarios (abs(round))",
        "ALTER TABLE elapsed ADD COLUMN x AS (seconds * 2)",
    ],
)
def test_a_study_that_would_do_something_is_refused(sent, statement):
    change(sent, statement)
    for one in (("show", sent), ("analyze", sent)):
        result = cornercase(*one)
        assert result.returncode == 2
        assert "is not a study that cornercase wrote; it holds the " in result.stderr


def test_a_view_in_place_of_a_table_is_refused(sent):
    change(sent, "DROP TABLE elapsed", "CREATE VIEW elapsed AS SELECT 'x' AS stage, 1.0 AS seconds")
    assert "it holds the view 'elapsed'" in cornercase("show", sent).stderr


def test_what_a_file_says_of_itself_is_not_trusted(sent):
    with StudyFile.open(sent, readonly=True) as study:
        assert study._database.query("PRAGMA trusted_schema") == [(0,)]
        assert study._database.query("PRAGMA query_only") == [(1,)]


ODD = (
    "<script>alert(1)</script>",
    "=cmd|' /C calc'!A0",
    "\x1b[2J\x1b]0;owned\x07[bold][/x]",
    "$\\frac{",
    "@x\u202e\x9b",
)


@pytest.fixture(scope="module")
def oddly_named(tmp_path_factory):
    """A study in which everything that has a name has an odd one."""
    path = tmp_path_factory.mktemp("odd") / "s.db"
    names = {"ego": ODD[0] + ODD[1], "other": ODD[1]}
    plain = SPACE.to_json()
    for one, name in zip(plain["parameters"], (ODD[3] + ODD[0], ODD[1] + ODD[2]), strict=True):
        one["name"], one["unit"] = name, ODD[0]
    space = cc.ParameterSpace.from_json(plain)
    # A reader on another platform has to take it, too.
    about_it = about(space, "distance", **names, settings={ODD[0]: ODD[2]}, critical=3.0)
    about_it = type(about_it)(
        **{**vars(about_it), "scenario": f"C:\\..\\{ODD[0]}\\..\\CON.{ODD[2].replace('/', '')}.xosc"}
    )
    rng = np.random.default_rng(1)
    with StudyFile.create(path, about_it) as study:
        points = rng.random((12, 2))
        rows = study.writer.add_pending(1, points, space.values(points))
        for row in rows[:-1]:
            x = np.stack([np.zeros(5), 20 * row.point[0] + np.arange(5.0)])
            still = np.zeros((2, 5))
            recording = cc.Recording(
                time=np.arange(5.0), names=(names["ego"], names["other"]), object_types=(ODD[4], "-1+1"), x=x, y=still, heading=still,
                speed=still, acceleration=still, length=np.full(2, 4.0), width=np.full(2, 2.0), center_x=np.zeros(2),
                collisions=(cc.recordings.Collision(1.0, (names["ego"], names["other"])),),
            )  # fmt: skip
            study.writer.record_result(row.id, recording, {"distance": (x[1], float(x[1].min()))})
        study.writer.record_failure(rows[-1].id, cc.SimulationError("".join(ODD)))
    cc.analyze(path)
    return path


def test_names_are_escaped_in_the_page(oddly_named, tmp_path):
    page = cc.write_report(oddly_named, tmp_path / "r.html", figures=True).read_text()
    assert "<script>alert" not in page
    assert "&lt;script&gt;" in page
    for figure in (tmp_path / "r-figures").iterdir():
        assert figure.name.isprintable()


def test_names_are_escaped_in_notebooks(oddly_named):
    with StudyFile.open(oddly_named, readonly=True) as study:
        shown = (cc.Study.open(oddly_named)._repr_html_(), study.space._repr_html_(), study.recording(1)._repr_html_())
    assert all("&lt;script&gt;" in one and "<script" not in one for one in shown)


def test_names_give_no_orders_to_the_terminal(oddly_named):
    result = cornercase("show", oddly_named)
    assert result.returncode == 0, result.stderr
    assert r"\x1b[2J" in result.stdout
    for told in (
        result,
        cornercase("show", oddly_named.with_name("\x1b[2J.db")),
        cornercase("show", oddly_named, "--json"),
    ):
        assert not {"\x1b", "\x07", "\x9b", "\u202e"} & set(told.stdout + told.stderr)


def test_names_are_no_formulas_in_tables(oddly_named, tmp_path):
    result = cornercase("export", oddly_named, "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    tables = sorted(tmp_path.rglob("*.csv"))
    assert len(tables) == 24
    for table in tables:
        with open(table, newline="", encoding="utf-8") as file:
            for cell in (cell for row in csv.reader(file) for cell in row):
                assert cell[:1] not in tuple("=@\t\r") or not cell
                assert cell[:1] not in tuple("+-") or not cell or np.isfinite(float(cell))
    # Undo it.
    with StudyFile.open(oddly_named, readonly=True) as study:
        first, again = study.recording(1), read_recording(tmp_path / "recordings" / "00001.csv")
        assert (first.names, first.object_types, first.collisions) == (
            again.names,
            again.object_types,
            again.collisions,
        )
        table, read = study.table(), pd.read_csv(tmp_path / "scenarios.csv")
    assert read["distance"].dtype == np.float64
    assert list(read["id"]) == list(table.index)
    assert read["round"].dtype.kind == "i"


def test_a_kept_scenario_is_called_such_that_every_platform_takes_it(oddly_named):
    with StudyFile.open(oddly_named, readonly=True) as study:
        assert study.meta.file_name.startswith("CON.")
        assert study.meta.title.startswith("CON.")
    from cornercase._common.io.files import make_portable_file_name

    for name in ("../../x", "..", "CON", "con.txt", "COM¹", "a\x1b[2Jb", "x" * 5000, "", ".bashrc", "C:\\x", "a/b"):
        made = make_portable_file_name(name)
        assert made
        assert not {"/", "\\", ":", "\x1b"} & set(made)
        assert len(made.encode()) <= 150
        assert not made.startswith(".")
        assert made.upper().partition(".")[0] not in ("CON", "COM¹")


def test_arrays_come_back_as_they_were_packed():
    arrays: dict[str, Any] = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.array(["ä", "bc"]),
        "c": np.zeros(0),
        "d": np.float64(3),
    }
    for name, one in unpack_arrays(pack_arrays(arrays)).items():
        np.testing.assert_array_equal(one, arrays[name])
        assert one.dtype == np.asarray(arrays[name]).dtype


def test_arrays_that_numpy_packed_are_read_too():
    buffer = io.BytesIO()
    columns = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    wide = np.zeros(2, dtype=[(f"field number {k} of a header that is longer than 64 KiB", "<f8") for k in range(1500)])
    with pytest.warns(UserWarning, match=r"format 2\.0"):
        np.savez_compressed(buffer, columns=columns, wide=wide)
    with pytest.raises(InputError, match="arrays that cannot be read"):
        unpack_arrays(buffer.getvalue())
    buffer = io.BytesIO()
    np.savez(buffer, columns=columns)
    found = unpack_arrays(buffer.getvalue())["columns"]
    np.testing.assert_array_equal(found, columns)
    assert found.flags.writeable


@pytest.mark.parametrize("made_up", ["x", 0.5, b"\xff" * 9])
def test_checksums_that_are_no_numbers_are_damage(sent, made_up):
    with closing(sqlite3.connect(sent)) as connection, connection:
        connection.execute("UPDATE scenarios SET checksum = ? WHERE id = 2", (made_up,))
    for one in (("show", sent), ("export", sent, "-o", sent.parent / "tables")):
        result = cornercase(*one)
        assert (result.returncode, len(result.stderr.strip().splitlines())) == (2, 1)
        assert "damaged" in result.stderr
