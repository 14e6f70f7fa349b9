"""Simulators that fail in all the ways in which simulators fail; they are known wherever this module is loaded."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.recordings import Recording
from cornercase.simulators import SIMULATORS, Simulator


class UnsendableError(SimulationError):
    def __reduce__(self):
        os._exit(7)


END = object()


class Plan:
    """What goes wrong in which scenario: by the value of its parameter ``k``, a list of what each try does."""

    def __init__(self, folder, does=None, start="well"):
        self.folder, self.does, self.start = Path(folder), does or {}, start


class FailingSimulator(Simulator):
    """Fails as its plan says, and notes each start and each try in the plan's folder."""

    name = "failing"

    def __init__(self, *, plan):
        self.settings = {}
        self._plan = plan
        self._begun = False

    def run(self, concretes):
        self._begin()
        for concrete in concretes:
            found = self._outcome(int(concrete.values["k"]))
            if found is END:
                return
            yield found

    def close(self):
        if self._begun:
            self._note("ends")

    def _begin(self):
        if not self._begun:
            self._begun = True
            self._note("starts")

    def _outcome(self, k):
        tries = self._note(f"tries-{k}")
        plan = self._plan.does.get(k, ["well"])
        what = plan[min(tries, len(plan)) - 1]
        if what == "crash":
            os._exit(3)
        elif what == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        elif what == "full":
            with open("/dev/full", "w") as file:
                file.write("x")
        elif what == "hang":
            time.sleep(600)
        elif what == "raise":
            raise ZeroDivisionError("of the adapter")
        elif what == "refuse":
            raise InputError("The licence server is gone; start it.")
        elif what == "cut":
            return UnsendableError()
        elif what == "fail":
            return SimulationError("it cannot be")
        elif what == "lose":
            return SimulatorError("the program is gone")
        elif what == "none":
            return None
        elif what == "junk":
            return {"x": 1}
        elif what == "end":
            return END
        elif what == "nap":
            time.sleep(0.3)
        elif what == "child":
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            # Who sees the file finds the number in it.
            (self._plan.folder / "child").write_text(str(child.pid))
            (self._plan.folder / "child").rename(self._plan.folder / "children")
            time.sleep(600)
        return recording(k)

    def _note(self, name):
        path = self._plan.folder / name
        with path.open("a") as file:
            file.write("x")
        return path.stat().st_size


class BatchSimulator(FailingSimulator):
    """Runs all in lock-step: what befalls one befalls all, and results come at the end."""

    name = "batches"
    batched = True

    def run(self, concretes):
        self._begin()
        with (self._plan.folder / "batches").open("a") as file:
            file.write(f"{len(concretes)} ")
        found = [self._outcome(int(concrete.values["k"])) for concrete in concretes]
        yield from found[: found.index(END)] if END in found else found


class InsideSimulator(BatchSimulator):
    """Runs in the process that asks for it, as the builtin simulator does, so that it takes this with it."""

    name = "inside"
    in_process = True


class TellingSimulator(Simulator):
    """Tells the values that it was given: an entity of the name of each parameter stands at its value."""

    name = "named-values"

    def __init__(self, *, plan):
        self.settings = {}

    def run(self, concretes):
        for concrete in concretes:
            names, values = zip(*concrete.values.items(), strict=True)
            still, one = np.zeros((len(names), 2)), np.ones(len(names))
            yield Recording(
                time=np.arange(2) * 0.1,
                names=names,
                object_types=("car",) * len(names),
                x=still + np.array(values)[:, None],
                y=still,
                heading=still,
                speed=still,
                acceleration=still,
                length=one,
                width=one,
                center_x=0 * one,
            )


class NoisySimulator(Simulator):
    """Never gives the same twice: the other stands somewhere else in each run, and every fifth run fails."""

    name = "noisy"

    def __init__(self, **options):
        self.settings = {}
        self._rng = np.random.default_rng(0)
        self.given = []

    def run(self, concretes):
        for _ in concretes:
            if len(self.given) % 5 == 4:
                self.given.append(None)
                yield SimulationError("it cannot be")
                continue
            self.given.append(float(self._rng.uniform(10.0, 50.0)))
            row, still, one = np.array([[0.0] * 3, [self.given[-1]] * 3]), np.zeros((2, 3)), np.ones(2)
            yield Recording(
                time=np.arange(3) * 0.1,
                names=("Ego", "C"),
                object_types=("car",) * 2,
                x=row,
                y=still,
                heading=still,
                speed=still,
                acceleration=still,
                length=one,
                width=one,
                center_x=0 * one,
            )


def recording(k):
    """One entity that stands at x = k."""
    row = np.full((1, 3), float(k))
    still = np.zeros((1, 3))
    one = np.ones(1)
    return Recording(
        time=np.arange(3) * 0.1,
        names=("Ego",),
        object_types=("car",),
        x=row,
        y=still,
        heading=still,
        speed=still,
        acceleration=still,
        length=one,
        width=one,
        center_x=0 * one,
        collisions=(),
    )


if "noisy" not in SIMULATORS.names():
    SIMULATORS.register("noisy", NoisySimulator)
if "failing" not in SIMULATORS.names():
    SIMULATORS.register("failing", FailingSimulator)
    SIMULATORS.register("batches", BatchSimulator)
    SIMULATORS.register("inside", InsideSimulator)
    SIMULATORS.register("named-values", TellingSimulator)
