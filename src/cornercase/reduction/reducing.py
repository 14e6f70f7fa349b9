"""From clusters to the few concrete scenarios that matter, as files."""

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

# Bytes: of a pair in a matrix and in what the choice makes of it, of a scenario and aspect in places, gaps of random
# choices and what is left, and of blocks of distances.
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
    # Which mutants is said once all are chosen.
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
    """Keep the few concrete scenarios that matter, and write them as OpenSCENARIO files.

    By default a tenth of all is kept. `size`, `share`, `cover` and `archetypes` say otherwise; at most one of them can
    be given.

    Parameters
    ----------
    study : Study or path
        Open for writing, or the file; analysed.
    folder : path
        Folder to write. Each file in it runs by itself and gives the same recording; ``manifest.json`` says why each is
        there. Of a study of imported recordings only the manifest is written. An earlier set in it is replaced as a
        whole; files that belong to none stay.
    by : str, optional
        Aspect whose clusters count; by default the searched metric.
    size : int, optional
        Number of scenarios to keep.
    share : float, optional
        Share of all scenarios to keep, above 0 and up to 1.
    cover : float, optional
        Keep as few as leave no scenario farther from a kept one than this share of the largest distance.
    archetypes : int or "auto", optional
        Keep nothing but the prototype of each cluster and so many archetypes at most, as in
        `cornercase.reduction.cluster_selection.choose_by_cluster`.
    archetypes_by : {"auto", "hull", "pcha", "parts", "kernel"}, default "auto"
        How archetypes are found, as in `cornercase.reduction.cluster_shapes.find_shapes`.
    within : float, default 0.5
        Share of the median distance within clusters up to which two scenarios are alike; for the coverage of the
        critical scenarios.
    critical : float, optional
        Score from which a scenario is critical, to choose and to grade by; by default that of the study, which stays
        as it is.
    exposure : Exposure, optional
        Which scenarios expose which mutants of the driver, as `cornercase.suite.find_exposure` finds it: scenarios that
        expose as many as possible are kept first, as in `cornercase.reduction.exposing.choose_exposing`, and then those
        that are kept without.
    scenario : path or Scenario, optional
        File that was explored, from which the files are made. By default it is looked for where the study names it,
        beside the study and in the current folder, and known by its fingerprint.
    memory : str or float, default "4 GB"
        That the process may take, in bytes or in words.
    progress : bool, default False
        Show a bar for what takes more than two seconds.

    Returns
    -------
    ReducedSet
        What is kept and why, and what that leaves out.

    Raises
    ------
    InputError
        The study was not analysed, an argument is out of range, the scenario file is not found or not the one that was
        explored, the folder cannot be written, or the distances do not fit in the memory.

    Warns
    -----
    NoticeWarning
        Fewer are kept than `size` or `share` asks for, as all others are like a kept one.

    See Also
    --------
    cornercase.analyze : Finds the clusters.
    cornercase.reduction.choose_scenarios : Chooses the scenarios.
    """
    if sum(one is not None for one in (size, share, cover, archetypes)) > 1:
        raise InputError("`size`, `share`, `cover`, `archetypes`: give one of them.")
    if exposure is not None and (cover is not None or archetypes is not None):
        raise InputError(f"`exposure`, `{'cover' if archetypes is None else 'archetypes'}`: give one of them.")
    asked = size is not None or share is not None
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
        begun = time.monotonic()
        # Looked at before anything is written or takes time.
        explored = explored_scenario(opened, scenario, where_named=True)
        opened.elapsed()
        _require_memory(opened, limit)
        ran = read_ran(opened)
        if share is not None:
            size = max(1, round(share * len(ran.rows)))
        elif size is None and cover is None and archetypes is None:
            size = max(1, round(len(analysis.ids) / PER_KEPT))
        material = Material(
            ran.points(analysis),
            _compared(ran, analysis),
            analysis.labels,
            analysis.clustering.embedding,
            find_critical_clusters(opened, analysis),
            None if exposure is None else exposure.rows_of(analysis.ids.tolist()),
        )
        wish = Wish(size, cover, archetypes, archetypes_by)
        reduced = _described(ran, analysis, material, wish, within)
        if exposure is not None:
            plain, _ = choose(replace(material, exposed=None), wish)
            reduced = with_exposure(reduced, exposure, [int(analysis.ids[one.index]) for one in plain])
        kinds = {profile.cluster: profile.label for profile in analysis.profiles}
        _write(opened, explored, reduced, kinds, folder)
        opened.writer.add_elapsed("reduce", time.monotonic() - begun)
    if size is not None and asked and len(reduced) < size:
        _tell_fewer(size, len(reduced), len(analysis.ids))
    return reduced


def _tell_fewer(asked: int, kept: int, among: int) -> None:
    there = f"each of the other {among - kept} is like one of these, to a thousandth of the largest distance"
    if kept == among:
        there = "the study has no more"
    warnings.warn(f"{asked} scenarios were asked for, and {kept} are kept: {there}", NoticeWarning, stacklevel=3)


def _require_memory(study: Study, limit: MemoryLimit) -> None:
    """Refuse distances that do not fit, before they are read."""
    known = read_analyses(study).values()
    count = max(len(one.ids) for one in known)
    pairs = [len(one.ids) ** 2 for one in known if one.inexact is None]
    need = _OF_A_PAIR * sum(pairs) + _OF_A_SCENARIO * count * len(known) + _OF_BLOCKS
    fewer = ", or `analyze` it again by fewer aspects" if len(known) > 1 else ""
    limit.require(need, f"{study.path}: the distances of {count} scenarios", f"give more{fewer}")


def _compared(ran: Ran, analysis: Analysis) -> list[Distances]:
    """Distances by the aspect that counts, then by the others that the same scenarios were analysed by."""
    others = [
        ran.distances[name]
        for name, one in ran.analyses.items()
        if name != analysis.by and len(one.ids) == len(analysis.ids)
    ]
    return [ran.distances[analysis.by], *others]


def _described(ran: Ran, analysis: Analysis, material: Material, wish: Wish, within: float) -> ReducedSet:
    """Choose scenarios, and say of them what they are, and what they leave out."""
    kept, shaped = choose(material, wish)
    ids = analysis.ids.tolist()
    kept_ids = [ids[one.index] for one in kept]
    methods = {one.shape.cluster: one.shape.method for one in shaped}
    trials = [
        Trial(*(analysis.ids[rows] for rows in (one.chosen_from, one.kept, one.judging)))
        for one in try_choice(material, wish)
    ]
    held_out = hold_out(ran, trials)
    gaps = find_gaps(ran, kept_ids)
    return ReducedSet(
        by=analysis.by,
        run=len(ran.rows),
        kept=tuple(
            _kept_scenario(ran, one, ids[one.index], methods[one.cluster] if one.role == "archetype" else one.role)
            for one in kept
        ),
        shapes=tuple(one.shape for one in shaped),
        coverage=grade(ran, kept_ids, held_out, gaps),
        critical=grade_critical(ran, kept_ids, held_out, within, gaps),
        hulls={one.shape.cluster: _facets(material.points, one.parts, ids) for one in shaped},
        threshold=ran.study.critical,
    )


def _kept_scenario(ran: Ran, one: Kept, scenario: int, reason: str) -> KeptScenario:
    meta = ran.study.meta
    # An imported recording is run again where it came from; the manifest says which one it was.
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
    """Write the kept scenarios and the manifest, and note in the study which they are: all of it or nothing."""
    drivers = {
        entity: driver for entity, driver in study.meta.settings.get("drivers", {}).items() if isinstance(driver, str)
    }
    beside: dict[Path, bytes] = {}
    with replaced_set(folder) as written:
        for one in reduced.kept if scenario is not None else ():
            assert scenario is not None
            why = f"Scenario {one.id} of the logical scenario {study.meta.title}: {one.why}"
            made = fill_concrete(scenario, one.values, folder / one.file, drivers, why)
            for source, place, root in made.beside:
                if source not in beside:
                    beside[source] = read_beside(source, root)
                written.add(place, beside[source])
            written.add(one.file, made.content)
        written.seal(make_manifest(study, reduced, kinds, written.digests))
        before = study.reduction()
        save_reduction(study, reduced)
        try:
            written.replace()
        except InputError:
            study.writer.save_analyses({"reduction": None if before is None else ({}, before)})
            raise
