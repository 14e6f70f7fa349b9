"""A stand-in of CARLA that runs beside the tests, or the CARLA that CARLA_HOST names."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

REAL = os.environ.get("CARLA_HOST", "")
COUNT = itertools.count(os.getpid() % 250)
# CARLA's client crashes now and then as it connects or closes a connection; a search would try that scenario again.
# What the crash leads to differs, so each failure is tried again.
AGAIN_IF_THE_CLIENT_CRASHES = pytest.mark.flaky(reruns=2)


class Served:
    """A stand-in that runs in a process of its own, since its client may abort."""

    def __init__(self, road, *wrong):
        self.host, self.port = "localhost", free_port()
        if REAL:
            self.host, _, port = REAL.partition(":")
            self.port = int(port or 2000)
            return
        command = [sys.executable, Path(__file__).with_name("carla_protocol_server.py"), str(self.port), road, *wrong]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == b"ready\n"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if not REAL:
            self._process.kill()
            # Closes the pipes too.
            self._process.communicate()


def free_port():
    """A port with the next one free, too, which no other process of the tests takes."""
    part = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    for _ in range(250):
        port = 21000 + 500 * part + 2 * (next(COUNT) % 250)
        with suppress(OSError):
            for one in (port, port + 1):
                socket.create_server(("127.0.0.1", one)).close()
            return port
    raise OSError("no port is free")
