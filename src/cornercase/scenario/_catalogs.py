"""Look up catalog entries by the names of catalog and entry."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.tracked_xml import iter_children_untracked

_CATALOG_TAG: Final = re.compile(rb"<(?:[A-Za-z_][\w.-]*:)?Catalog[\s/>]")
# Byte order marks of UTF-16.
_UTF16_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")


def looks_like_catalog(content: bytes) -> bool:
    """Return whether the content of a file looks like a catalog, without parsing the content."""
    return content.startswith(_UTF16_MARKS) or _CATALOG_TAG.search(content) is not None


class Catalogs:
    """All catalogs in the catalog locations of a scenario."""

    def __init__(self, scenario_path: Path, documents: Iterable[tuple[Path, etree._Element]]) -> None:
        self._scenario_path = scenario_path
        self._by_name: dict[str, list[tuple[Path, etree._Element]]] = {}
        for file, root in documents:
            catalog = root.find("Catalog")
            if catalog is not None:
                # As in esmini, the file name also names the catalog.
                for name in dict.fromkeys((catalog.get("name", ""), file.stem)):
                    self._by_name.setdefault(name, []).append((file, catalog))

    def find_catalogs(self, name: str) -> list[etree._Element]:
        """Return all catalogs whose name is `name`, or whose file has this name without its extension."""
        return [element for _, element in self._by_name.get(name, ())]

    def find_entry_in_any_catalog(self, entry_name: str) -> etree._Element | None:
        """Return the first entry with the given name in any catalog; None if there is none."""
        for documents in self._by_name.values():
            for _, catalog in documents:
                for element in iter_children_untracked(catalog):
                    if element.attrib.get("name") == entry_name:
                        element.get("name")
                        return element
        return None

    def find_entry(self, catalog_name: str, entry_name: str) -> etree._Element:
        """Return an entry of a catalog.

        If several catalogs of this name have the entry, prefer a catalog whose file has the name of the catalog.
        """
        if catalog_name not in self._by_name:
            raise InputError(
                f"{self._scenario_path}: there is no catalog '{catalog_name}';"
                f" {suggest_name(catalog_name, self._by_name)}"
            )
        matches: list[tuple[Path, etree._Element]] = []
        names: list[str] = []
        for file, holder in self._by_name[catalog_name]:
            entries = {str(e.attrib.get("name", "")): e for e in iter_children_untracked(holder)}
            names += entries
            matches += [(file, entries[entry_name])] if entry_name in entries else []
        if not matches:
            raise InputError(
                f"{self._scenario_path}: the catalog '{catalog_name}' has no entry '{entry_name}';"
                f" {suggest_name(entry_name, names)}"
            )
        preferred = [holder for holder in matches if holder[0].stem == catalog_name] or matches
        if len({etree.tostring(element, method="c14n").strip() for _, element in preferred}) > 1:
            raise InputError(
                f"{self._scenario_path}: the entry '{entry_name}' of the catalog '{catalog_name}' is in"
                f" {' and in '.join(str(file) for file, _ in preferred)}, with different contents;"
                " give the catalogs different names."
            )
        preferred[0][1].get("name")
        return preferred[0][1]
