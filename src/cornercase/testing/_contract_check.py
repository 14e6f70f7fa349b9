"""Contract checks, each with a name and a function, and their results."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import describe_error, reraise_termination_request
from cornercase._common.process.signals import collect_interrupts, count_termination_requests


@dataclass(frozen=True)
class ContractCheck:
    """Check of one property that a system under test, simulator, metric or optimizer must have.

    Attributes
    ----------
    name : str
        The property in words, such as ``"repeats itself"``.
    run : callable
        Raises `AssertionError` with a sentence if the property does not hold.
    needs : str, default ""
        Name of an earlier check; if the earlier check fails, this check is not run. Empty if there is none.

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
    """Error if a check cannot be tried here; the message says why, as a sentence."""


@dataclass(frozen=True)
class CheckResult:
    """Result of a contract check.

    Attributes
    ----------
    name : str
        The property that was checked, as in `ContractCheck`.
    problem : str
        Why the property does not hold, or that the check was not run, as a sentence; empty if no problem was found.
    seconds : float
        Duration of the check.
    blocked_by : str, default ""
        Name of the failed check that prevented this check; empty if this check was run.
    not_tried : str, default ""
        Why the check could not be tried, as a sentence; empty if the check was tried.

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
    """Run checks one after the other; checks that need a failed check are not run.

    Parameters
    ----------
    checks : iterable of ContractCheck

    Yields
    ------
    CheckResult
        Result of each check, in order.

    Examples
    --------
    >>> from cornercase.testing import optimizer_checks, run_checks
    >>> for result in run_checks(optimizer_checks("sobol")[:2]):
    ...     print(result.name, "–", result.problem or "ok")
    proposes points of the unit cube – ok
    proposes the same for the same seed – ok
    """
    # Name of the failed check, by name of each check that failed or was not run.
    causes = dict[str, str]()
    with collect_interrupts() as raise_interrupt:
        for check in checks:
            if cause := causes.get(check.needs):
                causes[check.name] = cause
                yield CheckResult(check.name, f"It was not run, as it needs '{cause}'.", 0.0, cause)
                continue
            begin, requests, not_tried = time.perf_counter(), count_termination_requests(), ""
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
