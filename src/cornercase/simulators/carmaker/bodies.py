"""Read boxes and types of entities from the scenario file, since CarMaker's result files lack them."""

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
    """Read the box of each entity; a car of 4.5 m x 1.8 m if the file has none."""
    # Named values that the scenario does not declare are for the TestRun only.
    declared = {name: value for name, value in values.items() if name in scenario.parameters}
    scope = Scope.of_file(str(scenario.path), scenario.root, [declared], scenario.catalog_entry)
    return {
        element.get("name", ""): _body(element, scope) or _USUAL
        for element in scenario.root.iterfind("Entities/ScenarioObject")
    }


def warn_of_missing(scenario: Scenario) -> None:
    """Warn about entities without a box in the file."""
    scope = Scope.of_file(str(scenario.path), scenario.root, [{}], scenario.catalog_entry)
    missing = [
        element.get("name", "")
        for element in scenario.root.iterfind("Entities/ScenarioObject")
        if _body(element, scope) is None
    ]
    if missing:
        verb = "has" if len(missing) == 1 else "have"
        warnings.warn(
            f"{scenario.path}: {', '.join(missing)} {verb} no <BoundingBox>, and CarMaker's result files have no sizes;"
            f" assumed to be a car of {_USUAL.length:g} m x {_USUAL.width:g} m",
            NoticeWarning,
            stacklevel=3,
        )


def _body(element: etree._Element, scope: Scope) -> EntityBox | None:
    body = next(
        (child for child in element.iterchildren("Vehicle", "Pedestrian", "MiscObject", "CatalogReference")), None
    )
    if body is None:
        return None
    if body.tag == "CatalogReference":
        body, scope = scope.from_catalog(body)
    else:
        scope = scope.within(body)
    dimensions = body.find("BoundingBox/Dimensions")
    if dimensions is None:
        return None
    object_type = _KINDS.get(body.tag) or scope.text(body, "vehicleCategory", "car")
    return EntityBox(object_type, scope.one_number(dimensions, "length"), scope.one_number(dimensions, "width"))
