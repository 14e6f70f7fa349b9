"""Commands whose orders to the system fail, one after the other: opening, writing, renaming, syncing, making folders.

``faults.c`` is loaded before the C library, so that SQLite's orders count too. This program makes a folder with studies
of a few scenarios, runs each command in it once undisturbed, and then once for each order that fails, each time in a
forked process and a fresh copy of the folder. It prints what it counted and what went wrong, as JSON.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import hashlib
import io
import json
import os
import random
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from contextlib import closing, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

EXAMPLE: Final = Path(__file__).parents[2] / "examples" / "t_intersection"
_SEARCH: Final = (
    "explore", "t_intersection.xosc", "--space", "t_intersection.space.xosc", "--ego", "Ego", "--other", "C",
    "--metric", "wttc", "--optimizer", "sobol", "--batch", "3", "--duration", "12",
)  # fmt: skip
_CONCRETE: Final = ("t_intersection.xosc", "--set", "c_start_time=1")
COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "simulate": ("simulate", *_CONCRETE, "--duration", "2", "-o", "new/run.csv"),
    "vary": ("vary", "t_intersection.xosc", "--all", "-o", "new/varied.xosc"),
    "convert": ("convert", *_CONCRETE, "--ego", "Ego", "-o", "new/t10.xosc"),
    "measure": ("measure", "runs/00001.csv", "--ego", "Ego", "--other", "C", "--metric", "wttc", "-o", "courses.csv"),
    "explore": (*_SEARCH, "--budget", "6", "-o", "new.db"),
    "continue": (*_SEARCH, "--budget", "9", "-o", "study.db"),
    "analyze": ("analyze", "study.db", "--by", "wttc", "--by", "ego-trajectory"),
    "reduce": ("reduce", "analyzed.db", "--size", "2", "-o", "set"),
    "reduce-new": ("reduce", "analyzed.db", "--size", "3", "-o", "new/set"),
    "report": ("report", "analyzed.db", "-o", "report.html"),
    "export": ("export", "study.db", "-o", "tables"),
    "import": ("import", "runs", "--ego", "Ego", "--other", "C", "--metric", "wttc", "-o", "imported.db"),
    "test": (
        "test",
        "set",
        "--require",
        "no collision",
        "--against",
        "analyzed.db",
        "--junit",
        "junit.xml",
        "-o",
        "run.db",
    ),
    "replay": ("replay", "study.db", "1", "-o", "replay.html"),
}
_ON_FILES_ALONE: Final = {"simulate", "vary", "convert", "explore"}
ERRORS: Final = {"EIO": errno.EIO, "ENOSPC": errno.ENOSPC, "EACCES": errno.EACCES, "full": 0}
_LONGEST: Final = 60.0
# What SQLite and the lock of a study keep beside it, while it is open or after a process was ended.
_BESIDE: Final = ("-wal", "-shm", ".lock")


@dataclass
class Ended:
    """How a command ended, and the order that failed."""

    code: int
    said: str
    given: int = 0
    failed: str = ""


@dataclass
class Counted:
    """What was tried, and what of it is not as it has to be."""

    tried: Counter[str] = field(default_factory=Counter)
    orders: dict[str, int] = field(default_factory=dict)
    wrong: list[dict[str, Any]] = field(default_factory=list)


def ran(command: Sequence[str], folder: Path) -> tuple[int, str]:
    """Run a command in this process."""
    from cornercase.cli import main

    said = io.StringIO()
    sys.argv = ["cornercase", *command]
    os.chdir(folder)
    code: Any = 0
    with redirect_stderr(said), redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as ending:
            code = ending.code or 0
        except BaseException:
            code = -1
            said.write(traceback.format_exc())
    return int(code), said.getvalue()


def in_child(shim: ctypes.CDLL, command: Sequence[str], folder: Path, turn: int, error: str) -> Ended:
    """Run a command in a forked process in which one order fails."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.close(reader)
        ended = Ended(-2, "")
        try:
            shim.faults_arm(os.fsencode(folder), turn, ERRORS[error], int(error == "full"))
            code, said = ran(command, folder)
            given, failed = int(shim.faults_given()), shim.faults_last().decode()
            shim.faults_arm(b"", 0, 0, 0)
            ended = Ended(code, said, given, failed)
        finally:
            os.write(writer, json.dumps([ended.code, ended.said[-5000:], ended.given, ended.failed]).encode())
            os._exit(0)
    os.close(writer)
    signal.setitimer(signal.ITIMER_REAL, _LONGEST)
    try:
        with open(reader, "rb") as file:
            told = file.read()
        os.waitpid(child, 0)
    except TimeoutError:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return Ended(-3, f"did not end within {_LONGEST:g} s")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return Ended(*json.loads(told)) if told else Ended(-4, "the process ended by itself")


def content(folder: Path) -> dict[str, str]:
    """Digest of each file of a folder; of a study that of its tables, but for the times that stages took."""
    found = {}
    for one in sorted(folder.rglob("*")):
        name = one.relative_to(folder).as_posix()
        if one.is_file() and not name.endswith(_BESIDE):
            found[name] = _tables(one) if name.endswith(".db") else hashlib.sha256(one.read_bytes()).hexdigest()
    return found


def _tables(file: Path) -> str:
    with tempfile.TemporaryDirectory() as folder:
        for one in (file, *(file.with_name(file.name + ending) for ending in _BESIDE[:1])):
            if one.exists():
                shutil.copy(one, folder)
        with closing(sqlite3.connect(Path(folder) / file.name)) as connection:
            if connection.execute("PRAGMA integrity_check").fetchone() != ("ok",):
                return "damaged"
            names = [one for (one,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
            rows = [
                (name, sorted(map(repr, connection.execute(f"SELECT * FROM {name}").fetchall())))
                for name in sorted(names)
                # A lease that could not be taken out is one of a process that has ended, which holds nothing.
                if name not in ("elapsed", "lease")
            ]
    return hashlib.sha256(repr(rows).encode()).hexdigest()


def prepare(folder: Path, chosen: Sequence[str]) -> None:
    """Make what the commands are run on."""
    folder.mkdir(parents=True)
    for one in EXAMPLE.iterdir():
        if one.is_file():
            shutil.copy(one, folder)
    if set(chosen) <= _ON_FILES_ALONE:
        return
    for command in (
        (*_SEARCH, "--budget", "6", "-o", "study.db"),
        (*_SEARCH, "--budget", "6", "-o", "analyzed.db"),
        COMMANDS["export"],
        ("analyze", "analyzed.db", "--by", "wttc", "--by", "ego-trajectory"),
        ("reduce", "analyzed.db", "--size", "4", "-o", "set"),
    ):
        code, said = ran(command, folder)
        assert not code, (command, said)
    runs = folder / "runs"
    shutil.move(folder / "tables" / "recordings", runs)
    shutil.rmtree(folder / "tables")
    lines = [f"{one.name},{k}" for k, one in enumerate(sorted(runs.iterdir()))]
    (runs / "parameters.csv").write_text("\n".join(["file,p", *lines]) + "\n")
    for one in folder.glob("*.lock"):
        one.unlink()


def judge(command: str, ended: Ended, before: dict[str, str], after: dict[str, str], work: Path) -> list[str]:
    """Say what is not as it has to be after an order has failed."""
    from cornercase.reduction._reduced_set_folder import complete_replacement

    wrong = []
    if ended.code not in (0, 1, 2):
        wrong.append(f"ended with {ended.code}")
    if "Traceback" in ended.said or "please report" in ended.said:
        wrong.append("a traceback")
    if ended.code and not ended.said.strip():
        wrong.append("nothing said")
    now = content(work)
    if command.startswith("reduce"):
        for place in ("set", "new/set"):
            if (work / place).is_dir():
                complete_replacement(work / place)
        kept = {one for one in content(work) if one.startswith(("set/", "new/"))}
        now = content(work)
        ours = {name: now[name] for name in kept if "/.cornercase-" not in name}
        if ours not in (
            {name: one[name] for name in one if name.startswith(("set/", "new/"))} for one in (before, after)
        ):
            wrong.append(f"half a set: {sorted(ours)}")
    for name, digest in now.items():
        hidden = any(part.startswith(".") for part in Path(name).parts)
        if name not in before and name not in after:
            # What could not be removed is removed by the next command. Where SQLite could not take back a transaction on a
            # full disk, who opens the study next does.
            rolls_back = name.endswith("-journal") and name.removesuffix("-journal") in now
            if not (rolls_back or (hidden and ended.failed == "unlink")):
                wrong.append(f"left behind: {name}")
        elif digest == "damaged":
            wrong.append(f"damaged: {name}")
        elif not name.endswith(".db") and digest not in (before.get(name), after.get(name)):
            wrong.append(f"half written: {name}")
    if ended.code == 0 and now != after:
        wrong.append(f"success, but {sorted(name for name in now | after if now.get(name) != after.get(name))} differ")
    return wrong


def torture(
    shim: ctypes.CDLL, place: Path, chosen: Sequence[str], errors: Sequence[str], sample: int, seed: int
) -> Counted:
    """Let each order of each command fail, or so many of each command that are drawn."""
    counted = Counted()
    template, work = place / "template", place / "work"
    prepare(template, chosen)
    draw = random.Random(seed)
    for name in chosen:
        command = COMMANDS[name]
        begin_again(template, work)
        before = content(work)
        # In this process first, so that what it imports and compiles is there in all that are forked.
        code, said = ran(command, work)
        assert code in (0, 1), (command, code, said)
        begin_again(template, work)
        undisturbed = in_child(shim, command, work, 0, "EIO")
        after = content(work)
        counted.orders[name] = undisturbed.given
        turns = [(turn, error) for turn in range(1, undisturbed.given + 1) for error in errors]
        for turn, error in sorted(draw.sample(turns, min(sample, len(turns))) if sample else turns):
            begin_again(template, work)
            ended = in_child(shim, command, work, turn, error)
            counted.tried[name] += 1
            wrong = judge(name, ended, before, after, work)
            again = in_child(shim, command, work, 0, error)
            if again.code != undisturbed.code:
                wrong.append(f"then it ended with {again.code}: {again.said[-300:]}")
            elif (now := content(work)) != after:
                differ = sorted(one for one in now | after if now.get(one) != after.get(one))
                wrong.append(f"then {differ} differ")
            if wrong:
                counted.wrong.append(
                    {"command": name, "turn": turn, "error": error, "order": ended.failed, "wrong": wrong,
                     "said": ended.said[-1500:]}
                )  # fmt: skip
                print(counted.wrong[-1], file=sys.stderr, flush=True)
        print(f"{name}: {counted.tried[name]} tried of {undisturbed.given} orders", file=sys.stderr, flush=True)
    return counted


def begin_again(template: Path, work: Path) -> None:
    os.chdir(template)
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(template, work)


def _main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("shim")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--commands", default=",".join(COMMANDS))
    parser.add_argument("--errors", default="EIO,full")
    parser.add_argument("--sample", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    shim = ctypes.CDLL(given.shim)
    shim.faults_last.restype = ctypes.c_char_p
    shim.faults_given.restype = ctypes.c_long
    shim.faults_arm.argtypes = [ctypes.c_char_p, ctypes.c_long, ctypes.c_int, ctypes.c_int]

    def late(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, late)
    begun = time.process_time()
    place = given.folder.resolve()
    counted = torture(shim, place, given.commands.split(","), given.errors.split(","), given.sample, given.seed)
    json.dump(
        {
            "tried": counted.tried,
            "orders": counted.orders,
            "wrong": counted.wrong,
            "seconds": time.process_time() - begun + sum(os.times()[2:4]),
        },
        sys.stdout,
    )


if __name__ == "__main__":
    _main()
