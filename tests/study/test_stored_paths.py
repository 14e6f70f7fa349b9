"""How a study names files: it shows nobody's folders, is the same wherever it was made, and its scenario is found."""

from __future__ import annotations

import base64
import io
import json
import os
import re
import shutil
import sqlite3
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from cornercase import InputError, SimulationError
from cornercase._common.text.sanitize import remove_folders
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._stored_paths import format_stored_path, resolve_stored_path
from helpers.checksums import changed
from helpers.command_line import SPACE, X, cornercase
from helpers.synthetic_study import about

MEASURED = ("--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc")
SEARCH = (*MEASURED, "--optimizer", "sobol", "--budget", "12", "--duration", "6", "--time-step", "0.2")


def unpacked(content: bytes, depth: int = 3) -> Iterator[bytes]:
    """All that is packed in some bytes, as far as it can be unpacked."""
    yield content
    if not depth:
        return
    if content[:2] == b"PK":
        with suppress(zipfile.BadZipFile), zipfile.ZipFile(io.BytesIO(content)) as archive:
            for name in archive.namelist():
                yield from unpacked(archive.read(name), depth - 1)
    for match in re.finditer(rb"x[\x01\x5e\x9c\xda]|\x1f\x8b\x08", content):
        with suppress(zlib.error):
            yield from unpacked(
                zlib.decompressobj(31 if len(match[0]) == 3 else 15).decompress(content[match.start() :]), depth - 1
            )
    for match in re.finditer(rb"[A-Za-z0-9+/]{100,}={0,2}", content):
        with suppress(ValueError):
            yield from unpacked(base64.b64decode(match[0] + b"=" * (-len(match[0]) % 4)), depth - 1)


def cells(path: Path) -> Iterator[bytes]:
    with closing(sqlite3.connect(path)) as connection:
        for (table,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall():
            for row in connection.execute(f"SELECT * FROM {table}"):
                yield from (one for one in row if isinstance(one, bytes))


def holding(folder: Path, word: str) -> list[str]:
    """Files in whose bytes a word stands, packed or not."""
    found = []
    for path in sorted(one for one in folder.rglob("*") if one.is_file()):
        parts = [path.read_bytes(), *(cells(path) if path.suffix == ".db" else ())]
        if any(word.encode() in one for part in parts for one in unpacked(part)):
            found.append(path.relative_to(folder).as_posix())
    return found


def all_files(folder: Path) -> None:
    """Everything that commands write, each file named by its whole path."""
    folder.mkdir(parents=True)
    for file in X.parent.iterdir():
        shutil.copy(file, folder / file.name)
    study = folder / "studies" / "s.db"
    commands = (
        ("explore", folder / X.name, "--space", folder / SPACE.name, *SEARCH, "-o", study),
        ("analyze", study),
        ("reduce", study, "-o", folder / "reduced"),
        ("test", folder / "reduced", "-o", folder / "test.db", "--junit", folder / "j.xml", "--summary", folder / "s.md",
         "--against", study),
        ("compare", study, study, "-o", folder / "compared.html"),
        ("report", study, "--scenario", folder / X.name, "-o", folder / "report.html"),
        ("replay", study, "1", "-o", folder / "replay.html"),
        ("export", study, "-o", folder / "tables"),
    )  # fmt: skip
    for one in commands:
        done = cornercase(*one)
        assert done.returncode == 0, done.stderr
    for name, command in (("show.json", ("show", study, "--json")), ("study.toml", ("show", study, "--config"))):
        (folder / name).write_text(cornercase(*command, cwd=folder).stdout)
    runs = folder / "runs"
    runs.mkdir()
    for name in ("1", "2"):
        shutil.copy(folder / "tables" / "recordings" / f"0000{name}.csv", runs / f"{name}.csv")
    (runs / "2.csv").write_text("no recording")
    (runs / "table.csv").write_text("file,a\n1.csv,1\n2.csv,2\n")
    done = cornercase("import", runs, "--parameters", runs / "table.csv", *MEASURED, "-o", folder / "imported.db")
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    folder: Path = tmp_path_factory.mktemp("whose") / "secret-name"
    all_files(folder)
    return folder


def test_42_s6_nothing_that_is_written_shows_where_its_author_keeps_it(written):
    assert len(list(written.rglob("*"))) > 30
    assert holding(written, "secret-name") == []
    # What is looked for would be found.
    with StudyFile.open(written / "imported.db") as imported:
        assert imported.meta.settings["table"] == "runs/table.csv"
        (failed,) = imported.failed_rows()
        assert failed.error is not None
        assert failed.error.startswith("2.csv")
    assert "studies/s.db" in holding(written, X.stem)


def test_42_s6_the_same_layout_elsewhere_gives_the_same_study(written, tmp_path):
    folder = tmp_path / "other" / "place"
    folder.mkdir(parents=True)
    for file in X.parent.iterdir():
        shutil.copy(file, folder / file.name)
    study = Path("studies") / "s.db"
    search = ("explore", X.name, "--space", SPACE.name, *SEARCH, "-o", study)
    assert cornercase(*search, cwd=folder).returncode == 0
    tables = ("meta", "scenarios", "courses")
    mine, theirs = (sqlite3.connect(one / study) for one in (folder, written))
    with closing(mine), closing(theirs):
        for table in tables:
            rows = [one.execute(f"SELECT * FROM {table}").fetchall() for one in (mine, theirs)]
            assert rows[0] == rows[1], table
    # It can be continued in place, and after moving it together with its scenario.
    moved = folder.rename(folder.with_name("moved"))
    done = cornercase(*search[:-2], "--budget", "14", "-o", study, cwd=moved)
    assert done.returncode == 0, done.stderr
    assert cornercase("analyze", moved / study, "--by", "wttc").returncode == 0
    assert cornercase("reduce", moved / study, "-o", moved / "reduced", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("file", "study", "stored"),
    [
        ("a/x.xosc", "a/s.db", "x.xosc"),
        ("a/b/c/x.xosc", "a/s.db", "b/c/x.xosc"),
        ("a/x.xosc", "a/b/c/s.db", "../../x.xosc"),
        ("a/scenarios/x.xosc", "a/results/1/s.db", "../../scenarios/x.xosc"),
        ("x.xosc", "a/b/c/d/s.db", "x.xosc"),
        # A folder has a name, also from within.
        ("a/reduced", "a/reduced/s.db", "../reduced"),
        ("home/bob/x.xosc", "home/bob/results/s.db", "../x.xosc"),
        ("home/bob/project/x.xosc", "home/bob/results/s.db", "x.xosc"),
        ("home/alice/x.xosc", "home/bob/s.db", "x.xosc"),
        ("home/bob/project/x.xosc", "home/bob/project/results/s.db", "../x.xosc"),
        ("home/bob/p/scenarios/x.xosc", "home/bob/p/results/s.db", "../scenarios/x.xosc"),
    ],
)
def test_42_s6_a_way_that_tells_how_somebodys_folders_lie_is_left_out(tmp_path, monkeypatch, file, study, stored):
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home" / "bob")
    monkeypatch.chdir(tmp_path)
    for parts in ((tmp_path / file, tmp_path / study), (Path(file), Path(study))):
        assert format_stored_path(*parts) == stored
    there = tmp_path / file
    if there.suffix:
        there.parent.mkdir(parents=True, exist_ok=True)
        there.write_text("<a/>")
        (tmp_path / study).parent.mkdir(parents=True, exist_ok=True)
        named = resolve_stored_path(stored, tmp_path / study)
        assert (named == there) == ("/" in stored or there.parent == (tmp_path / study).parent)


def test_42_s6_a_way_through_the_root_is_none(tmp_path):
    assert format_stored_path(Path("/work/secret/x.xosc"), tmp_path / "s.db") == "x.xosc"


def test_42_s6_messages_are_stored_without_folders(tmp_path, written):
    shutil.copy(written / "studies" / "s.db", tmp_path / "s.db")
    (tmp_path / "secret name").mkdir()
    with StudyFile.open(tmp_path / "s.db", readonly=False) as study:
        study.writer.record_failure(
            1, SimulationError(f"{tmp_path}/secret name/x.xosc, line 5: no lane at 3 m/s, see {tmp_path}/a.log")
        )
        assert study.failed_rows()[0].error == "x.xosc, line 5: no lane at 3 m/s, see a.log"
    for text in ("1 / 2 m/s", "https://a.b/c/d", "a/b/c", "/", "carmaker:project=acc"):
        assert remove_folders(text) == text
    assert remove_folders(f"carmaker:project={tmp_path}/acc,port=1") == "carmaker:project=acc,port=1"


@pytest.fixture
def apart(written, tmp_path, monkeypatch) -> Path:
    """A study in a folder beside that of its scenario; the current folder is another one."""
    shutil.copytree(X.parent, tmp_path / "project")
    study: Path = tmp_path / "project" / "studies" / "s.db"
    study.parent.mkdir()
    shutil.copy(written / "studies" / "s.db", study)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return study


@pytest.mark.usefixtures("no_cache")
def test_42_10_the_scenario_is_taken_from_where_the_study_says(apart, tmp_path):
    assert json.loads(cornercase("show", apart, "--json").stdout)["scenario"] == f"../{X.name}"
    done = cornercase("reduce", apart, "-o", tmp_path / "reduced")
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "reduced").glob("*.xosc"))
    with closing(sqlite3.connect(apart)) as connection, connection:
        connection.execute("UPDATE courses SET score = score + 1 WHERE scenario = 2")
    done = cornercase("verify", apart, "--repair")
    assert done.returncode == 0, done.stderr
    assert cornercase("analyze", apart, "--by", "wttc").returncode == 0
    # Other content is reported as such; if there is no file, all searched folders are named.
    file = apart.parent.parent / X.name
    file.write_text(file.read_text().replace("<FileHeader ", "<!-- new --><FileHeader ", 1))
    done = cornercase("reduce", apart, "-o", tmp_path / "again")
    assert done.returncode == 2
    assert f"{file}: the file, its road or its catalogs have changed" in done.stderr
    file.unlink()
    done = cornercase("reduce", apart, "-o", tmp_path / "again")
    assert done.returncode == 2
    assert (
        f"the scenario file '{X.name}' was not found beside the study, in the current folder, up to two folders below them, or"
        f" at ../{X.name}; name it with --scenario." in done.stderr
    )
    assert sorted(one.name for one in apart.parent.iterdir()) == ["s.db", "s.db.damaged"]


@pytest.mark.slow
def test_42_s6_an_estimate_finds_the_scenario_and_names_it_likewise(apart, tmp_path):
    made = tmp_path / "project" / "estimates" / "e.db"
    done = cornercase("estimate", apart, "--budget", "100", "-o", made)
    assert done.returncode == 0, done.stderr
    with StudyFile.open(made) as study:
        assert study.meta.scenario == f"../{X.name}"
    assert holding(made.parent, tmp_path.name) == []


@pytest.mark.parametrize(
    "stored",
    [
        "/etc/x.xosc", "//host/share/x.xosc", "\\\\host\\share\\x.xosc", "C:/x.xosc", "a/../../x.xosc", "../../../../x.xosc",
        "../secret.csv", "../pipe.xosc", "../empty.xosc", "../folder.xosc", "./../x.xosc", "..//x.xosc", "../\0.xosc", "",
    ],
)  # fmt: skip
def test_42_10_a_study_leads_to_no_other_file(tmp_path, stored):
    study = tmp_path / "a" / "b" / "c" / "s.db"
    study.parent.mkdir(parents=True)
    for folder in study.parents[:4]:
        (folder / "x.xosc").write_text("<OpenSCENARIO/>")
    near = study.parent.parent
    (near / "secret.csv").write_text("1")
    (near / "empty.xosc").touch()
    (near / "folder.xosc").mkdir()
    if hasattr(os, "mkfifo"):
        os.mkfifo(near / "pipe.xosc")
    assert resolve_stored_path(stored, study) is None
    assert resolve_stored_path("../x.xosc", study) == near / "x.xosc"


def test_42_10_only_who_asks_for_what_needs_the_scenario_reads_it_there(apart, tmp_path, monkeypatch):
    read = []

    def noted(stored, study):
        read.append(stored)
        return resolve_stored_path(stored, study)

    monkeypatch.setattr("cornercase.study._scenario_file.resolve_stored_path", noted)
    for command in (
        ("show", apart),
        ("show", apart, "--config"),
        ("report", apart, "-o", tmp_path / "r.html"),
        ("replay", apart, "1", "-o", tmp_path / "p.html"),
        ("export", apart, "-o", tmp_path / "tables"),
        ("compare", apart, apart, "-o", tmp_path / "c.html"),
    ):
        assert cornercase(*command).returncode == 0
    assert read == []
    assert cornercase("reduce", apart, "-o", tmp_path / "reduced").returncode == 0
    assert read == [f"../{X.name}"]


@pytest.mark.usefixtures("no_cache")
def test_42_s6_a_study_with_an_absolute_path_goes_on(apart, tmp_path):
    file = apart.parent.parent / X.name
    changed(apart, ("UPDATE meta SET value = ? WHERE key = 'scenario'", (json.dumps(str(file)),)))
    assert json.loads(cornercase("show", apart, "--json").stdout)["scenario"] == str(file)
    # Its path may be one of another machine, and is not read.
    assert cornercase("reduce", apart, "-o", tmp_path / "reduced").returncode == 2
    assert cornercase("reduce", apart, "-o", tmp_path / "reduced", cwd=file.parent).returncode == 0
    search = ("explore", file, "--space", file.with_name(SPACE.name), *SEARCH, "--budget", "14", "-o", apart)
    done = cornercase(*search)
    assert done.returncode == 0, done.stderr


@pytest.mark.usefixtures("no_cache")
def test_of_a_suite_no_path_is_named_that_was_not_looked_at(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    space = ParameterSpace.from_ranges(["a=0:1"])
    meta = replace(about(space, "distance", suite="0", files=("a.xosc",)), scenario="../set/a.xosc")
    with StudyFile.create(tmp_path / "run.db", meta) as study, pytest.raises(InputError) as error:
        find_explored_scenario(study, search_stored_path=True)
    assert "or at" not in str(error.value)


def found_path(study: StudyFile) -> Path:
    found = find_explored_scenario(study, search_stored_path=True)
    assert found is not None
    return found.path


def edit(file: Path) -> None:
    file.write_text(file.read_text().replace("<FileHeader ", "<!-- new --><FileHeader ", 1))


@pytest.mark.usefixtures("no_cache")
def test_a_changed_file_of_the_same_name_does_not_hide_the_one_that_was_explored(tmp_path, monkeypatch):
    """The study does not hold the path, but this machine remembers it; a copy lies one folder below the study."""
    (explored, here, other) = (tmp_path / "a" / "scenarios", tmp_path / "b" / "1" / "2" / "here", tmp_path / "c")
    for folder in (explored, here / "sub", other):
        shutil.copytree(X.parent, folder)
    monkeypatch.chdir(here)
    study = here / "s.db"
    search = ("explore", explored / X.name, "--space", explored / SPACE.name, *SEARCH)
    assert cornercase(*search, "-o", study).returncode == 0
    with StudyFile.open(study) as file:
        assert found_path(file) == explored / X.name
        edit(here / "sub" / X.name)
        assert found_path(file) == explored / X.name
        # The current folder is the last.
        shutil.rmtree(explored)
        monkeypatch.chdir(other)
        assert found_path(file) == Path(X.name)
        edit(other / X.name)
        with pytest.raises(
            InputError,
            match=rf"{here / 'sub' / X.name}: the file, .* \(further files of this name that differ: 1\); re",
        ):
            found_path(file)
        shutil.copytree(X.parent, explored)
        assert found_path(file) == explored / X.name


@pytest.mark.usefixtures("no_cache")
def test_a_file_that_cannot_be_read_is_passed_over_and_named_where_no_other_is_found(tmp_path, monkeypatch):
    # The study lies so deep that it does not hold the path.
    explored, beside = tmp_path / "a", tmp_path / "b" / "1" / "2" / "3"
    for folder in (explored, beside / "sub"):
        shutil.copytree(X.parent, folder)
    monkeypatch.chdir(tmp_path)
    study = beside / "s.db"
    search = ("explore", explored / X.name, "--space", explored / SPACE.name, *SEARCH)
    assert cornercase(*search, "-o", study).returncode == 0
    with StudyFile.open(study) as file:
        with monkeypatch.context() as context:
            is_file = Path.is_file

            def forbidden(path):
                if explored in path.parents:
                    raise PermissionError(13, "Permission denied")
                return is_file(path)

            context.setattr(Path, "is_file", forbidden)
            context.setattr("cornercase.scenario._scenario_search.ScenarioFile", _unreadable_below(explored))
            assert found_path(file) == beside / "sub" / X.name
        shutil.rmtree(beside / "sub")
        (explored / X.name).write_text("<OpenSCENARIO>")
        with pytest.raises(InputError, match=r"XML.*; use `scenario` to name the file that was explored"):
            found_path(file)


def _unreadable_below(folder):
    from cornercase.scenario._file import ScenarioFile

    def read(path):
        if folder in Path(path).parents:
            raise PermissionError(13, "Permission denied")
        return ScenarioFile(path)

    return read
