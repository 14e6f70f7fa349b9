"""From clusters to the few concrete scenarios that matter."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cornercase._common.files import written_whole
from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence import CriticalSet
from cornercase.exploration import Objective
from cornercase.reduction.cluster_shapes import ArchetypeMethod, shapes
from cornercase.reduction.coverage import coverage
from cornercase.reduction.critical_coverage import WITHIN, alike, critical_coverage
from cornercase.reduction.hulls import convex_hull
from cornercase.reduction.selection import KEPT_SHARE, Kept, choose, reduce_clusters
from cornercase.scenario import Scenario, Value, write_concrete
from cornercase.study import IMPORTED, Study

_WHY = {
    "hull": "on the hull of cluster {cluster} in the parameter space",
    "pcha": "at an extreme of cluster {cluster} in the parameter space, by archetypal analysis",
    "parts": "on the hull of a near-convex part of cluster {cluster} in the parameter space",
    "kernel": "at an extreme of cluster {cluster} in kernel space, by archetypal analysis",
    "prototype": "the scenario most like all others of cluster {cluster}",
    "gap": "for what is unlike all others that are kept",
}


def reduce_study(
    study: Study,
    folder: Path | str,
    *,
    by: str | None = None,
    archetypes: int | Literal["auto"] | None = None,
    size: int | None = None,
    cover: float | None = None,
    method: ArchetypeMethod = "auto",
    within: float = WITHIN,
) -> dict[str, Any]:
    """Write the scenarios to keep as OpenSCENARIO files, and ``manifest.json``, which says why each is there.

    By default a tenth of all are kept.

    Parameters
    ----------
    study : Study
        Open for writing, and analysed.
    folder : path
        Each file in it runs by itself and gives the same recording. Of a study of imported recordings only the manifest
        is written.
    by : str, optional
        Clustering whose clusters count; by default that of the searched metric.
    archetypes : int or "auto", optional
        Keep nothing but prototypes and archetypes, so many for each cluster at most, as of
        `cornercase.reduction.selection.reduce_clusters`.
    size : int, optional
        How many to keep in all, as of `cornercase.reduction.selection.choose`.
    cover : float, optional
        Instead: keep as few as leave nothing more unlike than this share of the largest distance.
    method : {"auto", "hull", "pcha", "parts", "kernel"}
        How archetypes are found, as of `cornercase.reduction.cluster_shapes.shapes`.
    within : float, default 0.5
        Up to this share of what is usual within a cluster scenarios are alike, for the coverage of the critical set, as
        of `cornercase.reduction.critical_coverage.alike`.

    Returns
    -------
    dict
        The manifest.

    Raises
    ------
    InputError
        The study was not analysed, or the folder cannot be written.
    """
    folder, by = Path(folder), by or study.meta.metrics[0]
    arrays, _ = study.analysis(by)
    analyses = {name: arrays if name == by else study.analysis(name)[0] for name in study.analyses()}
    rows = {row.id: row for row in study.done()}
    chosen = [rows[i] for i in arrays["ids"].tolist()]
    points = np.array([row.point for row in chosen])
    labels = arrays["labels"]
    shaped = shapes(points, labels, arrays["embedding"], method)
    if archetypes is not None:
        kept = reduce_clusters(points, arrays["distances"], labels, archetypes=archetypes, shaped=shaped)
    else:
        if size is None and cover is None:
            size = max(1, round(len(chosen) / KEPT_SHARE))
        kept = choose(
            points, _distances(analyses, by), labels, critical_clusters(study, arrays),
            size=size, cover=cover, shaped=shaped,
        )  # fmt: skip
    methods = {shape.cluster: shape.method for shape in shaped}
    kept_ids = [chosen[one.index].id for one in kept]
    # Before anything is written, as what the user asked for here may not be possible.
    critical = _of_critical(study, analyses, kept_ids, within)
    scores = {name: study.scores(name) for name in study.meta.metrics}
    place = {scenario: k for k, scenario in enumerate(rows)}

    imported = study.meta.simulator == IMPORTED
    stem = Path(study.meta.scenario).stem
    scenario = None if imported else Scenario.read(study.meta.scenario)
    drivers = study.meta.settings.get("drivers", {})
    items = []
    for one in kept:
        row = chosen[one.index]
        why = _WHY[methods[one.cluster] if one.role == "archetype" else one.role].format(cluster=one.cluster)
        if scenario is None:
            # What was run elsewhere is run again there; the manifest says which it was.
            name = str(study.meta.files[row.id - 1])
        else:
            name = f"{stem}-{row.id:05}.xosc"
            write_concrete(
                scenario,
                row.values,
                folder / name,
                drivers={entity: driver for entity, driver in drivers.items() if isinstance(driver, str)},
                description=f"Scenario {row.id} of the logical scenario {stem}: {why}",
            )
        items.append(
            _item(
                one,
                row.id,
                name,
                why,
                row.values,
                {m: float(s[place[row.id]]) for m, s in scores.items()},
            )
        )

    manifest: dict[str, Any] = {
        "scenario": study.meta.scenario,
        "fingerprint": study.meta.fingerprint,
        "study": study.path.name,
        "simulator": study.meta.simulator,
        "settings": study.meta.settings,
        "by": by,
        "run": len(rows),
        "kept": len(items),
        "scenarios": items,
        "shapes": [
            {
                "cluster": shape.cluster,
                "convexity": shape.convexity,
                "convexity in kernel space": shape.behaviour,
                "archetypes by": shape.method,
                "parts": len(shape.parts),
            }
            for shape in shaped
        ],
        "coverage": {name: _coverage(one, kept_ids) for name, one in analyses.items()},
        "critical": critical,
    }
    with written_whole(folder / "manifest.json") as temporary:
        temporary.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8", newline="\n")
    study.save_analysis(
        "reduction",
        {},
        {
            "by": by,
            "kept": items,
            **{key: manifest[key] for key in ("shapes", "coverage", "critical")},
            "hulls": {str(shape.cluster): _facets(points, shape.parts, [row.id for row in chosen]) for shape in shaped},
        },
    )
    return manifest


def _distances(analyses: Mapping[str, Any], by: str) -> list[FloatArray]:
    """Distances of the clustering that counts, then of the others of the same scenarios."""
    first = analyses[by]
    others = [one["distances"] for name, one in analyses.items() if name != by and len(one["ids"]) == len(first["ids"])]
    return [first["distances"], *others]


def critical_clusters(study: Study, arrays: Mapping[str, Any]) -> list[int]:
    """Clusters in which most scenarios are critical.

    Where that holds for all clusters or nothing says what is critical, the one with the most critical median.

    Parameters
    ----------
    study : Study
    arrays : mapping
        Of `Study.analysis`, with the ids and the labels.
    """
    objective = Objective.of_study(study.meta)
    metric, labels = objective.metrics[0], arrays["labels"]
    ids = [row.id for row in study.done()]
    scores = study.scores(metric.name)[[ids.index(i) for i in arrays["ids"].tolist()]]
    oriented = metric.oriented(scores)
    clusters = [label for label in np.unique(labels).tolist() if label >= 0]
    medians = {label: float(np.median(oriented[labels == label])) for label in clusters}
    limit = study.meta.critical
    critical = clusters
    if limit is not None and not objective.weights and not objective.pareto:
        critical = [label for label in clusters if medians[label] <= objective.flip(limit)]
    return [min(clusters, key=medians.__getitem__)] if critical == clusters and clusters else critical


def _of_critical(study: Study, analyses: Mapping[str, Any], kept: list[int], within: float) -> dict[str, Any]:
    """Coverage of the critical set by each clustering; nothing where no threshold says what is critical."""
    objective, limit = Objective.of_study(study.meta), study.meta.critical
    if limit is None or objective.pareto or not kept:
        return {}
    rows = {row.id: row for row in study.done()}
    oriented = dict(zip(rows, objective.oriented_of(study).tolist(), strict=True))
    threshold, seed = objective.flip(limit), study.meta.seed
    found, known = {}, {}
    for name, one in analyses.items():
        ids = one["ids"].tolist()
        index = np.array([ids.index(i) for i in kept if i in ids], dtype=np.int64)
        if not len(index):
            continue
        points, scores = np.array([rows[i].point for i in ids]), np.array([oriented[i] for i in ids])
        # Clusterings of the same scenarios have one critical set.
        if tuple(ids) not in known:
            with suppress(ValueError):
                known[tuple(ids)] = CriticalSet(study.space, points, scores, threshold, seed)
        found[name] = asdict(
            critical_coverage(
                study.space, points, scores, threshold, one["distances"], index,
                alike(one["distances"], one["labels"], within), seed=seed, critical_set=known.get(tuple(ids)),
            )
        )  # fmt: skip
    return found


def _item(
    one: Kept, scenario: int, file: str, why: str, values: Mapping[str, Value], scores: Mapping[str, float]
) -> dict[str, Any]:
    return {
        "id": scenario,
        "file": file,
        "cluster": one.cluster,
        "role": one.role,
        "why": why,
        "values": dict(values),
        "scores": dict(scores),
    }


def _coverage(arrays: Mapping[str, Any], kept: list[int]) -> dict[str, Any]:
    ids = arrays["ids"].tolist()
    index = [ids.index(i) for i in kept if i in ids]
    if not index:
        return {}
    found = asdict(coverage(arrays["distances"], index))
    found["worst"] = ids[found["worst"]]
    return found


def _facets(points: FloatArray, parts: Sequence[IntArray], ids: list[int]) -> list[list[int]]:
    """Facets of the hulls of a cluster's parts, by scenario."""
    return [[ids[part[i]] for i in facet] for part in parts for facet in convex_hull(points[part]).simplices]
