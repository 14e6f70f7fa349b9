"""The option that takes the others from a study file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from cornercase._common.errors import InputError, suggestion
from cornercase._common.files import read_file

_TEXTS: Final = ("ego", "optimizer", "critical-if", "simulator", "on-collision")
_LISTS: Final = ("other", "metric", "range", "vary", "weight", "stop-when", "driver")
_PATHS: Final = ("scenario", "space", "warm-start")
_WHOLE: Final = ("budget", "batch", "patience", "seed", "workers", "retries", "max-failures", "repeats", "max-repeats")
_NUMBERS: Final = ("critical", "max-seconds", "timeout", "audit", "time-step", "duration")
_FLAGS: Final = ("continuous", "pareto", "asynchronous")
KEYS: Final = (*_PATHS, *_TEXTS, *_LISTS, *_WHOLE, *_NUMBERS, *_FLAGS)
"""What a study file may hold: options of explore by their names, and the scenario."""

# Where it goes and where it runs is for who types the command, as is what repeats or mends a search.
_TYPED: Final = ("output", "cluster", "maps", "profile", "check-proposals", "retry-failed", "config")
_LARGEST: Final = 1_000_000


def read_study_file(path: Path) -> dict[str, Any]:
    """Read options of explore from a file.

    Parameters
    ----------
    path : Path
        TOML, with the names of options as keys.

    Returns
    -------
    dict of str to object
        By parameter of the command; paths are relative to the folder of the file.

    Raises
    ------
    InputError
        The file cannot be used, or names code or a place where something runs or is written.
    """
    try:
        plain = tomllib.loads(read_file(path, _LARGEST).decode("utf-8-sig"))
    except InputError:
        raise
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text ({error.reason}).") from error
    except (ValueError, RecursionError) as error:
        # Also of whole numbers that are too long for Python.
        raise InputError(f"{path}: is not valid TOML ({str(error)[:200]}).") from error
    found = {}
    for key, value in plain.items():
        if key in _TYPED:
            raise InputError(f"{path}: '{key}' cannot stand in a study file; give --{key} on the command line.")
        if key not in KEYS:
            raise InputError(f"{path}: has '{key[:60]}', which is not known; {suggestion(key, KEYS)}")
        found["ranges" if key == "range" else key.replace("-", "_")] = _value(path, key, value)
    return found


def _value(path: Path, key: str, value: Any) -> Any:
    if key in _LISTS:
        texts = [value] if isinstance(value, str) else value
        if not isinstance(texts, list) or not all(isinstance(one, str) and one for one in texts):
            raise InputError(f"{path}: '{key}' is not a list of texts; write {key} = [\"…\"].")
        if key == "driver":
            for one in texts:
                _require_harmless_driver(path, one)
        return texts
    if key in _FLAGS:
        if not isinstance(value, bool):
            raise InputError(f"{path}: '{key}' is neither true nor false.")
        return value
    if key in _WHOLE or key in _NUMBERS:
        kinds = (int,) if key in _WHOLE else (int, float)
        if isinstance(value, bool) or not isinstance(value, kinds):
            raise InputError(f"{path}: '{key}' is not a {'whole ' if key in _WHOLE else ''}number.")
        return value
    if not isinstance(value, str) or not value:
        raise InputError(f"{path}: '{key}' is not a text; write {key} = \"…\".")
    if key == "simulator" and ":" in value:
        raise InputError(
            f"{path}: 'simulator' has options, which may name programs; give --simulator {value} on the command line."
        )
    return str(path.parent / value) if key in _PATHS else value


def _require_harmless_driver(path: Path, text: str) -> None:
    """Refuse a driver that is code of somebody's own: naming it in a file runs nothing."""
    from cornercase.drivers import driver_of_file, is_registered

    _, _, name = text.partition("=")
    if name and not is_registered(name):
        raise InputError(
            f"{path}: there is no driver '{name}'; a class is code, which a study file may not name: give it on the"
            f" command line, --driver {text}."
        )
    try:
        if name:
            driver_of_file(name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _read(context: typer.Context, path: Path | None) -> Path | None:
    """Let the file say what the command line does not."""
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
        callback=_read,
    ),
]
