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
    needs : str, default ""
        Name of an earlier check without which this one says nothing; empty if there is none.

    Examples
    --------
    >>> from cornercase.testing import ContractCheck, run_checks
    >>> def check_that_it_is_fast():
    ...     raise AssertionError("It takes 3 s per scenario.")
    >>> [result.problem for result in run_checks([ContractCheck("is fast", check_that_it_is_fast)])]
    ['It takes 3 s per scenario.']
    """

    name: str
    run: Callable[[], None]
    needs: str = ""


class NotTriedError(Exception):
    """A check cannot be tried; the message says why, as a sentence."""


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
    blocked_by : str, default ""
        Name of the check that failed and that this one needs, so that it was not run; empty if it was run.
    not_tried : str, default ""
        Why it could not be tried, as a sentence; empty if it was tried.

    Examples
    --------
    >>> from cornercase.testing import metric_checks, run_checks
    >>> results = list(run_checks(metric_checks("ttc")))
    >>> [result.name for result in results if result.problem]
    []
    """

    name: str
    problem: str
    seconds: float
    blocked_by: str = ""
    not_tried: str = ""


def run_checks(checks: Iterable[ContractCheck]) -> Iterator[CheckResult]:
    """Run checks one after the other, also after one that fails, except for those that need it.

    Parameters
    ----------
    checks : iterable of ContractCheck

    Yields
    ------
    CheckResult
        In order.

    Examples
    --------
    >>> from cornercase.testing import optimizer_checks, run_checks
    >>> for result in run_checks(optimizer_checks("sobol")[:2]):
    ...     print(result.name, "–", result.problem or "ok")
    proposes points of the unit cube – ok
    proposes the same for the same seed – ok
    """
    # By name of a check that failed or was not run: the one that failed.
    causes = dict[str, str]()
    with collect_interrupts() as raise_interrupt:
        for check in checks:
            if cause := causes.get(check.needs):
                causes[check.name] = cause
                yield CheckResult(check.name, f"It was not run, as it needs '{cause}'.", 0.0, cause)
                continue
            begin, requests, not_tried = time.perf_counter(), count_requests(), ""
            try:
                check.run()
                problem = ""
            except NotTriedError as error:
                problem, not_tried = "", str(error)
            except (AssertionError, InputError) as error:
                problem = str(error)
            except BaseException as error:
                reraise_termination_request(error, requests)
                problem = f"It failed: {describe_error(error)}."
            raise_interrupt()
            if problem:
                causes[check.name] = check.name
            yield CheckResult(check.name, problem, time.perf_counter() - begin, not_tried=not_tried)
