import os
import shutil
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.dtw import _in_memory as pairs
from cornercase.dtw import distance_matrix
from helpers.matrix_file import SIDE, fill_small_squares
from helpers.waiting import until


def random_walks(n, seed=0, longest=40):
    rng = np.random.default_rng(seed)
    return [np.cumsum(rng.normal(size=(rng.integers(1, longest), 2)), axis=0) for _ in range(n)]


def progress_of(path):
    return path.with_name(path.name + ".progress")


@pytest.mark.parametrize("options", [{}, {"dtype": "float32"}, {"window": 4}, {"local_cost": "squared"}])
@pytest.mark.parametrize("n", [1, 16, 45])
def test_a_file_holds_the_matrix_to_the_bit(tmp_path, n, options):
    series = random_walks(n)
    path = tmp_path / "matrix.npy"
    written = fill_small_squares(series, path, **options)
    expected = distance_matrix(series, **options)
    assert isinstance(written, np.memmap)
    assert written.dtype == expected.dtype
    assert np.array_equal(written, expected)
    assert np.array_equal(np.load(path, mmap_mode="r"), expected)


def test_fills_a_map_that_is_given(tmp_path):
    series = random_walks(40)
    path = tmp_path / "raw"
    out = np.memmap(path, np.float64, "w+", offset=64, shape=(40, 40))
    assert distance_matrix(series, out=out) is out
    assert np.array_equal(out, distance_matrix(series))
    # Without resume it is filled again, whatever its content.
    out[:] = -1.0
    distance_matrix(series, out=out)
    assert np.array_equal(out, distance_matrix(series))


def test_goes_on_after_being_killed(tmp_path, monkeypatch):
    series = random_walks(200, longest=100)
    path = tmp_path / "matrix.npy"
    np.savez(tmp_path / "series.npz", *series)
    program = (
        "import itertools, sys, time, numpy as np; from cornercase.dtw import _matrix_file as disk; "
        "from helpers.matrix_file import fill_small_squares; "
        "stored = np.load(sys.argv[1]); number, check = itertools.count(), disk._checksum; "
        # It waits to be killed before it records the eighth square.
        "disk._checksum = lambda square: (time.sleep(600 * (next(number) == 7)), check(square))[1]; "
        "fill_small_squares([stored[f'arr_{i}'] for i in range(200)], sys.argv[2])"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "series.npz"), str(path)]
    child = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    progress = progress_of(path)
    until(lambda: child.poll() is not None or (progress.exists() and progress.read_bytes().count(b"\n") > 6))
    child.kill()
    child.wait()
    squares = progress.read_text().splitlines()[1:]
    assert 5 < len(squares) < 13 * 14 / 2

    # Recorded squares are not computed again; the last line is incomplete.
    whole = distance_matrix(series)
    half = np.load(path, mmap_mode="r+")
    for line in squares:
        rows, columns = (slice(SIDE * int(a), SIDE * (int(a) + 1)) for a in line.split()[:2])
        assert np.array_equal(half[rows, columns], whole[rows, columns])
        assert np.array_equal(half[columns, rows], whole[columns, rows])
    del half
    with progress.open("a") as notes:
        notes.write("12 3")
    computed = []
    alone = pairs.compute_distances

    def counted(*given):
        computed.append(1)
        return alone(*given)

    monkeypatch.setattr(pairs, "compute_distances", counted)
    resumed = fill_small_squares(series, path, resume=True)
    assert len(computed) == 13 * 14 // 2 - len(set(squares))
    assert np.array_equal(resumed, whole)
    assert len(set(progress.read_text().splitlines()[1:])) == 13 * 14 // 2


@pytest.mark.parametrize("damage", ["cut", "flip", "mirror", "journal", "other squares"])
def test_what_is_not_as_it_was_noted_is_computed_again(tmp_path, damage):
    series = random_walks(40)
    path = tmp_path / "matrix.npy"
    expected = np.array(fill_small_squares(series, path))
    data = bytearray(path.read_bytes())
    progress = progress_of(path)
    if damage == "cut":
        del data[len(data) // 2 :]
    elif damage == "flip":
        data[-9] ^= 1
    elif damage == "mirror":
        data[128 + 8 * (39 * 40) + 3] ^= 1
    elif damage == "journal":
        progress.write_bytes(progress.read_bytes().replace(b"\n1 1 ", b"\n1 \xff "))
    else:
        first, *squares = progress.read_text().splitlines()
        progress.write_text("\n".join([first, *squares[1:], *squares[:1], "0 2 17", "a b c"]) + "\n")
    path.write_bytes(bytes(data))
    assert np.array_equal(fill_small_squares(series, path, resume=True), expected)
    # And is complete from then on.
    assert np.array_equal(np.load(path), expected)


def test_resume_begins_where_nothing_is(tmp_path):
    series = random_walks(20)
    expected = distance_matrix(series)
    path = tmp_path / "matrix.npy"
    assert np.array_equal(fill_small_squares(series, path, resume=True), expected)
    # The matrix is lost, its journal is not.
    path.unlink()
    assert np.array_equal(fill_small_squares(series, path, resume=True), expected)
    # Ended before the file had its size.
    progress = progress_of(path)
    progress.write_text(progress.read_text().splitlines()[0] + "\n")
    path.write_bytes(b"")
    assert np.array_equal(fill_small_squares(series, path, resume=True), expected)
    # Ended before the first line was written.
    progress.write_bytes(b"")
    assert np.array_equal(fill_small_squares(series, path, resume=True), expected)


def test_does_not_mix_matrices(tmp_path):
    series = random_walks(20)
    path = tmp_path / "matrix.npy"
    distance_matrix(series, out=path)
    before = path.read_bytes()
    other = [*series[:-1], series[-1] + 1.0]
    for call in (
        lambda: distance_matrix(series, out=path),
        lambda: distance_matrix(other, out=path, resume=True),
        lambda: distance_matrix(series, out=path, resume=True, window=3),
        lambda: distance_matrix(series, out=path, resume=True, local_cost="squared"),
        lambda: distance_matrix(series, out=path, resume=True, dtype="float32"),
    ):
        with pytest.raises(InputError):
            call()
        assert path.read_bytes() == before
    foreign = tmp_path / "foreign.npy"
    np.save(foreign, np.ones(3))
    with pytest.raises(InputError, match="unknown"):
        distance_matrix(series, out=foreign, resume=True)
    assert np.load(foreign).tolist() == [1.0, 1.0, 1.0]


def test_refuses_what_it_cannot_fill(tmp_path):
    series = random_walks(3)
    raw = np.memmap(tmp_path / "raw", np.float64, "w+", shape=(4, 3, 3))
    wrong: list[tuple[Any, str]] = [
        (np.zeros((3, 3)), "in memory"),
        (raw, r"give float64 of shape \(3, 3\)"),
        (raw[1], "whole file"),
        (np.memmap(tmp_path / "raw", np.float64, "r", shape=(3, 3)), "mode 'r'"),
        (np.memmap(tmp_path / "raw", np.float32, "r+", shape=(3, 3)), "float32"),
        (np.memmap(tmp_path / "raw", np.float64, "r+", shape=(3, 3), order="F"), "whole file"),
        (tmp_path / "nowhere" / "matrix.npy", "cannot be written"),
    ]
    for out, words in wrong:
        with pytest.raises(InputError, match=words):
            distance_matrix(series, out=out)
    assert sorted(os.listdir(tmp_path)) == ["raw"]


@pytest.mark.skipif(sys.platform == "win32", reason="files have no holes there")
def test_a_full_disk_is_told_before_anything_is_computed(tmp_path, monkeypatch):
    series, path = random_walks(40), tmp_path / "matrix.npy"
    with monkeypatch.context() as full:
        full.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
        with pytest.raises(InputError, match=r"needs .* kB more disk space, but only 1 kB are free"):
            distance_matrix(series, out=path)
        assert os.listdir(tmp_path) == []
        # An existing file needs no more space.
        raw = tmp_path / "raw"
        np.zeros((40, 40)).tofile(raw)
        distance_matrix(series, out=np.memmap(raw, np.float64, "r+", shape=(40, 40)))
    raw.unlink()
    assert np.array_equal(distance_matrix(series, out=path, resume=True), distance_matrix(series))


@pytest.mark.skipif(sys.platform != "linux", reason="what is written into a map cannot be reserved")
def test_space_is_taken_before_it_is_written_into(tmp_path, monkeypatch):
    path, taken = tmp_path / "matrix.npy", []

    def distances(*given):
        taken.append(path.stat().st_blocks * 512)
        return computed(*given)

    computed = pairs.compute_distances
    monkeypatch.setattr(pairs, "compute_distances", distances)
    distance_matrix(random_walks(200), out=path)
    assert taken[0] >= path.stat().st_size


def test_names_the_pair_that_is_too_large(tmp_path):
    series = [[0.0]] * 20 + [[1e200]]
    with pytest.raises(InputError, match="series 0 and 20 is too large"):
        fill_small_squares(series, tmp_path / "matrix.npy", local_cost="squared")
