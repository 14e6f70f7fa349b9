"""A CarMaker that IPG's own Python module starts and controls."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.scenario import Value

# s that CarMaker may take to end.
_ENDING: Final = 5.0


def has_cmapi() -> bool:
    """Look whether IPG's module ``cmapi`` can be imported; it lies in CarMaker's installation.

    Returns
    -------
    bool
    """
    return find_spec("cmapi") is not None


class CarMakerApi:
    """Starts CarMaker once, and runs a TestRun with named values as often as is asked.

    The module has an event loop of its own, which goes on in a thread.

    Parameters
    ----------
    project : Path
        Folder of the CarMaker project.
    testrun : str
    patience : float
        s that a run may take, or the start.

    Raises
    ------
    InputError
        CarMaker does not start.
    """

    def __init__(self, project: Path, testrun: str, patience: float) -> None:
        import cmapi

        self._cmapi: Any = cmapi
        self._project, self._testrun, self._patience = project, testrun, patience
        self._started: Future[asyncio.AbstractEventLoop] = Future()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()
        try:
            self._loop = self._started.result(patience)
        except Exception as error:
            raise InputError(
                f"CarMaker does not start by IPG's cmapi ({error or 'no answer'}); see to its installation and licence,"
                " or use a CarMaker that runs already by carmaker:via=port."
            ) from error

    def _live(self) -> None:
        try:
            self._cmapi.Task.run_main_task(self._main())
        except Exception as error:
            if not self._started.done():
                self._started.set_exception(error)

    async def _main(self) -> None:
        cmapi = self._cmapi
        cmapi.Project.load(self._project)
        self._control = cmapi.SimControlInteractive()
        await self._control.set_master(cmapi.CarMaker())
        # CarMaker connects only when there is a variation to run.
        self._control.set_variation(self._variation({}))
        await self._control.start_and_connect()
        self._over = asyncio.Event()
        self._started.set_result(asyncio.get_running_loop())
        await self._over.wait()
        await self._control.stop_and_disconnect()

    def _variation(self, values: Mapping[str, Value]) -> Any:
        cmapi = self._cmapi
        testrun = cmapi.Project.instance().load_testrun_parametrization(Path(self._testrun))
        variation = cmapi.Variation.create_from_testrun(testrun)
        variation.set_name("cornercase")
        variation.set_nvalues([cmapi.NamedValue(name, value) for name, value in values.items()])
        variation.set_storage_mode(cmapi.StorageMode.save)
        return variation

    def run(self, values: Mapping[str, Value]) -> Path:
        """Run the TestRun with named values.

        Parameters
        ----------
        values : mapping of str to float or str

        Returns
        -------
        Path
            Of the result file that CarMaker wrote.

        Raises
        ------
        SimulationError
            It did not end in time, or wrote no file; as a `SimulatorError` whatever the module says went wrong.
        """
        before = self._results()
        future = asyncio.run_coroutine_threadsafe(self._run(values), self._loop)
        try:
            # `_run` stops waiting after `patience` and stops the run; this is for a module that does not answer at all.
            future.result(2 * self._patience)
        except SimulationError:
            raise
        except Exception as error:
            raise SimulatorError(f"CarMaker, by cmapi: {type(error).__name__}: {error}") from error
        written = [path for path, changed in self._results().items() if before.get(path) != changed]
        if len(written) != 1:
            raise SimulationError(
                f"CarMaker wrote {len(written)} result files in SimOutput, where one was awaited; let the TestRun store"
                " its results, and let nothing else use the project"
            )
        return written[0]

    async def _run(self, values: Mapping[str, Value]) -> None:
        control, states = self._control, self._cmapi.ConditionSimState
        control.set_variation(self._variation(values))
        await control.start_sim()
        try:
            await asyncio.wait_for(control.create_simstate_condition(states.finished).wait(), self._patience)
        except TimeoutError:
            stopping = control.stop_sim()
            if inspect.isawaitable(stopping):
                await stopping
            raise SimulationError(f"CarMaker did not end the TestRun within {self._patience:g} s") from None

    def _results(self) -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in (self._project / "SimOutput").rglob("*.erg")}

    def close(self) -> None:
        """End CarMaker, and wait a moment until it has."""
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(_ENDING)
