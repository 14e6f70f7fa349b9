"""Estimate how much of a space is critical, and how much of that an exploration may have missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import ndtri

from cornercase._common.rows import row_keys
from cornercase._common.threads import one_thread
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence.binomial import bounds_of_share, highest_share
from cornercase.evidence.committee import FOUND, Committee
from cornercase.evidence.correction import Correction
from cornercase.evidence.drawn_sets import DRAWS, DrawnSets
from cornercase.evidence.elsewhere import Elsewhere, with_foretold
from cornercase.evidence.estimate import Estimate
from cornercase.evidence.gaussian_process import boundary_process, encoded, enough
from cornercase.evidence.left_out import left_out
from cornercase.evidence.places import Places
from cornercase.evidence.products import lower_times
from cornercase.metrics import Feature
from cornercase.scenario import ParameterSpace

# Points for which critical sets are drawn jointly.
_JOINT: Final = 1500
# Added to the standard deviation of outcomes, so that some nearly certain points are sampled too.
_LEAST: Final = 0.02
# Scenarios chosen independently of scores, and critical ones among them, from which intervals are given. With fewer
# critical ones, intervals of what is missed were too narrow on the first half of benchmarks/calibration.py.
_FEWEST, _FEWEST_HITS = 20, 3
# Weight of one prediction in the likelihood; below 1 because errors of neighbouring predictions are correlated. In the
# whole set false positives and false negatives cancel, so the critical fraction is known better than its parts. Chosen
# on the first half of benchmarks/calibration.py.
_OF_WHOLE, _OF_PARTS = 1.0, 0.5
# Probability that a hidden region at a random place contains no scenario that was run.
_HIDES: Final = 0.05
# Probabilities are clipped to this and to one minus this.
_RAREST: Final = 1e-3

REGION: Final = 0.01
"""Default of the smallest fraction of the space that counts as a region."""


class CriticalSet:
    """Estimate of the set of all critical scenarios of a space, from those that were run.

    A Gaussian process of the scores (`fit_boundary_process`) predicts each scenario of the initial design, and each
    audit, from all others. The quality of these predictions calibrates the probability that a scenario is critical
    (`ProbitCalibration`). Critical sets are drawn with these probabilities, with the correlation of the process between
    points, and with the calibration drawn from its posterior.

    A critical scenario counts as found if it was run, or if the mean of the process there is beyond the threshold.
    Audits never affect what is found. With `features` a `Committee` predicts instead of the process, which is one of
    its members; found is then what it gives a probability of at least `PREDICTED_CRITICAL`. The process still provides
    the correlation.

    `points` (n, d) were run and have `scores` (n,), lower is more critical, NaN for a failed scenario. `initial_design`
    (n,) marks those chosen independently of scores, by default all. `audits` are random points and their scores, which
    the optimizer has not observed. `features` are the columns and their values (n, f). `source_model` gives one more
    coordinate of the process, which is dropped if it misleads; the calibration uses the scenarios at hand only.
    ValueError if there are fewer than 10 scores, or all are the same.

    Leave-one-out prediction: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006),
    equation 5.12.
    """

    def __init__(
        self,
        space: ParameterSpace,
        points: FloatArray,
        scores: FloatArray,
        threshold: float,
        seed: int = 0,
        *,
        filling: BoolArray | None = None,
        audits: tuple[FloatArray, FloatArray] | None = None,
        happened: tuple[Sequence[Feature], FloatArray] | None = None,
        elsewhere: Elsewhere | None = None,
    ) -> None:
        finished = np.isfinite(scores)
        self._filling = np.ones(int(finished.sum()), dtype=np.bool_) if filling is None else filling[finished]
        points, scores = enough(points, scores)
        self._space, self._seed = space, seed
        self._critical = scores <= threshold
        self._places = Places.of(space, seed)
        self._ran, self._elsewhere = encoded(space, points), elsewhere
        coordinates, has_prediction = with_foretold(elsewhere, self._ran), elsewhere is not None
        self._committee: Committee | None = None
        if happened is not None and 0 < self._critical.sum() < len(scores):
            columns, values = happened
            self._committee = Committee(threshold, columns, seed, foretold=has_prediction)
            self._committee.fit(coordinates, scores, values[finished])
            self._process = self._committee.process
        else:
            self._process = boundary_process(coordinates, scores, threshold, foretold=has_prediction)
        mean, self._t = self._foretold(self._places.encoded)
        self._outcome = dict(zip(row_keys(space.snap(points)), np.where(self._critical, np.inf, -np.inf), strict=True))
        self._certain = self._seen(self._places.points)
        self._is_found = _found(mean, self._certain)
        audit_points, audit_scores = audits if audits is not None else (points[:0], scores[:0])
        self._audits = audit_points[np.isfinite(audit_scores)]
        self._audited = audit_scores[np.isfinite(audit_scores)] <= threshold
        # One thread, so that sums do not depend on the number of threads.
        with one_thread():
            t, critical = self._record(coordinates, scores, threshold)
            edge = 0.0 if self._committee is None else float(_deviate(np.array(FOUND)))
            self._missed_none = not (critical & (t > edge)).any()
            self._corrections = Correction(t, critical, _OF_WHOLE), Correction(t, critical, _OF_PARTS)

    @property
    def by_committee(self) -> bool:
        """Whether a `Committee` predicts instead of the process: if there are features and both classes."""
        return self._committee is not None

    def _foretold(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `(margin, z)` at encoded points.

        `margin` is negative where the model predicts *critical*; `z` is the distance to the threshold in standard
        deviations.
        """
        at = with_foretold(self._elsewhere, at)
        if self._committee is not None:
            t = _deviate(self._committee.predict(at)[0])
            return t - _deviate(np.array(FOUND)), t
        mean, deviation = self._process.predict(at)
        return mean, mean / np.hypot(deviation, self._process.kernel.noise)

    def _record(self, points: FloatArray, scores: FloatArray, threshold: float) -> tuple[FloatArray, BoolArray]:
        """Out-of-sample `z` of the scenarios chosen independently of scores, and whether these were critical."""
        if self._committee is not None:
            t = _deviate(self._committee.out_of_fold())[self._filling]
        else:
            mean, deviation = left_out(self._process, points, scores, threshold, np.flatnonzero(self._filling))
            t = mean / deviation
        critical = self._critical[self._filling]
        if len(self._audits):
            t = np.concatenate([t, self._foretold(encoded(self._space, self._audits))[1]])
            critical = np.concatenate([critical, self._audited])
        return t, critical

    @cached_property
    def _some(self) -> tuple[IntArray, FloatArray]:
        """Points for which critical sets are drawn jointly, and the fraction of the space that each represents."""
        probability = np.where(self._certain == 0.0, self._corrections[1].probability(self._t), 0.0)
        return self._places.chosen(np.sqrt(probability * (1.0 - probability)) + _LEAST, _JOINT)

    def _normal(self, at: IntArray, key: int) -> FloatArray:
        """Draw standardized errors of the predictions at some points, (m, draws), correlated as the process.

        Another key gives independent draws.
        """
        factor, deviation = self._process.joint(with_foretold(self._elsewhere, self._places.encoded[at]))
        standard = np.random.default_rng([self._seed, key]).standard_normal((len(factor), DRAWS))
        normal = lower_times(factor, standard)
        normal /= deviation[:, None]
        return normal

    @cached_property
    def _drawn(self) -> tuple[DrawnSets, DrawnSets]:
        """Critical sets drawn with the calibration for the whole set, and with that for its parts."""
        with one_thread():
            normal = self._normal(self._some[0], 4)
        whole, parts = (
            DrawnSets(correction, self._seed, self._places.weights, self._t, self._certain, self._some, normal)
            for correction in self._corrections
        )
        return whole, parts

    @property
    def _whole(self) -> DrawnSets:
        return self._drawn[0]

    @property
    def _parts(self) -> DrawnSets:
        return self._drawn[1]

    def found(self, points: FloatArray) -> BoolArray:
        """Whether scenarios (n, d) are critical, as run or as predicted, (n,)."""
        if not len(points):
            return np.zeros(0, dtype=np.bool_)
        return _found(self._foretold(encoded(self._space, points))[0], self._seen(points))

    def _seen(self, points: FloatArray) -> FloatArray:
        """Outcome of scenarios, (n,): inf if run and critical, -inf if run and not critical, 0 if not run."""
        return np.array([self._outcome.get(key, 0.0) for key in row_keys(self._space.snap(points))])

    @cached_property
    def exhausted(self) -> bool:
        """Whether all scenarios of a finite space were run, so that the fraction is exact and nothing is missed."""
        return self._places.complete and bool((self._certain != 0.0).all())

    @property
    def met_both(self) -> bool:
        """Whether both critical and other scenarios were run."""
        return bool(self._critical.any() and not self._critical.all())

    @property
    def doubt(self) -> str | None:
        """Reason why `critical_fraction` and `missed_fraction` have no interval; None if they have one.

        Scenarios chosen by scores say nothing about how often predictions are wrong elsewhere.
        """
        count = int(self._filling.sum()) + len(self._audits)
        if count >= _FEWEST or self.exhausted:
            return None
        return f"only {count} scenarios were chosen without looking at scores; {_FEWEST} are needed, audits are such"

    @property
    def missed_doubt(self) -> str | None:
        """Reason why `missed_fraction` has no interval; None if it has one."""
        hits = int(self._critical[self._filling].sum() + self._audited.sum())
        if self.doubt is not None or hits >= _FEWEST_HITS or self.exhausted:
            return self.doubt
        return (
            f"only {hits} of the scenarios that were chosen without looking at scores are critical; {_FEWEST_HITS} are"
            " needed"
        )

    @cached_property
    def share(self) -> Estimate:
        """Critical fraction of the space; bounded by random scenarios only as long as all outcomes are the same."""
        if self.met_both:
            return Estimate.of_draws(self._whole.all)
        hits = int(self._critical[self._filling].sum() + self._audited.sum())
        bounds = bounds_of_share(hits, int(self._filling.sum()) + len(self._audited))
        # Bounds that hold whatever the scenarios are that were not run.
        critical, others = (
            float(self._places.weights[mask].sum()) for mask in (self._certain > 0.0, self._certain < 0.0)
        )
        low, high = max(bounds.low, min(critical, 1.0)), min(bounds.high, max(1.0 - others, 0.0))
        return Estimate(min(max(float(self._whole.all.mean()), low), high), low, high)

    @cached_property
    def missed(self) -> Estimate:
        """Fraction of the critical set that is not found; 1 while nothing critical was run, 0 if exhausted."""
        if not self._critical.any():
            return Estimate(*[float(not self.exhausted)] * 3)
        with one_thread():
            not_found = np.clip(self._parts.shares(~self._is_found), 0.0, self._parts.all)
        # Empty draws are ignored, since something is critical.
        nonempty = self._parts.all > 0.0
        estimate = Estimate(1.0, 0.0, 1.0)
        if nonempty.any():
            estimate = Estimate.of_draws(not_found[nonempty] / self._parts.all[nonempty])
        # As long as no prediction missed a critical scenario, it is possible that none is missed.
        return replace(estimate, low=0.0) if self._missed_none else estimate

    @cached_property
    def hidden(self) -> float:
        """Fraction of the critical set that an unexplored region may hold, in addition to `missed_fraction`.

        It is the fraction of a ball without any scenario that was run, as large as the largest that escapes with a
        probability of 5 %. It depends on the location of scenarios, not on the predicted scores.
        """
        ball = float(np.quantile(self._empty, 1.0 - _HIDES))
        return ball / max(ball + self.share.value, 1e-12)

    @cached_property
    def audited_share(self) -> Estimate:
        """Critical fraction of the space by the audits alone."""
        return bounds_of_share(int(self._audited.sum()), len(self._audited))

    @cached_property
    def _audits_missed(self) -> tuple[int, int]:
        critical = self._audits[self._audited]
        return int((~self.found(critical)).sum()), len(critical)

    @property
    def audited_missed(self) -> Estimate:
        """Fraction of the critical audits that are not found: what is missed, by the audits alone."""
        return bounds_of_share(*self._audits_missed)

    @property
    def audited_missed_at_most(self) -> float:
        """Upper bound of `audited_missed_fraction` that holds at all times, whenever runs are stopped."""
        return highest_share(*self._audits_missed)

    def share_in(self, other: CriticalSet) -> Estimate:
        """Fraction of this critical set that lies in `other`, which is of another score, with the same seed."""
        with one_thread():
            both = self._parts.shared(other._parts, other._normal(self._some[0], 5), np.arange(DRAWS))
        nonempty = self._parts.all > 0.0
        fractions = np.clip(both[nonempty] / self._parts.all[nonempty], 0.0, 1.0) if nonempty.any() else np.ones(1)
        return Estimate.of_draws(fractions)

    def against(self, other: CriticalSet) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw the fractions of the space that are critical here, in `other`, and in both, shape (draws,) each.

        `other` is from other scenarios of the same space, with the same seed. The draws of both are independent.
        """
        # The calibrations of both are drawn with the same random numbers; permuted, they are independent.
        order = np.random.default_rng([self._seed, 6]).permutation(DRAWS)
        fractions, other_fractions = self._whole.all, other._whole.all[order]
        with one_thread():
            both = self._whole.shared(other._whole, other._normal(self._some[0], 5), order)
        return fractions, other_fractions, np.clip(both, 0.0, np.minimum(fractions, other_fractions))

    def middle(self) -> FloatArray:
        """Draw the mean of each parameter over the critical set, (draws, d), in the parameters' units.

        NaN for a parameter with choices, and where a draw is empty.
        """
        values = self._space.values(self._places.points)
        means = np.full((DRAWS, self._space.dimension), np.nan)
        with one_thread():
            whole = self._parts.shares(np.ones(len(self._t)))
            for k, parameter in enumerate(self._space.parameters):
                if not parameter.choices:
                    x = np.array([parameter.read_number(value) for value in values])
                    with np.errstate(divide="ignore", invalid="ignore"):
                        mean = np.clip(self._parts.shares(x - x.min()) / whole + x.min(), x.min(), x.max())
                    means[:, k] = np.where(self._parts.all > 0.0, mean, np.nan)
        return means

    def overlooked(self, size: float = REGION) -> float:
        """Probability, by the process, that some critical region contains no scenario that was run.

        `size` is the smallest fraction of the space that counts as a region. As long as nothing critical was run, it is
        that of a region at a random place (`unexplored_fraction`).
        """
        if not self._critical.any():
            return self.unvisited(size)
        drawn = self._parts.drawn
        edges, regions = self._edges
        weights = np.concatenate([self._some[1], np.zeros(regions)])
        count = 0
        for is_critical in np.concatenate([drawn, np.ones((regions, DRAWS), dtype=np.bool_)]).T:
            label = _regions(edges[:, is_critical[edges[0]] & is_critical[edges[1]]], len(is_critical))
            sizes = np.bincount(label, weights=weights * is_critical, minlength=label.max() + 1)
            has_run = np.zeros(len(sizes), dtype=np.bool_)
            has_run[label[len(drawn) :]] = True
            count += bool(((sizes >= size) & ~has_run).any())
        return count / DRAWS

    def unvisited(self, size: float = REGION) -> float:
        """Fraction of the space around which a ball of volume `size` contains none of the scenarios that were run.

        It needs no assumption about the scores: a critical ball of this size at a random place contains such a scenario
        with a probability of one minus this fraction. Parts of the ball outside the space do not count.
        """
        return float((self._empty > size).mean())

    @cached_property
    def _empty(self) -> FloatArray:
        with one_thread():
            return self._places.empty(self._ran)

    @cached_property
    def _edges(self) -> tuple[IntArray, int]:
        """Pairs of neighbours, (2, E), among sampled points and critical regions, and the number of these.

        Critical scenarios that were run are connected in every draw, so each of their connected regions is a single
        node.
        """
        sample = self._places.encoded[self._some[0]]
        count = len(sample)
        edges = _neighbours(np.concatenate([sample, self._ran]))
        is_node = np.concatenate([np.ones(count, dtype=np.bool_), self._critical])
        edges = edges[:, is_node[edges[0]] & is_node[edges[1]]]
        was_run = edges >= count
        region = _regions(edges[:, was_run.all(axis=0)] - count, len(self._ran))
        node = np.concatenate([np.arange(count), count + region])
        edges = np.unique(np.sort(node[edges[:, ~was_run.all(axis=0)]], axis=0), axis=1)
        # Drop regions without a neighbour among the sampled points, and renumber the others.
        regions, index = np.unique(edges[edges >= count], return_inverse=True)
        edges[edges >= count] = count + index
        return edges, len(regions)


def _neighbours(nodes: FloatArray) -> IntArray:
    """Pairs of neighbouring points, (2, E), of points (n, e)."""
    if nodes.shape[1] == 1:
        # The two nearest points may lie on the same side, so connect each point with the next one instead.
        order = np.argsort(nodes[:, 0], kind="stable")
        return np.stack([order[:-1], order[1:]])
    nearest = cKDTree(nodes).query(nodes, k=min(2 * nodes.shape[1] + 1, len(nodes)))[1]
    near = np.asarray(nearest, dtype=np.int64)[:, 1:]
    return np.stack([np.repeat(np.arange(len(nodes)), near.shape[1]), near.ravel()])


def _regions(edges: IntArray, count: int) -> IntArray:
    """Label of the connected component of each of `count` nodes, (count,)."""
    graph = coo_array((np.ones(edges.shape[1]), (edges[0], edges[1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _deviate(probability: FloatArray) -> FloatArray:
    """Normal deviate of a probability of being critical, negative where critical is likely."""
    return np.asarray(-ndtri(np.clip(probability, _RAREST, 1.0 - _RAREST)))


def _found(mean: FloatArray, seen: FloatArray) -> BoolArray:
    return np.where(seen == 0.0, mean <= 0.0, seen > 0.0)
