"""Support tables of file formats, and XML elements that track what was read."""

from __future__ import annotations

from pathlib import Path

import pytest
from lxml import etree

from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.io.support_table import (
    Notice,
    NoticeLabel,
    SupportEntry,
    SupportStatus,
    SupportTable,
    sort_notices,
    warn_notices,
)
from cornercase._common.progress import verbosity
from cornercase.scenario._xml import XmlFileCache

LEDGER = SupportTable(
    [
        SupportEntry("House", "", SupportStatus.USED, (), ""),
        SupportEntry("House", "name", SupportStatus.USED, (), ""),
        SupportEntry("House", "colour", SupportStatus.WITHOUT_EFFECT, ("white",), "all houses are white"),
        SupportEntry("House", "floors", SupportStatus.REFUSED, ("1",), "give floors='1'"),
        SupportEntry("Room", "", SupportStatus.USED, (), ""),
        SupportEntry("Room", "size", SupportStatus.USED, (), ""),
        SupportEntry("Cellar/Room", "size", SupportStatus.WITHOUT_EFFECT, ("0",), "cellars have no size"),
        SupportEntry("Cellar", "", SupportStatus.USED, (), ""),
        SupportEntry("Garden", "", SupportStatus.WITHOUT_EFFECT, (), "gardens are left out"),
        SupportEntry("Pool", "", SupportStatus.REFUSED, (), "remove it"),
    ]
)


@pytest.fixture
def read(tmp_path):
    def read(text: str):
        path = tmp_path / "house.xml"
        path.write_text(text, encoding="utf-8")
        files = XmlFileCache()
        return files, files.get_root(path), path

    return read


def _notices(root: etree._Element, path: Path) -> list[str]:
    return [
        f"{', '.join(one.parts)}: {one.reason}; {list(one.lines)}"
        for one in LEDGER.list_unsupported_notices(root, path)
    ]


def test_names_what_is_without_effect(read):
    _, root, path = read("<House colour='red'>\n<Garden><Tree/></Garden>\n<Garden/>\n</House>")
    root.find("Garden")
    assert _notices(root, path) == [
        "colour of <House>: all houses are white; [1]",
        "<Garden>: gardens are left out; [2, 3]",
    ]


def test_says_nothing_of_values_that_change_nothing(read):
    _, root, path = read("<House colour='white'><Cellar><Room size='0.0'/></Cellar></House>")
    root.find("Cellar/Room")
    assert _notices(root, path) == []


def test_names_what_it_does_not_know(read):
    _, root, path = read("<House rent='3'><Roof/></House>")
    root.get("name")
    assert _notices(root, path) == [
        "rent of <House>, <Roof> in <House>: is not known here; [1]",
    ]


def test_names_what_is_used_elsewhere_but_nobody_read(read):
    _, root, path = read("<House name='a'>\n<Room size='1'/>\n<Room size='2'/>\n<Room size='3'/></House>")
    rooms = root.findall("Room")
    rooms[0].get("size")
    assert _notices(root, path) == [
        "name of <House>, size of <Room>: it is not read here; [1, 3, 4]",
    ]


def test_looking_through_a_file_is_not_reading_it(read):
    _, root, path = read("<House name='a'><Room size='1'/></House>")
    assert {e.tag for e in root.iter()} == {"House", "Room"}
    assert dict(root.attrib) == {"name": "a"}
    root.get("name")
    assert _notices(root, path) == ["<Room> in <House>: it is not read here; [1]"]


@pytest.mark.parametrize(
    "text",
    ["<House><Room><Pool/></Room></House>", "<House floors='2'/>", "<a:House xmlns:a='b'><a:Pool/></a:House>"],
)
def test_refuses_by_name(read, text):
    _, root, path = read(text)
    with pytest.raises(InputError, match=r"house.xml, line 1: .*(<Pool>|floors '2' of <House>) cannot be used; "):
        LEDGER.check_supported(root, path)


@pytest.mark.parametrize("text", ["<House floors='1.0'/>", "<House><Garden><Pool/></Garden></House>"])
def test_refuses_nothing_that_changes_nothing_or_has_no_effect_anyway(read, text):
    _, root, path = read(text)
    LEDGER.check_supported(root, path)


def test_many_lines_are_counted(read):
    _, root, path = read("<House>" + "\n<Garden/>" * 9 + "</House>")
    root.find("Garden")
    (notice,) = LEDGER.list_unsupported_notices(root, path)
    assert str(notice) == "<Garden> (house.xml, lines 2, 3, 4, 5, 6 and 4 more): gardens are left out"


def test_what_was_read_is_kept_however_the_elements_are_reached(read):
    files, root, path = read("<House><Room size='1'/><Room size='2'/></House>")
    for room in root:
        room.get("size")
    del room
    assert _notices(root, path) == []
    assert files.get_root(path) is root


def test_warnings_are_of_who_called(read):
    _, root, path = read("<House><Garden/></House>")
    with pytest.warns(NoticeWarning, match="without effect: <Garden>") as caught:
        warn_notices(LEDGER.list_unsupported_notices(root, path))
    assert caught[0].filename == __file__


def test_what_nobody_read_is_not_named_where_reading_did_not_end(read):
    _, root, path = read("<House><Room/><Garden/><Shed/></House>")
    whats = [one.parts for one in LEDGER.list_unsupported_notices(root, path, is_complete=False)]
    assert whats == [("<Garden>",), ("<Shed> in <House>",)]


def test_43_5_each_notice_that_matters_is_given_and_the_others_are_counted(read):
    *_, path = read("<House/>")
    minor = [Notice((f"<{name}>", f"<{name}s>"), "is paint", path, (), affects_result=False) for name in "ab"]
    major = Notice(("<Roof>",), "is missing", path, ())
    read_otherwise = Notice(("<Door>",), "is read as a window", path, (), NoticeLabel.ADAPTED)
    assert sort_notices([*minor, major, read_otherwise]) == (read_otherwise, major, *minor)
    with pytest.warns(NoticeWarning) as caught:
        warn_notices([*minor, major, read_otherwise])
    assert [str(one.message).partition(" (")[0] for one in caught] == [
        "adapted: <Door>",
        "without effect: <Roof>",
        "4 more parts of the files are ignored, on which no position or speed depends; `check` lists them",
    ]
    token = verbosity.set("verbose")
    try:
        with pytest.warns(NoticeWarning) as caught:
            warn_notices(minor)
    finally:
        verbosity.reset(token)
    assert [str(one.message).partition(" (")[0] for one in caught] == [
        "without effect: <a>, <as>",
        "without effect: <b>, <bs>",
    ]
