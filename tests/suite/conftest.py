"""A suite of a study, and what running it again gave."""

from __future__ import annotations

import shutil

import pytest

import cornercase as cc
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config


@pytest.fixture(scope="session")
def explored(tmp_path_factory):
    """A study of the T-intersection with a daring ego, and its reduced set below it."""
    folder = tmp_path_factory.mktemp("suite")
    configuration = paper_experiment_config("t-intersection", budget=30, driver="aggressive")
    explore_config(configuration, folder / "study.db")
    cc.analyze(folder / "study.db", ["ttc"])
    cc.reduce(folder / "study.db", folder / "reduced", size=6, scenario=configuration.logical.scenario_file)
    return folder


@pytest.fixture
def reduced(explored, tmp_path):
    """A copy of the reduced set that may be spoilt, beside its study."""
    shutil.copy(explored / "study.db", tmp_path / "study.db")
    return shutil.copytree(explored / "reduced", tmp_path / "reduced")


@pytest.fixture(scope="session")
def ran(explored):
    return cc.run_suite(explored / "reduced", explored / "run.db", require=["no collision"])
