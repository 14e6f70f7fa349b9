"""The page's scripts share one scope: what two of them declare, one of them loses."""

from __future__ import annotations

import importlib.resources
import re
from collections import Counter

from cornercase.report import _report_page as page

WEB = importlib.resources.files("cornercase.report.web")
DECLARED = re.compile(r"^(?:async )?(?:function\*? |class |const |let |var )([A-Za-z_$][\w$]*)", re.MULTILINE)
SCRIPTS = (*page._SCRIPTS, "versions.js", "replay/alone.js")


def test_no_name_is_declared_twice():
    names = Counter(name for script in page._SCRIPTS for name in DECLARED.findall(WEB.joinpath(script).read_text()))
    assert names["Store"] == 1
    assert [name for name, count in names.items() if count > 1] == []


def test_every_script_is_strict():
    assert [one for one in page._SCRIPTS if not WEB.joinpath(one).read_text().startswith('"use strict";')] == []


def test_42_14_no_script_swallows_errors():
    """Whoever catches an error looks at which one it is, or tells of it."""
    blind = re.compile(r"catch \{|\.catch\(\(\) => null\)")
    assert [one for one in SCRIPTS if blind.search(WEB.joinpath(one).read_text())] == []
