"""cornercase's own simulator: OpenSCENARIO on OpenDRIVE roads, all concrete scenarios at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import NamedTuple
from weakref import WeakSet

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.ledger import Notice
from cornercase._common.places import of_file
from cornercase._common.platform import available_cpus
from cornercase._common.version import __version__
from cornercase.drivers import Driver, decides_compiled
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value, VariesError
from cornercase.simulators.base import Availability, Simulator, checked_settings
from cornercase.simulators.builtin.batch import Batch
from cornercase.simulators.builtin.effect import notices
from cornercase.simulators.builtin.prepared import PreparedScenario

# Limits of a batch: bytes of motion if all scenarios last the maximum duration, and scenarios. The overhead of a batch
# equals that of several hundred scenarios.
_MOST_BYTES = 800_000_000
_LARGEST_BATCH = 4096
# Scenarios that are worth a batch of their own: while the storyboard of one is in Python, another one runs.
_WORTH_A_BATCH = 512
# Bytes of recordings that are made together.
_MOST_RECORDED = 4_000_000


class BuiltinSimulator(Simulator):
    """Simulates all concrete scenarios at once, one or a hundred thousand.

    Parameters
    ----------
    time_step : float, default 0.05
        s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether entities pass through each other, as in CarMaker, or the run ends, as in CARLA. A scenario file's own
        stop trigger applies in both cases.
    drivers : mapping of str to str or Driver, optional
        Driver of each entity: the name of a preset, or a driver. Overrides the file's controllers.

    Raises
    ------
    InputError
        An option is out of range.
    """

    name = "builtin"
    in_process = True
    repeats_itself = True
    takes_batches = True
    values_by = "file"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, str | Driver] | None = None,
    ) -> None:
        self.settings = checked_settings(time_step, duration, on_collision, drivers)
        self._time_step, self._duration, self._on_collision = time_step, duration, on_collision
        self._drivers = dict(drivers or {})
        self._prepared: PreparedScenario | None = None

    @classmethod
    def availability(cls) -> Availability:
        """Return version and features; it can always run."""
        return Availability(
            version=__version__,
            missing="",
            abilities=(
                "pedestrians", "drivers of your own", "occlusion", "collisions go on or end the run", "deterministic",
                "batches",
            ),
        )  # fmt: skip

    @classmethod
    def notices(cls, scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """Notices about parts of a scenario that have no effect here."""
        return notices(scenario, values)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Yield one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            A scenario file cannot be used.
        """
        for portion in self._portions(concretes):
            yield from self._run(portion)

    def require_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Raise `InputError`, with the first one's problem, if none of the scenarios can be run. Runs none."""
        first_error: InputError | None = None
        for concrete in concretes:
            prepared = self._prepare(concrete)
            unusable = prepared.unusable([concrete.values])
            try:
                if unusable:
                    raise InputError(of_file(concrete.path, f"{unusable[0]}."))
                self._batch(prepared, [concrete])
            except InputError as error:
                first_error = first_error or error
            else:
                return
        if first_error is not None:
            raise first_error

    def _portions(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Sequence[ConcreteScenario]]:
        instants = int(self._duration / self._time_step) + 2
        begin, total, needed = 0, 0, 0
        previous: ConcreteScenario | None = None
        for i, concrete in enumerate(concretes):
            if previous is None or concrete.path is not previous.path or concrete.source is not previous.source:
                needed = self._prepare(concrete).bytes_for(instants, bool(self._drivers))
            previous = concrete
            if i > begin and (total + needed > _MOST_BYTES or i - begin == _LARGEST_BATCH):
                yield concretes[begin:i]
                begin, total = i, 0
            total += needed
        if begin < len(concretes):
            yield concretes[begin:]

    def _run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        files: dict[tuple[Path, Scenario | None], list[int]] = {}
        for i, concrete in enumerate(concretes):
            files.setdefault((concrete.path, concrete.source), []).append(i)
        with ThreadPoolExecutor(available_cpus()) as executor:
            run = _PortionRun(concretes, {}, executor, Lock(), WeakSet(), [])
            try:
                for indices in files.values():
                    self._run_file(run, indices)
                # Recordings of the first batch are made while the next ones still run.
                yield from _made(run.progress, run.gil_lock)
                for sentences in run.remarks:
                    self.notice(sentences)
            except BaseException:
                # The executor waits for its threads: do not let an interrupt wait for the remaining batches.
                for batch in run.batches:
                    batch.halt()
                raise

    def _run_file(self, run: _PortionRun, indices: list[int]) -> None:
        prepared = self._prepare(run.concretes[indices[0]])
        for entity in self._drivers:
            prepared.scenario.require_entity(entity, "driven entity")
        invalid = prepared.unusable([run.concretes[i].values for i in indices])
        run.progress.update((indices[k], SimulationError(reason)) for k, reason in invalid.items())
        for group in _groups(prepared, run.concretes, [i for i in indices if i not in run.progress]):
            self._run_group(run, prepared, group)

    def _prepare(self, concrete: ConcreteScenario) -> PreparedScenario:
        """Prepared file of a concrete scenario: that of the last run, if its content is the same."""
        scenario = concrete.scenario(None if self._prepared is None else self._prepared.scenario)
        if self._prepared is None or self._prepared.scenario is not scenario:
            self._prepared = PreparedScenario.of(scenario)
        return self._prepared

    def _batch(self, prepared: PreparedScenario, concretes: Sequence[ConcreteScenario]) -> Batch:
        return Batch(
            prepared,
            [concrete.values for concrete in concretes],
            self._time_step,
            self._duration,
            self._on_collision == "stop",
            self._drivers,
        )

    def _run_group(self, run: _PortionRun, prepared: PreparedScenario, indices: list[int]) -> None:
        """Start to run scenarios that could share a batch; if there is one batch, it has run on return."""
        parts, started = self._parts(prepared, indices), list[Future[Batch]]()
        try:
            for part in parts:
                with run.gil_lock:
                    batch = self._form(run, prepared, part)
                if batch is not None:
                    # A compiled batch already runs while the next one is made; a batch in Python would block it.
                    started.append(run.start(batch, 1 if batch.in_python else len(parts)))
                    run.progress.update((i, (started[-1], k)) for k, i in enumerate(part))
                    if batch.failure is not None and len(part) > 1:
                        # A driver failed in some of them: rerun them in smaller batches, so that only these fail.
                        size = (len(part) + 1) // 2 if batch.failure.splits else 1
                        for begin in range(0, len(part), size):
                            self._run_group(run, prepared, part[begin : begin + size])
        except VariesError as split:
            wait(started)
            names = sorted(split.names)
            if len({tuple(run.concretes[i].values.get(name) for name in names) for i in indices}) < 2:
                path = prepared.scenario.path
                raise InputError(f"{path}: an attribute that must be one value {split}.") from None
            prepared.splitting |= split.names
            for group in _groups(prepared, run.concretes, indices):
                self._run_group(run, prepared, group)

    def _parts(self, prepared: PreparedScenario, chosen: list[int]) -> list[list[int]]:
        count = min(available_cpus(), len(chosen) // _WORTH_A_BATCH)
        if count < 2:
            return [chosen]
        drivers = {**prepared.scenario.drivers, **self._drivers}.values()
        # A driver object can drive in one batch at a time, and a Python driver blocks the other threads.
        if not all(isinstance(driver, str) and decides_compiled(driver) for driver in drivers):
            return [chosen]
        return [chosen[begin:end] for begin, end in pairwise(len(chosen) * k // count for k in range(count + 1))]

    def _form(self, run: _PortionRun, prepared: PreparedScenario, indices: list[int]) -> Batch | None:
        """Make a batch; None if the file cannot be used with the values of its scenarios."""
        try:
            return self._batch(prepared, [run.concretes[i] for i in indices])
        except InputError as error:
            # The cause is the same for the whole group.
            first = run.concretes[indices[0]]
            own_values = ConcreteScenario(first.path, {}, prepared.scenario)
            reason = prepared.what_is_wrong(error, first.values, lambda: self._batch(prepared, [own_values]))
            run.progress.update((i, SimulationError(reason)) for i in indices)
            return None


class _PortionRun(NamedTuple):
    """The run of scenarios that fit into memory together, in parallel batches.

    Only one thread is in Python at a time: this avoids GIL contention, which cost a third of the run time.
    """

    concretes: Sequence[ConcreteScenario]
    progress: dict[int, _Ran]
    executor: ThreadPoolExecutor
    gil_lock: Lock
    batches: WeakSet[Batch]
    remarks: list[list[str]]

    def start(self, batch: Batch, n_parallel: int) -> Future[Batch]:
        """Run a batch as one of `n_parallel`; if it is the only one, it has run on return."""
        self.batches.add(batch)
        remarks: list[str] = []
        self.remarks.append(remarks)
        if n_parallel > 1:
            return self.executor.submit(self._run, batch, max(available_cpus() // n_parallel, 1), remarks)
        done: Future[Batch] = Future()
        done.set_result(self._run(batch, available_cpus(), remarks))
        return done

    def _run(self, batch: Batch, threads: int, remarks: list[str]) -> Batch:
        with self.gil_lock:
            batch.run(threads, self.gil_lock)
            remarks += batch.remarks
        return batch


_Ran = tuple[Future[Batch], int] | SimulationError


def _made(ran: dict[int, _Ran], turn: Lock) -> Iterator[Recording | SimulationError]:
    """Yield results, computed a few portions ahead of the caller."""
    pending: deque[Future[list[Recording | SimulationError]]] = deque()
    with ThreadPoolExecutor(available_cpus()) as executor:
        for begin, end in _portions_of_results(ran):
            portion = [ran.pop(i) for i in range(begin, end)]
            if not (ran or pending):
                yield from _results(portion, turn)
                return
            pending.append(executor.submit(_results, portion, turn))
            if len(pending) > available_cpus():
                yield from pending.popleft().result()
        while pending:
            yield from pending.popleft().result()


def _portions_of_results(ran: Mapping[int, _Ran]) -> Iterator[tuple[int, int]]:
    """Yield (begin, end) of recordings to make together: few, since only what the caller keeps should take memory."""
    count, begin, total = len(ran), 0, 0
    future: Future[Batch] | None = None
    for i in range(count):
        entry = ran[i]
        if not isinstance(entry, SimulationError):
            if entry[0] is not future:
                future = entry[0]
                batch = future.result()
            total += batch.bytes_of(entry[1])
        if total > _MOST_RECORDED:
            yield begin, i + 1
            begin, total = i + 1, 0
    yield begin, count


def _results(ran: list[_Ran], turn: Lock) -> list[Recording | SimulationError]:
    with turn:
        indices: dict[Future[Batch], list[int]] = {}
        for entry in ran:
            if not isinstance(entry, SimulationError):
                indices.setdefault(entry[0], []).append(entry[1])
        results = {future: iter(future.result().results(chosen, turn)) for future, chosen in indices.items()}
        return [entry if isinstance(entry, SimulationError) else next(results[entry[0]]) for entry in ran]


def _groups(prepared: PreparedScenario, concretes: Sequence[ConcreteScenario], chosen: list[int]) -> list[list[int]]:
    names = sorted(prepared.splitting)
    if not (names and chosen):
        return [chosen] if chosen else []
    groups: dict[tuple[object, ...], list[int]] = {}
    for i in chosen:
        key = tuple(concretes[i].values.get(name) for name in names)
        groups.setdefault(key, []).append(i)
    return list(groups.values())
