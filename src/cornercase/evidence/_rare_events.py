"""Importance sampling of rare events; the proposal distribution is learned first and then frozen."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.evidence._mixture import TMixture
from cornercase.evidence.gp._gaussian_process import encode_points, fit_boundary_process, require_enough_scores
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

# Limits of the unit interval whose normal quantiles are finite.
_MIN_QUANTILE, _MAX_QUANTILE = 1e-16, 1.0 - 1.2e-16
# Fraction of the learning scenarios in the first round, number of later rounds, and least size of a round.
_FIRST_ROUND_FRACTION, _ROUNDS, _MIN_ROUND_SIZE = 0.2, 12, 20
# A proposal is fitted to this effective number of scenarios per coefficient of a component's mean. Learning ends early
# once the effective number of events is this multiple of the number of scenarios needed for a fit.
_PER_COEFFICIENT, _EVENTS_FACTOR = 10, 10
# Standard deviations of the wide components, which search unknown regions; their fraction of a round, and at the end.
_WIDE_DEVIATIONS, _WIDE_FRACTION, _FINAL_WIDE_FRACTION = (1.5, 2.5), 0.25, 0.15
# Fractions of the frozen proposal for the parameters' distribution and for the proposals of earlier rounds.
_FINAL_PLAIN_FRACTION, _FINAL_EARLIER_FRACTION = 0.05, 0.2
# Least number of dimensions for a component around the point where a linear model of the scores meets the event. This
# component's fraction of a round, and at the end; and the number of scenarios that give the distance of the point.
_MANY_DIMENSIONS = 8
_LINEAR_FRACTION, _FINAL_LINEAR_FRACTION, _DISTANCE_SCENARIOS = 0.25, 0.1, 10
_MAX_VALUES_WITHOUT_DIRECTION: Final = 2
# Least number of rounds after the first before scores are judged by the events that they lead to. While no event has
# occurred, they are judged from a number of learning scenarios on: with fewer, a search that is nearly at the event
# looks the same. They mislead if the later half of the scenarios makes less than a fraction of the progress.
_MIN_ROUNDS_WITH_EVENT, _MIN_SCENARIOS_WITHOUT_EVENT, _MIN_PROGRESS = 4, 800, 0.05
_CANDIDATES: Final = 20_000
_N_CONSTRAINT_DRAWS: Final = 20_000
_MAX_TRIES: Final = 10_000
_HARDLY_ANY: Final = (
    "Hardly any scenario fulfils the constraints of the parameters; choose ranges that lie within the constraints."
)


class ImportanceSampling:
    """Importance sampling: draws scenarios among which rare events are frequent, and weights them accordingly.

    The unit cube is mapped to a space in which the parameters are standard normal. The first scenarios follow this
    normal distribution. Then, round by round, a mixture of t distributions is fitted to the weighted scenarios nearest
    to the event. The next round is drawn from the mixture and from wide normal distributions. With 8 dimensions or
    more, it is also drawn around the point where a linear model of the scores meets the event. When events have
    occurred often enough, the proposal is frozen. The frozen proposal combines all earlier mixtures, the other
    distributions of a round, and the distribution of the parameters. Later scenarios are independent, so the mean of
    the weights of the events is an unbiased estimate of their probability, whatever was learned before. The draws
    depend only on the arguments and the recorded results.

    Scores that take no more than two values give no direction towards an event. If the first round has such scores, and
    there is no first guess, all scenarios follow the distribution of the parameters (plain Monte Carlo). Scores may
    also mislead. If the proposals meet the events no more often than the distribution of the parameters does,
    the proposal is frozen as this distribution.

    `n_events` is the number of kinds of event whose probability is estimated; each round is divided among them.
    `max_learning_scenarios` is the greatest number of scenarios before the proposal is frozen. `initial_proposal` is an
    optional first guess.
    """

    def __init__(
        self,
        space: ParameterSpace,
        n_events: int,
        max_learning_scenarios: int,
        seed: int,
        initial_proposal: TMixture | None = None,
    ) -> None:
        self._space, self._events, self._learn, self._seed = space, n_events, max_learning_scenarios, seed
        self._first_round_size = max(_MIN_ROUND_SIZE, round(_FIRST_ROUND_FRACTION * max_learning_scenarios))
        self._size = max(_MIN_ROUND_SIZE, (max_learning_scenarios - self._first_round_size) // _ROUNDS)
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._met = np.zeros((0, n_events), dtype=np.bool_)
        self._plain_distribution = TMixture.normal_around_zero(space.dimension)
        self._wide = [TMixture.normal_around_zero(space.dimension, deviation) for deviation in _WIDE_DEVIATIONS]
        self._earlier = [] if initial_proposal is None else [initial_proposal]
        self._proposal, self._drawn = self._plain_distribution, list[tuple[int, TMixture]]()
        self._rounds, self._ready, self._frozen, self._is_plain = 0, 0, False, False
        self._factor: tuple[float, float] | None = None

    @property
    def next_stage(self) -> str:
        """Purpose of the next round: ``"law"`` (draw from the distribution itself), ``"learn"`` or ``"estimate"``."""
        return "law" if self._rounds == 0 or self._is_plain else "estimate" if self._frozen else "learn"

    @property
    def is_plain(self) -> bool:
        """True if all scenarios are drawn from the distribution of the parameters itself (plain Monte Carlo).

        This happens if the scores take too few values to show in which direction an event lies.
        """
        return self._is_plain

    @property
    def is_plain_after_learning(self) -> bool:
        """True if the frozen proposal is the distribution of the parameters, because the scores mislead."""
        return self._frozen and self._proposal is self._plain_distribution

    def draw_round(self, max_count: int) -> FloatArray:
        """Draw a round of at most `max_count` scenarios within the constraints, (n, d) in the unit cube.

        Raises
        ------
        InputError
            Hardly any scenario fulfils the constraints.
        """
        count = max_count
        if not (self._frozen or self._is_plain):
            count = min(max_count, self._size if self._rounds else self._first_round_size)
        rng = np.random.default_rng((self._seed, 0, self._rounds))
        admitted = np.zeros((0, self._space.dimension))
        for _ in range(_MAX_TRIES):
            points = ndtr(self._proposal.draw_points(count - len(admitted), rng))
            admitted = np.concatenate([admitted, points[self._space.is_admissible(points)]])
            if len(admitted) == count:
                return admitted
        raise InputError(_HARDLY_ANY)

    def record_round(self, points: FloatArray, scores: FloatArray, occurred: BoolArray) -> None:
        """Record the results of a round; while the proposal is not frozen, learn from them.

        A lower score is nearer to the events; `scores` (n,) are NaN for a failed scenario. `occurred` (n, events) says
        which events occurred.
        """
        if self._rounds == 0 and not self._earlier:
            self._is_plain = len(np.unique(scores[np.isfinite(scores)])) <= _MAX_VALUES_WITHOUT_DIRECTION
        if not (self._frozen or self._is_plain):
            self._drawn.append((len(points), self._proposal))
            self._points = np.concatenate([self._points, _to_standard_normal(points)])
            self._scores = np.concatenate([self._scores, scores])
            self._met = np.concatenate([self._met, occurred])
            self._learn_proposal()
        self._rounds += 1

    def importance_weights(self, points: FloatArray) -> FloatArray:
        """Return the weights (n,) of scenarios that were drawn with the frozen proposal; they are 1 on average.

        A weight is the density of the parameters' distribution over the density of the proposal, both within the
        constraints.
        """
        normal = _to_standard_normal(points)
        factor, _ = self._estimate_constraint_factor()
        return np.asarray(
            factor * np.exp(self._plain_distribution.log_density(normal) - self._proposal.log_density(normal))
        )

    @property
    def common_weight_error(self) -> float:
        """Relative standard error that all weights have in common.

        The error comes from the estimated fraction of draws within the constraints.
        """
        return self._estimate_constraint_factor()[1]

    def _estimate_constraint_factor(self) -> tuple[float, float]:
        """Return the factor of all weights that is due to constraints, and its relative standard error.

        The factor is the fraction of the proposal within the constraints over the same fraction of the parameters'
        distribution.
        """
        if self.is_plain_after_learning or not self._space.declarations:
            return 1.0, 0.0
        if self._factor is None:
            rng = np.random.default_rng((self._seed, 1))
            fractions = [
                float(self._space.is_admissible(ndtr(mixture.draw_points(_N_CONSTRAINT_DRAWS, rng))).mean())
                for mixture in (self._proposal, self._plain_distribution)
            ]
            if not all(fractions):
                raise InputError(_HARDLY_ANY)
            error = np.sqrt(sum((1.0 - fraction) / fraction for fraction in fractions) / _N_CONSTRAINT_DRAWS)
            self._factor = fractions[0] / fractions[1], float(error)
        return self._factor

    def _learn_proposal(self) -> None:
        """Fit the next proposal to the scenarios nearest to each event; freeze the proposal if enough is learned."""
        count = len(self._points)
        proposals = [np.log(n / count) + mixture.log_density(self._points) for n, mixture in self._drawn]
        log_weights = self._plain_distribution.log_density(self._points) - np.logaddexp.reduce(proposals, axis=0)
        weights = np.exp(log_weights - log_weights.max())
        is_last = count + self._size > self._learn
        if self._scores_mislead(weights, is_last):
            self._proposal, self._frozen = self._plain_distribution, True
            return
        rng = np.random.default_rng((self._seed, 2, self._rounds))
        fitted, linear, ready = [], list[TMixture](), True
        for event in range(self._events):
            nearest, enough_events = self._select_nearest_to_event(event, weights)
            fitted.append((1.0 / self._events, TMixture.fit(self._points[nearest], weights[nearest], rng)))
            linear += self._fit_linear_model(event)
            ready &= enough_events
        new = TMixture.from_parts(fitted)
        self._ready = self._ready + 1 if ready else 0
        # Two rounds in a row, so that the last fit includes scenarios of a proposal at the event.
        if self._ready >= 2 or is_last:
            earlier = [(_FINAL_EARLIER_FRACTION / len(self._earlier), mixture) for mixture in self._earlier]
            wide = [(_FINAL_WIDE_FRACTION / len(_WIDE_DEVIATIONS), mixture) for mixture in self._wide]
            others = [
                (_FINAL_PLAIN_FRACTION, self._plain_distribution),
                *wide,
                *earlier,
                *((_FINAL_LINEAR_FRACTION / len(linear), mixture) for mixture in linear),
            ]
            rest = 1.0 - sum(share for share, _ in others)
            self._proposal = TMixture.from_parts([(rest, new), *others])
            self._frozen = True
            return
        parts = [new, *self._earlier[:1]] if self._rounds == 0 else [new]
        others = [
            *((_WIDE_FRACTION / len(_WIDE_DEVIATIONS), mixture) for mixture in self._wide),
            *((_LINEAR_FRACTION / len(linear), mixture) for mixture in linear),
        ]
        rest = 1.0 - sum(share for share, _ in others)
        self._proposal = TMixture.from_parts([*((rest / len(parts), part) for part in parts), *others])
        self._earlier.append(new)

    def _scores_mislead(self, weights: FloatArray, is_last: bool) -> bool:
        """Return whether the scores lead to other scenarios than those in which the events occur.

        This is so if the rounds after the first met each event no more often than its estimated probability. If no
        event has occurred, it is so if the scores hardly got any lower before the last round. While some events have
        occurred and others have not, nothing is known of the others. `weights` are those of all scenarios.
        """
        if self._rounds < _MIN_ROUNDS_WITH_EVENT:
            return False
        n_first, met, has_occurred = self._drawn[0][0], self._met, self._met.any(axis=0)
        if has_occurred.any():
            is_no_better = met[n_first:].mean(axis=0) <= weights @ met / weights.sum()
            return bool((has_occurred & is_no_better).all())
        first, first_half = (self._scores[:count] for count in (n_first, (n_first + len(met)) // 2))
        if not is_last or self._learn < _MIN_SCENARIOS_WITHOUT_EVENT or not np.isfinite(first).any():
            return False
        begin, middle, end = np.median(first[np.isfinite(first)]), np.nanmin(first_half), np.nanmin(self._scores)
        return bool(middle - end <= _MIN_PROGRESS * (begin - end))

    def _fit_linear_model(self, event: int) -> list[TMixture]:
        """Fit a normal distribution around the point at which, by a linear model of the scores, an event is likeliest.

        The list has at most one distribution. With fewer than 8 dimensions the list is empty, because the mixture is
        learned soon enough without this distribution. With too few scenarios for the model the list is empty, too.

        While the event has not occurred, the point is where the model reaches the lowest score so far. The direction of
        the point comes from least squares over the half of the scenarios with the lowest scores. The distance comes
        from the scenarios with scores nearest to the event. This is the design point of the first-order reliability
        method: A. M. Hasofer, N. C. Lind, "Exact and invariant second-moment code format", Journal of the Engineering
        Mechanics Division 100 (1974).
        """
        finite, dimension = np.isfinite(self._scores), self._space.dimension
        points, scores, met = self._points[finite], self._scores[finite], self._met[finite, event]
        lowest = np.argsort(scores, kind="stable")[: max(len(scores) // 2, 2 * (dimension + 1))]
        if dimension < _MANY_DIMENSIONS or len(lowest) < 2 * (dimension + 1):
            return []
        design = np.column_stack([np.ones(len(lowest)), points[lowest]])
        slope = np.linalg.lstsq(design, scores[lowest], rcond=None)[0][1:]
        if not (norm := float(np.linalg.norm(slope))) > 0.0:
            return []
        aim = scores[met].max() if met.any() else scores.min()
        nearest = np.argsort(np.abs(scores - aim), kind="stable")[:_DISTANCE_SCENARIOS]
        direction = -slope / norm
        center = float((points[nearest] @ direction).mean()) * direction
        return [TMixture(np.ones(1), center[None], np.eye(dimension)[None], np.array([np.inf]))]

    def _select_nearest_to_event(self, event: int, weights: FloatArray) -> tuple[BoolArray, bool]:
        """Return a mask of the scenarios nearest to an event, and whether the event occurred often enough for a fit."""
        met = self._met[:, event]
        # The worst score gives no direction towards the event; failures rank last.
        finite = np.isfinite(self._scores)
        informative = (finite & (self._scores < self._scores[finite].max(initial=-np.inf))) | met
        order = np.lexsort((np.where(finite, self._scores, np.inf), ~informative, ~met))
        ordered = weights[order]
        effective = np.cumsum(ordered) ** 2 / np.maximum(np.cumsum(ordered**2), 1e-300)
        needed = _PER_COEFFICIENT * (self._space.dimension + 2)
        hits = int(met.sum())
        count = max(int(np.searchsorted(np.maximum.accumulate(effective), needed)) + 1, hits)
        n_informative = int(informative.sum())
        selected = np.zeros(len(weights), dtype=np.bool_)
        selected[order[: min(count, n_informative) if n_informative else len(order)]] = True
        return selected, hits >= count and bool(effective[hits - 1] >= _EVENTS_FACTOR * needed)


def fit_initial_proposal(
    space: ParameterSpace, points: FloatArray, scores: FloatArray, criterion: Criterion, seed: int
) -> TMixture | None:
    """Fit a proposal for critical scenarios, by a Gaussian process of known scores; None with too few or equal scores.

    The proposal is a distribution in the space in which the parameters are standard normal. `scores` are lower if more
    critical, and NaN for a failed scenario.
    """
    try:
        points, scores = require_enough_scores(points, scores)
    except ValueError:
        return None
    rng = np.random.default_rng((seed, 3))
    law = TMixture.normal_around_zero(space.dimension)
    wide = [(1.0, TMixture.normal_around_zero(space.dimension, deviation)) for deviation in _WIDE_DEVIATIONS]
    proposal = TMixture.from_parts([(1.0, law), *wide])
    candidates = proposal.draw_points(_CANDIDATES, rng)
    process = fit_boundary_process(encode_points(space, points), scores, criterion)
    mean, deviation = process.predict(encode_points(space, ndtr(candidates)))
    weights = np.exp(law.log_density(candidates) - proposal.log_density(candidates))
    weights *= ndtr(-mean / np.maximum(deviation, 1e-9))
    return TMixture.fit(candidates, weights, rng) if weights.sum() > 0.0 else None


def _to_standard_normal(points: FloatArray) -> FloatArray:
    """Map points of the unit cube to the space in which the parameters are standard normal."""
    return np.asarray(ndtri(np.clip(points, _MIN_QUANTILE, _MAX_QUANTILE)))
