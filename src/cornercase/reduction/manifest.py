"""The reduced set as plain values, for ``manifest.json`` and for the study."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final, get_args

from cornercase._common.json_keys import with_identifiers
from cornercase._common.texts import plain_text
from cornercase._common.version import __version__
from cornercase.evidence import Estimate
from cornercase.reduction.cluster_shapes import ClusterShape
from cornercase.reduction.coverage import Coverage
from cornercase.reduction.critical_coverage import CriticalCoverage
from cornercase.reduction.exposure import ExposingChoice, Grade
from cornercase.reduction.held_out import HeldOut, HeldOutCritical
from cornercase.reduction.kept import Role
from cornercase.reduction.reduced_set import KeptScenario, ReducedSet
from cornercase.study import Study, damage_told, made, require

MANIFEST_FORMAT: Final = 2
"""Version of the manifest's format."""

_GRADED: Final = (
    "held_out: each fifth of the scenarios, or one fifth of many, judges a set that was chosen in the same way from the"
    " other four, beside random choices and k-medoids of these; all other figures describe the kept scenarios among"
    " those that they were chosen from"
)


def make_manifest(
    study: Study, reduced: ReducedSet, kinds: Mapping[int, str], files: Mapping[str, str]
) -> dict[str, Any]:
    """Return the content of ``manifest.json``: the reduced set, its origin, and how to run it again.

    `cluster_names` are names of clusters; `files` has the SHA-256 of each file that was written, by its path in the
    folder.
    """
    meta = study.meta
    return (
        {
            "format": MANIFEST_FORMAT,
            "version": __version__,
            "scenario": meta.file_name,
            "fingerprint": meta.fingerprint,
            "study": plain_text(study.path.name),
            "simulator": meta.simulator,
            "settings": dict(meta.settings),
            "ego": meta.ego,
            "other": meta.other if isinstance(meta.other, str) else list(meta.other),
            "metrics": list(meta.metrics),
            "critical_threshold": study.critical,
            "space": meta.space.to_json(),
            "by": reduced.by,
            "run": reduced.run,
            "kept": len(reduced.kept),
            "graded": _GRADED,
            "scenarios": [asdict(item) | {"kind": kinds.get(item.cluster, "")} for item in reduced.kept],
            "shapes": [_of_shape(item) for item in reduced.shapes],
            "coverage": {name: asdict(item) for name, item in reduced.coverage.items()},
            "critical": {name: asdict(item) for name, item in reduced.critical.items()},
            "files": dict(files),
        }
        | _asked(study)
        | ({} if reduced.exposing is None else {"exposing": reduced.exposing.to_json()})
    )


def _asked(study: Study) -> dict[str, float | None]:
    """The threshold stored in the study, if another one was used."""
    return {} if study.critical == study.meta.critical else {"critical_threshold_of_the_study": study.meta.critical}


def save_reduction(study: Study, reduced: ReducedSet) -> None:
    """Store a reduced set in a study, in place of the earlier one."""
    info = {
        "by": reduced.by,
        "run": reduced.run,
        "kept": [asdict(item) for item in reduced.kept],
        "shapes": [_of_shape(item) for item in reduced.shapes],
        "coverage": {name: asdict(item) for name, item in reduced.coverage.items()},
        "critical": {name: asdict(item) for name, item in reduced.critical.items()},
        "hulls": {str(cluster): [list(facet) for facet in facets] for cluster, facets in reduced.hulls.items()},
    } | ({} if reduced.exposing is None else {"exposing": reduced.exposing.to_json()})
    if study.critical != study.meta.critical:
        info["critical_threshold"] = study.critical
    study.writer.save_analysis("reduction", {}, info)


def read_reduction(study: Study) -> ReducedSet | None:
    """Read back the reduced set of a study.

    Parameters
    ----------
    study : Study
        Holds the scenarios.

    Returns
    -------
    ReducedSet or None
        None before the study was reduced.

    Raises
    ------
    InputError
        What it holds is damaged.
    """
    info = study.reduction()
    if info is None:
        return None
    with damage_told(study.path):
        ids = {row.id for row in study.done()}
        threshold = info.get("critical_threshold", study.meta.critical)
        reduced = ReducedSet(
            by=str(info["by"]),
            run=int(info["run"]),
            kept=tuple(_kept(item) for item in info["kept"]),
            shapes=tuple(_shape(item) for item in info["shapes"]),
            coverage={name: _coverage(item) for name, item in info["coverage"].items() if item},
            critical={name: _critical(item) for name, item in info["critical"].items()},
            hulls={int(cluster): tuple(map(tuple, facets)) for cluster, facets in info["hulls"].items()},
            exposing=_exposing(info["exposing"]) if info.get("exposing") else None,
            threshold=None if threshold is None else float(threshold),
        )
        corners = {corner for facets in reduced.hulls.values() for facet in facets for corner in facet}
        for scenario in reduced.kept:
            for parameter in study.space.parameters:
                value = parameter.read(scenario.values)
                require(bool(parameter.choices) == isinstance(value, str), f"a {parameter.name} of the wrong type")
        require(corners | set(reduced.ids) <= ids, "a reduced set with scenarios that were not run")
        return reduced


def _kept(plain: Mapping[str, Any]) -> KeptScenario:
    scenario = made(KeptScenario, plain)
    require(scenario.role in get_args(Role), f"a selected scenario with the role {str(scenario.role)[:60]!r}")
    require(
        all(isinstance(value, float | int | str) for value in scenario.values.values()), "a scenario without values"
    )
    require(all(isinstance(value, float | int) for value in scenario.scores.values()), "a scenario without scores")
    return scenario


def _of_shape(one: ClusterShape) -> dict[str, Any]:
    return {
        "cluster": one.cluster,
        "convexity": one.convexity,
        "convexity_in_kernel_space": one.kernel_convexity,
        "archetypes_by": one.method,
        "parts": one.parts,
    }


def _shape(plain: Mapping[str, Any]) -> ClusterShape:
    plain = with_identifiers(plain, {})
    fields = {"kernel_convexity": plain["convexity_in_kernel_space"], "method": plain["archetypes_by"]}
    fields |= {name: plain[name] for name in ("cluster", "convexity", "parts")}
    require(fields["method"] in ("hull", "pcha", "parts", "kernel"), "an unknown method for archetypes")
    return made(ClusterShape, fields)


def _coverage(plain: Mapping[str, Any]) -> Coverage:
    fields: dict[str, Any] = {key: math.nan if value is None else value for key, value in plain.items()}
    held_out = plain["held_out"]
    return made(Coverage, fields | {"held_out": None if held_out is None else made(HeldOut, held_out)})


def _critical(plain: Mapping[str, Any]) -> CriticalCoverage:
    unlike, held_out = plain["unlike"], plain["held_out"]
    nested = {
        "unlike": None if unlike is None else made(Estimate, unlike),
        "held_out": None if held_out is None else made(HeldOutCritical, held_out),
    }
    return made(CriticalCoverage, {**plain, **nested})


def _exposing(plain: Mapping[str, Any]) -> ExposingChoice:
    plain = with_identifiers(plain, {})
    grades = {
        name: None
        if plain[name] is None
        else Grade(*(int(plain[name][grade]) for grade in ("mutants", "possible", "exposed")))
        for name in ("chosen_by", "held_out", "without")
    }
    require(grades["chosen_by"] is not None, "a selection by mutants without a result")
    for grade in filter(None, grades.values()):
        require(0 <= grade.exposed <= grade.possible <= grade.mutants, "more killed mutants than there are")
    return made(
        ExposingChoice,
        {
            "driver": str(plain["driver"]),
            "requirements": tuple(map(str, plain["requirements"])),
            "candidates": int(plain["candidates"]),
            **grades,
        },
    )
