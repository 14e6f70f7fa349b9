"""How much of a space is critical, and how much of that an exploration may have missed."""

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

# Places for which critical sets are drawn together.
_JOINT: Final = 1500
# Deviation of what is all but certain, so that some of those places are looked at too.
_LEAST: Final = 0.02
# Scenarios chosen without looking at scores, and critical ones among them, from which intervals are given. Where there
# were fewer critical ones, intervals of what is missed were too narrow on the first half of benchmarks/calibration.py.
_FEWEST, _FEWEST_HITS = 20, 3
# What one prediction counts: neighbours are wrong together. Over the whole set what is wrongly taken for critical makes
# up for what is not, so that the share is known better than its parts are. Chosen on the first half of
# benchmarks/calibration.py.
_OF_WHOLE, _OF_PARTS = 1.0, 0.5
# Probability with which a region of the size that is called hidden, at a random place, holds nothing that was run.
_HIDES: Final = 0.05
# The least probability that a committee is taken to mean, and the most one is as far from 1.
_RAREST: Final = 1e-3

REGION: Final = 0.01
"""Share of the space from which a region counts, unless somebody says otherwise."""


class CriticalSet:
    """Estimate of the set of all critical scenarios of a space, from those that were run.

    A Gaussian process of the scores (`boundary_process`) predicts each scenario that fills the space from all others,
    and each audit. How good these predictions are corrects the probability that a scenario is critical, as `Correction`
    says. Critical sets are drawn with these probabilities, with the correlation of the process between places, and with
    the correction drawn from its posterior.

    A critical scenario counts as found when it was run, or when the mean of the process there is beyond the
    threshold. Audits never say what is found.

    With features of the recordings a `Committee` predicts in place of the process, of which it has one as a member;
    found is then what it says is critical with a probability of `FOUND` or more. The process still says how places go
    together.

    Parameters
    ----------
    space : ParameterSpace
    points : ndarray of float64, shape (n, d)
        Scenarios that were run, in the unit cube.
    scores : ndarray of float64, shape (n,)
        Oriented: lower is more critical. NaN for a scenario that failed.
    threshold : float
        Oriented score up to which a scenario is critical.
    seed : int, default 0
    filling : ndarray of bool, shape (n,), optional
        Which of them fill the space, whatever the scores are; by default all.
    audits : tuple of (ndarray of float64, shape (m, d), ndarray of float64, shape (m,)), optional
        Points that were drawn from the space at random, and their oriented scores, which no search was told.
    happened : tuple of (sequence of Feature, ndarray of float64, shape (n, f)), optional
        Features, and what they are in the recordings of `points`; NaN for a scenario that failed.
    elsewhere : Elsewhere, optional
        What another study predicts. It is one more coordinate of the process, which leaves it out where it misleads;
        the correction is learned from the scenarios at hand alone.

    Raises
    ------
    ValueError
        There are fewer than 10 scores, or all are the same.

    Notes
    -----
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
        ended = np.isfinite(scores)
        self._filling = np.ones(int(ended.sum()), dtype=np.bool_) if filling is None else filling[ended]
        points, scores = enough(points, scores)
        self._space, self._seed = space, seed
        self._critical = scores <= threshold
        self._places = Places.of(space, seed)
        self._ran, self._elsewhere = encoded(space, points), elsewhere
        coordinates, foretold = with_foretold(elsewhere, self._ran), elsewhere is not None
        self._committee: Committee | None = None
        if happened is not None and 0 < self._critical.sum() < len(scores):
            columns, values = happened
            self._committee = Committee(threshold, columns, seed, foretold=foretold)
            self._committee.fit(coordinates, scores, values[ended])
            self._process = self._committee.process
        else:
            self._process = boundary_process(coordinates, scores, threshold, foretold=foretold)
        mean, self._t = self._foretold(self._places.encoded)
        self._outcome = dict(zip(row_keys(space.snap(points)), np.where(self._critical, np.inf, -np.inf), strict=True))
        self._certain = self._seen(self._places.points)
        self._is_found = _found(mean, self._certain)
        self._audits, audited = audits if audits is not None else (points[:0], scores[:0])
        self._audits, audited = self._audits[np.isfinite(audited)], audited[np.isfinite(audited)]
        self._audited = audited <= threshold
        # Sums in one order, whatever the number of threads.
        with one_thread():
            t, critical = self._record(coordinates, scores, threshold)
            edge = 0.0 if self._committee is None else float(_deviate(np.array(FOUND)))
            self._missed_none = not (critical & (t > edge)).any()
            self._corrections = Correction(t, critical, _OF_WHOLE), Correction(t, critical, _OF_PARTS)

    @property
    def by_committee(self) -> bool:
        """Whether a `Committee` predicts in place of the process: where there are features, and something to tell."""
        return self._committee is not None

    def _foretold(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is below 0 at encoded places that are found, and how many deviations it is from there."""
        at = with_foretold(self._elsewhere, at)
        if self._committee is not None:
            t = _deviate(self._committee.predict(at)[0])
            return t - _deviate(np.array(FOUND)), t
        mean, deviation = self._process.predict(at)
        return mean, mean / np.hypot(deviation, self._process.kernel.noise)

    def _record(self, points: FloatArray, scores: FloatArray, threshold: float) -> tuple[FloatArray, BoolArray]:
        """What was said of scenarios that the search did not choose by what it knew, and which were critical."""
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
        """Places for which critical sets are drawn together, and the share of the space that each stands for."""
        likely = np.where(self._certain == 0.0, self._corrections[1].probability(self._t), 0.0)
        return self._places.chosen(np.sqrt(likely * (1.0 - likely)) + _LEAST, _JOINT)

    def _normal(self, at: IntArray, key: int) -> FloatArray:
        """Draw by how many deviations scores differ from what is said on some places, shape (m, draws).

        Another key gives independent draws.
        """
        factor, deviation = self._process.joint(with_foretold(self._elsewhere, self._places.encoded[at]))
        standard = np.random.default_rng([self._seed, key]).standard_normal((len(factor), DRAWS))
        normal = lower_times(factor, standard)
        normal /= deviation[:, None]
        return normal

    @cached_property
    def _drawn(self) -> tuple[DrawnSets, DrawnSets]:
        """Critical sets as predictions of the whole set have them, and as those of its parts have them."""
        with one_thread():
            normal = self._normal(self._some[0], 4)
        whole, parts = (
            DrawnSets(one, self._seed, self._places.weights, self._t, self._certain, self._some, normal)
            for one in self._corrections
        )
        return whole, parts

    @property
    def _whole(self) -> DrawnSets:
        return self._drawn[0]

    @property
    def _parts(self) -> DrawnSets:
        return self._drawn[1]

    def found(self, points: FloatArray) -> BoolArray:
        """Predict which scenarios are critical.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        if not len(points):
            return np.zeros(0, dtype=np.bool_)
        return _found(self._foretold(encoded(self._space, points))[0], self._seen(points))

    def _seen(self, points: FloatArray) -> FloatArray:
        """Infinite for scenarios that were run and critical, minus infinite for others that were run, else 0; (n,)."""
        return np.array([self._outcome.get(key, 0.0) for key in row_keys(self._space.snap(points))])

    @cached_property
    def exhausted(self) -> bool:
        """Whether all scenarios of a finite space were run, so that `share` is exact and nothing is missed."""
        return self._places.complete and bool((self._certain != 0.0).all())

    @property
    def met_both(self) -> bool:
        """Whether critical scenarios were run, and others."""
        return bool(self._critical.any() and not self._critical.all())

    @property
    def doubt(self) -> str | None:
        """Why no interval can be given of `share` and `missed`; None where one can.

        What a search chose by scores tells nothing of how often it is wrong elsewhere.
        """
        drawn = int(self._filling.sum()) + len(self._audits)
        if drawn >= _FEWEST or self.exhausted:
            return None
        return f"only {drawn} scenarios were chosen without looking at scores; {_FEWEST} are needed, audits are such"

    @property
    def missed_doubt(self) -> str | None:
        """Why no interval can be given of `missed`; None where one can."""
        hits = int(self._critical[self._filling].sum() + self._audited.sum())
        if self.doubt is not None or hits >= _FEWEST_HITS or self.exhausted:
            return self.doubt
        return (
            f"only {hits} of the scenarios that were chosen without looking at scores are critical; {_FEWEST_HITS} are"
            " needed"
        )

    @cached_property
    def share(self) -> Estimate:
        """Critical share of the space; while all that was met is alike, as bounded by what was run at random."""
        if self.met_both:
            return Estimate.of_draws(self._whole.all)
        hits = int(self._critical[self._filling].sum() + self._audited.sum())
        known = bounds_of_share(hits, int(self._filling.sum()) + len(self._audited))
        # Whatever the scenarios are that were not run.
        least, others = (float(self._places.weights[at].sum()) for at in (self._certain > 0.0, self._certain < 0.0))
        low, high = max(known.low, min(least, 1.0)), min(known.high, max(1.0 - others, 0.0))
        return Estimate(min(max(float(self._whole.all.mean()), low), high), low, high)

    @cached_property
    def missed(self) -> Estimate:
        """Share of the critical set that is not found; all of it while nothing critical was run of what there is."""
        if not self._critical.any():
            return Estimate(*[float(not self.exhausted)] * 3)
        with one_thread():
            unseen = np.clip(self._parts.shares(~self._is_found), 0.0, self._parts.all)
        there = self._parts.all > 0.0
        # A draw of which nothing is critical says nothing, as something is.
        found = Estimate.of_draws(unseen[there] / self._parts.all[there]) if there.any() else Estimate(1.0, 0.0, 1.0)
        # Where no prediction missed a critical scenario yet, nothing excludes that none is missed.
        return replace(found, low=0.0) if self._missed_none else found

    @cached_property
    def hidden(self) -> float:
        """Share of the critical set that may be a region of which nothing is known, beside what `missed` says.

        It is the part that a ball would have which nothing was run in, as large as the largest that escapes with a
        probability of 5 %. It depends on where scenarios were run, not on what the process says of the scores.
        """
        ball = float(np.quantile(self._empty, 1.0 - _HIDES))
        return ball / max(ball + self.share.value, 1e-12)

    @cached_property
    def audited_share(self) -> Estimate:
        """Critical share of the space by the audits alone."""
        return bounds_of_share(int(self._audited.sum()), len(self._audited))

    @cached_property
    def _audits_missed(self) -> tuple[int, int]:
        critical = self._audits[self._audited]
        return int((~self.found(critical)).sum()), len(critical)

    @property
    def audited_missed(self) -> Estimate:
        """Share of the critical set that is not found by the audits alone: of those that are critical."""
        return bounds_of_share(*self._audits_missed)

    @property
    def audited_missed_at_most(self) -> float:
        """Bound of `audited_missed` from above that holds however often one looks before one stops."""
        return highest_share(*self._audits_missed)

    def share_in(self, other: CriticalSet) -> Estimate:
        """Share of the critical set that lies in another set of the same space.

        Parameters
        ----------
        other : CriticalSet
            From another score of scenarios of the same space, with the same seed; drawn independently.

        Returns
        -------
        Estimate
        """
        with one_thread():
            both = self._parts.shared(other._parts, other._normal(self._some[0], 5), np.arange(DRAWS))
        there = self._parts.all > 0.0
        return Estimate.of_draws(np.clip(both[there] / self._parts.all[there], 0.0, 1.0) if there.any() else np.ones(1))

    def against(self, other: CriticalSet) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw the shares of the space that are critical here, there, and in both.

        Parameters
        ----------
        other : CriticalSet
            From other scenarios of the same space, with the same seed; drawn independently.

        Returns
        -------
        here, there, both : ndarray of float64, shape (draws,)
            Each draw of the one goes with one of the other.
        """
        # The corrections of both are drawn with the same numbers: in another order they are independent.
        order = np.random.default_rng([self._seed, 6]).permutation(DRAWS)
        here, there = self._whole.all, other._whole.all[order]
        with one_thread():
            both = self._whole.shared(other._whole, other._normal(self._some[0], 5), order)
        return here, there, np.clip(both, 0.0, np.minimum(here, there))

    def middle(self) -> FloatArray:
        """Draw the middle of the critical set: the mean of each parameter over all that is critical.

        Returns
        -------
        ndarray of float64, shape (draws, d)
            In the parameters' units; NaN of a parameter with choices, and where nothing is critical.
        """
        values = self._space.values(self._places.points)
        found = np.full((DRAWS, self._space.dimension), np.nan)
        with one_thread():
            whole = self._parts.shares(np.ones(len(self._t)))
            for k, one in enumerate(self._space.parameters):
                if not one.choices:
                    at = np.array([one.read_number(value) for value in values])
                    with np.errstate(divide="ignore", invalid="ignore"):
                        middle = np.clip(self._parts.shares(at - at.min()) / whole + at.min(), at.min(), at.max())
                    found[:, k] = np.where(self._parts.all > 0.0, middle, np.nan)
        return found

    def overlooked(self, size: float = REGION) -> float:
        """Probability, by the process, that no scenario was run in some critical region.

        Before anything critical was met it is that of a region at a random place, as `unvisited` says.

        Parameters
        ----------
        size : float, default 0.01
            Share of the space from which a region counts.

        Returns
        -------
        float
        """
        if not self._critical.any():
            return self.unvisited(size)
        drawn = self._parts.drawn
        edges, regions = self._edges
        weights = np.concatenate([self._some[1], np.zeros(regions)])
        overlooked = 0
        for one in np.concatenate([drawn, np.ones((regions, DRAWS), dtype=np.bool_)]).T:
            kept = edges[:, one[edges[0]] & one[edges[1]]]
            label = _regions(kept, len(one))
            sizes = np.bincount(label, weights=weights * one, minlength=label.max() + 1)
            hit = np.zeros(len(sizes), dtype=np.bool_)
            hit[label[len(drawn) :]] = True
            overlooked += bool(((sizes >= size) & ~hit).any())
        return overlooked / DRAWS

    def unvisited(self, size: float = REGION) -> float:
        """Share of the space around which a ball of a given size holds none of the scenarios that were run.

        It needs no assumption about the scores: a critical ball of this size around a random place is met with a
        probability of one minus this share.

        Parameters
        ----------
        size : float, default 0.01
            Share of the space that the ball takes; what would lie outside the space does not count.

        Returns
        -------
        float
        """
        return float((self._empty > size).mean())

    @cached_property
    def _empty(self) -> FloatArray:
        with one_thread():
            return self._places.empty(self._ran)

    @cached_property
    def _edges(self) -> tuple[IntArray, int]:
        """Pairs of neighbours, shape (2, E), among the places and the regions that were met, and how many of these.

        Critical scenarios that were run are neighbours of each other in each draw: what they connect is one node, of
        which there are few where there are many scenarios.
        """
        places = self._places.encoded[self._some[0]]
        nodes = np.concatenate([places, self._ran])
        edges = _neighbours(nodes)
        there = np.concatenate([np.ones(len(places), dtype=np.bool_), self._critical])
        edges = edges[:, there[edges[0]] & there[edges[1]]]
        ran = edges >= len(places)
        region = _regions(edges[:, ran.all(axis=0)] - len(places), len(self._ran))
        node = np.concatenate([np.arange(len(places)), len(places) + region])
        edges = np.unique(np.sort(node[edges[:, ~ran.all(axis=0)]], axis=0), axis=1)
        # Those that no place is near to say nothing.
        met, at = np.unique(edges[edges >= len(places)], return_inverse=True)
        edges[edges >= len(places)] = len(places) + at
        return edges, len(met)


def _neighbours(nodes: FloatArray) -> IntArray:
    """Pairs of places, shape (n, e), that lie next to each other, shape (2, E)."""
    if nodes.shape[1] == 1:
        # Both nearest places may lie on the same side, and a region would seem to end there.
        order = np.argsort(nodes[:, 0], kind="stable")
        return np.stack([order[:-1], order[1:]])
    found = cKDTree(nodes).query(nodes, k=min(2 * nodes.shape[1] + 1, len(nodes)))[1]
    near = np.asarray(found, dtype=np.int64)[:, 1:]
    return np.stack([np.repeat(np.arange(len(nodes)), near.shape[1]), near.ravel()])


def _regions(edges: IntArray, count: int) -> IntArray:
    """Number the connected parts of so many nodes; of each node that of its part, shape (count,)."""
    graph = coo_array((np.ones(edges.shape[1]), (edges[0], edges[1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _deviate(probability: FloatArray) -> FloatArray:
    """Normal deviate above which a scenario of that probability is not critical, negative where it likely is."""
    return np.asarray(-ndtri(np.clip(probability, _RAREST, 1.0 - _RAREST)))


def _found(mean: FloatArray, seen: FloatArray) -> BoolArray:
    return np.where(seen == 0.0, mean <= 0.0, seen > 0.0)
