"""Compare two versions of the system under test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.validation import check_str_sequence
from cornercase.clustering import read_analyses
from cornercase.clustering._assign import assign_to_clusters
from cornercase.clustering._headline_aspect import find_headline_aspect
from cornercase.drivers import DRIVERS
from cornercase.drivers._serialization import driver_command_option, format_driver
from cornercase.evidence import CriticalSetDifference
from cornercase.metrics import Metric
from cornercase.simulators import SIMULATORS
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._study_file import open_study
from cornercase.suite._judge import judge_study
from cornercase.suite._requirement import Requirement
from cornercase.suite.compare._change_verdict import decide_verdict, find_findings, resolve_tolerances
from cornercase.suite.compare._choose_examples import choose_examples
from cornercase.suite.compare._comparison import (
    ALPHA,
    ChangeTest,
    ClusterChange,
    Comparison,
    ScenarioPair,
    ScoreChanges,
)
from cornercase.suite.compare._critical_region_change import estimate_space_change
from cornercase.suite.compare._match_scenarios import (
    ComparedStudy,
    choose_compared_metrics,
    count_unpaired_scenarios,
    criticality_metrics,
    match_pairs,
    space_filling_scores,
)
from cornercase.suite.compare._significance import (
    MIN_SAMPLE_SIZE,
    holm_correct,
    score_difference,
    test_pairs,
    test_unpaired_samples,
)

_DRIVER_PREFIX: Final = "drivers "
# Fields listed as differences; seed and optimizer only determine which scenarios were run.
_SETTING_LABELS: Final = {
    "simulator": "simulator",
    "version": "version of cornercase",
    "repeats_text": "runs of each scenario",
}


def compare(
    old: StudyFile | Path | str,
    new: StudyFile | Path | str,
    *,
    metrics: str | Sequence[str] | None = None,
    critical: float | None = None,
    tolerances: Mapping[str, float] | None = None,
) -> Comparison:
    """Compare two versions of the system under test, and tell whether the new one is better or worse.

    Each version has to be run into a study of its own. Scenarios with the same parameters are compared one by one. If
    both studies were explored, their critical sets are compared too. If both simulators are deterministic and no sensor
    is random, any two recordings that differ show a change. Otherwise statistical tests decide; they use only scenarios
    that were chosen independently of scores.

    Parameters
    ----------
    old, new : Study or path
        Studies of the same scenario, parameter space and entities. Drivers, simulators, versions and time steps may
        differ.
    metrics : str or sequence of str, optional
        Metrics to compare by. By default all metrics; both studies must then have the same metrics.
    critical : float, optional
        Threshold for this comparison only. By default the threshold of each study; both must then be equal.
    tolerances : mapping of str to float, optional
        Largest change of a score that does not count, by metric, in its unit. By default 0.1 for s, m, m/s, m/s² and
        s², 0.01 for rad and for metrics without unit, and 0 for other units.

    Returns
    -------
    Comparison
        `verdict` says whether the new version is better, worse, mixed or the same, or that the data do not allow a
        verdict. As a bool, the result is True if the versions differ at all. If simulators are not deterministic, equal
        versions are called better or worse with a probability of at most 5 %, for all tests together.

    Raises
    ------
    InputError
        The studies have different scenarios, parameters, entities, metrics or thresholds. Or they have no scenario in
        common, except those that failed in both, and one study has fewer than 20 scenarios that were chosen
        independently of scores. Or the run of a suite is incomplete. Or a tolerance is negative, or for a metric that
        is neither compared nor used by the threshold or by a requirement of both studies.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.compare("missing_a.db", "missing_b.db")
    Traceback (most recent call last):
        ...
    cornercase._common.errors.InputError: missing_a.db: there is no such study; make one with `Study.create`.
    """
    with (
        open_study(old, readonly=True, critical=critical) as before,
        open_study(new, readonly=True, critical=critical) as after,
    ):
        compared = choose_compared_metrics(
            before, after, None if metrics is None else check_str_sequence("metrics", metrics)
        )
        for study in (before, after):
            _require_complete_suite(study)
        shared = set(before.meta.requirements) & set(after.meta.requirements)
        measured = tuple(
            dict.fromkeys((*compared, *(criticality_metrics(before) if criticality_metrics(after) else ())))
        )
        required = [name for item in sorted(shared) for name in Requirement.parse(item).expression.metrics]
        metric_by_name = {name: before.meta.create_metric(name) for name in (*measured, *required)}
        for name in metric_by_name:
            if before.meta.own_metrics.get(name) != after.meta.own_metrics.get(name):
                raise InputError(
                    f"{before.path} and {after.path}: define the metric '{name}' differently; explore one again."
                )
        limits = resolve_tolerances(metric_by_name, tolerances)
        sides = [ComparedStudy.from_study(study, measured, judge_study(study)) for study in (before, after)]
        pairs = match_pairs(sides[0], sides[1], compared)
        deterministic = all(_is_deterministic(study.meta) for study in (before, after))
        compared_metrics = {name: metric_by_name[name] for name in compared}
        space = estimate_space_change(sides[0], sides[1], pairs)
        sets = None if space is None else space.sets
        tests = _run_significance_tests(sides[0], sides[1], pairs, compared_metrics, deterministic, sets)
        changed, reason = _decide_whether_changed(pairs, tests, deterministic)
        worse, better, within = find_findings(pairs, tests, metric_by_name, limits, deterministic)
        clusters, main_aspect = _count_cluster_changes(before, after, pairs)
        verdict, verdict_reason = decide_verdict((worse, better), pairs, tests, (changed, reason), deterministic)
        return Comparison(
            names=(before.path.name, after.path.name),
            title=before.meta.title,
            differences=(
                *_describe_setting_differences(before.meta, after.meta),
                *_describe_nondeterminism(before, after),
            ),
            changed=changed,
            reason=reason,
            verdict=verdict,
            verdict_reason=verdict_reason,
            worse=worse,
            better=better,
            within_tolerance=within,
            tolerances=limits,
            is_deterministic=deterministic,
            pairs=pairs,
            n_unmatched=(len(sides[0].rows) - len(pairs), len(sides[1].rows) - len(pairs)),
            unpaired=count_unpaired_scenarios(sides[0], sides[1], pairs),
            same_search=(before.meta.optimizer, before.meta.seed) == (after.meta.optimizer, after.meta.seed),
            main_aspect=main_aspect,
            scores=tuple(
                _compute_score_change(pairs, name, metric)
                for name, metric in compared_metrics.items()
                if any(pair.both_ran for pair in pairs)
            ),
            tests=tests,
            outcomes=Counter(pair.outcomes for pair in pairs if pair.both_ran),
            verdicts=Counter(
                (a.requirement, a.state, b.state) for pair in pairs for a, b in zip(*pair.verdicts, strict=True)
            ),
            clusters=clusters,
            space=space,
            examples=choose_examples(pairs, compared_metrics, _sole_criticality_metric(before.meta, compared)),
            metrics=metric_by_name,
            critical=critical,
        )


def _require_complete_suite(study: StudyFile) -> None:
    """Raise `InputError` if the run of a suite is incomplete, since the scenarios so far could look like no change."""
    n_pending = sum(row.state == "pending" for row in study.rows())
    if study.meta.suite and n_pending:
        raise InputError(
            f"{study.path}: {n_pending} of its {study.meta.budget} scenarios have not been run yet; run `test` again"
            " to complete the run."
        )


def _sole_criticality_metric(meta: StudyMeta, metrics: Sequence[str]) -> str:
    """Return the metric that alone defines criticality; empty if several metrics do, or if it is not compared."""
    return "" if meta.weights or meta.pareto or meta.metrics[0] not in metrics else meta.metrics[0]


def _is_deterministic(meta: StudyMeta) -> bool:
    """Return whether the runs of a study are deterministic.

    Runs are deterministic if a repeated run gave the same recording, unless the simulator is declared not
    deterministic. If none was repeated, the simulator and all drivers must be cornercase's own, and the simulator must
    be declared deterministic. Runs with random sensors do not count as deterministic, although runs with the same seed
    are equal.
    """
    if meta.repeatability.get("random", False):
        return False
    declared: bool | None = None
    is_own_code = False
    with suppress(InputError):
        simulator = SIMULATORS.get_class(meta.simulator)
        declared = simulator.deterministic
        is_own_code = simulator.__module__.startswith("cornercase.") and not any(
            map(_is_custom_driver, meta.drivers.values())
        )
    observed = meta.repeatability.get("same")
    return declared is not False and bool(observed) if observed is not None else is_own_code and declared is True


def _run_significance_tests(
    old: ComparedStudy,
    new: ComparedStudy,
    pairs: Sequence[ScenarioPair],
    metrics: Mapping[str, Metric],
    deterministic: bool,
    sets: CriticalSetDifference | None,
) -> tuple[ChangeTest, ...]:
    """Run all significance tests, and correct the p-values for the number of tests.

    If runs are deterministic, all pairs are tested, otherwise only pairs that were chosen independently of scores. If
    there are too few pairs of the latter kind, unpaired samples are tested, too: the scenarios of each study that were
    chosen independently of scores, to fill the parameter space evenly or at random.
    """
    tested = [pair for pair in pairs if deterministic or pair.is_score_independent]
    tests_ = test_pairs(tested, metrics) if any(pair.run != "in neither" for pair in tested) else []
    n_filling = len(old.space_filling_ids()), len(new.space_filling_ids())
    # If both designs are mostly the same scenarios, pairs are more powerful.
    if sum(pair.is_score_independent for pair in pairs) < MIN_SAMPLE_SIZE <= min(n_filling):
        old_scores, old_facts = space_filling_scores(old, list(metrics))
        new_scores, new_facts = space_filling_scores(new, list(metrics))
        shared = {name: fact for name, fact in old_facts.items() if name in new_facts}
        tests_ += test_unpaired_samples((old_scores, new_scores), (shared, new_facts), metrics, sets)
    if not tests_ and all(pair.run == "in neither" for pair in pairs):
        raise InputError(
            f"{old.study.path} and {new.study.path}: no scenario was run in both, and only {n_filling[0]} and"
            f" {n_filling[1]} scenarios were chosen independently of scores (each study needs {MIN_SAMPLE_SIZE});"
            " explore both with the same `seed`, or with `audit`."
        )
    return holm_correct(tests_)


def _decide_whether_changed(
    pairs: Sequence[ScenarioPair], tests: Sequence[ChangeTest], deterministic: bool
) -> tuple[bool, str]:
    runs = Counter(pair.run for pair in pairs)
    n_ran = sum(pair.both_ran for pair in pairs)
    significant = [test for test in tests if test.corrected <= ALPHA]
    if n_different := deterministic and runs["otherwise"]:
        return (
            True,
            f"{n_different} of {n_ran} scenarios that ran with both differ, and both simulators are deterministic",
        )
    if deterministic and runs["not in one"]:
        return True, f"{runs['not in one']} of {len(pairs)} scenarios could be run with one version only"
    if significant:
        first = min(significant, key=lambda test: test.corrected)
        rest = f" and {len(significant) - 1} more" if len(significant) > 1 else ""
        return True, (
            f"{first.about} differs ({first.method}, p = {first.corrected:.2g} corrected for {len(tests)} tests){rest}"
        )
    if n_ran and runs["the same"] == len(pairs) - runs["in neither"]:
        return False, f"all {n_ran} scenarios that both ran have identical recordings"
    if deterministic and n_ran:
        return False, f"the {n_ran} scenarios that both ran are the same up to rounding"
    if not tests:
        return False, "none of the scenarios that both ran can be tested: a search chose them by their scores"
    return False, f"none of {len(tests)} tests shows a change, at {ALPHA:.0%} over all of them"


def _compute_score_change(pairs: Sequence[ScenarioPair], metric_name: str, metric: Metric) -> ScoreChanges:
    both_ran = [pair for pair in pairs if pair.both_ran]
    scores = np.array([pair.scores[metric_name] for pair in both_ran])
    changes = score_difference(scores[:, 0], scores[:, 1])
    moved = changes[changes != 0.0]
    worse = int((np.asarray(metric.to_minimize(moved)) < 0.0).sum())
    k = int(np.abs(changes).argmax())
    return ScoreChanges(
        metric=metric_name,
        unit=metric.unit,
        pairs=len(both_ran),
        moved=len(moved),
        worse=worse,
        better=len(moved) - worse,
        median=float(np.median(moved)) if len(moved) else 0.0,
        largest=float(changes[k]),
        ids=both_ran[k].ids if len(moved) else None,
    )


def _describe_setting_differences(old: StudyMeta, new: StudyMeta) -> Iterator[str]:
    if bool(old.suite) != bool(new.suite):
        yield f"scenarios: {' → '.join('of a suite' if meta.suite else 'explored' for meta in (old, new))}"
    for name, label in _SETTING_LABELS.items():
        if getattr(old, name) != getattr(new, name):
            yield f"{label}: {getattr(old, name)} → {getattr(new, name)}"
    yield from _describe_value_difference("", *_settings_with_ego_drivers(old, new))


def _settings_with_ego_drivers(old: StudyMeta, new: StudyMeta) -> Iterator[dict[str, Any]]:
    """Yield the settings of each study, including the ego's driver if only the scenario file names it."""
    ego_drivers = [meta.ego_driver for meta in (old, new)]
    for meta, driver in zip((old, new), ego_drivers, strict=True):
        ego_entry = {} if None in ego_drivers else {meta.ego: driver or "its storyboard"}
        yield {**meta.settings, "drivers": {**meta.drivers, **ego_entry}}


def _describe_nondeterminism(*studies: StudyFile) -> Iterator[str]:
    for study in studies:
        if study.meta.nondeterminism_text:
            yield f"runs of {study.path.name} differ: {study.meta.nondeterminism_text}"


def _describe_value_difference(name: str, old: Any, new: Any) -> Iterator[str]:
    if old == new:
        return
    if name.startswith(_DRIVER_PREFIX) and (_is_custom_driver(old) or _is_custom_driver(new)):
        texts = format_driver(old), format_driver(new)
        if texts[0] != texts[1]:
            yield f"driver {name.removeprefix(_DRIVER_PREFIX)}: {texts[0]} → {texts[1]}"
            return
    before, after = old, new
    if isinstance(old, str) != isinstance(new, str):
        before, after = _expand_driver_name(old), _expand_driver_name(new)
    if isinstance(before, Mapping) and isinstance(after, Mapping) and before.get("driver") == after.get("driver"):
        for key in [*before, *(key_ for key_ in after if key_ not in before)]:
            yield from _describe_value_difference(f"{name} {key}".lstrip(), before.get(key), after.get(key))
    else:
        yield f"{name.replace('_', ' ')}: {_format_setting(old)} → {_format_setting(new)}"


def _is_custom_driver(driver: Any) -> bool:
    """Return whether a driver is the user's own code, neither registered nor described by parameters alone."""
    if not isinstance(driver, Mapping):
        return False
    return driver_command_option(driver) is None or not {"options", "sha256", "settings"}.isdisjoint(driver)


def _expand_driver_name(driver: Any) -> Any:
    """Return the settings of a registered driver if its name is given; return anything else unchanged."""
    return DRIVERS.create(driver).settings if isinstance(driver, str) and driver in DRIVERS else driver


def _format_setting(value: Any) -> str:
    if isinstance(value, Mapping):
        return format_driver(value) if "driver" in value else "others"
    return "that of the scenario file" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _count_cluster_changes(
    old: StudyFile, new: StudyFile, pairs: Sequence[ScenarioPair]
) -> tuple[dict[str, tuple[ClusterChange, ...]], str]:
    """Count the pairs in each cluster of the old study; recordings of the new version are assigned to these clusters.

    Returns the changes by aspect (what scenarios are clustered by), and the aspect that says most about how scenarios
    end.
    """
    clusters = {}
    analyses = {
        by: analysis
        for by, analysis in read_analyses(old).items()
        if by not in old.meta.metrics or by in new.meta.metrics
    }
    for by, analysis in analyses.items():
        label_of = dict(zip(analysis.ids.tolist(), analysis.labels.tolist(), strict=True))
        ran = [pair for pair in pairs if pair.both_ran and pair.ids[0] in label_of]
        # Unchanged scenarios keep their cluster, also at its edge.
        changed = [pair for pair in ran if pair.run != "the same"]
        assigned = assign_to_clusters(old, analysis, new, [pair.ids[1] for pair in changed]).tolist()
        after = {pair.ids: label_of[pair.ids[0]] for pair in ran}
        after |= {pair.ids: cluster for pair, cluster in zip(changed, assigned, strict=True)}
        names = {profile.cluster: profile.label for profile in analysis.profiles} | {-1: "noise"}
        labels = {*after.values(), *(label_of[pair.ids[0]] for pair in ran)}
        clusters[by] = tuple(
            _build_cluster_change(
                cluster,
                "noise" if cluster < 0 else names.get(cluster, f"cluster {cluster}"),
                [pair for pair in ran if label_of[pair.ids[0]] == cluster],
                [pair for pair in ran if after[pair.ids] == cluster],
            )
            for cluster in sorted(labels, key=lambda number: (number < 0, number))
        )
    return clusters, find_headline_aspect(analyses) or ""


def _build_cluster_change(
    cluster: int, label: str, before: Sequence[ScenarioPair], after: Sequence[ScenarioPair]
) -> ClusterChange:
    """Count the outcomes in a cluster; its scenarios are `before` with the old version, `after` with the new one."""
    outcomes = [
        dict(sorted(Counter(pair.outcomes[side] for pair in members).items(), key=lambda item: (-item[1], item[0])))
        for side, members in enumerate((before, after))
    ]
    ids = [{pair.ids for pair in members} for members in (before, after)]
    return ClusterChange(
        cluster, label, len(before), len(after), outcomes[0], outcomes[1], tuple(sorted(ids[0] ^ ids[1]))
    )
