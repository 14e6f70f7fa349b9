"""Option ``--config``, which reads other options of `explore` from a TOML file, the study file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import parse_toml, read_utf8
from cornercase._common.option import Option
from cornercase.cli.driver_options import DRIVER_OPTIONS
from cornercase.exploration._explore_options import OPTIONS

_SCENARIO: Final = Option("OpenSCENARIO file.", annotation="Path | str", name="scenario", flag="--scenario")
_OPTIONS: Final = {option.key: option for option in (_SCENARIO, *OPTIONS.values(), *DRIVER_OPTIONS.values())}
_ALLOWED_KEYS: Final = [key for key, option in _OPTIONS.items() if option.in_file]
# Further options that must not be in a file; they are not in the table above.
_COMMAND_LINE_ONLY: Final = ("output", "maps", "profile", "config")
_MAX_BYTES: Final = 1_000_000


def read_explore_options(path: Path) -> dict[str, Any]:
    """Read options of `explore` from a TOML file; return them by the name of their Python parameter.

    Raises `InputError` if an option is unknown, has a wrong type, could run code, or names a file to write.
    """
    options = {}
    for key, value in parse_toml(path, read_utf8(path, _MAX_BYTES)).items():
        if key in _COMMAND_LINE_ONLY or (key in _OPTIONS and not _OPTIONS[key].in_file):
            raise InputError(f"{path}: '{key}' is not allowed in a study file; give --{key} on the command line.")
        if key not in _OPTIONS:
            raise InputError(f"{path}: has '{key[:60]}', which is not known; {suggest_name(key, _ALLOWED_KEYS)}")
        options[_OPTIONS[key].name] = _check_value(path, _OPTIONS[key], value)
    return options


def _check_value(path: Path, option: Option, value: Any) -> Any:
    key = option.key
    if option.is_list:
        texts = [value] if isinstance(value, str) else value
        if not isinstance(texts, list) or not all(isinstance(item, str) and item for item in texts):
            raise InputError(f"{path}: '{key}' is not a list of strings; write {key} = [\"…\"].")
        for item in texts:
            if option.name in ("drivers", "sut"):
                _require_registered_driver(path, item, option)
            elif option.name in DRIVER_OPTIONS:
                _require_numeric_options(path, item, option)
        return texts
    if option.annotation == "bool":
        if not isinstance(value, bool):
            raise InputError(f"{path}: '{key}' is neither true nor false.")
        return value
    if option.annotation in ("int", "float"):
        is_whole = option.annotation == "int"
        if isinstance(value, bool) or not isinstance(value, int if is_whole else int | float):
            raise InputError(f"{path}: '{key}' is not a {'whole ' if is_whole else ''}number.")
        return value
    if not isinstance(value, str) or not value:
        raise InputError(f"{path}: '{key}' is not a string; write {key} = \"…\".")
    if option.name == "simulator" and ":" in value:
        raise InputError(
            f"{path}: 'simulator' has options, which could start programs; give --simulator {value} on the command"
            " line."
        )
    return str(path.parent / value) if option.annotation == "Path | str" else value


def _require_registered_driver(path: Path, text: str, option: Option) -> None:
    """Raise InputError if a driver is not registered, since it is then code, which a study file must not run."""
    from cornercase.drivers._registry import is_registered_driver
    from cornercase.drivers._resolve import create_driver_named_in_file

    _, equals, name = text.partition("=")
    if not equals and text.endswith(".toml"):
        raise InputError(
            f"{path}: '{option.key}' names the file {text}, which could run code; give --sut {text} on the command"
            " line."
        )
    if name and not is_registered_driver(name):
        raise InputError(
            f"{path}: there is no driver '{name}'. If it is a class, give it on the command line, {option.flag} {text}:"
            " a study file must not name code."
        )
    try:
        if name:
            create_driver_named_in_file(name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _require_numeric_options(path: Path, text: str, option: Option) -> None:
    """Raise InputError if an option of a sensor or vehicle is a text, not a number, since a text could name a file."""
    from cornercase.drivers._resolve import find_non_numeric_option

    if (other := find_non_numeric_option(text.partition("=")[2])) is not None:
        raise InputError(
            f"{path}: '{option.key}' has the option '{other}', which is no number; give {option.flag} {text} on the"
            " command line."
        )


def _load_defaults(context: typer.Context, path: Path | None) -> Path | None:
    """Use the options in a study file (TOML) as defaults of the command line."""
    if path is not None:
        context.default_map = {**(context.default_map or {}), **read_explore_options(path)}
    return path


Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="STUDY.toml",
        help="TOML file with options of this command, as 'show --config' prints it. Options on the command line"
        " override those in the file.",
        is_eager=True,
        callback=_load_defaults,
    ),
]
