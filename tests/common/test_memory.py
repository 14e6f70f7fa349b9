import re

import pytest

from cornercase._common.errors import InputError
from cornercase._common.memory import MemoryLimit, format_size, report_memory_need


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ("4 GB", 4e9),
        ("4GB", 4e9),
        (" 500 mb ", 5e8),
        ("1.5 GB", 1.5e9),
        ("2GiB", 2**31),
        ("600000 kB", 6e8),
        ("0.001 TB", 1e9),
        ("700000000", 7e8),
        (700_000_000, 7e8),
        (5e9, 5e9),
    ],
)
def test_sizes_are_read_as_people_write_them(given, size):
    assert MemoryLimit.from_value(given).size == size
    assert MemoryLimit.from_value(MemoryLimit.from_value(given)).size == size


@pytest.mark.parametrize(
    "given",
    ["", "much", "4 GBit", "-4 GB", "4,5 GB", "1e9", "nan", "inf", 0, -1, float("nan"), float("inf"), True, None],
)
def test_what_is_no_size_is_refused(given):
    with pytest.raises(InputError, match=r"^`memory` .*: give a size such as 4 GB or 500 MB\.$"):
        MemoryLimit.from_value(given)


def test_a_size_too_small_for_python_is_refused():
    with pytest.raises(InputError, match=r"^`memory` 4 MB: give at least "):
        MemoryLimit.from_value("4 MB")


@pytest.mark.parametrize("given", ["500 MB", "4 GB", "40 GB"])
@pytest.mark.parametrize("count", [0, 1, 7, 1000])
def test_blocks_hold_each_row_once_and_fit(given, count):
    limit, row = MemoryLimit.from_value(given), 10e6
    blocks = list(limit.split_rows(count, row, share=0.5))
    assert [k for block in blocks for k in range(count)[block]] == list(range(count))
    lengths = [block.stop - block.start for block in blocks]
    assert all(length == 1 or length * row <= 0.5 * limit.free_bytes for length in lengths)


def test_a_row_that_does_not_fit_is_a_block_of_its_own():
    assert list(MemoryLimit.from_value("500 MB").split_rows(3, 1e12)) == [slice(0, 1), slice(1, 2), slice(2, 3)]


def test_data_fits_beside_python_and_what_does_not_is_refused_with_what_to_do():
    limit = MemoryLimit.from_value("4 GB")
    limit.check_fits(limit.free_bytes, "distances", "give more")
    assert limit.free_bytes < limit.size
    sentence = "distances need up to 21 GB, which is more than `memory` 4 GB; compare fewer."
    with pytest.raises(InputError, match=f"^{re.escape(sentence)}$"):
        limit.check_fits(20e9, "distances", "compare fewer")
    # A size that does not fit is never rounded to one that does.
    with pytest.raises(InputError, match=r"need up to 4\.1 GB, which is more than `memory` 4 GB"):
        limit.check_fits(limit.free_bytes + 1e6, "distances", "compare fewer")


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (1, "1 bytes"),
        (1500, "1.5 kB"),
        (999e6, "1 GB"),
        (4e9, "4 GB"),
        (4.01e9, "4.1 GB"),
        (12.3e9, "13 GB"),
        (5e13, "50 TB"),
    ],
)
def test_sizes_are_said_with_two_digits_and_never_as_less(size, words):
    assert format_size(size) == words


def test_needs_are_stated_where_they_are_large(capsys):
    report_memory_need("Distances of 30 scenarios", 1e4)
    assert capsys.readouterr().err == ""
    report_memory_need("Distances of 20,000 scenarios", 1.6e9)
    assert re.fullmatch(r"Distances of 20,000 scenarios need about 2 GB of memory\.\n", capsys.readouterr().err)
