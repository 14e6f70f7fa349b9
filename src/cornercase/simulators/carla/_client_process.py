"""CARLA's client in a process of ScenarioRunner's Python."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, Final
from weakref import finalize

from cornercase._common.errors import InputError, SimulatorError
from cornercase._common.optional_packages import describe_install, is_empty_extra
from cornercase._common.platform import describe_exit_code, kill_process_tree
from cornercase.simulators.carla._runner_environment import PYTHON_VARIABLE, RunnerEnvironment

_PROGRAM: Final = Path(__file__).with_name("cornercase_recorder.py")
_MISSING_CLIENT: Final = "No module named 'carla'"


class ClientError(SimulatorError):
    """Error that CARLA's client reports, for example if the server does not answer."""


class ClientProcess:
    """Process of the program `cornercase_recorder.py`, which calls CARLA's client.

    The program runs until `close` is called.
    """

    def __init__(self, environment: RunnerEnvironment) -> None:
        self._python = environment.python
        # Deleted when it is closed.
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                [environment.python, str(_PROGRAM)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env=environment.variables(),
            )
        except OSError as error:
            self._errors.close()
            raise InputError(
                f"{environment.python}: is no Python that can be run ({error}); set {PYTHON_VARIABLE} to the"
                " Python of ScenarioRunner's environment."
            ) from error

        # Ends the program even if `close` is never called.
        self.close = finalize(self, _end_program, self._process, self._errors)

    def call_method(self, method: str, *arguments: object) -> Any:
        """Call a method of the client and return its result; raise `ClientError` if the client reports an error."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps([method, *arguments]).encode() + b"\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except OSError:
            line = b""
        if not line:
            self._raise_ended()
        try:
            answer = json.loads(line)
        except ValueError as error:
            raise SimulatorError(
                f"CARLA's client printed '{line[:100].decode(errors='replace').strip()}' instead of JSON"
            ) from error
        if "error" in answer:
            raise ClientError(answer["error"])
        return answer["result"]

    def _raise_ended(self) -> None:
        """Raise an error that says why the program has ended.

        For instance, CARLA's client aborts if it does not understand the server.
        """
        code = self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        if _MISSING_CLIENT in last:
            # The extra is for the Python that runs cornercase.
            if self._python == sys.executable and is_empty_extra("carla"):
                raise InputError(
                    f"{self._python}: CARLA's client is not installed there; {describe_install('carla')}. Set"
                    f" {PYTHON_VARIABLE} to the Python of ScenarioRunner's environment."
                )
            raise InputError(
                f"{self._python}: CARLA's client is not installed there; install the version that matches your CARLA,"
                f" for example by `{self._python} -m pip install carla==0.9.15`, or set {PYTHON_VARIABLE} to the Python"
                " of ScenarioRunner's environment."
            )
        raise SimulatorError(f"CARLA's client {describe_exit_code(code)}{f': {last[:300]}' if last else ''}")


def _end_program(process: subprocess.Popen[bytes], errors: IO[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        # The program may not have read all its input.
        with suppress(OSError):
            pipe.close()
    try:
        process.wait(2.0)
    except subprocess.TimeoutExpired:
        kill_process_tree(process.pid)
        process.wait()
    errors.close()


@cache
def find_client_version(environment: RunnerEnvironment) -> str:
    """Return the version of CARLA's client in ScenarioRunner's Python; `InputError` if it does not run there."""
    client = ClientProcess(environment)
    try:
        return str(client.call_method("get_version"))
    except SimulatorError as error:
        # No server is asked, so it is the installation.
        raise InputError(
            f"{environment.python}: CARLA's client does not run there ({error}); install it again, or set"
            f" {PYTHON_VARIABLE} to the Python of ScenarioRunner's environment."
        ) from error
    finally:
        client.close()
