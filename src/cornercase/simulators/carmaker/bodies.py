"""Boxes and kinds of the entities, which CarMaker's result files do not tell, from the scenario file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

from lxml import etree

from cornercase._common.errors import NoticeWarning
from cornercase.recordings import EntityBox
from cornercase.scenario import Scenario, Scope, Value

_USUAL = EntityBox("car", 4.5, 1.8)
_KINDS = {"Pedestrian": "pedestrian", "MiscObject": "misc"}


def read_bodies(scenario: Scenario, values: Mapping[str, Value]) -> dict[str, EntityBox]:
    """Read the box and the kind of each entity.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str
        Of its parameters.

    Returns
    -------
    dict of str to EntityBox
        By entity. Where the file does not tell, a car of 4.5 m x 1.8 m, with a notice.

    Raises
    ------
    InputError
        A size cannot be read.
    """
    # A named value that the scenario does not declare is the TestRun's.
    declared = {name: value for name, value in values.items() if name in scenario.parameters}
    scope = Scope.of_file(str(scenario.path), scenario.root, [declared], scenario.catalog_entry)
    return {
        element.get("name", ""): _body(element, scope) or _USUAL
        for element in scenario.root.iterfind("Entities/ScenarioObject")
    }


def warn_of_missing(scenario: Scenario) -> None:
    """Say whose box the file does not tell.

    Parameters
    ----------
    scenario : Scenario

    Warns
    -----
    NoticeWarning
        Somebody's is missing.
    """
    scope = Scope.of_file(str(scenario.path), scenario.root, [{}], scenario.catalog_entry)
    missing = [
        element.get("name", "")
        for element in scenario.root.iterfind("Entities/ScenarioObject")
        if _body(element, scope) is None
    ]
    if missing:
        have = "has" if len(missing) == 1 else "have"
        warnings.warn(
            f"{scenario.path}: {', '.join(missing)} {have} no <BoundingBox>, and CarMaker's result files hold no sizes;"
            f" assumed to be a car of {_USUAL.length:g} m x {_USUAL.width:g} m",
            NoticeWarning,
            stacklevel=3,
        )


def _body(element: etree._Element, scope: Scope) -> EntityBox | None:
    body = next((one for one in element.iterchildren("Vehicle", "Pedestrian", "MiscObject", "CatalogReference")), None)
    if body is None:
        return None
    if body.tag == "CatalogReference":
        body, scope = scope.from_catalog(body)
    else:
        scope = scope.within(body)
    dimensions = body.find("BoundingBox/Dimensions")
    if dimensions is None:
        return None
    kind = _KINDS.get(body.tag) or scope.text(body, "vehicleCategory", "car")
    return EntityBox(kind, scope.one_number(dimensions, "length"), scope.one_number(dimensions, "width"))
