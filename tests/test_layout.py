"""The floor plan: rooms, sizes, and what may stand where."""

from __future__ import annotations

import ast
import configparser
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from cornercase.optimizers import OPTIMIZERS
from cornercase.simulators import SIMULATORS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "cornercase"
ROOMS = sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists())

LONGEST_MODULE, LONGEST_FUNCTION, MOST_PARAMETERS = 800, 80, 10
# Functions that are longer, or have more parameters, and why.
LARGE = {
    "cli/estimating.py estimate": "one parameter for each option of the command",
    "cli/explore.py explore": "one parameter for each option of the command",
    "cli/study.py analyze": "one parameter for each option of the command",
    "cli/study.py reduce": "one parameter for each option of the command",
    "cli/simulating.py simulate": "one parameter for each option of the command",
    "cli/testing.py test_": "one parameter for each option of the command",
    "clustering/analyzing.py analyze": "part of the API: one parameter for each option of the command",
    "dtw/cpu.py _four_rows": "compiled: machine code takes numbers and arrays, no objects",
    "dtw/cpu.py _one_row": "compiled: machine code takes numbers and arrays, no objects",
    "exploration/estimating.py estimate": "part of the API: one parameter for each option of the command",
    "exploration/exploring.py explore": "part of the API: one parameter for each option of the command",
    "simulators/simulating_many.py simulate_many": "part of the API: one parameter for each option of the command",
    "simulators/builtin/tracks/lane_kernels.py _advance": "the columns of a path, which compiled code takes one by one",
    "suite/testing.py test": "part of the API: one parameter for each option of the command",
    "reduction/reducing.py reduce": "part of the API: one parameter for each option of the command",
    "roads/lane_path.py of_points": "one parameter for each array of the path",
    "simulators/carla/simulator.py __init__": "one parameter for each option of the simulator",
    "simulators/carmaker/simulator.py __init__": "one parameter for each option of the simulator",
}
# Objects of other packages, whose versions differ in what they have; and drivers, which need no base class.
OF_OTHERS = ("recordings/formats/", "_common/platform.py", "drivers/base.py", "drivers/loading.py")
OPTIONS_OF_OTHERS = {"--csv_logger"}
PLATFORM = "_common/platform.py"


@cache
def modules() -> dict[str, ast.Module]:
    """All of the package, read by the one worker that looks at it."""
    return {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")}


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    for path, module in modules().items():
        yield from ((f"{path} {one.name}", one) for one in ast.walk(module) if isinstance(one, ast.FunctionDef))


def size(function: ast.FunctionDef) -> int:
    """Lines without the docstring."""
    documentation = ast.get_docstring(function, clean=False)
    assert function.end_lineno is not None
    return function.end_lineno - function.lineno + 1 - (len(documentation.splitlines()) if documentation else 0)


def parameters(function: ast.FunctionDef) -> int:
    given = function.args
    return len([*given.posonlyargs, *given.args, *given.kwonlyargs])


def called(module: ast.Module, *names: str) -> Iterator[ast.Call]:
    for node in ast.walk(module):
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in names:
            yield node


def texts(node: ast.AST) -> Iterator[str]:
    return (one.value for one in ast.walk(node) if isinstance(one, ast.Constant) and isinstance(one.value, str))


def test_beside_the_rooms_there_is_next_to_nothing():
    assert len(list(PACKAGE.glob("*.py"))) <= 3
    assert all((PACKAGE / room / "__init__.pyi").exists() for room in ROOMS if room not in ("_common", "cli"))


def test_every_room_is_under_contract_without_exceptions():
    contracts = configparser.ConfigParser()
    contracts.read(ROOT / ".importlinter")
    assert sorted(contracts["importlinter:contract:rooms"]["layers"].split()) == ["__main__", *ROOMS]
    assert not any("ignore" in key for name in contracts.sections() for key in contracts[name])
    for room in ROOMS:
        if room not in ("_common", "cli"):
            assert contracts[f"importlinter:contract:{room}"]["protected_modules"] == f"cornercase.{room}.**"


def test_tests_have_a_folder_for_each_room():
    folders = {path.parent.name for path in (ROOT / "tests").glob("*/test_*.py")}
    assert folders == {room.lstrip("_") for room in ROOMS} | {"browser", "reliability"}


def test_no_two_modules_of_tests_are_named_alike():
    """Where folders are no packages, Python imports only one of them; which one depends on the worker."""
    paths = [one for one in (ROOT / "tests").rglob("*.py") if not (one.parent / "__init__.py").exists()]
    names = Counter(path.stem for path in paths if path.stem != "conftest")
    assert {name: count for name, count in names.items() if count > 1} == {}


def test_no_module_is_long():
    lengths = {path: len((PACKAGE / path).read_text("utf-8").splitlines()) for path in modules()}
    assert {path: lines for path, lines in lengths.items() if lines > LONGEST_MODULE} == {}


def test_no_module_is_named_after_nothing():
    vague = re.compile(r"manager|helper|util|misc|common\.py")
    assert [path for path in modules() if vague.search(path)] == []


def test_only_known_functions_are_large_and_each_of_them_is():
    large = {name for name, one in functions() if size(one) > LONGEST_FUNCTION or parameters(one) > MOST_PARAMETERS}
    assert sorted(large) == sorted(LARGE)


@pytest.mark.parametrize("room", [room for room in ROOMS if (PACKAGE / room / "__init__.pyi").exists()])
def test_nothing_public_has_the_name_of_its_module(room):
    """Else it would depend on what was imported before whether the name is the module."""
    shown = ast.parse((PACKAGE / room / "__init__.pyi").read_text("utf-8"))
    for node in shown.body:
        assert isinstance(node, ast.ImportFrom)
        for name in node.names:
            assert name.asname == name.name
            assert name.name != str(node.module).rpartition(".")[2]


def test_interfaces_have_defaults_and_are_not_asked_what_they_have():
    for path, module in modules().items():
        if not path.startswith(OF_OTHERS):
            for call in called(module, "getattr", "hasattr"):
                asks = ast.unparse(call.func) == "hasattr" or len(call.args) == 3
                # Python's own, such as __name__, is no part of an interface.
                names = [text for text in texts(call.args[1]) if not text.startswith("__")]
                assert not (asks and names), (path, ast.unparse(call))


def test_what_only_some_platforms_have_stands_in_one_module():
    names = re.compile(r"\bfcntl\b|\bmsvcrt\b|os\.(setsid|killpg|fork|getuid)\b|SIGKILL|SIGHUP")
    for path, module in modules().items():
        if path != PLATFORM:
            assert not names.search(ast.unparse(module)), path


def test_messages_name_parameters_and_not_options():
    for path, module in modules().items():
        if not path.startswith("cli/"):
            for call in called(module, "InputError", "SimulationError"):
                options = {option for text in texts(call) for option in re.findall(r"--[a-z][\w-]+", text)}
                assert options <= OPTIONS_OF_OTHERS, (path, ast.unparse(call))


def test_no_name_of_an_optimizer_or_simulator_is_asked_for_outside_its_room():
    for room, registry in (("optimizers", OPTIMIZERS), ("simulators", SIMULATORS)):
        known = set(registry.names())
        for path, module in modules().items():
            if not path.startswith(f"{room}/"):
                for node in ast.walk(module):
                    if isinstance(node, ast.Compare):
                        assert not set(texts(node)) & known, (path, ast.unparse(node))


def test_told_is_what_an_optimizer_was_told_and_a_metric_has_a_most_critical_value():
    """Scores that a search sees are oriented, and the ends of a course are the cap and the most critical value."""
    for path, module in modules().items():
        names = {node.id for node in ast.walk(module) if isinstance(node, ast.Name)}
        names |= {node.attr for node in ast.walk(module) if isinstance(node, ast.Attribute)}
        assert path.startswith("optimizers/") or not {"told", "_told"} & names, path
        assert not path.startswith("metrics/") or "limit" not in names, path
