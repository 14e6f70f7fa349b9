"""The page of a study: one HTML file without outside references."""

from __future__ import annotations

import base64
import importlib.resources
import json
import zlib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

from markupsafe import Markup

from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file, written_whole
from cornercase.report.blocks import pack_block, pack_record
from cornercase.report.contents import page_contents
from cornercase.report.data import ReportData, read_report_data
from cornercase.report.sections.overview import tell_provenance
from cornercase.study import Study, open_study

if TYPE_CHECKING:
    from jinja2 import Environment

_STYLES: Final = ("style.css",)
_SCRIPTS: Final = (
    "store.js",
    "recordings.js",
    "colours.js",
    "describe.js",
    "plot.js",
    "points.js",
    "ranges.js",
    "filters.js",
    "link.js",
    "theme.js",
    "views.js",
    "views/space.js",
    "main.js",
)
# The page loads nothing from anywhere: what is in it is all that it may run.
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:;"
    " font-src data:; worker-src blob:; connect-src 'self'"
)
_IN_BLOCK: Final = 16


def write_report(study: Study | Path | str, path: Path | str) -> Path:
    """Write one page without outside references.

    Parameters
    ----------
    study : Study or path
        The page leaves out what the study was not analysed for. A study that is open for writing notes how long
        drawing took.
    path : path
        Of the page.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    InputError
        No scenario has ended without failing, the page is the study itself, or it cannot be written.

    See Also
    --------
    cornercase.summarize : The same as values, for programs.
    """
    path = Path(path)
    with open_study(study, readonly=True) as opened:
        require_other_file(path, opened.path)
        if not opened.done():
            _tell_why_empty(opened)
        data = read_report_data(opened)
    with written_whole(path) as temporary:
        temporary.write_text(fill_page(data), encoding="utf-8", newline="\n")
    return path


def fill_page(data: ReportData) -> str:
    """Put the page together.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    str
        HTML.
    """
    records = {
        row.id: pack_record(
            row.id, data.recordings[row.id], {name: each[row.id] for name, each in data.courses.items()}
        )
        for row in data.rows
    }
    ids = list(records)
    blocks: list[str] = []
    index: dict[str, list[int]] = {}
    for k in range(0, len(ids), _IN_BLOCK):
        some = ids[k : k + _IN_BLOCK]
        block, offsets = pack_block([records[one] for one in some])
        index |= {str(one): [len(blocks), offset] for one, offset in zip(some, offsets, strict=True)}
        blocks.append(base64.b64encode(block).decode())
    contents = page_contents(data) | {"recordings": index}
    meta = data.summary.meta
    page: str = (
        _environment()
        .get_template("page.html.j2")
        .render(
            title=f"cornercase: {meta.title}",
            about=f"{meta.ego} is the ego, {meta.other} the other.",
            policy=_POLICY,
            contents=contents,
            answers=[],
            details=[],
            provenance=Markup("".join(tell_provenance(data))),
            blocks=blocks,
            plotly=_plotly(),
            styles=[Markup(_asset(name)) for name in _STYLES],
            scripts=[Markup(_asset(name)) for name in _SCRIPTS],
        )
    )
    return page


def _asset(name: str) -> str:
    return importlib.resources.files("cornercase.report.web").joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    code = importlib.resources.files("plotly.package_data").joinpath("plotly.min.js").read_bytes()
    return base64.b64encode(zlib.compress(code, 9)).decode()


def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader("cornercase.report", "web"), autoescape=True, trim_blocks=True)
    environment.filters["json"] = _json
    return environment


def _json(value: Any) -> Markup:
    # In a script nothing is escaped, so what would end it must not be there.
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def _tell_why_empty(study: Study) -> NoReturn:
    failed = study.failed()
    if not failed:
        raise InputError(f"{study.path}: no scenario was run yet, so there is nothing to report.")
    raise InputError(
        f"{study.path}: all {len(failed)} scenarios failed, so there is nothing to report; the first one as"
        f" {failed[0].error}"
    )
