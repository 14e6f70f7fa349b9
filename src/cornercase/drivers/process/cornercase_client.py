"""Client for cornercase's protocol, for a driving function that runs in its own Python process.

Copy this file next to your function. The file needs Python 3.7 or later and msgpack, but neither cornercase nor NumPy::

    from cornercase_client import Control, Function, serve

    class MyFunction(Function):
        def __init__(self, reaction=0.3):
            self.reaction = reaction

        def step(self, view, dt):
            leader = view.leader
            if leader is not None and leader.gap < 1.5 * leader.closing:
                return Control(acceleration=-8.0)
            return 0.0

    serve(MyFunction)

An object of the class is made for each concrete scenario, with the options of the driver that cornercase is given, such
as ``exec:python my_function.py:reaction=0.2``.
"""

from __future__ import annotations

import array
import bisect
import inspect
import math
import os
import random
import socket
import struct
import sys
import traceback
from collections import namedtuple
from contextlib import suppress
from typing import Any, BinaryIO, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import msgpack

PROTOCOL_VERSION = 1
LANE_CHANGES = {None: 0.0, "left": 1.0, "right": -1.0}

Ego = namedtuple(
    "Ego",
    "name object_type length width center_x wheelbase max_steering max_speed max_acceleration max_deceleration values",
)
EgoState = namedtuple("EgoState", "x y heading speed acceleration distance offset turn")
ObjectView = namedtuple("ObjectView", "name object_type x y heading speed length width gap closing lateral in_path")
PathPoint = namedtuple("PathPoint", "x y heading curvature")
Trajectory = namedtuple("Trajectory", "time x y")
_Control = namedtuple("_Control", "acceleration steering throttle brake trajectory lane_change")


class Control(_Control):
    """Decision of a driving function: acceleration, throttle and brake, or trajectory. See `cornercase.Control`."""

    __slots__ = ()

    def __new__(
        cls,
        acceleration: Optional[float] = None,
        steering: Optional[float] = None,
        throttle: Optional[float] = None,
        brake: Optional[float] = None,
        trajectory: Optional[Trajectory] = None,
        lane_change: Optional[str] = None,
    ) -> Control:
        """Check that exactly one kind of decision is given, and that a lane change comes without steering."""
        pedals = throttle is not None or brake is not None
        if (acceleration is not None) + pedals + (trajectory is not None) != 1:
            raise ValueError("give one of: acceleration, or throttle and brake, or a trajectory")
        if lane_change not in LANE_CHANGES:
            raise ValueError("lane_change is %r; give 'left', 'right' or None" % (lane_change,))
        if lane_change is not None and steering is not None:
            raise ValueError("a lane change steers by itself; leave out steering or lane_change")
        return super().__new__(cls, acceleration, steering, throttle, brake, trajectory, lane_change)


class Batch:
    """Batch of N concrete scenarios that run together, as described in the message ``start``."""

    def __init__(self, message: Mapping[str, Any], options: Dict[str, Any]) -> None:
        self.scenarios: int = message["scenarios"]
        self.time_step: float = message["time_step"]
        self.ego = message["ego"]
        self.values = message["values"]
        self.seeds = message["seeds"]
        self.friction = unpack_doubles(message["friction"])
        self.options = options
        self.parameters = {name: unpack_doubles(values) for name, values in message["parameters"].items()}
        self.others: List[Dict[str, Any]] = []

    def options_of(self, scenario: int) -> Dict[str, Any]:
        """Return the options of the function in a scenario, with the parameters that differ between scenarios."""
        return dict(self.options, **{name: values[scenario] for name, values in self.parameters.items()})


class Step:
    """Time step of M scenarios, with A other entities, and K points of the path ahead.

    `columns` has the name of each column with its numbers as a flat ``array('d')``: M, M * A or M * K numbers, first
    all numbers of the first scenario, then of the second, and so on.
    """

    def __init__(self, message: Mapping[str, Any], batch: Batch, ahead: List[float]) -> None:
        self.batch = batch
        self.time: float = message["time"]
        self.time_step: float = message["time_step"]
        self.scenarios: List[int] = message["scenarios"]
        self.columns = {name: unpack_doubles(values) for name, values in message["columns"].items()}
        self.others = batch.others
        self.signals = message.get("signals", {})
        self.ahead = ahead


class View:
    """View of one scenario for a driving function; attributes are as in `cornercase.drivers.View`.

    But there are no lanes and no speed limit, and `signals` has only the states of the signals that the scenario sets.
    """

    def __init__(self, step: Step, row: int) -> None:
        self._step, self._row = step, row
        self.time = step.time
        self._objects: Optional[Tuple[ObjectView, ...]] = None

    def _own(self, name: str) -> float:
        return self._step.columns[name][self._row]

    def _points(self, name: str, count: int) -> array.array[float]:
        return self._step.columns[name][self._row * count : (self._row + 1) * count]

    @property
    def target_speed(self) -> float:
        """Speed in m/s that the scenario asks for; infinite or NaN if the scenario asks for none."""
        return self._own("target_speed")

    @property
    def ego(self) -> EgoState:
        """State of the ego."""
        return EgoState(*(self._own(name) for name in EgoState._fields))

    @property
    def objects(self) -> Tuple[ObjectView, ...]:
        """All other entities that are sensed, the nearest first."""
        if self._objects is None:
            others = self._step.others
            names = ("x", "y", "heading", "speed", "gap", "closing", "lateral", "in_path")
            # All have one length; `zip` has no `strict` before Python 3.10.
            rows = zip(others, *(self._points("other_" + name, len(others)) for name in names))
            objects = [
                ObjectView(
                    other["name"], other["object_type"], x, y, heading, speed, other["length"], other["width"],
                    gap, closing, lateral, in_path != 0.0,
                )
                for other, x, y, heading, speed, gap, closing, lateral, in_path in rows
                if not math.isnan(x)
            ]  # fmt: skip
            self._objects = tuple(sorted(objects, key=lambda other: math.hypot(other.x, other.y)))
        return self._objects

    @property
    def leader(self) -> Optional[ObjectView]:
        """Nearest entity ahead in the ego's path; None if there is none."""
        ahead = [other for other in self.objects if other.in_path and other.gap >= 0.0 and other.x > 0.0]
        return min(ahead, key=lambda other: other.gap) if ahead else None

    @property
    def signals(self) -> Dict[str, str]:
        """State of each traffic signal by its name."""
        return {name: states[self._row] for name, states in self._step.signals.items()}

    def path(self, ahead: float) -> PathPoint:
        """Return the point of the ego's path at the distance `ahead` in m.

        The point is interpolated between the points at the distances that were given as ``serve(ahead=…)``.
        """
        distances = self._step.ahead
        if not distances:
            raise ValueError(
                "view.path needs the distances in m at which cornercase sends the path, as in"
                " serve(MyFunction, ahead=range(0, 101))"
            )
        high = min(max(bisect.bisect_left(distances, ahead), 1), len(distances) - 1)
        low = max(high - 1, 0)
        gap = distances[high] - distances[low]
        share = min(max((ahead - distances[low]) / gap, 0.0), 1.0) if gap > 0.0 else 0.0
        values = []
        for name in PathPoint._fields:
            points = self._points("path_" + name, len(distances))
            change = points[high] - points[low]
            if name == "heading":
                change = (change + math.pi) % (2.0 * math.pi) - math.pi
            values.append(points[low] + share * change)
        return PathPoint(*values)


class Function:
    """Base class of driving functions for one scenario; the constructor of a derived class takes its options."""

    def start(self, ego: Ego, rng: random.Random) -> None:
        """Begin a scenario; take all random numbers from `rng`. Does nothing by default."""

    def step(self, view: View, dt: float) -> Any:
        """Return a `Control` or an acceleration in m/s² for the coming `dt` s."""
        raise NotImplementedError


class BatchFunction:
    """Base class of driving functions that drive all scenarios of a batch at once, for speed.

    `columns`: names of the columns that the function needs; None for all. `option_names`: names of its options, so that
    cornercase refuses other options; None if any option may be given. `one_at_a_time`: True if the function can drive
    only one scenario at a time, for example because its state cannot be held for several.
    """

    columns: Optional[Sequence[str]] = None
    option_names: Optional[Sequence[str]] = None
    one_at_a_time = False

    def start(self, batch: Batch) -> Optional[Mapping[int, str]]:
        """Begin a batch; may return the reasons why scenarios fail, by number of the scenario."""
        return None

    def step(self, step: Step) -> Mapping[str, Any]:
        """Return the decisions for a time step of M scenarios, by name.

        ``acceleration``, ``steering``, ``throttle``, ``brake`` and ``lane_change`` are M numbers each, in a list or an
        array (also of NumPy). ``trajectories`` and ``failures`` are dicts by row of the step. Any key may be left
        out.
        """
        raise NotImplementedError


class ScalarAdapter(BatchFunction):
    """Driving function for batches that creates a `Function` object by `make` for each scenario of a batch."""

    def __init__(self, make: Callable[..., Function], one_at_a_time: bool = False) -> None:
        self.make, self.one_at_a_time = make, one_at_a_time
        self.option_names = _names_of_parameters(make)

    def start(self, batch: Batch) -> Dict[int, str]:
        """Create one object per scenario; return errors by scenario."""
        self.objects: List[Any] = []
        failures: Dict[int, str] = {}
        for n in range(batch.scenarios):
            function = None
            try:
                function = self.make(**batch.options_of(n))
                function.start(Ego(values=batch.values[n], **batch.ego), random.Random(batch.seeds[n]))
            except Exception as error:
                failures[n] = describe(error)
            self.objects.append(function)
        return failures

    def step(self, step: Step) -> Dict[str, Any]:
        """Collect the decisions of the objects of all scenarios in the step."""
        count, nan = len(step.scenarios), float("nan")
        numbers = {name: array.array("d", [nan]) * count for name in ("acceleration", "steering", "throttle", "brake")}
        numbers["lane_change"] = array.array("d", [0.0]) * count
        answer: Dict[str, Any] = dict(numbers, trajectories={}, failures={})
        for row, n in enumerate(step.scenarios):
            try:
                control = self.objects[n].step(View(step, row), step.time_step)
                if not isinstance(control, Control):
                    control = Control(acceleration=float(control))
                for name in ("acceleration", "steering", "throttle", "brake"):
                    value = getattr(control, name)
                    if value is not None:
                        if not math.isfinite(value):
                            raise ValueError("%s is %r, which is not a finite number" % (name, value))
                        numbers[name][row] = value
                numbers["lane_change"][row] = LANE_CHANGES[control.lane_change]
                if control.trajectory is not None:
                    answer["trajectories"][row] = control.trajectory
            except Exception as error:
                answer["failures"][row] = describe(error)
        return answer


def serve(
    make: Callable[..., Function],
    ahead: Sequence[float] = (),
    port: Optional[int] = None,
    host: str = "localhost",
    one_at_a_time: bool = False,
) -> None:
    """Run a driving function: answer the messages of cornercase until cornercase closes the connection.

    `make` is a class that derives from `Function`, or a function that returns an object of this kind. `ahead` are the
    distances in m at which cornercase sends the path, for `View.path`. With `port`, the function listens on this port
    for the driver ``exec:tcp://HOST:PORT``, one connection after the other without end, instead of using stdin and
    stdout.
    `one_at_a_time`: True if only one scenario may run at a time, because the objects share something.
    """
    serve_batches(ScalarAdapter(make, one_at_a_time), ahead, port, host)


def serve_batches(
    function: BatchFunction, ahead: Sequence[float] = (), port: Optional[int] = None, host: str = "localhost"
) -> None:
    """Run a driving function of whole batches; `ahead`, `port` and `host` are as in `serve`."""
    if port is None:
        _answer_messages(function, ahead, *_take_over_stdout())
        return
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(1)
        while True:
            connection, _ = listener.accept()
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                # Cornercase may have closed the connection; the next connection may come.
                with suppress(OSError):
                    _answer_messages(function, ahead, connection.makefile("rb"), connection.makefile("wb"))


def _take_over_stdout() -> Tuple[BinaryIO, BinaryIO]:
    """Return stdin and stdout as binary files; what the function prints goes to stderr from now on."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return sys.stdin.buffer, answers


def _answer_messages(function: BatchFunction, ahead: Sequence[float], messages: BinaryIO, answers: BinaryIO) -> None:
    distances = sorted(float(distance) for distance in ahead)
    options: Dict[str, Any] = {}
    while True:
        message = _receive(messages)
        if message is None:
            return
        kind = message.get("type")
        if kind == "hello":
            options = message["options"]
            _send(answers, _answer_hello(message, function, distances))
        elif kind == "start":
            batch = Batch(message, options)
            failures = function.start(batch) or {}
            _send(answers, {"type": "ready", "failures": sorted(failures.items())})
        elif kind == "step":
            batch.others = message.get("others", batch.others)
            answer = function.step(Step(message, batch, distances))
            _send(answers, _pack_answer(answer))


def _answer_hello(message: Mapping[str, Any], function: BatchFunction, ahead: List[float]) -> Dict[str, Any]:
    if message["protocol"] != PROTOCOL_VERSION:
        return {
            "type": "hello",
            "protocol": PROTOCOL_VERSION,
            "error": "this cornercase_client.py speaks version %d, cornercase %s speaks %s; copy the file again"
            % (PROTOCOL_VERSION, message.get("cornercase"), message["protocol"]),
        }
    return {
        "type": "hello",
        "protocol": PROTOCOL_VERSION,
        "columns": None if function.columns is None else list(function.columns),
        "ahead": list(ahead),
        "options": None if function.option_names is None else list(function.option_names),
        "one_at_a_time": function.one_at_a_time,
    }


def _names_of_parameters(make: Callable[..., Function]) -> Optional[List[str]]:
    """Return the names of the options that a constructor takes; None if it takes any name, or cannot be inspected."""
    try:
        parameters = list(inspect.signature(make).parameters.values())
    except (TypeError, ValueError):
        return None
    if any(parameter.kind == parameter.VAR_KEYWORD for parameter in parameters):
        return None
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [parameter.name for parameter in parameters if parameter.kind in by_name]


def _pack_answer(answer: Mapping[str, Any]) -> Dict[str, Any]:
    packed: Dict[str, Any] = {"type": "control"}
    for name, value in answer.items():
        if name == "trajectories":
            packed[name] = [[row] + [pack_doubles(column) for column in line] for row, line in sorted(value.items())]
        elif name == "failures":
            packed[name] = [[row, str(text)] for row, text in sorted(value.items())]
        else:
            packed[name] = pack_doubles(value)
    return packed


def unpack_doubles(content: bytes) -> array.array[float]:
    """Decode little-endian doubles to an ``array('d')``."""
    values = array.array("d")
    values.frombytes(content)
    if sys.byteorder == "big":
        values.byteswap()
    return values


def pack_doubles(values: Any) -> bytes:
    """Return numbers as bytes of little-endian doubles."""
    packed = array.array("d", values)
    if sys.byteorder == "big":
        packed.byteswap()
    return packed.tobytes()


def describe(error: BaseException) -> str:
    """Describe an exception by its type and message, with the file and line in which it was raised."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    text = "%s: %s" % (type(error).__name__, error)
    return "%s (%s line %s in %s: %s)" % (
        text.rstrip(": "), os.path.basename(frame.filename), frame.lineno, frame.name, frame.line,
    )  # fmt: skip


def _receive(stream: BinaryIO) -> Any:
    """Read the next message from a stream; None if the stream has ended."""
    head = stream.read(4)
    if len(head) < 4:
        return None
    (length,) = struct.unpack("<I", head)
    content = stream.read(length)
    return msgpack.unpackb(content, raw=False, strict_map_key=False) if len(content) == length else None


def _send(stream: BinaryIO, message: Mapping[str, Any]) -> None:
    content = msgpack.packb(message, use_bin_type=True)
    stream.write(struct.pack("<I", len(content)) + content)
    stream.flush()
