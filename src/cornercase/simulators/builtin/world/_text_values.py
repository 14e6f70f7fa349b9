"""Values of variables and parameters as texts, and the check whether a scenario file has certain conditions."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from lxml import etree

from cornercase._common.io.tracked_xml import iter_descendants_untracked, note_adaptation
from cornercase.scenario._scope import Scope

_BOOLEAN_TEXTS: Final = {"true": "true", "1": "true", "false": "false", "0": "false"}


def read_text_value(element: etree._Element, scope: Scope, values: npt.NDArray[np.str_]) -> str:
    """Read the ``value`` of an element as text.

    If all present `values` of the variable or parameter are boolean, 1 and 0 are read as ``"true"`` and ``"false"``.
    """
    text = scope.read_text(element, "value")
    if not set(np.unique(values)) <= {"true", "false"} or text.lower() not in _BOOLEAN_TEXTS:
        return text
    truth = _BOOLEAN_TEXTS[text.lower()]
    if text not in _BOOLEAN_TEXTS:
        rule = "a boolean is true, false, 1 or 0"
        note_adaptation(element, f"value of <{element.tag}>", f"'{text}' is read as {truth}", rule)
    return truth


def has_no_conditions_with_tags(element: etree._Element, *conditions: str) -> bool:
    """Return whether the scenario file of an element holds no condition with one of the given tags.

    Returns False if the file uses catalogs of maneuvers, since these may hold one.
    """
    root = element.getroottree().getroot()
    # This search must not mark elements as read.
    found_conditions = iter_descendants_untracked(root, *conditions)
    groups = iter_descendants_untracked(root, "ManeuverGroup")
    references = (
        reference for group in groups for reference in etree.ElementBase.iterchildren(group, "CatalogReference")
    )
    is_scenario_file = etree.ElementBase.find(root, "Storyboard") is not None
    return is_scenario_file and next(found_conditions, None) is None and next(references, None) is None
