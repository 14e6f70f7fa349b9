"""Functions that list all contract checks of an object, run them, or make pytest tests of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from cornercase._common.errors import InputError
from cornercase._common.validation import repr_short
from cornercase.drivers import Driver, SystemUnderTest
from cornercase.metrics import Metric
from cornercase.optimizers import Optimizer
from cornercase.simulators import Simulator
from cornercase.testing._contract_check import ContractCheck, run_checks
from cornercase.testing._metric_checks import metric_checks
from cornercase.testing._optimizer_checks import optimizer_checks
from cornercase.testing._simulator_checks import simulator_checks
from cornercase.testing._sut_checks import sut_checks

_CHECKS: tuple[tuple[tuple[type[Any], ...], Callable[[Any], list[ContractCheck]]], ...] = (
    ((SystemUnderTest, Driver), sut_checks),
    ((Simulator,), simulator_checks),
    ((Metric,), metric_checks),
    ((Optimizer,), optimizer_checks),
)


def list_checks(candidate: SystemUnderTest | Driver | Simulator | Metric | Optimizer) -> list[ContractCheck]:
    """Return the contract checks of an object; its base class decides which checks these are.

    Parameters
    ----------
    candidate : SystemUnderTest, Driver, Simulator, Metric or Optimizer
        Object to check.

    Returns
    -------
    list of ContractCheck

    Raises
    ------
    InputError
        `candidate` is of no such class.

    Examples
    --------
    >>> from cornercase.optimizers import OPTIMIZERS
    >>> from cornercase.testing import list_checks
    >>> list_checks(OPTIMIZERS.create("sobol"))[0].name
    'proposes points of the unit cube'
    """
    for bases, checks in _CHECKS:
        if isinstance(candidate, bases):
            return checks(candidate)
    raise InputError(
        f"`candidate` {repr_short(candidate)}: give a SystemUnderTest, Driver, Simulator, Metric or Optimizer."
    )


def check(candidate: SystemUnderTest | Driver | Simulator | Metric | Optimizer) -> None:
    """Run all contract checks of an object.

    Parameters
    ----------
    candidate : SystemUnderTest, Driver, Simulator, Metric or Optimizer
        Object to check.

    Raises
    ------
    AssertionError
        A check failed. The message has a line for each failed check.
    InputError
        `candidate` is of no such class.

    Examples
    --------
    >>> from cornercase.optimizers import OPTIMIZERS
    >>> from cornercase.testing import check
    >>> check(OPTIMIZERS.create("sobol"))
    """
    failed = [result for result in run_checks(list_checks(candidate)) if result.problem and not result.blocked_by]
    if failed:
        raise AssertionError("\n".join(f"{result.name}: {result.problem}" for result in failed))


def parametrize_with_checks(
    candidates: Iterable[SystemUnderTest | Driver | Simulator | Metric | Optimizer],
) -> Callable[[Any], Any]:
    """Make one pytest test for each contract check of each object.

    Parameters
    ----------
    candidates : iterable of SystemUnderTest, Driver, Simulator, Metric or Optimizer

    Returns
    -------
    callable
        Decorator for a test function with the argument ``check``, which is a `ContractCheck`.

    Examples
    --------
    In a test module, with your own object instead of the optimizer:

    >>> from cornercase.testing import parametrize_with_checks
    >>> from cornercase.optimizers import OPTIMIZERS
    >>> @parametrize_with_checks([OPTIMIZERS.create("sobol")])
    ... def test_contract(check):
    ...     check.run()
    """
    import pytest

    listed = [(candidate, check) for candidate in candidates for check in list_checks(candidate)]
    return pytest.mark.parametrize(
        "check",
        [check for _, check in listed],
        ids=[f"{type(candidate).__name__} {check.name}" for candidate, check in listed],
    )
