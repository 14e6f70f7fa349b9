"""`reduce`: select the few concrete scenarios that matter, and write them as files."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_folder
from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase._common.progress import show_bars
from cornercase._common.typing import FloatArray, IntArray
from cornercase._common.unknown_names import suggest_arguments
from cornercase._common.validation import check_float, check_int, check_str
from cornercase.clustering import Analysis, read_analyses, read_analysis
from cornercase.clustering._embedding import Distances
from cornercase.clustering._headline_aspect import find_headline_aspect
from cornercase.evidence._criticality_bands import BANDS_PREFIX, bands_by_scenario
from cornercase.reduction._cluster_shapes import ArchetypeMethod, require_archetype_method
from cornercase.reduction._coverage import CoverageCurves
from cornercase.reduction._critical_clusters import find_critical_clusters
from cornercase.reduction._critical_coverage import DEFAULT_SIMILARITY, check_similarity
from cornercase.reduction._evaluate import (
    StudyData,
    evaluate_coverage,
    evaluate_critical_coverage,
    load_study_data,
    measure_held_out_by_aspect,
    measure_nearest_distances_by_aspect,
)
from cornercase.reduction._held_out_coverage import Fold
from cornercase.reduction._hulls import find_convex_hull
from cornercase.reduction._kill_matrix import KillMatrix
from cornercase.reduction._mutant_selection import add_mutant_selection
from cornercase.reduction._reduced_set import ReducedSet, SelectedScenario
from cornercase.reduction._reduced_set_folder import replace_reduced_set
from cornercase.reduction._reduced_set_manifest import make_manifest, save_reduction
from cornercase.reduction._selection_state import Selected
from cornercase.reduction._write_files import add_scenario_files, name_concrete_file
from cornercase.reduction.selection._per_cluster import SCENARIOS_PER_SELECTED
from cornercase.reduction.selection._select import SelectionInput, SelectionRequest, cross_validate, select_reduced_set
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._damage import reraise_read_errors
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._study_file import open_study

# Needed memory in bytes: per pair of scenarios for a matrix of distances and what the selection derives from it; per
# scenario and aspect for embeddings and random selections; and for blocks of distances.
_BYTES_PER_PAIR: Final = 20
_BYTES_PER_SCENARIO: Final = 5_000
_BYTES_OF_BLOCKS: Final = 600_000_000

_REASONS: Final = {
    "hull": "on the hull of {cluster} in the parameter space",
    "pcha": "at an extreme of {cluster} in the parameter space, by archetypal analysis",
    "parts": "on the hull of a near-convex part of {cluster} in the parameter space",
    "kernel": "at an extreme of {cluster} in kernel space, by archetypal analysis",
    "prototype": "the scenario most like all others of {cluster}",
    "critical prototype": "the scenario most like the critical ones of {cluster}",
    "gap": "for what is unlike all others that are kept",
    # `add_mutant_selection` completes this text once all scenarios are selected.
    "exposing": "exposes mutants of the driver",
}


@suggest_arguments
def reduce(
    study: StudyFile | Path | str,
    folder: Path | str,
    *,
    by: str | None = None,
    size: int | None = None,
    share: float | None = None,
    cover: float | None = None,
    archetypes: int | Literal["auto"] | None = None,
    archetypes_by: ArchetypeMethod = "auto",
    within: float = DEFAULT_SIMILARITY,
    critical: float | None = None,
    kill_matrix: KillMatrix | None = None,
    scenario: Path | str | ScenarioFile | None = None,
    memory: str | float = DEFAULT_MEMORY,
    progress: bool = False,
) -> ReducedSet:
    """Select the few concrete scenarios that represent all of a study, and write them as OpenSCENARIO files.

    By default a tenth of all scenarios is selected. At most one of `size`, `share`, `cover` and `archetypes` can be
    given instead.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that was analysed: an object open for writing, or the path of the file.
    folder : path
        Folder to write. Each scenario file in the folder can be run without the study, and then gives the same
        recording as in the study. ``manifest.json`` says why each scenario was selected. For a study of imported
        recordings only the manifest is written. An earlier reduced set in the folder is replaced as a whole; other
        files are left alone.
    by : str, optional
        Aspect (what scenarios are compared by) whose clusters are represented. The default is the aspect whose clusters
        say most about how scenarios end; the report shows this aspect first. If no aspect has several clusters, the
        default is the first metric of the study, or the last aspect if the study was not analysed by this metric. With
        ``"bands:METRIC"``, the selected scenarios represent bands of high, medium and low criticality by a metric
        instead of clusters; the study must have been analysed by this metric.
    size : int, optional
        Number of scenarios to select.
    share : float, optional
        Share of all scenarios to select, above 0 and up to 1.
    cover : float, optional
        Select few scenarios, such that the distance from each scenario to the nearest selected scenario is at most
        this share of the largest distance of any two scenarios. The share is above 0 and up to 1.
    archetypes : int or "auto", optional
        Select from each cluster only the prototype (most central scenario) and at most this many archetypes (extreme
        scenarios), as in the paper that cornercase follows. ``"auto"`` selects about a tenth of all scenarios.
    archetypes_by : {"auto", "hull", "pcha", "parts", "kernel"}, default "auto"
        Method that finds archetypes: corners of the hull, archetypal analysis, corners of the hulls of near-convex
        parts, or archetypal analysis in kernel space. ``"auto"`` decides by the convexity of each cluster.
    within : float, default 0.5
        Two scenarios count as similar if their distance is at most this share of the median distance within clusters.
        Similarity matters only for the evaluation: for the share of critical scenarios similar to a selected one.
    critical : float, optional
        Score from which a scenario is critical, for selection and evaluation. The default is the threshold of the
        study, which is not changed.
    kill_matrix : KillMatrix, optional
        Which scenarios kill which mutants of the driver, from `cornercase.suite.analyze_mutants`. Scenarios that
        together kill as many mutants as possible come first, then the scenarios that are selected without mutants.
    scenario : path or ScenarioFile, optional
        Logical scenario that was explored, from which the concrete scenario files are made. By default the file is
        looked for at the path that the study holds, next to the study and in the current folder, and is recognised by
        its fingerprint.
    memory : str or float, default "4 GB"
        Memory limit of the process, in bytes or as text.
    progress : bool, default False
        Show a progress bar for steps that take more than two seconds.

    Returns
    -------
    ReducedSet
        The selected scenarios, why each is selected, and what they leave uncovered.

    Raises
    ------
    InputError
        The study was not analysed, an argument is out of range, the scenario file is missing or differs from the
        explored file, the folder cannot be written, or the distances do not fit in the memory.

    Warns
    -----
    NoticeWarning
        Fewer scenarios are selected than `size` or `share` asks for, since all others are similar to a selected one. Or
        scenarios were run after the analysis; these are neither selected nor represented.

    See Also
    --------
    cornercase.analyze : Finds the clusters.

    Examples
    --------
    >>> import cornercase as cc
    >>> reduced = cc.reduce("study.db", "reduced", size=12)  # doctest: +SKIP
    >>> reduced.ids  # doctest: +SKIP
    """
    if sum(option is not None for option in (size, share, cover, archetypes)) > 1:
        raise InputError("`size`, `share`, `cover`, `archetypes`: give only one of them.")
    if kill_matrix is not None and (cover is not None or archetypes is not None):
        raise InputError(f"`kill_matrix`, `{'cover' if archetypes is None else 'archetypes'}`: give only one of them.")
    size_requested = size is not None or share is not None
    size = None if size is None else check_int("size", size, minimum=1)
    share = None if share is None else check_float("share", share, above=0.0)
    cover = None if cover is None else check_float("cover", cover, above=0.0)
    if share is not None and share > 1.0:
        raise InputError(f"`share` {share:g}: give a number above 0 and up to 1.")
    require_archetype_method(check_str("archetypes_by", archetypes_by))
    check_similarity(check_float("within", within))
    by = None if by is None else check_str("by", by)
    folder = check_output_folder("folder", folder)
    limit = MemoryLimit.from_value(memory)
    with show_bars(progress), open_study(study, critical=critical) as opened:
        analysis, band_names = _read_clusters_or_bands(opened, by or default_aspect(opened))
        start = time.monotonic()
        # Checked before anything is written or takes time.
        explored = find_explored_scenario(opened, scenario, search_stored_path=True)
        opened.elapsed_by_stage()
        _require_memory(opened, limit)
        data = load_study_data(opened)
        if share is not None:
            size = max(1, round(share * len(data.rows)))
        elif size is None and cover is None and archetypes is None:
            size = max(1, round(len(analysis.ids) / SCENARIOS_PER_SELECTED))
        selection_input = SelectionInput(
            data.parameter_points(analysis),
            _distances_by_aspect(data, analysis),
            analysis.labels,
            analysis.clustering.embedding,
            find_critical_clusters(opened, analysis),
            np.isin(analysis.ids, np.array(list(data.rows))[opened.critical_mask()]),
            None if kill_matrix is None else kill_matrix.kills_of(analysis.ids.tolist()),
        )
        request = SelectionRequest(size, cover, archetypes, archetypes_by)
        reduced, curves = _select_and_evaluate(data, analysis, selection_input, request, within)
        if band_names:
            reduced = _replace_clusters_by_bands(reduced, band_names)
        if kill_matrix is not None:
            without_mutants, _ = select_reduced_set(replace(selection_input, kills=None), request)
            reduced = add_mutant_selection(
                reduced, kill_matrix, [int(analysis.ids[entry.index]) for entry in without_mutants]
            )
        cluster_names = {profile.cluster: profile.label for profile in analysis.profiles}
        cluster_names |= dict(enumerate(band_names))
        _write_files_and_store(opened, explored, reduced, curves, data.analyses, cluster_names, folder)
        opened.writer.add_elapsed_time("reduce", time.monotonic() - start)
    n_new = len(data.rows.keys() - set(analysis.ids.tolist()))
    if n_new:
        _warn_not_clustered(n_new, len(data.rows))
    if size is not None and size_requested and len(reduced) < size:
        _warn_fewer_selected(size, len(reduced), len(analysis.ids), "no more are clustered" if n_new else "")
    return reduced


def default_aspect(study: StudyFile) -> str:
    """Return the aspect by which scenarios are selected by default.

    An aspect is what scenarios are compared by. The default aspect has the clusters that say most about how scenarios
    end. If no aspect has several clusters, the default is the first metric of the study, or the last aspect if the
    study was analysed, but not by this metric.
    """
    analyses = read_analyses(study)
    searched, headline = study.meta.metrics[0], find_headline_aspect(analyses)
    if headline is None or (searched in analyses and analyses[headline].clustering.n_clusters <= 1):
        return searched
    return headline


def _read_clusters_or_bands(study: StudyFile, by: str) -> tuple[Analysis, list[str]]:
    """Read the clusters, or the bands of criticality, that the selected scenarios are to represent.

    If `by` is an aspect (what scenarios are compared by), the result is its clustering and an empty list. If `by` is
    ``bands:METRIC``, the result is a clustering with a cluster for each band, and the names of the bands.
    """
    if not by.startswith(BANDS_PREFIX):
        return read_analysis(study, by), []
    metric = by.removeprefix(BANDS_PREFIX)
    bands, band_by_id = bands_by_scenario(study, metric)
    analysis = read_analysis(study, metric)
    # A band without a scenario has no group.
    occupied, labels = np.unique([band_by_id[scenario] for scenario in analysis.ids.tolist()], return_inverse=True)
    names = [f"band of {bands.names[k]} criticality by {metric}: {bands.describe_range(k)}" for k in occupied.tolist()]
    return replace(analysis, clustering=replace(analysis.clustering, labels=labels.astype(np.int64))), names


def _replace_clusters_by_bands(reduced: ReducedSet, names: Sequence[str]) -> ReducedSet:
    """Name bands of criticality instead of clusters in the reasons why scenarios were selected."""
    scenarios = tuple(
        replace(entry, why=entry.why.replace(f"{reduced.by} {entry.cluster}", f"the {names[entry.cluster]}"))
        for entry in reduced.scenarios
    )
    return replace(reduced, by=f"{BANDS_PREFIX}{reduced.by}", scenarios=scenarios)


def _warn_not_clustered(n_new: int, n_run: int) -> None:
    were, are = ("was", "is") if n_new == 1 else ("were", "are")
    issue_notice_warning(
        f"{n_new} of the {n_run} scenarios {were} run after the clusters were found and {are} not represented; cluster"
        " again, with `keep_clusters` if the clusters shall stay as they are"
    )


def _warn_fewer_selected(n_requested: int, n_selected: int, n_clustered: int, why_no_more: str) -> None:
    reason = (
        f"each of the other {n_clustered - n_selected} is nearly the same as a selected scenario (distance at most"
        " 0.001 of the largest distance)"
    )
    if n_selected == n_clustered:
        reason = why_no_more or "the study has no more"
    issue_notice_warning(f"{n_requested} scenarios were asked for, but {n_selected} are selected: {reason}")


def _require_memory(study: StudyFile, memory_limit: MemoryLimit) -> None:
    """Raise an error if the distances will not fit in memory, before they are read."""
    analyses = read_analyses(study).values()
    count = max(len(analysis.ids) for analysis in analyses)
    pairs = [len(analysis.ids) ** 2 for analysis in analyses if analysis.embedding_error is None]
    need = _BYTES_PER_PAIR * sum(pairs) + _BYTES_PER_SCENARIO * count * len(analyses) + _BYTES_OF_BLOCKS
    advice = ", or `analyze` it again by fewer aspects" if len(analyses) > 1 else ""
    memory_limit.check_fits(need, f"{study.path}: the distances of {count} scenarios", f"give more{advice}")


def _distances_by_aspect(data: StudyData, analysis: Analysis) -> list[Distances]:
    """Return the distances by the aspect of `analysis`, then by each other aspect with as many analysed scenarios."""
    others = [
        data.distances[name]
        for name, other in data.analyses.items()
        if name != analysis.by and len(other.ids) == len(analysis.ids)
    ]
    return [data.distances[analysis.by], *others]


def _select_and_evaluate(
    data: StudyData, analysis: Analysis, selection_input: SelectionInput, request: SelectionRequest, similarity: float
) -> tuple[ReducedSet, dict[str, CoverageCurves]]:
    """Select scenarios, with a reason for each, and evaluate the set; also return its coverage curves by aspect."""
    selected, shaped = select_reduced_set(selection_input, request)
    ids = analysis.ids.tolist()
    selected_ids = [ids[entry.index] for entry in selected]
    methods = {entry.shape.cluster: entry.shape.method for entry in shaped}
    folds = [
        Fold(*(analysis.ids[rows] for rows in (entry.training, entry.selected, entry.held_out)))
        for entry in cross_validate(selection_input, request)
    ]
    held_out = measure_held_out_by_aspect(data, folds)
    gaps = measure_nearest_distances_by_aspect(data, selected_ids)
    reduced = ReducedSet(
        by=analysis.by,
        n_run=len(data.rows),
        scenarios=tuple(
            _make_selected_scenario(
                data,
                analysis.by,
                entry,
                ids[entry.index],
                methods[entry.cluster] if entry.role == "archetype" else entry.role,
            )
            for entry in selected
        ),
        shapes=tuple(entry.shape for entry in shaped),
        coverage=evaluate_coverage(data, selected_ids, held_out, gaps),
        critical=evaluate_critical_coverage(data, selected_ids, held_out, similarity, gaps),
        hulls={entry.shape.cluster: _hull_facets(selection_input.points, entry.parts, ids) for entry in shaped},
        threshold=data.study.critical,
    )
    return reduced, {name: CoverageCurves.from_nearest_distances(distances) for name, distances in gaps.items()}


def _make_selected_scenario(
    data: StudyData, by: str, selected: Selected, scenario_id: int, reason: str
) -> SelectedScenario:
    meta = data.study.meta
    # An imported recording is run again by its own simulator; the manifest names it.
    imported = meta.simulator == IMPORTED_SIMULATOR
    with reraise_read_errors(data.study.path):
        file = meta.files[scenario_id - 1] if imported else name_concrete_file(meta, scenario_id)
    return SelectedScenario(
        id=scenario_id,
        file=file,
        cluster=selected.cluster,
        role=selected.role,
        why=_REASONS[reason].format(cluster=f"{by} {selected.cluster}" if selected.cluster >= 0 else f"noise by {by}"),
        values=dict(data.rows[scenario_id].values),
        scores={name: scores[scenario_id] for name, scores in data.scores.items()},
    )


def _hull_facets(points: FloatArray, parts: Sequence[IntArray], ids: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Return the facets of the convex hulls of a cluster's parts; a facet lists the scenario ids at its corners."""
    return tuple(
        tuple(ids[part[i]] for i in facet)
        for part in parts
        for facet in find_convex_hull(points[part]).simplices.tolist()
    )


def _write_files_and_store(
    study: StudyFile,
    scenario: ScenarioFile | None,
    reduced_set: ReducedSet,
    curves: Mapping[str, CoverageCurves],
    analyses: Mapping[str, Analysis],
    cluster_names: Mapping[int, str],
    folder: Path,
) -> None:
    """Write the selected scenarios and the manifest, and store the reduced set in the study.

    If an error occurs before the new manifest is in the folder, neither the folder nor the study changes. After that,
    the new set counts, and the next reader or writer of the folder moves the files that are missing.
    """
    with replace_reduced_set(folder) as set_folder:
        if scenario is not None:
            add_scenario_files(set_folder, study, scenario, reduced_set.scenarios, folder)
        set_folder.write_manifest(make_manifest(study, reduced_set, cluster_names, set_folder.digests))
        previous = None if study.read_reduction() is None else study.read_analysis("reduction")
        save_reduction(study, reduced_set, curves, analyses)
        try:
            set_folder.replace()
        except InputError:
            study.writer.save_analyses({"reduction": previous})
            raise
