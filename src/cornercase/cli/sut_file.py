"""Reader of a file ``sut.toml``, which gives entities drivers, sensors and vehicle models."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

from cornercase._common.configurable import format_option_value
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import parse_toml, read_utf8
from cornercase.drivers._registry import SEPARATOR, split_spec
from cornercase.drivers._resolve import runs_program_or_file

_MAX_BYTES: Final = 1_000_000
_ENTITY_KEYS: Final = ("driver", "sut", "options", "sensors", "vehicle")
_PART_KEYS: Final = ("name", "options")
_OPTION: Final = re.compile(r":[^\s:=/\\]+=")


def read_sut_file(path: Path) -> dict[str, str]:
    """Return the text ``DRIVER + SENSOR + VEHICLE`` of each entity in a TOML file.

    The file may name Python code, since the user gives the file on the command line.
    """
    specs = {
        entity: _format_entity_spec(f"{path}: [{entity}]", table)
        for entity, table in parse_toml(path, read_utf8(path, _MAX_BYTES)).items()
    }
    if not specs:
        raise InputError(f'{path}: has no entity; write a table for each, as in [Ego] with driver = "normal".')
    return specs


def _format_entity_spec(where: str, table: Any) -> str:
    if not isinstance(table, Mapping):
        raise InputError(f'{where}: is no table; write [Ego] on a line, and below it driver = "normal".')
    _check_keys(where, table, _ENTITY_KEYS)
    names = [key for key in ("driver", "sut") if key in table]
    if len(names) != 1:
        problem = "has both 'driver' and 'sut', which mean the same; keep one" if names else "has no 'driver'; add one"
        raise InputError(f"{where}: {problem}.")
    parts = [_format_name_with_options(f"{where}, {names[0]}", table[names[0]], table.get("options", {}))]
    sensors = table.get("sensors", [])
    if not isinstance(sensors, list):
        raise InputError(f"{where}: 'sensors' is no list; write sensors = [\"radar:range=120\"].")
    parts += [_format_equipment_spec(f"{where}, sensors {k}", sensor) for k, sensor in enumerate(sensors, 1)]
    if "vehicle" in table:
        parts.append(_format_equipment_spec(f"{where}, vehicle", table["vehicle"]))
    return SEPARATOR.join(parts)


def _format_equipment_spec(where: str, part: Any) -> str:
    """Return the text of a sensor or vehicle from `part`, which is a text or a table with name and options."""
    if not isinstance(part, Mapping):
        return _format_name_with_options(where, part, {})
    _check_keys(where, part, _PART_KEYS)
    if "name" not in part:
        raise InputError(f"{where}: has no 'name'; add one.")
    return _format_name_with_options(where, part["name"], part.get("options", {}))


def _format_name_with_options(where: str, name: Any, options: Any) -> str:
    """Return a name with its options as one text, as on the command line: ``name:key=value``."""
    if not isinstance(name, str) or not name.strip():
        raise InputError(f'{where}: is no text; write it as on the command line, as in "normal:horizon=4".')
    if not isinstance(options, Mapping):
        raise InputError(f"{where}: 'options' is no table; write options = {{ reaction = 0.3 }}.")
    texts = []
    for key, value in options.items():
        if not isinstance(value, bool | int | float | str):
            raise InputError(f"{where}: the value of the option '{key}' must be a number, a text, true or false.")
        text = format_option_value(value)
        if "," in text or SEPARATOR in text:
            raise InputError(f"{where}: the option '{key}' contains '{text}'; a comma or ' + ' cannot be in a value.")
        texts.append(f"{key}={text}")
    if not texts:
        return name
    named, equipment = split_spec(name)
    return SEPARATOR.join([f"{named}{',' if _has_options(named) else ':'}{','.join(texts)}", *equipment])


def _has_options(name: str) -> bool:
    """Return whether the text of a driver, sensor or vehicle has options after a colon."""
    if runs_program_or_file(name):
        # A path, address or argument may have a colon or an equals sign, too.
        return _OPTION.search(name.partition(":")[2]) is not None
    return name.count(":") > 1 or (":" in name and "=" in name)


def _check_keys(where: str, table: Mapping[str, Any], allowed: Collection[str]) -> None:
    for key in table:
        if key not in allowed:
            raise InputError(f"{where}: has '{key[:60]}', which is not known; {suggest_name(key, allowed)}")
