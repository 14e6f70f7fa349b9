"""Conversion of keys in plain words to identifiers, for JSON that programs read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

_NON_ALPHANUMERIC: Final = re.compile(r"[^0-9A-Za-z]+")
_LEADING_NUMBER: Final = re.compile(r"(\d+)_(.+)")


def key_to_identifier(key: str) -> str:
    """Turn a key in plain words into an identifier in lower case.

    >>> from cornercase._common.text.json_keys import key_to_identifier
    >>> key_to_identifier("first order, 90 % interval"), key_to_identifier("95 % interval")
    ('first_order_interval_90', 'interval_95')
    """
    joined = _NON_ALPHANUMERIC.sub("_", key).strip("_").lower()
    return _LEADING_NUMBER.sub(r"\2_\1", joined)


def keys_to_identifiers(plain: Any, name_levels: Mapping[str, int]) -> Any:
    """Replace the keys of nested dictionaries by identifiers, except keys that are names, such as names of metrics.

    `name_levels` says below which keys the names are. With ``{"scores": 2}``, the keys of the two levels of
    dictionaries below the key ``"scores"`` are names, and stay unchanged.
    """
    if isinstance(plain, Mapping):
        return {
            key_to_identifier(key): _convert_keys_below_names(value, name_levels.get(key, 0), name_levels)
            for key, value in plain.items()
        }
    return [keys_to_identifiers(item, name_levels) for item in plain] if isinstance(plain, list) else plain


def _convert_keys_below_names(plain: Any, levels: int, names: Mapping[str, int]) -> Any:
    if levels and isinstance(plain, Mapping):
        return {key: _convert_keys_below_names(value, levels - 1, names) for key, value in plain.items()}
    return keys_to_identifiers(plain, names)
