"""Read entities of a scenario file, and their trailers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.places import place_of
from cornercase._common.recorded_xml import adapt, named, unrecorded
from cornercase.scenario import Scope
from cornercase.simulators.builtin.tracks.track import ALONG_LEGS, AT_CORNERS, AT_VERTICES
from cornercase.simulators.builtin.world.state import Entity, Tow
from cornercase.simulators.builtin.world.towing import MOST_TRAILERS, front_first, read_tow

_TURNING: Final = {"segment": ALONG_LEGS, "corner": AT_CORNERS, "off": AT_VERTICES, "none": AT_VERTICES}

# m; larger than any vehicle or object beside a road.
_LARGEST: Final = 10_000.0
# Length, width and longitudinal centre in m, if a file gives none: those of esmini's entities, or of common vehicles.
_SIZES: Final = {
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
_LIMITS: Final = ("maxSpeed", "maxAcceleration", "maxDeceleration")


def read_entities(objects: Sequence[etree._Element], scope: Scope) -> tuple[tuple[Entity, ...], tuple[Tow, ...]]:
    """Read the file's entities and their trailers, and who tows whom (front first).

    The file's entities come first, in order. A trailer without a name of its own has its vehicle's name with ``+``.
    `InputError` for malformed entities, and trailers that are none.
    """
    bodies = [_body(element, element.get("name", ""), scope) for element in objects]
    names = [element.get("name", "") for element in objects]
    entities = [_entity(body, name, body_scope) for name, (body, body_scope) in zip(names, bodies, strict=True)]
    pairs = []
    for k, (body, body_scope) in enumerate(bodies[: len(objects)]):
        front = k
        for trailer in _pulled(body, body_scope, names[k]):
            if isinstance(trailer, str):
                if trailer not in names:
                    raise InputError(
                        f"{place_of(body, body_scope.source)}: <Trailer>: the entity '{names[k]}' pulls '{trailer}',"
                        f" which does not exist; {suggestion(trailer, names)}"
                    )
                pairs.append((front, names.index(trailer)))
                break
            bodies.append(trailer)
            entities.append(_entity(trailer[0], entities[front].name + "+", trailer[1]))
            pairs.append((front, len(entities) - 1))
            front = len(entities) - 1
    return tuple(entities), front_first([read_tow(front_row, rear_row, entities) for front_row, rear_row in pairs])


def _body(element: etree._Element, name: str, scope: Scope) -> tuple[etree._Element, Scope]:
    outer_scope = scope
    body = next((e for e in element.iterchildren("Vehicle", "Pedestrian", "MiscObject", "CatalogReference")), None)
    if body is not None and body.tag == "CatalogReference":
        body, scope = scope.from_catalog(body)
    elif body is not None:
        scope = scope.within(body)
    if body is None or body.tag not in ("Vehicle", "Pedestrian", "MiscObject"):
        raise InputError(
            f"{place_of(element, outer_scope.source)}: the <{element.tag}> '{name}' is not a vehicle, pedestrian or"
            " misc object, the only ones that the builtin simulator can move."
        )
    return body, scope


def _entity(body: etree._Element, name: str, scope: Scope) -> Entity:
    kind = {"Pedestrian": "pedestrian", "MiscObject": "misc"}.get(body.tag) or scope.text(
        body, "vehicleCategory", "car"
    )
    # A misc object cannot move by itself.
    limits = [0.0 if body.tag == "MiscObject" else np.inf, np.inf, np.inf]
    performance = body.find("Performance")
    if performance is not None:
        limits = [scope.one_number(performance, a, np.inf) for a in _LIMITS]
        for attribute, limit in zip(_LIMITS, limits, strict=True):
            if limit < 0.0:
                location = place_of(performance, scope.source)
                raise InputError(
                    f"{location}: <Performance>: {attribute} of '{name}' is {limit:g}; it must not be below 0."
                )
    length, width, center_x = _box(body, kind, scope)
    if not (length > 0 and width > 0):
        raise InputError(
            f"{place_of(body, scope.source)}: <Dimensions>: the bounding box of '{name}' needs a positive"
            " length and width."
        )
    if max(length, width, abs(center_x)) > _LARGEST:
        raise InputError(
            f"{place_of(body, scope.source)}: <BoundingBox>: the bounding box of '{name}' is larger than"
            f" {_LARGEST:g} m; give it in m."
        )
    # Two properties that esmini defines.
    items = unrecorded(body, "Properties", "Property")
    elements = {key: named(items, key) for key in ("ignoreHeadingForTrajMotion", "plineInterpolation")}
    properties = {key: "" if item is None else scope.text(item, "value") for key, item in elements.items()}
    slides = properties["ignoreHeadingForTrajMotion"] == "true"
    turning = _TURNING.get(properties["plineInterpolation"], "")
    body_and_scope = body, scope
    return Entity(name, kind, length, width, center_x, limits[0], limits[1], limits[2], slides, turning, body_and_scope)


def _box(body: etree._Element, kind: str, scope: Scope) -> tuple[float, float, float]:
    """Length, width and longitudinal centre of the bounding box in m; defaults of the entity's type if missing."""
    dimensions, center = body.find("BoundingBox/Dimensions"), body.find("BoundingBox/Center")
    length, width, default_center_x = _SIZES.get(kind, _SIZES["car"])
    given = {} if dimensions is None else {key: scope.one_number(dimensions, key, 0.0) for key in ("length", "width")}
    center_x = default_center_x if center is None else scope.one_number(center, "x")
    size = given.get("length") or length, given.get("width") or width
    if center is None or not all(given.get(key) for key in ("length", "width")):
        part = "<BoundingBox>" if dimensions is None or center is None else "size of <BoundingBox>"
        reason = f"the {kind} is taken as {size[0]:g} m long and {size[1]:g} m wide, its centre {center_x:g} m ahead"
        rule = "an entity has a <BoundingBox> with <Center> and <Dimensions>, which are above 0 m"
        adapt(body if dimensions is None else dimensions, part, reason, rule)
    return *size, center_x


def _pulled(body: etree._Element, scope: Scope, name: str) -> Iterator[tuple[etree._Element, Scope] | str]:
    """Yield the trailers behind a vehicle, front first: body and scope, or the name of an entity of its own."""
    for _ in range(MOST_TRAILERS):
        holder = body.find("Trailer")
        if holder is None:
            return
        if name_of_entity := _referred(holder, scope):
            yield name_of_entity
            return
        inner = _held(holder, scope)
        if inner is None:
            return
        body, scope = _body(inner, name, scope)
        yield body, scope
    location = place_of(body, scope.source)
    raise InputError(f"{location}: the <Trailer> of the entity '{name}' pulls more than {MOST_TRAILERS} trailers.")


def _referred(holder: etree._Element, scope: Scope) -> str:
    """Name of the entity that is the trailer; empty for none, as an empty reference is no trailer."""
    names = []
    for element in holder.iterchildren("TrailerRef", "EntityRef"):
        names.append(scope.text(element, "entityRef", ""))
        if element.tag == "EntityRef":
            adapt(element, "<EntityRef> in <Trailer>", "is read as <TrailerRef>", _TRAILER_RULE)
    return next(filter(None, names), "")


def _held(holder: etree._Element, scope: Scope) -> etree._Element | None:
    if (inner := holder.find("Trailer")) is not None:
        return inner
    for direct in holder.iterchildren("Vehicle", "CatalogReference"):
        # As in esmini, a reference without an entry name is no trailer.
        if direct.tag == "CatalogReference" and not scope.text(direct, "entryName", ""):
            return None
        adapt(direct, f"<{direct.tag}> in <Trailer>", f"is read as <Trailer><{direct.tag}>", _TRAILER_RULE)
        return holder
    return None
