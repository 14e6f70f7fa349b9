"""Write scenarios of a study as concrete scenario files: the scenarios of a reduced set, or those that a user chose."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_folder, make_portable_file_name
from cornercase.clustering import Analysis, read_analyses
from cornercase.clustering._headline_aspect import find_headline_aspect
from cornercase.drivers._parameters import spec_with_values
from cornercase.drivers._resolve import create_driver_named_in_file, may_be_named_in_file
from cornercase.reduction._reduced_set import ReducedSet, SelectedScenario
from cornercase.reduction._reduced_set_folder import ReducedSetFolder, replace_reduced_set
from cornercase.reduction._reduced_set_manifest import make_manifest
from cornercase.scenario import Value
from cornercase.scenario._concrete_file import ConcreteFile, build_concrete_file, read_required_xml
from cornercase.scenario._file import ScenarioFile
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._study_file import open_study


def write_chosen_scenarios(
    study: StudyFile | Path | str,
    folder: Path | str,
    ids: Iterable[int],
    *,
    scenario: Path | str | ScenarioFile | None = None,
    critical: float | None = None,
) -> tuple[SelectedScenario, ...]:
    """Write the scenarios with these ids as a suite: concrete scenario files and a manifest, as `reduce` writes them.

    The study is not changed. `InputError` if an id is unknown, if a scenario was not run yet, if there is no scenario
    file, or if the folder cannot be written.
    """
    folder = check_output_folder("folder", folder)
    with open_study(study, readonly=True, critical=critical) as opened:
        if opened.meta.suite:
            raise InputError(
                f"{opened.path}: is the run of a suite, whose scenarios are files already; copy these files instead."
            )
        rows = _read_scenarios_by_id(opened, ids)
        explored = find_explored_scenario(opened, scenario, search_stored_path=True)
        if explored is None:
            raise InputError(
                f"{opened.path}: the recordings of this study were imported, so there is no scenario file to write."
            )
        analyses = read_analyses(opened)
        headline = find_headline_aspect(analyses)
        analysis = None if headline is None else analyses[headline]
        chosen = _chosen_scenarios(opened, rows, analysis)
        names = {} if analysis is None else {profile.cluster: profile.label for profile in analysis.profiles}
        chosen_set = ReducedSet(
            by=headline or "",
            n_run=len(opened.finished_rows()),
            scenarios=chosen,
            shapes=(),
            coverage={},
            critical={},
            hulls={},
            threshold=opened.critical,
        )
        with replace_reduced_set(folder) as set_folder:
            add_scenario_files(set_folder, opened, explored, chosen, folder)
            set_folder.write_manifest(make_manifest(opened, chosen_set, names, set_folder.digests))
            set_folder.replace()
    return chosen


def name_concrete_file(meta: StudyMeta, scenario_id: int) -> str:
    """Return the file name of a concrete scenario of a study."""
    return f"{make_portable_file_name(meta.title)}-{scenario_id:05}.xosc"


def add_scenario_files(
    set_folder: ReducedSetFolder,
    study: StudyFile,
    scenario: ScenarioFile,
    selected: Sequence[SelectedScenario],
    folder: Path,
) -> None:
    """Add the files of selected scenarios to a new set in `folder`, with the roads and catalogs that they need."""
    dependencies: dict[Path, bytes] = {}
    for item in selected:
        comment = f"Scenario {item.id} of the logical scenario {study.meta.title}: {item.why}"
        concrete = build_scenario_file(study.meta, scenario, item.values, folder / item.file, comment)
        for source, path, root in concrete.companions:
            if source not in dependencies:
                dependencies[source] = read_required_xml(source, root)
            set_folder.add(path, dependencies[source])
        set_folder.add(item.file, concrete.content)


def build_scenario_file(
    meta: StudyMeta, scenario: ScenarioFile, values: Mapping[str, Value], target: Path, description: str
) -> ConcreteFile:
    """Build the file of a concrete scenario of a study with its drivers; values of drivers end the description."""
    if of_drivers := scenario.parse_driver_option_names(values):
        description += f"; {', '.join(f'{name}={values[name]}' for name in of_drivers)}"
    named = {entity: driver for entity, driver in meta.drivers.items() if isinstance(driver, str)}
    drivers = named | _drivers_with_values(scenario, meta.drivers, values)
    return build_concrete_file(scenario, values, target, drivers, description)


def _read_scenarios_by_id(study: StudyFile, ids: Iterable[int]) -> list[ScenarioRecord]:
    """Return the scenarios with these ids, in the order of their ids."""
    rows = {row.id: row for row in study.rows()}
    wanted = sorted(set(ids))
    if not wanted:
        raise InputError("`ids`: no id is given; give at least one.")
    unknown = [number for number in wanted if number not in rows]
    if unknown:
        which = f"the ids {min(rows)} to {max(rows)}" if rows else "no scenarios"
        raise InputError(
            f"`ids` {_format_ids(unknown)}: {study.path} has no such scenario; it has {which}. Look up ids in the table"
            " of the study's report."
        )
    pending = [number for number in wanted if rows[number].state not in ("done", "failed")]
    if pending:
        raise InputError(
            f"`ids` {_format_ids(pending)}: not run yet; run `explore` to the end, or leave these ids out."
        )
    return [rows[number] for number in wanted]


def _format_ids(ids: Sequence[int]) -> str:
    shown = ", ".join(map(str, ids[:5]))
    return shown if len(ids) <= 5 else f"{shown} and {len(ids) - 5} more"


def _chosen_scenarios(
    study: StudyFile, rows: Sequence[ScenarioRecord], analysis: Analysis | None
) -> tuple[SelectedScenario, ...]:
    labels = {} if analysis is None else dict(zip(analysis.ids.tolist(), analysis.labels.tolist(), strict=True))
    indices = {row.id: k for k, row in enumerate(study.finished_rows())}
    scores = {name: study.scores(name) for name in study.meta.metrics} if indices else {}
    return tuple(
        SelectedScenario(
            id=row.id,
            file=name_concrete_file(study.meta, row.id),
            cluster=labels.get(row.id, -1),
            role="chosen",
            why="chosen by its id" if row.state == "done" else "chosen by its id; it failed",
            values=dict(row.values),
            scores={
                name: float(column[indices[row.id]])
                for name, column in scores.items()
                if row.id in indices and math.isfinite(column[indices[row.id]])
            },
        )
        for row in rows
    )


def _drivers_with_values(
    scenario: ScenarioFile, drivers: Mapping[str, object], values: Mapping[str, Value]
) -> dict[str, str]:
    """Return, by entity, the text that names its driver with the driver parameters that the study varied.

    A scenario file can only name drivers that cornercase defines; for other drivers, the manifest has the values.
    """
    by_entity: dict[str, dict[str, Value]] = {}
    for full_name, (entity, name) in scenario.parse_driver_option_names(values).items():
        by_entity.setdefault(entity, {})[name] = values[full_name]
    named: dict[str, str] = {}
    for entity, own in by_entity.items():
        driver = drivers.get(entity, scenario.drivers.get(entity))
        if isinstance(driver, str) and may_be_named_in_file(driver):
            named[entity] = spec_with_values(entity, create_driver_named_in_file(driver), own)
    return named
