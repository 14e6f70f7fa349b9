"""Read the entities of a scenario file, and their trailers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import suggest_name
from cornercase._common.io.tracked_xml import find_by_name, find_untracked, note_adaptation
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.track_kernels._track_layout import ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES
from cornercase.simulators.builtin.world._trailers import MAX_TRAILERS, read_tow, sort_front_to_back
from cornercase.simulators.builtin.world._world import Entity, Tow

_HEADING_INTERPOLATIONS: Final = {
    "segment": ALONG_SEGMENTS,
    "corner": AT_CORNERS,
    "off": AT_VERTICES,
    "none": AT_VERTICES,
}

# m; larger than any vehicle or object beside a road.
_MAX_SIZE: Final = 10_000.0
# Wheelbase as a share of the length, and largest angle of the front wheels in rad, of vehicles without axles.
_DEFAULT_WHEELBASE: Final = 0.6
_DEFAULT_MAX_STEERING: Final = 0.6
# Length, width and longitudinal centre in m, if a file gives none: as of esmini's entities, or of common vehicles.
_DEFAULT_SIZES: Final = {
    "car": (5.04, 2.0, 1.4),
    "van": (4.5, 1.8, 1.3),
    "truck": (5.7, 2.6, 2.2),
    "bus": (12.0, 2.55, 3.0),
    "trailer": (4.5, 2.0, 1.4),
    "semitrailer": (11.23, 2.6, 2.56),
    "motorbike": (2.5, 0.5, 1.0),
    "bicycle": (1.8, 0.5, 0.5),
    "tram": (30.0, 2.4, 0.0),
    "train": (25.0, 2.8, 0.0),
    "pedestrian": (0.6, 0.5, 0.06),
    "misc": (1.0, 1.0, 0.0),
}
_TRAILER_RULE: Final = "the <Trailer> of a vehicle holds a <TrailerRef> or a <Trailer>"
_LIMIT_ATTRIBUTES: Final = ("maxSpeed", "maxAcceleration", "maxDeceleration")


def read_entities(objects: Sequence[etree._Element], scope: Scope) -> tuple[tuple[Entity, ...], tuple[Tow, ...]]:
    """Read all entities of a file, and the pairs of vehicle and trailer (tows).

    Trailers that are defined inside a ``<Trailer>`` come after all other entities. The name of such a trailer is the
    name of the vehicle or trailer that pulls it, with ``+`` appended, whatever its own name in the file.
    """
    bodies = [_find_entity_element(element, element.get("name", ""), scope) for element in objects]
    names = [element.get("name", "") for element in objects]
    entities = [_read_entity(body, name, body_scope) for name, (body, body_scope) in zip(names, bodies, strict=True)]
    pairs = []
    for k, (body, body_scope) in enumerate(bodies[: len(objects)]):
        front = k
        for trailer in _iter_trailers(body, body_scope, names[k]):
            if isinstance(trailer, str):
                if trailer not in names:
                    raise body_scope.error_at(
                        body,
                        f"<Trailer>: the entity '{names[k]}' pulls"
                        f" '{trailer}', which does not exist; {suggest_name(trailer, names)}",
                    )
                pairs.append((front, names.index(trailer)))
                break
            bodies.append(trailer)
            entities.append(_read_entity(trailer[0], entities[front].name + "+", trailer[1]))
            pairs.append((front, len(entities) - 1))
            front = len(entities) - 1
    return tuple(entities), sort_front_to_back(
        [read_tow(front_row, rear_row, entities) for front_row, rear_row in pairs]
    )


def _find_entity_element(element: etree._Element, name: str, scope: Scope) -> tuple[etree._Element, Scope]:
    outer_scope = scope
    body = next((e for e in element.iterchildren("Vehicle", "Pedestrian", "MiscObject", "CatalogReference")), None)
    if body is not None and body.tag == "CatalogReference":
        body, scope = scope.resolve_catalog_reference(body)
    elif body is not None:
        scope = scope.nested_scope(body)
    if body is None or body.tag not in ("Vehicle", "Pedestrian", "MiscObject"):
        raise outer_scope.error_at(
            element,
            f"the <{element.tag}> '{name}' is not a vehicle,"
            " pedestrian or misc object, the only ones that the builtin simulator can move.",
        )
    return body, scope


def _read_entity(body: etree._Element, name: str, scope: Scope) -> Entity:
    kind = {"Pedestrian": "pedestrian", "MiscObject": "misc"}.get(body.tag) or scope.read_text(
        body, "vehicleCategory", "car"
    )
    # A misc object cannot move by itself.
    limits = (0.0 if body.tag == "MiscObject" else np.inf, np.inf, np.inf)
    performance = body.find("Performance")
    if performance is not None:
        max_speed, max_acceleration, max_deceleration = (
            scope.read_number(performance, a, np.inf) for a in _LIMIT_ATTRIBUTES
        )
        limits = (max_speed, max_acceleration, max_deceleration)
        for attribute, limit in zip(_LIMIT_ATTRIBUTES, limits, strict=True):
            if limit < 0.0:
                raise scope.error_at(
                    performance, f"<Performance>: {attribute} of '{name}' is {limit:g}; it must not be below 0."
                )
    length, width, center_x = _read_bounding_box(body, kind, scope)
    if not (length > 0 and width > 0):
        raise scope.error_at(body, f"<Dimensions>: the bounding box of '{name}' needs a positive length and width.")
    if max(length, width, abs(center_x)) > _MAX_SIZE:
        raise scope.error_at(
            body, f"<BoundingBox>: the bounding box of '{name}' is larger than {_MAX_SIZE:g} m; give it in m."
        )
    # Two properties that esmini defines.
    items = find_untracked(body, "Properties", "Property")
    elements = {key: find_by_name(items, key) for key in ("ignoreHeadingForTrajMotion", "plineInterpolation")}
    properties = {key: "" if item is None else scope.read_text(item, "value") for key, item in elements.items()}
    slides = properties["ignoreHeadingForTrajMotion"] == "true"
    turning = _HEADING_INTERPOLATIONS.get(properties["plineInterpolation"])
    body_and_scope = body, scope
    wheelbase, max_steering = _read_axles(body, length, scope)
    return Entity(
        name, kind, length, width, center_x, *limits, wheelbase, max_steering, slides, turning, body_and_scope
    )


def _read_axles(body: etree._Element, length: float, scope: Scope) -> tuple[float, float]:
    """Return wheelbase in m and largest angle of the front wheels in rad; defaults if the file has none above 0."""
    # Only vehicles that are steered use them, so they do not count as read.
    front, rear = (next(iter(find_untracked(body, "Axles", tag)), None) for tag in ("FrontAxle", "RearAxle"))
    positions = [0.0 if axle is None else scope.read_number(axle, "positionX", 0.0) for axle in (front, rear)]
    max_steering = 0.0 if front is None else scope.read_number(front, "maxSteering", 0.0)
    wheelbase = positions[0] - positions[1]
    return (
        wheelbase if wheelbase > 0.0 else _DEFAULT_WHEELBASE * length,
        max_steering if max_steering > 0.0 else _DEFAULT_MAX_STEERING,
    )


def _read_bounding_box(body: etree._Element, object_type: str, scope: Scope) -> tuple[float, float, float]:
    """Return length, width and longitudinal centre of the box in m, by default those of the entity's type."""
    dimensions, center = body.find("BoundingBox/Dimensions"), body.find("BoundingBox/Center")
    length, width, default_center_x = _DEFAULT_SIZES.get(object_type, _DEFAULT_SIZES["car"])
    given = {} if dimensions is None else {key: scope.read_number(dimensions, key, 0.0) for key in ("length", "width")}
    center_x = default_center_x if center is None else scope.read_number(center, "x")
    size = given.get("length") or length, given.get("width") or width
    if center is None or not all(given.get(key) for key in ("length", "width")):
        part = "<BoundingBox>" if dimensions is None or center is None else "size of <BoundingBox>"
        reason = (
            f"the {object_type} is taken as {size[0]:g} m long and {size[1]:g} m wide, its centre {center_x:g} m ahead"
        )
        rule = "an entity has a <BoundingBox> with <Center> and <Dimensions>, which are above 0 m"
        note_adaptation(body if dimensions is None else dimensions, part, reason, rule)
    return *size, center_x


def _iter_trailers(
    body: etree._Element, scope: Scope, vehicle_name: str
) -> Iterator[tuple[etree._Element, Scope] | str]:
    """Yield the trailers of a vehicle from front to back, each as XML element and scope.

    A trailer that is an entity of its own is yielded as the name of this entity, and is the last one.
    """
    for _ in range(MAX_TRAILERS):
        holder = body.find("Trailer")
        if holder is None:
            return
        if name_of_entity := _read_trailer_reference(holder, scope):
            yield name_of_entity
            return
        inner = _trailer_body_parent(holder, scope)
        if inner is None:
            return
        body, scope = _find_entity_element(inner, vehicle_name, scope)
        yield body, scope
    if body.find("Trailer") is None:
        return
    raise scope.error_at(body, f"the <Trailer> of the entity '{vehicle_name}' pulls more than {MAX_TRAILERS} trailers.")


def _read_trailer_reference(holder: etree._Element, scope: Scope) -> str:
    """Return the name of the entity to which a ``<Trailer>`` refers; empty if it refers to none."""
    names = []
    for element in holder.iterchildren("TrailerRef", "EntityRef"):
        names.append(scope.read_text(element, "entityRef", ""))
        if element.tag == "EntityRef":
            note_adaptation(element, "<EntityRef> in <Trailer>", "is read as <TrailerRef>", _TRAILER_RULE)
    return next(filter(None, names), "")


def _trailer_body_parent(holder: etree._Element, scope: Scope) -> etree._Element | None:
    if (inner := holder.find("Trailer")) is not None:
        return inner
    for direct in holder.iterchildren("Vehicle", "CatalogReference"):
        # As in esmini, a reference without an entry name is no trailer.
        if direct.tag == "CatalogReference" and not scope.read_text(direct, "entryName", ""):
            return None
        note_adaptation(direct, f"<{direct.tag}> in <Trailer>", f"is read as <Trailer><{direct.tag}>", _TRAILER_RULE)
        return holder
    return None
