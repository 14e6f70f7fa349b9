"""Entities of a scenario file, and what they pull."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.recorded_xml import named, unrecorded
from cornercase.scenario import Scope
from cornercase.simulators.builtin.tracks.track import ALONG_LEGS, AT_CORNERS, AT_VERTICES
from cornercase.simulators.builtin.world.state import Entity, Tow

_TURNING: Final = {"segment": ALONG_LEGS, "corner": AT_CORNERS, "off": AT_VERTICES, "none": AT_VERTICES}

# More trailers than that behind one vehicle are a catalog entry that pulls itself.
_MOST_TRAILERS: Final = 20
# m; no vehicle, nor what stands beside a road, is larger.
_LARGEST: Final = 10_000.0
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
                        f"{scope.source}: the entity '{names[k]}' pulls '{trailer}', which does not exist;"
                        f" {suggestion(trailer, names)}"
                    )
                pairs.append((front, names.index(trailer)))
                break
            bodies.append(trailer)
            found.append(_entity(trailer[0], found[front].name + "+", trailer[1]))
            pairs.append((front, len(found) - 1))
            front = len(found) - 1
    tows = [_tow(one, two, bodies, found) for one, two in pairs]
    behind = {tow.trailer: tow.vehicle for tow in tows}

    def depth(one: int) -> int:
        count = 0
        while one in behind and count < _MOST_TRAILERS:
            one, count = behind[one], count + 1
        return count

    return tuple(found), tuple(sorted(tows, key=lambda tow: depth(tow.vehicle)))


def _body(element: etree._Element, name: str, scope: Scope) -> tuple[etree._Element, Scope]:
    body = next((e for e in element.iterchildren("Vehicle", "Pedestrian", "MiscObject", "CatalogReference")), None)
    if body is not None and body.tag == "CatalogReference":
        body, scope = scope.from_catalog(body)
    elif body is not None:
        scope = scope.within(body)
    if body is None or body.tag not in ("Vehicle", "Pedestrian", "MiscObject"):
        raise InputError(
            f"{scope.source}: the entity '{name}' is not a vehicle, pedestrian or misc object, the only ones that"
            " the builtin simulator can move."
        )
    return body, scope


def _entity(body: etree._Element, name: str, scope: Scope) -> Entity:
    dimensions, center = body.find("BoundingBox/Dimensions"), body.find("BoundingBox/Center")
    if dimensions is None or center is None:
        raise InputError(f"{scope.source}: the entity '{name}' has no <BoundingBox> with <Center> and <Dimensions>.")
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
                raise InputError(f"{scope.source}: {attribute} of '{name}' is {limit:g}; it must not be below 0.")
    length, width = scope.one_number(dimensions, "length"), scope.one_number(dimensions, "width")
    reach = scope.one_number(center, "x")
    if not (length > 0 and width > 0):
        raise InputError(f"{scope.source}: the bounding box of '{name}' needs a positive length and width.")
    if max(length, width, abs(reach)) > _LARGEST:
        raise InputError(f"{scope.source}: the bounding box of '{name}' is larger than {_LARGEST:g} m; give it in m.")
    # Two of esmini's own properties.
    items = unrecorded(body, "Properties", "Property")
    found = {key: named(items, key) for key in ("ignoreHeadingForTrajMotion", "plineInterpolation")}
    own = {key: "" if item is None else scope.text(item, "value") for key, item in found.items()}
    slides, turning = own["ignoreHeadingForTrajMotion"] == "true", _TURNING.get(own["plineInterpolation"], "")
    return Entity(name, kind, length, width, reach, limits[0], limits[1], limits[2], slides, turning)


def _pulled(body: etree._Element, scope: Scope, name: str) -> Iterator[tuple[etree._Element, Scope] | str]:
    """Bodies of the trailers behind a vehicle, from the front; of one that is an entity of its own, the name."""
    for _ in range(_MOST_TRAILERS):
        holder = body.find("Trailer")
        inner = None if holder is None else holder.find("Trailer")
        reference = None if holder is None else holder.find("TrailerRef")
        if inner is not None:
            body, scope = _body(inner, name, scope)
            yield body, scope
        else:
            # A reference to no entity is no trailer.
            if reference is not None and (other := scope.text(reference, "entityRef", "")):
                yield other
            return
    raise InputError(f"{scope.source}: the entity '{name}' pulls more than {_MOST_TRAILERS} trailers.")


def _tow(vehicle: int, trailer: int, bodies: list[tuple[etree._Element, Scope]], entities: list[Entity]) -> Tow:
    (front, front_scope), (back, back_scope) = bodies[vehicle], bodies[trailer]
    hitch, coupler = front.find("TrailerHitch"), back.find("TrailerCoupler")
    if hitch is None or coupler is None:
        raise InputError(
            f"{front_scope.source}: '{entities[vehicle].name}' cannot pull '{entities[trailer].name}', as it has no"
            f" {'<TrailerHitch>' if hitch is None else '<TrailerCoupler>'}."
        )
    return Tow(vehicle, trailer, front_scope.one_number(hitch, "dx"), back_scope.one_number(coupler, "dx"))
