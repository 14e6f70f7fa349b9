"""XML elements that record which elements and attributes were read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from lxml import etree

T = TypeVar("T")

# lxml's own methods, which track nothing.
_get = etree.ElementBase.get
_find = etree.ElementBase.find
_children = etree.ElementBase.iterchildren


class TrackedElement(etree.ElementBase):
    """An XML element that records whether it was found, and which of its attributes were requested.

    `find`, `findall`, `iterfind`, `iterchildren`, `iter` with a tag, and iteration over the children mark elements as
    found. `iter` without a tag, `attrib`, `items` and `getparent` mark nothing. lxml deletes element objects without
    references, together with their marks. So keep references to all elements of a file as long as the marks are needed,
    as `XmlFileCache` does. `cache` holds values derived from the element; `adaptations` holds the element's violations
    of the standard, see `list_adaptations`.
    """

    # Class attributes as defaults, so that creating an element costs nothing.
    is_found: bool = False
    requested_attributes: set[str] | None = None
    cache: dict[str, Any] | None = None
    adaptations: dict[tuple[str, str], str] | None = None

    def get(self, key: Any, default: Any = None) -> Any:
        """Return the value of an attribute, and record that it was requested."""
        if self.requested_attributes is None:
            self.requested_attributes = {key}
        else:
            self.requested_attributes.add(key)
        return _get(self, key, default)

    def find(self, path: Any, namespaces: Any = None) -> Any:
        """Return the first element at a path, or None, and mark the element as found."""
        return _mark_found(_find(self, path, namespaces))

    def findall(self, path: Any, namespaces: Any = None) -> Any:
        """Return all elements at a path, and mark them as found."""
        return [_mark_found(element) for element in etree.ElementBase.findall(self, path, namespaces)]

    def iterfind(self, path: Any, namespaces: Any = None) -> Any:
        """Iterate over the elements at a path, and mark them as found."""
        return map(_mark_found, etree.ElementBase.iterfind(self, path, namespaces))

    def iterchildren(self, *tags: Any, **options: Any) -> Any:
        """Iterate over the children, optionally only with these tags, and mark them as found."""
        return map(_mark_found, _children(self, *tags, **options))

    def iter(self, *tags: Any, **options: Any) -> Any:
        """Iterate over the element and its descendants.

        If tags are given, only elements with these tags are returned, and these elements are marked as found.
        """
        elements = etree.ElementBase.iter(self, *tags, **options)
        return map(_mark_found, elements) if tags else elements

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        return map(_mark_found, etree.ElementBase.__iter__(self))


def _mark_found(element: Any) -> Any:
    if isinstance(element, TrackedElement):
        element.is_found = True
    return element


def iter_children_untracked(element: etree._Element) -> Iterator[etree._Element]:
    """Iterate over the child elements without marking them as read."""
    return _children(element, "*") if isinstance(element, TrackedElement) else element.iterchildren("*")


def iter_descendants_untracked(element: etree._Element, *tags: Any) -> Iterator[etree._Element]:
    """Iterate over an element and its descendants without marking them as read; optionally only over these tags."""
    iterate = etree.ElementBase.iter if isinstance(element, etree.ElementBase) else etree._Element.iter
    return iter(iterate(element, *tags))


def find_untracked(element: etree._Element, *tags: str) -> list[etree._Element]:
    """Return the descendants along a path of tags, without marking them as read."""
    elements = [element]
    for tag in tags:
        elements = [child for parent in elements for child in iter_children_untracked(parent) if child.tag == tag]
    return elements


def find_by_name(elements: Iterable[etree._Element], name: str) -> etree._Element | None:
    """Return the first element with this name attribute, or None; only this element is marked as found."""
    for element in elements:
        if element.attrib.get("name") == name:
            element.get("name")
            return element
    return None


def is_read(element: etree._Element) -> bool:
    """Return whether an element was found or one of its attributes requested; True for untracked elements."""
    return not isinstance(element, TrackedElement) or element.is_found or element.requested_attributes is not None


def requested_attributes(element: etree._Element) -> frozenset[str] | None:
    """Return the names of the attributes that were requested; None if the element is not tracked."""
    return frozenset(element.requested_attributes or ()) if isinstance(element, TrackedElement) else None


def cached_on_element(element: etree._Element, key: str, make: Callable[[], T]) -> T:
    """Return the result of `make`; on a tracked element, the result is cached under `key`."""
    if not isinstance(element, TrackedElement):
        return make()
    if element.cache is None:
        element.cache = {}
    if key not in element.cache:
        element.cache[key] = make()
    result: T = element.cache[key]
    return result


def note_adaptation(element: etree._Element, part: str, reason: str, rule: str) -> None:
    """Record that a part of an element violates the standard.

    `reason` says how the part was read instead; `rule` quotes the standard.
    """
    if isinstance(element, TrackedElement):
        element.adaptations = {**(element.adaptations or {}), (part, reason): rule}


def list_adaptations(element: etree._Element) -> list[tuple[str, str, str]]:
    """Return part, reason and rule of each violation of the standard that `note_adaptation` recorded."""
    notes = element.adaptations if isinstance(element, TrackedElement) else None
    return [(what, why, rule) for (what, why), rule in (notes or {}).items()]


def make_tracking_parser(**options: Any) -> etree.XMLParser:
    """Make an XML parser whose elements are tracked; `options` are those of ``lxml.etree.XMLParser``."""
    parser = etree.XMLParser(**options)
    parser.set_element_class_lookup(etree.ElementDefaultClassLookup(element=TrackedElement))
    return parser
