"""ASAM OSI traces."""

from __future__ import annotations

import lzma
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase._common.text.sanitize import format_exception
from cornercase.recordings._from_samples import EntitySamples, recording_from_samples
from cornercase.recordings._osi_messages import NAME_PREFIX, REFERENCE_TYPE
from cornercase.recordings._recording import Recording

# Largest unpacked message and file in bytes, against decompression bombs.
_MAX_MESSAGE_SIZE: Final = 64_000_000
_MAX_FILE_SIZE: Final = 2_000_000_000
# Largest unpacked chunk of an MCAP file; usual are some megabytes.
_MAX_CHUNK_SIZE: Final = 256_000_000
# MCAP: length of the magic at both ends, length of a record header, opcode of a chunk.
_MAGIC_SIZE, _RECORD_HEADER_SIZE, _CHUNK_OPCODE = 8, 9, 6


def read_osi(path: Path | str) -> Recording:
    """Read the moving objects of an ASAM OSI trace; requires the extra ``osi``.

    An object is named like its entity in the scenario if the trace contains this name, or else by its id.

    The trace has one channel (``.osi``, ``.xz``, ``.lzma``) or several (``.mcap``). Its messages are GroundTruth or
    SensorView.
    """
    path = Path(path)
    try:
        from osi3 import osi_object_pb2
    except ImportError as error:
        raise InputError(f"{path}: reading OSI traces needs the extra 'osi'; {describe_install('osi')}.") from error

    moving = osi_object_pb2.MovingObject
    kinds = {moving.TYPE_PEDESTRIAN: "pedestrian", moving.TYPE_ANIMAL: "animal"}
    vehicle = moving.VehicleClassification
    vehicles = {
        vehicle.TYPE_DELIVERY_VAN: "van",
        vehicle.TYPE_HEAVY_TRUCK: "truck",
        vehicle.TYPE_SEMITRAILER: "semitrailer",
        vehicle.TYPE_TRAILER: "trailer",
        vehicle.TYPE_MOTORBIKE: "motorbike",
        vehicle.TYPE_BICYCLE: "bicycle",
        vehicle.TYPE_BUS: "bus",
        vehicle.TYPE_TRAM: "tram",
        vehicle.TYPE_TRAIN: "train",
        vehicle.TYPE_WHEELCHAIR: "wheelchair",
    }

    tracks: dict[str, EntitySamples] = {}
    names: dict[int, str] = {}
    for truth in _iter_ground_truths(path):
        time = truth.timestamp.seconds + truth.timestamp.nanos * 1e-9
        for moving_object in truth.moving_object:
            number, base = moving_object.id.value, moving_object.base
            if number not in names:
                entity = _find_entity_name(moving_object)
                names[number] = entity if entity and entity not in names.values() else str(number)
            name = names[number]
            kind = kinds.get(moving_object.type) or vehicles.get(moving_object.vehicle_classification.type, "car")
            if moving_object.type == moving.TYPE_OTHER:
                kind = "misc"
            track = tracks.setdefault(name, EntitySamples(kind, base.dimension.length, base.dimension.width))
            if time in track.samples:
                raise InputError(f"{path}: object {name} occurs twice at {time} s.")
            heading = base.orientation.yaw
            # Invalid headings are refused when the recording is created.
            cos, sin = (math.cos(heading), math.sin(heading)) if math.isfinite(heading) else (math.nan, math.nan)
            track.samples[time] = (
                base.position.x,
                base.position.y,
                heading,
                cos * base.velocity.x + sin * base.velocity.y if base.HasField("velocity") else math.nan,
                cos * base.acceleration.x + sin * base.acceleration.y if base.HasField("acceleration") else math.nan,
            )
    return recording_from_samples(path, tracks)


def _find_entity_name(moving_object: Any) -> str:
    """Return the name of an object in its OpenSCENARIO file; empty if unknown."""
    for reference in moving_object.source_reference:
        for identifier in reference.identifier if reference.type == REFERENCE_TYPE else ():
            if identifier.startswith(NAME_PREFIX):
                return str(identifier.removeprefix(NAME_PREFIX))
    return ""


def _iter_ground_truths(path: Path) -> Iterator[Any]:
    """Yield the GroundTruth of each message.

    The type of the messages, SensorView or GroundTruth, is the one as which moving objects are found first. Raises
    InputError if no message contains moving objects.
    """
    streams: list[Iterator[Any]] = [
        (view.global_ground_truth for view in _iter_messages(path, "SensorView")),
        _iter_messages(path, "GroundTruth"),
    ]
    while streams:
        for stream in tuple(streams):
            truth = next(stream, None)
            if truth is None:
                streams.remove(stream)
            elif truth.moving_object:
                yield truth
                yield from stream
                return
    raise InputError(f"{path}: holds no GroundTruth or SensorView messages with moving objects.")


def _iter_messages(path: Path, message_type: str) -> Iterator[Any]:
    return (
        _iter_mcap(path, message_type) if path.suffix.lower() == ".mcap" else _iter_single_channel(path, message_type)
    )


def _iter_single_channel(path: Path, message_type: str) -> Iterator[Any]:
    """Yield the messages of a single-channel file one by one, with limited memory."""
    from google.protobuf.message import DecodeError
    from osi3trace.osi_trace import OSITrace

    count = total = 0
    try:
        with (lzma.open if path.suffix.lower() in (".xz", ".lzma") else open)(path, "rb") as file:
            while size := file.read(4):
                length = int.from_bytes(size, "little")
                if length > _MAX_MESSAGE_SIZE:
                    raise InputError(f"{path}: has a message of {length} bytes; at most {_MAX_MESSAGE_SIZE} are read.")
                body = file.read(length)
                if len(size) < 4 or len(body) < length:
                    raise EOFError("the last message is incomplete")
                total += length + 4
                if total > _MAX_FILE_SIZE:
                    raise InputError(f"{path}: has more than {_MAX_FILE_SIZE} bytes when it is unpacked.")
                message = OSITrace.map_message_type(message_type)()
                message.ParseFromString(body)
                count += 1
                yield message
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except (DecodeError, EOFError, lzma.LZMAError) as error:
        raise InputError(f"{path}: is broken or cut off after {count} messages ({error}).") from error


def _iter_mcap(path: Path, message_type: str) -> Iterator[Any]:
    from mcap.exceptions import McapError
    from osi3trace.osi_trace import OSITrace

    try:
        _refuse_bad_mcap_sizes(path)
        trace = OSITrace(str(path), message_type)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except (McapError, EOFError) as error:
        raise InputError(f"{path}: is not an MCAP file, or is cut off ({error}).") from error
    except ValueError:
        # There is no channel of this message type.
        return
    except Exception as error:
        raise InputError(f"{path}: is not an MCAP file, or is damaged ({format_exception(error)}).") from error
    count = 0
    try:
        for message in trace:
            count += 1
            yield message
    except Exception as error:
        # Decompression libraries have their own errors.
        raise InputError(f"{path}: is broken or cut off after {count} messages ({format_exception(error)}).") from error
    finally:
        trace.close()


def _refuse_bad_mcap_sizes(path: Path) -> None:
    """Refuse records that are longer than the file, and chunks that become too large when they are unpacked.

    The mcap package does not check these sizes.
    """
    size = path.stat().st_size
    if size > _MAX_FILE_SIZE:
        raise InputError(
            f"{path}: has more than {_MAX_FILE_SIZE} bytes, the largest size that is read; split the trace."
        )
    with open(path, "rb") as file:
        at = _MAGIC_SIZE
        while at + _RECORD_HEADER_SIZE <= size - _MAGIC_SIZE:
            file.seek(at)
            # A chunk starts with its first and last time and its unpacked size.
            head = file.read(_RECORD_HEADER_SIZE + 24)
            length, unpacked = (
                int.from_bytes(head[start : start + 8], "little") for start in (1, _RECORD_HEADER_SIZE + 16)
            )
            if length > size - at - _RECORD_HEADER_SIZE:
                raise InputError(f"{path}: is not an MCAP file, or is cut off (a record of {length} bytes).")
            if head[0] == _CHUNK_OPCODE and unpacked > _MAX_CHUNK_SIZE:
                raise InputError(f"{path}: has a chunk of {unpacked} bytes; at most {_MAX_CHUNK_SIZE} are read.")
            at += _RECORD_HEADER_SIZE + length
