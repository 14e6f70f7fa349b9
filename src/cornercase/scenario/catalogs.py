"""Look up catalog entries by the names of catalog and entry."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.recorded_xml import children

_CATALOG: Final = re.compile(rb"<(?:[A-Za-z_][\w.-]*:)?Catalog[\s/>]")
# Byte order marks of UTF-16.
_WIDE: Final = (b"\xff\xfe", b"\xfe\xff")


def holds_catalog(content: bytes) -> bool:
    """Whether a file seems to hold a catalog, judged by its text without parsing it."""
    return content.startswith(_WIDE) or _CATALOG.search(content) is not None


class Catalogs:
    """The catalogs among the files in a scenario's catalog locations."""

    def __init__(self, source: Path, documents: Iterable[tuple[Path, etree._Element]]) -> None:
        self._source = source
        self._named: dict[str, list[tuple[Path, etree._Element]]] = {}
        for file, root in documents:
            catalog = root.find("Catalog")
            if catalog is not None:
                # As in esmini, the file name also names the catalog.
                for name in dict.fromkeys((catalog.get("name", ""), file.stem)):
                    self._named.setdefault(name, []).append((file, catalog))

    def named(self, catalog: str) -> list[etree._Element]:
        """Return all catalogs of a name."""
        return [element for _, element in self._named.get(catalog, ())]

    def entry_anywhere(self, entry: str) -> etree._Element | None:
        """Return the first entry of a name in any catalog, or None."""
        for documents in self._named.values():
            for _, catalog in documents:
                for element in children(catalog):
                    if element.attrib.get("name") == entry:
                        element.get("name")
                        return element
        return None

    def entry(self, catalog: str, entry: str) -> etree._Element:
        """Return an entry of a catalog.

        Among several catalogs with that name, one whose file has the name too is preferred.
        """
        if catalog not in self._named:
            raise InputError(f"{self._source}: there is no catalog '{catalog}'; {suggestion(catalog, self._named)}")
        matches: list[tuple[Path, etree._Element]] = []
        names: list[str] = []
        for file, holder in self._named[catalog]:
            entries = {str(e.attrib.get("name", "")): e for e in children(holder)}
            names += entries
            matches += [(file, entries[entry])] if entry in entries else []
        if not matches:
            raise InputError(
                f"{self._source}: the catalog '{catalog}' has no entry '{entry}'; {suggestion(entry, names)}"
            )
        preferred = [holder for holder in matches if holder[0].stem == catalog] or matches
        if len({etree.tostring(element, method="c14n").strip() for _, element in preferred}) > 1:
            raise InputError(
                f"{self._source}: the entry '{entry}' of the catalog '{catalog}' is in"
                f" {' and in '.join(str(file) for file, _ in preferred)}, with different contents;"
                " give the catalogs different names."
            )
        preferred[0][1].get("name")
        return preferred[0][1]
