"""Built-in driver, which plans its speed, follows and yields, and knows only entities that it has seen."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from inspect import Parameter, Signature
from typing import Any, Final, Self, cast

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray
from cornercase.drivers._compiled import CompiledDriver
from cornercase.drivers._kernels.structs import BEHAVIOUR, KNOWN, YIELDING
from cornercase.drivers._presets import AGGRESSIVE, CAUTIOUS, NORMAL, Behaviour, check_parameter

_ALLOWED_ZERO: Final = frozenset(
    {"standing_caution", "reaction_time", "memory", "lateral_margin", "braking_distance", "safety_time"}
)


class BehaviourDriver(CompiledDriver):
    """Built-in driver, which plans its speed, follows other entities and yields to them.

    The driver computes an acceleration from its own speed plan, and an acceleration for each entity that it follows or
    yields to. The lowest of these accelerations counts. See ``docs/drivers.md``.

    Parameters
    ----------
    behaviour : Behaviour, default NORMAL
        Parameters of the driver.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import NORMAL, BehaviourDriver
    >>> sleepy = BehaviourDriver(NORMAL._replace(reaction_time=2.0))
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": sleepy})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    kind = BEHAVIOUR

    def __init__(self, behaviour: Behaviour = NORMAL) -> None:
        _check_parameters(behaviour)
        self.settings = {"driver": "behaviour", **behaviour._asdict()}
        self.parameters = tuple(behaviour)
        self.start(0, 0)

    def __str__(self) -> str:
        if type(self) is not BehaviourDriver:
            return super().__str__()
        preset, changes = Behaviour(*self.parameters).nearest_preset()
        return ":".join([preset, *filter(None, [",".join(f"{name}={value}" for name, value in changes.items())])])

    def numeric_parameters(self) -> dict[str, float]:
        """Return the parameters of the driver by name, as in `Behaviour`."""
        return Behaviour(*self.parameters)._asdict() if type(self) is BehaviourDriver else super().numeric_parameters()

    def with_options(self, **changes: Any) -> Self:
        """Return a new driver with some options changed; the options are the fields of `Behaviour`."""
        if type(self) is BehaviourDriver and "behaviour" not in changes:
            return type(self)(Behaviour(*self.parameters)._replace(**changes))
        return super().with_options(**changes)

    @property
    def known_mask(self) -> BoolArray:
        """Mask of the A other entities that the driver knows in N scenarios, ndarray of bool, shape (N, A)."""
        return self._fleet.awareness[0, :, KNOWN]

    @property
    def yielding_mask(self) -> BoolArray:
        """Mask of the A other entities that the driver yields to in N scenarios, ndarray of bool, shape (N, A)."""
        return self._fleet.awareness[0, :, YIELDING]


def _check_parameters(behaviour: Behaviour) -> None:
    for name, value in behaviour._asdict().items():
        check_parameter(name, value, name in _ALLOWED_ZERO)
    if behaviour.field_of_view > 2.0 * math.pi:
        raise InputError(
            f"The driver's field_of_view is {behaviour.field_of_view:g}; give an angle in rad of at most 6.2832."
        )


def _preset_factory(behaviour: Behaviour, summary: str) -> Callable[..., BehaviourDriver]:
    """Return a function that builds the driver of a preset; all parameters of the driver are its options."""

    def build(**overrides: float) -> BehaviourDriver:
        return BehaviourDriver(behaviour._replace(**{name: float(value) for name, value in overrides.items()}))

    factory: Any = build
    factory.__doc__ = f"{summary}\n\nIts options are the parameters of a Behaviour.\n\n{inspect.getdoc(Behaviour)}"
    # The registry reads the options from the signature.
    factory.__signature__ = Signature(
        [
            Parameter(name, Parameter.KEYWORD_ONLY, default=value, annotation=float)
            for name, value in behaviour._asdict().items()
        ]
    )
    return cast(Callable[..., BehaviourDriver], factory)


cautious = _preset_factory(CAUTIOUS, "Careful driver who goes slowly, brakes early and keeps a large distance.")
normal = _preset_factory(NORMAL, "Driver of usual attention.")
aggressive = _preset_factory(AGGRESSIVE, "Hasty driver who brakes late and keeps a small distance.")
