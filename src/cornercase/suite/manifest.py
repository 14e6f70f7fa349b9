"""Read the reduced set of a folder from the manifest that `reduce` wrote."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.files import read_file
from cornercase._common.texts import loaded_json, plain_text
from cornercase.drivers import driver_command
from cornercase.metrics import METRICS
from cornercase.reduction import MANIFEST, MANIFEST_FORMAT, finish_set
from cornercase.scenario import Declaration, ParameterSpace, Scenario, Value, read_declarations, typed_value
from cornercase.simulators import checked_settings
from cornercase.study import IMPORTED
from cornercase.suite.contents import SuiteContents, SuiteScenario

# Errors that damaged values cause.
_BROKEN: Final = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
_SETTINGS: Final[dict[str, Any]] = {"time_step": 0.05, "duration": 60.0, "on_collision": "continue"}


def read_manifest(path: Path) -> SuiteContents:
    """Read a manifest and the files that it names, after completing a `reduce` that was interrupted.

    Raises `InputError` if it is not a manifest or of another format, or if a file is missing or has changed since.
    """
    if path.name == MANIFEST:
        finish_set(path.parent)
    manifest = _loaded(path)
    try:
        return _contents(path, manifest)
    except InputError as error:
        if str(path.parent) in str(error):
            raise
        # The user did not give these values, so remove argument quotes.
        raise InputError(f"{path}: {str(error).replace('`', '').removesuffix('.')}; run `reduce` again.") from error
    except OSError as error:
        raise InputError(f"{path}: names a file that cannot be read ({error.strerror}); run `reduce` again.") from error
    except _BROKEN as error:
        raise InputError(
            f"{path}: cannot be used as a manifest ({type(error).__name__}: {str(error)[:200]}); run `reduce` again."
        ) from error


def _loaded(path: Path) -> dict[str, Any]:
    try:
        manifest = loaded_json(read_file(path).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: is not valid JSON ({str(error)[:200]}); name the manifest.json that `reduce` wrote."
        ) from error
    if not isinstance(manifest, dict) or not isinstance(manifest.get("scenarios"), list):
        raise InputError(
            f"{path}: is not a manifest; name the manifest.json that `reduce` wrote, or a folder of files."
        )
    if manifest.get("simulator") == IMPORTED:
        raise InputError(f"{path}: its recordings were imported, so there are no scenario files to run.")
    if "format" not in manifest:
        raise InputError(
            f"{path}: an earlier version of cornercase wrote it, without what it takes to run it again; run `reduce`"
            " again."
        )
    if manifest["format"] == 1:
        # Format 1 had other keys.
        manifest = manifest | {"format": MANIFEST_FORMAT, "critical_threshold": manifest.get("critical threshold")}
    if manifest["format"] != MANIFEST_FORMAT:
        raise InputError(
            f"{path}: has the format {str(manifest['format'])[:20]}, and this version of cornercase reads"
            f" {MANIFEST_FORMAT}; use the version that wrote it, or run `reduce` again."
        )
    return manifest


def _contents(path: Path, plain: Mapping[str, Any]) -> SuiteContents:
    folder = path.parent
    digests = {str(name_): str(digest) for name_, digest in plain["files"].items()}
    for name_, digest in digests.items():
        _require_file(path, name_, digest)
    space = ParameterSpace.from_json(plain["space"])
    if len({str(entry["file"]) for entry in plain["scenarios"]}) < len(plain["scenarios"]):
        raise InputError(f"{path}: names a file twice; run `reduce` again.")
    scenarios = []
    for entry in plain["scenarios"]:
        if entry["file"] not in digests:
            raise InputError(f"{path}: has no checksum of {str(entry['file'])[:100]}; run `reduce` again.")
        file = folder / entry["file"]
        scenarios.append(
            SuiteScenario(
                file=entry["file"],
                scenario=Scenario.read(file),
                values={_text(name): _value(value) for name, value in entry["values"].items()},
                kind=_text(entry["kind"]),
                role=_text(entry["role"]),
                why=_text(entry["why"]),
                origin=int(entry["id"]),
            )
        )
    if not scenarios:
        raise InputError(f"{path}: has no scenario; run `reduce` again.")
    _require_values(path, space, scenarios)
    settings = dict(plain["settings"])
    metrics = tuple(METRICS.create(_text(name)).name for name in plain["metrics"])
    time_step, duration, on_collision = (settings.get(name, default) for name, default in _SETTINGS.items())
    checked_settings(time_step, duration, on_collision, None)
    critical = plain["critical_threshold"]
    return SuiteContents(
        place=path,
        scenarios=tuple(scenarios),
        space=space,
        ego=_text(plain["ego"]),
        other=tuple(map(_text, plain["other"])) if isinstance(plain["other"], list) else _text(plain["other"]),
        metrics=metrics,
        critical=None if critical is None else _finite(critical),
        simulator=_text(plain["simulator"]),
        settings={name: settings[name] for name in _SETTINGS if name in settings},
        # A file must not name code to run: custom drivers have to be given again.
        lost_drivers={
            _text(entity): driver_command(driver) or ""
            for entity, driver in dict(settings.get("drivers", {})).items()
            if not isinstance(driver, str)
        },
        study=_text(plain["study"]),
        fingerprint=_text(plain["fingerprint"]),
    )


def _require_file(path: Path, place: str, digest: str) -> None:
    # The manifest may come from anywhere: it must not name files outside of its folder.
    parts = re.split(r"[\\/]", place)
    if any(part in ("", ".", "..") or ":" in part for part in parts):
        raise InputError(f"{path}: names {place[:100]}, which is not a file in its folder; run `reduce` again.")
    file = path.parent / place
    if not file.is_file():
        raise InputError(f"{file}: is named in {path.name}, but is not there; restore it, or run `reduce` again.")
    if hashlib.sha256(read_file(file)).hexdigest() != digest:
        raise InputError(
            f"{file}: has changed since {path.name} was written; restore it, run `reduce` again, or take {path.name}"
            " away to run the files as they are."
        )


def _require_values(path: Path, space: ParameterSpace, scenarios: Sequence[SuiteScenario]) -> None:
    """Raise `InputError` if values do not fit the parameters in the manifest, or differ from those of the file."""
    for scenario in scenarios:
        try:
            points = space.points([scenario.values])
            if set(scenario.values) != set(space.assigns) or not np.isfinite(points).all():
                raise ValueError("not those of the space")
        except _BROKEN as error:
            raise InputError(
                f"{path}: the values of {scenario.file[:100]} do not fit its parameter space; run `reduce` again."
            ) from error
        _require_same_values(path, scenario)


def _require_same_values(path: Path, one: SuiteScenario) -> None:
    declared = {
        declaration.name: declaration for declaration in read_declarations(one.scenario.root, str(one.scenario.path))
    }
    one.scenario.require_parameters(list(one.values))
    # Paths in the copied file differ from those in the logical scenario.
    path_names = one.scenario.path_parameters
    for name, value in one.values.items():
        if name not in path_names and _typed(value, declared[name]) != _typed(declared[name].value, declared[name]):
            raise InputError(
                f"{path}: says that {plain_text(name)} of {one.file[:100]} is {plain_text(str(value))[:60]}, and the"
                f" file says {plain_text(declared[name].value)[:60]}; run `reduce` again."
            )


def _typed(value: Value, declaration: Declaration) -> Value:
    try:
        return typed_value(value, declaration.kind)
    except ValueError:
        # It may be an expression.
        return str(value)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{str(value)[:60]!r} is no text")
    return value


def _finite(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError(f"{str(value)[:60]!r} is no number")
    return float(value)


def _value(value: object) -> float | str:
    if isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    return _finite(value)
