"""Index page of the studies in a folder: a table with a row for each study, and links to the reports."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final
from urllib.parse import quote

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import escape_control_characters
from cornercase.drivers._serialization import format_driver
from cornercase.report._page_metadata import find_page_of_study
from cornercase.report._summary import entities_hit_by_ego
from cornercase.report.html._templates import check_page_path, render_template, write_page
from cornercase.report.text._phrases import format_criterion_with_signs, format_percent
from cornercase.study import StudyFile

_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


@dataclass(frozen=True)
class _Cell:
    """Cell of a table: text, value by which rows are sorted, link address, and tooltip."""

    text: str
    sort_by: float | str
    address: str = ""
    title: str = ""

    @property
    def is_number(self) -> bool:
        return not isinstance(self.sort_by, str)


def write_index(folder: Path | str, path: Path | str) -> Path:
    """Write an HTML page with a table of the studies in a folder and in its direct subfolders.

    The critical share of the space is not estimated again, but read from a report beside the study. For each file that
    is damaged or no study, the page has a sentence.
    """
    folder, path = validation.check_path("folder", folder), validation.check_path("path", path)
    check_page_path(path, "index")
    files = [*sorted(folder.glob("*.db")), *sorted(folder.glob("*/*.db"))]
    if not files:
        raise InputError(f"{folder}: has no studies; name a folder that holds .db files, directly or one folder below.")
    rows, troubles = [], []
    for file in files:
        try:
            with StudyFile.open(file) as study, study.snapshot():
                rows.append(list(_read_row(study, folder, path.resolve().parent)))
        except InputError as error:
            # Folders of the author are private.
            troubles.append(escape_control_characters(str(error).replace(str(folder / "_")[:-1], "")))
    page = render_template(
        "index.html.j2",
        ("style.css", "index.css"),
        ("index.js",),
        policy=_POLICY,
        title=escape_control_characters(folder.resolve().name or "studies"),
        about=_describe_counts(len(rows), len(troubles)),
        head=_HEAD,
        rows=rows,
        troubles=troubles,
    )
    write_page(path, page)
    return path


_HEAD: Final[Sequence[str]] = (
    "study", "scenario", "function", "simulator", "run", "collisions", "critical", "critical share of the space",
    "kept", "date", "report",
)  # fmt: skip


def _describe_counts(n_studies: int, n_troubles: int) -> str:
    studies = "One study" if n_studies == 1 else f"{n_studies} studies"
    others = {0: "", 1: "; one file could not be read"}.get(n_troubles, f"; {n_troubles} files could not be read")
    return f"{studies}{others}."


def _read_row(study: StudyFile, folder: Path, page_folder: Path) -> Iterator[_Cell]:
    """Yield the cells of the row of a study in the index, from stored values only, without any estimate."""
    meta = study.meta
    rows = study.rows()
    n_run = sum(row.state == "done" for row in rows)
    n_failed = sum(row.state == "failed" for row in rows)
    name = study.path.relative_to(folder).as_posix()
    yield _text_cell(name)
    yield _text_cell(meta.title)
    driver = meta.ego_driver
    yield _text_cell(format_driver(driver) if driver else meta.ego)
    yield _text_cell(meta.simulator)
    yield _Cell(f"{n_run}" + (f" ({n_failed} failed)" if n_failed else ""), n_run)
    others = frozenset(meta.others)
    hits = [not others.isdisjoint(entities_hit_by_ego(meta, hits)) for hits in study.collisions().values()]
    yield _Cell(str(sum(hits)), sum(hits))
    criterion = study.criterion
    if criterion is None or not n_run:
        yield _Cell("–", -1, title="there is no threshold" if criterion is None else "nothing was run")
    else:
        n_critical = int(study.critical_mask().sum())
        yield _Cell(str(n_critical), n_critical, title=format_criterion_with_signs(criterion, study.objective.label))
    page, share = find_page_of_study(study, n_run, n_failed)
    yield _share_cell(share)
    reduction = study.read_reduction()
    n_selected = 0 if reduction is None else len(reduction["kept"])
    yield _Cell("–" if reduction is None else str(n_selected), -1 if reduction is None else n_selected)
    changed = datetime.fromtimestamp(study.path.stat().st_mtime, UTC)
    yield _Cell(changed.strftime("%Y-%m-%d"), changed.strftime("%Y-%m-%d %H:%M:%S"))
    yield _Cell("–", "", title="cornercase report writes one") if page is None else _link_cell(page, page_folder)


def _text_cell(text: str) -> _Cell:
    clean = escape_control_characters(text)
    return _Cell(clean, clean.casefold())


def _share_cell(share: Sequence[float | None] | None) -> _Cell:
    value, low, high = (None, None, None) if share is None else share
    if value is None:
        return _Cell("–", -1, title="a report beside the study tells it")
    interval = "" if low is None or high is None else f" ({format_percent(low)} to {format_percent(high)})"
    return _Cell(f"{format_percent(value)}{interval}", value)


def _link_cell(page: Path, page_folder: Path) -> _Cell:
    try:
        address = Path(os.path.relpath(page.resolve(), page_folder)).as_posix()
    except ValueError:
        # There is no relative path to another drive.
        return _text_cell(page.name)
    # A colon in the first part would be taken for a scheme.
    return _Cell(escape_control_characters(page.name), page.name.casefold(), f"./{quote(address)}")
