"""The frame of the report's page: everything that does not depend on the study."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Final

_STYLE: Final = """
body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
h1{margin-bottom:.2rem}h2{margin-top:2.4rem;border-bottom:1px solid #ccc}figure{margin:1rem 0}img{max-width:100%}
figcaption{color:#444;font-size:.92rem}table{border-collapse:collapse;font-size:.9rem;margin:.8rem 0}
th,td{padding:.25rem .6rem;text-align:right;border-bottom:1px solid #ddd}th{background:#f3f3f3}
td.text,th.text{text-align:left}.wide{overflow-x:auto}.numbers{display:flex;flex-wrap:wrap;gap:1rem;margin:1rem 0}
.numbers div{border:1px solid #ccc;border-radius:.4rem;padding:.4rem .9rem}.numbers b{display:block;font-size:1.5rem}
td.text:first-child{white-space:nowrap}td.text:last-child{min-width:12rem}
@media print{body{margin:0;font-size:11px}h2,figure{break-inside:avoid}}
"""
_PAGE: Final = (
    "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
    "<meta name='viewport' content='width=device-width, initial-scale=1'>"
    "<title>{title}</title><style>{style}</style></head><body>\n{body}\n</body></html>\n"
)
_FIGURE: Final = (
    "<figure><img alt='{caption}' src='data:image/png;base64,{data}'><figcaption>{caption}</figcaption></figure>"
)


def fill_page(title: str, body: str) -> str:
    """Put a page together.

    Parameters
    ----------
    title : str
        Plain text.
    body : str
        HTML.

    Returns
    -------
    str
        HTML.
    """
    return _PAGE.format(title=escape(title), style=_STYLE, body=body)


def fill_figure(caption: str, data: str) -> str:
    """Put a figure and its caption together.

    Parameters
    ----------
    caption : str
        Plain text.
    data : str
        PNG in base64.

    Returns
    -------
    str
        HTML.
    """
    return _FIGURE.format(caption=escape(caption), data=data)


def fill_numbers(numbers: Mapping[str, object]) -> str:
    """Put figures into boxes.

    Parameters
    ----------
    numbers : mapping of str to object
        By what they count.

    Returns
    -------
    str
        HTML.
    """
    boxes = "".join(f"<div><b>{escape(str(value))}</b>{escape(name)}</div>" for name, value in numbers.items())
    return f"<div class='numbers'>{boxes}</div>"
