"""Functions that parse values of command line options."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

from cornercase._common.errors import InputError, suggest_name

_MAX_DIGITS: Final = 15
_MAX_IDS: Final = 100_000


def parse_pairs(texts: Sequence[str], option: str) -> dict[str, str]:
    """Parse NAME=VALUE texts into a dictionary."""
    pairs = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name or not value:
            if option in ("--driver", "--sut", "--sensor", "--vehicle"):
                hint = "put the entity before the equals sign" if not sign else "give both"
                spec = value or name or "normal"
                if option in ("--driver", "--sut"):
                    from cornercase.drivers._prefix_hints import add_prefix

                    spec = add_prefix(spec)
                raise InputError(f"{option} {text}: write it as ENTITY=NAME, as in Ego={spec}; {hint}.")
            raise InputError(f"{option} {text}: write it as NAME=VALUE.")
        if ":" in name and option in ("--driver", "--sut", "--sensor", "--vehicle"):
            raise InputError(
                f"{option} {text}: write it as ENTITY=NAME, as in Ego={text}; put the entity before the equals sign."
            )
        pairs[name] = value
    return pairs


def parse_numbers(texts: Sequence[str], option: str) -> dict[str, float]:
    """Parse METRIC=NUMBER texts into a dictionary."""
    numbers = {}
    for text in texts:
        # A metric may have options with an equals sign of their own.
        name, _, value = text.rpartition("=")
        try:
            numbers[name] = float(value)
        except ValueError:
            name = ""
        if not name:
            raise InputError(f"{option} {text}: write it as METRIC=NUMBER.")
    return numbers


def parse_number_or_auto(text: str, option: str) -> float | Literal["auto"]:
    """Parse a positive number or ``auto``."""
    if text == "auto":
        return "auto"
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0 < number < float("inf"):
        raise InputError(f"{option} {text}: give a positive number or auto.")
    return number


def require_one_of(text: str, choices: tuple[str, ...], option: str) -> Any:
    """Return `text` if it is one of `choices`; otherwise raise InputError with a suggestion."""
    if text not in choices:
        raise InputError(f"{option} {text}: {suggest_name(text, choices)}")
    return text


def parse_count_or_auto(text: str, option: str) -> int | Literal["auto"]:
    """Parse a positive integer or ``auto``."""
    if text == "auto":
        return "auto"
    if not text.isdecimal() or len(text) > _MAX_DIGITS or int(text) < 1:
        raise InputError(f"{option} {text}: give a positive whole number or auto.")
    return int(text)


def parse_ids(text: str, option: str) -> list[int]:
    """Parse ids and ranges of ids, as ``3,17-20``."""
    ids: list[int] = []
    for piece in text.split(","):
        first, dash, last = piece.strip().partition("-")
        ends = (first, last if dash else first)
        if any(not (end.isascii() and end.isdecimal()) or len(end) > _MAX_DIGITS or int(end) < 1 for end in ends):
            raise InputError(f"{option} {text[:60]}: give ids and ranges of ids, such as 3,17-20.")
        low, high = map(int, ends)
        if low > high:
            raise InputError(f"{option} {piece.strip()}: the range goes backwards; write it as {high}-{low}.")
        if len(ids) + high - low >= _MAX_IDS:
            raise InputError(f"{option} {text[:60]}: names more than {_MAX_IDS:,} scenarios; name fewer.")
        ids += range(low, high + 1)
    return ids
