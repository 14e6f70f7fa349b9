"""Run the compiled time loop, or interpret the loop for a few scenarios if it is not compiled on this machine yet."""

# Kernels are declared as plain functions, without the methods of their dispatcher.
# mypy: disable-error-code="attr-defined"

from __future__ import annotations

import time
from typing import Any

import numpy as np

from cornercase._common.numba.interpret import can_interpret, interpret
from cornercase.drivers._compiled import compile_fleet_kernels
from cornercase.simulators.builtin.kernels._actions import compile_action_kernels
from cornercase.simulators.builtin.kernels._conditions import compile_condition_kernel
from cornercase.simulators.builtin.kernels._loop import IDLE, LoopState, run_until_storyboard


def run_scenarios(
    scene: Any,
    tracks: Any,
    roads: Any,
    fleet: Any,
    actions: Any,
    conditions: Any,
    loop: LoopState,
    options: Any,
    first: int,
    last: int,
) -> None:
    """Call `run_until_storyboard` for the scenarios [first, last).

    If this kernel is not compiled yet, Python first interprets it, scenario by scenario. The kernel is compiled when
    the remaining scenarios would take too long (see `can_interpret`).
    """
    arguments = (scene, tracks, roads, fleet, actions, conditions, loop, options, first, last)
    if not can_interpret(0.0, is_loop=True) or run_until_storyboard.has_machine_code(*arguments):
        compile_loop_kernels(*arguments[:6])
        run_until_storyboard(*arguments)
        return
    waiting = first + np.flatnonzero(loop.status[first:last] != IDLE)
    status = loop.status[waiting]
    begin, n_done = time.thread_time(), 0
    while n_done < len(waiting):
        seconds = (time.thread_time() - begin) / max(n_done, 1)
        if not can_interpret(seconds * (len(waiting) - n_done), is_loop=True):
            break
        loop.status[waiting] = IDLE
        loop.status[waiting[n_done]] = status[n_done]
        interpret(run_until_storyboard, arguments)
        status[n_done] = loop.status[waiting[n_done]]
        n_done += 1
    loop.status[waiting[:n_done]], loop.status[waiting[n_done:]] = IDLE, status[n_done:]
    if n_done < len(waiting):
        compile_loop_kernels(*arguments[:6])
        run_until_storyboard(*arguments)
    loop.status[waiting[:n_done]] = status[:n_done]


def compile_loop_kernels(scene: Any, tracks: Any, roads: Any, fleet: Any, actions: Any, conditions: Any) -> None:
    """Compile the kernels of drivers, actions and conditions that the time loop calls; needed before a compiled run."""
    compile_fleet_kernels(fleet)
    compile_action_kernels(scene, tracks, roads, actions)
    compile_condition_kernel(scene, conditions)
