"""Client for the Tcl command port of a running CarMaker."""

from __future__ import annotations

import socket
import time

from cornercase._common.errors import InputError, SimulationError, SimulatorError

# Maximum size of an answer, and time limit in s to connect.
_MAX_REPLY_SIZE, _CONNECT_TIMEOUT = 1_000_000, 60.0


class TclClient:
    """Connection to a running CarMaker, which executes Tcl commands; `InputError` if none listens.

    CarMaker answers each command: ``O`` and a value, or ``E`` and an error, followed by an empty line; or only an empty
    line. An answer may arrive in several pieces.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT)
        except OSError as error:
            raise InputError(
                f"No CarMaker listens on {host}:{port} ({error.strerror or error}); start it with -cmdport {port}."
            ) from error
        self._received = b""

    def send(self, command: str, timeout: float) -> str:
        """Send a Tcl command and return the value in the answer; waits up to `timeout` s."""
        deadline = time.monotonic() + timeout
        # Discard the rest of an earlier answer.
        self._received = b""
        try:
            self._socket.sendall(command.encode() + b"\r")
            while True:
                answer = self._next_answer()
                if answer is not None:
                    break
                self._socket.settimeout(max(deadline - time.monotonic(), 1e-3))
                piece = self._socket.recv(65536)
                if not piece:
                    raise SimulatorError(f"CarMaker closed the connection while answering '{command}'")
                self._received += piece
                if len(self._received) > _MAX_REPLY_SIZE:
                    raise SimulatorError(f"CarMaker's answer to '{command}' has no end")
        except TimeoutError:
            raise SimulatorError(f"CarMaker did not answer '{command}' within {timeout:g} s") from None
        except OSError as error:
            raise SimulatorError(f"connection to CarMaker lost at '{command}' ({error.strerror or error})") from error
        if answer.startswith("E"):
            raise SimulationError(f"CarMaker refuses '{command}': {answer[1:].strip()}")
        return answer[1:].strip()

    def _next_answer(self) -> str | None:
        """Return the next answer if it has arrived completely, else None."""
        if self._received.startswith(b"\r\n"):
            self._received = self._received[2:]
            return ""
        whole, end, rest = self._received.partition(b"\r\n\r\n")
        if not end:
            return None
        self._received = rest
        return whole.decode("utf-8", "replace")

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
