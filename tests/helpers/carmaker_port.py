"""A replacement for CarMaker's command port, and the files of a project."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers import foreign_recordings as foreign


class Port:
    """A replacement for CarMaker that listens on a command port and goes through its states.

    After ``StartSim`` it prepares, adapts its driver, runs and postprocesses, each for some questions for its status;
    then it is idle, and its result lies in a new file; without a course it never begins. ``odd`` says what it answers instead, by the word a command
    begins with; ``waits`` whether ``WaitForStatus`` waits, comes back at once, or is an error.
    """

    def __init__(self, pieces=1, odd=None, waits="waits", course=(-1, -5, 0, 0, -3), write=None, state=(-2,), number=0):
        self._listener = socket.create_server(("127.0.0.1", number))
        self.number = self._listener.getsockname()[1]
        self.asked: list[str] = []
        self.project = Path()
        self._pieces, self._odd, self._waits, self._course = pieces, odd or {}, waits, course
        self._write = write or (lambda path, values: foreign.erg(path, speed=float(values["ego_speed"])))
        self._states, self._values, self._runs, self._begun = list(state), {}, 0, False
        self._result = ""
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
            for _ in range(100 if self._waits == "waits" else 0):
                if self._state() >= 0 if rest[0] == "running" else self._state() == -2:
                    break
                self._next()
            return b"Etimeout\r\n\r\n" if self._waits == "error" else b"O0\r\n\r\n"
        if word == "NamedValue":
            self._values[rest[1]] = rest[2]
            return b"O\r\n\r\n"
        if word == "GetLastResultFName":
            return f"O{self._result}\r\n\r\n".encode()
        if word == "StartSim" and self._course is not None:
            self._states, self._begun = [*self._course, -2], True
        if word == "StopSim":
            self._states, self._begun = [-3, -2], False
        if word in ("LoadTestRun", "SaveMode", "StartSim", "StopSim", "OutQuantsAdd"):
            return b"\r\n"
        return f'Einvalid command name "{word}"\r\n\r\n'.encode()

    def _state(self):
        if self._states[0] == -2 and self._begun:
            self._begun = False
            self._runs += 1
            self._result = f"SimOutput/pc/run{self._runs}.erg"
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


def serve_alone(number, project, *wrong):
    """Be a program that takes commands at a port; with ``crash-once`` it dies in its first run."""
    with (project / "started.txt").open("a") as file:
        file.write("started\n")

    def write(path, values):
        if "crash-once" in wrong and (project / "started.txt").read_text().count("started") == 1:
            os._exit(1)
        foreign.erg(path, speed=float(values["ego_speed"]))

    Port(number=number, write=write, pieces=1000).project = project
    threading.Event().wait()


if __name__ == "__main__":
    serve_alone(int(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
