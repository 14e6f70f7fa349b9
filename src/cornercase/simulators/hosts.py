"""Where the servers of several workers listen."""

from __future__ import annotations

from cornercase._common.errors import InputError


def address(hosts: str, port: int, worker: int, step: int = 1) -> tuple[str, int]:
    """Host and port of a worker's own server.

    Parameters
    ----------
    hosts : str
        One or more of ``host`` and ``host:port``, separated by ``+``. On each the first worker takes the port that is
        given, the next one the port `step` above it; several hosts are taken in turn.
    port : int
        For those without one.
    worker : int
        From 0 on.
    step : int, default 1

    Returns
    -------
    host : str
    port : int

    Raises
    ------
    InputError
        A port is out of range.
    """
    every = [one.strip() for one in hosts.split("+")]
    host, _, own = every[worker % len(every)].partition(":")
    try:
        first = int(own or port)
    except ValueError:
        raise InputError(f"'{every[worker % len(every)]}' is not a host; write it as host or host:port.") from None
    found = first + step * (worker // len(every))
    if not host or not 0 < found < 65536:
        raise InputError(f"{host}:{found} is not possible; give a host, and a port from 1 to 65535.")
    return host, found
