"""Process of a CARLA server that cornercase starts, waits for and starts again."""

from __future__ import annotations

import socket
from functools import partial
from typing import Final

from cornercase.simulators._server_process import ServerProcess

# Time in s: a server loads its first map before it answers.
_START_TIMEOUT: Final = 180.0
_ANSWER_TIMEOUT: Final = 2.0
# Request of the server's version in MessagePack: [0, 1, "version", [[False]]].
_VERSION_REQUEST: Final = b"\x94\x00\x01\xa7version\x91\x91\xc2"


def make_carla_process(command: str, host: str, port: int, restart_after: int) -> ServerProcess:
    """Return the process of a CARLA server, which is not started yet.

    `command` starts the server; ``{port}`` in the command stands for the port. The server is started again after
    `restart_after` scenarios (0: never).
    """
    return ServerProcess(
        "CARLA",
        command,
        host,
        port,
        partial(is_answering, host, port),
        start_timeout=_START_TIMEOUT,
        restart_after=restart_after,
    )


def is_answering(host: str, port: int) -> bool:
    """Return whether a CARLA server answers a request; its ports are open before it can answer."""
    try:
        with socket.create_connection((host, port), _ANSWER_TIMEOUT) as connection:
            connection.settimeout(_ANSWER_TIMEOUT)
            connection.sendall(_VERSION_REQUEST)
            return bool(connection.recv(1))
    except OSError:
        return False
