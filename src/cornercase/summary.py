"""What a study holds, in a few lines."""

from __future__ import annotations

from typing import Any

import numpy as np

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
        "scenario": meta["scenario"],
        "ego": meta["ego"],
        "other": meta["other"],
        "optimizer": meta["optimizer"],
        "seed": meta["seed"],
        "simulator": meta["simulator"],
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
    for name in meta["metrics"] if done else ():
        metric, scores = METRICS.create(name), study.scores(name)
        worst = int(scores.argmin() if metric.lower_is_critical else scores.argmax())
        summary["metrics"][name] = {
            "unit": metric.unit,
            "critical is": "low" if metric.lower_is_critical else "high",
            "most critical": float(scores[worst]),
            "median": float(np.median(scores)),
            "at": done[worst].values,
        }
    if done and meta.get("critical") is not None:
        first = METRICS.create(meta["metrics"][0])
        scores, limit = study.scores(first.name), float(meta["critical"])
        critical = scores <= limit if first.lower_is_critical else scores >= limit
        summary["critical"] = {
            "is": f"{first.name} {'<=' if first.lower_is_critical else '>='} {limit:g} {first.unit}",
            "scenarios": int(critical.sum()),
        }
    for name in study.analyses():
        labels = study.analysis(name)[0]["labels"]
        summary["clusters"][name] = {
            "sizes": np.bincount(labels[labels >= 0]).tolist(),
            "noise": int((labels < 0).sum()),
        }
    reduction = study.reduction()
    if reduction is not None:
        summary["kept"] = len(reduction["kept"])
    return summary


def collisions(study: Study) -> int:
    """Number of scenarios in which the ego and the other entity collide."""
    pair = {study.meta["ego"], study.meta["other"]}
    return sum(
        any(set(collision.entities) == pair for collision in study.recording(row.id).collisions) for row in study.done()
    )
