"""Conversion of a reduced set to plain values for ``manifest.json`` and for the study file, and back."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from cornercase._common.text.json_keys import keys_to_identifiers
from cornercase._common.text.sanitize import escape_control_characters
from cornercase._common.version import __version__
from cornercase.clustering import Analysis, read_distances
from cornercase.evidence import Estimate
from cornercase.reduction._cluster_shapes import ClusterShape
from cornercase.reduction._coverage import Coverage, CoverageCurves, measure_nearest_distances
from cornercase.reduction._critical_coverage import CriticalCoverage
from cornercase.reduction._held_out_coverage import HeldOutCoverage, HeldOutCriticalCoverage
from cornercase.reduction._kill_matrix import MutantSelection, MutationScore
from cornercase.reduction._reduced_set import ReducedSet, SelectedScenario
from cornercase.reduction._selection_state import Role
from cornercase.study import StudyFile
from cornercase.study._damage import dataclass_from_json, require_condition, reraise_read_errors
from cornercase.study._study_file import open_study

MANIFEST_FORMAT: Final = 2
"""Version of the manifest's format."""

_EVALUATION_NOTE: Final = (
    "held_out: each fifth of the scenarios, or one fifth of many, judges a set that was chosen in the same way from the"
    " other four, beside random choices and k-medoids of these; all other figures describe the kept scenarios among"
    " those that they were chosen from"
)


def make_manifest(
    study: StudyFile, reduced_set: ReducedSet, cluster_names: Mapping[int, str], files: Mapping[str, str]
) -> dict[str, Any]:
    """Return the content of ``manifest.json``: reduced set, its origin, and what is needed to run the scenarios again.

    `cluster_names` maps clusters to names. `files` maps the path of each written file in the folder to its SHA-256.
    """
    meta = study.meta
    return (
        {
            "format": MANIFEST_FORMAT,
            "version": __version__,
            "scenario": meta.file_name,
            "fingerprint": meta.fingerprint,
            "study": escape_control_characters(study.path.name),
            "simulator": meta.simulator,
            "settings": dict(meta.settings),
            "ego": meta.ego,
            "other": meta.other if isinstance(meta.other, str) else list(meta.other),
            "metrics": list(meta.metrics),
            "critical_threshold": study.critical,
            "space": meta.space.to_json(),
            "by": reduced_set.by,
            "run": reduced_set.n_run,
            "kept": len(reduced_set.scenarios),
            "graded": _EVALUATION_NOTE,
            "scenarios": [
                asdict(item) | {"kind": cluster_names.get(item.cluster, "")} for item in reduced_set.scenarios
            ],
            "shapes": [_shape_to_json(item) for item in reduced_set.shapes],
            "coverage": {name: asdict(item) for name, item in reduced_set.coverage.items()},
            "critical": {name: asdict(item) for name, item in reduced_set.critical.items()},
            "files": dict(files),
        }
        | ({"seed": meta.seed} if meta.seed and meta.may_draw_random_numbers else {})
        | _study_threshold_entry(study)
        | ({} if reduced_set.exposing is None else {"exposing": reduced_set.exposing.to_json()})
    )


def _study_threshold_entry(study: StudyFile) -> dict[str, float | None]:
    """Return the manifest entry for the study's own threshold; empty if the set was selected with this threshold."""
    return {} if study.critical == study.meta.critical else {"critical_threshold_of_the_study": study.meta.critical}


def save_reduction(
    study: StudyFile,
    reduced_set: ReducedSet,
    curves: Mapping[str, CoverageCurves],
    analyses: Mapping[str, Analysis],
) -> None:
    """Store a reduced set in a study, with its coverage curves by aspect; an earlier reduced set is replaced."""
    info = {
        "by": reduced_set.by,
        "run": reduced_set.n_run,
        "kept": [asdict(item) for item in reduced_set.scenarios],
        "shapes": [_shape_to_json(item) for item in reduced_set.shapes],
        "coverage": {name: asdict(item) for name, item in reduced_set.coverage.items()},
        "critical": {name: asdict(item) for name, item in reduced_set.critical.items()},
        "hulls": {str(cluster): [list(facet) for facet in facets] for cluster, facets in reduced_set.hulls.items()},
    } | ({} if reduced_set.exposing is None else {"exposing": reduced_set.exposing.to_json()})
    if study.critical != study.meta.critical:
        info["critical_threshold"] = study.critical
    info["curves of"] = {name: _fingerprint(analyses[name]) for name in curves}
    arrays = {
        f"{field.name} {name}": getattr(curve, field.name) for name, curve in curves.items() for field in fields(curve)
    }
    study.writer.save_analysis("reduction", arrays, info)


def read_coverage_curves(
    study: StudyFile, analyses: Mapping[str, Analysis], selected_ids: list[int]
) -> dict[str, CoverageCurves]:
    """Read the coverage curves of the stored reduced set, by aspect (what scenarios are compared by).

    The curves of an aspect are computed again if the scenarios were analysed again by this aspect since `reduce` stored
    them.
    """
    arrays, info = study.read_analysis("reduction")
    curves = {}
    with reraise_read_errors(study.path):
        for name, analysis in analyses.items():
            if info.get("curves of", {}).get(name) == _fingerprint(analysis):
                stored = [arrays[f"{field.name} {name}"] for field in fields(CoverageCurves)]
                for array in stored:
                    is_finite = array.ndim == 1 and array.dtype.kind == "f" and bool(np.isfinite(array).all())
                    require_condition(is_finite, "coverage curves without numbers")
                curve = CoverageCurves(*stored)
                require_condition(
                    len(curve.to_selected) == len(curve.to_medoids) == len(analysis.ids)
                    and len(curve.reach) == len(curve.random_low) == len(curve.random_high),
                    "coverage curves of different lengths",
                )
                curves[name] = curve
    for name, analysis in analyses.items():
        rows = analysis.rows_of(selected_ids)
        if name not in curves and len(rows):
            distances = measure_nearest_distances(read_distances(study, name), rows)
            curves[name] = CoverageCurves.from_nearest_distances(distances)
    return {name: curves[name] for name in analyses if name in curves}


def _fingerprint(analysis: Analysis) -> str:
    """Return a hash of an analysis: of its scenarios and of their positions in kernel space."""
    return hashlib.sha256(analysis.ids.tobytes() + analysis.clustering.embedding.tobytes()).hexdigest()


def read_reduction(study: StudyFile | Path | str) -> ReducedSet | None:
    """Read the stored reduced set of a study.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study whose reduced set is read.

    Returns
    -------
    ReducedSet or None
        None if the study was not reduced yet.

    Raises
    ------
    InputError
        The stored reduced set is damaged.

    Examples
    --------
    >>> from cornercase.reduction import read_reduction
    >>> reduced = read_reduction("study.db")  # doctest: +SKIP
    >>> None if reduced is None else reduced.ids  # doctest: +SKIP
    [17, 3, 181, 176, 99, 121, 173, 90, 108, 56]
    """
    with open_study(study, readonly=True) as opened:
        return _read_reduction(opened)


def _read_reduction(study: StudyFile) -> ReducedSet | None:
    info = study.read_reduction()
    if info is None:
        return None
    with reraise_read_errors(study.path):
        ids = {row.id for row in study.finished_rows()}
        threshold = info.get("critical_threshold", study.meta.critical)
        reduced = ReducedSet(
            by=str(info["by"]),
            n_run=int(info["run"]),
            scenarios=tuple(_scenario_from_json(item) for item in info["kept"]),
            shapes=tuple(_shape_from_json(item) for item in info["shapes"]),
            coverage={name: _coverage_from_json(item) for name, item in info["coverage"].items() if item},
            critical={name: _critical_coverage_from_json(item) for name, item in info["critical"].items()},
            hulls={int(cluster): tuple(map(tuple, facets)) for cluster, facets in info["hulls"].items()},
            exposing=_mutant_selection_from_json(info["exposing"]) if info.get("exposing") else None,
            threshold=None if threshold is None else float(threshold),
        )
        corners = {corner for facets in reduced.hulls.values() for facet in facets for corner in facet}
        for scenario in reduced.scenarios:
            for parameter in study.space.parameters:
                value = parameter.extract_value(scenario.values)
                require_condition(
                    bool(parameter.choices) == isinstance(value, str), f"a {parameter.name} of the wrong type"
                )
        require_condition(corners | set(reduced.ids) <= ids, "a reduced set with scenarios that were not run")
        return reduced


def _scenario_from_json(json_values: Mapping[str, Any]) -> SelectedScenario:
    scenario = dataclass_from_json(SelectedScenario, json_values)
    require_condition(scenario.role in get_args(Role), f"a selected scenario with the role {str(scenario.role)[:60]!r}")
    require_condition(
        all(isinstance(value, float | int | str) for value in scenario.values.values()), "a scenario without values"
    )
    require_condition(
        all(isinstance(value, float | int) for value in scenario.scores.values()), "a scenario without scores"
    )
    return scenario


def _shape_to_json(shape: ClusterShape) -> dict[str, Any]:
    return {
        "cluster": shape.cluster,
        "convexity": shape.convexity,
        "convexity_in_kernel_space": shape.kernel_convexity,
        "archetypes_by": shape.method,
        "parts": shape.parts,
    }


def _shape_from_json(json_values: Mapping[str, Any]) -> ClusterShape:
    json_values = keys_to_identifiers(json_values, {})
    fields = {"kernel_convexity": json_values["convexity_in_kernel_space"], "method": json_values["archetypes_by"]}
    fields |= {name: json_values[name] for name in ("cluster", "convexity", "parts")}
    require_condition(fields["method"] in ("hull", "pcha", "parts", "kernel"), "an unknown method for archetypes")
    return dataclass_from_json(ClusterShape, fields)


def _coverage_from_json(json_values: Mapping[str, Any]) -> Coverage:
    fields: dict[str, Any] = {key: math.nan if value is None else value for key, value in json_values.items()}
    held_out = json_values["held_out"]
    return dataclass_from_json(
        Coverage, fields | {"held_out": None if held_out is None else dataclass_from_json(HeldOutCoverage, held_out)}
    )


def _critical_coverage_from_json(json_values: Mapping[str, Any]) -> CriticalCoverage:
    unlike, held_out = json_values["unlike"], json_values["held_out"]
    nested = {
        "unlike": None if unlike is None else dataclass_from_json(Estimate, unlike),
        "held_out": None if held_out is None else dataclass_from_json(HeldOutCriticalCoverage, held_out),
    }
    return dataclass_from_json(CriticalCoverage, {**json_values, **nested})


def _mutant_selection_from_json(json_values: Mapping[str, Any]) -> MutantSelection:
    json_values = keys_to_identifiers(json_values, {})
    grades = {
        name: None
        if json_values[name] is None
        else MutationScore(*(int(json_values[name][grade]) for grade in ("mutants", "possible", "exposed")))
        for name in ("chosen_by", "held_out", "without")
    }
    require_condition(grades["chosen_by"] is not None, "a selection by mutants without a result")
    for grade in filter(None, grades.values()):
        require_condition(0 <= grade.killed <= grade.killable <= grade.mutants, "more killed mutants than there are")
    return dataclass_from_json(
        MutantSelection,
        {
            "driver": str(json_values["driver"]),
            "requirements": tuple(map(str, json_values["requirements"])),
            "candidates": int(json_values["candidates"]),
            **grades,
        },
    )
