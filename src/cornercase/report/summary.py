"""What a study holds, in a few lines."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Final

import numpy as np

from cornercase.clustering import compare_clusterings
from cornercase.evidence import CriticalSet, estimate_sensitivity
from cornercase.exploration import Objective, on_front
from cornercase.metrics import METRICS
from cornercase.study import Study


def summarize(study: Study) -> dict[str, Any]:
    """Plain values that tell what was run and what was found.

    Parameters
    ----------
    study : Study

    Returns
    -------
    dict
    """
    meta, rows = study.meta, study.rows()
    done = [row for row in rows if row.state == "done"]
    summary: dict[str, Any] = {
        "scenario": meta.scenario,
        "ego": meta.ego,
        "other": meta.other,
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "simulator": meta.simulator,
        "parameters": {
            p.name: f"{p.low:g} to {p.high:g} {p.unit}".strip() if not p.choices else ", ".join(p.choices)
            for p in study.space.parameters
        },
        "run": len(done),
        "failed": sum(row.state == "failed" for row in rows),
        "pending": sum(row.state == "pending" for row in rows),
        "collisions": collisions(study),
        "metrics": {},
        "clusters": {},
        "seconds": {stage: round(seconds, 2) for stage, seconds in study.elapsed().items()},
    }
    for name in meta.metrics if done else ():
        metric, scores = METRICS.create(name), study.scores(name)
        worst = int(metric.oriented(scores).argmin())
        summary["metrics"][name] = {
            "unit": metric.unit,
            "critical is": "low" if metric.lower_is_critical else "high",
            "most critical": float(scores[worst]),
            "median": float(np.median(scores)),
            "at": done[worst].values,
        }
        if (width := run_spread(study, name)) is not None:
            summary["metrics"][name] |= {
                "runs of each": meta.repeats,
                "spread of the runs, median": width[0],
                "spread of the runs, largest": width[1],
            }
    objective = Objective.of_study(meta)
    summary["searched"] = objective.text
    if done:
        summary |= knowledge(study, objective)
    for name in study.analyses():
        arrays, info = study.analysis(name, "labels")
        labels = arrays["labels"]
        summary["clusters"][name] = {
            "sizes": np.bincount(labels[labels >= 0]).tolist(),
            "noise": int((labels < 0).sum()),
        } | {
            f"cluster {one['cluster']}": {
                "scenarios": one["size"],
                "outcomes": one["outcomes"],
                "median": {metric: quartiles[1] for metric, quartiles in one["scores"].items()},
                "where": [f"{r['text']} ({r['covers']:.0%} of it, {r['purity']:.0%} pure)" for r in one["rules"]],
            }
            for one in info["profiles"]
            if one["cluster"] >= 0
        }
    summary["agreement"] = {
        f"{a} and {b}": {
            "adjusted rand": one.rand,
            "adjusted mutual information": one.mutual,
            "scenarios that differ": len(one.differ),
        }
        for (a, b), one in compare_clusterings(study).items()
    }
    reduction = study.reduction()
    if reduction is not None:
        summary["kept"] = len(reduction["kept"])
        summary["shapes"] = {
            f"cluster {one['cluster']}": {key: value for key, value in one.items() if key != "cluster"}
            for one in reduction["shapes"]
        }
        summary["coverage"] = {name: _told(one, _LEFT_OUT) for name, one in reduction["coverage"].items() if one}
        for name, one in reduction["critical"].items():
            summary["coverage"].setdefault(name, {})["critical scenarios"] = _told(one, _OF_CRITICAL)
    return summary


_LEFT_OUT: Final = {
    "largest": "largest distance to a kept one",
    "mean": "mean distance",
    "better_largest": "random subsets with a larger largest one",
    "better_mean": "random subsets with a larger mean",
    "medoids_largest": "largest one of k-medoids",
    "medoids_mean": "mean of k-medoids",
}
_OF_CRITICAL: Final = {
    "within": "alike up to a distance of",
    "critical": "like a kept one",
    "random": "like one of a random subset",
    "medoids": "like one of k-medoids",
    "boundary": "on the boundary, like a kept one",
    "unlike": "one of the space is unlike all kept",
}


def _told(found: dict[str, Any], words: dict[str, str]) -> dict[str, Any]:
    """What is known of the kept scenarios, in the words of a summary."""
    return {text: found[key] for key, text in words.items() if found.get(key) is not None}


def knowledge(study: Study, objective: Objective) -> dict[str, Any]:
    """What is known of the front, of the critical set, and of the influence of each parameter.

    Parameters
    ----------
    study : Study
        In which some scenario ended.
    objective : Objective
        The study's own.

    Returns
    -------
    dict
        ``front``, or ``critical`` and ``sensitivity`` as far as there is enough to say something.
    """
    known: dict[str, Any] = {}
    rows, meta = study.done(), study.meta
    points = np.array([row.point for row in rows])
    scores = objective.oriented_of(study)
    if objective.pareto:
        front = np.flatnonzero(on_front(scores))
        known["front"] = {
            f"scenario {rows[k].id}": {m.name: float(study.scores(m.name)[k]) for m in objective.metrics} for k in front
        }
        return known
    if meta.critical is not None:
        limit = float(meta.critical)
        low = objective.weights or objective.metrics[0].lower_is_critical
        known["critical"] = {
            "is": f"{objective.text} {'<=' if low else '>='} {limit:g} {objective.unit}".rstrip(),
            "scenarios": int((scores <= objective.flip(limit)).sum()),
        }
        with suppress(ValueError):
            critical_set = CriticalSet(study.space, points, scores, objective.flip(limit), meta.seed)
            known["critical"] |= critical_set.to_json()
    with suppress(ValueError):
        known["sensitivity"] = estimate_sensitivity(study.space, points, scores, meta.seed).to_json()
    return known


def run_spread(study: Study, metric: str) -> tuple[float, float] | None:
    """By how much the runs of a scenario differ, in the median scenario and at most; None if each ran once."""
    spread = study.spread(metric)
    if spread is None:
        return None
    width = spread[:, 1] - spread[:, 0]
    return float(np.median(width)), float(width.max())


def collisions(study: Study) -> int:
    """Number of scenarios in which the ego and the other entity collide."""
    pair = {study.meta.ego, study.meta.other}
    return sum(
        any(set(collision.entities) == pair for collision in study.recording(row.id).collisions) for row in study.done()
    )
