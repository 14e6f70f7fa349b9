"""XML elements that track which of them were read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from lxml import etree

T = TypeVar("T")

# lxml's own methods, which track nothing.
_get = etree.ElementBase.get
_find = etree.ElementBase.find
_children = etree.ElementBase.iterchildren


class RecordedElement(etree.ElementBase):
    """An element that tracks whether it was found, and which of its attributes were requested.

    `find`, `findall`, `iterfind`, `iterchildren`, `iter` with a tag, and iteration over the children mark elements as
    found. `iter` without a tag, `attrib`, `items` and `getparent` do not, so that a file can be searched without
    counting as read. lxml drops element objects that nobody references: whoever asks what was read must hold all of
    them, as `XmlFiles` does. `cache` holds what was derived from the element, `adaptations` violations of the
    standard.
    """

    # Class attributes as defaults, so that creating an element costs nothing.
    found: bool = False
    asked: set[str] | None = None
    made: dict[str, Any] | None = None
    adapted: dict[tuple[str, str], str] | None = None

    def get(self, key: Any, default: Any = None) -> Any:
        """Value of an attribute."""
        if self.asked is None:
            self.asked = {key}
        else:
            self.asked.add(key)
        return _get(self, key, default)

    def find(self, path: Any, namespaces: Any = None) -> Any:
        """First element at a path."""
        return _found(_find(self, path, namespaces))

    def findall(self, path: Any, namespaces: Any = None) -> Any:
        """All elements at a path."""
        return [_found(element) for element in etree.ElementBase.findall(self, path, namespaces)]

    def iterfind(self, path: Any, namespaces: Any = None) -> Any:
        """Iterate over the elements at a path."""
        return map(_found, etree.ElementBase.iterfind(self, path, namespaces))

    def iterchildren(self, *tags: Any, **options: Any) -> Any:
        """Children, optionally only with these tags."""
        return map(_found, _children(self, *tags, **options))

    def iter(self, *tags: Any, **options: Any) -> Any:
        """The element and its descendants; with tags, those returned count as found."""
        elements = etree.ElementBase.iter(self, *tags, **options)
        return map(_found, elements) if tags else elements

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        return map(_found, etree.ElementBase.__iter__(self))


def _found(element: Any) -> Any:
    if isinstance(element, RecordedElement):
        element.found = True
    return element


def children(element: etree._Element) -> Iterator[etree._Element]:
    """Child elements, without marking them as read."""
    return _children(element, "*") if isinstance(element, RecordedElement) else element.iterchildren("*")


def below(element: etree._Element, *tags: Any) -> Iterator[etree._Element]:
    """An element and its descendants, optionally only with these tags, without marking them as read."""
    iterate = etree.ElementBase.iter if isinstance(element, etree.ElementBase) else etree._Element.iter
    return iter(iterate(element, *tags))


def unrecorded(element: etree._Element, *tags: str) -> list[etree._Element]:
    """Descendants along a path of tags, without marking them as read."""
    elements = [element]
    for tag in tags:
        elements = [child for parent in elements for child in children(parent) if child.tag == tag]
    return elements


def named(elements: Iterable[etree._Element], name: str) -> etree._Element | None:
    """First element with this name attribute, which alone counts as found; or None."""
    for element in elements:
        if element.attrib.get("name") == name:
            element.get("name")
            return element
    return None


def was_read(element: etree._Element) -> bool:
    """Whether an element was found, or an attribute requested; True if the element tracks nothing."""
    return not isinstance(element, RecordedElement) or element.found or element.asked is not None


def asked_attributes(element: etree._Element) -> frozenset[str] | None:
    """Names of the requested attributes; None if the element tracks nothing."""
    return frozenset(element.asked or ()) if isinstance(element, RecordedElement) else None


def made_once(element: etree._Element, what: str, make: Callable[[], T]) -> T:
    """Return `make()`, cached on the element under the name `key` (if the element tracks anything)."""
    if not isinstance(element, RecordedElement):
        return make()
    if element.made is None:
        element.made = {}
    if what not in element.made:
        element.made[what] = make()
    result: T = element.made[what]
    return result


def adapt(element: etree._Element, what: str, why: str, rule: str) -> None:
    """Note that a part violates the standard, and how it was read (`reason`); `rule` is what the standard says."""
    if isinstance(element, RecordedElement):
        element.adapted = {**(element.adapted or {}), (what, why): rule}


def adaptations(element: etree._Element) -> list[tuple[str, str, str]]:
    """The notes of `note_adaptation`: part, reason and rule of each."""
    notes = element.adapted if isinstance(element, RecordedElement) else None
    return [(what, why, rule) for (what, why), rule in (notes or {}).items()]


def recording_parser(**options: Any) -> etree.XMLParser:
    """Make a parser whose elements track what is read; `options` are those of ``lxml.etree.XMLParser``."""
    parser = etree.XMLParser(**options)
    parser.set_element_class_lookup(etree.ElementDefaultClassLookup(element=RecordedElement))
    return parser
