"""cornercase's own simulator: OpenSCENARIO on OpenDRIVE roads, all concrete scenarios in lock-step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.version import __version__
from cornercase.drivers import Driver
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario, VariesError
from cornercase.simulators.base import Availability, Simulator, checked_settings
from cornercase.simulators.builtin.batch import Batch
from cornercase.simulators.builtin.effect import without_effect
from cornercase.simulators.builtin.prepared import PreparedScenario

# A batch keeps the whole motion of its scenarios; this many take about 300 MB for four entities and 400 instants.
_LARGEST_BATCH = 4096


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
    takes_batches = True

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
    def without_effect(cls, scenario: Scenario) -> dict[str, int]:
        """Count what of a scenario file changes nothing here.

        Parameters
        ----------
        scenario : Scenario

        Returns
        -------
        dict of str to int
            Actions, conditions and controllers, by the name of the element, and roads that climb or bank.
        """
        return without_effect(scenario)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Give one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            A scenario file cannot be used.
        """
        for start in range(0, len(concretes), _LARGEST_BATCH):
            yield from self._run(concretes[start : start + _LARGEST_BATCH])

    def _run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        ran: dict[int, tuple[Batch, int]] = {}
        files: dict[tuple[Path, Scenario | None], list[int]] = {}
        for i, concrete in enumerate(concretes):
            files.setdefault((concrete.path, concrete.source), []).append(i)
        for chosen in files.values():
            prepared = self._prepare(concretes[chosen[0]])
            for entity in self._drivers:
                prepared.scenario.require_entity(entity, "driven entity")
            for group in _groups(prepared, concretes, chosen):
                self._run_group(prepared, concretes, group, ran)
        # Recordings are made one by one, so that only those that the caller keeps take memory.
        for i in range(len(concretes)):
            batch, place = ran[i]
            yield batch.result(place)

    def _prepare(self, concrete: ConcreteScenario) -> PreparedScenario:
        """Prepared file of a concrete scenario: that of the last run, if its content is the same."""
        scenario = concrete.scenario(None if self._prepared is None else self._prepared.scenario)
        if self._prepared is None or self._prepared.scenario is not scenario:
            self._prepared = PreparedScenario(scenario)
        return self._prepared

    def _run_group(
        self,
        prepared: PreparedScenario,
        concretes: Sequence[ConcreteScenario],
        chosen: list[int],
        ran: dict[int, tuple[Batch, int]],
    ) -> None:
        try:
            batch = Batch(
                prepared,
                [concretes[i].values for i in chosen],
                self._time_step,
                self._duration,
                self._on_collision == "stop",
                self._drivers,
            )
        except VariesError as varies:
            differing = {tuple(concretes[i].values.get(name) for name in sorted(varies.names)) for i in chosen}
            if len(differing) < 2:
                path = prepared.scenario.path
                raise InputError(f"{path}: an attribute that must be one value {varies}.") from None
            prepared.splitting |= varies.names
            for group in _groups(prepared, concretes, chosen):
                self._run_group(prepared, concretes, group, ran)
            return
        batch.run()
        ran.update((i, (batch, place)) for place, i in enumerate(chosen))


def _groups(prepared: PreparedScenario, concretes: Sequence[ConcreteScenario], chosen: list[int]) -> list[list[int]]:
    """Concrete scenarios that go into one batch each, as far as is known."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for i in chosen:
        key = tuple(concretes[i].values.get(name) for name in sorted(prepared.splitting))
        groups.setdefault(key, []).append(i)
    return list(groups.values())
