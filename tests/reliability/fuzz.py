"""Try mutants of files of all formats, and of command lines, on the commands that take them.

    python tests/reliability/fuzz.py --count 1000 --seed 7 [--only NAME] [--kept FOLDER]
    python tests/reliability/fuzz.py --corpus tests/reliability/corpus

Each mutant is a function of the seed and its number. Commands run in this process's children, of which each tries some
hundred mutants; one that takes more than 10 s of CPU or 1 GB of memory ends its child, and counts as a failure.
"""

# ruff: noqa: E402
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
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import typer.main
from fuzz_judging import files_in, trouble_of
from fuzz_targets import all_targets

import cornercase.cli

# typer makes the commands anew for each call, which takes longer than most mutants.
_commands: Any = typer.main.get_command(cornercase.cli.app)
cornercase.cli.app = _commands

CPU, MEMORY = 10.0, 1_000_000_000
# s of waiting, for whatever else than work holds a command up.
_WALL = 120
_PER_CHILD = 500


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

    def known(self, file: Path):
        """Try a file that failed once: in place of the one that its target changes, or as a command line."""
        target = self.targets[file.parent.name]
        words = target.all_commands()[0] if target.changed else shlex.split(file.read_text("utf-8"))

        def change(folder: Path) -> None:
            if target.changed:
                shutil.copyfile(file, folder / target.changed)

        trouble, ended = self.tried(target.name, words, change)
        return f"{target.name}/{file.name}", words, trouble, ended


def limited() -> None:
    """Let this process have 1 GB more than it has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def attempts(tried: Tried, seed: int, corpus: Path | None):
    """Give what tries the mutant of a number, at random or of a corpus."""
    if corpus is None:
        return lambda number: tried.mutant(seed, number)
    files = sorted(one for one in corpus.rglob("*") if one.is_file())
    return lambda number: tried.known(files[number])


def child(attempt, numbers: range, out: int) -> None:
    """Try mutants and write a line for each; ended by a signal where one takes too long."""
    limited()
    with os.fdopen(out, "w", buffering=1) as file:
        for number in numbers:
            signal.setitimer(signal.ITIMER_PROF, CPU)
            signal.setitimer(signal.ITIMER_REAL, _WALL)
            begun = time.process_time()
            name, words, trouble, (code, _, told) = attempt(number)
            row = {
                "number": number, "target": name, "cpu": time.process_time() - begun, "code": str(code), "trouble": trouble,
                "command": shlex.join(words) if trouble else words[0], "told": told[-3000:] if trouble else "",
            }  # fmt: skip
            file.write(json.dumps(row) + "\n")


def rows_of(tried: Tried, attempt, first: int, count: int):
    """Try mutants in children, one after the other; give a row for each."""
    number, end = first, first + count
    while number < end:
        reader, writer = os.pipe()
        numbers = range(number, min(end, number + _PER_CHILD))
        process = os.fork()
        if process == 0:
            os.close(reader)
            try:
                child(attempt, numbers, writer)
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
            why: dict[int, str] = {
                signal.SIGPROF: f"more than {CPU:g} s of CPU",
                signal.SIGALRM: f"more than {_WALL} s",
            }
            text = why.get(ended, f"the process ended ({ended})")
            yield {
                "number": number, "target": "?", "cpu": CPU, "code": "-", "trouble": [text], "command": "?", "told": "",
            }  # fmt: skip
            number += 1


def fuzz(given: argparse.Namespace) -> dict[str, Any]:
    """Try so many mutants; give what failed, and how much was tried."""
    begun = time.monotonic()
    place = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
    failed: list[dict[str, Any]] = []
    codes: Counter[str] = Counter()
    commands: Counter[str] = Counter()
    spent: Counter[str] = Counter()
    cpu = most = 0.0
    with tempfile.TemporaryDirectory(dir=place, prefix="cornercase-fuzz-") as name:
        tried = Tried(Path(name), given.only)
        if not given.cold:
            tried.warm_up()
        print(f"warm after {time.monotonic() - begun:.1f} s, {time.process_time():.1f} s of CPU", flush=True)
        count = given.count
        if given.corpus is not None:
            count = sum(one.is_file() for one in given.corpus.rglob("*"))
        for row in rows_of(
            tried, attempts(tried, given.seed, given.corpus and given.corpus.resolve()), given.first, count
        ):
            command = row["command"].split()[0]
            codes[row["code"]] += 1
            commands[command] += 1
            spent[row["target"]] += row["cpu"]
            spent[command] += row["cpu"]
            cpu, most = cpu + row["cpu"], max(most, row["cpu"])
            if row["trouble"]:
                failed.append(row)
                print(
                    f"{row['number']} {row['target']} {row['cpu']:.2f} s {row['trouble']} {row['command'][:300]}\n"
                    f"    {row['told'][-600:]}",
                    flush=True,
                )
                if given.kept is not None and given.corpus is None:
                    _keep(tried, given.seed, row, given.kept.resolve() / f"{row['number']}")
            if codes.total() % 1000 == 0:
                print(f"{codes.total()} tried, {len(failed)} failed, {cpu:.0f} s of CPU", flush=True)
    print({name: round(one, 2) for name, one in spent.most_common(30)})
    return {
        "seed": given.seed, "mutants": codes.total(), "failed": failed, "exit codes": dict(codes),
        "commands": dict(commands), "cpu": cpu, "longest": most,
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
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--only", default="", help="regular expression on the names of targets")
    parser.add_argument("--kept", type=Path, help="folder for the files of failures")
    parser.add_argument("--corpus", type=Path, help="try the files in this folder instead")
    parser.add_argument("--cold", action="store_true", help="import and compile only what the first mutants need")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    found = fuzz(arguments)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(found, indent=1))
    print({key: value for key, value in found.items() if key != "failed"}, len(found["failed"]), "failed")
    sys.exit(bool(found["failed"]))
