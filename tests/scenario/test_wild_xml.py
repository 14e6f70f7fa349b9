"""Malformed XML that other tools accept."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from cornercase import InputError, simulate
from cornercase.simulators import check

EXAMPLE = Path(__file__).parents[2] / "examples" / "t_intersection"


def changed_example(folder: Path, before: str = "", comment: str = "") -> Path:
    """Write the example with something before its XML declaration and a comment after its root's tag."""
    text = (EXAMPLE / "t_intersection.xosc").read_text(encoding="utf-8")
    text = text.replace("<OpenSCENARIO>", f"<OpenSCENARIO>{comment}", 1)
    text = text.replace('filepath="', f'filepath="{EXAMPLE.as_posix()}/')
    path = folder / "changed.xosc"
    path.write_text(before + text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("before", "comment", "what"),
    [
        ("", "<!-- speed -- in m/s -->", "comments that hold '--'"),
        ("", "<!----- rule ----->", "comments that hold '--'"),
        ("\n  ", "", "XML declaration"),
        ("<!-- licence -->\n", "", "XML declaration"),
    ],
)
def test_43_8_comments_and_declaration_may_break_the_rules_of_xml(tmp_path, before, comment, what):
    plain = changed_example(tmp_path)
    expected = simulate(plain)
    path = changed_example(tmp_path, before, comment)
    with pytest.warns(UserWarning, match=f"adapted: {what} .changed.xosc, line"):
        recording = simulate(path)
    assert recording.x.tobytes() == expected.x.tobytes()
    (notice,) = [one for one in check(path).notices if what in one.parts]
    assert "XML 1.0" in notice.rule


def test_43_8_lines_of_messages_stay_right_where_the_declaration_comes_late(tmp_path):
    path = changed_example(tmp_path, before="\n\n<!-- a\n comment -->\n")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("<ByEntityCondition>", '<Nonsense x="1"/><ByEntityCondition>', 1), encoding="utf-8")
    line = 1 + path.read_text(encoding="utf-8").partition("<Nonsense")[0].count("\n")
    assert any(f"line {line}" in str(one) for one in check(path).notices if "Nonsense" in str(one))


@pytest.mark.parametrize("data", ["<!-- x -- -->" * 20_000 + "<a><b></a>", "<!-- x -" * 20_000 + "<a/>"])
def test_43_8_other_faults_are_refused_at_once(tmp_path, data):
    path = tmp_path / "broken.xosc"
    path.write_text(data, encoding="utf-8")
    begun = time.process_time()
    with pytest.raises(InputError, match="is not well-formed XML"):
        check(path)
    assert time.process_time() - begun < 2.0
