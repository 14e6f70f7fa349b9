"""Exchange of OSI messages with an FMU by memory address and size, as OSI Sensor Model Packaging (OSMP) demands.

Only small modules are imported, since this code runs in the small processes of the FMU.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from typing import Final

from cornercase.drivers.fmu._instance import FmuError, Instance

_MASK: Final = 0xFFFFFFFF
_MAX_SIZE: Final = 0x7FFFFFFF
# FMI type and value references of three integers: lower and upper half of the address, and size.
MessageLayout = tuple[str, Sequence[int]]


class MessageBuffers:
    """Buffers of the OSI messages that an FMU instance is given, one per input; empty bytes stand for no message.

    The messages of the previous step stay in memory, so that the FMU can compare old and new messages.
    """

    def __init__(self, layouts: Sequence[MessageLayout]) -> None:
        self._layouts, self._last_two = layouts, deque[list[bytes]]([[b""] * len(layouts)], maxlen=2)

    @property
    def newest(self) -> list[bytes]:
        """OSI messages for the next step, one per input."""
        return self._last_two[-1]

    def replace(self, messages: list[bytes]) -> None:
        """Set the messages for the next step; the messages set before stay in memory for one more step."""
        self._last_two.append(messages)

    def pass_to(self, instance: Instance) -> None:
        """Set addresses and sizes of the newest messages in an FMU instance."""
        for layout, message in zip(self._layouts, self.newest, strict=True):
            pass_message(instance, layout, message)


def pass_message(instance: Instance, layout: MessageLayout, message: bytes) -> None:
    """Set address and size of a message in an FMU instance; keep `message` alive while the FMU may read it."""
    address = ctypes.cast(ctypes.c_char_p(message), ctypes.c_void_p).value or 0 if message else 0
    kind, references = layout
    to_integer = ctypes.c_uint32 if kind == "UInt32" else ctypes.c_int32
    values = (address & _MASK, address >> 32, len(message))
    instance.set(kind, references, [to_integer(value).value for value in values])


def read_message(instance: Instance, layout: MessageLayout) -> bytes:
    """Return a copy of the OSI message that an FMU instance has written; empty bytes if there is none."""
    kind, references = layout
    low, high, size = (value & _MASK for value in instance.get(kind, references))
    address = high << 32 | low
    if not address or not size:
        return b""
    if size > _MAX_SIZE:
        raise FmuError("it gave its OSI message a negative size")
    return ctypes.string_at(address, size)
