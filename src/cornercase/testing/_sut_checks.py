"""Checks of systems under test."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import cloudpickle
import numpy as np

from cornercase.drivers import Driver, SystemUnderTest
from cornercase.drivers._description import serialize_driver
from cornercase.drivers._resolve import check_drivers, driver_by_name, resolve_driver
from cornercase.recordings import Recording
from cornercase.recordings._compare import are_bitwise_equal
from cornercase.simulators import Builtin
from cornercase.testing._cases import Cases, default_cases, unlimited_cases
from cornercase.testing._contract_check import ContractCheck

_SETTINGS: Final[dict[str, Any]] = {"time_step": 0.05, "duration": 12.0}
_SHORT: Final = 4.0
# m/s and m/s²; no vehicle does more, so that something else is in its unit.
_MAX_SPEED: Final = 100.0
_MAX_ACCELERATION: Final = 25.0
# rad; no vehicle turns further in a step.
_MAX_TURN: Final = 0.5


def sut_checks(system: str | SystemUnderTest | Driver, cases: Sequence[Cases] | None = None) -> list[ContractCheck]:
    """Return the checks of a system under test.

    Parameters
    ----------
    system : str, SystemUnderTest or Driver
        As for ``drivers``: an object, or a text such as ``"my_aeb:Aeb:reaction=0.3"``.
    cases : sequence of Cases, optional
        Scenarios to drive in; by default some that come with cornercase.

    Returns
    -------
    list of ContractCheck
    """
    subject = _Subject(system, cases if cases is not None else default_cases())
    return [
        ContractCheck("can be stored and sent to another process", subject.can_be_stored),
        ContractCheck("drives every scenario", subject.drives),
        ContractCheck("keeps to units: m, rad, s", subject.keeps_units),
        ContractCheck("repeats itself", subject.repeats),
        ContractCheck("gives the same alone and among other scenarios", subject.is_independent),
        ContractCheck("knows nothing of the time after", subject.is_causal),
        ContractCheck("forgets the scenario before", subject.forgets),
        ContractCheck("gives the same in two worker processes", subject.is_same_in_workers),
    ]


class _Subject:
    """A system under test, and the scenarios that it is checked in."""

    def __init__(self, system: str | SystemUnderTest | Driver, cases: Sequence[Cases]) -> None:
        self._system, self._cases = system, cases
        self._drives: bool | None = None

    def can_be_stored(self) -> None:
        created = self._create()
        description = serialize_driver(created)
        stored = json.loads(json.dumps(description))
        assert stored == description, f"Its settings {description} are no plain JSON values: numbers, texts and lists."
        if not isinstance(self._system, str):
            sent = cloudpickle.loads(cloudpickle.dumps(created))
            assert serialize_driver(sent) == description, "Another process would get other settings than this one has."

    def drives(self) -> None:
        # Code that the user names runs in a process of its own, which may crash.
        self._drives = False
        driver = resolve_driver(self._system) if isinstance(self._system, str) else self._create()
        for cases in self._cases:
            cases.run("builtin", drivers={cases.entity: driver}, **_SETTINGS)
        self._drives = True

    def keeps_units(self) -> None:
        # Without limits in the file, which would hide what the system asks for.
        with TemporaryDirectory() as folder:
            cases = unlimited_cases(Path(folder))
            for recording in self._run(cases):
                e = recording.entity_index(cases.entity)
                fastest = np.nanmax(np.abs(recording.speed[e]))
                hardest = np.nanmax(np.abs(recording.acceleration[e, 1:]), initial=0.0)
                turn = np.nanmax(np.abs(np.diff(np.unwrap(recording.heading[e]))), initial=0.0)
                assert hardest < _MAX_ACCELERATION, f"It accelerates by {hardest:.0f} m/s²; accelerations are in m/s²."
                assert fastest < _MAX_SPEED, f"It drives at {fastest:.0f} m/s; speeds are in m/s."
                assert turn < _MAX_TURN, f"It turns by {turn:.2f} rad in a step; angles are in rad."

    def repeats(self) -> None:
        for cases in self._cases:
            _require_same(self._run(cases), self._run(cases), "A second run differs")

    def is_independent(self) -> None:
        for cases in self._cases:
            together = self._run(cases)
            last = len(together) - 1
            reverse = self._run(cases, range(last, -1, -1))
            _require_same(together[::-1], reverse, "Another order of scenarios differs")
            _require_same(together[:1], self._run(cases, [0]), "Alone, a scenario differs")

    def is_causal(self) -> None:
        cases = self._cases[0]
        whole, started = self._run(cases), self._run(cases, duration=_SHORT)
        for long, short in zip(whole, started, strict=True):
            count = min(len(long.time), len(short.time))
            same = all(
                np.array_equal(getattr(long, name)[:, :count], getattr(short, name)[:, :count], equal_nan=True)
                for name in ("x", "y", "heading", "speed")
            )
            assert same, f"The first {short.time[-1]:g} s are others if the scenario ends then: does it use a clock?"

    def forgets(self) -> None:
        cases, other = self._cases[0], self._cases[-1]
        driver = self._create()
        before = self._run(cases, driver=driver)
        self._run(other, driver=driver, duration=_SHORT)
        _require_same(before, self._run(cases, driver=driver), "After another scenario it drives otherwise")

    def is_same_in_workers(self) -> None:
        self._require_driving()
        cases = self._cases[0]
        driver = resolve_driver(self._system) if isinstance(self._system, str) else self._create()
        in_workers = cases.run("builtin", workers=2, drivers={cases.entity: driver}, **_SETTINGS)
        _require_same(
            self._run(cases),
            in_workers,
            "In two worker processes, which share no class or module with this one, it drives otherwise",
        )

    def _create(self) -> Driver:
        if isinstance(self._system, str):
            return driver_by_name(self._system)
        driver = check_drivers({"Ego": self._system})["Ego"]
        assert not isinstance(driver, str)
        return driver

    def _require_driving(self) -> None:
        if self._drives is None:
            self.drives()
        assert self._drives, "It was not checked, as it does not drive every scenario."

    def _run(
        self, cases: Cases, rows: Sequence[int] | None = None, *, driver: Driver | None = None, **options: float
    ) -> list[Recording]:
        """Run in this process."""
        self._require_driving()
        simulator = Builtin(drivers={cases.entity: driver or self._create()}, **{**_SETTINGS, **options})
        return cases.run(simulator, rows)


def _require_same(first: Sequence[Recording], second: Sequence[Recording], sentence: str) -> None:
    for k, (recording, repeated) in enumerate(zip(first, second, strict=True)):
        if not are_bitwise_equal(recording, repeated):
            raise AssertionError(f"{sentence} {_first_difference(recording, repeated)} (scenario {k}).")


def _first_difference(first: Recording, second: Recording) -> str:
    count = min(len(first.time), len(second.time))
    differs = np.zeros(count, dtype=np.bool_)
    for name in ("x", "y", "heading", "speed"):
        values, others = getattr(first, name)[:, :count], getattr(second, name)[:, :count]
        differs |= ((values != others) & ~(np.isnan(values) & np.isnan(others))).any(axis=0)
    at = first.time[int(differs.argmax())] if differs.any() else first.time[count - 1]
    return f"from {at:g} s on"
