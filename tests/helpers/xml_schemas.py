"""What an XML schema allows: every element where it may stand, with its attributes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

from lxml import etree

_XS: Final = "{http://www.w3.org/2001/XMLSchema}"
_GROUPS: Final = ("sequence", "choice", "all", "complexContent", "simpleContent")


class Schema:
    """Types and elements of a schema and of all files that it includes."""

    def __init__(self, file: Path) -> None:
        self._all: list[list[etree._Element]] = []
        self._words: dict[str, set[str]] = {}
        self._types: dict[str, etree._Element] = {}
        self._elements: dict[str, etree._Element] = {}
        self._groups: dict[str, etree._Element] = {}
        self._attributes: dict[str, etree._Element] = {}
        self._read(file, set())

    def _read(self, file: Path, seen: set[Path]) -> None:
        if file in seen:
            return
        seen.add(file)
        root = etree.parse(str(file)).getroot()
        # Held, so that each stays the same object.
        self._all.append(list(root.iter()))
        for one in root:
            kinds = {
                "complexType": self._types,
                "element": self._elements,
                "group": self._groups,
                "attributeGroup": self._attributes,
            }
            kind = _kind(one)
            if kind == "simpleType":
                self._words[one.get("name", "")] = {e.get("value", "") for e in one.iter(f"{_XS}enumeration")}
            if kind in kinds:
                kinds[kind][one.get("name", "")] = one
            elif kind in ("include", "redefine", "import") and one.get("schemaLocation"):
                self._read(file.parent / one.get("schemaLocation", ""), seen)

    def places(
        self, *roots: str, ends: Callable[[tuple[str, ...]], bool] = lambda path: False
    ) -> dict[tuple[str, ...], set[str]]:
        """Attributes of each element, by its name and up to three above it, from root elements on.

        Three names above are as much as it takes to tell apart what has one name and different meanings; elements
        that hold themselves come to an end so. Below a place where `ends` is true nothing is looked at.
        """
        found: dict[tuple[str, ...], set[str]] = {}
        left: deque[tuple[tuple[str, ...], etree._Element | None]] = deque(
            ((name,), of) for name in roots for of in self._types_of(self._elements[name])
        )
        seen: set[tuple[tuple[str, ...], int]] = set()
        while left:
            path, kind = left.popleft()
            if (path, id(kind)) in seen:
                continue
            seen.add((path, id(kind)))
            attributes = found.setdefault(path, set())
            if kind is not None and not ends(path):
                attributes |= set(self._attributes_of(kind))
                left.extend(((*path, name)[-4:], of) for name, of in self._children_of(kind))
        return found

    def words(self, *roots: str) -> dict[tuple[str, str], set[str]]:
        """Values of the attributes that take one of a few words, by element and attribute."""
        found: dict[tuple[str, str], set[str]] = {}
        left = [(name, of) for name in roots for of in self._types_of(self._elements[name])]
        seen = set()
        while left:
            name, kind = left.pop()
            if kind is None or (name, id(kind)) in seen:
                continue
            seen.add((name, id(kind)))
            for attribute in kind.iter(f"{_XS}attribute"):
                words = self._words.get(_local(attribute.get("type", "")))
                if words:
                    found.setdefault((name, attribute.get("name", "")), set()).update(words)
            left += self._children_of(kind)
        return found

    def _types_of(self, element: etree._Element) -> list[etree._Element | None]:
        """Type of an element; where it depends on an attribute, all that it may have."""
        inline = element.find(f"{_XS}complexType")
        if inline is not None:
            return [inline]
        names = [element.get("type", ""), *(one.get("type", "") for one in element.iterfind(f"{_XS}alternative"))]
        return [self._types.get(_local(name)) for name in dict.fromkeys(names) if name] or [None]

    def _children_of(self, kind: etree._Element) -> list[tuple[str, etree._Element | None]]:
        found: list[tuple[str, etree._Element | None]] = []
        for one in kind:
            tag = _kind(one)
            if tag == "element":
                element = self._elements[_local(one.get("ref", ""))] if one.get("ref") else one
                found += [(element.get("name", ""), of) for of in self._types_of(element)]
            elif tag == "group" and one.get("ref"):
                found += self._children_of(self._groups[_local(one.get("ref", ""))])
            elif tag == "extension":
                base = self._types.get(_local(one.get("base", "")))
                found += ([] if base is None else self._children_of(base)) + self._children_of(one)
            elif tag in (*_GROUPS, "restriction"):
                found += self._children_of(one)
        return found

    def _attributes_of(self, kind: etree._Element) -> list[str]:
        found: list[str] = []
        for one in kind:
            tag = _kind(one)
            if tag == "attribute" and one.get("use") != "prohibited":
                found.append(one.get("name") or _local(one.get("ref", "")))
            elif tag == "attributeGroup":
                found += self._attributes_of(self._attributes[_local(one.get("ref", ""))])
            elif tag == "extension":
                base = self._types.get(_local(one.get("base", "")))
                found += ([] if base is None else self._attributes_of(base)) + self._attributes_of(one)
            elif tag in (*_GROUPS, "restriction"):
                found += self._attributes_of(one)
        return found


def _kind(element: etree._Element) -> str:
    return str(element.tag).removeprefix(_XS)


def _local(name: str) -> str:
    return name.rpartition(":")[2]
