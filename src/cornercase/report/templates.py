"""Templates of pages, with all that a page needs put into it."""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

if TYPE_CHECKING:
    from jinja2 import Environment


def fill_template(name: str, styles: Iterable[str], scripts: Iterable[str], **parts: Any) -> str:
    """Put a page together; what it is given is escaped, but for what is markup already.

    Parameters
    ----------
    name : str
        Of the template.
    styles, scripts : iterable of str
        Files beside it, in this order.
    **parts : object
        What the template asks for.

    Returns
    -------
    str
        HTML.
    """
    page: str = (
        _environment()
        .get_template(name)
        .render(
            styles=[Markup(_asset(one)) for one in styles], scripts=[Markup(_asset(one)) for one in scripts], **parts
        )
    )
    return page


def _asset(name: str) -> str:
    return importlib.resources.files("cornercase.report.web").joinpath(name).read_text(encoding="utf-8")


def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader("cornercase.report", "web"), autoescape=True, trim_blocks=True)
    environment.filters["json"] = _json
    return environment


def _json(value: Any) -> Markup:
    # In a script nothing is escaped, so what would end it must not be there.
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))
