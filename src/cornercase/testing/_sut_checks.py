"""Contract checks of systems under test."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import cloudpickle
import numpy as np

from cornercase._common.validation import repr_short
from cornercase.drivers import Driver, SystemUnderTest
from cornercase.drivers._compiled import is_compiled
from cornercase.drivers._equipment import EquippedDriver
from cornercase.drivers._resolve import check_drivers, driver_by_name, resolve_driver
from cornercase.drivers._serialization import serialize_driver
from cornercase.recordings import Recording
from cornercase.recordings._compare import are_bitwise_equal
from cornercase.simulators import Builtin
from cornercase.testing._cases import Cases, default_cases, write_cases_without_limits
from cornercase.testing._contract_check import ContractCheck
from cornercase.testing._request_recording_driver import RequestRecordingDriver

_SETTINGS: Final[dict[str, Any]] = {"time_step": 0.05, "duration": 12.0}
_SHORT: Final = 4.0
_DRIVES: Final = "drives every scenario"
_REPEATS: Final = "repeats itself"
# m/s and m/s²; no vehicle does more, so larger values are in another unit.
_MAX_SPEED: Final = 100.0
_MAX_ACCELERATION: Final = 25.0
# m/s²; largest acceleration that a system may request. Requested positions may cause larger accelerations.
_MAX_REQUEST: Final = 15.0
# rad by which rounding may exceed the largest steering angle.
_ROUNDING: Final = 1e-9
# rad; no vehicle turns further in a step.
_MAX_TURN: Final = 0.5
_SPEEDS: Final = "accelerations are in m/s² and speeds in m/s, so look for km/h, g or a pedal"
_ANGLES: Final = "angles are in rad, so look for degrees"


def sut_checks(system: str | SystemUnderTest | Driver, cases: Sequence[Cases] | None = None) -> list[ContractCheck]:
    """Return the contract checks of a system under test.

    Parameters
    ----------
    system : str, SystemUnderTest or Driver
        An object, a preset such as ``"normal"``, or a text with module, class and options, such as
        ``"my_aeb:Aeb:reaction=0.3"``.
    cases : sequence of Cases, optional
        Scenarios to drive in; by default some examples of cornercase.

    Returns
    -------
    list of ContractCheck

    Examples
    --------
    >>> from cornercase.testing import run_checks, sut_checks
    >>> checks = sut_checks("normal")
    >>> checks[0].name
    'can be stored and sent to another process'
    >>> [result.problem for result in run_checks(checks) if result.problem]  # doctest: +SKIP
    []
    """
    subject = _CheckedSystem(system, cases if cases is not None else default_cases())
    return [
        ContractCheck("can be stored and sent to another process", subject.check_storage),
        ContractCheck(_DRIVES, subject.check_driving),
        ContractCheck(
            "decides what fits m/s² and rad (not seen: signs, units inside)",
            subject.check_requested_units,
            needs=_DRIVES,
        ),
        ContractCheck(_REPEATS, subject.check_repeated_run, needs=_DRIVES),
        # What differs between two equal runs differs in all of these, too.
        ContractCheck("gives the same alone and among other scenarios", subject.check_independence, needs=_REPEATS),
        ContractCheck("knows nothing of the time after", subject.check_causality, needs=_REPEATS),
        ContractCheck("forgets the scenario before", subject.check_reset, needs=_REPEATS),
        ContractCheck("gives the same in two worker processes", subject.check_worker_processes, needs=_REPEATS),
    ]


class _CheckedSystem:
    """System under test, and the scenarios in which it is checked."""

    def __init__(self, system: str | SystemUnderTest | Driver, cases: Sequence[Cases]) -> None:
        self._system, self._cases = system, cases
        self._drives: bool | None = None

    def check_storage(self) -> None:
        created = self._create()
        description = serialize_driver(created)
        _require_json_value(description)
        if not isinstance(self._system, str):
            sent = cloudpickle.loads(cloudpickle.dumps(created))
            assert serialize_driver(sent) == description, (
                f"A copy for another process has the settings {repr_short(serialize_driver(sent))} instead of"
                f" {repr_short(description)}; look at what pickling leaves out, as in __getstate__ or __reduce__."
            )

    def check_driving(self) -> None:
        # Code that the user names runs in a separate process, which may crash.
        self._drives = False
        driver = resolve_driver(self._system) if isinstance(self._system, str) else self._create()
        for cases in self._cases:
            cases.run("builtin", drivers={cases.entity: driver}, **_SETTINGS)
        self._drives = True

    def check_requested_units(self) -> None:
        self._require_driving()
        for cases in self._cases:
            self._run_observed(cases)
        # Limits in the file would hide what the system requests.
        with TemporaryDirectory() as folder:
            cases = write_cases_without_limits(Path(folder))
            for recording in self._run_observed(cases):
                e = recording.entity_index(cases.entity)
                turns = np.abs(np.diff(np.unwrap(recording.heading[e])))
                for values, limit, seen, hint in (
                    (recording.acceleration[e, 1:], _MAX_ACCELERATION, "it accelerates by {} m/s²", _SPEEDS),
                    (recording.speed[e, 1:], _MAX_SPEED, "it drives at {} m/s", _SPEEDS),
                    (turns, _MAX_TURN, "it turns by {} rad in a step", _ANGLES),
                ):
                    size = np.nan_to_num(np.abs(values))
                    k = int(size.argmax())
                    what = f"At {recording.time[k + 1]:g} s {seen.format(f'{values[k]:.3g}')}"
                    assert size[k] < limit, f"{what}, which no vehicle does; {hint}."

    def _run_observed(self, cases: Cases) -> list[Recording]:
        """Run the scenarios, and check that a vehicle can follow what the system requests; return the recordings."""
        driver, observed = self._create(), None
        decides = driver.driver if isinstance(driver, EquippedDriver) else driver
        if not is_compiled(decides):
            observed = RequestRecordingDriver(decides)
            driver = (
                EquippedDriver(observed, driver.sensors, driver.vehicle)
                if isinstance(driver, EquippedDriver)
                else observed
            )
        recordings = self._run(cases, driver=driver)
        if observed is not None:
            _require_feasible(observed)
        return recordings

    def check_repeated_run(self) -> None:
        for cases in self._cases:
            _require_same(
                self._run(cases),
                self._run(cases),
                "A second run of the same scenario",
                "random numbers that are not those of `rng`, a clock, or something that outlives a run, as a variable"
                " of the class or the module",
            )

    def check_independence(self) -> None:
        for cases in self._cases:
            together = self._run(cases)
            last = len(together) - 1
            reverse = self._run(cases, range(last, -1, -1))
            shared = (
                "something that scenarios share, as a variable of the class or the module, or a sum over all of them"
            )
            _require_same(together[::-1], reverse, "In another order of the scenarios, one", shared)
            _require_same(together[:1], self._run(cases, [0]), "Alone, a scenario", shared)

    def check_causality(self) -> None:
        cases = self._cases[0]
        whole, started = self._run(cases), self._run(cases, duration=_SHORT)
        for k, (long, short) in enumerate(zip(whole, started, strict=True)):
            begin = _first_difference(long, short)
            assert begin is None, (
                f"If scenario {k} ends at {_SHORT:g} s, it differs from {begin:g} s on; look for something that"
                " outlives a run, as a variable of the class or the module, or a file."
            )

    def check_reset(self) -> None:
        cases, other = self._cases[0], self._cases[-1]
        driver = self._create()
        before = self._run(cases, driver=driver)
        self._run(other, driver=driver, duration=_SHORT)
        _require_same(
            before,
            self._run(cases, driver=driver),
            "After another scenario, one",
            "something that `start` does not set again: an attribute, or a variable of the class or the module",
        )

    def check_worker_processes(self) -> None:
        self._require_driving()
        cases = self._cases[0]
        driver = resolve_driver(self._system) if isinstance(self._system, str) else self._create()
        in_workers = cases.run("builtin", workers=2, drivers={cases.entity: driver}, **_SETTINGS)
        _require_same(
            self._run(cases),
            in_workers,
            "In two worker processes, a scenario",
            "what differs between processes, which share no class or module: the hash of a text, the order of a set,"
            " the id of the process, or a variable of the class or the module",
        )

    def _create(self) -> Driver:
        if isinstance(self._system, str):
            return driver_by_name(self._system)
        driver = check_drivers({"Ego": self._system})["Ego"]
        assert not isinstance(driver, str)
        return driver

    def _require_driving(self) -> None:
        if self._drives is None:
            self.check_driving()
        assert self._drives, "It was not checked, as it does not drive every scenario."

    def _run(
        self, cases: Cases, rows: Sequence[int] | None = None, *, driver: Driver | None = None, **options: float
    ) -> list[Recording]:
        """Run the scenarios in this process."""
        self._require_driving()
        simulator = Builtin(drivers={cases.entity: driver or self._create()}, **{**_SETTINGS, **options})
        return cases.run(simulator, rows)


def _require_json_value(description: object) -> None:
    """Require that settings are plain JSON values, so that they are stored unchanged."""
    for name, value in description.items() if isinstance(description, Mapping) else ():
        if name == "settings":
            _require_json_value(value)
            continue
        try:
            is_plain = json.loads(json.dumps(value)) == value
        except (TypeError, ValueError):
            is_plain = False
        assert is_plain, (
            f"Its setting '{name}' is {repr_short(value)}, which is no plain JSON value; give a number, a text, true or"
            " false, or a list or dict of these."
        )


def _require_feasible(observed: RequestRecordingDriver) -> None:
    """Require that a vehicle can follow the strongest requests of a driver."""
    acceleration, steering, bound = observed.most_acceleration, observed.most_steering, observed.max_steering
    assert abs(acceleration.value) <= _MAX_REQUEST, (
        f"At {acceleration.time:g} s it asks for an acceleration of {acceleration.value:.3g} m/s², and no vehicle does"
        f" more than {_MAX_REQUEST:g}; accelerations are in m/s² and speeds in m/s. If it is meant, let the system"
        " limit it."
    )
    assert abs(steering.value) <= bound + _ROUNDING, (
        f"At {steering.time:g} s it asks for a steering angle of {steering.value:.3g} rad, and the front wheels turn"
        f" by at most {bound:.3g} rad ({np.degrees(bound):.0f}°); angles are in rad: are these degrees? If it is meant,"
        " let the system limit it to max_steering, which `start` is given."
    )


def _require_same(first: Sequence[Recording], second: Sequence[Recording], what: str, suspects: str) -> None:
    for k, (recording, repeated) in enumerate(zip(first, second, strict=True)):
        if not are_bitwise_equal(recording, repeated):
            begin = _first_difference(recording, repeated)
            at = min(recording.time[-1], repeated.time[-1]) if begin is None else begin
            raise AssertionError(f"{what} differs, first at {at:g} s (scenario {k}); look for {suspects}.")


def _first_difference(first: Recording, second: Recording) -> float | None:
    """Return the first instant in s at which the motion in two recordings differs; None if it never does."""
    count = min(len(first.time), len(second.time))
    differs = np.zeros(count, dtype=np.bool_)
    for name in ("x", "y", "heading", "speed"):
        values, others = getattr(first, name)[:, :count], getattr(second, name)[:, :count]
        differs |= ((values != others) & ~(np.isnan(values) & np.isnan(others))).any(axis=0)
    return float(first.time[differs.argmax()]) if differs.any() else None
