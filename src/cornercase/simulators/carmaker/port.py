"""The command port of a CarMaker that runs already."""

from __future__ import annotations

import socket
import time
from typing import Self

from cornercase._common.errors import InputError, SimulationError, SimulatorError

# Characters that an answer may have, and s that it may take to connect.
_LONGEST_REPLY, _PATIENCE = 1_000_000, 60.0


class CommandPort:
    """Line to a CarMaker, which takes Tcl commands and answers each.

    An answer is ``O`` and a value, or ``E`` and an error, ended by an empty line; or an empty line alone. It may come
    in any number of pieces.

    Parameters
    ----------
    host : str
    port : int

    Raises
    ------
    InputError
        Nobody listens there.
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
        """Send a command, and wait for its answer.

        Parameters
        ----------
        command : str
            In Tcl.
        timeout : float
            s.

        Returns
        -------
        str
            The value that comes back; empty where there is none.

        Raises
        ------
        SimulationError
            CarMaker answers with an error; as a `SimulatorError`, not in time or not at all.
        """
        deadline = time.monotonic() + timeout
        # The rest of an earlier answer is thrown away.
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
                    raise SimulatorError(f"CarMaker closed the line in its answer to '{command}'")
                self._heard += piece
                if len(self._heard) > _LONGEST_REPLY:
                    raise SimulatorError(f"CarMaker's answer to '{command}' has no end")
        except TimeoutError:
            raise SimulatorError(f"CarMaker did not answer '{command}' within {timeout:g} s") from None
        except OSError as error:
            raise SimulatorError(f"the line to CarMaker broke at '{command}' ({error.strerror or error})") from error
        if answer.startswith("E"):
            raise SimulationError(f"CarMaker refuses '{command}': {answer[1:].strip()}")
        return answer[1:].strip()

    def _answer(self) -> str | None:
        """The next answer, if it is whole."""
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
