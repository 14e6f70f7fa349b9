"""Recordings as CSV: nothing is lost, and errors are clear."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from typing import Any

import numpy as np
import pandas
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree

from conftest import examples
from cornercase._common.errors import InputError
from cornercase.recordings import Collision, Recording, read_recording
from cornercase.recordings._recording import CSV_COLUMNS, MOTION_ARRAYS
from cornercase.recordings._svg import draw_tracks

HEADER = ",".join(CSV_COLUMNS)
FIELDS = ("time", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")


def recording() -> Recording:
    time = np.array([0.0, 0.1, 0.2, 0.30000000000000004])
    shape = np.arange(8.0).reshape(2, 4)
    x = shape / 3
    motion: dict[str, Any] = {"x": x, "y": -x, "heading": x / 7, "speed": x + 1e-17, "acceleration": x - 0.1}
    for values in motion.values():
        values[1, 2:] = np.nan
    return Recording(
        time=time,
        names=("ego", "walker"),
        object_types=("car", "pedestrian"),
        **motion,
        length=np.array([4.5, 0.5]),
        width=np.array([1.8, 0.6]),
        center_x=np.array([1.4, 0.0]),
        collisions=(Collision(0.1, ("ego", "walker")),),
    )


def same(a: Recording, b: Recording) -> None:
    assert (a.names, a.object_types, a.collisions) == (b.names, b.object_types, b.collisions)
    for field in FIELDS:
        one, two = getattr(a, field), getattr(b, field)
        assert one.shape == two.shape
        assert one.tobytes() == two.tobytes() or np.array_equal(one, two, equal_nan=True)


def write(path, *rows, header=HEADER):
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_a_written_recording_is_read_back_bit_by_bit(tmp_path):
    recording().to_csv(tmp_path / "new" / "r.csv")
    same(recording(), read_recording(tmp_path / "new" / "r.csv"))
    assert (tmp_path / "new" / "r.csv").read_text().startswith(HEADER + ",collision\n")


@settings(deadline=None, max_examples=examples(40))
@given(st.lists(st.floats(-1e9, 1e9), min_size=4, max_size=4))
def test_any_number_survives(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("any") / "r.csv"
    speed = np.array([values, values])
    replace(recording(), speed=speed).to_csv(path)
    np.testing.assert_array_equal(read_recording(path).speed, speed)


def test_the_centre_lies_ahead_of_the_reference_point():
    shifted = recording()
    ahead = 1.4 * np.array([np.cos(shifted.heading[0]), np.sin(shifted.heading[0])]).T
    reference = np.stack([shifted.x[0], shifted.y[0]], -1)
    np.testing.assert_allclose(shifted.box_center("ego"), reference + ahead)


def test_two_entities_collide_when_they_do_so_with_each_other():
    hits = (Collision(0.1, ("ego", "wall")), Collision(0.2, ("ego", "walker")), Collision(0.3, ("walker", "ego")))
    busy = replace(recording(), collisions=hits)
    assert busy.first_collision("ego", "walker") == busy.first_collision("walker", "ego") == hits[1]
    assert replace(busy, collisions=hits[::-1]).first_collision("ego", "walker") == hits[1]
    assert busy.first_collision("walker", "wall") is None
    assert replace(busy, collisions=()).first_collision("ego", "walker") is None


def test_rows_of_other_tools_in_any_order_with_more_columns_and_a_byte_order_mark(tmp_path):
    rows = [
        "0.5,b,car,1,2,0,3,0,4,2,0,note",
        "0,a,bicycle,5,6,1,7,,1.8,0.6,0,",
        "0.5,a,bicycle,6,6,1,7,,1.8,0.6,0,",
    ]
    path = tmp_path / "r.csv"
    path.write_text("\n".join([HEADER + ",remark", *rows]), encoding="utf-8-sig")
    read = read_recording(path)
    assert read.names == ("b", "a")
    assert read.object_types == ("car", "bicycle")
    np.testing.assert_array_equal(read.time, [0, 0.5])
    np.testing.assert_array_equal(read.x, np.array([[np.nan, 1], [5, 6]]))
    assert np.isnan(read.acceleration[1]).all()


@pytest.mark.parametrize(
    ("rows", "header", "words"),
    [
        ([], HEADER, "no rows"),
        (["0,a,car"], "time,entity,kind", "lacks x, y, heading"),
        (["0,a,car,1,2,0,3,0,4,2,0", "0.1,a,car,1,north,0,3,0,4,2,0"], HEADER, "line 3: y is 'north'"),
        (["nan,a,car,1,2,0,3,0,4,2,0"], HEADER, "finite time"),
        ([",a,car,1,2,0,3,0,4,2,0"], HEADER, "finite time"),
        (["0,a,car,1,2,0,3,0,-4,2,0"], HEADER, "not negative"),
        (["0,a,car,1,2,0,3,0,,2,0"], HEADER, "length and width"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, rows, header, words):
    path = write(tmp_path / "bad.csv", *rows, header=header)
    with pytest.raises(InputError, match=words) as error:
        read_recording(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_and_one_that_is_no_text_are_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: cannot be read"):
        read_recording(tmp_path / "none.csv")
    (tmp_path / "image.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match=r"image\.csv"):
        read_recording(tmp_path / "image.csv")


def test_an_unknown_entity_is_answered_with_the_known_ones():
    with pytest.raises(InputError, match="did you mean 'walker'"):
        recording().entity_index("walkr")


def test_a_folder_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        recording().to_csv(tmp_path / "file" / "r.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_each_line_is_what_the_csv_module_writes(tmp_path):
    x = np.array([[-0.0, 1e16, np.nan], [0.1, -np.inf, 1e-5], [3.0, 2.0, 1.0]])
    odd = Recording(
        time=np.array([0.0, 1e-7, 100.0]),
        names=('a "b", c', "=1+1", ""),
        object_types=("car\nbus", "@kind", "misc"),
        x=x,
        y=2.0 * x,
        heading=x[::-1],
        speed=np.asfortranarray(x),
        acceleration=np.arange(9.0).reshape(3, 3),
        length=np.array([4, 0.1, 1e20]),
        width=np.array([1, 2, 3]),
        center_x=np.array([-0.0, 0.5, 1.0]),
        collisions=(Collision(1e-7, ('a "b", c', "=1+1")), Collision(1e-7, ('a "b", c', ""))),
    )
    odd.to_csv(tmp_path / "r.csv")
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow((*CSV_COLUMNS, "collision"))
    for instant, time in enumerate(odd.time.tolist()):
        for who, texts in enumerate((('a "b", c', "car\nbus"), ("'=1+1", "'@kind"), ("", "misc"))):
            motion = [float(getattr(odd, column)[who, instant]) for column in MOTION_ARRAYS]
            box = [float(getattr(odd, column)[who]) for column in ("length", "width", "center_x")]
            writer.writerow((time, *texts, *motion, *box, "'=1+1;" if (instant, who) == (1, 0) else ""))
    assert (tmp_path / "r.csv").read_bytes().decode() == lines.getvalue()


def test_names_with_spaces_keep_their_collisions(tmp_path):
    named = replace(recording(), names=("my ego", "a walker"), collisions=(Collision(0.1, ("my ego", "a walker")),))
    named.to_csv(tmp_path / "r.csv")
    assert read_recording(tmp_path / "r.csv").collisions == named.collisions
    with pytest.raises(InputError, match="semicolon"):
        replace(named, names=("a", "b;c"), collisions=(Collision(0.1, ("a", "b;c")),)).to_csv(tmp_path / "s.csv")
    assert not (tmp_path / "s.csv").exists()


def test_a_name_may_begin_or_end_with_a_space(tmp_path):
    hit = Collision(0.1, (" ego", "walker "))
    named = replace(recording(), names=(" ego", "walker "), collisions=(hit,))
    named.to_csv(tmp_path / "r.csv")
    assert read_recording(tmp_path / "r.csv").collisions == (hit,)


def test_a_second_row_of_one_entity_and_time_is_refused(tmp_path):
    recording().to_csv(tmp_path / "r.csv")
    lines = (tmp_path / "r.csv").read_text().splitlines()
    (tmp_path / "r.csv").write_text("\n".join([*lines, lines[2]]) + "\n")
    with pytest.raises(InputError, match=rf"r.csv, line {len(lines) + 1}: .* already .* line 3"):
        read_recording(tmp_path / "r.csv")


def test_collisions_are_kept_where_the_simulators_clock_differs_in_the_last_digits(tmp_path):
    one = recording()
    clock = float(np.nextafter(one.time[1], 9.0))
    hit = replace(one, collisions=(Collision(clock, ("ego", "walker")),))
    hit.to_csv(tmp_path / "hit.csv")
    on_time = (Collision(float(one.time[1]), ("ego", "walker")),)
    assert read_recording(tmp_path / "hit.csv").collisions == on_time
    assert set(hit.to_dataframe()["collision"]) == {"", "walker"}


def test_a_table_has_the_rows_and_columns_of_the_csv(tmp_path):
    one = recording()
    one.to_csv(tmp_path / "one.csv")
    written = pandas.read_csv(
        tmp_path / "one.csv", keep_default_na=False, na_values="nan", float_precision="round_trip"
    )
    table = one.to_dataframe()
    assert list(table.columns) == list(written.columns)
    assert len(table) == len(one.names) * len(one.time)
    for column in ("time", "entity", "kind", "x", "length", "collision"):
        assert table[column].equals(written[column]), column
    assert table.collision.tolist()[2:4] == ["walker", ""]


def test_a_recording_says_in_a_line_what_it_is():
    words = "<Recording of ego (car), walker (pedestrian), 0.3 s in 4 instants, ego and walker collide at 0.1 s>"
    assert repr(recording()) == words
    assert repr(replace(recording(), collisions=())).endswith("no collision>")


def test_a_notebook_shows_who_is_there_and_where_they_go():
    one = replace(recording(), names=("<b>ego</b>", "walker"), collisions=())
    page = etree.HTML(one._repr_html_())
    assert [cell.text for cell in page.iterfind(".//th")] == ["entity", "kind", "there", "speed"]
    cells = ["".join(map(str, cell.itertext())) for cell in page.iterfind(".//td")]
    assert cells[:3] == ["● <b>ego</b>", "car", "0 s to 0.3 s"]
    assert cells[6] == "0 s to 0.1 s"
    assert len(page.findall(".//polyline")) == len(page.findall(".//circle")) == 2


def test_tracks_have_gaps_and_who_never_comes_has_none():
    x = np.array([[0.0, 1.0, np.nan, 3.0], [np.nan] * 4])
    lines = [one.get("points", "") for one in etree.fromstring(draw_tracks(x, x)).iterfind("polyline")]
    assert [len(one.split()) for one in lines] == [2, 1]
    # y is upwards; both axes have the same scale.
    (first, second), _ = ([tuple(map(float, point.split(","))) for point in one.split()] for one in lines)
    assert second[0] - first[0] == pytest.approx(first[1] - second[1], abs=0.2)
    assert draw_tracks(np.full((2, 3), np.nan), np.zeros((2, 3))) == ""


def test_an_empty_recording_has_words_a_page_and_a_table():
    one = recording()
    empty = replace(
        one, time=one.time[:0], **{column: getattr(one, column)[:, :0] for column in MOTION_ARRAYS}, collisions=()
    )
    assert "0 s in 0 instants" in repr(empty)
    assert "never" in empty._repr_html_()
    assert empty.to_dataframe().empty
