"""Entities of a scenario file, and what they pull."""

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

# m; no vehicle, nor what stands beside a road, is larger.
_LARGEST: Final = 10_000.0
# Length, width and how far the centre is ahead, in m, where a file gives none: those of the entities that come with
# esmini, and of common vehicles where it has none.
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
    """Read all entities: those of the file, and the trailers that they bring along.

    Parameters
    ----------
    objects : sequence of lxml element
        ``ScenarioObject`` elements.
    scope : Scope
        Values of the file's parameters.

    Returns
    -------
    tuple of Entity
        Those of the file first, in its order. A trailer that has no name of its own is called as its vehicle with a
        ``+`` behind.
    tuple of Tow
        Who pulls whom, those in front first.

    Raises
    ------
    InputError
        An entity is of no kind that can be moved, is malformed, or pulls what is no trailer.
    """
    bodies = [_body(element, element.get("name", ""), scope) for element in objects]
    names = [element.get("name", "") for element in objects]
    found = [_entity(body, name, inner) for name, (body, inner) in zip(names, bodies, strict=True)]
    pairs = []
    for k, (body, inner) in enumerate(bodies[: len(objects)]):
        front = k
        for trailer in _pulled(body, inner, names[k]):
            if isinstance(trailer, str):
                if trailer not in names:
                    raise InputError(
                        f"{place_of(body, inner.source)}: <Trailer>: the entity '{names[k]}' pulls '{trailer}', which"
                        f" does not exist; {suggestion(trailer, names)}"
                    )
                pairs.append((front, names.index(trailer)))
                break
            bodies.append(trailer)
            found.append(_entity(trailer[0], found[front].name + "+", trailer[1]))
            pairs.append((front, len(found) - 1))
            front = len(found) - 1
    return tuple(found), front_first([read_tow(one, two, found) for one, two in pairs])


def _body(element: etree._Element, name: str, scope: Scope) -> tuple[etree._Element, Scope]:
    holder = scope
    body = next((e for e in element.iterchildren("Vehicle", "Pedestrian", "MiscObject", "CatalogReference")), None)
    if body is not None and body.tag == "CatalogReference":
        body, scope = scope.from_catalog(body)
    elif body is not None:
        scope = scope.within(body)
    if body is None or body.tag not in ("Vehicle", "Pedestrian", "MiscObject"):
        raise InputError(
            f"{place_of(element, holder.source)}: the <{element.tag}> '{name}' is not a vehicle, pedestrian or misc"
            " object, the only ones that the builtin simulator can move."
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
                where = place_of(performance, scope.source)
                raise InputError(
                    f"{where}: <Performance>: {attribute} of '{name}' is {limit:g}; it must not be below 0."
                )
    length, width, reach = _box(body, kind, scope)
    if not (length > 0 and width > 0):
        raise InputError(
            f"{place_of(body, scope.source)}: <Dimensions>: the bounding box of '{name}' needs a positive"
            " length and width."
        )
    if max(length, width, abs(reach)) > _LARGEST:
        raise InputError(
            f"{place_of(body, scope.source)}: <BoundingBox>: the bounding box of '{name}' is larger than"
            f" {_LARGEST:g} m; give it in m."
        )
    # Two of esmini's own properties.
    items = unrecorded(body, "Properties", "Property")
    found = {key: named(items, key) for key in ("ignoreHeadingForTrajMotion", "plineInterpolation")}
    own = {key: "" if item is None else scope.text(item, "value") for key, item in found.items()}
    slides, turning = own["ignoreHeadingForTrajMotion"] == "true", _TURNING.get(own["plineInterpolation"], "")
    body_and_scope = body, scope
    return Entity(name, kind, length, width, reach, limits[0], limits[1], limits[2], slides, turning, body_and_scope)


def _box(body: etree._Element, kind: str, scope: Scope) -> tuple[float, float, float]:
    """Length and width of an entity's box, and how far its centre is ahead, in m: those of its kind for none."""
    dimensions, center = body.find("BoundingBox/Dimensions"), body.find("BoundingBox/Center")
    length, width, ahead = _SIZES.get(kind, _SIZES["car"])
    known = {} if dimensions is None else {key: scope.one_number(dimensions, key, 0.0) for key in ("length", "width")}
    reach = ahead if center is None else scope.one_number(center, "x")
    found = known.get("length") or length, known.get("width") or width
    if center is None or not all(known.get(key) for key in ("length", "width")):
        part = "<BoundingBox>" if dimensions is None or center is None else "size of <BoundingBox>"
        why = f"the {kind} is taken as {found[0]:g} m long and {found[1]:g} m wide, its centre {reach:g} m ahead"
        rule = "an entity has a <BoundingBox> with <Center> and <Dimensions>, which are above 0 m"
        adapt(body if dimensions is None else dimensions, part, why, rule)
    return *found, reach


def _pulled(body: etree._Element, scope: Scope, name: str) -> Iterator[tuple[etree._Element, Scope] | str]:
    """Bodies of the trailers behind a vehicle, from the front; of one that is an entity of its own, the name."""
    for _ in range(MOST_TRAILERS):
        holder = body.find("Trailer")
        if holder is None:
            return
        if other := _referred(holder, scope):
            yield other
            return
        inner = _held(holder, scope)
        if inner is None:
            return
        body, scope = _body(inner, name, scope)
        yield body, scope
    where = place_of(body, scope.source)
    raise InputError(f"{where}: the <Trailer> of the entity '{name}' pulls more than {MOST_TRAILERS} trailers.")


def _referred(holder: etree._Element, scope: Scope) -> str:
    """Name of the entity that is to be the trailer; empty where none is, as a reference to no entity is no trailer."""
    names = []
    for element in holder.iterchildren("TrailerRef", "EntityRef"):
        names.append(scope.text(element, "entityRef", ""))
        if element.tag == "EntityRef":
            adapt(element, "<EntityRef> in <Trailer>", "is read as <TrailerRef>", _TRAILER_RULE)
    return next(filter(None, names), "")


def _held(holder: etree._Element, scope: Scope) -> etree._Element | None:
    """What holds the body of a trailer; None where there is none."""
    if (inner := holder.find("Trailer")) is not None:
        return inner
    for direct in holder.iterchildren("Vehicle", "CatalogReference"):
        # As in esmini, a reference to no entry is no trailer.
        if direct.tag == "CatalogReference" and not scope.text(direct, "entryName", ""):
            return None
        adapt(direct, f"<{direct.tag}> in <Trailer>", f"is read as <Trailer><{direct.tag}>", _TRAILER_RULE)
        return holder
    return None
