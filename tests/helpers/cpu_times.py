"""What tests cost: ``pytest --cpu-times`` ends with the processor's seconds of those that take longest, and of all.

Time by the clock says little on a busy machine. What a test starts counts where it has ended; a browser that all tests
share is seen in the total alone.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Generator
from typing import Any, Final

import pytest

from helpers.ready_workers import forked_seconds

MOST: Final = 40
_COSTS: dict[str, float] = {}


def spent() -> float:
    """Seconds of this process, of all that it has started and that have ended, and of workers that were forked."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system + forked_seconds()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cpu-times", action="store_true", help="tell which tests take most of the processor's time")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Measure from before its fixtures are made until after they are gone."""
    before = spent()
    try:
        return (yield)
    finally:
        _COSTS[item.nodeid] = spent() - before


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand over what a worker has measured."""
    output: dict[str, Any] | None = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["cpu_times"] = _COSTS


class Summary:
    """Hears of what workers have measured, and tells it at the end."""

    def __init__(self) -> None:
        self.costs: dict[str, float] = {}

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self.costs |= getattr(node, "workeroutput", {}).get("cpu_times", {})

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        costs = self.costs | _COSTS
        functions: defaultdict[str, float] = defaultdict(float)
        for test, seconds in costs.items():
            functions[test.partition("[")[0]] += seconds
        write = terminalreporter.write_line
        terminalreporter.section("seconds of the processor")
        for function, seconds in sorted(functions.items(), key=lambda one: -one[1])[:MOST]:
            write(f"{seconds:8.1f} {function}")
        write(f"{sum(costs.values()):8.1f} all tests, without collecting them")
