"""Arguments are converted, or refused in one sentence that names the parameter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase._common.validation import (
    check_bool,
    check_float,
    check_int,
    check_mapping,
    check_path,
    check_str,
    check_str_sequence,
)


@pytest.mark.parametrize("given", [4, np.int64(4), np.uint8(4)])
def test_a_whole_number_is_one_whoever_made_it(given):
    taken = check_int("seed", given)
    assert taken == 4
    assert type(taken) is int


@pytest.mark.parametrize("given", [0.5, np.float32(0.5)])
def test_a_number_is_one_whoever_made_it(given):
    taken = check_float("timeout", given, above=0.0)
    assert taken == 0.5
    assert type(taken) is float
    assert check_float("critical", -3) == -3.0
    assert check_float("max_seconds", 0, minimum=0.0) == 0.0
    with pytest.raises(InputError, match="`max_seconds` -1: give a number of 0 or more"):
        check_float("max_seconds", -1, minimum=0.0)


@pytest.mark.parametrize(
    "given", ["4", None, 2.5, True, float("nan"), float("inf"), [4], np.array([4]), np.array(4.0), 0, 1025, np.True_]
)
def test_what_is_no_whole_number_in_bounds_is_refused(given):
    with pytest.raises(InputError, match=r"^`workers` .*: give a whole number from 1 to 1024\.$"):
        check_int("workers", given, 1, 1024)


@pytest.mark.parametrize("given", ["4", None, True, float("nan"), float("inf"), -1, 0, [4.0], np.zeros((40, 40))])
def test_what_is_no_number_in_bounds_is_refused(given):
    with pytest.raises(InputError, match=r"^`max_seconds` .{1,80}: give a number above 0\.$"):
        check_float("max_seconds", given, above=0.0)


def test_texts_dictionaries_flags_and_paths_are_what_they_are():
    assert check_str("ego", "Ego") == "Ego"
    assert check_str_sequence("metrics", "ttc") == ("ttc",)
    assert check_str_sequence("metrics", ["ttc", "wttc"]) == ("ttc", "wttc")
    assert check_str_sequence("ranges", iter(())) == ()
    assert check_mapping("drivers", {"Ego": "normal"}) == {"Ego": "normal"}
    assert check_bool("pareto", True) is True
    assert check_path("study", "a.db") == check_path("study", Path("a.db")) == Path("a.db")
    with pytest.raises(InputError, match=r"`on_collision` stopp: did you mean 'stop'\?"):
        check_str("on_collision", "stopp", ("continue", "stop"))


@pytest.mark.parametrize(
    ("take", "words", "given"),
    [
        (check_str, "give a text", (None, 3, "", b"Ego", Path("a"))),
        (check_str_sequence, "give a list of texts|give a text", (None, 3, [3], {"ttc": 1.0}, b"ttc", [("a", 1)])),
        (check_mapping, "give a dictionary|give a text", ("normal", ["normal"], {3: "normal"})),
        (check_bool, "give True or False", (1, None, "yes")),
        (check_path, "give the path", (None, 3, "")),
    ],
)
def test_what_is_something_else_is_refused(take, words, given):
    for one in given:
        with pytest.raises(InputError, match=f"^`metrics` .*: ({words})"):
            take("metrics", one)
