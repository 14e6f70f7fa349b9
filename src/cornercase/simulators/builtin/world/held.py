"""Values of variables and parameters that are texts, and who asks for what a file changes."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from lxml import etree

from cornercase._common.recorded_xml import adapt, below
from cornercase.scenario import Scope

_TRUTHS: Final = {"true": "true", "1": "true", "false": "false", "0": "false"}


def as_held(element: etree._Element, scope: Scope, values: npt.NDArray[np.str_]) -> str:
    """Read the ``value`` of an element as one of those that a variable or parameter has.

    Parameters
    ----------
    element : lxml element
    scope : Scope
        Values of the parameters there.
    values : ndarray of str, shape (N,)

    Returns
    -------
    str
        For booleans ``"true"`` or ``"false"``, however they are written.
    """
    text = scope.text(element, "value")
    if not set(np.unique(values)) <= {"true", "false"} or text.lower() not in _TRUTHS:
        return text
    truth = _TRUTHS[text.lower()]
    if text not in _TRUTHS:
        rule = "a boolean is true, false, 1 or 0"
        adapt(element, f"value of <{element.tag}>", f"'{text}' is read as {truth}", rule)
    return truth


def nobody_asks(element: etree._Element, *conditions: str) -> bool:
    """Whether no condition of some kinds stands in an element's file, nor may in a catalog that it refers to.

    Parameters
    ----------
    element : lxml element
    *conditions : str
        Tags.

    Returns
    -------
    bool
        Never so for an element of a catalog.
    """
    root = element.getroottree().getroot()
    # Looking through the file does not count as reading it.
    asked = below(root, *conditions)
    groups = below(root, "ManeuverGroup")
    referred = (one for group in groups for one in etree.ElementBase.iterchildren(group, "CatalogReference"))
    stands = etree.ElementBase.find(root, "Storyboard") is not None
    return stands and next(asked, None) is None and next(referred, None) is None
