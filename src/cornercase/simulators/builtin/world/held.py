"""Text values of variables and parameters, and whether a file's conditions use them."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from lxml import etree

from cornercase._common.recorded_xml import adapt, below
from cornercase.scenario import Scope

_TRUTHS: Final = {"true": "true", "1": "true", "false": "false", "0": "false"}


def as_held(element: etree._Element, scope: Scope, values: npt.NDArray[np.str_]) -> str:
    """Read the ``value`` of an element; ``"true"`` or ``"false"`` if the variable or parameter is boolean."""
    text = scope.text(element, "value")
    if not set(np.unique(values)) <= {"true", "false"} or text.lower() not in _TRUTHS:
        return text
    truth = _TRUTHS[text.lower()]
    if text not in _TRUTHS:
        rule = "a boolean is true, false, 1 or 0"
        adapt(element, f"value of <{element.tag}>", f"'{text}' is read as {truth}", rule)
    return truth


def nobody_asks(element: etree._Element, *conditions: str) -> bool:
    """Check that no condition with one of the tags is in an element's file; False if catalogs could contain some."""
    root = element.getroottree().getroot()
    # This search must not mark elements as read.
    found_conditions = below(root, *conditions)
    groups = below(root, "ManeuverGroup")
    references = (
        reference for group in groups for reference in etree.ElementBase.iterchildren(group, "CatalogReference")
    )
    is_scenario_file = etree.ElementBase.find(root, "Storyboard") is not None
    return is_scenario_file and next(found_conditions, None) is None and next(references, None) is None
