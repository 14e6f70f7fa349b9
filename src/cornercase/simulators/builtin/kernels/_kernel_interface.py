"""Calls of kernels from Python, between runs of the compiled time loop: actions, distances and overlaps."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, attr-defined"

from __future__ import annotations

from typing import Final
from weakref import proxy

import numpy as np
import numpy.typing as npt

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.simulators.builtin.kernels._action_table import ACTION_APPLIED, ActionTable
from cornercase.simulators.builtin.kernels._actions import apply_action_in_scenarios, compile_action_kernels
from cornercase.simulators.builtin.kernels._box_overlap import entities_overlap
from cornercase.simulators.builtin.kernels._distances import distance_to_entity, distance_to_point
from cornercase.simulators.builtin.kernels._simulation_state import SimulationState
from cornercase.simulators.builtin.tracks._track_pool import TrackPool
from cornercase.simulators.builtin.world._world import World

_OVERLAP: Final = -1
_NO_POINTS: Final = np.empty((2, 0))


class KernelInterface:
    """Access from Python to the kernels for actions, distances and overlaps in a batch of scenarios.

    The world holds only a weak reference to this object, so that the recordings are freed together with the batch.
    """

    def __init__(
        self, world: World, scene: SimulationState, pool: TrackPool, roads: tuple[object, ...], actions: ActionTable
    ) -> None:
        self._world, self._scene, self._pool, self._roads, self._actions = world, scene, pool, roads, actions
        # Weak, so that the recordings are freed as soon as the object that runs the batch is.
        world.compiled = proxy(self)

    def apply_action(self, number: int, dt: float, where: BoolArray) -> npt.NDArray[np.int64]:
        """Apply an action for one time step in the scenarios of a mask, and return the outcomes, shape (N,).

        `number` is the row of the action in the action table. The outcome is `ACTION_APPLIED` outside the mask.
        """
        outcomes = np.full(where.shape, ACTION_APPLIED)
        tracks, scenarios = self._pool.update(self._world.tracks), np.flatnonzero(where)
        arguments = self._scene, tracks, self._roads, self._actions, scenarios, number, float(dt)
        if not apply_action_in_scenarios.is_interpreted(*arguments):
            compile_action_kernels(*arguments[:4])
        outcomes[scenarios] = apply_action_in_scenarios(*arguments)
        return outcomes

    def measure_to_entity(self, entity: int, other: int, distance_kind: int) -> FloatArray:
        """Return the signed distance in m from one entity to another, shape (N,).

        `distance_kind` is `EUCLIDEAN_DISTANCE`, `LONGITUDINAL_DISTANCE` or `LATERAL_DISTANCE`. For the distance between
        boxes, it is one of the last two plus `FREE_SPACE`.
        """
        return np.asarray(_measure_distance_or_overlap(self._scene, entity, other, _NO_POINTS, distance_kind))

    def measure_to_point(self, entity: int, x: FloatArray, y: FloatArray, distance_kind: int) -> FloatArray:
        """Return the signed distance in m from an entity to the point (x, y), shape (N,).

        `distance_kind` is `EUCLIDEAN_DISTANCE`, `LONGITUDINAL_DISTANCE` or `LATERAL_DISTANCE`, plus `FREE_SPACE` for
        the distance from the box.
        """
        return np.asarray(_measure_distance_or_overlap(self._scene, entity, -1, np.array([x, y]), distance_kind))

    def find_overlaps(self, entity: int, other: int) -> BoolArray:
        """Return a mask of the scenarios in which the bounding boxes of two entities overlap now."""
        return np.asarray(_measure_distance_or_overlap(self._scene, entity, other, _NO_POINTS, _OVERLAP) > 0.0)


@kernel(interpreted_seconds=lambda scene, *_: 3e-5 * scene.time.size, error_model="numpy")
def _measure_distance_or_overlap(scene, e, other, points, distance_kind):
    result = np.empty(scene.time.size)
    for n in range(result.size):
        if distance_kind == _OVERLAP:
            result[n] = entities_overlap(scene, n, e, other)
        elif other >= 0:
            result[n] = distance_to_entity(scene, n, e, other, distance_kind)
        else:
            result[n] = distance_to_point(scene, n, e, points[0, n], points[1, n], distance_kind)
    return result
