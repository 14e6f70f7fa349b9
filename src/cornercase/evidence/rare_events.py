"""Importance sampling of rare events: where to draw is learned first, and then frozen."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.evidence.gaussian_process import boundary_process, encoded, enough
from cornercase.evidence.mixture import Mixture
from cornercase.scenario import ParameterSpace

# Places of the unit interval between which the real line is finite.
_LEAST, _MOST = 1e-16, 1.0 - 1.2e-16
# The first scenarios are drawn by the law of the space; so many more rounds follow at least before the learning ends.
_PLAIN_SHARE, _ROUNDS, _FEWEST = 0.2, 12, 20
# Independent scenarios per coefficient of a mean that the next proposal is fitted to, and how many times as many
# events there have to be for the learning to end before its last scenario.
_PER_COEFFICIENT, _ENOUGH = 10, 10
# Deviations of the wide parts, which look for regions that nobody knows of, and their share of a round and at last.
_WIDE, _WIDE_SHARE, _WIDE_AT_LAST = (1.5, 2.5), 0.25, 0.15
# Shares of the frozen proposal that follow the law of the space and the proposals of earlier rounds.
_LAW_AT_LAST, _EARLIER_AT_LAST = 0.05, 0.2
_CANDIDATES: Final = 20_000
_INSIDE: Final = 20_000
_MOST_TRIES: Final = 10_000
_HARDLY_ANY: Final = "Hardly any scenario fulfils the constraints of the parameters; vary them within these."


class ImportanceSampling:
    """Draws scenarios among which a rare event is frequent, and says how much each of them counts.

    The unit cube is taken to a space in which the law of the parameters is standard normal. The first scenarios follow
    that law. Then, round by round, a mixture of t distributions is fitted to the scenarios that come nearest to the
    event, as many as it can be learned from, each with the weight that it has under the law; the next round is drawn
    from it and from wide normal distributions. When there are enough events the proposal is frozen, with shares of all
    earlier ones, of the wide ones and of the law itself. What is drawn then is independent, so that the mean of the
    weights of the events is an estimate of their probability without bias, whatever was learned before.

    It is a function of its arguments and of what it was told.

    Parameters
    ----------
    space : ParameterSpace
    events : int
        Number of events; a round is shared among them.
    learn : int
        Number of scenarios, at most, until the proposal is frozen.
    seed : int
    guess : Mixture, optional
        Where events are taken to be before anything was run, as of `guessed_proposal`.
    """

    def __init__(self, space: ParameterSpace, events: int, learn: int, seed: int, guess: Mixture | None = None) -> None:
        self._space, self._events, self._learn, self._seed = space, events, learn, seed
        self._plain = max(_FEWEST, round(_PLAIN_SHARE * learn))
        self._size = max(_FEWEST, (learn - self._plain) // _ROUNDS)
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._met = np.zeros((0, events), dtype=np.bool_)
        self._law = Mixture.around_zero(space.dimension)
        self._wide = [Mixture.around_zero(space.dimension, deviation) for deviation in _WIDE]
        self._earlier = [] if guess is None else [guess]
        self._proposal, self._drawn = self._law, list[tuple[int, Mixture]]()
        self._rounds, self._ready, self._asked, self._frozen = 0, 0, 0, False
        self._factor: tuple[float, float] | None = None

    @property
    def stage(self) -> str:
        """What the next round is for: ``"law"``, ``"learn"`` or ``"estimate"``."""
        return "law" if self._rounds == 0 else "estimate" if self._frozen else "learn"

    def ask(self, most: int) -> FloatArray:
        """Draw a round.

        Parameters
        ----------
        most : int
            Number of scenarios at most.

        Returns
        -------
        ndarray of float64, shape (n, d)
            In the unit cube, within the constraints.

        Raises
        ------
        InputError
            Hardly any scenario fulfils the constraints.
        """
        wanted = most if self._frozen else min(most, self._size if self._rounds else self._plain)
        rng = np.random.default_rng((self._seed, 0, self._rounds))
        found = np.zeros((0, self._space.dimension))
        for _ in range(_MOST_TRIES):
            points = ndtr(self._proposal.draw(wanted - len(found), rng))
            found = np.concatenate([found, points[self._space.admits(points)]])
            if len(found) == wanted:
                return found
        raise InputError(_HARDLY_ANY)

    def tell(self, points: FloatArray, scores: FloatArray, met: BoolArray) -> None:
        """Take what came out of a round.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            As they were asked for.
        scores : ndarray of float64, shape (n,)
            The lower, the nearer to the events; NaN for a scenario that failed.
        met : ndarray of bool, shape (n, events)
            Which events happened.
        """
        if not self._frozen:
            self._drawn.append((len(points), self._proposal))
            self._points = np.concatenate([self._points, _to_normal(points)])
            self._scores = np.concatenate([self._scores, scores])
            self._met = np.concatenate([self._met, met])
            self._learn_proposal()
        self._rounds += 1

    def weights(self, points: FloatArray) -> FloatArray:
        """How much scenarios count that were asked for since the proposal is frozen.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)

        Returns
        -------
        ndarray of float64, shape (n,)
            Density of the law over that of the proposal, both within the constraints; 1 in the mean.
        """
        normal = _to_normal(points)
        factor, _ = self._of_constraints()
        return np.asarray(factor * np.exp(self._law.log_density(normal) - self._proposal.log_density(normal)))

    @property
    def weights_error(self) -> float:
        """Relative standard error that all weights have together, as the share within constraints is estimated."""
        return self._of_constraints()[1]

    def _of_constraints(self) -> tuple[float, float]:
        """Share of the proposal over share of the law within the constraints, and its relative standard error."""
        if not self._space.declarations:
            return 1.0, 0.0
        if self._factor is None:
            rng = np.random.default_rng((self._seed, 1))
            inside = [
                float(self._space.admits(ndtr(one.draw(_INSIDE, rng))).mean()) for one in (self._proposal, self._law)
            ]
            if not all(inside):
                raise InputError(_HARDLY_ANY)
            error = np.sqrt(sum((1.0 - share) / share for share in inside) / _INSIDE)
            self._factor = inside[0] / inside[1], float(error)
        return self._factor

    def _learn_proposal(self) -> None:
        """Fit the next proposal to the scenarios nearest to each event."""
        count = len(self._points)
        drawn = [np.log(n / count) + one.log_density(self._points) for n, one in self._drawn]
        logarithms = self._law.log_density(self._points) - np.logaddexp.reduce(drawn, axis=0)
        weights = np.exp(logarithms - logarithms.max())
        rng = np.random.default_rng((self._seed, 2, self._rounds))
        fitted, ready = [], True
        for event in range(self._events):
            chosen, enough_events = self._nearest(event, weights)
            fitted.append((1.0 / self._events, Mixture.fitted(self._points[chosen], weights[chosen], rng)))
            ready &= enough_events
        new = Mixture.together(fitted)
        self._ready = self._ready + 1 if ready else 0
        # Two rounds in a row, so that the last fit has seen what a proposal at the event brings.
        if self._ready >= 2 or count + self._size > self._learn:
            earlier = [(_EARLIER_AT_LAST / len(self._earlier), one) for one in self._earlier]
            wide = [(_WIDE_AT_LAST / len(_WIDE), one) for one in self._wide]
            rest = 1.0 - _LAW_AT_LAST - sum(share for share, _ in (*earlier, *wide))
            self._proposal = Mixture.together([(rest, new), (_LAW_AT_LAST, self._law), *wide, *earlier])
            self._frozen = True
            return
        parts = [new, *self._earlier[:1]] if self._rounds == 0 else [new]
        wide = [(_WIDE_SHARE / len(_WIDE), one) for one in self._wide]
        self._proposal = Mixture.together([*(((1.0 - _WIDE_SHARE) / len(parts), one) for one in parts), *wide])
        self._earlier.append(new)

    def _nearest(self, event: int, weights: FloatArray) -> tuple[BoolArray, bool]:
        """Which scenarios are as near to an event as can be learned from, and whether there are enough events."""
        met = self._met[:, event]
        # Scores that are as bad as any say nothing of where the event is; failures rank behind all.
        known = np.isfinite(self._scores)
        says = known & (self._scores < self._scores[known].max(initial=-np.inf))
        order = np.lexsort((np.where(known, self._scores, np.inf), ~(says | met), ~met))
        ordered = weights[order]
        effective = np.cumsum(ordered) ** 2 / np.maximum(np.cumsum(ordered**2), 1e-300)
        needed = _PER_COEFFICIENT * (self._space.dimension + 2)
        hits = int(met.sum())
        count = max(int(np.searchsorted(np.maximum.accumulate(effective), needed)) + 1, hits)
        some = int((says | met).sum())
        chosen = np.zeros(len(weights), dtype=np.bool_)
        chosen[order[: min(count, some) if some else len(order)]] = True
        return chosen, hits >= count and bool(effective[hits - 1] >= _ENOUGH * needed)


def guessed_proposal(
    space: ParameterSpace, points: FloatArray, scores: FloatArray, threshold: float, seed: int
) -> Mixture | None:
    """Guess from a Gaussian process where critical scenarios are under the law of the space.

    Parameters
    ----------
    space : ParameterSpace
    points : ndarray of float64, shape (n, d)
        Scenarios that were run, in the unit cube.
    scores : ndarray of float64, shape (n,)
        Oriented; NaN for a scenario that failed.
    threshold : float
        Oriented score up to which a scenario is critical.
    seed : int

    Returns
    -------
    Mixture or None
        In the space in which the law is standard normal; None where too little is known.
    """
    try:
        known = enough(points, scores)
    except ValueError:
        return None
    rng = np.random.default_rng((seed, 3))
    law = Mixture.around_zero(space.dimension)
    wide = [(1.0, Mixture.around_zero(space.dimension, deviation)) for deviation in _WIDE]
    drawn = Mixture.together([(1.0, law), *wide])
    places = drawn.draw(_CANDIDATES, rng)
    process = boundary_process(encoded(space, known[0]), known[1], threshold)
    mean, deviation = process.predict(encoded(space, ndtr(places)))
    weights = np.exp(law.log_density(places) - drawn.log_density(places)) * ndtr(-mean / np.maximum(deviation, 1e-9))
    return Mixture.fitted(places, weights, rng) if weights.sum() > 0.0 else None


def _to_normal(points: FloatArray) -> FloatArray:
    """Points of the unit cube in the space in which the law of the parameters is standard normal."""
    return np.asarray(ndtri(np.clip(points, _LEAST, _MOST)))
