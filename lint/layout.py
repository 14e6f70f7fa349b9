"""Where things stand: private modules, sizes, and what only one module may do."""

from __future__ import annotations

import ast
import configparser
import re
from collections import defaultdict
from collections.abc import Iterator

from cornercase.optimizers import OPTIMIZERS
from cornercase.simulators import SIMULATORS
from lint.source import PACKAGE, ROOMS, ROOT, WITHOUT_STUB, Function, complain, functions, modules

LONGEST_MODULE, LONGEST_FUNCTION, MOST_PARAMETERS = 800, 80, 12
# Modules, and functions with many lines or parameters, that are larger, and why.
LONG_MODULES = {
    "api/_study.py": "the verbs of the public API, most of it their docstrings",
    "study/_study_file.py": "everything that is read of a study, most of it docstrings of public methods",
}
_OPTIONS = "one parameter for each option of the command"
_API = "part of the API: one parameter for each option of the command"
_VERB = "a verb of the API: up to twelve parameters besides the object"
_COMPILED = "compiled: machine code takes numbers and arrays, no objects"
_SIMULATOR = "one parameter for each option of the simulator"
LARGE_FUNCTIONS = {
    "cli/report.py report": _OPTIONS,
    "cli/study.py analyze": _OPTIONS,
    "cli/study.py reduce": _OPTIONS,
    "cli/test.py test_suite": _OPTIONS,
    "api/_study.py cluster": _VERB,
    "api/_study.py reduce": _VERB,
    "api/_suite.py run": _VERB,
    "clustering/_analyze.py analyze": _API,
    "drivers/_kernels/ego_view.py look": _COMPILED,
    "dtw/_cpu.py _advance_four_rows": _COMPILED,
    "drivers/sensors/_object_sensor.py __init__": "one parameter for each option of the sensor",
    "dtw/_cpu.py _advance_one_row": _COMPILED,
    "reduction/_reduce.py reduce": _API,
    "roads/_lane_path.py from_points": "one parameter for each array of the path",
    "simulators/carla/_simulator.py __init__": _SIMULATOR,
    "simulators/carmaker/_simulator.py __init__": _SIMULATOR,
}
# Modules that other programs start by their names.
PUBLIC_MODULES = (
    "drivers/process/cornercase_client.py",
    "simulators/carla/cornercase_agent.py",
    "simulators/carla/cornercase_driver.py",
    "simulators/carla/cornercase_example_agent.py",
    "simulators/carla/cornercase_launcher.py",
    "simulators/carla/cornercase_recorder.py",
    "simulators/carla/cornercase_trajectory.py",
)
# Names that several modules or classes have, and why.
SHARED_STEMS: dict[str, str] = {"study": "cli has the commands, api the object"}
SHARED_CLASSES: dict[str, str] = {
    "Trajectory": "a system under test plans one, a storyboard prescribes one",
    "Batch": "scenarios that the builtin simulator runs together, and what a program is told about them",
    "Control": "a program in another Python has its own, without importing cornercase",
    "View": "a program in another Python has its own, without importing cornercase",
    "Comparison": "suite compares studies, api writes the page too; a formula compares numbers",
}

# Objects of other packages, whose versions differ in what they have; and drivers, which need no base class.
PLATFORM = "_common/platform.py"
OF_OTHERS = ("recordings/formats/", PLATFORM, "drivers/_base.py", "drivers/_resolve.py")
OPTIONS_OF_OTHERS = {"--csv_logger"}


def check() -> Iterator[str]:
    """List what stands in the wrong place or has the wrong size."""
    yield from public_modules()
    yield from shared_names()
    yield from vague_names()
    yield from sizes()
    yield from rooms()
    yield from imports()
    yield from platform_calls()
    yield from interface_queries()
    yield from options_in_messages()
    yield from names_of_plugins()
    yield from test_folders()


def public_modules() -> Iterator[str]:
    for path in modules():
        *folders, file = path.split("/")
        private = file.startswith("_") or any(folder.startswith("_") for folder in folders)
        if folders and folders[0] != "cli" and not private and path not in PUBLIC_MODULES:
            yield complain(path, 1, "modules of rooms begin with an underscore, packages do not")


def shared_names() -> Iterator[str]:
    stems, classes = defaultdict(list), defaultdict(list)
    for path, module in modules().items():
        stem = path.rpartition("/")[2].removesuffix(".py").strip("_")
        if stem not in ("init", "main"):
            stems[stem].append((path, 1))
        for node in module.body:
            if isinstance(node, ast.ClassDef):
                classes[node.name].append((path, node.lineno))
    for names, reasons, what in ((stems, SHARED_STEMS, "module"), (classes, SHARED_CLASSES, "class")):
        for name, places in names.items():
            if len(places) > 1 and name not in reasons:
                others = ", ".join(path for path, _ in places[1:])
                yield complain(*places[0], f"{what} {name} is in {others}, too: rename one, or say why it is shared")
        for name in reasons:
            if len(names[name]) < 2:
                yield f"lint/layout.py:1: {what} {name} is not shared any more"


def vague_names() -> Iterator[str]:
    vague = re.compile(r"manager|helper|util|misc|common\.py")
    yield from (complain(path, 1, "is named after nothing") for path in modules() if vague.search(path))


def sizes() -> Iterator[str]:
    for path in modules():
        lines = len((PACKAGE / path).read_text("utf-8").splitlines())
        if (lines > LONGEST_MODULE) != (path in LONG_MODULES):
            yield complain(path, 1, f"{lines} lines: is it one idea? If so, LONG_MODULES says why")
    large = {f"{path} {node.name}": node for path, node in functions() if _is_large(node)}
    for name, node in large.items():
        if name not in LARGE_FUNCTIONS:
            yield complain(name.partition(" ")[0], node, f"{node.name} is large: split it, or LARGE_FUNCTIONS says why")
    yield from (f"lint/layout.py:1: {name} is not large any more" for name in LARGE_FUNCTIONS if name not in large)


def _is_large(node: Function) -> bool:
    documentation = ast.get_docstring(node, clean=False)
    lines = (node.end_lineno or 0) - node.lineno + 1 - (len(documentation.splitlines()) if documentation else 0)
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return lines > LONGEST_FUNCTION or len(arguments) > MOST_PARAMETERS


def rooms() -> Iterator[str]:
    if len(list(PACKAGE.glob("*.py"))) > 3:
        yield complain("__init__.py", 1, "there is a module beside the rooms")
    for room in ROOMS:
        if room not in WITHOUT_STUB and not (PACKAGE / room / "__init__.pyi").exists():
            yield complain(f"{room}/__init__.py", 1, "the room has no stub")
    contracts = configparser.ConfigParser()
    contracts.read(ROOT / ".importlinter")
    if sorted(contracts["importlinter:contract:rooms"]["layers"].split()) != ["__main__", *ROOMS]:
        yield ".importlinter:1: its layers are not the rooms"
    if any("ignore" in key for name in contracts.sections() for key in contracts[name]):
        yield ".importlinter:1: a contract has exceptions"


def imports() -> Iterator[str]:
    """Rooms see of each other what a package shows and what a module of the room itself has, but no sub-packages."""
    for path, module in modules().items():
        room = path.partition("/")[0]
        for node in ast.walk(module):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("cornercase."):
                continue
            other, *deeper = str(node.module).split(".")[1:]
            if other in (room, "_common"):
                continue
            if len(deeper) > 1 or (deeper and (PACKAGE / other / deeper[0]).is_dir()):
                yield complain(path, node, f"{node.module} is a matter of {other}: import it from a module of the room")
            for alias in node.names:
                if alias.name.startswith("_") and not (PACKAGE / other / f"{alias.name}.py").exists():
                    yield complain(path, node, f"{alias.name} is private to {node.module}")


def _calls(module: ast.Module, *names: str) -> Iterator[ast.Call]:
    for node in ast.walk(module):
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in names:
            yield node


def _texts(node: ast.AST) -> Iterator[str]:
    return (text.value for text in ast.walk(node) if isinstance(text, ast.Constant) and isinstance(text.value, str))


def platform_calls() -> Iterator[str]:
    names = re.compile(
        r"\b(fcntl|msvcrt|setsid|killpg|umask|sched_getaffinity|getppid|SIGKILL|SIGHUP)\b"
        r"|\bos\.(fork|getuid|name)\b|\bsys\.platform\b"
    )
    for path, module in modules().items():
        # Programs in another Python cannot import it.
        if path not in (PLATFORM, *PUBLIC_MODULES) and names.search(ast.unparse(module)):
            yield complain(path, 1, f"what only some platforms have belongs into {PLATFORM}")


def interface_queries() -> Iterator[str]:
    """Interfaces have defaults, so nobody has to ask an object what it has."""
    for path, module in modules().items():
        if path.startswith(OF_OTHERS):
            continue
        for call in _calls(module, "getattr", "hasattr"):
            queries = ast.unparse(call.func) == "hasattr" or len(call.args) == 3
            # Python's own, such as __name__, is no part of an interface.
            if queries and any(not text.startswith("__") for text in _texts(call.args[1])):
                yield complain(path, call, f"give the interface a default instead: {ast.unparse(call)}")


def options_in_messages() -> Iterator[str]:
    for path, module in modules().items():
        if not path.startswith("cli/"):
            for call in _calls(module, "InputError", "SimulationError"):
                options = {option for text in _texts(call) for option in re.findall(r"--[a-z][\w-]+", text)}
                if options - OPTIONS_OF_OTHERS:
                    yield complain(path, call, "messages name parameters; the command line makes options of them")


def names_of_plugins() -> Iterator[str]:
    for room, registry in (("optimizers", OPTIMIZERS), ("simulators", SIMULATORS)):
        # Many options of other rooms may be "auto".
        known = {*registry.names()} - {"auto"}
        for path, module in modules().items():
            if not path.startswith(f"{room}/"):
                for node in ast.walk(module):
                    if isinstance(node, ast.Compare) and set(_texts(node)) & known:
                        yield complain(path, node, f"asks for one of the {room} by its name: {ast.unparse(node)}")


def test_folders() -> Iterator[str]:
    """Tests have a folder for each room, and modules that can be told apart."""
    tests = ROOT / "tests"
    folders = {path.parent.name for path in tests.glob("*/test_*.py")}
    expected = {room.lstrip("_") for room in ROOMS} | {"browser", "documentation", "integration", "reliability"}
    yield from (f"tests/{name}:1: no room, or a room without tests" for name in sorted(folders ^ expected))
    yield from (f"tests/{path.name}:1: belongs into a folder" for path in tests.glob("test_*.py"))
    # If folders are no packages, Python imports only one of two modules with the same name.
    stems = defaultdict(list)
    for path in tests.rglob("*.py"):
        if not (path.parent / "__init__.py").exists() and path.stem != "conftest":
            stems[path.stem].append(path)
    for paths in stems.values():
        yield from (f"{path.relative_to(ROOT)}:1: another test module has this name" for path in paths[1:])
