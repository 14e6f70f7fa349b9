"""What is said where the packages of an extra are missing."""

from __future__ import annotations

import platform
import sys

import pytest

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase.simulators.carla._client_process import ClientProcess
from cornercase.simulators.carla._runner_environment import RunnerEnvironment

EXTRAS = ("gpu", "validate", "parquet", "optuna", "cluster", "fmu", "osi", "live", "video", "sumo", "commonroad")


def pretend(monkeypatch, version, machine="x86_64"):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(platform, "system", lambda: "Linux")
    monkeypatch.setattr(platform, "python_version_tuple", lambda: tuple(version.split(".")))
    monkeypatch.setattr(platform, "machine", lambda: machine)


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_that_installs_something_is_named(extra, monkeypatch):
    pretend(monkeypatch, "3.13.1")
    assert describe_install(extra) == f"install it with pip install 'cornercase[{extra}]'"


@pytest.mark.parametrize(
    ("version", "machine", "said"),
    [
        ("3.12.4", "x86_64", "install it with pip install 'cornercase[carla]'"),
        ("3.13.1", "x86_64", "there is none for Python 3.13 on Linux x86_64, where the extra 'carla' installs nothing"),
        ("3.12.4", "aarch64", "there is none for Python 3.12 on Linux aarch64, where the extra 'carla' installs"),
    ],
)
def test_an_extra_that_installs_nothing_here_is_not_recommended(version, machine, said, monkeypatch):
    pretend(monkeypatch, version, machine)
    assert describe_install("carla").startswith(said)


def test_a_missing_client_of_carla_is_not_asked_for_where_there_is_none(tmp_path, monkeypatch):
    monkeypatch.setattr(platform, "python_version_tuple", lambda: ("3", "13", "1"))
    # An environment in which nothing called carla can be imported.
    (tmp_path / "carla.py").write_text("raise ModuleNotFoundError(\"No module named 'carla'\")\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    client = ClientProcess(RunnerEnvironment(tmp_path, sys.executable, ""))
    try:
        with pytest.raises(InputError, match=r"there is none for Python 3\.13 .* Set CORNERCASE_CARLA_PYTHON to"):
            client.call_method("get_version")
    finally:
        client.close()
