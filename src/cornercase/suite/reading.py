"""Read a suite from a folder or a manifest."""

from __future__ import annotations

import warnings
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Final

from cornercase._common.arguments import path as path_argument
from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.texts import plain_text
from cornercase.reduction import MANIFEST
from cornercase.scenario import (
    Declaration,
    Parameter,
    ParameterSpace,
    Scenario,
    Value,
    read_declarations,
    typed_value,
)
from cornercase.simulators import failure_words
from cornercase.suite.contents import SuiteContents, SuiteScenario
from cornercase.suite.manifest import read_manifest

_FILE: Final = "file"


def read_suite(place: Path | str) -> SuiteContents:
    """Read a suite from a manifest that `cornercase.reduce` wrote, its folder, any folder of scenarios, or one file.

    Without a manifest, all ``.xosc`` files of the folder are run. Distributions of parameters and catalogs among them
    are left out with a warning. Raises `InputError` if there is nothing to run, or if a file cannot be used, is missing
    or has changed since the manifest was written.
    """
    path = path_argument("suite", place)
    if path.is_dir():
        manifest = path / MANIFEST
        return read_manifest(manifest) if manifest.is_file() else _of_files(path, sorted(path.glob("*.xosc")))
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; name a folder of scenarios, or the manifest.json that `reduce` wrote."
        )
    return _of_files(path, [path]) if path.suffix.lower() == ".xosc" else read_manifest(path)


def _of_files(folder: Path, files: Sequence[Path]) -> SuiteContents:
    for file in files:
        # Names are stored as UTF-8.
        if (readable := plain_text(file.name).replace("\n", "\\n").encode(errors="replace").decode()) != file.name:
            raise InputError(f"{folder}: the name of its file '{readable}' is not plain text; rename the file.")
    scenarios, errors = list[Scenario](), dict[Path, InputError]()
    ignored = []
    for file in files:
        try:
            if _is_of_something_else(Scenario(file)):
                ignored.append(file.name)
                continue
            scenarios.append(Scenario.read(file))
        except InputError as error:
            errors[file] = error
            scenarios.append(Scenario(file))
    if ignored:
        warnings.warn(f"not run, because they are not scenarios: {', '.join(ignored)}", NoticeWarning, stacklevel=3)
    if not scenarios:
        raise InputError(f"{folder}: has no scenarios; name a folder with .xosc files, or with a manifest.json.")
    if len(errors) == len(scenarios):
        raise next(iter(errors.values()))
    values, space = _varied(scenarios, errors)
    reasons = {path: failure_words(path, error) for path, error in errors.items()}
    return SuiteContents(
        place=folder,
        scenarios=tuple(
            SuiteScenario(scenario.path.name, scenario, parameters, wrong=reasons.get(scenario.path, ""))
            for scenario, parameters in zip(scenarios, values, strict=True)
        ),
        space=space,
    )


def _is_of_something_else(scenario: Scenario) -> bool:
    root = scenario.root
    return root.find("ParameterValueDistribution") is not None or root.find("Catalog") is not None


def _varied(scenarios: Sequence[Scenario], wrong: Container[Path]) -> tuple[list[dict[str, Value]], ParameterSpace]:
    """Parameters that all files declare and that differ; the file name too if these do not distinguish all files."""
    declarations = [
        {}
        if scenario.path in wrong
        else {declaration.name: declaration for declaration in read_declarations(scenario.root, str(scenario.path))}
        for scenario in scenarios
    ]
    names = [
        name
        for name, declaration in declarations[0].items()
        if all(name in scenario and scenario[name].kind == declaration.kind for scenario in declarations)
    ]
    columns = {name: [_value(scenario[name]) for scenario in declarations] for name in names}
    columns = {name: values for name, values in columns.items() if len(set(values)) > 1}
    parameters = [_parameter(name, values) for name, values in columns.items()]
    if len(set(zip(*columns.values(), strict=True))) < len(scenarios):
        files = [declaration.path.name for declaration in scenarios]
        name = _FILE if _FILE not in columns else "scenario file"
        columns[name] = list(files)
        parameters.append(Parameter(name, 0.0, len(files) - 1.0, None, tuple(files)))
    rows: list[dict[str, Value]] = [
        {name: values[k] for name, values in columns.items()} for k in range(len(scenarios))
    ]
    # Declarations distinguish integers and booleans.
    first_declared: Mapping[str, Declaration] = declarations[0]
    return rows, ParameterSpace(parameters).typed(
        [first_declared[name] for name in columns if name in first_declared], str(scenarios[0].path)
    )


def _value(declaration: Declaration) -> Value:
    try:
        return typed_value(declaration.value, declaration.kind)
    except ValueError:
        # It may be an expression.
        return declaration.value


def _parameter(name: str, values: Sequence[Value]) -> Parameter:
    if all(isinstance(value, int | float) for value in values):
        numbers = [float(value) for value in values]
        return Parameter(name, min(numbers), max(numbers))
    choices = tuple(sorted({str(value) for value in values}))
    return Parameter(name, 0.0, len(choices) - 1.0, None, choices)
