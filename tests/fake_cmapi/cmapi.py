"""Stands in for IPG's cmapi, as far as public programs show it; what goes wrong is said by FAKE_CMAPI."""

import asyncio
import enum
import json
import os
import subprocess
import sys

from helpers import foreign_recordings as foreign_recordings

WRONG = os.environ.get("FAKE_CMAPI", "")


class StorageMode(enum.Enum):
    save = 1


class ConditionSimState(enum.Enum):
    finished = 1
    idle = 2


class SimControlState(enum.Enum):
    configure = 1
    running = 2
    finished = 3


class Task:
    @staticmethod
    def run_main_task(main):
        return asyncio.run(main)


class NamedValue:
    def __init__(self, name, value):
        self.name, self.value = name, value


class OutputQuantities:
    def __init__(self):
        self.names = []

    @classmethod
    def create(cls):
        return cls()

    def add_quantities(self, names):
        self.names += names


class Project:
    loaded: "Project"

    def __init__(self, path):
        self.path = path

    @classmethod
    def load(cls, path):
        cls.loaded = cls(path)

    @classmethod
    def instance(cls):
        return cls.loaded

    def load_testrun_parametrization(self, path):
        if not (self.path / "Data" / "TestRun" / path).is_file():
            raise FileNotFoundError(f"no TestRun {path}")
        return path


class Variation:
    def __init__(self, testrun):
        self.testrun = testrun

    @classmethod
    def create_from_testrun(cls, testrun):
        return cls(testrun)

    quantities = ()

    def set_name(self, name):
        self.name = name

    def set_nvalues(self, values):
        self.values = {one.name: one.value for one in values}

    def set_outputquantities(self, quantities):
        self.quantities = quantities.names

    def set_storage_mode(self, mode):
        assert mode is StorageMode.save


class CarMaker:
    process: "subprocess.Popen[bytes]"

    def start(self):
        self.process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])

    def get_pid(self):
        return self.process.pid

    def __del__(self):
        # Whoever was told its number has ended it.
        if hasattr(self, "process"):
            self.process.wait()


class Condition:
    def __init__(self, control, state):
        self.control, self.state = control, state

    async def wait(self):
        if self.state is ConditionSimState.finished and self.control.status is SimControlState.running:
            await self.control.run()
        if self.state is ConditionSimState.idle:
            if WRONG in ("restless", "hang on"):
                await asyncio.sleep(60)
            self.control.status = SimControlState.configure


class SimControlInteractive:
    """Takes a variation, and starts it, only while it is configured: after a run it has to be stopped first."""

    def __init__(self):
        self.status = SimControlState.running if WRONG in ("busy", "restless") else SimControlState.configure

    async def set_master(self, master):
        assert isinstance(master, CarMaker)
        self.master = master

    def set_variation(self, variation):
        if self.status is SimControlState.configure:
            self.variation = variation

    def get_status(self):
        return self.status

    async def start_and_connect(self):
        self.master.start()
        if WRONG == "start":
            raise ConnectionError("no licence")
        if WRONG == "slow start":
            await asyncio.sleep(60)
        self.note("connected")

    async def start_sim(self):
        if WRONG == "raise":
            raise RuntimeError("the application is gone")
        if WRONG == "deaf":
            await asyncio.sleep(60)
        crashed = Project.loaded.path / "crashed"
        if WRONG == "raise once" and not crashed.exists():
            crashed.touch()
            raise RuntimeError("the application is gone")
        if self.status is SimControlState.configure:
            self.note(json.dumps(self.variation.values))
            self.status = SimControlState.running

    def create_simstate_condition(self, state):
        return Condition(self, state)

    async def run(self):
        if WRONG in ("hang", "hang on"):
            await asyncio.sleep(60)
        if WRONG != "no file":
            number = len(list((Project.loaded.path / "SimOutput").glob("*.erg")))
            path = Project.loaded.path / "SimOutput" / f"run{number}.erg"
            (Project.loaded.path / "quantities.txt").write_text(" ".join(self.variation.quantities))
            foreign_recordings.erg(path, speed=self.variation.values.get("ego_speed", foreign_recordings.SPEED))
        self.status = SimControlState.finished

    def stop_sim(self):
        self.note("stopped")

    async def stop_and_disconnect(self):
        if WRONG == "stays":
            await asyncio.sleep(60)
        self.note("disconnected")
        self.master.process.kill()

    def note(self, words):
        with (Project.loaded.path / "said.txt").open("a") as file:
            file.write(words + "\n")
