"""Boxes and types of entities, read from the scenario file or the TestRun: CarMaker's result files lack both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from lxml import etree

from cornercase.recordings._from_samples import EntityBox
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._scope import Scope
from cornercase.simulators.carmaker._testrun_files import TestRunFiles

_DEFAULT_BOX: Final = EntityBox("car", 4.5, 1.8)
_OBJECT_TYPES: Final = {"Pedestrian": "pedestrian", "MiscObject": "misc"}
# Length in m by which a box of the scenario file may differ from the box of the TestRun.
_SAME_BOX: Final = 0.1


def find_entity_boxes(
    scenario: ScenarioFile, values: Mapping[str, Value], testrun: TestRunFiles | None
) -> dict[str, EntityBox]:
    """Return the box of each entity, from the scenario file or else from the TestRun.

    If neither contains a box, the entity is taken for a car of 4.5 m x 1.8 m. If both contain a box, the distance from
    the reference point to the centre of the box is taken from the TestRun.
    """
    # Named values that the scenario does not declare are for the TestRun only.
    declared = {name: value for name, value in values.items() if name in scenario.parameters}
    stored = {} if testrun is None else testrun.boxes
    boxes = dict[str, EntityBox]()
    for name, box in _read_boxes(scenario, declared).items():
        other = stored.get(name)
        if box is None:
            boxes[name] = other or _DEFAULT_BOX
        else:
            boxes[name] = box if other is None else replace(box, ahead=other.ahead)
    return boxes


def describe_box_problems(scenario: ScenarioFile, testrun: TestRunFiles | None) -> list[str]:
    """Return sentences about entities whose boxes are missing or contradictory.

    A box is missing if neither the scenario file nor the TestRun has it, and contradictory if its length or width in
    the two differs by more than 0.1 m.
    """
    boxes, stored = _read_boxes(scenario, {}), {} if testrun is None else testrun.boxes
    sentences = [
        f"{scenario.path}: the box of {name} is {box.length:g} m x {box.width:g} m, and in the files of the TestRun"
        f" {stored[name].length:g} m x {stored[name].width:g} m; the box of the scenario file is used"
        for name, box in boxes.items()
        if box is not None
        and name in stored
        and max(abs(box.length - stored[name].length), abs(box.width - stored[name].width)) > _SAME_BOX
    ]
    missing = [name for name, box in boxes.items() if box is None and name not in stored]
    if missing:
        verb = "has" if len(missing) == 1 else "have"
        sentences.append(
            f"{scenario.path}: {', '.join(missing)} {verb} no <BoundingBox>, and CarMaker's result files have no sizes;"
            f" assumed to be a car of {_DEFAULT_BOX.length:g} m x {_DEFAULT_BOX.width:g} m"
        )
    return sentences


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
