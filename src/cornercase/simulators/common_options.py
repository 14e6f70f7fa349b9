"""Options that every simulator is offered, and those that it declares."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import Parameter, signature
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.ledger import warn
from cornercase._common.registry import declared_options
from cornercase.simulators.base import Simulator

# What is said of a run unless somebody wants it otherwise; a simulator that knows nothing of it need not be told.
_USUAL: Final[dict[str, Any]] = {"drivers": {}, "on_collision": "continue", "time_step": 0.05, "duration": 60.0}


def take_options(name: str, simulator: type[Simulator], options: Mapping[str, Any]) -> dict[str, Any]:
    """Find the options that a simulator gets: those that its constructor declares.

    Parameters
    ----------
    name : str
        For messages.
    simulator : type
    options : mapping of str to object
        ``time_step``, ``duration``, ``on_collision`` and ``drivers``, and what else it is made with.

    Returns
    -------
    dict of str to object
        All options, if the constructor takes others than those that it names.

    Raises
    ------
    InputError
        It knows no drivers, or nothing of collisions, and is to have some or to end with one.

    Warns
    -----
    NoticeWarning
        A time step or duration has no effect.
    """
    declared = declared_options(simulator)
    for key, usual in _USUAL.items():
        value = options.get(key)
        if key in declared or value in (None, usual):
            continue
        if key == "drivers":
            raise InputError(
                f"`drivers` {', '.join(value)}: the simulator '{name}' takes no drivers; leave them out, or declare"
                " 'drivers' in its constructor."
            )
        if key == "on_collision":
            raise InputError(
                f"`on_collision` {value}: the simulator '{name}' does not declare 'on_collision' in its constructor;"
                " leave it out, or declare it."
            )
        warn(f"without effect: {key} {value} s, since the simulator '{name}' does not declare it in its constructor")
    if any(one.kind is Parameter.VAR_KEYWORD for one in signature(simulator).parameters.values()):
        return dict(options)
    return {key: value for key, value in options.items() if key in declared or key not in _USUAL}
