"""Read the pages of a study file, damaged or not, one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, Final

_PAGE: Final = 4096
# A recording fills several pages, mostly adjacent.
_REMEMBERED: Final = 256


class Pages:
    """Pages of an SQLite file; `size` is the number of bytes of a page, `length` that of the file."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.length = file.seek(0, 2)
        file.seek(16)
        size = int.from_bytes(file.read(2), "big")
        size = 65536 if size == 1 else size
        # An invalid page size is damaged.
        self.size = size if size >= 512 and not size & (size - 1) else _PAGE
        self.page = lru_cache(_REMEMBERED)(self._page)

    def __len__(self) -> int:
        return -(-self.length // self.size)

    def _page(self, number: int) -> bytes:
        """Read a page, numbered from 1; it is shorter if the file ends within it."""
        if number < 1:
            raise ValueError("a page before the first")
        self._file.seek((number - 1) * self.size)
        return self._file.read(self.size)


@contextmanager
def opened_pages(path: Path) -> Iterator[Pages]:
    """Open the pages of a study for as long as the block lasts."""
    with path.open("rb") as file:
        yield Pages(file)
