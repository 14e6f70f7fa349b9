"""Addresses of the servers that workers use."""

from __future__ import annotations

import re
from contextlib import suppress
from ipaddress import IPv6Address
from typing import Final

from cornercase._common.errors import InputError

_BRACKETED_HOST: Final = re.compile(r"\[([^\]]+)\](?::(.*))?")


def worker_address(hosts: str, port: int, worker: int, port_step: int = 1) -> tuple[str, int]:
    """Return host and port of the server that only the worker process with the number `worker` uses.

    `hosts` are ``host`` or ``host:port``, separated by ``+``; workers use them in turn. Before a port, an IPv6 address
    stands between brackets: ``[::1]:2000``. A host without a port has the port `port`. On each host, the first worker
    uses the port of the host, and each further worker a port that is `port_step` higher. Raises `InputError` if a port
    is out of range.
    """
    all_hosts = [host_text.strip() for host_text in hosts.split("+")]
    address = all_hosts[worker % len(all_hosts)]
    host, explicit_port = _split_address(address)
    try:
        first = int(explicit_port or port)
    except ValueError:
        raise InputError(f"'{address}' is not a host; write it as host or host:port.") from None
    worker_port = first + port_step * (worker // len(all_hosts))
    if not host or not 0 < worker_port < 65536:
        raise InputError(f"{host}:{worker_port} is not a valid address; give a host, and a port from 1 to 65535.")
    return host, worker_port


def _split_address(address: str) -> tuple[str, str]:
    """Split an address into host and port; the port is empty if it is missing."""
    bracketed = _BRACKETED_HOST.fullmatch(address)
    if bracketed is not None:
        return bracketed[1], bracketed[2] or ""
    with suppress(ValueError):
        return str(IPv6Address(address)), ""
    host, _, port = address.partition(":")
    return host, port
