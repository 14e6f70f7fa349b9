"""File with mutations (changes for the worse) of an FMU or a program, for mutation testing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import parse_toml, read_utf8
from cornercase.drivers._mutation import Mutation

_MAX_BYTES: Final = 1_000_000
# Largest factor or increase; larger values would overflow.
_LARGEST: Final = 1e6
_KEYS: Final = ("description", "factor", "increase")


def read_mutations(path: Path) -> tuple[Mutation, ...]:
    """Read mutations from a TOML file with a table for each option: ``[reaction]``, ``increase = [0.1, 1]``."""
    tables = parse_toml(path, read_utf8(path, _MAX_BYTES))
    if not tables:
        raise InputError(
            f"{path}: has no table; write one for each option, as in [reaction] with increase = [0.1, 1.0]."
        )
    return tuple(_read_mutation(f"{path}: [{option}]", option, table) for option, table in tables.items())


def _read_mutation(where: str, option: str, table: Any) -> Mutation:
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: is no table; write [{option}] on a line, and below it increase = [0.1, 1.0].")
    for key in table:
        if key not in _KEYS:
            raise InputError(f"{where}: has '{key[:60]}', which is not known; {suggest_name(key, _KEYS)}")
    kinds = [key for key in ("factor", "increase") if key in table]
    if len(kinds) != 1:
        raise InputError(f"{where}: needs either factor = [0.8, 0.2] or increase = [0.1, 1.0], from mild to severe.")
    (kind,) = kinds
    bounds = table[kind]
    is_pair = isinstance(bounds, list) and len(bounds) == 2 and all(type(value) in (int, float) for value in bounds)
    # A severity between them is drawn on a logarithmic scale.
    if not is_pair or not all(1.0 / _LARGEST <= value <= _LARGEST for value in bounds):
        raise InputError(
            f"{where}, {kind}: give two numbers from {1.0 / _LARGEST:g} to {_LARGEST:g}, from mild to severe, as in"
            " [0.8, 0.2]."
        )
    description = table.get("description", f"other {option}")
    if not isinstance(description, str) or not description.strip() or not description.isprintable():
        raise InputError(f'{where}, description: give a text in one line, as in "reacts later".')
    return Mutation(description, option, float(bounds[0]), float(bounds[1]), is_offset=kind == "increase")
