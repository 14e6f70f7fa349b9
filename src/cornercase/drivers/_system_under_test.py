"""Systems under test written by users: one object per scenario, one plain call per time step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, is_dataclass
from inspect import signature
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

import numpy as np

from cornercase._common.configurable import Configurable, copy_with_numeric_options, describe_as_text, numeric_options
from cornercase._common.errors import InputError, PluginError, SimulationError
from cornercase._common.plugin_errors import format_time_of_failure, make_scenario_failure
from cornercase._common.process.signals import count_termination_requests
from cornercase._common.text.sanitize import quote_name
from cornercase.drivers._base import Situation
from cornercase.drivers._controls import Control, Controls
from cornercase.drivers._driving_function import DrivingFunction, Start
from cornercase.drivers._mutation import Mutation
from cornercase.drivers._view import SharedView, View

if TYPE_CHECKING:
    from cornercase.roads._network import RoadNetwork


@dataclass(frozen=True, eq=False)
class Ego:
    """Vehicle that a system under test drives, as given when a scenario starts.

    Attributes
    ----------
    name, object_type : str
        Name of the entity, and its category: a vehicle category such as ``"car"``, ``"pedestrian"`` or ``"misc"``.
    length, width, center_x, wheelbase : float
        Length and width of the bounding box, position of its centre ahead of the reference point, and distance between
        the axles, in m.
    max_steering : float
        Largest angle of the front wheels in rad.
    max_speed, max_acceleration, max_deceleration : float
        Limits in m/s and m/s²; infinite if the scenario file has none, but 0 for the speed of a misc object.
    values : mapping of str to object
        Values that are set for parameters of the scenario file in this scenario, by name. Parameters that are left out
        have the value in the file.

    Examples
    --------
    >>> import cornercase as cc
    >>> class Hold(cc.SystemUnderTest):
    ...     def start(self, ego, road, rng):
    ...         print(f"{ego.name}, a {ego.object_type}, is {ego.length} m long")
    ...
    ...     def step(self, view, dt):
    ...         return 0.0
    >>> _ = cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": Hold()}, duration=0.1)
    Ego, a car, is 4.3 m long
    """

    name: str
    object_type: str
    length: float
    width: float
    center_x: float
    wheelbase: float
    max_steering: float
    max_speed: float
    max_acceleration: float
    max_deceleration: float
    values: Mapping[str, object]


class SystemUnderTest(Configurable, ABC):
    """Base class of your own driving function, which sees one scenario and decides one time step at a time.

    Derive a class and implement `step`; if the function has state, also `start`. Each concrete scenario gets its own
    object: a copy of the object that you give or, if a search varies options or the object cannot be copied, a new
    object made from the options of the constructor. An exception ends only the scenario in which it is raised.

    A decision may depend only on what the function is given: no clock, no random numbers except those of `rng`.

    Attributes
    ----------
    settings : dict
        Everything that decisions depend on, as plain JSON values; by default only the name of the class. Options of the
        constructor that are numbers, texts or booleans are stored with a study in any case. A study refuses any other
        option, such as a list or a dict, unless `settings` has an entry under the option's name, as in
        ``self.settings = {"config": {"gain": 2.0}}``.
    mutations : tuple of Mutation, default empty
        Changes that make the function worse, for `cornercase reduce --kill-mutants` and `cornercase test --mutants`.

    See Also
    --------
    Driver : Base class of drivers that decide for all scenarios at once, with arrays.
    Control : Decision that a step may return.

    Examples
    --------
    >>> import cornercase as cc
    >>> class Aeb(cc.SystemUnderTest):
    ...     def __init__(self, time_to_brake=1.5):
    ...         self.time_to_brake = time_to_brake
    ...
    ...     def step(self, view, dt):
    ...         leader = view.leader
    ...         if leader is not None and leader.gap < self.time_to_brake * leader.closing:
    ...             return cc.Control(acceleration=-8.0)
    ...         return 0.0
    >>> scenario = "examples/x_intersection/x_intersection.xosc"
    >>> cc.simulate(scenario, drivers={"Ego": Aeb(time_to_brake=2.0)}, duration=2.0).names[0]
    'Ego'
    """

    settings: dict[str, object]
    mutations: ClassVar[tuple[Mutation, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not any("settings" in vars(base) for base in cls.__mro__):
            cls.settings = {"driver": f"{cls.__module__}:{cls.__qualname__}"}

    def __str__(self) -> str:
        return describe_as_text(self)

    def describe(self) -> Sequence[str]:
        """Return text lines about the function, which `cornercase check` prints; none by default.

        Returns
        -------
        sequence of str
            Lines such as the version, or which files were loaded.
        """
        return ()

    def start(self, ego: Ego, road: RoadNetwork | None, rng: np.random.Generator) -> None:
        """Begin a scenario; does nothing by default.

        Parameters
        ----------
        ego : Ego
            The vehicle to drive.
        road : RoadNetwork or None
            The roads.
        rng : numpy.random.Generator
            Source of all random numbers: the same scenario in the same study has the same numbers.
        """

    @abstractmethod
    def step(self, view: View, dt: float) -> Control | float:
        """Decide what the ego does in the coming time step.

        Parameters
        ----------
        view : View
            State of the ego, and the traffic around it.
        dt : float
            Duration of the step in s.

        Returns
        -------
        Control or float
            A number is an acceleration in m/s².
        """


# How the methods of a user's class are called.
_CALLS: Final = {"start": ("ego", "road", "rng"), "step": ("view", "dt")}


def _check_method_signatures(made: SystemUnderTest) -> None:
    """Raise `InputError` if a method of a user's class cannot be called as cornercase calls it."""
    for method, arguments in _CALLS.items():
        try:
            declared = signature(getattr(made, method))
        except (TypeError, ValueError):
            # Compiled code may have none.
            continue
        try:
            declared.bind(*arguments)
        except TypeError:
            own, called = (", ".join(("self", *names)) for names in (declared.parameters, arguments))
            cls = f"{type(made).__module__}:{type(made).__qualname__}"
            raise InputError(
                f"The driver '{cls}' defines {method}({own}), but cornercase calls {method}({called}); define"
                f" {method}({called})."
            ) from None


class PerScenarioDriver(DrivingFunction):
    """Driver that drives each scenario with its own `SystemUnderTest` object.

    Each object is made like `prototype`, the object that the user gave.
    """

    def __init__(self, prototype: SystemUnderTest) -> None:
        _check_method_signatures(prototype)
        self.prototype = prototype
        self.settings, self.mutations = prototype.settings, prototype.mutations  # type: ignore[misc]
        self._objects: list[SystemUnderTest] = []

    def __str__(self) -> str:
        return str(self.prototype)

    def with_options(self, **changes: Any) -> Self:
        """Return a new driver whose prototype has some options changed."""
        return type(self)(copy_with_numeric_options(self.prototype, changes))

    def describe(self) -> Sequence[str]:
        """Return the lines of the prototype's `describe`."""
        return self.prototype.describe()

    def numeric_parameters(self) -> dict[str, float]:
        """Return the numeric options of the prototype."""
        return numeric_options(self.prototype)

    def prepare(self, start: Start) -> None:
        """Create and start one object of the user's class per scenario."""
        body, cls = start.body, type(self.prototype)
        self._name = f"the driver of {quote_name(body.name)} ({cls.__module__}:{cls.__qualname__})"
        self._objects, self._failures, self._network = [], dict[int, SimulationError](), start.network
        for n in range(start.scenarios):
            requests = count_termination_requests()
            try:
                made = self._create_object({name: float(values[n]) for name, values in start.parameters.items()})
                ego = Ego(**vars(body), values=start.values[n])
                made.start(ego, start.network, start.generator(n, "driver"))
            except BaseException as error:
                self._failures[n] = make_scenario_failure(self._name, error, requests, 0.0)
                made = self.prototype
            self._objects.append(made)

    def _create_object(self, numbers: Mapping[str, float]) -> SystemUnderTest:
        """Return a new object like the prototype, with the numeric options in `numbers` changed."""
        if not numbers:
            # A copy has also what a dataclass changes after its construction.
            with suppress(Exception):
                return deepcopy(self.prototype)
        if is_dataclass(self.prototype) and vars(self.prototype.with_options()) != vars(self.prototype):
            raise InputError(
                "its dataclass changes fields in __post_init__, so the options cannot be varied; write an __init__"
                " instead"
            )
        made: SystemUnderTest = copy_with_numeric_options(self.prototype, numbers)
        return made

    def decide(self, situation: Situation) -> Controls:
        """Return the decisions of the objects in the active scenarios."""
        shared = SharedView(situation, self._network)
        controls: list[Control | float | None] = [None] * len(situation.active)
        failures = dict[int, SimulationError]()
        for n in np.flatnonzero(situation.active).tolist():
            if n in self._failures:
                failures[n] = self._failures[n]
                continue
            requests = count_termination_requests()
            try:
                returned: object = self._objects[n].step(View(shared, n), situation.time_step)
            except BaseException as error:
                failures[n] = make_scenario_failure(self._name, error, requests, situation.time)
                continue
            if type(returned) is float and isfinite(returned):
                # Most functions return one, and a `Control` takes longer to make than to decide.
                controls[n] = returned
                continue
            try:
                controls[n] = Control.from_returned(returned)
            except ValueError as error:
                instant = format_time_of_failure(situation.time)
                failures[n] = PluginError(f"{self._name} returned no control{instant}: {error}")
        return Controls.from_scalar(controls, failures)
