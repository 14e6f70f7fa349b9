import pytest
from scipy.stats import binom

from cornercase._common.clopper_pearson import clopper_pearson_interval


@pytest.mark.parametrize(("hits", "drawn"), [(0, 1), (0, 50), (3, 50), (25, 50), (49, 50), (50, 50)])
def test_at_its_ends_as_many_hits_or_as_few_are_as_likely_as_the_tail(hits, drawn):
    low, high = clopper_pearson_interval(hits, drawn, 0.05)
    assert 0.0 <= low <= hits / drawn <= high <= 1.0
    if hits:
        assert binom.sf(hits - 1, drawn, low) == pytest.approx(0.05)
    if hits < drawn:
        assert binom.cdf(hits, drawn, high) == pytest.approx(0.05)


def test_ends_are_those_of_all_shares_where_nothing_speaks_against_them():
    assert clopper_pearson_interval(0, 0, 0.05) == (0.0, 1.0)
    assert clopper_pearson_interval(0, 7, 0.05)[0] == 0.0
    assert clopper_pearson_interval(7, 7, 0.05)[1] == 1.0
