"""Digests of recordings: values that analysis, report and live page need, stored so that no recording is unpacked.

Series and courses are downsampled to every k-th instant; the lengths of the first recordings of a study decide this
stride k. The values at these instants are exact. Only `lines` (curves of courses) and `rounded` (for the replay in the
report) are approximations.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar, cast, get_args
from zlib import crc32

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import parse_json
from cornercase._common.typing import Float32Array, FloatArray, IntArray
from cornercase.metrics import Metric, compute_features, registered_features
from cornercase.metrics._outcome import Conflict, Culprit, Fault, Impact, Outcome, PathRelation
from cornercase.recordings import Collision, Recording
from cornercase.recordings._compact_encoding import encode_rounded
from cornercase.recordings._entity_series import bearing_series, position_series
from cornercase.study._codec import pack_arrays, unpack_arrays
from cornercase.study._damage import require_condition
from cornercase.study._meta import StudyMeta

if TYPE_CHECKING:
    from cornercase.metrics._ending import Poses

COURSE_POINTS: Final = 48
"""Number of points of the line that the page draws of a course; the replay has all points."""
MAX_INSTANTS: Final = 100
"""Largest number of instants, besides the last one, to which a series of median length is downsampled."""
N_STRIDE_RECORDINGS: Final = 32
"""Number of recordings, the first of a study, that decide the stride of the stored series."""

Bounds = tuple[float, float, float, float]
_Array = TypeVar("_Array", FloatArray, IntArray)

# Columns of the stored series: time and position of the ego; then position and bearing of each other entity.
_EGO_COLUMNS: Final = slice(1, 3)
_N_OTHER_COLUMNS: Final = 4
_FIRST_OTHER_COLUMN: Final = 3
DigestPart = Literal["series", "courses", "lines", "rounded"]
DIGEST_PARTS: Final[frozenset[DigestPart]] = frozenset(get_args(DigestPart))


@dataclass(frozen=True, eq=False)
class ScenarioDigest:
    """Digest of one scenario: the values that analysis and report need of its recording and metric courses.

    `begin` and `end` are the first and the last instant in s. `bounds` are x_min, y_min, x_max, y_max of the reference
    points of all entities in m; None if no entity exists. `outcomes` and `features` have one item for each of the
    others (the entities of the study except the ego). `series` and `courses` are downsampled to M instants: every
    `stride`-th, and the last. `series` has the columns time, x and y of the ego, and for each of the others x, y and
    the two components of its bearing (unit vector from the ego): shape (M, 3 + 4 others). `courses` has the shape (M,
    metrics). `lines` are courses at 48 evenly spaced times, with values capped as for display, shape (metrics, 48).
    `rounded` is the recording with its capped courses in the format of `encode_rounded`; empty if the package of a
    metric is missing.
    """

    n_instants: int
    begin: float
    end: float
    bounds: Bounds | None
    collisions: tuple[Collision, ...]
    stride: int
    outcomes: tuple[Outcome, ...]
    features: tuple[Mapping[str, float], ...]
    series: FloatArray
    courses: FloatArray
    lines: FloatArray
    rounded: bytes

    @property
    def time(self) -> FloatArray:
        """Times of the M downsampled instants in s, shape (M,)."""
        return self.series[:, 0]

    @property
    def ego_position(self) -> FloatArray:
        """Centre of the ego's bounding box in m at the M downsampled instants, shape (M, 2)."""
        return self.series[:, _EGO_COLUMNS]

    def position_and_bearing(self, other_index: int) -> tuple[FloatArray, FloatArray]:
        """Return position and bearing of another entity at the M downsampled instants, each with shape (M, 2).

        The position is the centre of the entity's bounding box in m. The bearing is the unit vector from the ego to the
        entity, with components ahead and to the left as seen from the ego.
        """
        first = _FIRST_OTHER_COLUMN + _N_OTHER_COLUMNS * other_index
        return self.series[:, first : first + 2], self.series[:, first + 2 : first + 4]

    def can_downsample_to(self, stride: int) -> bool:
        """Return whether the stored series contain every `stride`-th instant of the recording."""
        return stride % self.stride == 0

    def downsample(self, series: FloatArray, stride: int) -> FloatArray:
        """Downsample stored series further, to every `stride`-th instant of the recording."""
        return downsample(series, stride // self.stride)


def make_digest(
    recording: Recording,
    courses: Mapping[str, FloatArray],
    meta: StudyMeta,
    stride: int,
    metrics: Sequence[Metric] | None = None,
) -> ScenarioDigest:
    """Make the digest of a recording and its metric courses.

    If `courses` lacks a metric of the study, the digest gets a course of NaN for the metric. `metrics` are the metrics
    of the study, by default created from `meta`.
    """
    # Kernels take long to import, and readers of digests do not need them.
    from cornercase.metrics._ending import Poses, find_outcomes, measure_features_per_outcome

    entities = recording.with_absent_entities((meta.ego, *meta.others))
    poses = Poses.from_recording(entities)
    outcomes = find_outcomes(entities, meta.ego, meta.others, poses=poses)
    n_instants = len(recording.time)
    whole = {name: course for name, course in courses.items() if len(course) == n_instants}
    missing = np.full(n_instants, math.nan)
    lines = np.full((len(meta.metrics), COURSE_POINTS), math.nan)
    metrics = create_metrics_if_known(meta) if metrics is None else metrics
    clipped = {metric.name: metric.clip_course(whole.get(metric.name, missing)) for metric in metrics}
    for line, metric in zip(lines, metrics, strict=False):
        if metric.name in whole:
            course = clipped[metric.name].astype(np.float32)
            line[:] = resample_course(recording.time, course, metric.lower_is_critical)
    return ScenarioDigest(
        n_instants=n_instants,
        begin=float(recording.time[0]),
        end=float(recording.time[-1]),
        bounds=find_bounds(recording),
        collisions=recording.collisions,
        stride=stride,
        outcomes=outcomes,
        features=measure_features_per_outcome(entities, outcomes, poses),
        series=_compute_series(entities, meta, downsample(np.arange(n_instants), stride), poses),
        courses=downsample(
            np.array([whole.get(name, missing) for name in meta.metrics]).reshape(-1, n_instants).T, stride
        ),
        lines=lines,
        rounded=encode_rounded(recording, clipped) if metrics else b"",
    )


def _compute_series(recording: Recording, meta: StudyMeta, instants: IntArray, poses: Poses) -> FloatArray:
    """Return the series of a digest at M instants, given as indices, shape (M, 3 + 4 others).

    The columns are time, position of the ego, and position and bearing of each entity except the ego.
    """
    centers = np.array([poses.x, poses.y])
    if np.isfinite(centers).all() and np.isfinite(recording.heading).all():
        i = recording.entity_index(meta.ego)
        j = [recording.entity_index(other) for other in meta.others]
        x, y = centers[:, :, instants]
        x_offset, y_offset, cos, sin = x[j] - x[i], y[j] - y[i], poses.cos[i, instants], poses.sin[i, instants]
        relative = np.array([cos * x_offset + sin * y_offset, cos * y_offset - sin * x_offset])
        distance = np.hypot(*relative)
        bearing = np.divide(relative, distance, out=np.zeros_like(relative), where=distance > 0.0)
        others = np.concatenate(([x[j], y[j]], bearing)).transpose(1, 0, 2).reshape(-1, len(instants))
        series: FloatArray = np.array([recording.time[instants], x[i], y[i], *others])
        return series.T.copy()
    columns = [recording.time[:, None], position_series(recording, meta.ego)]
    for other in meta.others:
        columns += [position_series(recording, other, meta.ego), bearing_series(recording, meta.ego, other)]
    return np.hstack(columns)[instants]


def create_metrics_if_known(meta: StudyMeta) -> tuple[Metric, ...]:
    """Create the metrics of a study; return an empty tuple if any metric is unknown."""
    try:
        return meta.create_metrics()
    except InputError:
        return ()


def downsampling_stride(lengths: Sequence[int]) -> int:
    """Return the stride that downsamples a series of the median of these lengths to at most about 100 instants."""
    return max(1, math.ceil(float(np.median(lengths)) / MAX_INSTANTS))


def downsample(series: _Array, stride: int) -> _Array:
    """Take every `stride`-th instant of a series, shape (T,) or (T, k), and the last one."""
    if stride == 1:
        return series
    return np.concatenate((series[:-1:stride], series[-1:]))


def resample_course(time: FloatArray, course: Float32Array, lower_is_critical: bool) -> FloatArray:
    """Resample a capped course at `COURSE_POINTS` evenly spaced times; return shape (COURSE_POINTS,).

    The nearest of these times gets the most critical value of the course, so that a short critical peak stays visible.
    """
    begin, end = float(time[0]), float(time[-1])
    line = np.interp(np.linspace(begin, end, COURSE_POINTS), time, course)
    worst = int(course.argmin() if lower_is_critical else course.argmax())
    nearest = round((float(time[worst]) - begin) / (end - begin) * (COURSE_POINTS - 1)) if end > begin else 0
    line[nearest] = course[worst]
    return line


def find_bounds(recording: Recording) -> Bounds | None:
    """Return x_min, y_min, x_max, y_max of all reference points in m; None if no entity exists."""
    bounds = []
    for values in (recording.x, recording.y):
        # These ignore NaN as long as there is any number.
        low, high = float(np.fmin.reduce(values, axis=None)), float(np.fmax.reduce(values, axis=None))
        if not (math.isfinite(low) and math.isfinite(high)):
            finite = values[np.isfinite(values)]
            if not finite.size:
                return None
            low, high = float(finite.min()), float(finite.max())
        bounds.append((low, high))
    (x_min, x_max), (y_min, y_max) = bounds
    return x_min, y_min, x_max, y_max


def measure_registered_features(recording: Recording, meta: StudyMeta) -> FloatArray:
    """Compute the f features of a recording that cornercase and other packages have registered, shape (f,)."""
    entities = recording.with_absent_entities((meta.ego, *meta.others))
    features: FloatArray = compute_features([entities], meta.ego, meta.others)[0]
    return features


def encode_digest(digest: ScenarioDigest, features: FloatArray) -> tuple[str, bytes]:
    """Encode a digest as a JSON text, called the facts of the digest, and an archive of arrays.

    `features` are the f registered features of the recording, shape (f,).
    """
    facts = {
        "instants": digest.n_instants,
        "time": [digest.begin, digest.end],
        "bounds": digest.bounds,
        "collisions": [[hit.time, *hit.entities] for hit in digest.collisions],
        "stride": digest.stride,
        "endings": [
            _encode_outcome(outcome) | {"features": {name: _encode_float(value) for name, value in features.items()}}
            for outcome, features in zip(digest.outcomes, digest.features, strict=True)
        ],
    }
    # Compression would save a third of these bytes, but take four times as long.
    arrays: dict[str, npt.ArrayLike] = {
        "series": digest.series,
        "courses": digest.courses,
        "lines": digest.lines,
        "rounded": np.frombuffer(digest.rounded, np.uint8),
        "features": features,
        "features_checksum": registered_features_checksum(),
    }
    packed = pack_arrays(arrays, compress=False)
    return json.dumps(facts, separators=(",", ":")), packed


def _encode_outcome(outcome: Outcome) -> dict[str, Any]:
    return {
        "encounter": _encode_encounter(outcome.encounter),
        "others": [_encode_encounter(encounter) for encounter in outcome.others],
        "impacts": [
            [hit.entity, hit.time, _encode_float(hit.speed), hit.manner, _encode_fault(hit.fault)]
            for hit in outcome.impacts
        ],
        "flags": [int(getattr(outcome, name)) for name in _FLAGS],
    }


def _encode_fault(fault: Fault | None) -> list[Any] | None:
    return None if fault is None else [fault.who, fault.conflict, fault.sides, fault.point, fault.reasons]


_ENCOUNTER_FIELDS: Final = tuple(field.name for field in fields(PathRelation))
_FLAGS: Final = ("exists", "moves", "stops", "waits", "yields")


def _encode_encounter(encounter: PathRelation) -> list[Any]:
    values = [getattr(encounter, name) for name in _ENCOUNTER_FIELDS]
    return [_encode_float(value) if isinstance(value, float) else value for value in values]


def _encode_float(value: float) -> float | None:
    """Return the number, or None for NaN, which JSON lacks."""
    return None if math.isnan(value) else value


def decode_digest_facts(facts: str) -> dict[str, Any]:
    """Parse the facts (the JSON text) of a digest; call it within `reraise_read_errors`."""
    return dict(parse_json(facts))


def decode_collisions(facts: Mapping[str, Any]) -> tuple[Collision, ...]:
    """Return the collisions of a recording from the facts of its digest."""
    return tuple(Collision(float(time), (str(first), str(second))) for time, first, second in facts["collisions"])


def decode_impacts(facts: Mapping[str, Any]) -> tuple[Impact, ...]:
    """Return the collisions of the ego, in the order of time, from the facts of a digest."""
    # The collisions are the same for each other entity of the study.
    return _decode_impacts(facts["endings"][0])


def _decode_impacts(ending: Mapping[str, Any]) -> tuple[Impact, ...]:
    return tuple(
        Impact(str(entity), float(time), _decode_float(speed), manner, _decode_fault(*fault))
        for entity, time, speed, manner, *fault in ending["impacts"]
    )


def _decode_fault(fault: Sequence[Any] | None = None) -> Fault | None:
    """Decode a fault; None if an early version did not store it."""
    if fault is None:
        return None
    who, conflict, (side, other_side), point, reasons = fault
    require_condition(who in get_args(Culprit), "it is unclear whose fault a collision is")
    contact_point = None if point is None else (float(point[0]), float(point[1]))
    return Fault(who, cast(Conflict, str(conflict)), (side, other_side), contact_point, tuple(map(str, reasons)))


def decode_digest(
    facts: Mapping[str, Any],
    packed: bytes,
    meta: StudyMeta,
    parts: Collection[DigestPart] = DIGEST_PARTS,
) -> ScenarioDigest:
    """Decode a digest without the registered features; raise `ValueError` if the digest does not fit the study.

    Only the arrays in `parts` are decoded; other arrays are empty.
    """
    arrays = unpack_arrays(packed, names=parts)
    n_instants, stride, collisions = facts["instants"], facts["stride"], decode_collisions(facts)
    require_condition(
        isinstance(n_instants, int) and isinstance(stride, int) and n_instants > 0 and stride > 0,
        "the length of a digest is not valid",
    )
    count = len(range(0, n_instants - 1, stride)) + 1
    n_metrics = len(meta.metrics)
    shapes: dict[DigestPart, tuple[int, int]] = {
        "series": (count, _FIRST_OTHER_COLUMN + _N_OTHER_COLUMNS * len(meta.others)),
        "courses": (count, n_metrics),
        "lines": (n_metrics, COURSE_POINTS),
    }
    for name, shape in shapes.items():
        if name not in parts:
            arrays[name] = np.empty((0, shape[1]))
        else:
            require_condition(
                arrays[name].shape == shape and arrays[name].dtype == np.float64,
                f"the {name} of a digest have a wrong shape or type",
            )
    endings = facts["endings"]
    require_condition(len(endings) == len(meta.others), "a digest has endings for other entities")
    begin, end = map(float, facts["time"])
    return ScenarioDigest(
        n_instants=n_instants,
        begin=begin,
        end=end,
        bounds=decode_bounds(facts),
        collisions=collisions,
        stride=stride,
        outcomes=tuple(_decode_outcome(ending, meta.ego, collisions) for ending in endings),
        features=tuple(
            {str(name): _decode_float(value) for name, value in ending["features"].items()} for ending in endings
        ),
        series=arrays["series"],
        courses=arrays["courses"],
        lines=arrays["lines"],
        rounded=decode_rounded_recording(arrays),
    )


def decode_rounded_recording(arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Return the rounded recording among the arrays of a digest; empty if an earlier version did not store it."""
    return arrays["rounded"].tobytes() if "rounded" in arrays else b""


def decode_features(packed: bytes, checksum: int) -> FloatArray | None:
    """Return the f registered features in the archive of a digest, shape (f,).

    None if the archive has no features, or if the stored checksum differs from `checksum`: other features were
    registered when the digest was made. Raises `ValueError` unless each feature is one finite number.
    """
    arrays = unpack_arrays(packed, names=("features", "features_checksum"))
    if not arrays or int(arrays["features_checksum"]) != checksum:
        return None
    features: FloatArray = arrays["features"]
    require_condition(
        features.shape == (len(registered_features()),) and features.dtype == np.float64,
        "the features of a digest have a wrong shape or type",
    )
    require_condition(bool(np.isfinite(features).all()), "the features of a digest are not finite")
    return features


def registered_features_checksum() -> int:
    """Return the CRC-32 of the names of all registered features."""
    return crc32("\n".join(feature.name for feature in registered_features()).encode())


def decode_bounds(facts: Mapping[str, Any]) -> Bounds | None:
    """Return the bounds of a recording, as computed by `find_bounds`, from the facts of its digest."""
    if facts["bounds"] is None:
        return None
    x_min, y_min, x_max, y_max = map(float, facts["bounds"])
    return x_min, y_min, x_max, y_max


def _decode_outcome(ending: Mapping[str, Any], ego: str, collisions: Sequence[Collision]) -> Outcome:
    return Outcome(
        ego=ego,
        encounter=_decode_encounter(ending["encounter"]),
        others=tuple(map(_decode_encounter, ending["others"])),
        impacts=_decode_impacts(ending),
        other_collisions=tuple(collision for collision in collisions if ego not in collision.entities),
        **{name: bool(flag) for name, flag in zip(_FLAGS, ending["flags"], strict=True)},
    )


def _decode_encounter(values: Sequence[Any]) -> PathRelation:
    entity, relation, first, ahead, *times = values
    return PathRelation(str(entity), relation, first, ahead, *map(_decode_float, times))


def _decode_float(value: float | None) -> float:
    return math.nan if value is None else float(value)
