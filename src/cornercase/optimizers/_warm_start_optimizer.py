"""Base class of optimizers with a warm start: a search that uses the scores of another study."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence._multi_fidelity import SourceStudyModel, append_source_prediction
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.optimizers._candidates import CandidateOptimizer
from cornercase.optimizers._straddle import StraddleSelection
from cornercase.study._criterion import Criterion

_N_CHECKED: Final = 10  # number of scores from which the other study's prediction is checked
_SOURCE_FRACTION: Final = 0.5  # fraction of the first `_N_CHECKED` points that the other study chooses
_N_CANDIDATES: Final = 4096  # number of candidates for the points that the other study chooses
_CATCH_UP_RANGE: Final = (15, 24)  # numbers of points between which space-filling points catch up


class WarmStartOptimizer(CandidateOptimizer):
    """Base class of optimizers that use the prediction of another study as an additional coordinate of their model.

    The prediction comes from `SourceStudyModel`. Half of the first ten points are on the boundary of the
    critical scenarios that the other study predicts, to learn how far the true boundary is from there. Each of these
    points has the largest ``1.96 s - |m|`` of 4096 candidates. Here m is the mean that the Gaussian process of the
    other study predicts, with the threshold at 0. s is the standard deviation of a process with the same kernel that
    knows only the points of the new search. So the points spread along the predicted boundary, instead of crowding
    where s of the other study is large.

    As soon as there are ten scores that the other study predicts well, the model is learned. Additional space-filling
    points follow between the 15th and the 24th point, as many as points were chosen by the other study. If the other
    study does not predict the scores well, the model is learned from as many points as without a warm start.
    """

    supports_warm_start = True
    _criterion: Criterion
    _source_model: SourceStudyModel | None = None

    def warm_start(self, points: FloatArray, scores: FloatArray) -> None:
        """Use the scores (n,) of another study at points (n, d); called before the first `tell`."""
        self._source_model = SourceStudyModel(encode_points(self._space, points), scores, self._criterion)

    def _propose(self, n: int, pending: FloatArray) -> FloatArray:
        n_proposed = len(self._points) + len(pending)
        if (
            self._source_model is None
            or (count := _count_chosen_by_source(n_proposed + n) - _count_chosen_by_source(n_proposed)) == 0
        ):
            return super()._propose(n, pending)
        filling = self._sequence.ask(n - count, exclude=pending)
        sampled = np.concatenate([self._points, pending, filling])
        return np.concatenate(
            [self._points_on_source_boundary(self._source_model, sampled, count, n_proposed), filling]
        )

    def _points_on_source_boundary(
        self, source_model: SourceStudyModel, sampled: FloatArray, n: int, n_proposed: int
    ) -> FloatArray:
        """Return points (k, d) on the boundary that the other study predicts, away from the `sampled` points (m, d)."""
        candidates = self._draw_candidates(self._seed_of(n_proposed), _N_CANDIDATES, sampled)
        count, process = len(candidates), source_model.process
        points = encode_points(self._space, np.concatenate([candidates, sampled]))
        variance = np.full(len(points), process.kernel.signal**2)
        selection = StraddleSelection(process, points, process.predict(points)[0], variance, np.empty((len(points), 0)))
        for i in range(count, len(points)):
            selection.condition_on_point(i)
        return candidates[selection.choose_points(min(n, count), count)[0]]

    def _has_enough_scores(self) -> bool:
        if super()._has_enough_scores():
            return True
        scores = self._scores[self._is_finished]
        if self._source_model is None or len(scores) < _N_CHECKED or np.ptp(scores) == 0.0:
            return False
        return self._source_model.improves_prediction(
            encode_points(self._space, self._points[self._is_finished]), scores
        )

    def _count_space_filling(self, n_points: int) -> int:
        added = (
            0
            if self._source_model is None
            else int(np.interp(n_points, _CATCH_UP_RANGE, (0, _count_chosen_by_source(n_points))))
        )
        return super()._count_space_filling(n_points) + added

    def _encode(self, points: FloatArray) -> FloatArray:
        """Return the encoded coordinates of points in the space, shape (n, e)."""
        return encode_points(self._space, points)

    def _model_coordinates(self, points: FloatArray) -> FloatArray:
        """Return the coordinates of points for the model of the scores, shape (n, e).

        After a warm start, the last coordinate is the prediction of the other study.
        """
        return append_source_prediction(self._source_model, encode_points(self._space, points))


def _count_chosen_by_source(n_points: int) -> int:
    """Return how many of the first `n_points` points are chosen on the boundary that the other study predicts."""
    return math.floor(_SOURCE_FRACTION * min(n_points, _N_CHECKED))
