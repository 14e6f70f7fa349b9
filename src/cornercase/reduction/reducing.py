"""`reduce`: select the few concrete scenarios that matter, and write them as files."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

from cornercase._common.arguments import number, text, whole_number
from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.files import portable_name, require_folder
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase._common.progress import bars_wanted
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Analysis, Distances, read_analyses, read_analysis
from cornercase.reduction.choosing import Material, Wish, choose, try_choice
from cornercase.reduction.cluster_selection import PER_KEPT
from cornercase.reduction.cluster_shapes import ArchetypeMethod, require_archetype_method
from cornercase.reduction.critical_clusters import find_critical_clusters
from cornercase.reduction.critical_coverage import WITHIN, require_within
from cornercase.reduction.exposing import with_exposure
from cornercase.reduction.exposure import Exposure
from cornercase.reduction.grading import Ran, find_gaps, grade, grade_critical, hold_out, read_ran
from cornercase.reduction.held_out import Trial
from cornercase.reduction.hulls import find_hull
from cornercase.reduction.kept import Kept
from cornercase.reduction.manifest import make_manifest, save_reduction
from cornercase.reduction.reduced_set import KeptScenario, ReducedSet
from cornercase.reduction.set_folder import replaced_set
from cornercase.scenario import Scenario, fill_concrete, read_beside
from cornercase.study import IMPORTED, Study, damage_told, explored_scenario, open_study

# Bytes per pair in a matrix and in what the selection derives from it, per scenario and aspect in embeddings and gaps
# of random selections, and for blocks of distances.
_OF_A_PAIR: Final = 20
_OF_A_SCENARIO: Final = 5_000
_OF_BLOCKS: Final = 600_000_000

_WHY: Final = {
    "hull": "on the hull of cluster {cluster} in the parameter space",
    "pcha": "at an extreme of cluster {cluster} in the parameter space, by archetypal analysis",
    "parts": "on the hull of a near-convex part of cluster {cluster} in the parameter space",
    "kernel": "at an extreme of cluster {cluster} in kernel space, by archetypal analysis",
    "prototype": "the scenario most like all others of cluster {cluster}",
    "gap": "for what is unlike all others that are kept",
    # Completed by `with_exposure` once all are selected.
    "exposing": "exposes mutants of the driver",
}


def reduce(
    study: Study | Path | str,
    folder: Path | str,
    *,
    by: str | None = None,
    size: int | None = None,
    share: float | None = None,
    cover: float | None = None,
    archetypes: int | Literal["auto"] | None = None,
    archetypes_by: ArchetypeMethod = "auto",
    within: float = WITHIN,
    critical: float | None = None,
    exposure: Exposure | None = None,
    scenario: Path | str | Scenario | None = None,
    memory: str | float = DEFAULT_MEMORY,
    progress: bool = False,
) -> ReducedSet:
    """Select the few concrete scenarios that matter, and write them as OpenSCENARIO files.

    By default a tenth of all is selected. At most one of `size`, `share`, `cover` and `archetypes` can be given
    instead.

    Parameters
    ----------
    study : Study or path
        Open for writing, or the file; analysed.
    folder : path
        Folder to write. Each file in it runs by itself and gives the same recording; ``manifest.json`` says why each
        was selected. For a study of imported recordings only the manifest is written. An earlier set in the folder is
        replaced as a whole; other files are left alone.
    by : str, optional
        Aspect whose clusters count; by default the metric that was searched.
    size : int, optional
        Number of scenarios to select.
    share : float, optional
        Share of all scenarios to select, above 0 and up to 1.
    cover : float, optional
        Select as few as leave no scenario farther from a selected one than this share of the largest distance.
    archetypes : int or "auto", optional
        Select only the prototype of each cluster and at most this many archetypes, as the paper does; ``"auto"``
        selects about a tenth of all scenarios.
    archetypes_by : {"auto", "hull", "pcha", "parts", "kernel"}, default "auto"
        How archetypes are found: corners of the hull, archetypal analysis, corners of the hulls of near-convex parts,
        or archetypal analysis in kernel space; ``"auto"`` decides by the convexity of each cluster.
    within : float, default 0.5
        Share of the median distance within clusters up to which two scenarios are similar; for the coverage of the
        critical scenarios.
    critical : float, optional
        Score from which a scenario is critical, to select and to evaluate by; by default that of the study, which is
        not changed.
    kill_matrix : KillMatrix, optional
        Which scenarios kill which mutants of the driver, from `cornercase.suite.find_exposure`: scenarios that kill as
        many as possible come first, then those that are selected without.
    scenario : path or Scenario, optional
        File that was explored, from which the files are made. By default it is searched at the path in the study, next
        to the study and in the current folder, and recognised by its fingerprint.
    memory : str or float, default "4 GB"
        Memory limit of the process, in bytes or as text.
    progress : bool, default False
        Show a bar for what takes more than two seconds.

    Returns
    -------
    ReducedSet
        The selected scenarios, why each is selected, and what they leave uncovered.

    Raises
    ------
    InputError
        The study was not analysed, an argument is out of range, the scenario file is not found or not the one that was
        explored, the folder cannot be written, or the distances do not fit in the memory.

    Warns
    -----
    NoticeWarning
        Fewer are selected than `size` or `share` asks for, since all others are similar to a selected one.

    See Also
    --------
    cornercase.analyze : Finds the clusters.
    """
    if sum(option is not None for option in (size, share, cover, archetypes)) > 1:
        raise InputError("`size`, `share`, `cover`, `archetypes`: give one of them.")
    if exposure is not None and (cover is not None or archetypes is not None):
        raise InputError(f"`exposure`, `{'cover' if archetypes is None else 'archetypes'}`: give one of them.")
    size_requested = size is not None or share is not None
    size = None if size is None else whole_number("size", size, least=1)
    share = None if share is None else number("share", share, above=0.0)
    cover = None if cover is None else number("cover", cover, above=0.0)
    if share is not None and share > 1.0:
        raise InputError(f"`share` {share:g}: give a number above 0 and up to 1.")
    require_archetype_method(text("archetypes_by", archetypes_by))
    require_within(number("within", within))
    by = None if by is None else text("by", by)
    folder = require_folder("folder", folder)
    limit = MemoryLimit.of(memory)
    with bars_wanted(progress), open_study(study, critical=critical) as opened:
        analysis = read_analysis(opened, by or opened.meta.metrics[0])
        start = time.monotonic()
        # Checked before anything is written or takes time.
        explored = explored_scenario(opened, scenario, where_named=True)
        opened.elapsed()
        _require_memory(opened, limit)
        data = read_ran(opened)
        if share is not None:
            size = max(1, round(share * len(data.rows)))
        elif size is None and cover is None and archetypes is None:
            size = max(1, round(len(analysis.ids) / PER_KEPT))
        selection_input = Material(
            data.points(analysis),
            _compared(data, analysis),
            analysis.labels,
            analysis.clustering.embedding,
            find_critical_clusters(opened, analysis),
            None if exposure is None else exposure.rows_of(analysis.ids.tolist()),
        )
        request = Wish(size, cover, archetypes, archetypes_by)
        reduced = _described(data, analysis, selection_input, request, within)
        if exposure is not None:
            without_mutants, _ = choose(replace(selection_input, exposed=None), request)
            reduced = with_exposure(reduced, exposure, [int(analysis.ids[entry.index]) for entry in without_mutants])
        cluster_names = {profile.cluster: profile.label for profile in analysis.profiles}
        _write(opened, explored, reduced, cluster_names, folder)
        opened.writer.add_elapsed("reduce", time.monotonic() - start)
    if size is not None and size_requested and len(reduced) < size:
        _tell_fewer(size, len(reduced), len(analysis.ids))
    return reduced


def _tell_fewer(asked: int, kept: int, among: int) -> None:
    reason = f"each of the other {among - kept} is within a thousandth of the largest distance of one of these"
    if kept == among:
        reason = "the study has no more"
    warnings.warn(f"{asked} scenarios were asked for, but {kept} are selected: {reason}", NoticeWarning, stacklevel=3)


def _require_memory(study: Study, limit: MemoryLimit) -> None:
    """Raise an error if the distances will not fit, before they are read."""
    analyses = read_analyses(study).values()
    count = max(len(analysis.ids) for analysis in analyses)
    pairs = [len(analysis.ids) ** 2 for analysis in analyses if analysis.inexact is None]
    need = _OF_A_PAIR * sum(pairs) + _OF_A_SCENARIO * count * len(analyses) + _OF_BLOCKS
    advice = ", or `analyze` it again by fewer aspects" if len(analyses) > 1 else ""
    limit.require(need, f"{study.path}: the distances of {count} scenarios", f"give more{advice}")


def _compared(ran: Ran, analysis: Analysis) -> list[Distances]:
    """Distances by the main aspect, then by the others with the same scenarios."""
    others = [
        ran.distances[name]
        for name, other in ran.analyses.items()
        if name != analysis.by and len(other.ids) == len(analysis.ids)
    ]
    return [ran.distances[analysis.by], *others]


def _described(ran: Ran, analysis: Analysis, material: Material, wish: Wish, within: float) -> ReducedSet:
    """Select scenarios, describe why, and evaluate what they leave uncovered."""
    selected, shaped = choose(material, wish)
    ids = analysis.ids.tolist()
    selected_ids = [ids[entry.index] for entry in selected]
    methods = {entry.shape.cluster: entry.shape.method for entry in shaped}
    folds = [
        Trial(*(analysis.ids[rows] for rows in (entry.chosen_from, entry.kept, entry.judging)))
        for entry in try_choice(material, wish)
    ]
    held_out = hold_out(ran, folds)
    gaps = find_gaps(ran, selected_ids)
    return ReducedSet(
        by=analysis.by,
        run=len(ran.rows),
        kept=tuple(
            _kept_scenario(
                ran, entry, ids[entry.index], methods[entry.cluster] if entry.role == "archetype" else entry.role
            )
            for entry in selected
        ),
        shapes=tuple(entry.shape for entry in shaped),
        coverage=grade(ran, selected_ids, held_out, gaps),
        critical=grade_critical(ran, selected_ids, held_out, within, gaps),
        hulls={entry.shape.cluster: _facets(material.points, entry.parts, ids) for entry in shaped},
        threshold=ran.study.critical,
    )


def _kept_scenario(ran: Ran, one: Kept, scenario: int, reason: str) -> KeptScenario:
    meta = ran.study.meta
    # An imported recording is run again by its own simulator; the manifest names it.
    imported = meta.simulator == IMPORTED
    with damage_told(ran.study.path):
        file = meta.files[scenario - 1] if imported else f"{portable_name(meta.title)}-{scenario:05}.xosc"
    return KeptScenario(
        id=scenario,
        file=file,
        cluster=one.cluster,
        role=one.role,
        why=_WHY[reason].format(cluster=one.cluster),
        values=dict(ran.rows[scenario].values),
        scores={name: scores[scenario] for name, scores in ran.scores.items()},
    )


def _facets(points: FloatArray, parts: Sequence[IntArray], ids: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Facets of the hulls of a cluster's parts, by the ids of the scenarios at their corners."""
    return tuple(
        tuple(ids[part[i]] for i in facet) for part in parts for facet in find_hull(points[part]).simplices.tolist()
    )


def _write(
    study: Study, scenario: Scenario | None, reduced: ReducedSet, kinds: Mapping[int, str], folder: Path
) -> None:
    """Write the selected scenarios and the manifest, and store them in the study: all of it or nothing."""
    drivers = {
        entity: driver for entity, driver in study.meta.settings.get("drivers", {}).items() if isinstance(driver, str)
    }
    dependencies: dict[Path, bytes] = {}
    with replaced_set(folder) as set_folder:
        for selected in reduced.kept if scenario is not None else ():
            assert scenario is not None
            comment = f"Scenario {selected.id} of the logical scenario {study.meta.title}: {selected.why}"
            concrete = fill_concrete(scenario, selected.values, folder / selected.file, drivers, comment)
            for source, path, root in concrete.beside:
                if source not in dependencies:
                    dependencies[source] = read_beside(source, root)
                set_folder.add(path, dependencies[source])
            set_folder.add(selected.file, concrete.content)
        set_folder.seal(make_manifest(study, reduced, kinds, set_folder.digests))
        previous = study.reduction()
        save_reduction(study, reduced)
        try:
            set_folder.replace()
        except InputError:
            study.writer.save_analyses({"reduction": None if previous is None else ({}, previous)})
            raise
