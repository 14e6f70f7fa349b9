"""Page templates, rendered with their styles and scripts inlined, and written to files."""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup

from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write
from cornercase.report.html._scenario_links import link_scenarios

if TYPE_CHECKING:
    from jinja2 import Environment

_FILE_ENDINGS: Final = (".html", ".htm")


def render_template(name: str, styles: Iterable[str], scripts: Iterable[str], **parts: Any) -> str:
    """Render the page template `name` with the contents of these style and script files.

    `parts` are the values of the template; they are escaped unless they are `Markup`.
    """
    page: str = (
        _template_environment()
        .get_template(name)
        .render(
            styles=[Markup(_read_web_file(style)) for style in styles],
            scripts=[Markup(_read_web_file(script)) for script in scripts],
            **parts,
        )
    )
    return page


def check_page_path(path: Path, what: str) -> None:
    """Raise `InputError` if `path` does not end with ``.html`` or ``.htm``; `what` is the kind of page."""
    if path.suffix.lower() not in _FILE_ENDINGS:
        raise InputError(f"`path` {path}: the {what} is an HTML page; name a file that ends with .html.")


def write_page(path: Path, page: str) -> None:
    """Write a rendered page in UTF-8; characters that UTF-8 cannot encode are escaped."""
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace", newline="\n")


def _read_web_file(name: str) -> str:
    return importlib.resources.files("cornercase.report.web").joinpath(name).read_text(encoding="utf-8")


def _template_environment() -> Environment:
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader("cornercase.report", "web"), autoescape=True, trim_blocks=True)
    environment.filters["json"] = _json_for_script
    environment.filters["link_scenarios"] = link_scenarios
    return environment


def _json_for_script(value: Any) -> Markup:
    # Nothing is escaped inside a script, so the text must not contain anything that ends the script.
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))
