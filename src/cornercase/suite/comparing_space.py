"""How the critical part of a space changed between two studies, and what says so."""

from __future__ import annotations

import numpy as np

from cornercase._common.errors import InputError
from cornercase.evidence import CriticalSet, SetDifference, bounds_of_share
from cornercase.exploration import Objective, critical_set_of
from cornercase.study import Study
from cornercase.suite.comparing_pairs import Side
from cornercase.suite.comparing_results import Pair, SpaceChange
from cornercase.suite.comparing_tests import FEWEST

# Of what is drawn for both studies.
_SEED = 0


def find_space_change(old: Side, new: Side, pairs: tuple[Pair, ...]) -> SpaceChange | None:
    """Find how the critical part of the space changed.

    Parameters
    ----------
    old, new : Side
        Of the same space.
    pairs : tuple of Pair

    Returns
    -------
    SpaceChange or None
        None where nothing says what is critical, or one of the studies does not look at the space.

    Notes
    -----
    Scenarios that a search chose by scores lie where it expected something critical, so they say nothing of shares of
    the space. Pairs of the fillings of both searches, and of their audits, do, without any model: of n of them, those
    that are critical with one version only give the interval of Clopper and Pearson of that part of the space.
    """
    if not (old.critical and new.critical and old.searched and new.searched):
        return None
    blind = [one for one in pairs if one.critical is not None and old.fills[one.ids[0]] and new.fills[one.ids[1]]]
    critical = np.array([one.critical for one in blind], dtype=np.bool_).reshape(-1, 2)
    gained = lost = None
    doubt = f"only {len(blind)} scenarios were run with both and chosen by neither by its scores; {FEWEST} are needed"
    if len(blind) >= FEWEST:
        doubt = ""
        gained = bounds_of_share(int((critical[:, 1] & ~critical[:, 0]).sum()), len(blind))
        lost = bounds_of_share(int((critical[:, 0] & ~critical[:, 1]).sum()), len(blind))
    if len(pairs) == len(old.rows) == len(new.rows) and all(one.run == "the same" for one in pairs):
        sets, sets_doubt = None, "both studies hold the same scenarios, which ran the same"
    else:
        sets, sets_doubt = _sets(old.study, new.study)
    parameters = old.study.space.parameters
    names, units = tuple(one.name for one in parameters), tuple(one.unit for one in parameters)
    return SpaceChange(len(blind), gained, lost, doubt, sets, sets_doubt, names, units)


def _sets(old: Study, new: Study) -> tuple[SetDifference | None, str]:
    found = []
    for study in (old, new):
        try:
            one = _critical_set(study)
        except InputError:
            # That a study is damaged is no lack of scores.
            raise
        except ValueError:
            return None, f"{study.path.name} has fewer than 10 scores without audits, or all are the same"
        if one.missed_doubt is not None:
            return None, f"of {study.path.name}, {one.missed_doubt}"
        if not (one.met_both or one.exhausted):
            return None, f"all scenarios of {study.path.name} are critical, so nothing says where that ends"
        found.append(one)
    return SetDifference.between(*found), ""


def _critical_set(study: Study) -> CriticalSet:
    objective = Objective.of_study(study.meta)
    threshold = objective.flip(float(study.critical or 0.0))
    return critical_set_of(study, objective.oriented_of(study), threshold, seed=_SEED)
