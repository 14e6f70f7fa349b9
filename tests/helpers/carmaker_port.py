"""A replacement for CarMaker's command port, and the files of a project."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np

from cornercase.simulators import Builtin
from cornercase.testing._small_scenarios import write_small_scenarios
from helpers import foreign_recordings as foreign


class Port:
    """A replacement for CarMaker that listens on a command port and goes through its states.

    After ``StartSim`` it prepares, adapts its driver, runs and postprocesses, each for some questions for its status;
    then it is idle, and its result lies in a new file; without a course it never begins. ``odd`` says what it answers instead, by the word a command
    begins with; ``waits`` whether ``WaitForStatus`` waits, comes back at once, is an error, or waits for a state that
    does not come by itself until its time is up ("in full").
    """

    def __init__(
        self, pieces=1000, odd=None, waits="waits", course=(-1, -5, 0, 0, -3), write=None, state=(-2,), number=0,
        project=Path(), write_testrun=None,
    ):  # fmt: skip
        self.project, self._write_testrun = project, write_testrun
        self._listener = socket.create_server(("127.0.0.1", number))
        self.number = self._listener.getsockname()[1]
        self.asked: list[str] = []
        self._pieces, self._odd, self._waits, self._course = pieces, odd or {}, waits, course
        self._write = write or (lambda path, values: foreign.erg(path, speed=float(values["ego_speed"])))
        self._states, self._values, self._runs, self._begun = list(state), {}, 0, False
        self._result, self.testrun, self._suffix = "", "", ""
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        while True:
            try:
                line, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._talk, args=(line,), daemon=True).start()

    def _talk(self, line):
        # The client may have disconnected.
        with suppress(OSError):
            self._answer_all(line)

    def _answer_all(self, line):
        heard = b""
        with line:
            while piece := line.recv(4096):
                heard += piece
                while b"\r" in heard:
                    command, _, heard = heard.partition(b"\r")
                    self.asked.append(command.decode())
                    word = command.decode().split()[0]
                    odd = self._odd.get(word)
                    odd = odd.pop(0) if isinstance(odd, list) and odd else odd or None
                    if odd == "close":
                        return
                    if odd == "silence":
                        time.sleep(2)
                    answer = odd.encode() if odd else self._answer(command.decode())
                    half = odd == "Ocut"
                    for k in range(0, len(answer), self._pieces):
                        line.sendall(answer[k : k + self._pieces])
                        time.sleep(0.001)
                    if half:
                        return

    def _answer(self, command):
        word, *rest = command.split()
        if word == "SimStatus":
            return b"O%d\r\n\r\n" % self._next()
        if word == "WaitForStatus":
            is_there = self._state() >= 0 if rest[0] == "running" else self._state() == -2
            if self._waits == "in full" and not is_there:
                time.sleep(1e-3 * int(rest[1]))
            for _ in range(100 if self._waits == "waits" else 0):
                if self._state() >= 0 if rest[0] == "running" else self._state() == -2:
                    break
                self._next()
            return b"Etimeout\r\n\r\n" if self._waits == "error" else b"O0\r\n\r\n"
        if word == "SetResultFName":
            self._suffix = rest[0].strip('"').removeprefix("%o/%r/%D/%f_%T").removesuffix("%?_s")
        if word == "LoadTestRun":
            self.testrun = rest[0].strip('"')
        if word == "NamedValue":
            self._values[rest[1]] = rest[2]
            return b"O\r\n\r\n"
        if word == "GetLastResultFName":
            return f"O{self._result}\r\n\r\n".encode()
        if word == "StartSim" and self._course is not None:
            self._states, self._begun = [*self._course, -2], True
        if word == "StopSim":
            self._states, self._begun = [-3, -2], False
        if word in ("LoadTestRun", "SaveMode", "StartSim", "StopSim", "OutQuantsAdd", "SetResultFName"):
            return b"\r\n"
        return f'Einvalid command name "{word}"\r\n\r\n'.encode()

    def _state(self):
        if self._states[0] == -2 and self._begun:
            self._begun = False
            self._runs += 1
            self._result = f"SimOutput/pc/run{self._runs}{self._suffix}.erg"
            if self._write_testrun is not None:
                self._write_testrun(self.project / self._result, self.testrun)
            else:
                self._write(self.project / self._result, self._values)
        return self._states[0]

    def _next(self):
        """Return the state and move to the next; the last one stays."""
        state = self._state()
        if len(self._states) > 1:
            self._states.pop(0)
        return state

    def close(self):
        # Wakes up the thread that waits for a call.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


def write_testrun(folder, *more, names=("ego_speed", "gap", "lanes", "weather", "lights"), vehicle=""):
    """A TestRun that uses named values, and the vehicle data set that it names."""
    (folder / "Data" / "TestRun").mkdir(parents=True, exist_ok=True)
    (folder / "Data" / "Vehicle" / "Examples").mkdir(parents=True, exist_ok=True)
    lines = [
        "#INFOFILE1.1 - Do not remove this line!", "FileIdent = CarMaker-TestRun 10", "FileCreator = CarMaker 8.0.2 2019-11-25",
        "Description:", "\twithout anything", "# $comment=3", "Vehicle = Examples/MyCar",
        *(f"Extra.{name} = ${name}=1" for name in names), *more,
    ]  # fmt: skip
    (folder / "Data" / "TestRun" / "Crossing").write_text("\n".join(lines) + "\n")
    (folder / "Data" / "Vehicle" / "Examples" / "MyCar").write_text(f"Body.mass = $mass=1500\n{vehicle}\n")


class SmallTestRuns:
    """Writes the small scenarios of the checks as CarMaker would: the motion of the builtin simulator, with a fault."""

    def __init__(self, project, fault=""):
        self.folder = project / "scenarios"
        self.folder.mkdir(exist_ok=True)
        self.scenarios = {one.path.stem: one for one in write_small_scenarios(self.folder).values()}
        skin = "Vehicle.OuterSkin = 0.7 0.9 0.2 5.2 -0.9 1.6" if fault == "box" else ""
        write_testrun(project, names=(), vehicle=skin)
        for stem in self.scenarios:
            (project / "Data" / "TestRun" / stem).write_text((project / "Data" / "TestRun" / "Crossing").read_text())
        self.fault = fault

    def write(self, path, testrun):
        (recording,) = Builtin().run([self.scenarios[testrun]])
        columns = carmaker_columns(recording, self.fault)
        foreign.write_erg(path, columns)


def carmaker_columns(recording, fault=""):
    """Columns of a result file, in CarMaker's conventions unless there is a fault."""
    time = recording.time
    columns: dict[str, tuple[str, Any]] = {}
    late = np.maximum(np.arange(len(time)) - (fault == "late"), 0)
    if fault == "stale":
        late[-1] -= 1
    for e, name in enumerate(recording.names):
        heading, speed = recording.heading[e][late], recording.speed[e][late]
        # From the reference point to the centre of the box, and from there to the middle of the rear end.
        ahead = recording.center_x[e] - (0.0 if fault == "centre" else 0.5 * recording.length[e])
        x = recording.x[e][late] + ahead * np.cos(heading)
        y = recording.y[e][late] + ahead * np.sin(heading)
        if fault == "speed" and name == "Ego":
            x, speed = x[0] + speed[0] * time, speed[0] + 0 * speed
        if fault == "mirror":
            y, heading = -y, -heading
        if fault == "heading":
            heading = -heading
        if fault == "feet":
            x, y, speed = x / 0.3048, y / 0.3048, speed / 0.3048
        names = (
            ("Car.tx", "Car.ty", "Car.Yaw", "Car.v")
            if name == "Ego"
            else tuple(f"Traffic.{name}.{quantity}" for quantity in ("tx", "ty", "rz", "LongVel"))
        )
        columns |= {key: ("Double", values) for key, values in zip(names, (x, y, heading, speed), strict=True)}
    count = (time > 0.8 * time[-1]).astype(int) if fault == "sensor" else 0 * time
    return {
        "Time": ("Double", time * (1.02 if fault == "drift" else 1.0)),
        **columns,
        "Sensor.Collision.Vhcl.Fr1.Count": ("Int", count),
    }


def small_port(project, fault="", number=0):
    """A port that runs the small scenarios of the checks, with a fault."""
    runs = SmallTestRuns(project, fault)
    # Listens from the beginning on, so everything else has to be there.
    return Port(pieces=1000, course=(), number=number, project=project, write_testrun=runs.write)


def serve_alone(number, project, *wrong):
    """Be a program that takes commands at a port; with ``crash-once`` it dies in its first run.

    With ``small`` it runs the small scenarios of the checks, with the fault that follows.
    """
    with (project / "started.txt").open("a") as file:
        file.write("started\n")

    def write(path, values):
        if "crash-once" in wrong and (project / "started.txt").read_text().count("started") == 1:
            os._exit(1)
        foreign.erg(path, speed=float(values["ego_speed"]))

    if "small" in wrong:
        small_port(project, "".join(wrong[1:]), number)
    else:
        Port(number=number, write=write, pieces=1000, project=project)
    threading.Event().wait()


if __name__ == "__main__":
    serve_alone(int(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
