"""A check: what has to hold, as a sentence and a function."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import describe_error, reraise_termination_request
from cornercase._common.process.signals import collect_interrupts, count_requests


@dataclass(frozen=True)
class ContractCheck:
    """One thing that has to hold.

    Attributes
    ----------
    name : str
        What has to hold, in words: ``"repeats itself"``.
    run : callable
        Raises `AssertionError` with a sentence if it does not hold.
    """

    name: str
    run: Callable[[], None]


@dataclass(frozen=True)
class CheckResult:
    """What came of a check.

    Attributes
    ----------
    name : str
        As in `ContractCheck`.
    problem : str
        Why it does not hold, as a sentence; empty if it holds.
    seconds : float
        How long it took.
    """

    name: str
    problem: str
    seconds: float


def run_checks(checks: Iterable[ContractCheck]) -> Iterator[CheckResult]:
    """Run checks one after the other, also after one that fails.

    Parameters
    ----------
    checks : iterable of ContractCheck

    Yields
    ------
    CheckResult
        In order.
    """
    with collect_interrupts() as raise_interrupt:
        for check in checks:
            begin, requests = time.perf_counter(), count_requests()
            try:
                check.run()
                problem = ""
            except (AssertionError, InputError) as error:
                problem = str(error)
            except BaseException as error:
                reraise_termination_request(error, requests)
                problem = f"It failed: {describe_error(error)}."
            raise_interrupt()
            yield CheckResult(check.name, problem, time.perf_counter() - begin)
