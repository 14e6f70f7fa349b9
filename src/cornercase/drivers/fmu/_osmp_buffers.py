"""Messages that are passed to an FMU and back by address and size, as OSMP demands.

Nothing big is imported, since this runs in small processes of their own.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from typing import Final

from cornercase.drivers.fmu._instance import FmuError, Instance

_MASK: Final = 0xFFFFFFFF
_MAX_SIZE: Final = 0x7FFFFFFF
# Type of the three integers, and their references: lower and upper half of the address, and size.
MessageLayout = tuple[str, Sequence[int]]


class MessageBuffers:
    """The messages that an instance is given, one per input; an empty one stands for none.

    Those of the step before stay where they are, so that an FMU may compare both.
    """

    def __init__(self, layouts: Sequence[MessageLayout]) -> None:
        self._layouts, self._last_two = layouts, deque[list[bytes]]([[b""] * len(layouts)], maxlen=2)

    @property
    def newest(self) -> list[bytes]:
        """The messages for the next step."""
        return self._last_two[-1]

    def replace(self, messages: list[bytes]) -> None:
        """Take the messages for the next step."""
        self._last_two.append(messages)

    def pass_to(self, instance: Instance) -> None:
        """Tell an instance where its messages are."""
        for layout, message in zip(self._layouts, self.newest, strict=True):
            pass_message(instance, layout, message)


def pass_message(instance: Instance, layout: MessageLayout, message: bytes) -> None:
    """Give an instance the address of a message; keep the bytes as long as the instance may read them."""
    address = ctypes.cast(ctypes.c_char_p(message), ctypes.c_void_p).value or 0 if message else 0
    kind, references = layout
    to_integer = ctypes.c_uint32 if kind == "UInt32" else ctypes.c_int32
    values = (address & _MASK, address >> 32, len(message))
    instance.set(kind, references, [to_integer(value).value for value in values])


def read_message(instance: Instance, layout: MessageLayout) -> bytes:
    """Return a copy of the message that an instance has written; empty if there is none."""
    kind, references = layout
    low, high, size = (value & _MASK for value in instance.get(kind, references))
    address = high << 32 | low
    if not address or not size:
        return b""
    if size > _MAX_SIZE:
        raise FmuError("the size of its OSI message is negative")
    return ctypes.string_at(address, size)
