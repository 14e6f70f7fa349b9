"""The squared cost beside packages that define it so; they are in the extra `bench`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples, ran
from cornercase.dtw import distance_matrix
from cornercase.metrics import METRICS
from cornercase.simulators import Builtin


@st.composite
def sets_of_series(draw):
    dims = draw(st.integers(1, 8))
    lengths = draw(st.lists(st.integers(1, 30), min_size=2, max_size=8))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return [np.cumsum(rng.normal(size=(length, dims)), axis=0) for length in lengths]


windows = st.one_of(st.none(), st.integers(1, 12))


@settings(max_examples=examples(60), deadline=None)
@given(series=sets_of_series(), window=windows)
def test_dtaidistance(series, window):
    dtw_ndim = pytest.importorskip("dtaidistance.dtw_ndim")
    found = distance_matrix(series, local_cost="squared", window=window)
    for i, x in enumerate(series):
        for j, y in enumerate(series):
            assert found[i, j] == pytest.approx(dtw_ndim.distance(x, y, window=window), rel=1e-9, abs=1e-9)


@settings(max_examples=examples(60), deadline=None)
@given(series=sets_of_series(), window=windows)
def test_tslearn(series, window):
    metrics = pytest.importorskip("tslearn.metrics")
    found = distance_matrix(series, local_cost="squared", window=window)
    band = {} if window is None else {"global_constraint": "sakoe_chiba", "sakoe_chiba_radius": window - 1}
    for i, x in enumerate(series):
        for j, y in enumerate(series):
            # tslearn measures the band along one diagonal, so the two agree on it for equal lengths only.
            if window is None or len(x) == len(y):
                assert found[i, j] == pytest.approx(metrics.dtw(x, y, **band), rel=1e-9, abs=1e-9)


@pytest.fixture(scope="module")
def scenarios(t_intersection):
    """Ego trajectories and metric courses of simulated scenarios."""
    points = t_intersection.space.snap(np.random.default_rng(2).random((6, 3)))
    recordings = ran(Builtin(), [t_intersection.concrete_scenario(one) for one in t_intersection.space.values(points)])
    metric = METRICS.create("distance")
    return [(one.box_center("Ego"), metric.clip_course(metric.course(one, "Ego", "C"))[:, None]) for one in recordings]


@pytest.mark.parametrize("kind", [0, 1])
def test_simulated_scenarios(scenarios, kind):
    dtw_ndim = pytest.importorskip("dtaidistance.dtw_ndim")
    metrics = pytest.importorskip("tslearn.metrics")
    series = [np.ascontiguousarray(both[kind]) for both in scenarios]
    found = distance_matrix(series, local_cost="squared")
    assert len({len(one) for one in series}) > 1
    assert found[np.triu_indices(6, 1)].min() > 0.0
    for i, x in enumerate(series):
        for j, y in enumerate(series):
            assert found[i, j] == pytest.approx(dtw_ndim.distance(x, y), rel=1e-9, abs=1e-9)
            assert found[i, j] == pytest.approx(metrics.dtw(x, y), rel=1e-9, abs=1e-9)
