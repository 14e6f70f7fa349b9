"""Copy recordings from their pages."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math
from threading import Lock

import numpy as np

from cornercase._common.addresses import address_of, floats_at
from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.frames.scene import PAGE, QUANTITIES, Scene
from cornercase.simulators.builtin.turns import turn_given_up


def motion_of(scene: Scene, scenarios: IntArray, turn: Lock | None) -> tuple[list[FloatArray], BoolArray]:
    """Copy the motion of S scenarios, and tell which had any entity placed.

    Returns arrays (5, E, T) of the recorded quantities, and a mask (S,). `gil_lock` is released while compiled code
    runs.
    """
    shape = len(QUANTITIES), scene.pages.shape[2]
    motion = [np.empty((*shape, instants)) for instants in scene.frames[scenarios].tolist()]
    targets = np.array([address_of(array) for array in motion], dtype=np.int64)
    with turn_given_up(turn):
        return motion, _copy(scene.pages, scene.page, scene.frames, scenarios, targets)


@kernel(error_model="numpy")
def _copy(pages, page, frames, scenarios, targets):
    placed = np.zeros(scenarios.size, dtype=np.bool_)
    rows = pages.shape[1] * pages.shape[2]
    for k in range(scenarios.size):
        n = scenarios[k]
        instants = frames[n]
        target = floats_at(targets[k], rows * instants)
        for number in range((instants + PAGE - 1) // PAGE):
            start, current = PAGE * number, pages[page[n, number]]
            count = min(instants - start, PAGE)
            for q in range(pages.shape[1]):
                for e in range(pages.shape[2]):
                    offset = (q * pages.shape[2] + e) * instants + start
                    for i in range(count):
                        target[offset + i] = current[q, e, i]
            for e in range(pages.shape[2]):
                for i in range(count):
                    placed[k] |= math.isfinite(current[0, e, i])
    return placed
