"""The folder of a reduced set is replaced atomically, whatever happens meanwhile."""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase.clustering import analyze
from cornercase.reduction import _reduced_set_folder as set_folder
from cornercase.reduction import reduce
from cornercase.reduction._reduced_set_folder import MANIFEST, complete_replacement, replace_reduced_set
from cornercase.study import import_recordings
from helpers.two_cars import met

OLD = {"s-00001.xosc": b"one", "s-00002.xosc": b"two", "s-00003.xosc": b"three", "road.xodr": b"road"}
NEW = {"s-00002.xosc": b"two again", "s-00004.xosc": b"four", "catalogs/c/c.xosc": b"catalog", "road.xodr": b"new road"}
# System calls that write, rename and remove files.
ORDERS = ("open", "replace", "mkdir", "rmdir", "unlink", "fsync", "chmod")


class KilledError(BaseException):
    pass


def write(folder: Path, files: dict[str, bytes]) -> None:
    with replace_reduced_set(folder) as written:
        for place, content in files.items():
            written.add(place, content)
        named = [{"file": place} for place in files if place.startswith("s-")]
        written.write_manifest({"scenarios": named, "files": dict(written.digests)})
        written.replace()


def content(folder: Path) -> dict[str, bytes]:
    return {one.relative_to(folder).as_posix(): one.read_bytes() for one in folder.rglob("*") if one.is_file()}


def sets(folder: Path) -> dict[str, bytes]:
    """Files of the current set, each with the checksum in the manifest."""
    manifest = json.loads((folder / MANIFEST).read_bytes())
    found = {place: (folder / place).read_bytes() for place in manifest["files"]}
    assert {place: hashlib.sha256(one).hexdigest() for place, one in found.items()} == manifest["files"]
    return found


@contextmanager
def orders(monkeypatch, fails):
    """Count system calls, and let the given ones fail."""
    given: list[str] = []

    def counted(name, real):
        def order(*values, **more):
            given.append(name)
            if (error := fails(len(given))) is not None:
                raise error
            return real(*values, **more)

        return order

    with monkeypatch.context() as patched:
        for name in ORDERS:
            patched.setattr(os, name, counted(name, getattr(os, name)))
        yield given


def test_stumble_6_a_smaller_set_leaves_nothing_of_a_larger_one_and_all_of_others(tmp_path):
    write(tmp_path, OLD)
    assert sets(tmp_path) == OLD
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "s-00009.xosc").write_text("mine too")
    write(tmp_path, NEW)
    assert sets(tmp_path) == NEW
    others = {"mine.txt": b"mine", "s-00009.xosc": b"mine too"}
    assert content(tmp_path) == NEW | others | {MANIFEST: (tmp_path / MANIFEST).read_bytes()}


def test_a_set_of_recordings_that_lie_elsewhere_takes_the_place_of_one_with_files(tmp_path):
    runs, folder = tmp_path / "runs", tmp_path / "set"
    (runs / "later").mkdir(parents=True)
    files = ["later/00001.csv", str(tmp_path / "00002.csv"), "../00003.csv", "later/00004.csv"]
    for k, name in enumerate(files):
        met((np.arange(6.0), 0.0, 0.0, 10.0), (np.arange(6.0) + 20.0 - k, 0.0, 0.0, 10.0)).to_csv(runs / name)
    (runs / "parameters.csv").write_text("file,gap\n" + "".join(f"{name},{k}\n" for k, name in enumerate(files)))
    import_recordings(runs, tmp_path / "s.db", ego="Ego", other="Other", metrics=["distance"])
    analyze(tmp_path / "s.db", by="distance")
    write(folder, OLD)
    reduced = reduce(tmp_path / "s.db", folder, size=4)
    assert sorted(scenario.file for scenario in reduced.scenarios) == sorted(files)
    assert content(folder).keys() == {MANIFEST, "road.xodr"}
    assert not list(folder.glob(".cornercase-*"))


def test_a_file_that_somebody_has_changed_is_not_removed(tmp_path):
    write(tmp_path, OLD)
    (tmp_path / "s-00001.xosc").write_text("changed by hand")
    write(tmp_path, NEW)
    assert (tmp_path / "s-00001.xosc").read_text() == "changed by hand"
    assert not (tmp_path / "s-00003.xosc").exists()


@pytest.mark.parametrize("foreign", ["s-00004.xosc", MANIFEST, "catalogs"])
def test_a_file_of_others_is_never_replaced(tmp_path, foreign):
    (tmp_path / foreign).write_text("{}")
    with pytest.raises(InputError, match=r"`folder` .*choose another folder"):
        write(tmp_path, NEW)
    assert content(tmp_path) == {foreign: b"{}"}


def test_a_file_that_is_there_already_and_the_same_is_taken(tmp_path):
    (tmp_path / "road.xodr").write_bytes(NEW["road.xodr"])
    write(tmp_path, NEW)
    assert sets(tmp_path) == NEW


@pytest.mark.parametrize("earlier", at_night([OLD, None], [None]))
def test_killed_at_any_order_it_leaves_the_earlier_set_or_the_new_one(tmp_path, monkeypatch, earlier):
    seen = set()
    for last in range(10_000):
        folder = tmp_path / f"{last}"
        if earlier is not None:
            write(folder, earlier)
        # A killed process makes no further calls, not even to clean up.
        with orders(monkeypatch, lambda k, last=last: KilledError() if k > last else None):
            try:
                write(folder, NEW)
                ended = True
            except KilledError:
                ended = False
        if ended:
            break
        # A reader that cannot complete it reports missing or changed files, or finds one set.
        if (folder / MANIFEST).exists():
            complete_replacement(folder)
            found = sets(folder)
            assert found in (earlier, NEW)
            names = {one.name for one in folder.glob("*.xosc")}
            assert names == {place for place in found if place.startswith("s-")}
            seen.add("new" if found == NEW else "earlier")
        else:
            assert earlier is None
            assert not list(folder.glob("*.xosc"))
        write(folder, NEW)
        assert content(folder) == NEW | {MANIFEST: (folder / MANIFEST).read_bytes()}
    assert ended
    assert last > 30
    assert seen == ({"earlier", "new"} if earlier else {"new"})


@pytest.mark.parametrize("earlier", at_night([OLD, None], [None]))
def test_an_error_at_any_order_is_a_sentence_and_loses_nothing(tmp_path, monkeypatch, earlier):
    for turn in range(1, 10_000):
        folder = tmp_path / f"{turn}"
        if earlier is not None:
            write(folder, earlier)
        with orders(monkeypatch, lambda k, turn=turn: OSError(28, "No space left") if k == turn else None) as given:
            sentence = None
            try:
                write(folder, NEW)
            except InputError as error:
                sentence = str(error)
        assert sentence is None or ("No space left" in sentence and str(folder) in sentence)
        if len(given) < turn:
            break
        if earlier is None and not (folder / MANIFEST).exists():
            assert not folder.exists() or not list(folder.glob("*.xosc"))
        else:
            complete_replacement(folder)
            assert sets(folder) in (earlier, NEW)
        write(folder, NEW)
        assert content(folder) == NEW | {MANIFEST: (folder / MANIFEST).read_bytes()}
    assert turn > 30


def test_a_folder_of_a_stranger_reaches_nothing_outside_of_it(tmp_path):
    outside = tmp_path / "outside.txt"
    outside.write_text("mine")
    folder = tmp_path / "set"
    for place in ("../outside.txt", "away/outside.txt", "a\0b", str(outside)):
        write(folder, OLD)
        digest = hashlib.sha256(outside.read_bytes()).hexdigest()
        (folder / MANIFEST).write_text(json.dumps({"scenarios": [], "files": {place: digest}}))
        hidden = folder / f".cornercase-{hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest()[:16]}"
        hidden.mkdir()
        (hidden / "outside.txt").write_text("worse")
        if not (folder / "away").is_symlink():
            (folder / "away").symlink_to(tmp_path)
        with pytest.raises(InputError, match="which is not a file in the folder"):
            complete_replacement(folder)
        assert outside.read_text() == "mine"
        (folder / "away").unlink()
        (folder / MANIFEST).unlink()
        for one in folder.glob("*.xo*"):
            one.unlink()


def test_what_cannot_be_read_for_a_moment_is_not_given_up(tmp_path, monkeypatch):
    count = 0
    for failing in range(100):
        folder, reads = tmp_path / str(failing), 0

        def fails_once(path, failing=failing):
            nonlocal reads
            reads += 1
            if reads == failing + 1:
                raise InputError(f"{path}: cannot be read (Input/output error).")
            return read_file(path)

        write(folder, OLD)
        with monkeypatch.context() as patched, suppress(InputError):
            patched.setattr(set_folder, "read_file", fails_once)
            write(folder, NEW)
        if reads <= failing:
            break
        count += 1
        complete_replacement(folder)
        assert sets(folder) in (OLD, NEW)
        write(folder, NEW)
        assert content(folder) == NEW | {MANIFEST: (folder / MANIFEST).read_bytes()}
    assert count > 8
