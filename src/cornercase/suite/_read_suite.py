"""Read a suite from a folder or a manifest."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.text.sanitize import escape_control_characters
from cornercase._common.validation import check_path as path_argument
from cornercase.reduction._reduced_set_folder import MANIFEST
from cornercase.scenario import Parameter, ParameterDeclaration, ParameterSpace, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._results import describe_file_error
from cornercase.suite._manifest import convert_to_declared_type, declarations_by_name, read_manifest
from cornercase.suite._suite_contents import SuiteContents, SuiteScenario

_FILE_PARAMETER: Final = "file"


def read_suite(source: Path | str) -> SuiteContents:
    """Read a suite from a manifest, the folder of a manifest, a folder of scenario files, or one scenario file.

    Files in a folder that are not scenarios are left out, and a notice names them.
    """
    path = path_argument("suite", source)
    if path.is_dir():
        manifest = path / MANIFEST
        return read_manifest(manifest) if manifest.is_file() else _suite_from_files(path, sorted(path.glob("*.xosc")))
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; name a folder of scenarios, or the manifest.json that `reduce` wrote."
        )
    return _suite_from_files(path, [path]) if path.suffix.lower() == ".xosc" else read_manifest(path)


def _suite_from_files(folder: Path, files: Sequence[Path]) -> SuiteContents:
    for file in files:
        # Names are stored as UTF-8.
        if (
            readable := escape_control_characters(file.name).replace("\n", "\\n").encode(errors="replace").decode()
        ) != file.name:
            raise InputError(
                f"{folder}: the file name '{readable}' has control characters or is not UTF-8; rename the file."
            )
    scenarios, errors = list[ScenarioFile](), dict[Path, InputError]()
    ignored = []
    for file in files:
        try:
            if _is_not_scenario(ScenarioFile(file)):
                ignored.append(file.name)
                continue
            scenarios.append(ScenarioFile.read(file))
        except InputError as error:
            errors[file] = error
            scenarios.append(ScenarioFile(file))
    if ignored:
        issue_notice_warning(f"not run, because they are not scenarios: {', '.join(ignored)}")
    if not scenarios:
        raise InputError(f"{folder}: has no scenarios; name a folder with .xosc files, or with a manifest.json.")
    if len(errors) == len(scenarios):
        raise next(iter(errors.values()))
    values, space = _find_varied_parameters(scenarios, errors)
    reasons = {path: describe_file_error(path, error) for path, error in errors.items()}
    return SuiteContents(
        path=folder,
        scenarios=tuple(
            SuiteScenario(scenario.path.name, scenario, parameters, error=reasons.get(scenario.path, ""))
            for scenario, parameters in zip(scenarios, values, strict=True)
        ),
        space=space,
    )


def _is_not_scenario(scenario: ScenarioFile) -> bool:
    root = scenario.root
    return root.find("ParameterValueDistribution") is not None or root.find("Catalog") is not None


def _find_varied_parameters(
    scenarios: Sequence[ScenarioFile], unreadable: Container[Path]
) -> tuple[list[dict[str, Value]], ParameterSpace]:
    """Return the values of the parameters that differ between the files, for each file, and the space of these values.

    If these values do not distinguish all files, the file name is added as a parameter.
    """
    declarations = [{} if scenario.path in unreadable else declarations_by_name(scenario) for scenario in scenarios]
    names = [
        name
        for name, declaration in declarations[0].items()
        if all(name in declared and declared[name].type_name == declaration.type_name for declared in declarations)
    ]
    columns = {
        name: [convert_to_declared_type(declared[name].value, declared[name]) for declared in declarations]
        for name in names
    }
    columns = {name: values for name, values in columns.items() if len(set(values)) > 1}
    parameters = [_make_parameter(name, values) for name, values in columns.items()]
    if len(set(zip(*columns.values(), strict=True))) < len(scenarios):
        files = [scenario.path.name for scenario in scenarios]
        name = _FILE_PARAMETER if _FILE_PARAMETER not in columns else "scenario file"
        columns[name] = list(files)
        parameters.append(Parameter(name, 0.0, len(files) - 1.0, None, tuple(files)))
    rows: list[dict[str, Value]] = [
        {name: values[k] for name, values in columns.items()} for k in range(len(scenarios))
    ]
    # Declarations distinguish integers and booleans.
    first_declared: Mapping[str, ParameterDeclaration] = declarations[0]
    return rows, ParameterSpace(parameters).with_types(
        [first_declared[name] for name in columns if name in first_declared], str(scenarios[0].path)
    )


def _make_parameter(name: str, values: Sequence[Value]) -> Parameter:
    if all(isinstance(value, int | float) for value in values):
        numbers = [float(value) for value in values]
        return Parameter(name, min(numbers), max(numbers))
    choices = tuple(sorted({str(value) for value in values}))
    return Parameter(name, 0.0, len(choices) - 1.0, None, choices)
