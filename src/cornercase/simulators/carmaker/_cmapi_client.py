"""Client that starts and controls CarMaker by IPG's own Python module."""

from __future__ import annotations

import asyncio
import inspect
import os
import signal
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.scenario import Value
from cornercase.simulators.carmaker._result_file_tracker import ResultFileTracker

# Time limit in s for CarMaker to end.
_END_TIMEOUT: Final = 5.0


def is_cmapi_installed() -> bool:
    """Return whether IPG's module ``cmapi`` (part of CarMaker's installation) can be imported."""
    return find_spec("cmapi") is not None


class CmapiClient:
    """Client that starts CarMaker once by IPG's Python module, and runs TestRuns with named values.

    `project`: folder of the CarMaker project. `testrun`: TestRun with which CarMaker is started. `timeout`: time limit
    in s of the start and of each run. `end_timeout`: time limit in s for stopping a run, and for ending CarMaker. The
    event loop of IPG's module runs in a separate thread. Raises `InputError` if CarMaker does not start.
    """

    def __init__(self, project: Path, testrun: str, timeout: float, end_timeout: float = _END_TIMEOUT) -> None:
        import cmapi

        self._cmapi: Any = cmapi
        self._project, self._timeout, self._end_timeout = project, timeout, end_timeout
        self._first_testrun = testrun
        self._started: Future[None] = Future()
        self._thread = threading.Thread(target=self._run_event_loop, daemon=True)
        self._thread.start()
        try:
            self._started.result(timeout)
        except Exception as error:
            # It might still start, and would keep a licence.
            self.close()
            raise InputError(
                f"CarMaker does not start with IPG's cmapi ({str(error) or 'no answer'}); check its installation and"
                " licence, or use a running CarMaker with carmaker:via=port."
            ) from error

    def _run_event_loop(self) -> None:
        try:
            self._cmapi.Task.run_main_task(self._start_and_wait())
        except Exception as error:
            if not self._started.done():
                self._started.set_exception(error)

    async def _start_and_wait(self) -> None:
        cmapi = self._cmapi
        self._loop, self._end_event = asyncio.get_running_loop(), asyncio.Event()
        cmapi.Project.load(self._project)
        self._control, self._master = cmapi.SimControlInteractive(), cmapi.CarMaker()
        await self._control.set_master(self._master)
        # CarMaker connects only when there is a variation to run.
        self._control.set_variation(self._make_variation(self._first_testrun, {}, ()))
        try:
            starting = asyncio.ensure_future(self._control.start_and_connect())
            ended = asyncio.ensure_future(self._end_event.wait())
            await asyncio.wait((starting, ended), return_when=asyncio.FIRST_COMPLETED)
            if starting.done():
                starting.result()
                self._started.set_result(None)
            await ended
        except Exception as error:
            self._started.set_exception(error)
        finally:
            await self._end_carmaker()

    async def _end_carmaker(self) -> None:
        """End the CarMaker that this client has started, by force if IPG's module fails, to release the licence."""
        try:
            await asyncio.wait_for(_await_if_awaitable(self._control.stop_and_disconnect()), self._end_timeout)
        except Exception:
            with suppress(Exception):
                os.kill(int(self._master.get_pid()), signal.SIGTERM)

    def _make_variation(self, testrun: str, values: Mapping[str, Value], quantities: Sequence[str]) -> Any:
        cmapi = self._cmapi
        loaded = cmapi.Project.instance().load_testrun_parametrization(Path(testrun))
        variation = cmapi.Variation.create_from_testrun(loaded)
        variation.set_name("cornercase")
        variation.set_nvalues([cmapi.NamedValue(name, value) for name, value in values.items()])
        variation.set_storage_mode(cmapi.StorageMode.save)
        # Versions without it store what the project's list says.
        with suppress(AttributeError):
            stored = cmapi.OutputQuantities.create()
            stored.add_quantities(list(quantities))
            variation.set_outputquantities(stored)
        return variation

    def run_testrun(self, testrun: str, values: Mapping[str, Value], quantities: Sequence[str] = ()) -> Path:
        """Run a TestRun with named values, and return the result file, which contains `quantities`.

        Raises `SimulationError` if the run fails or does not write exactly one result file. Raises `SimulatorError` if
        CarMaker is no longer usable, and must be started again.
        """
        before = ResultFileTracker(self._project)
        future = asyncio.run_coroutine_threadsafe(self._run_testrun_async(testrun, values, quantities), self._loop)
        try:
            # The coroutine stops the run after `timeout`; this time limit is for a module that does not answer.
            future.result(2 * self._timeout + self._end_timeout)
        except SimulationError:
            raise
        except TimeoutError as error:
            future.cancel()
            raise SimulatorError("cmapi, the Python package of CarMaker, does not answer") from error
        except Exception as error:
            raise SimulatorError(
                f"cmapi, the Python package of CarMaker, failed with {type(error).__name__}: {error}"
            ) from error
        written = before.new_files()
        if len(written) != 1:
            raise SimulationError(
                f"CarMaker wrote {len(written)} result files in SimOutput instead of one; let the TestRun store its"
                " results, and let nothing else use the project"
            )
        return written[0]

    async def _run_testrun_async(self, testrun: str, values: Mapping[str, Value], quantities: Sequence[str]) -> None:
        control, states = self._control, self._cmapi.ConditionSimState
        # A variation is accepted only in the state `configure`: not while a run is active, or ended without being left.
        if control.get_status() != self._cmapi.SimControlState.configure and not await self._stop_run():
            raise SimulatorError(f"CarMaker did not become idle within {self._end_timeout:g} s")
        variation = self._make_variation(testrun, values, quantities)
        control.set_variation(variation)
        await control.start_sim()
        try:
            await asyncio.wait_for(control.create_simstate_condition(states.finished).wait(), self._timeout)
        except TimeoutError:
            message = f"CarMaker did not end the TestRun within {self._timeout:g} s"
            if await self._stop_run():
                raise SimulationError(message) from None
            raise SimulatorError(f"{message}, and did not stop it within another {self._end_timeout:g} s") from None
        failed = False
        # Not all versions of the module report how a run ended.
        with suppress(AttributeError):
            failed = bool(variation.get_simend_info().error_flag)
        if failed:
            raise SimulationError("CarMaker ended the TestRun with an error; see its log")

    async def _stop_run(self) -> bool:
        """Stop a run, and return whether CarMaker becomes idle within the time limit."""
        await _await_if_awaitable(self._control.stop_sim())
        idle = self._control.create_simstate_condition(self._cmapi.ConditionSimState.idle)
        with suppress(TimeoutError):
            await asyncio.wait_for(idle.wait(), self._end_timeout)
            return True
        return False

    def close(self) -> None:
        """End the CarMaker that this client has started, and wait for its end."""
        # If the start failed, the loop has ended already.
        with suppress(AttributeError, RuntimeError):
            self._loop.call_soon_threadsafe(self._end_event.set)
        self._thread.join(2 * self._end_timeout)


async def _await_if_awaitable(result: Any) -> None:
    """Await a result if it is awaitable: some versions of IPG's module return awaitables, others do not."""
    if inspect.isawaitable(result):
        await result
