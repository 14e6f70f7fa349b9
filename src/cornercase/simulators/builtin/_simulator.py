"""cornercase's own simulator: OpenSCENARIO on OpenDRIVE roads, for many concrete scenarios at the same time."""

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
from cornercase._common.io.support_table import Notice
from cornercase._common.platform import count_available_cpus
from cornercase._common.text.element_locations import prefix_file, remove_file_prefix
from cornercase._common.version import __version__
from cornercase.drivers._resolve import DriverLike, check_drivers, is_compiled_driver_name
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Availability, Simulator, check_settings
from cornercase.simulators._driver_parameters import find_parameters_of_drivers
from cornercase.simulators.builtin._batch import Batch
from cornercase.simulators.builtin._ignored_content import read_and_collect_notices
from cornercase.simulators.builtin._prepared_file import PreparedScenario

# Limits of a batch: bytes of motion if all scenarios last the maximum duration, and scenarios. The overhead of a batch
# equals that of several hundred scenarios.
_MAX_BATCH_BYTES = 800_000_000
_MAX_BATCH_SIZE = 4096
# Scenarios that are worth a batch of their own: while the storyboard of one is in Python, another one runs.
_MIN_SCENARIOS_PER_BATCH = 512
# Bytes of recordings that are made together.
_MAX_RECORDING_BYTES = 4_000_000


class Builtin(Simulator):
    """The builtin simulator, which runs concrete scenarios in batches, up to 4096 at the same time.

    Parameters
    ----------
    time_step : float, default 0.05
        Time step in s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether entities pass through each other, as in CarMaker, or the run ends, as in CARLA. A scenario file's own
        stop trigger applies in both cases.
    drivers : mapping of str to str, SystemUnderTest, Driver or Behaviour, optional
        Driver of each entity: the name of a preset (``"normal"``), also with options (``"normal:horizon=4"``), a
        driver object, or parameters of a driver (``cornercase.drivers.CAUTIOUS``). Overrides the file's controllers.

    Raises
    ------
    InputError
        An option is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> simulator = cc.simulators.Builtin(drivers={"Ego": "normal:horizon=4"}, duration=10.0)
    >>> recording = cc.simulate("examples/x_intersection/x_intersection.xosc", simulator=simulator)
    >>> recording.time[-1] <= 10.0, recording.object_types
    (True, ('car', 'truck', 'car', 'pedestrian'))
    """

    name = "builtin"
    in_process = True
    deterministic = True
    batched = True
    takes_driver_parameters = True
    parameter_passing = "file"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, DriverLike] | None = None,
    ) -> None:
        self.settings = check_settings(time_step, duration, on_collision, drivers)
        self._time_step, self._duration, self._on_collision = time_step, duration, on_collision
        self._drivers = check_drivers(drivers)
        self._last_scenario: ScenarioFile | None = None

    @classmethod
    def availability(cls) -> Availability:
        """Return version and features; the simulator is always available."""
        return Availability(
            version=__version__,
            problem="",
            features=(
                "pedestrians", "drivers of your own", "occlusion", "collisions go on or end the run", "deterministic",
                "batches",
            ),
        )  # fmt: skip

    @classmethod
    def notices(cls, scenario: ScenarioFile, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """List the parts of a scenario that have no effect in this simulator."""
        return read_and_collect_notices(scenario, values)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Yield one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            A scenario file cannot be used.
        """
        for portion in self._split_by_memory(concretes):
            yield from self._run_portion(portion)

    def check_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Raise `InputError` with the problem of the first scenario if none of the scenarios can be run.

        Runs nothing.
        """
        first_error: InputError | None = None
        for concrete in concretes:
            prepared = self._prepare(concrete)
            unusable = prepared.find_invalid_values([concrete.values])
            try:
                if unusable:
                    raise InputError(prefix_file(concrete.path, f"{unusable[0]}."))
                self._make_batch(prepared, [concrete])
            except InputError as error:
                first_error = first_error or error
            else:
                return
        if first_error is not None:
            raise first_error

    def _split_by_memory(
        self, concretes: Sequence[ConcreteScenario], max_bytes: int = _MAX_BATCH_BYTES
    ) -> Iterator[Sequence[ConcreteScenario]]:
        instants = int(self._duration / self._time_step) + 2
        begin, total, needed = 0, 0, 0
        previous: ConcreteScenario | None = None
        for i, concrete in enumerate(concretes):
            if previous is None or concrete.path is not previous.path or concrete.file is not previous.file:
                needed = self._prepare(concrete).estimate_bytes(instants, bool(self._drivers))
            previous = concrete
            if i > begin and (total + needed > max_bytes or i - begin == _MAX_BATCH_SIZE):
                yield concretes[begin:i]
                begin, total = i, 0
            total += needed
        if begin < len(concretes):
            yield concretes[begin:]

    def _run_portion(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        files: dict[tuple[Path, ScenarioFile | None], list[int]] = {}
        for i, concrete in enumerate(concretes):
            files.setdefault((concrete.path, concrete.file), []).append(i)
        with ThreadPoolExecutor(count_available_cpus()) as executor:
            run = _PortionRun(concretes, {}, executor, Lock(), WeakSet(), [])
            try:
                for indices in files.values():
                    self._run_scenario_file(run, indices)
                # Recordings of the first batch are made while the next ones still run.
                yield from _iter_results(run.progress, run.gil_lock)
                for sentences in run.remarks:
                    self.notify(sentences)
            except BaseException:
                # The executor waits for its threads: do not let an interrupt wait for the remaining batches.
                for batch in run.batches:
                    batch.cancel()
                raise

    def _run_scenario_file(self, run: _PortionRun, indices: list[int]) -> None:
        prepared = self._prepare(run.concretes[indices[0]])
        for entity in self._drivers:
            prepared.scenario.require_entity(entity, "driven entity")
        undeclared = _find_undeclared_values(prepared.scenario, run.concretes, indices)
        run.progress.update((i, SimulationError(reason)) for i, reason in undeclared.items())
        indices = [i for i in indices if i not in undeclared]
        names = {name for i in indices for name in run.concretes[i].values}
        find_parameters_of_drivers(prepared.scenario, self._drivers, names)
        invalid = prepared.find_invalid_values([run.concretes[i].values for i in indices])
        run.progress.update((indices[k], SimulationError(reason)) for k, reason in invalid.items())
        for group in _group_by_split_parameters(prepared, run.concretes, [i for i in indices if i not in run.progress]):
            self._run_group(run, prepared, group)

    def _prepare(self, concrete: ConcreteScenario) -> PreparedScenario:
        """Return the prepared file of a concrete scenario; reuse the last file if its content is the same."""
        self._last_scenario = concrete.load_file(self._last_scenario)
        return PreparedScenario.from_scenario(self._last_scenario)

    def _make_batch(self, prepared: PreparedScenario, concretes: Sequence[ConcreteScenario]) -> Batch:
        return Batch(
            prepared,
            [concrete.values for concrete in concretes],
            [concrete.seed for concrete in concretes],
            self._time_step,
            self._duration,
            self._on_collision == "stop",
            self._drivers,
        )

    def _run_group(self, run: _PortionRun, prepared: PreparedScenario, indices: list[int]) -> None:
        """Run scenarios that may share a batch: wait for a single batch, or start several batches in other threads."""
        parts, started = self._split_by_cores(prepared, indices), list[Future[Batch]]()
        try:
            for part in parts:
                with run.gil_lock:
                    batch = self._make_batch_or_store_errors(run, prepared, part)
                if batch is not None:
                    # A compiled batch already runs while the next one is made; a batch in Python would block it.
                    started.append(run.submit(batch, 1 if batch.has_python_drivers else len(parts)))
                    run.progress.update((i, (started[-1], k)) for k, i in enumerate(part))
                    if batch.failure is not None and len(part) > 1:
                        # A driver failed in some of them: rerun them in smaller batches, so that only these fail.
                        size = (len(part) + 1) // 2 if batch.failure.can_bisect else 1
                        for begin in range(0, len(part), size):
                            self._run_group(run, prepared, part[begin : begin + size])
        except BatchSplitError as split:
            wait(started)
            names = sorted(split.parameter_names)
            if len({tuple(run.concretes[i].values.get(name) for name in names) for i in indices}) < 2:
                path = prepared.scenario.path
                raise InputError(f"{path}: an attribute that must be the same in all scenarios {split}.") from None
            prepared.split_parameters |= split.parameter_names
            for group in _group_by_split_parameters(prepared, run.concretes, indices):
                self._run_group(run, prepared, group)

    def _split_by_cores(self, prepared: PreparedScenario, indices: list[int]) -> list[list[int]]:
        count = min(count_available_cpus(), len(indices) // _MIN_SCENARIOS_PER_BATCH)
        if count < 2:
            return [indices]
        drivers = {**prepared.scenario.drivers, **self._drivers}.values()
        # A driver object can drive in one batch at a time, and a Python driver blocks the other threads.
        if not all(isinstance(driver, str) and is_compiled_driver_name(driver) for driver in drivers):
            return [indices]
        return [indices[begin:end] for begin, end in pairwise(len(indices) * k // count for k in range(count + 1))]

    def _make_batch_or_store_errors(
        self, run: _PortionRun, prepared: PreparedScenario, indices: list[int]
    ) -> Batch | None:
        """Create a batch; if the file cannot be used with the values, store errors as results and return None."""
        try:
            return self._make_batch(prepared, [run.concretes[i] for i in indices])
        except InputError as error:
            # The cause is the same for the whole group.
            first = run.concretes[indices[0]]
            own_values = ConcreteScenario(first.path, {}, prepared.scenario)
            reason = prepared.describe_value_error(
                error, first.values, lambda: self._make_batch(prepared, [own_values])
            )
            run.progress.update((i, SimulationError(reason)) for i in indices)
            return None


class _PortionRun(NamedTuple):
    """State of a run of scenarios that fit into memory together, in parallel batches.

    `gil_lock` lets only one thread run Python code at a time. Without this lock, the threads would compete for the GIL;
    this took a third of the run time.
    """

    concretes: Sequence[ConcreteScenario]
    progress: dict[int, _BatchIndexOrError]
    executor: ThreadPoolExecutor
    gil_lock: Lock
    batches: WeakSet[Batch]
    remarks: list[list[str]]

    def submit(self, batch: Batch, n_parallel: int) -> Future[Batch]:
        """Start a batch in a thread, as one of `n_parallel` batches; a single batch runs in this thread."""
        self.batches.add(batch)
        remarks: list[str] = []
        self.remarks.append(remarks)
        if n_parallel > 1:
            return self.executor.submit(self._run_batch, batch, max(count_available_cpus() // n_parallel, 1), remarks)
        done: Future[Batch] = Future()
        done.set_result(self._run_batch(batch, count_available_cpus(), remarks))
        return done

    def _run_batch(self, batch: Batch, n_threads: int, remarks: list[str]) -> Batch:
        with self.gil_lock:
            batch.run(n_threads, self.gil_lock)
            remarks += batch.remarks
        return batch


_BatchIndexOrError = tuple[Future[Batch], int] | SimulationError


def _iter_results(progress: dict[int, _BatchIndexOrError], gil_lock: Lock) -> Iterator[Recording | SimulationError]:
    """Yield results in the order of the scenarios; threads create further results while the caller uses a result."""
    pending: deque[Future[list[Recording | SimulationError]]] = deque()
    with ThreadPoolExecutor(count_available_cpus()) as executor:
        for begin, end in _split_results(progress):
            portion = [progress.pop(i) for i in range(begin, end)]
            if not (progress or pending):
                yield from _collect_results(portion, gil_lock)
                return
            pending.append(executor.submit(_collect_results, portion, gil_lock))
            if len(pending) > count_available_cpus():
                yield from pending.popleft().result()
        while pending:
            yield from pending.popleft().result()


def _split_results(progress: Mapping[int, _BatchIndexOrError]) -> Iterator[tuple[int, int]]:
    """Yield ranges (begin, end) of scenarios whose recordings are created together: only a few, to limit memory."""
    count, begin, total = len(progress), 0, 0
    future: Future[Batch] | None = None
    for i in range(count):
        entry = progress[i]
        if not isinstance(entry, SimulationError):
            if entry[0] is not future:
                future = entry[0]
                batch = future.result()
            total += batch.recording_size(entry[1])
        if total > _MAX_RECORDING_BYTES:
            yield begin, i + 1
            begin, total = i + 1, 0
    yield begin, count


def _collect_results(entries: list[_BatchIndexOrError], gil_lock: Lock) -> list[Recording | SimulationError]:
    with gil_lock:
        indices: dict[Future[Batch], list[int]] = {}
        for entry in entries:
            if not isinstance(entry, SimulationError):
                indices.setdefault(entry[0], []).append(entry[1])
        results = {future: iter(future.result().results(chosen, gil_lock)) for future, chosen in indices.items()}
        return [entry if isinstance(entry, SimulationError) else next(results[entry[0]]) for entry in entries]


def _find_undeclared_values(
    scenario: ScenarioFile, concretes: Sequence[ConcreteScenario], indices: list[int]
) -> dict[int, str]:
    """Find scenarios with a value for an undeclared parameter; return error texts by index of the scenario."""
    reasons: dict[int, str] = {}
    names_of_scenarios = {i: tuple(concretes[i].values) for i in indices}
    for names in set(names_of_scenarios.values()):
        try:
            scenario.require_declared(names)
        except InputError as error:
            reason = remove_file_prefix(str(scenario.path), str(error).removesuffix("."))
            reasons |= {i: reason for i, own in names_of_scenarios.items() if own == names}
    return reasons


def _group_by_split_parameters(
    prepared: PreparedScenario, concretes: Sequence[ConcreteScenario], indices: list[int]
) -> list[list[int]]:
    names = sorted(prepared.split_parameters)
    if not (names and indices):
        return [indices] if indices else []
    groups: dict[tuple[object, ...], list[int]] = {}
    for i in indices:
        key = tuple(concretes[i].values.get(name) for name in names)
        groups.setdefault(key, []).append(i)
    return list(groups.values())
