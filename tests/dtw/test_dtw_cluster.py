"""Distances by the workers of a Dask cluster."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.dtw import _dask_squares as dask_tiles
from cornercase.dtw import _in_memory as pairs
from cornercase.dtw import distance_matrix, distances_to
from cornercase.dtw._in_memory import DtwSettings
from helpers.matrix_file import fill_small_squares

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def client():
    with distributed.Client(processes=False, n_workers=2, threads_per_worker=1, dashboard_address=None) as made:
        yield made


def walks(count, dims=2, seed=0):
    rng = np.random.default_rng(seed)
    series = [np.cumsum(rng.normal(size=(rng.integers(1, 30), dims)), axis=0) for _ in range(count)]
    # Copies, common constant parts and repeated lengths, which have shortcuts.
    return [*series[:-3], series[0], *series[-3:-1]]


@pytest.mark.parametrize(
    "options", [{}, {"dtype": "float32"}, {"window": 3}, {"local_cost": "squared", "dtype": "float32"}]
)
def test_the_matrix_is_that_of_one_process_to_the_bit(client, options):
    series = walks(150)
    here, there = distance_matrix(series, **options), distance_matrix(series, client=client, **options)
    assert here.dtype == there.dtype
    assert here.tobytes() == there.tobytes()


def test_distances_to_landmarks_are_those_of_one_process_to_the_bit(client):
    series, landmarks = walks(140), walks(9, seed=1)
    for dtype in ("float64", "float32"):
        here = distances_to(series, landmarks, dtype=dtype)
        assert here.tobytes() == distances_to(series, landmarks, dtype=dtype, client=client).tobytes()


def test_a_matrix_on_disk_goes_on_where_it_was_ended(client, tmp_path, monkeypatch):
    series, computed = walks(70), []
    here = fill_small_squares(series, tmp_path / "here.npy")
    plain = dask_tiles.DaskSquares.iter_squares

    def ends(self, wanted):
        for number, square in enumerate(plain(self, wanted)):
            if number == 4:
                raise KeyboardInterrupt
            yield square

    def counted(self, wanted):
        computed.extend(wanted)
        return plain(self, wanted)

    monkeypatch.setattr(dask_tiles.DaskSquares, "iter_squares", ends)
    with pytest.raises(KeyboardInterrupt):
        fill_small_squares(series, tmp_path / "there.npy", client=client)
    monkeypatch.setattr(dask_tiles.DaskSquares, "iter_squares", counted)
    there = fill_small_squares(series, tmp_path / "there.npy", resume=True, client=client)
    assert here.tobytes() == there.tobytes()
    assert (tmp_path / "here.npy").read_bytes() == (tmp_path / "there.npy").read_bytes()
    # Of 15 squares of 5 bands, 4 were there.
    assert len(computed) == 15 - 4


def test_progress_counts_every_cell(client):
    series = [np.arange(float(k % 7 + 1))[:, None] for k in range(80)]
    seen: list[int] = []
    settings = DtwSettings(False, None, np.dtype("float64"), 1, "cpu")
    dask_tiles.compute_distances_on_dask(series, None, settings, client, seen.append)
    assert sum(seen) == pairs.count_cells(series, None)
    assert len(seen) > 1


def test_what_is_no_client_is_refused(client):
    with pytest.raises(
        InputError, match=r"`client` tcp://host:8786: give a distributed.Client; .*cornercase\[cluster\]"
    ):
        distance_matrix([[0.0], [1.0]], client="tcp://host:8786")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="computes on the CPUs of its workers"):
        distance_matrix([[0.0], [1.0]], client=client, device="cuda")


def test_distances_too_large_name_the_pair(client):
    with pytest.raises(InputError, match="The distance of series 1 and 2 is too large for float64"):
        distance_matrix([[0.0], [-1.5e308], [1.5e308]], client=client)


def test_a_worker_of_another_version_is_told_of():
    settings = DtwSettings(False, None, np.dtype("float64"), 1, "cpu")
    with pytest.raises(InputError, match=r"a worker has cornercase .*, but this process has 0\.0\.0"):
        dask_tiles.compute_square_on_worker("0.0.0", settings, {}, [np.zeros((1, 1))], None)


def test_dask_is_loaded_by_those_who_ask_for_it_alone():
    script = "import sys, cornercase.dtw as d; d.distance_matrix([[0.0], [1.0]]); print('distributed' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
