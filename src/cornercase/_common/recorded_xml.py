"""XML elements that remember what was read of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from lxml import etree

T = TypeVar("T")

# Those of the class itself, which record nothing.
_get = etree.ElementBase.get
_find = etree.ElementBase.find
_children = etree.ElementBase.iterchildren


class RecordedElement(etree.ElementBase):
    """An element that remembers whether it was found, and which of its attributes were asked for.

    It is found when `find`, `findall`, `iterfind`, `iterchildren`, `iter` with a name, or a loop over the children
    gives it. `iter` without a name, `attrib`, `items` and `getparent` record nothing, so that a file can be looked
    through without counting as read. lxml forgets an element that nobody holds: whoever asks what was read has to
    hold all of them from the start, as `XmlFiles` does.

    Attributes
    ----------
    found : bool
    asked : set of str or None
        Names of attributes, whether or not the element has them; None as long as none was asked for.
    made : dict or None
        What was made of it, for `made_once`.
    adapted : dict or None
        Where it breaks the standard and was read all the same, for `adapt`.
    """

    # Of the class as long as nothing was read, so that an element costs nothing to make.
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
        return [_found(one) for one in etree.ElementBase.findall(self, path, namespaces)]

    def iterfind(self, path: Any, namespaces: Any = None) -> Any:
        """All elements at a path, one after the other."""
        return map(_found, etree.ElementBase.iterfind(self, path, namespaces))

    def iterchildren(self, *tags: Any, **options: Any) -> Any:
        """Children, of all names or of some."""
        return map(_found, _children(self, *tags, **options))

    def iter(self, *tags: Any, **options: Any) -> Any:
        """The element and all below it; those of some names count as found."""
        every = etree.ElementBase.iter(self, *tags, **options)
        return map(_found, every) if tags else every

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        return map(_found, etree.ElementBase.__iter__(self))


def _found(element: Any) -> Any:
    if isinstance(element, RecordedElement):
        element.found = True
    return element


def children(element: etree._Element) -> Iterator[etree._Element]:
    """Give the child elements without recording it."""
    return _children(element, "*") if isinstance(element, RecordedElement) else element.iterchildren("*")


def below(element: etree._Element, *tags: Any) -> Iterator[etree._Element]:
    """Give an element and all below it, or those of some tags, without recording it."""
    every = etree.ElementBase.iter if isinstance(element, etree.ElementBase) else etree._Element.iter
    return iter(every(element, *tags))


def unrecorded(element: etree._Element, *tags: str) -> list[etree._Element]:
    """Give the elements that lie below an element, by the tags on the way to them, without recording it."""
    found = [element]
    for tag in tags:
        found = [child for one in found for child in children(one) if child.tag == tag]
    return found


def named(elements: Iterable[etree._Element], name: str) -> etree._Element | None:
    """First element with a name, which then counts as found, and none of the others; None where there is none."""
    for element in elements:
        if element.attrib.get("name") == name:
            element.get("name")
            return element
    return None


def was_read(element: etree._Element) -> bool:
    """Whether an element was found, or something was read of it; always so where nothing is recorded.

    Parameters
    ----------
    element : lxml element

    Returns
    -------
    bool
    """
    return not isinstance(element, RecordedElement) or element.found or element.asked is not None


def asked_attributes(element: etree._Element) -> frozenset[str] | None:
    """Names of the attributes that were asked for; None where nothing is recorded."""
    return frozenset(element.asked or ()) if isinstance(element, RecordedElement) else None


def made_once(element: etree._Element, what: str, make: Callable[[], T]) -> T:
    """Make something of an element when it is first asked for, and give the same after that.

    Parameters
    ----------
    element : lxml element
        As long as it lasts, what was made of it is kept; of one that records nothing it is made each time.
    what : str
        Name of what is made, each time of the element alone.
    make : callable

    Returns
    -------
    object
    """
    if not isinstance(element, RecordedElement):
        return make()
    if element.made is None:
        element.made = {}
    if what not in element.made:
        element.made[what] = make()
    found: T = element.made[what]
    return found


def adapt(element: etree._Element, what: str, why: str, rule: str) -> None:
    """Note that a part of a file breaks the standard, and how it was read all the same.

    Parameters
    ----------
    element : lxml element
        Where it stands; one that records nothing notes nothing.
    what : str
        The part: ``"type of <ParameterDeclaration>"``.
    why : str
        What it was read as, in plain words; without a capital at its beginning or a full stop at its end.
    rule : str
        What the standard says: ``"the type is one of boolean, …"``; as `why`.
    """
    if isinstance(element, RecordedElement):
        element.adapted = {**(element.adapted or {}), (what, why): rule}


def adaptations(element: etree._Element) -> list[tuple[str, str, str]]:
    """What was noted of an element by `adapt`: what, why and rule of each."""
    noted = element.adapted if isinstance(element, RecordedElement) else None
    return [(what, why, rule) for (what, why), rule in (noted or {}).items()]


def recording_parser(**options: Any) -> etree.XMLParser:
    """Make a parser whose elements record what is read of them; `options` are those of ``lxml.etree.XMLParser``."""
    parser = etree.XMLParser(**options)
    parser.set_element_class_lookup(etree.ElementDefaultClassLookup(element=RecordedElement))
    return parser
