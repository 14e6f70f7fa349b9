"""What runs in ScenarioRunner's own Python, which may be as old as 3.7, with CARLA replaced."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from cornercase.simulators.carla._client_process import ClientError, ClientProcess, find_client_version
from cornercase.simulators.carla._runner_environment import RunnerEnvironment

FOLDER = Path(__file__).parents[2] / "src" / "cornercase" / "simulators" / "carla"
FILES = sorted(FOLDER.glob("cornercase_*.py"))


@cache
def old_pythons():
    """Python 3.7 and 3.8, where they are installed."""
    named = [shutil.which(f"python{version}") for version in ("3.7", "3.8")]
    found = [Path(one) for one in named if one is not None]
    found += [one / "bin" / "python" for one in sorted(Path.home().glob(".pyenv/versions/3.[78].*"))]
    return [one for one in found if subprocess.run([one, "-c", ""], capture_output=True, check=False).returncode == 0]


CARLA = """
class Client:
    def __init__(self, host, port): self.port = port
    def set_timeout(self, seconds): pass
    def get_client_version(self): return "0.9.13"
    def get_server_version(self):
        print("CARLA's client may print")
        if self.port == 1: raise RuntimeError("time-out of 100ms")
        return "0.9.13"
    def get_world(self): return World()
class World:
    callback = None
    def get_actors(self): return [Actor(7, "Ego"), Actor(8, "C")]
    def get_blueprint_library(self): return self
    def find(self, kind): return kind
    def spawn_actor(self, blueprint, transform, attach_to): return self
    def listen(self, callback): pass
    def stop(self): pass
    def destroy(self): pass
    def on_tick(self, callback):
        callback(Snapshot())
        return 1
    def remove_on_tick(self, number): pass
class Vector:
    x, y, z = 3.0, 4.0, 0.0
class Rotation:
    yaw = -90.0
class Transform:
    location, rotation = Vector(), Rotation()
class Actor:
    type_id, parent = "vehicle.a.b", None
    def __init__(self, number, name):
        self.id, self.attributes = number, {"role_name": name, "base_type": "car"}
    def get_transform(self): return Transform()
    def get_velocity(self): return Vector()
    class bounding_box:
        extent, location = Vector(), Vector()
class Snapshot:
    class timestamp:
        frame, delta_seconds = 5, 0.05
    def __iter__(self): return iter([Actor(9, "new")])
"""


def test_it_is_written_in_the_oldest_python():
    assert len(FILES) == 6
    for file in FILES:
        tree = ast.parse(file.read_text(encoding="utf-8"), feature_version=(3, 7))
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level == 0]
        assert not [one for one in imports if (one.module or "").partition(".")[0] in ("cornercase", "numpy")]


@pytest.mark.skipif(not old_pythons(), reason="no Python 3.7 or 3.8 is installed")
@pytest.mark.parametrize("python", old_pythons(), ids=lambda python: python.parent.parent.name)
def test_all_is_imported_by_an_old_python(python):
    script = f"""
import importlib.machinery, sys, types
class Stub(types.ModuleType):
    __path__ = []
    def __getattr__(self, name):
        if name.startswith("__"): raise AttributeError(name)
        return type(name, (), {{}})
class Finder:
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in ("carla", "srunner", "agents", "scenario_runner"):
            return importlib.machinery.ModuleSpec(name, self)
    def create_module(self, spec): return Stub(spec.name)
    def exec_module(self, module): pass
sys.meta_path.insert(0, Finder())
sys.path.insert(0, {str(FOLDER)!r})
for name in {[file.stem for file in FILES]!r}:
    importlib.import_module(name)
print("all")
"""
    done = subprocess.run([python, "-c", script], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("all\n", "")


@pytest.mark.skipif(not old_pythons(), reason="no Python 3.7 or 3.8 is installed")
@pytest.mark.parametrize("python", old_pythons(), ids=lambda python: python.parent.parent.name)
def test_the_client_answers_from_an_old_python(python, tmp_path):
    (tmp_path / "carla.py").write_text(CARLA)
    environment = RunnerEnvironment(tmp_path, str(python), "")
    assert find_client_version(environment) == "0.9.13"
    client = ClientProcess(environment)
    try:
        assert client.call_method("connect", "a", 2000, 0.1) == ["0.9.13", "0.9.13"]
        with pytest.raises(ClientError, match="time-out of 100ms"):
            client.call_method("connect", "a", 1, 0.1)
        client.call_method("connect", "a", 2000, 0.1)
        client.call_method("track", ["Ego", "C"], "")
        found = client.call_method("poll")
        assert found["missing"] == ["Ego", "C"]
        # In right-handed axes.
        ((number, step, poses),) = json.loads(json.dumps(found["frames"]))
        assert (number, step) == (5, 0.05)
        assert poses["9"] == pytest.approx([3.0, -4.0, 1.5707963, -4.0])
        client.call_method("track", ["Ego"], "Ego")
        ego = client.call_method("poll")["entities"]["Ego"]
        assert (ego["id"], ego["length"], ego["ahead"], ego["left"]) == (7, 6.0, 3.0, -4.0)
        client.call_method("end_tracking")
    finally:
        client.close()
