"""Copy recorded motion from the blocks (pages) in which kernels store it."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math
from threading import Lock

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.pointers import floats_at_address, memory_address
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin._gil import release_gil_lock
from cornercase.simulators.builtin.kernels._simulation_state import PAGE_LENGTH, RECORDED_QUANTITIES, SimulationState


def copy_motion(
    scene: SimulationState, scenarios: IntArray, gil_lock: Lock | None
) -> tuple[list[FloatArray], BoolArray]:
    """Return the recorded motion of scenarios, and a mask of the scenarios in which any entity was ever present.

    The motion of each scenario is an array of x, y, heading, speed and acceleration, by entity and frame. `gil_lock` is
    released while compiled code runs.
    """
    shape = len(RECORDED_QUANTITIES), scene.pages.shape[2]
    motion = [np.empty((*shape, instants)) for instants in scene.n_frames[scenarios].tolist()]
    targets = np.array([memory_address(array) for array in motion], dtype=np.int64)
    with release_gil_lock(gil_lock):
        return motion, _copy_pages(scene.pages, scene.page_numbers, scene.n_frames, scenarios, targets)


def _interpreted_seconds(
    pages: FloatArray, _: IntArray, n_frames: IntArray, scenarios: IntArray, __: IntArray
) -> float:
    return 3e-7 * pages.shape[1] * pages.shape[2] * int(n_frames[scenarios].sum())


@kernel(interpreted_seconds=_interpreted_seconds, error_model="numpy")
def _copy_pages(pages, page_numbers, n_frames, scenarios, targets):
    placed = np.zeros(scenarios.size, dtype=np.bool_)
    rows = pages.shape[1] * pages.shape[2]
    for k in range(scenarios.size):
        n = scenarios[k]
        instants = n_frames[n]
        target = floats_at_address(targets[k], rows * instants)
        for number in range((instants + PAGE_LENGTH - 1) // PAGE_LENGTH):
            start, current = PAGE_LENGTH * number, pages[page_numbers[n, number]]
            count = min(instants - start, PAGE_LENGTH)
            for q in range(pages.shape[1]):
                for e in range(pages.shape[2]):
                    offset = (q * pages.shape[2] + e) * instants + start
                    for i in range(count):
                        target[offset + i] = current[q, e, i]
            for e in range(pages.shape[2]):
                for i in range(count):
                    placed[k] |= math.isfinite(current[0, e, i])
    return placed
