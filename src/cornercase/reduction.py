"""From clusters to the few concrete scenarios that matter."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cornercase.archetypes import Kept, convex_hull, reduce_clusters
from cornercase.coverage import coverage
from cornercase.files import written_whole
from cornercase.objective import Objective
from cornercase.reduced_set import choose
from cornercase.scenario.openscenario import Scenario, write_concrete
from cornercase.scenario.space import Value
from cornercase.study import Study
from cornercase.typing import FloatArray

_WHY = {
    "archetype": "on the hull of cluster {cluster} in the parameter space",
    "prototype": "the scenario most like all others of cluster {cluster}",
    "gap": "the scenario that was least like all that are kept before it",
}


def reduce_study(
    study: Study,
    folder: Path | str,
    *,
    by: str | None = None,
    archetypes: int | Literal["auto"] = "auto",
    size: int | None = None,
    cover: float | None = None,
) -> dict[str, Any]:
    """Write archetypes and a prototype of each cluster as OpenSCENARIO files, and ``manifest.json``.

    Parameters
    ----------
    study : Study
        Open for writing, and analysed.
    folder : path
        Each file in it runs by itself and gives the same recording.
    by : str, optional
        Clustering whose clusters count; by default that of the searched metric.
    archetypes : int or "auto"
        Largest number for each cluster, as of `cornercase.archetypes.reduce_clusters`.
    size : int, optional
        How many to keep in all, as of `cornercase.reduced_set.choose`, instead.
    cover : float, optional
        Instead: keep as few as leave nothing more unlike than this share of the largest distance.

    Returns
    -------
    dict
        The manifest.

    Raises
    ------
    InputError
        The study was not analysed, or the folder cannot be written.
    """
    folder, by = Path(folder), by or study.meta["metrics"][0]
    arrays, _ = study.analysis(by)
    analyses = {name: arrays if name == by else study.analysis(name)[0] for name in study.analyses()}
    rows = {row.id: row for row in study.done()}
    chosen = [rows[i] for i in arrays["ids"].tolist()]
    points = np.array([row.point for row in chosen])
    if size is None and cover is None:
        kept = reduce_clusters(points, arrays["distances"], arrays["labels"], archetypes=archetypes)
    else:
        kept = choose(
            points, _distances(analyses, by), arrays["labels"], _critical(study, arrays), size=size, cover=cover
        )
    scores = {name: study.scores(name) for name in study.meta["metrics"]}
    ids = [row.id for row in study.done()]

    scenario, stem = Scenario.read(study.meta["scenario"]), Path(study.meta["scenario"]).stem
    items = []
    for one in kept:
        row = chosen[one.index]
        name = f"{stem}-{row.id:05}.xosc"
        why = _WHY[one.role].format(cluster=one.cluster)
        drivers = study.meta["settings"].get("drivers", {})
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
                {m: float(s[ids.index(row.id)]) for m, s in scores.items()},
            )
        )

    manifest: dict[str, Any] = {
        "scenario": study.meta["scenario"],
        "fingerprint": study.meta["fingerprint"],
        "study": study.path.name,
        "simulator": study.meta["simulator"],
        "settings": study.meta["settings"],
        "by": by,
        "run": len(ids),
        "kept": len(items),
        "scenarios": items,
        "coverage": {name: _coverage(one, [item["id"] for item in items]) for name, one in analyses.items()},
    }
    with written_whole(folder / "manifest.json") as temporary:
        temporary.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    study.save_analysis(
        "reduction",
        {},
        {
            "by": by,
            "kept": items,
            "coverage": manifest["coverage"],
            "hulls": _hulls(points, arrays["labels"], [row.id for row in chosen]),
        },
    )
    return manifest


def _distances(analyses: Mapping[str, Any], by: str) -> list[FloatArray]:
    """Distances of the clustering that counts, then of the others of the same scenarios."""
    first = analyses[by]
    others = [one["distances"] for name, one in analyses.items() if name != by and len(one["ids"]) == len(first["ids"])]
    return [first["distances"], *others]


def _critical(study: Study, arrays: Mapping[str, Any]) -> list[int]:
    """Clusters in which most scenarios are critical; without a threshold the one with the most critical median."""
    objective = Objective.of_study(study.meta)
    metric, labels = objective.metrics[0], arrays["labels"]
    ids = [row.id for row in study.done()]
    scores = study.scores(metric.name)[[ids.index(i) for i in arrays["ids"].tolist()]]
    told = scores if metric.lower_is_critical else -scores
    clusters = [label for label in np.unique(labels).tolist() if label >= 0]
    medians = {label: float(np.median(told[labels == label])) for label in clusters}
    limit = study.meta.get("critical")
    if limit is None or objective.weights or objective.pareto:
        return [min(clusters, key=medians.__getitem__)] if clusters else []
    return [label for label in clusters if medians[label] <= objective.flip(limit)]


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


def _hulls(points: Any, labels: Any, ids: list[int]) -> dict[str, list[list[int]]]:
    hulls = {}
    for label in np.unique(labels[labels >= 0]).tolist():
        members = np.flatnonzero(labels == label)
        facets = convex_hull(points[members]).simplices
        hulls[str(label)] = [[ids[members[i]] for i in facet] for facet in facets]
    return hulls
