"""Estimate how the critical part of the space changed between two studies."""

from __future__ import annotations

import numpy as np

from cornercase._common.clopper_pearson import clopper_pearson_interval
from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray
from cornercase.evidence import CriticalSetDifference, Estimate
from cornercase.evidence._proportions import proportion_interval
from cornercase.exploration._study_critical_set import estimate_critical_set
from cornercase.study import StudyFile
from cornercase.suite.compare._comparison import ScenarioPair, SpaceChange
from cornercase.suite.compare._match_scenarios import ComparedStudy
from cornercase.suite.compare._significance import MIN_SAMPLE_SIZE

# Seed for both studies.
_DRAW_SEED = 0


def estimate_space_change(
    old: ComparedStudy, new: ComparedStudy, pairs: tuple[ScenarioPair, ...]
) -> SpaceChange | None:
    """Estimate how the critical part of the space changed; None without a threshold or without an optimizer.

    An optimizer prefers critical scenarios, so the scenarios that it chose say nothing about fractions of the space.
    Only scenarios from initial designs, grids and audits (scenarios drawn at random as a check) are counted. Some pairs
    are critical with the new version only, some with the old version only. Both numbers of pairs give Clopper-Pearson
    intervals: of the fraction of the space that became critical, and of the fraction that is no longer critical. If
    there are fewer than 20 pairs, each study's critical share is estimated from its own scenarios, and the shares are
    compared. In addition, the critical sets are estimated from all scenarios of both studies.
    """
    if not (old.is_critical and new.is_critical and old.is_explored and new.is_explored):
        return None
    independent = [
        pair
        for pair in pairs
        if pair.is_critical is not None and old.fills_space[pair.ids[0]] and new.fills_space[pair.ids[1]]
    ]
    critical = np.array([pair.is_critical for pair in independent], dtype=np.bool_).reshape(-1, 2)
    gained = lost = shares = change = None
    counts = 0, 0
    reason = (
        f"only {len(independent)} scenarios ran with both and were chosen independently of"
        f" scores; {MIN_SAMPLE_SIZE} are needed"
    )
    if len(independent) >= MIN_SAMPLE_SIZE:
        reason = ""
        gained = proportion_interval(int((critical[:, 1] & ~critical[:, 0]).sum()), len(independent))
        lost = proportion_interval(int((critical[:, 0] & ~critical[:, 1]).sum()), len(independent))
        shares = _estimate_critical_shares(critical[:, 0], critical[:, 1])
        counts = len(independent), len(independent)
        change = _estimate_difference(
            (int((critical[:, 1] & ~critical[:, 0]).sum()), len(independent)),
            (int((critical[:, 0] & ~critical[:, 1]).sum()), len(independent)),
        )
    else:
        old_alone, new_alone = (
            np.array([side.is_critical[scenario] for scenario in side.space_filling_ids()], dtype=np.bool_)
            for side in (old, new)
        )
        if min(len(old_alone), len(new_alone)) >= MIN_SAMPLE_SIZE:
            shares, counts = _estimate_critical_shares(old_alone, new_alone), (len(old_alone), len(new_alone))
            change = _estimate_difference(
                (int(new_alone.sum()), len(new_alone)), (int(old_alone.sum()), len(old_alone))
            )
    if len(pairs) == len(old.rows) == len(new.rows) and all(pair.run == "the same" for pair in pairs):
        sets, sets_reason = None, "both studies hold the same scenarios with the same results"
    else:
        sets, sets_reason = _compare_critical_sets(old.study, new.study)
    parameters = old.study.space.parameters
    names, units = tuple(item.name for item in parameters), tuple(item.unit for item in parameters)
    return SpaceChange(len(independent), gained, lost, reason, sets, sets_reason, names, units, shares, change, counts)


def _estimate_critical_shares(old: BoolArray, new: BoolArray) -> tuple[Estimate, Estimate]:
    return proportion_interval(int(old.sum()), len(old)), proportion_interval(int(new.sum()), len(new))


def _estimate_difference(more: tuple[int, int], less: tuple[int, int]) -> Estimate:
    """Estimate the difference `more` minus `less` of two proportions, with an interval of at least 90 % confidence.

    Each proportion is given as the number of hits (such as critical scenarios) and the number of all scenarios. The
    interval combines the 95 % Clopper-Pearson intervals of both proportions (Bonferroni), so it also holds if the
    proportions are dependent.
    """
    (low, high), (other_low, other_high) = (clopper_pearson_interval(*proportion, 0.025) for proportion in (more, less))
    return Estimate(more[0] / more[1] - less[0] / less[1], low - other_high, high - other_low)


def _compare_critical_sets(old: StudyFile, new: StudyFile) -> tuple[CriticalSetDifference | None, str]:
    sets = []
    for study in (old, new):
        try:
            critical_set = estimate_critical_set(study, seed=_DRAW_SEED)
        except InputError:
            # A damaged study is not a lack of scores.
            raise
        except ValueError:
            return None, f"{study.path.name} has fewer than 10 scores besides audits, or all are equal"
        if critical_set.missed_interval_unavailable is not None:
            return None, f"of {study.path.name}, {critical_set.missed_interval_unavailable}"
        if not (critical_set.has_both_classes or critical_set.is_exhausted):
            return None, f"all scenarios of {study.path.name} are critical, so there is no boundary"
        sets.append(critical_set)
    return CriticalSetDifference.from_critical_sets(*sets), ""
