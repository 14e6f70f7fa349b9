"""Actions that connect and disconnect trailers."""

from __future__ import annotations

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.typing import BoolArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.paths._positions import read_entity_index
from cornercase.simulators.builtin.tracks._track import NO_TRACK
from cornercase.simulators.builtin.world._lane_following import attach_to_lane
from cornercase.simulators.builtin.world._trailers import read_tow, sort_front_to_back
from cornercase.simulators.builtin.world._world import World


class ConnectTrailerAction(Action):
    """Action that connects a trailer to a vehicle, and first disconnects the trailer that the vehicle pulls."""

    def __init__(self, vehicle: int, trailer: int) -> None:
        self._vehicle, self._trailer = vehicle, trailer

    def start(self, world: World, where: BoolArray) -> None:
        new = where & (world.pulled_by[self._trailer] != self._vehicle)
        _disconnect_trailer(world, self._vehicle, new)
        world.pulled_by[self._trailer][new] = self._vehicle


class DisconnectTrailerAction(Action):
    """Action that disconnects the trailer of a vehicle; the trailer then rolls on along its lane."""

    def __init__(self, vehicle: int) -> None:
        self._vehicle = vehicle

    def start(self, world: World, where: BoolArray) -> None:
        _disconnect_trailer(world, self._vehicle, where)


def read_trailer_action(element: etree._Element, scope: Scope, world: World, entity: int) -> Action | None:
    """Read a ``TrailerAction`` of a vehicle, given by index; None if the action, a hitch or a coupler is missing."""
    connects, leaves = element.find("ConnectTrailerAction"), element.find("DisconnectTrailerAction")
    if leaves is not None:
        return DisconnectTrailerAction(entity)
    if connects is None:
        note_adaptation(
            element, "<TrailerAction> without an action", "is skipped", "it connects or disconnects a trailer"
        )
        return None
    trailer = read_entity_index(connects, scope, world, "trailerRef")
    if trailer == entity:
        raise scope.error_at(connects, f"'{world.names[entity]}' cannot pull itself.")
    if not any((tow.vehicle, tow.trailer) == (entity, trailer) for tow in world.tows):
        try:
            world.tows = sort_front_to_back([*world.tows, read_tow(entity, trailer, world.entities)])
        except InputError as error:
            why = f"is skipped, as in esmini: {str(error).removeprefix(f'{scope.file_name}: ').removesuffix('.')}"
            note_adaptation(
                connects, "<ConnectTrailerAction>", why, "the vehicle has a <TrailerHitch>, the trailer a coupler"
            )
            return None
    return ConnectTrailerAction(entity, trailer)


def _disconnect_trailer(world: World, vehicle: int, where: BoolArray) -> None:
    for tow in world.tows:
        released = where & (world.pulled_by[tow.trailer] == vehicle)
        if tow.vehicle == vehicle and released.any():
            world.pulled_by[tow.trailer][released] = -1
            attach_to_lane(world, tow.trailer, released)
            # As in esmini, a trailer off the road stops.
            world.speed[tow.trailer][released & (world.track[tow.trailer] == NO_TRACK)] = 0.0
