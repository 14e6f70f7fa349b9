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

# A batch keeps the whole motion of its scenarios; so many bytes at most, which it takes only if all of them run as long
# as they may, and so many scenarios. What a batch costs besides its scenarios is worth several hundred of them.
_MOST_BYTES = 800_000_000
_LARGEST_BATCH = 4096
# So many scenarios are worth a batch of their own: while the storyboard of one looks, which is Python, another runs.
_WORTH_A_BATCH = 512
# Recordings are made so many bytes at once.
_MOST_RECORDED = 4_000_000


class BuiltinSimulator(Simulator):
    """Steps all concrete scenarios at once: one code path for one and for a hundred thousand.

    Parameters
    ----------
    time_step : float, default 0.05
        s.
    duration : float, default 60
        s after which a scenario ends at the latest.
    on_collision : {"continue", "stop"}, default "continue"
        Whether entities pass through each other, as in CarMaker, or the run ends, as in CARLA. A scenario file's
        own stop trigger holds either way.
    drivers : mapping of str to str or Driver, optional
        Who drives which entity: the name of a preset, or a driver. Beats the file's controller properties.

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
        """Say whether it can run here: always."""
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
        """Name what of a scenario changes nothing here.

        Parameters
        ----------
        scenario : Scenario
        values : mapping of str to float or str, optional
            Of its parameters.

        Returns
        -------
        tuple of Notice
        """
        return notices(scenario, values)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Give one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            A scenario file cannot be used.
        """
        for chosen in self._portions(concretes):
            yield from self._run(chosen)

    def require_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Refuse scenarios of which none can be run, without running any.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario

        Raises
        ------
        InputError
            What is wrong with the first.
        """
        wrong: InputError | None = None
        for concrete in concretes:
            prepared = self._prepare(concrete)
            unusable = prepared.unusable([concrete.values])
            try:
                if unusable:
                    raise InputError(of_file(concrete.path, f"{unusable[0]}."))
                self._batch(prepared, [concrete])
            except InputError as error:
                wrong = wrong or error
            else:
                return
        if wrong is not None:
            raise wrong

    def _portions(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Sequence[ConcreteScenario]]:
        """Scenarios that are held in memory at the same time."""
        instants = int(self._duration / self._time_step) + 2
        begin, held, needed = 0, 0, 0
        last: ConcreteScenario | None = None
        for i, concrete in enumerate(concretes):
            if last is None or concrete.path is not last.path or concrete.source is not last.source:
                needed = self._prepare(concrete).bytes_for(instants, bool(self._drivers))
            last = concrete
            if i > begin and (held + needed > _MOST_BYTES or i - begin == _LARGEST_BATCH):
                yield concretes[begin:i]
                begin, held = i, 0
            held += needed
        if begin < len(concretes):
            yield concretes[begin:]

    def _run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        ran: dict[int, _Ran] = {}
        files: dict[tuple[Path, Scenario | None], list[int]] = {}
        for i, concrete in enumerate(concretes):
            files.setdefault((concrete.path, concrete.source), []).append(i)
        with ThreadPoolExecutor(available_cpus()) as pool:
            crew = _Crew(pool, Lock(), WeakSet(), [])
            try:
                for chosen in files.values():
                    self._run_file(concretes, chosen, ran, crew)
                # Recordings of the first batch are made while the next ones still run.
                yield from _made(ran, crew.turn)
                for sentences in crew.remarks:
                    self.notice(sentences)
            except BaseException:
                # The pool waits for its threads; whoever interrupts does not wait for the rest of the batches.
                for batch in crew.running:
                    batch.halt()
                raise

    def _run_file(
        self, concretes: Sequence[ConcreteScenario], chosen: list[int], ran: dict[int, _Ran], crew: _Crew
    ) -> None:
        """Start to run those that have the same file."""
        prepared = self._prepare(concretes[chosen[0]])
        for entity in self._drivers:
            prepared.scenario.require_entity(entity, "driven entity")
        wrong = prepared.unusable([concretes[i].values for i in chosen])
        ran.update((chosen[place], SimulationError(words)) for place, words in wrong.items())
        for group in _groups(prepared, concretes, [i for i in chosen if i not in ran]):
            self._run_group(prepared, concretes, group, ran, crew)

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

    def _run_group(
        self,
        prepared: PreparedScenario,
        concretes: Sequence[ConcreteScenario],
        chosen: list[int],
        ran: dict[int, _Ran],
        crew: _Crew,
    ) -> None:
        """Start to run scenarios that could go into one batch; where it is one alone, it has run then."""
        parts, started = self._parts(prepared, chosen), list[Future[Batch]]()
        try:
            for part in parts:
                with crew.turn:
                    batch = self._form(prepared, concretes, part, ran)
                if batch is not None:
                    # While the next one is formed, this one runs already; in Python it would leave no time for that.
                    started.append(crew.start(batch, 1 if batch.in_python else len(parts)))
                    ran.update((i, (started[-1], place)) for place, i in enumerate(part))
                    if batch.failure is not None and len(part) > 1:
                        self._run_apart(prepared, concretes, part, ran, crew, batch.failure.splits)
        except VariesError as varies:
            wait(started)
            differing = {tuple(concretes[i].values.get(name) for name in sorted(varies.names)) for i in chosen}
            if len(differing) < 2:
                path = prepared.scenario.path
                raise InputError(f"{path}: an attribute that must be one value {varies}.") from None
            prepared.splitting |= varies.names
            for group in _groups(prepared, concretes, chosen):
                self._run_group(prepared, concretes, group, ran, crew)

    def _run_apart(
        self,
        prepared: PreparedScenario,
        concretes: Sequence[ConcreteScenario],
        chosen: list[int],
        ran: dict[int, _Ran],
        crew: _Crew,
        in_halves: bool,
    ) -> None:
        """Run scenarios again of which a driver failed in some, so that only these fail."""
        size = (len(chosen) + 1) // 2 if in_halves else 1
        for begin in range(0, len(chosen), size):
            self._run_group(prepared, concretes, chosen[begin : begin + size], ran, crew)

    def _parts(self, prepared: PreparedScenario, chosen: list[int]) -> list[list[int]]:
        """Scenarios that go into one batch each, of those that could go into one."""
        count = min(available_cpus(), len(chosen) // _WORTH_A_BATCH)
        if count < 2:
            return [chosen]
        drivers = {**prepared.scenario.drivers, **self._drivers}.values()
        # A driver object can be at the wheel in one batch at a time, and one in Python leaves other threads no time.
        if not all(isinstance(one, str) and decides_compiled(one) for one in drivers):
            return [chosen]
        return [chosen[begin:end] for begin, end in pairwise(len(chosen) * k // count for k in range(count + 1))]

    def _form(
        self,
        prepared: PreparedScenario,
        concretes: Sequence[ConcreteScenario],
        chosen: list[int],
        ran: dict[int, _Ran],
    ) -> Batch | None:
        """Form a batch; none where the file cannot be used with the values of its scenarios."""
        try:
            return self._batch(prepared, [concretes[i] for i in chosen])
        except InputError as error:
            # Whatever it is because of is the same for the whole group.
            first = concretes[chosen[0]]
            own = ConcreteScenario(first.path, {}, prepared.scenario)
            words = prepared.what_is_wrong(error, first.values, lambda: self._batch(prepared, [own]))
            ran.update((i, SimulationError(words)) for i in chosen)
            return None


class _Crew(NamedTuple):
    """Threads that run batches beside each other, all cores busy.

    Of those that are in Python only one has its turn: they would hand Python's own lock to and fro with each call of
    NumPy, which took a third of the time.
    """

    pool: ThreadPoolExecutor
    turn: Lock
    running: WeakSet[Batch]
    remarks: list[list[str]]

    def start(self, batch: Batch, beside: int) -> Future[Batch]:
        """Run a batch beside so many others, itself included; one that is alone has run then."""
        self.running.add(batch)
        remarks: list[str] = []
        self.remarks.append(remarks)
        if beside > 1:
            return self.pool.submit(self._run, batch, max(available_cpus() // beside, 1), remarks)
        done: Future[Batch] = Future()
        done.set_result(self._run(batch, available_cpus(), remarks))
        return done

    def _run(self, batch: Batch, threads: int, remarks: list[str]) -> Batch:
        with self.turn:
            batch.run(threads, self.turn)
            remarks += batch.remarks
        return batch


_Ran = tuple[Future[Batch], int] | SimulationError


def _made(ran: dict[int, _Ran], turn: Lock) -> Iterator[Recording | SimulationError]:
    """What came out of scenarios, a few ahead of what the caller has taken."""
    waiting: deque[Future[list[Recording | SimulationError]]] = deque()
    with ThreadPoolExecutor(available_cpus()) as makers:
        for begin, end in _portions_of_results(ran):
            chosen = [ran.pop(i) for i in range(begin, end)]
            if not (ran or waiting):
                yield from _results(chosen, turn)
                return
            waiting.append(makers.submit(_results, chosen, turn))
            if len(waiting) > available_cpus():
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()


def _portions_of_results(ran: Mapping[int, _Ran]) -> Iterator[tuple[int, int]]:
    """Recordings that are made together, first and last one: few, as only those that the caller keeps take memory."""
    count, begin, held = len(ran), 0, 0
    future: Future[Batch] | None = None
    for i in range(count):
        found = ran[i]
        if not isinstance(found, SimulationError):
            if found[0] is not future:
                future = found[0]
                batch = future.result()
            held += batch.bytes_of(found[1])
        if held > _MOST_RECORDED:
            yield begin, i + 1
            begin, held = i + 1, 0
    yield begin, count


def _results(ran: list[_Ran], turn: Lock) -> list[Recording | SimulationError]:
    """What came out of scenarios, of each batch at once."""
    with turn:
        places: dict[Future[Batch], list[int]] = {}
        for found in ran:
            if not isinstance(found, SimulationError):
                places.setdefault(found[0], []).append(found[1])
        made = {future: iter(future.result().results(chosen, turn)) for future, chosen in places.items()}
        return [found if isinstance(found, SimulationError) else next(made[found[0]]) for found in ran]


def _groups(prepared: PreparedScenario, concretes: Sequence[ConcreteScenario], chosen: list[int]) -> list[list[int]]:
    """Concrete scenarios that go into one batch each, as far as is known."""
    names = sorted(prepared.splitting)
    if not (names and chosen):
        return [chosen] if chosen else []
    groups: dict[tuple[object, ...], list[int]] = {}
    for i in chosen:
        key = tuple(concretes[i].values.get(name) for name in names)
        groups.setdefault(key, []).append(i)
    return list(groups.values())
