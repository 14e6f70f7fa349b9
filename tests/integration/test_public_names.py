"""The public names fit one screen, and each of them is there."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest

import cornercase

FUNCTIONS = (
    "analyze", "check", "compare", "convert", "estimate", "explore", "import_recordings", "measure", "read_recording", "reduce", "replay", "simulate",
    "run_suite", "simulate_many", "summarize", "watch", "write_report",
)  # fmt: skip
TYPES = (
    "Comparison", "ConcreteScenario", "Control", "Driver", "LogicalScenario", "Metric", "Optimizer", "Parameter",
    "ParameterSpace", "Problem", "Recording", "ReducedSet", "Runs", "Simulator", "Study", "Suite", "SuiteResult",
    "SystemUnderTest",
)  # fmt: skip
ROOMS = ("drivers", "metrics", "optimizers", "simulators", "stop")
ERRORS = ("InputError", "NoticeWarning", "SimulationError", "SimulatorError")


def names() -> list[str]:
    """The names that the package shows; the stub that it reads them from has no list of its own."""
    shown: list[str] = vars(cornercase)["__all__"]
    return shown


def test_the_public_names_are_these():
    assert sorted(names()) == sorted((*FUNCTIONS, *TYPES, *ROOMS, *ERRORS, "__version__"))


def test_dir_shows_them_and_each_is_there():
    assert set(names()) == set(dir(cornercase))
    assert len(names()) <= 45
    for name in names():
        assert getattr(cornercase, name) is not None
    assert all(callable(getattr(cornercase, name)) for name in (*FUNCTIONS, *TYPES))


@pytest.mark.slow
def test_a_function_stays_a_function_whatever_is_imported_before():
    program = """
import pkgutil, importlib, cornercase
for module in pkgutil.walk_packages(cornercase.__path__, "cornercase."):
    if not module.name.rpartition(".")[2].startswith("cornercase_"):
        importlib.import_module(module.name)
print([name for name in cornercase.__all__ if type(getattr(cornercase, name)).__name__ == "module"])
"""
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert sorted(ast.literal_eval(found.stdout)) == list(ROOMS)


def test_importing_the_package_loads_nothing_heavy():
    program = "import sys, cornercase; print([m for m in ('numpy', 'numba', 'scipy', 'pandas') if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_who_searches_or_looks_does_not_wait_for_scikit_learn():
    program = (
        "import sys, cornercase.exploration._explore, cornercase.report._report_page; print('sklearn' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "False"
