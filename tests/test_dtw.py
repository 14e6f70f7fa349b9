import _thread
import json
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cornercase.dtw import cpu, distance_matrix
from cornercase.errors import InputError


def defined(x, y, *, squared, window):
    """The table of dynamic time warping, cell by cell."""
    n, m = len(x), len(y)
    table = np.full((n + 1, m + 1), np.inf)
    table[0, 0] = 0.0
    for i in range(n):
        for j in range(m):
            if window is not None and not -(max(n - m, 0) + window) < j - i < max(m - n, 0) + window:
                continue
            square = ((x[i] - y[j]) ** 2).sum()
            cost = square if squared else np.sqrt(square)
            table[i + 1, j + 1] = cost + min(table[i, j], table[i, j + 1], table[i + 1, j])
    return np.sqrt(table[n, m]) if squared else table[n, m]


def all_pairs(series, **options):
    return np.array([[defined(x, y, **options) for y in series] for x in series])


@st.composite
def sets_of_series(draw, dims):
    dims = draw(dims)
    lengths = draw(st.lists(st.integers(1, 11), min_size=2, max_size=18))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    # Whole numbers make ties, the others do not.
    if draw(st.booleans()):
        return [rng.integers(-2, 3, size=(length, dims)).astype(float) for length in lengths]
    return [rng.normal(size=(length, dims)) * 10 for length in lengths]


costs = st.sampled_from(["euclidean", "squared"])
windows = st.one_of(st.none(), st.integers(1, 12))


def check(series, found, local_cost, window, **tolerance):
    expected = all_pairs(series, squared=local_cost == "squared", window=window)
    assert np.array_equal(found, found.T)
    assert not found.diagonal().any()
    np.testing.assert_allclose(found, expected, **tolerance)


@settings(max_examples=50, deadline=None)
@given(series=sets_of_series(st.integers(1, 3)), local_cost=costs, window=windows)
def test_is_the_definition(series, local_cost, window):
    found = distance_matrix(series, local_cost=local_cost, window=window, n_jobs=2)
    assert found.dtype == np.float64
    check(series, found, local_cost, window, rtol=1e-13, atol=1e-13)


@settings(max_examples=20, deadline=None)
@given(series=sets_of_series(st.just(2)), local_cost=costs, window=windows)
def test_is_the_definition_in_single_precision(series, local_cost, window):
    found = distance_matrix(series, local_cost=local_cost, window=window, dtype="float32", n_jobs=2)
    assert found.dtype == np.float32
    check(series, found, local_cost, window, rtol=1e-4, atol=1e-3)


def test_known_values():
    # tslearn 0.10 and dtaidistance 2.5 give these for the squared cost (radius 0 and window 1 for the band).
    series = [[0.0, 1.0, 2.0, 3.0], [1.0, 3.0], [2.0]]
    assert distance_matrix(series, local_cost="squared")[0].tolist() == pytest.approx([0.0, 2**0.5, 6**0.5])
    assert distance_matrix(series, local_cost="squared", window=1)[0].tolist() == pytest.approx([0.0, 2**0.5, 6**0.5])
    assert distance_matrix(series)[0].tolist() == [0.0, 2.0, 4.0]
    # No warping and equal lengths: the sum of the distances instant by instant.
    assert distance_matrix([[0.0, 0.0, 5.0], [0.0, 5.0, 5.0]], window=1)[0, 1] == 5.0
    assert distance_matrix([[0.0, 0.0, 5.0], [0.0, 5.0, 5.0]], window=2)[0, 1] == 0.0


def test_long_series_against_the_definition():
    rng = np.random.default_rng(3)
    series = [np.cumsum(rng.normal(size=(length, 2)), axis=0) for length in (203, 61, 118)]
    expected = all_pairs(series, squared=False, window=None)
    np.testing.assert_allclose(distance_matrix(series), expected, rtol=1e-13)
    np.testing.assert_allclose(distance_matrix(series, dtype="float32"), expected, rtol=1e-4, atol=1e-3)


def test_single_precision_keeps_digits_far_from_the_origin():
    rng = np.random.default_rng(4)
    near = [np.cumsum(rng.normal(size=(40, 2)), axis=0) for _ in range(6)]
    far = [one + np.array([5e5, 5.6e6]) for one in near]
    np.testing.assert_allclose(distance_matrix(far, dtype="float32"), distance_matrix(near), rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("options", [{}, {"window": 5}, {"dtype": "float32"}, {"local_cost": "squared"}])
def test_bits_do_not_depend_on_threads_or_order(options, monkeypatch):
    monkeypatch.setattr(cpu, "TILE_CELLS", 20_000)
    rng = np.random.default_rng(0)
    series = [rng.normal(size=(rng.integers(1, 60), 2)) for _ in range(50)]
    once = distance_matrix(series, n_jobs=1, **options)
    for threads in (2, 5):
        assert distance_matrix(series, n_jobs=threads, **options).tobytes() == once.tobytes()
    if options.get("dtype") != "float32":
        order = rng.permutation(len(series))
        shuffled = distance_matrix([series[i] for i in order], **options)
        assert np.array_equal(shuffled, once[np.ix_(order, order)])


def test_a_process_that_finds_the_compiled_kernels_gives_the_same(tmp_path):
    rng = np.random.default_rng(1)
    series = [rng.integers(-5, 6, size=rng.integers(1, 9)).tolist() for _ in range(9)]
    program = (
        "import json, sys; from cornercase.dtw import cpu, distance_matrix; series = json.load(sys.stdin); "
        "m = [distance_matrix(series, local_cost=c, window=w).tolist() for c in ('euclidean', 'squared')"
        " for w in (None, 2)]; "
        "hits = sum(sum(cpu._kernel(1, c, w, 8).stats.cache_hits.values()) for c in (False, True)"
        " for w in (False, True)); print(json.dumps([hits, m]))"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    answers = [
        json.loads(
            subprocess.run(
                [sys.executable, "-c", program],
                input=json.dumps(series),
                env=environment,
                capture_output=True,
                text=True,
                check=True,
            ).stdout
        )
        for _ in range(2)
    ]
    assert [answer[0] for answer in answers] == [0, 4]
    expected = [
        distance_matrix(series, local_cost=cost, window=window).tolist()
        for cost in ("euclidean", "squared")
        for window in (None, 2)
    ]
    assert answers[0][1] == answers[1][1] == expected


def test_interrupt_ends_between_tiles(monkeypatch):
    monkeypatch.setattr(cpu, "TILE_CELLS", 100_000)
    series = list(np.random.default_rng(0).normal(size=(600, 200)))
    distance_matrix(series[:3])
    started = []

    def interrupt(*args):
        # After the first tile, as a user would while the rest is still to do.
        if not started:
            started.append(True)
            _thread.interrupt_main()

    total = sum(1 for _ in _tiles_of(series))
    done = []
    with pytest.raises(KeyboardInterrupt):
        cpu.distance_matrix(
            [one[:, None] for one in series],
            squared=False,
            window=None,
            dtype="float64",
            n_jobs=2,
            advance=lambda cells: (done.append(cells), interrupt()),
        )
    assert started
    assert len(done) < total / 4
    assert threading.active_count() < 10


def _tiles_of(series):
    lengths = np.array([len(one) for one in series])
    blocks = [cpu._Block(first, lengths[first : first + 8], np.empty(0)) for first in range(0, len(series), 8)]
    return cpu._tiles(blocks, lengths)


def test_few_series():
    assert distance_matrix([]).shape == (0, 0)
    assert distance_matrix([[1.0, 2.0]]).tolist() == [[0.0]]
    assert distance_matrix([[1], [4]], dtype=np.float32).tolist() == [[0.0, 3.0], [3.0, 0.0]]


def test_progress_reaches_the_end(capsys):
    distance_matrix([[0.0, 1.0]] * 30, progress=True)
    assert "100%" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("series", "options", "words"),
    [
        ([[1.0], [2.0, np.nan]], {}, "Series 1 is not finite at instant 1"),
        ([[1.0], [2.0], [np.inf]], {}, "Series 2 is not finite"),
        ([[1.0], []], {}, "Series 1 is empty"),
        ([[1.0], np.empty((3, 0))], {}, "Series 1 is empty"),
        ([[1.0], [[1.0, 2.0]]], {}, "Series 1 has 2 dimensions where series 0 has 1"),
        ([[1.0], 2.0], {}, "Series 1 has 0 axes"),
        ([["a"], [1.0]], {}, "Series 0 is not an array of numbers"),
        ([[1.0], [1e300]], {"dtype": "float32"}, "too large for float32"),
        ([[1e200], [-1e200]], {"local_cost": "squared"}, "too large for float64"),
        ([[1.0], [2.0]], {"window": 0}, "window is 0"),
        ([[1.0], [2.0]], {"window": -3}, "window is -3"),
        ([[1.0], [2.0]], {"window": 2.5}, "window is 2.5"),
        ([[1.0], [2.0]], {"n_jobs": 0}, "n_jobs is 0"),
        ([[1.0], [2.0]], {"local_cost": "manhattan"}, "local_cost is 'manhattan'"),
        ([[1.0], [2.0]], {"dtype": "int32"}, "dtype is 'int32'"),
        ([[1.0], [2.0]], {"device": "cuda"}, "extra 'gpu'"),
        ([[1.0], [2.0]], {"device": "tpu"}, "device is 'tpu'"),
    ],
)
def test_refuses_in_one_sentence(series, options, words):
    with pytest.raises(InputError) as caught:
        distance_matrix(series, **options)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
