import _thread
import json
import os
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import at_night, examples
from cornercase._common.errors import InputError
from cornercase._common.progress import verbosity
from cornercase.dtw import _cpu as cpu
from cornercase.dtw import _in_memory as pairs
from cornercase.dtw import distance_matrix, distances_to, kernel_matrix
from cornercase.dtw._lower_bounds import find_pairs_within_distance


def defined(x, y, *, squared, window):
    """The table of dynamic time warping, cell by cell."""
    n, m = len(x), len(y)
    table = [[np.inf] * (m + 1) for _ in range(n + 1)]
    table[0][0] = 0.0
    squares = ((np.asarray(x)[:, None] - np.asarray(y)) ** 2).sum(axis=-1)
    costs = (squares if squared else np.sqrt(squares)).tolist()
    for i in range(n):
        for j in range(m):
            if window is not None and not -(max(n - m, 0) + window) < j - i < max(m - n, 0) + window:
                continue
            table[i + 1][j + 1] = costs[i][j] + min(table[i][j], table[i][j + 1], table[i + 1][j])
    return np.sqrt(table[n][m]) if squared else table[n][m]


def all_pairs(series, **options):
    return np.array([[defined(x, y, **options) for y in series] for x in series])


@st.composite
def sets_of_series(draw, dims):
    dims = draw(dims)
    lengths = draw(st.lists(st.integers(1, 11), min_size=2, max_size=18))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    # Integers create ties, other numbers do not.
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


# Each has its own kernels, which the first run compiles.
DIMENSIONS = at_night([[2], range(1, 9)], [range(1, 9)])


@pytest.mark.parametrize("dimensions", DIMENSIONS)
@settings(max_examples=examples(50), deadline=None)
@given(data=st.data(), local_cost=costs, window=windows)
def test_is_the_definition(dimensions, data, local_cost, window):
    series = data.draw(sets_of_series(st.sampled_from(dimensions)))
    found = distance_matrix(series, local_cost=local_cost, window=window, n_jobs=2)
    assert found.dtype == np.float64
    check(series, found, local_cost, window, rtol=1e-13, atol=1e-13)


@settings(max_examples=examples(20), deadline=None)
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
def test_bits_do_not_depend_on_threads_or_order(options):
    rng = np.random.default_rng(0)
    # So many points that each block is divided into several tiles.
    series = [rng.normal(size=(rng.integers(1, 300), 2)) for _ in range(100)]
    once = distance_matrix(series, n_jobs=1, **options)
    for threads in (2, 5):
        assert distance_matrix(series, n_jobs=threads, **options).tobytes() == once.tobytes()
    if options.get("dtype") != "float32":
        order = rng.permutation(len(series))
        shuffled = distance_matrix([series[i] for i in order], **options)
        assert np.array_equal(shuffled, once[np.ix_(order, order)])


ALL: list[Any] = [(cost, window) for cost in ("euclidean", "squared") for window in (None, 2)]


@pytest.mark.slow
def test_a_process_that_finds_the_compiled_kernels_gives_the_same(tmp_path):
    """Compiling prints a message, once."""
    options, rng = ALL, np.random.default_rng(1)
    series = [rng.integers(-5, 6, size=rng.integers(1, 9)).tolist() for _ in range(9)]
    program = (
        "import json, sys; from cornercase.dtw import _cpu as cpu, distance_matrix; "
        "series, options = json.load(sys.stdin); "
        "m = [distance_matrix(series, local_cost=c, window=w).tolist() for c, w in options + options]; "
        "kernels = [cpu._tile_kernel(1, c == 'squared', w is not None, 8) for c, w in options]; "
        "hits = sum(sum(one.stats.cache_hits.values()) for one in kernels); "
        "print(json.dumps([hits, m]))"
    )
    ended = [
        subprocess.run(
            [sys.executable, "-c", program],
            input=json.dumps([series, options]),
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    ]
    answers = [json.loads(one.stdout) for one in ended]
    assert [answer[0] for answer in answers] == [0, len(options)]
    expected = [distance_matrix(series, local_cost=cost, window=window).tolist() for cost, window in options]
    assert answers[0][1] == answers[1][1] == expected + expected
    message, *goes_on = ended[0].stderr.splitlines()
    assert message.startswith("Compiling kernels for this machine, which takes about a minute in all")
    assert all(line.startswith("Still compiling: ") for line in goes_on)
    assert ended[1].stderr == ""


def test_interrupt_ends_between_tiles():
    series = list(np.random.default_rng(0).normal(size=(600, 200)))
    distance_matrix(series[:3])
    started: list[bool] = []

    def interrupt(*args):
        # After the first tile, as a user would while the rest is pending.
        if not started:
            started.append(True)
            _thread.interrupt_main()

    done: list[int] = []

    def advance(cells):
        done.append(cells)
        interrupt()

    threads = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        cpu.compute_distances_on_cpu(
            [one[:, None] for one in series],
            None,
            squared=False,
            window=None,
            dtype="float64",
            n_jobs=2,
            report_progress=advance,
        )
    assert started
    # The whole matrix is 75 blocks, each of one tile at least.
    assert len(done) < 20
    assert threading.active_count() <= threads + 2


def test_few_series():
    assert distance_matrix([]).shape == (0, 0)
    assert distance_matrix([[1.0, 2.0]]).tolist() == [[0.0]]
    assert distance_matrix([[1], [4]], dtype=np.float32).tolist() == [[0.0, 3.0], [3.0, 0.0]]


def test_progress_reaches_the_end(capsys):
    token = verbosity.set("verbose")
    try:
        distance_matrix([[0.0, 1.0]] * 30, progress=True)
    finally:
        verbosity.reset(token)
    assert "1 of 1 million pairs of points" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("series", "options", "words"),
    [
        ([[1.0], [2.0, np.nan]], {}, "Series 1 is not finite at instant 1"),
        ([[1.0], [2.0], [np.inf]], {}, "Series 2 is not finite"),
        ([[1.0], []], {}, "Series 1 is empty"),
        ([[1.0], np.empty((3, 0))], {}, "Series 1 is empty"),
        ([[1.0], [[1.0, 2.0]]], {}, "Series 1 has 2 dimensions, but series 0 has 1"),
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
        ([np.zeros((4, 9))], {}, "at most 8 are supported"),
        ([[1.0], [2.0]], {"resume": True}, "as out"),
        ([[1.0], [2.0]], {"device": "tpu"}, "device is 'tpu'"),
    ],
)
def test_refuses_in_one_sentence(series, options, words):
    with pytest.raises(InputError) as caught:
        distance_matrix(series, **options)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dimensions", DIMENSIONS)
@settings(max_examples=examples(25), deadline=None)
@given(data=st.data(), local_cost=costs, window=windows, dtype=st.sampled_from(["float64", "float32"]))
def test_distances_to_landmarks_are_the_definition(dimensions, data, local_cost, window, dtype):
    dims = data.draw(st.sampled_from(dimensions))
    series = data.draw(sets_of_series(st.just(dims)))
    landmarks = data.draw(sets_of_series(st.just(dims)))
    found = distances_to(series, landmarks, local_cost=local_cost, window=window, dtype=dtype, n_jobs=2)
    expected = [[defined(x, y, squared=local_cost == "squared", window=window) for y in landmarks] for x in series]
    assert found.dtype == dtype
    relative, absolute = (1e-13, 1e-13) if dtype == "float64" else (1e-4, 1e-3)
    np.testing.assert_allclose(found, expected, rtol=relative, atol=absolute)


@pytest.mark.parametrize("window", [None, 7])
def test_landmarks_among_the_series_have_the_bits_of_the_matrix(window):
    rng = np.random.default_rng(5)
    series = [rng.normal(size=(rng.integers(1, 50), 2)) for _ in range(40)]
    matrix = distance_matrix(series, window=window)
    for landmarks in ([3], [0, 17, 39], range(40)):
        found = distances_to(series, [series[j] for j in landmarks], window=window)
        assert np.array_equal(found, matrix[:, list(landmarks)])
    assert distances_to(series, []).shape == (40, 0)
    assert distances_to([], series).shape == (0, 40)


@pytest.mark.parametrize(
    ("series", "landmarks", "options", "words"),
    [
        ([[1.0]], [[1.0], [np.nan]], {}, "Landmark 1 is not finite at instant 0"),
        ([[1.0], [np.nan]], [[1.0]], {}, "Series 1 is not finite at instant 0"),
        ([[1.0]], [[[1.0, 2.0]]], {}, "Landmark 0 has 2 dimensions, but series 0 has 1"),
        ([], [[1.0], [[1.0, 2.0]]], {}, "Landmark 1 has 2 dimensions, but landmark 0 has 1"),
        ([[0.0]], [[1.0], [1e300]], {"dtype": "float32"}, "Landmark 1 is too large for float32"),
        ([[1e200], [0.0]], [[0.0], [-1e200]], {"local_cost": "squared"}, "series 0 and landmark 0"),
    ],
)
def test_landmarks_are_refused_in_one_sentence(series, landmarks, options, words):
    with pytest.raises(InputError) as caught:
        distances_to(series, landmarks, **options)
    assert words in str(caught.value)


def cells_computed(monkeypatch):
    """Count the cells that reach the kernels from here on."""
    counted = []
    run = cpu.compute_distances_on_cpu

    def counting(rows, columns, **options):
        counted.append(pairs.count_cells(rows, columns))
        return run(rows, columns, **options)

    monkeypatch.setattr(cpu, "compute_distances_on_cpu", counting)
    return counted


def test_copies_are_computed_once(monkeypatch):
    counted = cells_computed(monkeypatch)
    rng = np.random.default_rng(6)
    different = [rng.normal(size=(30, 2)) for _ in range(5)]
    places = rng.integers(0, 5, size=60)
    series = [different[i].copy() for i in places]
    expected = distance_matrix(different)
    assert np.array_equal(distance_matrix(series), expected[np.ix_(places, places)])
    assert np.array_equal(distances_to(series, different), expected[places])
    assert counted == [10 * 900, 10 * 900, 25 * 900]
    assert not distance_matrix([different[0]] * 7).any()


@st.composite
def resting(draw):
    """Sets that all begin, or end, or both, with some instants at one point; few values, so rests recur inside."""
    dims = draw(st.integers(1, 2))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    begin, end = draw(st.booleans()), draw(st.booleans())
    scale = draw(st.sampled_from([1.0, 0.1]))
    series = []
    for _ in range(draw(st.integers(2, 12))):
        parts = [rng.integers(-1, 2, size=(rng.integers(0 if begin or end else 1, 9), dims))]
        if begin:
            parts.insert(0, np.tile(np.ones((1, dims)), (rng.integers(1, 7), 1)))
        if end:
            parts.append(np.tile(np.zeros((1, dims)), (rng.integers(1, 7), 1)))
        series.append(np.concatenate(parts) * scale)
    return series


@settings(max_examples=examples(100), deadline=None)
@given(series=resting(), local_cost=costs, dtype=st.sampled_from(["float64", "float32"]))
def test_cut_rests_change_no_bit(series, local_cost, dtype):
    options = {"squared": local_cost == "squared", "window": None, "dtype": dtype, "n_jobs": 1}
    whole = cpu.compute_distances_on_cpu(series, None, **options, report_progress=lambda done: None)
    short, _ = pairs.trim_common_constant_parts(series, None)
    assert np.array_equal(
        cpu.compute_distances_on_cpu(short, None, **options, report_progress=lambda done: None), whole
    )
    if dtype == "float64":
        assert np.array_equal(distance_matrix(series, local_cost=local_cost), whole)


def test_courses_that_rest_at_their_cap_cost_less(monkeypatch):
    counted = cells_computed(monkeypatch)
    rng = np.random.default_rng(7)
    middle = [rng.uniform(0.0, 9.0, size=20) for _ in range(4)]
    courses = [np.concatenate((np.full(50 + i, 10.0), one, np.full(30, 10.0))) for i, one in enumerate(middle)]
    expected = all_pairs([one[:, None] for one in courses], squared=False, window=None)
    np.testing.assert_allclose(distance_matrix(courses), expected, rtol=1e-13)
    assert counted == [6 * 22**2]
    # With a window instants count, so nothing may be cut off.
    banded = all_pairs([one[:, None] for one in courses], squared=False, window=3)
    np.testing.assert_allclose(distance_matrix(courses, window=3), banded, rtol=1e-13)


def test_works_where_numba_can_write_nowhere(tmp_path):
    # A file in the place of the folder refuses even a superuser.
    (tmp_path / "file").touch()
    program = "from cornercase.dtw import distance_matrix; print(distance_matrix([[0.0, 1.0], [3.0]])[0, 1])"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "file" / "folder")}
    run = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert run.stdout == "5.0\n", run.stderr


@pytest.mark.slow
def test_narrow_registers_give_the_same_bits(tmp_path):
    # A processor without AVX-512, or any vectors wider than its architecture has at least.
    rng = np.random.default_rng(8)
    series = [rng.normal(size=(length, 2)).tolist() for length in (13, 1, 8, 20, 5)]
    program = (
        "import json, sys; from cornercase.dtw import _simd as simd; simd._INTEGER_MINIMUM = False; "
        "from cornercase.dtw import distance_matrix; "
        "print(json.dumps(distance_matrix(json.load(sys.stdin), window=6).tolist()))"
    )
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
    }
    run = subprocess.run(
        [sys.executable, "-c", program], input=json.dumps(series), env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == distance_matrix(series, window=6).tolist()


# --- kernel matrices ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("local_cost", ["euclidean", "squared"])
@pytest.mark.parametrize("window", [None, 7])
@pytest.mark.parametrize("gamma", at_night([1e-6, 1e-2, 3.0], {1e-6, 3.0}))
def test_a_kernel_matrix_is_that_of_all_distances_to_the_bit(dtype, local_cost, window, gamma):
    rng = np.random.default_rng(4)
    series = [
        rng.normal(size=(rng.integers(1, 40), 2)).cumsum(axis=0) + rng.integers(-60, 60, size=2) for _ in range(45)
    ]
    series.append(series[3].copy())
    options = {"local_cost": local_cost, "window": window, "dtype": dtype}
    distances = distance_matrix(series, **options)
    with np.errstate(under="ignore"):
        expected = np.exp(-np.dtype(dtype).type(gamma) * distances**2)
    for n_jobs in (1, 2):
        found = kernel_matrix(series, gamma, n_jobs=n_jobs, **options)
        assert found.dtype == dtype
        assert found.tobytes() == expected.tobytes()


def test_pairs_that_underflow_are_not_computed():
    """Two bundles, 1,000 apart: only the pairs within each may be near."""
    rng = np.random.default_rng(0)
    series = [rng.normal(size=(20, 1)) + 1000.0 * (i % 2) for i in range(10)]
    together = np.equal.outer(np.arange(10) % 2, np.arange(10) % 2)
    assert (find_pairs_within_distance(series, 900.0, squared=False) == together).all()
    assert find_pairs_within_distance(series, 30_000.0, squared=False).all()
    assert (kernel_matrix(series, 1e-2) > 0).sum() <= together.sum()


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=12), min_size=2, max_size=6))
def test_the_bound_never_leaves_out_what_is_within(values):
    series = [np.array(one)[:, None] for one in values]
    for squared in (False, True):
        distances = distance_matrix(series, local_cost="squared" if squared else "euclidean")
        for limit in np.unique(distances):
            assert find_pairs_within_distance(series, float(limit), squared)[distances <= limit].all()


@pytest.mark.parametrize("gamma", [0.0, -1.0, float("nan"), float("inf")])
def test_the_width_of_a_kernel_is_above_zero(gamma):
    with pytest.raises(InputError, match="gamma"):
        kernel_matrix([[0.0], [1.0]], gamma)
