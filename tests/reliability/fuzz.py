"""Try mutants of files of all formats, and of command lines, on the commands that take them.

    python tests/reliability/fuzz.py --count 1000 --seed 7 [--only NAME] [--kept FOLDER]

Each mutant is a function of the seed and its number. Commands run in this process's children, of which each tries some
hundred mutants; one that takes more than 10 s of CPU or 1 GB of memory ends its child, and counts as a failure.
"""

from __future__ import annotations

import os

# Before numpy is imported: a process with threads cannot be forked well.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import contextlib
import io
import json
import random
import re
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzz_targets import Target, all_targets

import typer.main

import cornercase.cli

# typer makes the commands anew for each call, which takes longer than most mutants.
cornercase.cli.app = typer.main.get_command(cornercase.cli.app)

CPU, MEMORY = 10.0, 1_000_000_000
# s of waiting, for whatever else than work holds a command up.
_WALL = 120
_PER_CHILD = 200
_ORDERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
# Beside a study.
_BESIDE = (".lock", "-wal", "-shm")
_LONGEST = 1500


def run(words: list[str]) -> tuple[object, str, str]:
    """Exit code, output and errors of a command that runs here."""
    said, told, before, shown = io.StringIO(), io.StringIO(), sys.argv, warnings.showwarning
    sys.argv = ["cornercase", *words]
    code: object = 0
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
            cornercase.cli.main()
    except SystemExit as ended:
        code = ended.code or 0
    except BaseException as error:
        code = f"{type(error).__name__}: {error}"
    finally:
        sys.argv, warnings.showwarning = before, shown
    return code, said.getvalue(), told.getvalue()


def files_in(folder: Path) -> set[str]:
    return {str(one.relative_to(folder)) for one in folder.rglob("*") if one.is_file()}


def trouble_of(code: object, said: str, told: str, before: set[str], after: set[str]) -> list[str]:
    """What must not be, of how a command ended."""
    found = []
    if code not in (0, 1, 2):
        found.append(f"exit code {code}")
    lines = [one for one in told.splitlines() if one.startswith("cornercase: ")]
    for word in ("please report", "Traceback", "MemoryError", "needs more memory than there is"):
        if word in told:
            found.append(word)
    if re.search(r"\w+Warning: ", told):
        found.append("a warning of a library")
    usage = told.startswith("Usage: ")
    if len(lines) > 1 or (code == 2 and not lines and not usage):
        found.append(f"{len(lines)} sentences")
    if not usage and any(len(one) > _LONGEST for one in lines):
        found.append("a long sentence")
    if _ORDERS.search(said) or _ORDERS.search(told):
        found.append("orders to the terminal")
    new = {one for one in after - before if not one.endswith(_BESIDE)}
    if any(Path(one).name.startswith(".") for one in new):
        found.append("a temporary file left behind")
    if code == 2 and new:
        found.append("a file of a command that failed")
    if before - after:
        found.append("a file that is gone")
    return found


class Tried:
    """Targets with their files, ready to be copied."""

    def __init__(self, folder: Path, only: str = "") -> None:
        self.folder = folder
        self.targets = {name: one for name, one in all_targets(folder / "made").items() if re.search(only, name)}
        for name, one in self.targets.items():
            (folder / name).mkdir()
            one.make(folder / name)

    def warm_up(self) -> None:
        """Run what is meant to work, once each; code that is compiled when it is first used is then there."""
        for name, one in self.targets.items():
            for words in one.all_commands():
                code, said, told = self.tried(name, words)[1]
                if code not in (0, 1):
                    print(f"{name}: {shlex.join(words)} ends with {code}: {told or said}")

    def tried(self, name: str, words: list[str], change=lambda folder: None):
        """Run a command on fresh copies; give what must not be, and how it ended."""
        work = self.folder / f"work-{os.getpid()}"
        shutil.copytree(self.folder / name, work, copy_function=shutil.copyfile)
        home = os.getcwd()
        try:
            os.chdir(work)
            change(work)
            before = files_in(work)
            ended = run(words)
            after = files_in(work)
        finally:
            os.chdir(home)
            shutil.rmtree(work)
        return trouble_of(*ended, before, after), ended

    def mutant(self, seed: int, number: int, kept: Path | None = None):
        """Try one; a failure is kept."""
        rng = random.Random(f"{seed}/{number}")
        names = list(self.targets)
        name = rng.choices(names, [self.targets[one].weight for one in names])[0]
        words: list[str] = []

        def change(folder: Path) -> None:
            words.extend(self.targets[name].mutant(folder, rng))
            if kept is not None:
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(folder, kept)
                (kept / "command").write_text(shlex.join(words), errors="replace")

        trouble, ended = self.tried(name, words, change)
        return name, words, trouble, ended


def limited() -> None:
    """Let this process have 1 GB more than it has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def child(tried: Tried, seed: int, numbers: range, out: int) -> None:
    """Try mutants and write a line for each; ended by a signal where one takes too long."""
    limited()
    with os.fdopen(out, "w", buffering=1) as file:
        for number in numbers:
            signal.setitimer(signal.ITIMER_PROF, CPU)
            signal.setitimer(signal.ITIMER_REAL, _WALL)
            begun = time.process_time()
            name, words, trouble, (code, _, told) = tried.mutant(seed, number)
            row = {
                "number": number, "target": name, "cpu": time.process_time() - begun, "code": str(code), "trouble": trouble,
                "command": shlex.join(words) if trouble else words[0], "told": told[-3000:] if trouble else "",
            }  # fmt: skip
            file.write(json.dumps(row) + "\n")


def rows_of(tried: Tried, seed: int, first: int, count: int):
    """Try mutants in children, one after the other; give a row for each."""
    number, end = first, first + count
    while number < end:
        reader, writer = os.pipe()
        numbers = range(number, min(end, number + _PER_CHILD))
        process = os.fork()
        if process == 0:
            os.close(reader)
            try:
                child(tried, seed, numbers, writer)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(0)
        os.close(writer)
        with os.fdopen(reader) as file:
            for line in file:
                row = json.loads(line)
                number = row["number"] + 1
                yield row
        _, status = os.waitpid(process, 0)
        if number < numbers.stop:
            shutil.rmtree(tried.folder / f"work-{process}", ignore_errors=True)
            ended = os.WTERMSIG(status) if os.WIFSIGNALED(status) else -1
            why = {signal.SIGPROF: f"more than {CPU:g} s of CPU", signal.SIGALRM: f"more than {_WALL} s"}
            text = why.get(ended, f"the process ended ({ended})")
            yield {"number": number, "target": "?", "cpu": CPU, "code": "-", "trouble": [text], "command": "?", "told": ""}
            number += 1


def fuzz(seed: int, count: int, *, first: int = 0, only: str = "", kept: Path | None = None, say=print) -> dict[str, object]:
    """Try so many mutants; give what failed, and how much was tried."""
    begun = time.monotonic()
    place = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
    failed, codes, commands, spent, cpu, most = [], Counter(), Counter(), Counter(), 0.0, 0.0
    with tempfile.TemporaryDirectory(dir=place, prefix="cornercase-fuzz-") as name:
        tried = Tried(Path(name), only)
        tried.warm_up()
        say(f"warm after {time.monotonic() - begun:.1f} s, {time.process_time():.1f} s of CPU", flush=True)
        for row in rows_of(tried, seed, first, count):
            codes[row["code"]] += 1
            commands[row["command"].split()[0]] += 1
            cpu, most = cpu + row["cpu"], max(most, row["cpu"])
            if row["trouble"]:
                failed.append(row)
                say(f"{row['number']} {row['target']} {row['cpu']:.2f}s {row['trouble']} {row['command'][:300]}\n    {row['told'][-600:]}", flush=True)
                if kept is not None:
                    _keep(tried, seed, row, kept / f"{row['number']}")
            if sum(codes.values()) % 5000 == 0:
                say(f"{sum(codes.values())} tried, {len(failed)} failed, {cpu:.0f} s of CPU", flush=True)
            spent[row["target"]] += row["cpu"]
            spent[row["command"].split()[0]] += row["cpu"]
    say({name: round(one, 2) for name, one in spent.most_common(30)})
    return {
        "seed": seed, "mutants": sum(codes.values()), "failed": failed, "exit codes": dict(codes), "commands": dict(commands),
        "cpu": cpu, "longest": most,
    }  # fmt: skip


def _keep(tried: Tried, seed: int, row, folder: Path) -> None:
    """Write what a mutant reads into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    process = os.fork()
    if process == 0:
        # What is made is kept before the command runs, which may not end.
        signal.setitimer(signal.ITIMER_PROF, 0.5)
        with contextlib.suppress(BaseException):
            tried.mutant(seed, row["number"], folder / "files")
        os._exit(0)
    os.waitpid(process, 0)
    shutil.rmtree(tried.folder / f"work-{process}", ignore_errors=True)
    (folder / "row.json").write_text(json.dumps(row, indent=1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="", help="regular expression on the names of targets")
    parser.add_argument("--kept", type=Path, help="folder for the files of failures")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parser.parse_args()
    found = fuzz(given.seed, given.count, first=given.first, only=given.only, kept=given.kept and given.kept.resolve())
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))
    print({key: value for key, value in found.items() if key != "failed"}, len(found["failed"]), "failed")
    sys.exit(bool(found["failed"]))
