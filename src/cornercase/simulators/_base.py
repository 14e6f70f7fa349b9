"""Base class of simulators, and checks of their common options."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, Self

from cornercase._common.configurable import Configurable
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.io.support_table import Notice, issue_notice_warning
from cornercase._common.plugin_errors import convert_plugin_errors
from cornercase._common.validation import check_float, check_str, repr_short
from cornercase.drivers._resolve import DriverLike, check_drivers
from cornercase.drivers._serialization import serialize_driver
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile

COMMON_OPTIONS: Final = ("drivers", "on_collision", "time_step", "duration")
"""Options that every simulator is offered; its constructor need not declare them."""


@dataclass(frozen=True)
class Availability:
    """Availability of a simulator on this machine.

    Attributes
    ----------
    version : str
        Version of the simulator; empty if unknown.
    problem : str
        What is missing and how to get it, as a sentence; empty if the simulator can run.
    features : tuple of str
        Short descriptions of optional features.

    Examples
    --------
    >>> from cornercase.simulators import list_simulators
    >>> builtin = list_simulators()["builtin"]
    >>> bool(builtin.version), builtin.problem
    (True, '')
    """

    version: str = ""
    problem: str = ""
    features: tuple[str, ...] = ()


class Simulator(Configurable, ABC):
    """Base class of all simulators, which run concrete scenarios.

    Your own simulator is a subclass with `settings` and `run`, registered in the entry-point group
    ``cornercase.simulators``. The other members have defaults for a program that runs one scenario at a time.

    The constructor must not start anything, and must work if the program is not installed: the object only describes a
    simulator, and may be created again in another process. All options of the constructor are keyword arguments. Four
    options are common to all simulators: ``time_step`` and ``duration`` in s, ``on_collision`` (``"continue"`` or
    ``"stop"``) and ``drivers`` (by entity, a driver or the name of a driver). Of these, the constructor gets only those
    that it declares, or all four if it takes ``**options``. If it does not declare ``drivers``, drivers are refused.
    The simulator's own options follow its name after a colon (``"esmini:seed=3"``). The constructor must declare each
    of them by name: ``**options`` does not accept them.

    Attributes
    ----------
    name : str
        Registered name, with the simulator's options if any were given: ``"esmini:seed=3"``. Time step, duration,
        ``on_collision`` and drivers are not part of the name, since all simulators have them.
    settings : dict
        Everything that determines the recordings besides the scenario, as plain JSON values. The settings are stored
        with a study, and a study is resumed only with the same settings.
    requires : tuple of str
        Further options that the constructor gets: ``"ego"``, the name of the entity under test, and ``"worker"``, the
        number of the worker process, counted from 0.
    in_process : bool, default False
        Whether the simulator may run in cornercase's own process, since it neither crashes nor hangs and leaves
        nothing behind.
    deterministic : bool, default False
        Whether the same scenario with the same settings gives a bit-identical recording. If recordings differ
        nevertheless, the system under test is the cause. Each study checks this with its first scenario.
    batched : bool, default False
        Whether one call with many scenarios is faster than single calls. The simulator then gets as many scenarios as
        possible at once, otherwise one at a time.
    takes_driver_parameters : bool, default False
        Whether parameters of drivers can differ between scenarios: ``concrete.values`` then also has values such as
        ``Ego.reaction``, for the option ``reaction`` of the driver of ``Ego``. Otherwise these parameters are refused.
    runs_storyboard : bool, default True
        Whether the storyboard of the scenario file determines what happens; False if something else determines it,
        such as a TestRun of CarMaker.
    has_own_boxes : bool, default False
        Whether the simulator's vehicles have bounding boxes of their own, instead of the boxes in the scenario file.
    parameter_passing : {"name", "file"}, default "name"
        How the simulator takes parameter values. ``"name"``: ``concrete.values`` has the values of all parameters that
        the scenario file declares. ``"file"``: the simulator reads the file, and ``concrete.values`` has only the
        values that differ from the file. In a suite no values differ, since each scenario has a file of its own.
    on_notice : callable
        Function that is called with each sentence for the user. By default the sentence becomes a `NoticeWarning`;
        a worker process sends the sentence to the main process.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.recordings import Recording
    >>> from cornercase.simulators import Simulator
    >>> class Standing(Simulator):
    ...     name = "standing"
    ...
    ...     def __init__(self):
    ...         self.settings = {}
    ...
    ...     def run(self, concretes):
    ...         for _ in concretes:
    ...             rest, one = np.zeros((1, 2)), np.ones(1)
    ...             yield Recording(
    ...                 time=np.array([0.0, 0.1]), names=("Ego",), object_types=("car",), x=rest, y=rest, heading=rest,
    ...                 speed=rest, acceleration=rest, length=one, width=one, center_x=0.0 * one,
    ...             )
    """

    options_outside_name = frozenset({*COMMON_OPTIONS, "ego", "worker"})
    settings: dict[str, object]
    requires: ClassVar[tuple[str, ...]] = ()
    in_process: ClassVar[bool] = False
    deterministic: ClassVar[bool] = False
    batched: ClassVar[bool] = False
    takes_driver_parameters: ClassVar[bool] = False
    runs_storyboard: ClassVar[bool] = True
    has_own_boxes: ClassVar[bool] = False
    parameter_passing: Literal["name", "file"] = "name"
    on_notice: Callable[[str], None] = staticmethod(issue_notice_warning)

    @abstractmethod
    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario

        Yields
        ------
        Recording or SimulationError
            One result per scenario, in order; an error if the scenario cannot be run. If there are fewer results than
            scenarios, the remaining scenarios are run again one by one.

        Raises
        ------
        InputError
            No scenario can be run, whatever its values, for example because the scenario file cannot be used.
        """

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Refuse a scenario that this simulator does not support; called before anything is run.

        Parameters
        ----------
        scenario : ScenarioFile

        Raises
        ------
        InputError
            The simulator lacks what the scenario needs. By default nothing is refused.
        """

    def check_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Refuse a sample of scenarios if none of them can be run.

        Runs nothing, and is called before a study is created.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario
            A sample of the scenarios to run.

        Raises
        ------
        InputError
            None of the scenarios can be run, as far as can be known beforehand. By default nothing is refused.
        """

    @classmethod
    def notices(cls, scenario: ScenarioFile, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """List scenario content that has no effect in this simulator.

        Parameters
        ----------
        scenario : ScenarioFile
        values : mapping of str to float or str, optional
            Parameter values, on which the content may depend.

        Returns
        -------
        tuple of Notice
            Empty by default.
        """
        return ()

    @classmethod
    def availability(cls) -> Availability:
        """Return whether the simulator can run on this machine.

        Returns
        -------
        Availability
            By default nothing is missing.
        """
        return Availability()

    def component_versions(self) -> Mapping[str, str]:
        """Return versions of the programs that this simulator uses, which help to find the cause of a problem.

        Returns
        -------
        mapping of str to str
            Version by name of the program; an empty text if the version is unknown. Empty by default, since
            `availability` already gives the version of the simulator itself.
        """
        return {}

    @classmethod
    def own_agents(cls) -> Mapping[str, Mapping[str, object]]:
        """Return the simulator's own driver models (agents) that can drive the entity ``Ego``, for checks.

        Returns
        -------
        mapping of str to mapping
            For each agent, by its name, the options of the simulator that make the agent drive: ``{"SUMO's model
            normal": {"drivers": {"Ego": "normal"}}}``. Empty by default.
        """
        return {}

    def notify(self, sentences: Iterable[str]) -> None:
        """Pass sentences about the present runs to the user; repeated sentences are passed once.

        Parameters
        ----------
        sentences : iterable of str
            Without a full stop. Of sentences that differ only after a semicolon, only the first is passed.
        """
        for sentence in sentences:
            subject = sentence.partition("; ")[0]
            noticed: set[str] = vars(self).setdefault("_noticed", set())
            if subject not in noticed:
                noticed.add(subject)
                self.on_notice(sentence)

    def parallel_instances(self) -> Sequence[Simulator]:
        """Return simulators that may run at the same time, each in its own thread.

        Returns
        -------
        sequence of Simulator
            As many as scenarios can currently run in parallel. Empty by default: the simulator runs in the thread that
            created it.
        """
        return ()

    def cancel(self) -> None:
        """Cancel runs in other threads as soon as possible; does nothing by default."""

    def close(self) -> None:
        """Release resources; does nothing by default."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            with convert_plugin_errors(f"the simulator '{self.name}'", self, "in close"):
                self.close()
        except InputError as error:
            # Its results are valid, so only warn.
            self.on_notice(str(error).removesuffix("."))


def check_seed(seed: int, owner: str) -> int:
    """Return a seed from 0 to 2147483647; raise `InputError`, which names the `owner`, for any other seed."""
    if not (isinstance(seed, int) and 0 <= seed < 2**31):
        raise InputError(f"The seed of {owner} is {seed}; give a whole number from 0 to 2147483647.")
    return seed


def require_settings(simulator: Simulator) -> None:
    """Raise `InputError` if the settings of a simulator are missing, or cannot be stored with a study."""
    settings: object = None
    with suppress(AttributeError, TypeError, ValueError):
        settings = simulator.settings
        json.dumps(settings)
        if isinstance(settings, dict):
            return
    raise InputError(
        f"The simulator '{simulator.name}' has the `settings` {repr_short(settings)}; set a dict of plain JSON values"
        " in its constructor, such as {'time_step': 0.05}."
    )


def check_settings(
    time_step: float, duration: float, on_collision: str, drivers: Mapping[str, DriverLike] | None
) -> dict[str, object]:
    """Check the options common to all simulators with a storyboard, and return them as plain values.

    Parameters
    ----------
    time_step, duration : float
        In s.
    on_collision : {"continue", "stop"}
    drivers : mapping of str to str, SystemUnderTest, Driver or Behaviour, or None
        Driver of each entity.

    Returns
    -------
    dict
        The ``settings`` of a simulator.

    Raises
    ------
    InputError
        A value is out of range, or a value of `drivers` is not a driver.

    Examples
    --------
    The constructor of a simulator calls this function:

    >>> from cornercase.simulators import check_settings
    >>> settings = check_settings(0.05, 60.0, "stop", {"Ego": "normal:reaction_time=0.8"})
    >>> settings["time_step"], settings["on_collision"]
    (0.05, 'stop')
    """
    time_step, duration = check_float("time_step", time_step), check_float("duration", duration)
    if not 0.001 <= time_step <= 1.0:
        raise InputError(f"`time_step` {time_step:g}: choose a time from 0.001 s to 1 s.")
    if not time_step <= duration <= 3600.0:
        raise InputError(f"`duration` {duration:g}: choose a time from one time step to 3600 s.")
    check_str("on_collision", on_collision, ("continue", "stop"))
    return {
        "time_step": time_step,
        "duration": duration,
        "on_collision": on_collision,
        "drivers": {entity: serialize_driver(driver) for entity, driver in sorted(check_drivers(drivers).items())},
    }
