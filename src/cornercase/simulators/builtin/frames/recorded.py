"""Taking what was recorded of scenarios off their pages."""

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
    """Copy the motion of scenarios, each to memory of its own.

    Parameters
    ----------
    scene : Scene
    scenarios : ndarray of int64, shape (S,)
    turn : Lock, optional
        What only one thread may have that is in Python; held here, but for while compiled code runs.

    Returns
    -------
    motion : list of ndarray of float64, each (5, E, T)
        The `QUANTITIES` of all entities at the instants of each.
    placed : ndarray of bool, shape (S,)
        Whether any entity has ever been anywhere.
    """
    shape = len(QUANTITIES), scene.pages.shape[2]
    motion = [np.empty((*shape, instants)) for instants in scene.frames[scenarios].tolist()]
    targets = np.array([address_of(one) for one in motion], dtype=np.int64)
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
            begin, one = PAGE * number, pages[page[n, number]]
            count = min(instants - begin, PAGE)
            for q in range(pages.shape[1]):
                for e in range(pages.shape[2]):
                    at = (q * pages.shape[2] + e) * instants + begin
                    for i in range(count):
                        target[at + i] = one[q, e, i]
            for e in range(pages.shape[2]):
                for i in range(count):
                    placed[k] |= math.isfinite(one[0, e, i])
    return placed
