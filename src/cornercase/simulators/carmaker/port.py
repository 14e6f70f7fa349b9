"""Client for the Tcl command port of a running CarMaker."""

from __future__ import annotations

import socket
import time
from typing import Self

from cornercase._common.errors import InputError, SimulationError, SimulatorError

# Maximum size of an answer, and time limit in s to connect.
_LONGEST_REPLY, _PATIENCE = 1_000_000, 60.0


class CommandPort:
    """Connection to a CarMaker, which executes Tcl commands and answers each; `InputError` if nothing listens.

    An answer is ``O`` and a value, or ``E`` and an error, ended by an empty line; or an empty line alone. It may arrive
    in several pieces.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=_PATIENCE)
        except OSError as error:
            raise InputError(
                f"No CarMaker listens on {host}:{port} ({error.strerror or error}); start it with -cmdport {port}."
            ) from error
        self._heard = b""

    def ask(self, command: str, timeout: float) -> str:
        """Send a Tcl command and return the value of its answer, waiting up to `timeout` s.

        Raises `SimulationError` if CarMaker answers with an error, `SimulatorError` if it does not answer in time or at
        all.
        """
        deadline = time.monotonic() + timeout
        # Discard the rest of an earlier answer.
        self._heard = b""
        try:
            self._socket.sendall(command.encode() + b"\r")
            while True:
                answer = self._answer()
                if answer is not None:
                    break
                self._socket.settimeout(max(deadline - time.monotonic(), 1e-3))
                piece = self._socket.recv(65536)
                if not piece:
                    raise SimulatorError(f"CarMaker closed the connection while answering '{command}'")
                self._heard += piece
                if len(self._heard) > _LONGEST_REPLY:
                    raise SimulatorError(f"CarMaker's answer to '{command}' has no end")
        except TimeoutError:
            raise SimulatorError(f"CarMaker did not answer '{command}' within {timeout:g} s") from None
        except OSError as error:
            raise SimulatorError(f"connection to CarMaker lost at '{command}' ({error.strerror or error})") from error
        if answer.startswith("E"):
            raise SimulationError(f"CarMaker refuses '{command}': {answer[1:].strip()}")
        return answer[1:].strip()

    def _answer(self) -> str | None:
        """Return the next answer if it is complete, else None."""
        if self._heard.startswith(b"\r\n"):
            self._heard = self._heard[2:]
            return ""
        whole, end, rest = self._heard.partition(b"\r\n\r\n")
        if not end:
            return None
        self._heard = rest
        return whole.decode("utf-8", "replace")

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
