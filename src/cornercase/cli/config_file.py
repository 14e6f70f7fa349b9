"""The option ``--config``: take other options from a study file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import read_file

_TEXT_OPTIONS: Final = ("ego", "optimizer", "critical-if", "simulator", "on-collision")
_LIST_OPTIONS: Final = ("other", "metric", "range", "vary", "weight", "stop-when", "driver")
_PATH_OPTIONS: Final = ("scenario", "space", "warm-start")
_INTEGER_OPTIONS: Final = (
    "budget",
    "batch",
    "patience",
    "seed",
    "workers",
    "retries",
    "max-failures",
    "repeats",
    "max-repeats",
)
_NUMBER_OPTIONS: Final = ("critical", "max-seconds", "timeout", "audit", "time-step", "duration")
_FLAG_OPTIONS: Final = ("continuous", "pareto", "asynchronous")
ALLOWED_KEYS: Final = (
    *_PATH_OPTIONS,
    *_TEXT_OPTIONS,
    *_LIST_OPTIONS,
    *_INTEGER_OPTIONS,
    *_NUMBER_OPTIONS,
    *_FLAG_OPTIONS,
)
"""Keys of a study file: options of explore by name, and the scenario."""

# Where to write and run, and checks and repairs, must be on the command line.
_COMMAND_LINE_ONLY: Final = ("output", "cluster", "maps", "profile", "check-proposals", "retry-failed", "config")
_MAX_BYTES: Final = 1_000_000


def read_study_file(path: Path) -> dict[str, Any]:
    """Read options of `explore` from a TOML file, by parameter name; paths are relative to its folder.

    InputError if the file is invalid, or names code or an output path.
    """
    try:
        table = tomllib.loads(read_file(path, _MAX_BYTES).decode("utf-8-sig"))
    except InputError:
        raise
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text ({error.reason}).") from error
    except (ValueError, RecursionError) as error:
        # Also raised for integers that are too long for Python.
        raise InputError(f"{path}: is not valid TOML ({str(error)[:200]}).") from error
    options = {}
    for key, value in table.items():
        if key in _COMMAND_LINE_ONLY:
            raise InputError(f"{path}: '{key}' is not allowed in a study file; give --{key} on the command line.")
        if key not in ALLOWED_KEYS:
            raise InputError(f"{path}: has '{key[:60]}', which is not known; {suggest_name(key, ALLOWED_KEYS)}")
        options["ranges" if key == "range" else key.replace("-", "_")] = _check_value(path, key, value)
    return options


def _check_value(path: Path, key: str, value: Any) -> Any:
    if key in _LIST_OPTIONS:
        texts = [value] if isinstance(value, str) else value
        if not isinstance(texts, list) or not all(isinstance(item, str) and item for item in texts):
            raise InputError(f"{path}: '{key}' is not a list of strings; write {key} = [\"…\"].")
        if key == "driver":
            for item in texts:
                _require_registered_driver(path, item)
        return texts
    if key in _FLAG_OPTIONS:
        if not isinstance(value, bool):
            raise InputError(f"{path}: '{key}' is neither true nor false.")
        return value
    if key in _INTEGER_OPTIONS or key in _NUMBER_OPTIONS:
        types = (int,) if key in _INTEGER_OPTIONS else (int, float)
        if isinstance(value, bool) or not isinstance(value, types):
            raise InputError(f"{path}: '{key}' is not a {'whole ' if key in _INTEGER_OPTIONS else ''}number.")
        return value
    if not isinstance(value, str) or not value:
        raise InputError(f"{path}: '{key}' is not a string; write {key} = \"…\".")
    if key == "simulator" and ":" in value:
        raise InputError(
            f"{path}: 'simulator' has options, which may name programs; give --simulator {value} on the command line."
        )
    return str(path.parent / value) if key in _PATH_OPTIONS else value


def _require_registered_driver(path: Path, text: str) -> None:
    """Refuse a driver that is user code: naming it in a file must not run it."""
    from cornercase.drivers._registry import is_registered_driver
    from cornercase.drivers._resolve import create_driver_named_in_file

    _, _, name = text.partition("=")
    if name and not is_registered_driver(name):
        raise InputError(
            f"{path}: there is no driver '{name}'. If it is a class, give it on the command line, --driver {text}:"
            " a study file must not name code."
        )
    try:
        if name:
            create_driver_named_in_file(name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _load_defaults(context: typer.Context, path: Path | None) -> Path | None:
    """Use the file as defaults of the command line."""
    if path is not None:
        context.default_map = {**(context.default_map or {}), **read_study_file(path)}
    return path


Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="STUDY.toml",
        help="Study file: options of this command by their names, as 'show --config' prints it; options"
        " on the command line override it.",
        is_eager=True,
        callback=_load_defaults,
    ),
]
