"""Writing of the scenario file for a run, with an error that says whether the scenario or its values are at fault."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from cornercase._common.errors import InputError, SimulationError
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import read_xml
from cornercase.simulators.carla._openscenario_1_0 import ConversionOptions, write_openscenario_1_0
from cornercase.simulators.carla._support_table import VERSIONS, describe_version_gap, find_version_gaps


def write_run_scenario(
    scenario: ScenarioFile,
    values: Mapping[str, Value],
    target: Path,
    *,
    ego: str,
    options: ConversionOptions,
    version: str = "",
) -> tuple[str, ...]:
    """Write a concrete scenario for ScenarioRunner like `write_openscenario_1_0`; return notes on differences.

    Raises `SimulationError` if only `values` are at fault, since the scenario can be written with the values of its
    file. Raises `InputError` if it cannot be written with these values either, or if it needs something that
    ScenarioRunner lacks in `version`. A `version` that is not in the support table is not checked.
    """
    try:
        notes = write_openscenario_1_0(scenario, values, target, ego=ego, options=options)
    except InputError as error:
        if values and _can_be_written(scenario, ego, options):
            raise SimulationError(str(error).removesuffix(".")) from error
        raise
    for name, versions in find_version_gaps(read_xml(target)).items():
        if version in VERSIONS and version not in versions:
            raise InputError(f"{scenario.path}: {describe_version_gap(name, versions)}.")
    return notes


def _can_be_written(scenario: ScenarioFile, ego: str, options: ConversionOptions) -> bool:
    with TemporaryDirectory() as folder:
        # In a run the caller makes them.
        for needed in (Path(options.road_file).parent, Path(options.controllers)):
            (Path(folder) / needed).mkdir(parents=True, exist_ok=True)
        try:
            write_openscenario_1_0(scenario, {}, Path(folder) / "scenario.xosc", ego=ego, options=options)
        except InputError:
            return False
    return True
