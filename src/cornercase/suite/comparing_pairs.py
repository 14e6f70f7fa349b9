"""The same concrete scenarios in two studies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.clustering import find_outcome
from cornercase.exploration import Objective, chosen_blindly
from cornercase.recordings import ARRAYS, Recording, same_bytes
from cornercase.study import IMPORTED, Row, Study, StudyMeta
from cornercase.suite.comparing_results import Pair, Run
from cornercase.suite.judging import find_margin
from cornercase.suite.requirement import Requirement
from cornercase.suite.verdict import Verdict

# Of m, s, rad, m/s and m/s²: what another processor or compiler makes of the same motion.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two studies.

    Attributes
    ----------
    study : Study
    rows : tuple of Row
        All that ended; of those with the same values the first.
    fills : mapping of int to bool
        By id, whether a scenario is one of those that fill the space, whatever the scores are.
    searched : bool
        Whether a search chose scenarios; else they were chosen before anything was run.
    scores : mapping of int to mapping of str to float
        By id and metric, of those that were run: metrics to compare, and those that decide what is critical.
    critical : mapping of int to bool
        Empty where nothing says it.
    verdicts : mapping of int to sequence of Verdict
    """

    study: Study
    rows: tuple[Row, ...]
    fills: Mapping[int, bool]
    searched: bool
    scores: Mapping[int, Mapping[str, float]]
    critical: Mapping[int, bool]
    verdicts: Mapping[int, Sequence[Verdict]]

    @classmethod
    def of(cls, study: Study, metrics: Sequence[str], verdicts: Mapping[int, Sequence[Verdict]]) -> Side:
        """Read what is known of the scenarios of a study, but for their recordings.

        Parameters
        ----------
        study : Study
            Open.
        metrics : sequence of str
        verdicts : mapping of int to sequence of Verdict

        Returns
        -------
        Side
        """
        every, done = study.rows(), [row.id for row in study.done()]
        seen: dict[tuple[object, ...], Row] = {}
        for row in every:
            if row.state != "pending":
                seen.setdefault(key_of(study, row), row)
        columns = {name: study.scores(name).tolist() for name in metrics}
        scores = {one: {name: columns[name][k] for name in metrics} for k, one in enumerate(done)}
        known = knows_critical(study)
        critical = (
            dict(zip(done, Objective.of_study(study.meta).critical_of(study).tolist(), strict=True)) if known else {}
        )
        searched = study.meta.optimizer.partition(":")[0] != "none"
        fills = dict.fromkeys((row.id for row in every), False)
        if searched:
            fills = {row.id: study.meta.is_audit(row.id) for row in every}
            sought = [row for row in every if not fills[row.id]]
            points = np.array([row.point for row in sought]).reshape(-1, study.space.dimension)
            blindly = chosen_blindly(study.meta.optimizer, study.space, study.meta.seed, points)
            fills |= {row.id: bool(one) for row, one in zip(sought, blindly, strict=True) if one}
        return cls(study, tuple(seen.values()), fills, searched, scores, critical, verdicts)

    def unselected(self, scenario: int) -> bool:
        """Tell whether a scenario was not chosen by scores.

        Parameters
        ----------
        scenario : int
            Its id.

        Returns
        -------
        bool
        """
        return not self.searched or self.fills[scenario]

    def filling(self) -> list[int]:
        """List the scenarios that were run and fill the space.

        Returns
        -------
        list of int
            Their ids.
        """
        return [row.id for row in self.rows if row.state == "done" and self.fills[row.id]]


def knows_critical(study: Study) -> bool:
    """Tell whether a study says which scenarios are critical.

    Parameters
    ----------
    study : Study

    Returns
    -------
    bool
    """
    return study.critical is not None and not study.meta.pareto


def key_of(study: Study, row: Row) -> tuple[object, ...]:
    """Values of a scenario's parameters, by which its partner is found.

    Parameters
    ----------
    study : Study
    row : Row

    Returns
    -------
    tuple
        A number, or the text of a choice, for each parameter.
    """
    return tuple(
        str(value) if one.choices else float(value)
        for one in study.space.parameters
        for value in (one.read(row.values),)
    )


def deciding_metrics(study: Study) -> tuple[str, ...]:
    """Name the metrics whose scores say which scenarios of a study are critical.

    Parameters
    ----------
    study : Study

    Returns
    -------
    tuple of str
        Empty where nothing says it.
    """
    if not knows_critical(study):
        return ()
    return tuple(study.meta.weights) or study.meta.metrics[:1]


def read_pairs(old: Side, new: Side, metrics: Sequence[str]) -> tuple[Pair, ...]:
    """Find the scenarios that ended in both studies, and what became of them.

    Parameters
    ----------
    old, new : Side
        Of the same space.
    metrics : sequence of str
        Metrics to compare.

    Returns
    -------
    tuple of Pair
        In the order of the old study.

    Raises
    ------
    InputError
        A recording lacks an entity.
    """
    main = old.study.main_other()
    partners = {key_of(new.study, row): row for row in new.rows}
    found = []
    for row in old.rows:
        partner = partners.get(key_of(old.study, row))
        if partner is not None:
            found.append(_pair(old, new, row, partner, main, metrics))
    return tuple(found)


def _pair(old: Side, new: Side, before: Row, after: Row, other: str, metrics: Sequence[str]) -> Pair:
    ids = before.id, after.id
    unselected = old.unselected(before.id) and new.unselected(after.id)
    point = tuple(before.point.tolist())
    ran = [row.state == "done" for row in (before, after)]
    if not all(ran):
        run: Run = "not in one" if any(ran) else "in neither"
        return Pair(ids, before.values, point, run, unselected, (before.error, after.error))
    recordings = old.study.recordings_beside(before.id, new.study, after.id)
    run = compare_recordings(*recordings)
    ego, others = old.study.meta.ego, old.study.meta.others
    # Encounters with others than `other` change neither in words nor in collisions how it ended.
    first = find_outcome(recordings[0].with_absent(others), ego, other, others=False)
    last = first if run == "the same" else find_outcome(recordings[1].with_absent(others), ego, other, others=False)
    verdicts = _on_the_same(old.verdicts.get(before.id, ()), new.verdicts.get(after.id, ()))
    known = bool(old.critical and new.critical)
    return Pair(
        ids,
        before.values,
        point,
        run,
        unselected,
        scores=_scores(old, new, ids, metrics),
        outcomes=(first.text, last.text),
        collides=(bool(first.impacts), bool(last.impacts)),
        critical=(old.critical[before.id], new.critical[after.id]) if known else None,
        verdicts=verdicts,
        margins=_margins(verdicts, recordings, ego, others),
        deciding=_scores(old, new, ids, deciding_metrics(old.study) if known else ()),
    )


def _scores(old: Side, new: Side, ids: tuple[int, int], metrics: Sequence[str]) -> dict[str, tuple[float, float]]:
    return {name: (old.scores[ids[0]][name], new.scores[ids[1]][name]) for name in metrics}


def _margins(
    verdicts: tuple[tuple[Verdict, ...], tuple[Verdict, ...]],
    recordings: Sequence[Recording],
    ego: str,
    others: Sequence[str],
) -> dict[str, tuple[float, float]]:
    """How far requirements hold that turned from passed to failed or back, where that is a matter of degree."""
    margins = {}
    for before, after in zip(*verdicts, strict=True):
        if {before.state, after.state} == {"passed", "failed"}:
            requirement = Requirement.parse(before.requirement)
            old, new = (find_margin(requirement, one, ego, others) for one in recordings)
            if old is not None and new is not None:
                margins[requirement.text] = old, new
    return margins


def compare_recordings(old: Recording, new: Recording) -> Run:
    """Tell whether two recordings are the same.

    Parameters
    ----------
    old, new : Recording

    Returns
    -------
    {"the same", "within rounding", "otherwise"}
        Of entities, collisions and everything that moves.
    """
    if old.names != new.names or old.kinds != new.kinds or old.time.shape != new.time.shape:
        return "otherwise"
    if same_bytes(old, new):
        return "the same"
    arrays = [(getattr(old, name), getattr(new, name)) for name in ARRAYS]
    near = all(np.allclose(a, b, rtol=0.0, atol=_ROUNDING, equal_nan=True) for a, b in arrays)
    met = [[one.entities for one in each.collisions] for each in (old, new)]
    return "within rounding" if near and met[0] == met[1] else "otherwise"


def _on_the_same(old: Sequence[Verdict], new: Sequence[Verdict]) -> tuple[tuple[Verdict, ...], tuple[Verdict, ...]]:
    """Verdicts on the requirements that both have, in the order of the old ones."""
    after = {one.requirement: one for one in new}
    both = [(one, after[one.requirement]) for one in old if one.requirement in after]
    return tuple(one for one, _ in both), tuple(other for _, other in both)


def require_comparable(old: Study, new: Study, metrics: Sequence[str] | None) -> tuple[str, ...]:
    """Refuse studies of which scenarios or scores mean something else.

    Parameters
    ----------
    old, new : Study
    metrics : sequence of str, optional
        Those to compare, in place of all.

    Returns
    -------
    tuple of str
        Metrics to compare.

    Raises
    ------
    InputError
        The studies are of other scenarios, entities, parameters, metrics or thresholds, or one of the metrics is not
        in both.
    """
    pair = f"{old.path} and {new.path}"
    a, b = old.meta, new.meta
    # Of recordings that were imported it is that of the recordings.
    if not _of_the_same(a, b) and IMPORTED not in (a.simulator, b.simulator):
        what = "suites" if a.suite and b.suite else "scenarios"
        versions = f"different versions of the same {what[:-1]}" if a.file_name == b.file_name else f"other {what}"
        raise InputError(f"{pair}: are of {versions} ({a.file_name}, {b.file_name}); compare studies of the same.")
    if a.space.parameters != b.space.parameters:
        raise InputError(
            f"{pair}: have different parameter spaces ({', '.join(a.space.names) or 'none'};"
            f" {', '.join(b.space.names) or 'none'}); compare studies of the same parameters and ranges."
        )
    if (a.ego, set(a.others)) != (b.ego, set(b.others)):
        whom = "; ".join(f"{one.ego} and {', '.join(one.others)}" for one in (a, b))
        same = "the same two" if len(a.others) == len(b.others) == 1 else "the same entities"
        raise InputError(f"{pair}: measure different entities ({whom}); compare studies of {same}.")
    both = tuple(name for name in a.metrics if name in b.metrics)
    if metrics is None:
        if set(a.metrics) != set(b.metrics):
            advice = f"choose among {', '.join(both)} with `metrics`" if both else "compare studies of the same metrics"
            raise InputError(
                f"{pair}: have different metrics ({', '.join(a.metrics)}; {', '.join(b.metrics)}); {advice}."
            )
        chosen = both
    else:
        chosen = tuple(dict.fromkeys(metrics))
        if not chosen:
            raise InputError(f"`metrics`: name at least one; both have {', '.join(both) or 'none'}.")
        for name in chosen:
            if name not in both:
                raise InputError(f"`metrics` {name}: is not in both studies; both have {', '.join(both) or 'none'}.")
    if knows_critical(old) and knows_critical(new) and _criterion(old) != _criterion(new):
        raise InputError(
            f"{pair}: have different thresholds ({a.critical:g}, {b.critical:g}); give one for both with `critical`."
        )
    return chosen


def _of_the_same(a: StudyMeta, b: StudyMeta) -> bool:
    """Whether two studies are of the same files, or one of a suite that was reduced from what the other explored."""
    if bool(a.suite) == bool(b.suite):
        return (a.fingerprint, a.suite) == (b.fingerprint, b.suite)
    suite, explored = (a, b) if a.suite else (b, a)
    return suite.origin == explored.fingerprint


def _criterion(study: Study) -> tuple[object, ...]:
    meta = study.meta
    return study.critical, dict(meta.weights), meta.metrics[0] if not meta.weights else None


def sample_of(side: Side, metrics: Sequence[str]) -> tuple[dict[str, FloatArray], dict[str, BoolArray]]:
    """What is known of the scenarios that fill the space, where these are not the same in both studies.

    Parameters
    ----------
    side : Side
    metrics : sequence of str

    Returns
    -------
    scores : dict of str to ndarray of float64, shape (n,)
    facts : dict of str to ndarray of bool, shape (n,)
        ``"collision"``, and ``"critical"`` where that is known.
    """
    ids, meta = side.filling(), side.study.meta
    scores = {name: np.array([side.scores[one][name] for one in ids]) for name in metrics}
    hits = [any(meta.ego in hit.entities for hit in side.study.recording(one).collisions) for one in ids]
    facts = {"collision": np.array(hits, dtype=np.bool_)}
    if side.critical:
        facts["critical"] = np.array([side.critical[one] for one in ids], dtype=np.bool_)
    return scores, facts
