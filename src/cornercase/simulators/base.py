"""The base class of simulators, and checks of the options that several have."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

from cornercase._common.arguments import number, text
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.ledger import Notice, warn
from cornercase._common.parts import guarded
from cornercase.drivers import Driver, describe_driver
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value


@dataclass(frozen=True)
class Availability:
    """Whether a simulator can run here.

    Attributes
    ----------
    version : str
        Empty where it is not known.
    missing : str
        What is missing and how to get it, as a sentence; empty where nothing is.
    abilities : tuple of str
        What it can do, in a few words each.
    """

    version: str = ""
    missing: str = ""
    abilities: tuple[str, ...] = ()


class Simulator(ABC):
    """Runs concrete scenarios; the base class of all simulators.

    A simulator of your own is a subclass with `settings` and `run`, named in the entry-point group
    ``cornercase.simulators``. What it declares besides has defaults that are right for a program that runs one
    scenario after the other.

    The options of its constructor are keyword arguments. It gets those that it declares of ``time_step`` and
    ``duration`` in s, ``on_collision``, which is ``"continue"`` or ``"stop"``, and ``drivers``, a driver or its name by
    entity; drivers for a simulator that does not declare them are refused. More come from behind the colon of its name
    (``"esmini:seed=3"``); those that it does not declare are refused, also if it takes ``**options``.

    Attributes
    ----------
    name : str
        As it is registered; with its options where it was made with some: ``"esmini:seed=3"``.
    settings : dict
        Everything besides the scenario that the recordings depend on, as plain JSON values. It is stored with a
        study, and a study is continued only with the same settings.
    needs : tuple of str
        Options that it gets besides: ``"ego"``, the name of the entity under test, and ``"worker"``, the number of its
        worker process from 0 on.
    in_process : bool, default False
        Whether it may run in cornercase's own process: it does not crash, does not hang, and leaves nothing behind.
    repeats_itself : bool, default False
        Whether the same scenario with the same settings gives the same recording, to the last bit. Then any difference
        of two recordings is one of what is tested. It is tried with the first scenario of each study.
    takes_batches : bool, default False
        Whether many scenarios in one call take less time than one after the other. Such a simulator is given as
        many at once as there are; any other gets them one by one.
    values_by : {"name", "file"}, default "name"
        How it takes the values of parameters. By name, ``concrete.values`` holds those of all parameters that the
        scenario file declares, varied or not. By file, it reads the file, and ``concrete.values`` holds those that
        differ from it: none, where the scenario is a file of its own, as in a suite.
    on_notice : callable
        Takes a sentence for whoever runs scenarios. It becomes a `NoticeWarning`; in another process, it is sent to the
        one that asks.

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
    ...                 time=np.array([0.0, 0.1]), names=("Ego",), kinds=("car",), x=rest, y=rest, heading=rest,
    ...                 speed=rest, acceleration=rest, length=one, width=one, center_x=0.0 * one,
    ...             )
    """

    name: str
    settings: dict[str, object]
    needs: ClassVar[tuple[str, ...]] = ()
    in_process: ClassVar[bool] = False
    repeats_itself: ClassVar[bool] = False
    takes_batches: ClassVar[bool] = False
    values_by: Literal["name", "file"] = "name"
    on_notice: Callable[[str], None] = staticmethod(warn)

    @abstractmethod
    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario

        Yields
        ------
        Recording or SimulationError
            One for each scenario, in order, by which they are told apart: a scenario that cannot be run gives an error,
            never nothing. Where fewer come than there are scenarios, the rest is run again, one by one.

        Raises
        ------
        InputError
            None of them can run, whatever its values are; the scenario file cannot be used, for one.
        """

    def require_means(self, scenario: Scenario) -> None:  # noqa: B027 - optional
        """Refuse a scenario that this simulator cannot run; asked before anything is run.

        Parameters
        ----------
        scenario : Scenario

        Raises
        ------
        InputError
            It lacks what the scenario asks for. By default nothing is refused.
        """

    def require_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:  # noqa: B027 - optional
        """Refuse scenarios of which none can be run, without running any; asked before there is a study.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario
            Some of those that may be run.

        Raises
        ------
        InputError
            None of them can be run, as far as that shows beforehand. By default nothing is refused.
        """

    @classmethod
    def notices(cls, scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """Name what of a scenario changes nothing in this simulator.

        Parameters
        ----------
        scenario : Scenario
        values : mapping of str to float or str, optional
            Of its parameters, on which may depend what is read.

        Returns
        -------
        tuple of Notice
            Empty by default.
        """
        return ()

    @classmethod
    def availability(cls) -> Availability:
        """Tell whether it can run here.

        Returns
        -------
        Availability
            By default nothing is missing.
        """
        return Availability()

    def notice(self, sentences: Iterable[str]) -> None:
        """Tell whoever runs scenarios what they should know of these runs; each sentence once.

        Parameters
        ----------
        sentences : iterable of str
            Without a full stop. If several differ only behind a semicolon, the first of them is told.
        """
        for sentence in sentences:
            subject = sentence.partition("; ")[0]
            noticed: set[str] = vars(self).setdefault("_noticed", set())
            if subject not in noticed:
                noticed.add(subject)
                self.on_notice(sentence)

    def beside(self) -> Sequence[Simulator]:
        """Give the simulators that may run at the same time, each in a thread of its own.

        Returns
        -------
        sequence of Simulator
            As many as there are places for a scenario by now. Empty by default: it runs in the thread that made it.
        """
        return ()

    def give_up(self) -> None:  # noqa: B027 - optional
        """End what it runs in another thread, soon; by default nothing does."""

    def close(self) -> None:  # noqa: B027 - optional
        """End what it has started; by default there is nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            with guarded(f"the simulator '{self.name}'", self, "in close"):
                self.close()
        except InputError as error:
            # What it has run is there, and counts.
            self.on_notice(str(error).removesuffix("."))


def checked_seed(seed: int, whose: str) -> int:
    """Return a seed that a simulator takes.

    Parameters
    ----------
    seed : int
    whose : str
        For the message.

    Returns
    -------
    int

    Raises
    ------
    InputError
        It is not a whole number from 0 to 2147483647.
    """
    if not (isinstance(seed, int) and 0 <= seed < 2**31):
        raise InputError(f"The seed of {whose} is {seed}; give a whole number from 0 to 2147483647.")
    return seed


def checked_settings(
    time_step: float, duration: float, on_collision: str, drivers: Mapping[str, str | Driver] | None
) -> dict[str, object]:
    """Return the settings that all simulators with a storyboard have, as plain values.

    Parameters
    ----------
    time_step, duration : float
        s.
    on_collision : str
    drivers : mapping of str to str or Driver, or None
        By entity.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        One is out of range.
    """
    time_step, duration = number("time_step", time_step), number("duration", duration)
    if not 0.001 <= time_step <= 1.0:
        raise InputError(f"`time_step` {time_step:g}: choose a time from 0.001 s to 1 s.")
    if not time_step <= duration <= 3600.0:
        raise InputError(f"`duration` {duration:g}: choose a time from one time step to 3600 s.")
    text("on_collision", on_collision, ("continue", "stop"))
    return {
        "time_step": time_step,
        "duration": duration,
        "on_collision": on_collision,
        "drivers": {entity: describe_driver(driver) for entity, driver in sorted((drivers or {}).items())},
    }
