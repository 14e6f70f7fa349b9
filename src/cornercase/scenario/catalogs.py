"""Entries of catalogs, by the names of both."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.recorded_xml import children

_CATALOG: Final = re.compile(rb"<(?:[A-Za-z_][\w.-]*:)?Catalog[\s/>]")
# Files in two bytes a character begin so.
_WIDE: Final = (b"\xff\xfe", b"\xfe\xff")


def holds_catalog(content: bytes) -> bool:
    """Tell whether a file holds a catalog, as far as that shows before it is parsed."""
    return content.startswith(_WIDE) or _CATALOG.search(content) is not None


class Catalogs:
    """The catalogs of a scenario.

    Parameters
    ----------
    source : Path
        The scenario file, for messages.
    documents : iterable of (Path, lxml element)
        Files in its catalog locations, and their roots; what is no catalog is left out.
    """

    def __init__(self, source: Path, documents: Iterable[tuple[Path, etree._Element]]) -> None:
        self._source = source
        self._named: dict[str, list[tuple[Path, etree._Element]]] = {}
        for file, root in documents:
            catalog = root.find("Catalog")
            if catalog is not None:
                # As in esmini, a catalog can be named by its file as well.
                for name in dict.fromkeys((catalog.get("name", ""), file.stem)):
                    self._named.setdefault(name, []).append((file, catalog))

    def named(self, catalog: str) -> list[etree._Element]:
        """Return the catalogs of a name; none where there is none."""
        return [one for _, one in self._named.get(catalog, ())]

    def entry_anywhere(self, entry: str) -> etree._Element | None:
        """Return the element of a name of whichever catalog has it first; None where none has."""
        for documents in self._named.values():
            for _, one in documents:
                for element in children(one):
                    if element.attrib.get("name") == entry:
                        element.get("name")
                        return element
        return None

    def entry(self, catalog: str, entry: str) -> etree._Element:
        """Return the element that a catalog holds under a name.

        Of several catalogs of the name, one whose file has it, too, goes before the others.

        Parameters
        ----------
        catalog, entry : str

        Returns
        -------
        lxml element

        Raises
        ------
        InputError
            There is no such catalog, it lacks the entry, or several of the name have it and differ.
        """
        if catalog not in self._named:
            raise InputError(f"{self._source}: there is no catalog '{catalog}'; {suggestion(catalog, self._named)}")
        found: list[tuple[Path, etree._Element]] = []
        known: list[str] = []
        for file, one in self._named[catalog]:
            entries = {str(e.attrib.get("name", "")): e for e in children(one)}
            known += entries
            found += [(file, entries[entry])] if entry in entries else []
        if not found:
            raise InputError(
                f"{self._source}: the catalog '{catalog}' has no entry '{entry}'; {suggestion(entry, known)}"
            )
        first = [one for one in found if one[0].stem == catalog] or found
        if len({etree.tostring(element, method="c14n").strip() for _, element in first}) > 1:
            raise InputError(
                f"{self._source}: the entry '{entry}' of the catalog '{catalog}' is in"
                f" {' and in '.join(str(file) for file, _ in first)}, with different contents;"
                " give the catalogs different names."
            )
        first[0][1].get("name")
        return first[0][1]
