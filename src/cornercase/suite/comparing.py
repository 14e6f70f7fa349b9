"""What changed between two versions of what is tested."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.arguments import texts
from cornercase._common.errors import InputError
from cornercase.clustering import join_kinds, read_analyses
from cornercase.drivers import DRIVERS, driver_command, driver_text
from cornercase.metrics import METRICS
from cornercase.simulators import SIMULATORS
from cornercase.study import Study, StudyMeta, open_study
from cornercase.suite.comparing_pairs import Side, deciding_metrics, read_pairs, require_comparable, sample_of
from cornercase.suite.comparing_results import LEVEL, ChangeTest, Comparison, KindChange, Pair, ScoreChange
from cornercase.suite.comparing_space import find_space_change
from cornercase.suite.comparing_telling import choose_telling
from cornercase.suite.comparing_tests import FEWEST, correct, moved_by, tests_of_pairs, tests_of_samples
from cornercase.suite.comparing_verdict import find_tolerances, find_verdict, judge_version
from cornercase.suite.verdicts import verdicts_of

_DRIVER: Final = "drivers "
# What is named where it differs; seed and search say which scenarios were run, not what with.
_NAMED: Final = {"simulator": "simulator", "version": "version of cornercase", "runs_of_each": "runs of each scenario"}


def compare(
    old: Study | Path | str,
    new: Study | Path | str,
    *,
    metrics: str | Sequence[str] | None = None,
    critical: float | None = None,
    tolerances: Mapping[str, float] | None = None,
) -> Comparison:
    """Tell what changed between two versions of what is tested, and whether the new one is better or worse.

    Each version was run into a study.

    Scenarios with the same parameters are compared one by one; where both studies were explored, their critical sets
    too. What a search chose by scores never grades them, unless the simulators repeat themselves to the last bit: then
    any two recordings that differ show a change.

    Parameters
    ----------
    old, new : Study or path
        Of the same scenario, parameter space and entities; other drivers, simulators, versions and time steps are what
        is compared.
    metrics : str or sequence of str, optional
        Metrics to compare by; by default all, which have to be the same in both.
    critical : float, optional
        Threshold for both studies, which keep their own; by default these, which have to be the same.
    tolerances : mapping of str to float, optional
        By metric, in its unit: by how much a score may move and still count as the same. By default 0.1 for s, m, m/s,
        m/s² and s², 0.01 for rad and for metrics without unit, and 0 for other units.

    Returns
    -------
    Comparison
        `verdict` says whether the new version is better, worse, mixed or the same, or that nothing can be said. As a
        bool it is true if the versions differ at all. Where simulators do not repeat themselves, either is wrong in at
        most 5 % of all comparisons of a version with itself, over all tests together.

    Raises
    ------
    InputError
        The studies are of other scenarios, parameters, entities, metrics or thresholds; or they have nothing in common:
        no scenario, and fewer than 20 each that were chosen whatever the scores are; or one is of a suite that has not
        been run to its end; or a tolerance is negative, or of a metric that is not compared.
    """
    with (
        open_study(old, readonly=True, critical=critical) as before,
        open_study(new, readonly=True, critical=critical) as after,
    ):
        chosen = require_comparable(before, after, None if metrics is None else texts("metrics", metrics))
        for study in (before, after):
            _require_finished(study)
        both = set(before.meta.requirements) & set(after.meta.requirements)
        needed = tuple(dict.fromkeys((*chosen, *(deciding_metrics(before) if deciding_metrics(after) else ()))))
        allowed = find_tolerances(needed, sorted(both), tolerances)
        sides = [Side.of(study, needed, verdicts_of(study)) for study in (before, after)]
        pairs = read_pairs(sides[0], sides[1], chosen)
        certain = all(_repeats_itself(study.meta) for study in (before, after))
        tests = _tests(sides[0], sides[1], pairs, chosen, certain)
        changed, reason = _judged(pairs, tests, certain)
        worse, better, within = find_verdict(pairs, tests, allowed, certain)
        verdict, verdict_reason = judge_version((worse, better), pairs, tests, (changed, reason), certain)
        return Comparison(
            names=(before.path.name, after.path.name),
            title=before.meta.title,
            differences=(*_differences(before.meta, after.meta), *_differing_runs(before, after)),
            changed=changed,
            reason=reason,
            verdict=verdict,
            verdict_reason=verdict_reason,
            worse=worse,
            better=better,
            within=within,
            tolerances=allowed,
            certain=certain,
            pairs=pairs,
            alone=(len(sides[0].rows) - len(pairs), len(sides[1].rows) - len(pairs)),
            scores=tuple(_score_change(pairs, name) for name in chosen if any(one.ran for one in pairs)),
            tests=tests,
            outcomes=Counter(one.outcomes for one in pairs if one.ran),
            verdicts=Counter(
                (a.requirement, a.state, b.state) for one in pairs for a, b in zip(*one.verdicts, strict=True)
            ),
            kinds=_kinds(before, after, pairs),
            space=find_space_change(sides[0], sides[1], pairs),
            telling=choose_telling(pairs, chosen, _searched(before.meta, chosen)),
            critical=critical,
        )


def _require_finished(study: Study) -> None:
    """Refuse the run of a suite that was interrupted, as few scenarios without a change would look like all."""
    waiting = sum(row.state == "pending" for row in study.rows())
    if study.meta.suite and waiting:
        raise InputError(
            f"{study.path}: {waiting} of its {study.meta.budget} scenarios have not been run yet; run `test` again,"
            " which goes on with it."
        )


def _searched(meta: StudyMeta, metrics: Sequence[str]) -> str:
    """The metric whose score says what is critical; empty for a weighted sum, a front, and one that is left out."""
    return "" if meta.weights or meta.pareto or meta.metrics[0] not in metrics else meta.metrics[0]


def _repeats_itself(meta: StudyMeta) -> bool:
    """Whether the runs of a study repeat themselves, as it was tried; cornercase's own parts do as they declare."""
    declared: bool | None = None
    own = False
    with suppress(InputError):
        simulator = SIMULATORS.class_of(meta.simulator)
        declared = simulator.repeats_itself
        own = simulator.__module__.startswith("cornercase.") and not any(map(_is_own, meta.drivers.values()))
    tried = meta.repeatability.get("same")
    return declared is not False and bool(tried) if tried is not None else own and declared is True


def _tests(
    old: Side, new: Side, pairs: Sequence[Pair], metrics: Sequence[str], certain: bool
) -> tuple[ChangeTest, ...]:
    """Test the pairs, or both fillings if these are too few: scenarios that were not chosen by their scores."""
    paired = [one for one in pairs if certain or one.unselected]
    found = tests_of_pairs(paired, metrics) if any(one.run != "in neither" for one in paired) else []
    filling = len(old.filling()), len(new.filling())
    # Where the fillings are mostly the same scenarios, pairs say more.
    if sum(one.unselected for one in pairs) < FEWEST <= min(filling):
        (scores, facts), (others, other_facts) = sample_of(old, metrics), sample_of(new, metrics)
        both = {name: each for name, each in facts.items() if name in other_facts}
        found += tests_of_samples((scores, others), (both, other_facts))
    if not found and all(one.run == "in neither" for one in pairs):
        raise InputError(
            f"{old.study.path} and {new.study.path}: no scenario was run with both, and only {filling[0]} and"
            f" {filling[1]} scenarios were chosen without looking at scores, where {FEWEST} are needed; explore"
            " both with the same `seed`, or with `audit`."
        )
    return correct(found)


def _judged(pairs: Sequence[Pair], tests: Sequence[ChangeTest], certain: bool) -> tuple[bool, str]:
    """Whether the versions differ, and why that is said."""
    runs = Counter(one.run for one in pairs)
    ran = sum(one.ran for one in pairs)
    significant = [one for one in tests if one.corrected <= LEVEL]
    if otherwise := certain and runs["otherwise"]:
        return (
            True,
            f"{otherwise} of {ran} scenarios that both ran went otherwise, and both simulators repeat themselves",
        )
    if certain and runs["not in one"]:
        return True, f"{runs['not in one']} of {len(pairs)} scenarios could be run with one version only"
    if significant:
        first = min(significant, key=lambda one: one.corrected)
        more = f" and {len(significant) - 1} more" if len(significant) > 1 else ""
        return True, (
            f"{first.about} differs ({first.method}, p = {first.corrected:.2g} corrected for {len(tests)} tests){more}"
        )
    if ran and runs["the same"] == len(pairs) - runs["in neither"]:
        return False, f"all {ran} scenarios that both ran are the same bytes"
    if certain and ran:
        return False, f"the {ran} scenarios that both ran are the same up to rounding"
    if not tests:
        return False, "none of the scenarios that both ran can be tested: a search chose them by their scores"
    return False, f"none of {len(tests)} tests shows a change, at {LEVEL:.0%} over all of them"


def _score_change(pairs: Sequence[Pair], name: str) -> ScoreChange:
    metric = METRICS.create(name)
    ran = [one for one in pairs if one.ran]
    scores = np.array([one.scores[name] for one in ran])
    changes = moved_by(scores[:, 0], scores[:, 1])
    moved = changes[changes != 0.0]
    worse = int((np.asarray(metric.oriented(moved)) < 0.0).sum())
    k = int(np.abs(changes).argmax())
    return ScoreChange(
        metric=name,
        unit=metric.unit,
        pairs=len(ran),
        moved=len(moved),
        worse=worse,
        better=len(moved) - worse,
        median=float(np.median(moved)) if len(moved) else 0.0,
        largest=float(changes[k]),
        ids=ran[k].ids if len(moved) else None,
    )


def _differences(old: StudyMeta, new: StudyMeta) -> Iterator[str]:
    """What the studies were made with, where that differs, in words."""
    if bool(old.suite) != bool(new.suite):
        yield f"scenarios: {' → '.join('of a suite' if one.suite else 'explored' for one in (old, new))}"
    for name, words in _NAMED.items():
        if getattr(old, name) != getattr(new, name):
            yield f"{words}: {getattr(old, name)} → {getattr(new, name)}"
    yield from _unlike("", old.settings, new.settings)


def _differing_runs(*studies: Study) -> Iterator[str]:
    """Which of the studies do not repeat themselves, in words."""
    for study in studies:
        if study.meta.runs_differ:
            yield f"runs of {study.path.name} differ: {study.meta.runs_differ}"


def _unlike(name: str, old: Any, new: Any) -> Iterator[str]:
    if old == new:
        return
    if name.startswith(_DRIVER) and (_is_own(old) or _is_own(new)):
        texts = driver_text(old), driver_text(new)
        if texts[0] != texts[1]:
            yield f"driver {name.removeprefix(_DRIVER)}: {texts[0]} → {texts[1]}"
            return
    if isinstance(old, str) != isinstance(new, str):
        old, new = _spelt(old), _spelt(new)
    if isinstance(old, Mapping) and isinstance(new, Mapping) and old.get("driver") == new.get("driver"):
        for key in [*old, *(one for one in new if one not in old)]:
            yield from _unlike(f"{name} {key}".lstrip(), old.get(key), new.get(key))
    else:
        yield f"{name.replace('_', ' ')}: {_plain(old)} → {_plain(new)}"


def _is_own(driver: Any) -> bool:
    """Whether a driver is none of those that stand in a study by their name or parameters."""
    if not isinstance(driver, Mapping):
        return False
    return driver_command(driver) is None or not {"options", "sha256", "settings"}.isdisjoint(driver)


def _spelt(driver: Any) -> Any:
    """Parameters of a driver that stands there by its name."""
    return DRIVERS.create(driver).settings if isinstance(driver, str) and driver in DRIVERS else driver


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return str(value.get("driver", "others"))
    return "as the file says" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _kinds(old: Study, new: Study, pairs: Sequence[Pair]) -> dict[str, tuple[KindChange, ...]]:
    """Kinds of the old study that pairs belong to with each version; the new scenarios join them."""
    found = {}
    for by, analysis in read_analyses(old).items():
        if by in old.meta.metrics and by not in new.meta.metrics:
            continue
        label = dict(zip(analysis.ids.tolist(), analysis.labels.tolist(), strict=True))
        both = [one for one in pairs if one.ran and one.ids[0] in label]
        # What ran the same stays where it is, also at the edge of a kind.
        others = [one for one in both if one.run != "the same"]
        joined = join_kinds(old, analysis, new, [one.ids[1] for one in others]).tolist()
        after = {one.ids: label[one.ids[0]] for one in both}
        after |= {one.ids: kind for one, kind in zip(others, joined, strict=True)}
        names = {one.cluster: one.label for one in analysis.profiles} | {-1: "noise"}
        counts = Counter(label[one.ids[0]] for one in both), Counter(after.values())
        found[by] = tuple(
            KindChange(
                kind, "noise" if kind < 0 else names.get(kind, f"cluster {kind}"), counts[0][kind], counts[1][kind]
            )
            for kind in sorted({*counts[0], *counts[1]}, key=lambda one: (one < 0, one))
        )
    return found
