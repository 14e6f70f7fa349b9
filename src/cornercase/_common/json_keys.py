"""Keys of JSON that programs read: identifiers in place of words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

_NO_LETTERS: Final = re.compile(r"[^0-9A-Za-z]+")
_BEGINS_WITH_A_NUMBER: Final = re.compile(r"(\d+)_(.+)")


def identifier(words: str) -> str:
    """Make an identifier in lower case of the words of a key.

    Parameters
    ----------
    words : str

    Returns
    -------
    str
        Letters, digits and underscores.

    Examples
    --------
    >>> from cornercase._common.json_keys import identifier
    >>> identifier("first order, 90 % interval"), identifier("95 % interval")
    ('first_order_interval_90', 'interval_95')
    """
    found = _NO_LETTERS.sub("_", words).strip("_").lower()
    return _BEGINS_WITH_A_NUMBER.sub(r"\2_\1", found)


def with_identifiers(plain: Any, names: Mapping[str, int]) -> Any:
    """Write identifiers for the keys of plain values.

    Parameters
    ----------
    plain : object
        Dictionaries, lists, texts, numbers.
    names : mapping of str to int
        Below these keys, in their words, so many levels have names of things as keys, of metrics for one: they stay.

    Returns
    -------
    object
        The same values.
    """
    if isinstance(plain, Mapping):
        return {identifier(key): _below(value, names.get(key, 0), names) for key, value in plain.items()}
    return [with_identifiers(one, names) for one in plain] if isinstance(plain, list) else plain


def _below(plain: Any, levels: int, names: Mapping[str, int]) -> Any:
    if levels and isinstance(plain, Mapping):
        return {key: _below(value, levels - 1, names) for key, value in plain.items()}
    return with_identifiers(plain, names)
