"""Write verdicts as JUnit XML, which Jenkins, GitLab and others show."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from junitparser import Error, Failure, JUnitXml, Skipped, TestCase, TestSuite
from lxml import etree

from cornercase._common.files import written_whole
from cornercase._common.texts import plain_text
from cornercase.suite.result import ScenarioResult, SuiteResult
from cornercase.suite.verdict import Verdict

JUNIT: Final = b"<?xml version='1.0' encoding='utf-8'?>\n<testsuites "
"""Start of each file."""


def write_junit(result: SuiteResult, path: Path) -> None:
    """Write a test case for each scenario, in a test suite of its own, since only test suites can have properties.

    A violated requirement is a failure, an inconclusive verdict is skipped, and a failed simulation is an error. Times
    are those in the scenario, so that the same results give the same bytes.
    """
    path_ = result.suite.resolve()
    name = _text(path_.parent.name if path_.is_file() else path_.name) or "suite"
    document = JUnitXml("cornercase")
    for scenario in result.scenarios:
        document.add_testsuite(_suite(scenario, name, result))
    document.update_statistics()
    root = etree.fromstring(document.tostring())
    # Jenkins' schema allows this attribute for a suite only, and times in ms.
    del root.attrib["skipped"]
    times = [scenario.duration or 0.0 for scenario in result.scenarios]
    for element, seconds in zip((root, *root), (sum(times), *times), strict=True):
        element.set("time", f"{seconds:.3f}")
    etree.indent(root)
    with written_whole(path) as temporary:
        temporary.write_bytes(etree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _suite(one: ScenarioResult, name: str, result: SuiteResult) -> TestSuite:
    suite = TestSuite(_text(Path(one.file).stem))
    facts = _facts(one)
    run = {"simulator": result.simulator}
    run |= {f"requirement {number}": text for number, text in enumerate(result.requirements, start=1)}
    for key, value in (facts | run).items():
        suite.add_property(_text(key), _text(value))
    suite.add_testcase(_case(one, name, facts))
    return suite


def _case(one: ScenarioResult, suite: str, facts: Mapping[str, str]) -> TestCase:
    case = TestCase(_text(Path(one.file).stem), suite, round(one.duration or 0.0, 3))
    if one.state == "error":
        case.result = [_filled(Error(_text(one.reason), "simulator"), one.verdicts, facts)]
    elif one.state == "failed":
        first = next(verdict for verdict in one.verdicts if verdict.state == "failed")
        failure = Failure(_text(f"{first.requirement}: {first.reason}"), _text(first.requirement))
        case.result = [_filled(failure, one.verdicts, facts)]
    elif one.state == "inconclusive":
        # Surefire's schema allows no type here.
        case.result = [Skipped(_text(one.reason))]
    return case


def _filled(said: Error | Failure, verdicts: tuple[Verdict, ...], facts: Mapping[str, str]) -> Error | Failure:
    """Put all verdicts and facts into the text of a failure, as not every viewer shows properties."""
    lines = [f"{verdict.state}: {verdict.requirement}: {verdict.reason}" for verdict in verdicts]
    said.text = "\n".join(map(_text, [*lines, "", *(f"{name}: {value}" for name, value in facts.items())]))
    return said


def _facts(one: ScenarioResult) -> dict[str, str]:
    facts = {"file": one.file, "scenario": str(one.id)}
    facts |= {f"parameter {name}": _number(value) for name, value in one.values.items()}
    facts |= {f"score {name}": _number(value) for name, value in one.scores.items()}
    facts |= {f"score {name} against": entity for name, entity in one.others.items()}
    facts |= {"kind": one.kind, "role": one.role, "why": one.why}
    if one.difference is not None:
        facts["recording"] = "the same" if one.difference.same else "another"
        if one.difference.distance is not None and not one.difference.same:
            facts["largest distance of the ego in m"] = _number(one.difference.distance)
    return {name: value for name, value in facts.items() if value}


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else repr(value)


def _text(text: str) -> str:
    """Replace what XML cannot hold."""
    return "".join(c if c not in "\ufffe\uffff" else "\ufffd" for c in plain_text(text))
