"""The paper's statements beside what was measured, for several reconstructions of its scenarios and several seeds.

python benchmarks/paper.py [--quick] [--seeds N] [--keep FOLDER] [--page FILE] [--json FILE]
python benchmarks/paper.py --family [--seeds N] [--statement NUMBER] [--keep FOLDER] [--page FILE] [--json FILE]
python benchmarks/paper.py --experiment NAME [--seeds N] [--keep FOLDER]

Schütt, Otten and Sax (2023), section "Discussion": scenario 1 is the X-intersection with 400 concrete scenarios,
scenario 2 the T-intersection with 300, each with a cautious, a normal and an aggressive ego. Searched by Thompson
sampling without filling, as in the paper.

The first command asks of the default reconstructions what the paper leaves open. With --family the statements are
tested for each reconstruction of `benchmarks/replication/family.py`, and each gets a verdict. With --experiment one
cause is changed at a time, to see why statements hold for none. Studies and answers stay in the folder, so that
each can go on after an interruption.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.replication import open_questions
from benchmarks.replication.experiments import EXPERIMENTS, run_experiment
from benchmarks.replication.statements import STATEMENTS
from benchmarks.replication.verdicts import CONFIRMED, NONE, SOME, run_family, table, verdict, write_table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="60 scenarios a study")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the studies; go on with those that are there")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--family", action="store_true", help="test the statements for each reconstruction")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="seeds 0 to N-1 of each reconstruction")
    parser.add_argument("--experiment", choices=EXPERIMENTS, metavar="NAME", help=f"one of {', '.join(EXPERIMENTS)}")
    parser.add_argument(
        "--statement", choices=STATEMENTS, metavar="NUMBER", help="test one statement of the family only"
    )
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the tables to a page such as docs/paper.md")
    options = parser.parse_args()
    budget = 60 if options.quick else None
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        if options.family:
            show_family(options, folder, budget)
        elif options.experiment:
            print("\n".join(run_experiment(options.experiment, folder, range(options.seeds), budget)))
        else:
            show_open_questions(options, folder, budget)


def show_family(options: argparse.Namespace, folder: Path, budget: int | None) -> None:
    """Print the verdict of each statement, and for which reconstructions it holds."""
    numbers = list(STATEMENTS) if options.statement is None else [options.statement]
    results = run_family(folder, range(options.seeds), numbers, budget, progress=True)
    verdicts = {number: verdict(number, results) for number in numbers}
    print("\n".join(table(results)))
    counts = Counter(answer for answer, _ in verdicts.values())
    print(f"{len(numbers)} statements: " + ", ".join(f"{counts[one]} {one}" for one in (CONFIRMED, SOME, NONE)))
    if options.page:
        write_table(options.page, results)
    if options.json:
        rows = [{"number": key[0], "runs": key[1], "reading": key[2], "seeds": cells} for key, cells in results.items()]
        options.json.write_text(json.dumps({"verdicts": verdicts, "rows": rows}, indent=1))


def show_open_questions(options: argparse.Namespace, folder: Path, budget: int | None) -> None:
    """Print what the paper leaves open, asked of the default reconstructions."""
    answers = open_questions.ask_open_questions(folder, range(options.seeds), budget, progress=True)
    print("\n".join(open_questions.table(answers)))
    held = [cell["holds"] for cells in answers.values() for cell in cells]
    print(f"{sum(held)} of {len(held)} answers are yes")
    if options.page:
        open_questions.write_table(options.page, answers)
    if options.json:
        rows = [{"scenario": key[0], "question": key[1], "seeds": cells} for key, cells in answers.items()]
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
