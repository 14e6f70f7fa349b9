"""Addresses of the servers that workers use."""

from __future__ import annotations

from cornercase._common.errors import InputError


def worker_address(hosts: str, port: int, worker: int, port_step: int = 1) -> tuple[str, int]:
    """Return host and port of the server that only the worker process with the number `worker` uses.

    `hosts` are ``host`` or ``host:port``, separated by ``+``; workers use them in turn. A host without a
    port has the port `port`. On each host, the first worker uses the port of the host, and each further worker a port
    that is `port_step` higher. Raises `InputError` if a port is out of range.
    """
    all_hosts = [host_text.strip() for host_text in hosts.split("+")]
    host, _, explicit_port = all_hosts[worker % len(all_hosts)].partition(":")
    try:
        first = int(explicit_port or port)
    except ValueError:
        raise InputError(
            f"'{all_hosts[worker % len(all_hosts)]}' is not a host; write it as host or host:port."
        ) from None
    worker_port = first + port_step * (worker // len(all_hosts))
    if not host or not 0 < worker_port < 65536:
        raise InputError(f"{host}:{worker_port} is not a valid address; give a host, and a port from 1 to 65535.")
    return host, worker_port
