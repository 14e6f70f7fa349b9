"""Waiting for what other processes and threads do, as long as it takes on a busy machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import psutil

Found = TypeVar("Found")


def until(holds: Callable[[], Found], seconds: float = 120.0) -> Found:
    """Wait until something holds, and give it."""
    end = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)
    return found


def lives(process: int) -> bool:
    """Whether a process is there and has not ended; what nobody asks for its exit code stays in the table."""
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
