"""Read a reduced set from the manifest that `reduce` wrote into its folder."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase._common.text.sanitize import escape_control_characters, parse_json
from cornercase.drivers._serialization import driver_command_option
from cornercase.metrics import METRICS
from cornercase.reduction._reduced_set_folder import MANIFEST, complete_replacement
from cornercase.reduction._reduced_set_manifest import MANIFEST_FORMAT
from cornercase.scenario import ParameterDeclaration, ParameterSpace, Value
from cornercase.scenario._constraints import read_declarations
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._types import convert_to_type
from cornercase.simulators import check_settings
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.suite._suite_contents import DEFAULT_SETTINGS, SuiteContents, SuiteScenario

# Errors that damaged values cause.
_READ_ERRORS: Final = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)


def read_manifest(path: Path) -> SuiteContents:
    """Read a manifest and the scenario files that it lists, after completing a `reduce` that was interrupted."""
    if path.name == MANIFEST:
        complete_replacement(path.parent)
    manifest = _load_manifest_json(path)
    try:
        return _build_suite(path, manifest)
    except InputError as error:
        if str(path.parent) in str(error):
            raise
        # The user did not give these values, so remove argument quotes.
        raise InputError(f"{path}: {str(error).replace('`', '').removesuffix('.')}; run `reduce` again.") from error
    except OSError as error:
        raise InputError(f"{path}: names a file that cannot be read ({error.strerror}); run `reduce` again.") from error
    except _READ_ERRORS as error:
        raise InputError(
            f"{path}: cannot be used as a manifest ({type(error).__name__}: {str(error)[:200]}); run `reduce` again."
        ) from error


def _load_manifest_json(path: Path) -> dict[str, Any]:
    content = read_file(path)
    if content.startswith(b"SQLite format 3\0"):
        raise InputError(f"{path}: is a study; run `reduce` first, and name the folder that it writes.")
    try:
        manifest = parse_json(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: is not valid JSON ({str(error)[:200]}); name the manifest.json that `reduce` wrote."
        ) from error
    if not isinstance(manifest, dict) or not isinstance(manifest.get("scenarios"), list):
        raise InputError(
            f"{path}: is not a manifest; name the manifest.json that `reduce` wrote, or a folder of scenario files."
        )
    if manifest.get("simulator") == IMPORTED_SIMULATOR:
        raise InputError(f"{path}: was made from imported recordings, so there are no scenario files to run.")
    if "format" not in manifest:
        raise InputError(
            f"{path}: lacks what is needed to run the scenarios again, because an earlier version of cornercase wrote"
            " it; run `reduce` again."
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


def _build_suite(path: Path, manifest: Mapping[str, Any]) -> SuiteContents:
    folder = path.parent
    digests = {str(name_): str(digest) for name_, digest in manifest["files"].items()}
    for name_, digest in digests.items():
        _require_unchanged_file(path, name_, digest)
    space = ParameterSpace.from_json(manifest["space"])
    if len({str(entry["file"]) for entry in manifest["scenarios"]}) < len(manifest["scenarios"]):
        raise InputError(f"{path}: names a file twice; run `reduce` again.")
    scenarios = []
    for entry in manifest["scenarios"]:
        if entry["file"] not in digests:
            raise InputError(f"{path}: has no checksum of {str(entry['file'])[:100]}; run `reduce` again.")
        file = folder / entry["file"]
        scenarios.append(
            SuiteScenario(
                file_name=entry["file"],
                scenario=ScenarioFile.read(file),
                values={_require_text(name): _require_value(value) for name, value in entry["values"].items()},
                cluster_name=_require_text(entry["kind"]),
                role=_require_text(entry["role"]),
                selection_reason=_require_text(entry["why"]),
                source_id=int(entry["id"]),
                seed=int(manifest.get("seed", 0)),
            )
        )
    if not scenarios:
        raise InputError(f"{path}: has no scenario; run `reduce` again.")
    _require_valid_values(path, space, scenarios)
    settings = dict(manifest["settings"])
    names = [_require_text(name) for name in manifest["metrics"]]
    # The class of another metric has to be given.
    metrics = tuple(METRICS.create(name).name if name.partition(":")[0] in METRICS else name for name in names)
    time_step, duration, on_collision = (settings.get(name, default) for name, default in DEFAULT_SETTINGS.items())
    check_settings(time_step, duration, on_collision, None)
    critical = manifest["critical_threshold"]
    return SuiteContents(
        path=path,
        scenarios=tuple(scenarios),
        space=space,
        ego=_require_text(manifest["ego"]),
        other=tuple(map(_require_text, manifest["other"]))
        if isinstance(manifest["other"], list)
        else _require_text(manifest["other"]),
        metrics=metrics,
        critical=None if critical is None else _require_finite(critical),
        simulator=_require_text(manifest["simulator"]),
        settings={name: settings[name] for name in DEFAULT_SETTINGS if name in settings},
        # A file must not name code to run: custom drivers have to be given again.
        custom_drivers={
            _require_text(entity): driver_command_option(driver) or ""
            for entity, driver in dict(settings.get("drivers", {})).items()
            if not isinstance(driver, str)
        },
        study=_require_text(manifest["study"]),
        fingerprint=_require_text(manifest["fingerprint"]),
    )


def _require_unchanged_file(path: Path, relative_path: str, digest: str) -> None:
    # The manifest may come from anywhere: it must not name files outside of its folder.
    parts = re.split(r"[\\/]", relative_path)
    if any(part in ("", ".", "..") or ":" in part for part in parts):
        raise InputError(f"{path}: names {relative_path[:100]}, which is not a file in its folder; run `reduce` again.")
    file = path.parent / relative_path
    if not file.is_file():
        raise InputError(f"{file}: is named in {path.name}, but is not there; restore it, or run `reduce` again.")
    if hashlib.sha256(read_file(file)).hexdigest() != digest:
        raise InputError(
            f"{file}: has changed since {path.name} was written; restore it, run `reduce` again, or remove"
            f" {path.name} to run the files as they are."
        )


def _require_valid_values(path: Path, space: ParameterSpace, scenarios: Sequence[SuiteScenario]) -> None:
    """Raise `InputError` if parameter values in the manifest are out of range, or differ from those in the files."""
    for scenario in scenarios:
        try:
            points = space.points([scenario.values])
            if set(scenario.values) != set(space.assigned_names) or not np.isfinite(points).all():
                raise ValueError("not those of the space")
        except _READ_ERRORS as error:
            raise InputError(
                f"{path}: the values of {scenario.file_name[:100]} do not fit its parameter space; run `reduce` again."
            ) from error
        _require_same_values_as_file(path, scenario)


def _require_same_values_as_file(path: Path, scenario: SuiteScenario) -> None:
    declared = declarations_by_name(scenario.scenario)
    scenario.scenario.require_declared(list(scenario.values))
    # Paths in the copied file differ from those in the logical scenario.
    path_names = scenario.scenario.path_parameters
    for name, value in scenario.values.items():
        if (
            name in declared
            and name not in path_names
            and convert_to_declared_type(value, declared[name])
            != convert_to_declared_type(declared[name].value, declared[name])
        ):
            raise InputError(
                f"{path}: gives {scenario.file_name[:100]} the value {escape_control_characters(str(value))[:60]} for"
                f" the"
                f" parameter '{escape_control_characters(name)}', but that file declares"
                f" {escape_control_characters(declared[name].value)[:60]}; run `reduce` again."
            )


def declarations_by_name(scenario: ScenarioFile) -> dict[str, ParameterDeclaration]:
    """Return the declared parameters of a scenario file."""
    return {declaration.name: declaration for declaration in read_declarations(scenario.root, str(scenario.path))}


def convert_to_declared_type(value: Value, declaration: ParameterDeclaration) -> Value:
    """Convert a value to the type in its declaration, or to text if it cannot have this type."""
    try:
        return convert_to_type(value, declaration.type_name)
    except ValueError:
        # It may be an expression.
        return str(value)


def _require_text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{str(value)[:60]!r} is no text")
    return value


def _require_finite(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError(f"{str(value)[:60]!r} is no number")
    return float(value)


def _require_value(value: object) -> float | str:
    if isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    return _require_finite(value)
