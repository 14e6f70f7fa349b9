"""Estimate how the critical part of the space changed between two studies."""

from __future__ import annotations

import numpy as np

from cornercase._common.errors import InputError
from cornercase.evidence import CriticalSet, SetDifference, bounds_of_share
from cornercase.exploration import Objective, critical_set_of
from cornercase.study import Study
from cornercase.suite.comparing_pairs import Side
from cornercase.suite.comparing_results import Pair, SpaceChange
from cornercase.suite.comparing_tests import FEWEST

# Seed for both studies.
_SEED = 0


def find_space_change(old: Side, new: Side, pairs: tuple[Pair, ...]) -> SpaceChange | None:
    """Estimate how the critical part of the space changed; None without a threshold or if a study was not explored.

    Scenarios that an optimizer chose by scores lie where it expected critical ones, so they say nothing about fractions
    of the space. Pairs of both initial designs and audits do, without any model: the number of those that are critical
    with one version only gives the Clopper-Pearson interval of that part of the space.
    """
    if not (old.critical and new.critical and old.searched and new.searched):
        return None
    independent = [
        pair for pair in pairs if pair.critical is not None and old.fills[pair.ids[0]] and new.fills[pair.ids[1]]
    ]
    critical = np.array([pair.critical for pair in independent], dtype=np.bool_).reshape(-1, 2)
    gained = lost = None
    reason = (
        f"only {len(independent)} scenarios ran with both and were chosen independently of scores; {FEWEST} are needed"
    )
    if len(independent) >= FEWEST:
        reason = ""
        gained = bounds_of_share(int((critical[:, 1] & ~critical[:, 0]).sum()), len(independent))
        lost = bounds_of_share(int((critical[:, 0] & ~critical[:, 1]).sum()), len(independent))
    if len(pairs) == len(old.rows) == len(new.rows) and all(pair.run == "the same" for pair in pairs):
        sets, sets_reason = None, "both studies hold the same scenarios with the same results"
    else:
        sets, sets_reason = _sets(old.study, new.study)
    parameters = old.study.space.parameters
    names, units = tuple(pair.name for pair in parameters), tuple(pair.unit for pair in parameters)
    return SpaceChange(len(independent), gained, lost, reason, sets, sets_reason, names, units)


def _sets(old: Study, new: Study) -> tuple[SetDifference | None, str]:
    sets = []
    for study in (old, new):
        try:
            critical_set = _critical_set(study)
        except InputError:
            # A damaged study is not a lack of scores.
            raise
        except ValueError:
            return None, f"{study.path.name} has fewer than 10 scores besides audits, or all are equal"
        if critical_set.missed_doubt is not None:
            return None, f"of {study.path.name}, {critical_set.missed_doubt}"
        if not (critical_set.met_both or critical_set.exhausted):
            return None, f"all scenarios of {study.path.name} are critical, so there is no boundary"
        sets.append(critical_set)
    return SetDifference.between(*sets), ""


def _critical_set(study: Study) -> CriticalSet:
    objective = Objective.of_study(study.meta)
    threshold = objective.flip(float(study.critical or 0.0))
    return critical_set_of(study, objective.oriented_of(study), threshold, seed=_SEED)
