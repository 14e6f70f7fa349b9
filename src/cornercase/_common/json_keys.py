"""Turn worded keys into identifiers for JSON that programs read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

_NO_LETTERS: Final = re.compile(r"[^0-9A-Za-z]+")
_BEGINS_WITH_A_NUMBER: Final = re.compile(r"(\d+)_(.+)")


def identifier(words: str) -> str:
    """Identifier in lower case made of a worded key.

    >>> from cornercase._common.json_keys import identifier
    >>> identifier("first order, 90 % interval"), identifier("95 % interval")
    ('first_order_interval_90', 'interval_95')
    """
    joined = _NO_LETTERS.sub("_", words).strip("_").lower()
    return _BEGINS_WITH_A_NUMBER.sub(r"\2_\1", joined)


def with_identifiers(plain: Any, names: Mapping[str, int]) -> Any:
    """Replace the keys of nested dictionaries by identifiers.

    `kept_levels` says below which keys, and for how many levels, keys are names of things (such as metrics), which
    stay.
    """
    if isinstance(plain, Mapping):
        return {identifier(key): _below(value, names.get(key, 0), names) for key, value in plain.items()}
    return [with_identifiers(item, names) for item in plain] if isinstance(plain, list) else plain


def _below(plain: Any, levels: int, names: Mapping[str, int]) -> Any:
    if levels and isinstance(plain, Mapping):
        return {key: _below(value, levels - 1, names) for key, value in plain.items()}
    return with_identifiers(plain, names)
