"""Read boxes and types of entities from the scenario file, since CarMaker's result files contain neither."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

from lxml import etree

from cornercase._common.errors import NoticeWarning
from cornercase.recordings._from_samples import EntityBox
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._scope import Scope

_DEFAULT_BOX = EntityBox("car", 4.5, 1.8)
_OBJECT_TYPES = {"Pedestrian": "pedestrian", "MiscObject": "misc"}


def read_entity_boxes(scenario: ScenarioFile, values: Mapping[str, Value]) -> dict[str, EntityBox]:
    """Return the box of each entity; an entity without a box in the file becomes a car of 4.5 m x 1.8 m."""
    # Named values that the scenario does not declare are for the TestRun only.
    declared = {name: value for name, value in values.items() if name in scenario.parameters}
    return {name: box or _DEFAULT_BOX for name, box in _read_boxes(scenario, declared).items()}


def warn_about_missing_boxes(scenario: ScenarioFile) -> None:
    """Warn about entities without a box in the scenario file."""
    missing = [name for name, box in _read_boxes(scenario, {}).items() if box is None]
    if missing:
        verb = "has" if len(missing) == 1 else "have"
        warnings.warn(
            f"{scenario.path}: {', '.join(missing)} {verb} no <BoundingBox>, and CarMaker's result files have no sizes;"
            f" assumed to be a car of {_DEFAULT_BOX.length:g} m x {_DEFAULT_BOX.width:g} m",
            NoticeWarning,
            stacklevel=3,
        )


def _read_boxes(scenario: ScenarioFile, values: Mapping[str, Value]) -> dict[str, EntityBox | None]:
    scope, elements = scenario.scope([values]), scenario.root.iterfind("Entities/ScenarioObject")
    return {element.get("name", ""): _read_box(element, scope) for element in elements}


def _read_box(element: etree._Element, scope: Scope) -> EntityBox | None:
    body = next(element.iterchildren("Vehicle", "Pedestrian", "MiscObject", "CatalogReference"), None)
    if body is None:
        return None
    if body.tag == "CatalogReference":
        body, scope = scope.resolve_catalog_reference(body)
    else:
        scope = scope.nested_scope(body)
    dimensions = body.find("BoundingBox/Dimensions")
    if dimensions is None:
        return None
    object_type = _OBJECT_TYPES.get(body.tag) or scope.read_text(body, "vehicleCategory", "car")
    return EntityBox(object_type, scope.read_number(dimensions, "length"), scope.read_number(dimensions, "width"))
