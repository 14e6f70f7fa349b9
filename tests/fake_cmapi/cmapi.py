"""Stands in for IPG's cmapi, as far as public programs show it; what goes wrong is said by FAKE_CMAPI."""

import asyncio
import enum
import json
import os

import foreign_recordings

WRONG = os.environ.get("FAKE_CMAPI", "")


class StorageMode(enum.Enum):
    save = 1


class ConditionSimState(enum.Enum):
    finished = 1
    idle = 2


class Task:
    @staticmethod
    def run_main_task(main):
        return asyncio.run(main)


class NamedValue:
    def __init__(self, name, value):
        self.name, self.value = name, value


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

    def set_name(self, name):
        self.name = name

    def set_nvalues(self, values):
        self.values = {one.name: one.value for one in values}

    def set_storage_mode(self, mode):
        assert mode is StorageMode.save


class CarMaker:
    pass


class SimControlInteractive:
    async def set_master(self, master):
        assert isinstance(master, CarMaker)

    def set_variation(self, variation):
        self.variation = variation

    async def start_and_connect(self):
        if WRONG == "start":
            raise ConnectionError("no licence")
        self.note("connected")

    async def start_sim(self):
        if WRONG == "raise":
            raise RuntimeError("the application is gone")
        self.note(json.dumps(self.variation.values))

    def create_simstate_condition(self, state):
        assert state is ConditionSimState.finished
        return self

    async def wait(self):
        if WRONG == "hang":
            await asyncio.sleep(60)
        if WRONG != "no file":
            number = len(list((Project.loaded.path / "SimOutput").glob("*.erg")))
            foreign_recordings.erg(Project.loaded.path / "SimOutput" / f"run{number}.erg")

    def stop_sim(self):
        self.note("stopped")

    async def stop_and_disconnect(self):
        self.note("disconnected")

    def note(self, words):
        with (Project.loaded.path / "said.txt").open("a") as file:
            file.write(words + "\n")
