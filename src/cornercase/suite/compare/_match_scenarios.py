"""Match the scenarios that two studies have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.exploration._study_critical_set import is_score_independent
from cornercase.metrics._ending import find_outcome
from cornercase.metrics._outcome import Impact
from cornercase.recordings import Recording
from cornercase.recordings._compare import NUMERIC_ARRAYS, are_bitwise_equal
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.suite._judge import compute_margin
from cornercase.suite._requirement import Requirement
from cornercase.suite._verdict import Verdict
from cornercase.suite.compare._comparison import RunComparison, ScenarioPair, UnpairedScenarios

# Tolerance in m, s, rad, m/s and m/s² for differences between processors and compilers.
_ROUNDING_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class ComparedStudy:
    """One of the two studies of a comparison; the keys of mappings are scenario ids.

    `rows` are the scenarios that have ended, with or without success. If several scenarios have the same parameter
    values, only the first of them is in `rows`. `fills_space` says whether a search chose the scenario without regard
    to scores. `is_explored` says whether an optimizer chose the study's scenarios. `scores` has the scores of each
    scenario by metric. `is_critical` is empty without a threshold. `impacts` are the ego's collisions.
    """

    study: StudyFile
    rows: tuple[ScenarioRecord, ...]
    fills_space: Mapping[int, bool]
    is_explored: bool
    scores: Mapping[int, Mapping[str, float]]
    is_critical: Mapping[int, bool]
    verdicts: Mapping[int, Sequence[Verdict]]
    impacts: Mapping[int, Sequence[Impact]]

    @classmethod
    def from_study(
        cls, study: StudyFile, metrics: Sequence[str], verdicts: Mapping[int, Sequence[Verdict]]
    ) -> ComparedStudy:
        """Read the results of an open study, but no recordings."""
        rows, done = study.rows(), [row.id for row in study.finished_rows()]
        first_rows: dict[tuple[object, ...], ScenarioRecord] = {}
        for row in rows:
            if row.state != "pending":
                first_rows.setdefault(scenario_key(study, row), row)
        columns = {name: study.scores(name).tolist() for name in metrics}
        scores = {scenario: {name: columns[name][k] for name in metrics} for k, scenario in enumerate(done)}
        critical = dict(zip(done, study.critical_mask().tolist(), strict=True)) if study.criterion else {}
        searched = study.meta.optimizer.partition(":")[0] != "none"
        fills = dict.fromkeys((row.id for row in rows), False)
        if searched:
            fills = {row.id: study.meta.is_audit(row.id) for row in rows}
            searched_rows = [row for row in rows if not fills[row.id]]
            points = np.array([row.point for row in searched_rows]).reshape(-1, study.space.dimension)
            is_independent = is_score_independent(study.meta.optimizer, study.space, study.meta.seed, points)
            fills |= {row.id: bool(counts) for row, counts in zip(searched_rows, is_independent, strict=True) if counts}
        return cls(study, tuple(first_rows.values()), fills, searched, scores, critical, verdicts, study.impacts())

    def is_score_independent(self, scenario: int) -> bool:
        """Tell whether a scenario was chosen independently of scores."""
        return not self.is_explored or self.fills_space[scenario]

    def space_filling_ids(self) -> list[int]:
        """Return ids of the scenarios that ran without failing, and that the search chose without regard to scores."""
        return [row.id for row in self.rows if row.state == "done" and self.fills_space[row.id]]


def scenario_key(study: StudyFile, row: ScenarioRecord) -> tuple[object, ...]:
    """Return the parameter values of a scenario as a key to find the same scenario in another study."""
    return tuple(
        str(value) if parameter.choices else float(value)
        for parameter in study.space.parameters
        for value in (parameter.extract_value(row.values),)
    )


def criticality_metrics(study: StudyFile) -> tuple[str, ...]:
    """Return the metrics whose scores define which scenarios are critical in a study; empty without a threshold."""
    if study.criterion is None:
        return ()
    return tuple(study.meta.weights) or study.meta.metrics[:1]


def match_pairs(old: ComparedStudy, new: ComparedStudy, metrics: Sequence[str]) -> tuple[ScenarioPair, ...]:
    """Pair the scenarios that ended in both studies, in the order of the old study, and compare their results."""
    other = old.study.primary_other()
    partners = {scenario_key(new.study, row): row for row in new.rows}
    pairs = []
    for row in old.rows:
        partner = partners.get(scenario_key(old.study, row))
        if partner is not None:
            pairs.append(_build_pair(old, new, row, partner, other, metrics))
    return tuple(pairs)


def _build_pair(
    old: ComparedStudy,
    new: ComparedStudy,
    old_row: ScenarioRecord,
    new_row: ScenarioRecord,
    other: str,
    metrics: Sequence[str],
) -> ScenarioPair:
    ids = old_row.id, new_row.id
    unselected = old.is_score_independent(old_row.id) and new.is_score_independent(new_row.id)
    point = tuple(old_row.point.tolist())
    ran = [row.state == "done" for row in (old_row, new_row)]
    if not all(ran):
        run: RunComparison = "not in one" if any(ran) else "in neither"
        return ScenarioPair(ids, old_row.values, point, run, unselected, (old_row.error, new_row.error))
    recordings = old.study.read_recording_pair(old_row.id, new.study, new_row.id)
    run = compare_recordings(*recordings)
    ego, others = old.study.meta.ego, old.study.meta.others
    # Encounters with entities other than `other` do not affect the outcome.
    old_ending = find_outcome(recordings[0].with_absent_entities(others), ego, other, others=False)
    new_ending = (
        old_ending
        if run == "the same"
        else find_outcome(recordings[1].with_absent_entities(others), ego, other, others=False)
    )
    verdicts = _match_verdicts(old.verdicts.get(old_row.id, ()), new.verdicts.get(new_row.id, ()))
    has_criticality = bool(old.is_critical and new.is_critical)
    return ScenarioPair(
        ids,
        old_row.values,
        point,
        run,
        unselected,
        scores=_pair_scores(old, new, ids, metrics),
        outcomes=(old_ending.text, new_ending.text),
        collides=(bool(old_ending.impacts), bool(new_ending.impacts)),
        is_critical=(old.is_critical[old_row.id], new.is_critical[new_row.id]) if has_criticality else None,
        verdicts=verdicts,
        margins=_changed_margins(verdicts, recordings, ego, others),
        criticality_scores=_pair_scores(old, new, ids, criticality_metrics(old.study) if has_criticality else ()),
        faults=(_describe_fault(old, ids[0]), _describe_fault(new, ids[1])),
    )


def _describe_fault(side: ComparedStudy, scenario: int) -> str:
    """Return as text who is at fault in the ego's first collision; empty without a collision, or if unknown."""
    impacts = side.impacts.get(scenario, ())
    if not impacts or impacts[0].fault is None:
        return ""
    return impacts[0].fault.describe(side.study.meta.ego, impacts[0].entity)


def _pair_scores(
    old: ComparedStudy, new: ComparedStudy, ids: tuple[int, int], metrics: Sequence[str]
) -> dict[str, tuple[float, float]]:
    return {name: (old.scores[ids[0]][name], new.scores[ids[1]][name]) for name in metrics}


def _changed_margins(
    verdicts: tuple[tuple[Verdict, ...], tuple[Verdict, ...]],
    recordings: Sequence[Recording],
    ego: str,
    others: Sequence[str],
) -> dict[str, tuple[float, float]]:
    """Return the old and new margin (robustness) of each requirement that changed between passed and failed.

    Requirements without a margin, such as ``"no collision"``, are left out.
    """
    margins = {}
    for before, after in zip(*verdicts, strict=True):
        if {before.state, after.state} == {"passed", "failed"}:
            requirement = Requirement.parse(before.requirement)
            old, new = (compute_margin(requirement, recording, ego, others) for recording in recordings)
            if old is not None and new is not None:
                margins[requirement.text] = old, new
    return margins


def compare_recordings(old: Recording, new: Recording) -> RunComparison:
    """Return whether two recordings are the same, the same within rounding, or different (``"otherwise"``)."""
    if old.names != new.names or old.object_types != new.object_types or old.time.shape != new.time.shape:
        return "otherwise"
    if are_bitwise_equal(old, new):
        return "the same"
    arrays = [(getattr(old, name), getattr(new, name)) for name in NUMERIC_ARRAYS]
    is_close = all(np.allclose(a, b, rtol=0.0, atol=_ROUNDING_TOLERANCE, equal_nan=True) for a, b in arrays)
    collisions = [[collision.entities for collision in recording.collisions] for recording in (old, new)]
    return "within rounding" if is_close and collisions[0] == collisions[1] else "otherwise"


def _match_verdicts(old: Sequence[Verdict], new: Sequence[Verdict]) -> tuple[tuple[Verdict, ...], tuple[Verdict, ...]]:
    """Return old and new verdicts on the requirements that both studies have, in the order of the old study."""
    new_by_text = {verdict.requirement: verdict for verdict in new}
    matched = [(verdict, new_by_text[verdict.requirement]) for verdict in old if verdict.requirement in new_by_text]
    return tuple(verdict for verdict, _ in matched), tuple(other for _, other in matched)


def count_unpaired_scenarios(
    old: ComparedStudy, new: ComparedStudy, pairs: Sequence[ScenarioPair]
) -> tuple[UnpairedScenarios, UnpairedScenarios]:
    """Count the scenarios that only one study ran, for each study: all, critical, with collision, chosen by scores."""

    def count_side(side: ComparedStudy, paired: set[int]) -> UnpairedScenarios:
        ids = [row.id for row in side.rows if row.id not in paired]
        critical = sum(side.is_critical.get(scenario, False) for scenario in ids) if side.is_critical else None
        chosen = sum(not side.is_score_independent(scenario) for scenario in ids)
        collisions = sum(bool(side.impacts.get(scenario)) for scenario in ids)
        return UnpairedScenarios(len(ids), chosen, critical, collisions)

    return count_side(old, {pair.ids[0] for pair in pairs}), count_side(new, {pair.ids[1] for pair in pairs})


def choose_compared_metrics(old: StudyFile, new: StudyFile, metrics: Sequence[str] | None) -> tuple[str, ...]:
    """Return the metrics to compare; raise `InputError` if the studies cannot be compared."""
    pair = f"{old.path} and {new.path}"
    a, b = old.meta, new.meta
    # The fingerprint of an import is that of its recordings.
    if not _have_same_scenarios(a, b) and IMPORTED_SIMULATOR not in (a.simulator, b.simulator):
        subject = "suites" if a.suite and b.suite else "scenarios"
        versions = (
            f"different versions of the same {subject[:-1]}" if a.file_name == b.file_name else f"different {subject}"
        )
        raise InputError(
            f"{pair}: the studies are of {versions} ({a.file_name}, {b.file_name}); compare studies of the same"
            " scenarios."
        )
    if a.space.parameters != b.space.parameters:
        only_old, only_new = (
            ", ".join(str(parameter) for parameter in mine.parameters if parameter not in other.parameters) or "nothing"
            for mine, other in ((a.space, b.space), (b.space, a.space))
        )
        raise InputError(
            f"{pair}: the studies have different parameter spaces (only the first: {only_old}; only the second:"
            f" {only_new}); compare studies of the same parameters and ranges."
        )
    if (a.ego, set(a.others)) != (b.ego, set(b.others)):
        entities = "; ".join(f"{meta.ego} and {', '.join(meta.others)}" for meta in (a, b))
        same = "the same two" if len(a.others) == len(b.others) == 1 else "the same entities"
        raise InputError(f"{pair}: the studies measure different entities ({entities}); compare studies of {same}.")
    shared = tuple(name for name in a.metrics if name in b.metrics)
    if metrics is None:
        if set(a.metrics) != set(b.metrics):
            advice = (
                f"choose among {', '.join(shared)} with `metrics`" if shared else "compare studies of the same metrics"
            )
            raise InputError(
                f"{pair}: the studies have different metrics ({', '.join(a.metrics)}; {', '.join(b.metrics)});"
                f" {advice}."
            )
        compared = shared
    else:
        compared = tuple(dict.fromkeys(metrics))
        if not compared:
            raise InputError(f"`metrics`: name at least one metric; both studies have {', '.join(shared) or 'none'}.")
        for name in compared:
            if name not in shared:
                raise InputError(
                    f"`metrics` {name}: is not in both studies; metrics in both: {', '.join(shared) or 'none'}."
                )
    if old.criterion and new.criterion and _describe_criterion(a) != _describe_criterion(b):
        raise InputError(
            f"{pair}: the studies decide by different metrics which scenarios are critical ({_describe_criterion(a)};"
            f" {_describe_criterion(b)}); compare studies with the same first metric, or with the same weights."
        )
    if old.criterion and new.criterion and old.critical != new.critical:
        raise InputError(
            f"{pair}: the studies have different thresholds ({a.critical:g}, {b.critical:g}); give one for both with"
            " `critical`."
        )
    return compared


def _have_same_scenarios(old: StudyMeta, new: StudyMeta) -> bool:
    """Tell whether two studies have the same scenario files, or one runs a suite that was reduced from the other."""
    if bool(old.suite) == bool(new.suite):
        return (old.fingerprint, old.suite) == (new.fingerprint, new.suite)
    suite, explored = (old, new) if old.suite else (new, old)
    return suite.origin == explored.fingerprint


def _describe_criterion(meta: StudyMeta) -> str:
    """Return as text the metrics whose scores say whether a scenario is critical, with their weights if any."""
    weighted = [f"{weight:g} {name}" for name, weight in sorted(dict(meta.weights).items())]
    return " + ".join(weighted) or meta.metrics[0]


def space_filling_scores(
    side: ComparedStudy, metrics: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, BoolArray]]:
    """Return scores by metric, and yes/no facts by name, of the scenarios that were chosen without regard to scores.

    The facts are "collision" and "critical". Each array has the shape (n,) for n scenarios.
    """
    ids, meta = side.space_filling_ids(), side.study.meta
    scores = {name: np.array([side.scores[scenario][name] for scenario in ids]) for name in metrics}
    hits = [
        any(meta.ego in collision.entities for collision in side.study.recording(scenario).collisions)
        for scenario in ids
    ]
    facts = {"collision": np.array(hits, dtype=np.bool_)}
    if side.is_critical:
        facts["critical"] = np.array([side.is_critical[scenario] for scenario in ids], dtype=np.bool_)
    return scores, facts
