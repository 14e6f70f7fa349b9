"""Write verdicts as JUnit XML, which CI servers such as Jenkins and GitLab show."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from junitparser import Error, Failure, JUnitXml, Skipped, TestCase, TestSuite
from lxml import etree

from cornercase._common.io.files import atomic_write
from cornercase._common.text.sanitize import escape_control_characters
from cornercase.suite._verdict import Verdict

if TYPE_CHECKING:
    from cornercase.suite._suite_result import ScenarioResult, SuiteResult

_ROOT_NAME: Final = "cornercase"
JUNIT_START: Final = re.compile(
    rb"<\?xml version='1\.0' encoding='utf-8'\?>\n<testsuites [^<>]*name=\"%b\"" % _ROOT_NAME.encode()
)
"""Begin of each JUnit file, up to the name of its root."""


def write_junit(result: SuiteResult, path: Path) -> None:
    """Write a JUnit test case for each scenario.

    Each case is in a test suite of its own, since only test suites can have properties. A violated requirement is a
    failure, an inconclusive verdict a skipped test, and a failed simulation an error. Times are simulated
    times, so the same results give the same bytes.
    """
    path_ = result.suite.resolve()
    name = _to_xml_characters(path_.parent.name if path_.is_file() else path_.name) or "suite"
    document = JUnitXml(_ROOT_NAME)
    for scenario in result.scenarios:
        document.add_testsuite(_build_test_suite(scenario, name, result))
    document.update_statistics()
    root = etree.fromstring(document.tostring())
    # Jenkins' schema allows this attribute for a suite only, and times in ms.
    del root.attrib["skipped"]
    times = [scenario.duration or 0.0 for scenario in result.scenarios]
    for element, seconds in zip((root, *root), (sum(times), *times), strict=True):
        element.set("time", f"{seconds:.3f}")
    etree.indent(root)
    with atomic_write(path) as temporary:
        temporary.write_bytes(etree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _build_test_suite(scenario: ScenarioResult, name: str, result: SuiteResult) -> TestSuite:
    suite = TestSuite(_to_xml_characters(Path(scenario.file).stem))
    facts = _scenario_facts(scenario)
    run = {"simulator": result.simulator}
    run |= {f"requirement {number}": text for number, text in enumerate(result.requirements, start=1)}
    for key, value in (facts | run).items():
        suite.add_property(_to_xml_characters(key), _to_xml_characters(value))
    suite.add_testcase(_build_test_case(scenario, name, facts))
    return suite


def _build_test_case(scenario: ScenarioResult, suite: str, facts: Mapping[str, str]) -> TestCase:
    case = TestCase(_to_xml_characters(Path(scenario.file).stem), suite, round(scenario.duration or 0.0, 3))
    if scenario.state == "error":
        case.result = [
            _add_verdict_text(Error(_to_xml_characters(scenario.reason), "simulator"), scenario.verdicts, facts)
        ]
    elif scenario.state == "failed":
        first = next(verdict for verdict in scenario.verdicts if verdict.state == "failed")
        failure = Failure(
            _to_xml_characters(f"{first.requirement}: {first.reason}"),
            _to_xml_characters(first.requirement),
        )
        case.result = [_add_verdict_text(failure, scenario.verdicts, facts)]
    elif scenario.state == "inconclusive":
        # Surefire's schema allows no type here.
        case.result = [Skipped(_to_xml_characters(scenario.reason))]
    return case


def _add_verdict_text(
    failure: Error | Failure, verdicts: tuple[Verdict, ...], facts: Mapping[str, str]
) -> Error | Failure:
    """Put all verdicts and facts into the text of a failure, as not every viewer shows properties."""
    lines = [f"{verdict.state}: {verdict.requirement}: {verdict.reason}" for verdict in verdicts]
    failure.text = "\n".join(
        map(_to_xml_characters, [*lines, "", *(f"{name}: {value}" for name, value in facts.items())])
    )
    return failure


def _scenario_facts(scenario: ScenarioResult) -> dict[str, str]:
    facts = {"file": scenario.file, "scenario": str(scenario.id)}
    facts |= {f"parameter {name}": _format_value(value) for name, value in scenario.values.items()}
    facts |= {f"score {name}": _format_value(value) for name, value in scenario.scores.items()}
    facts |= {f"score {name} against": entity for name, entity in scenario.others.items()}
    facts |= {"kind": scenario.kind, "role": scenario.role, "why": scenario.why}
    if scenario.difference is not None:
        facts["recording"] = "the same" if scenario.difference.same else "another"
        if scenario.difference.distance is not None and not scenario.difference.same:
            facts["largest distance of the ego in m"] = _format_value(scenario.difference.distance)
    return {name: value for name, value in facts.items() if value}


def _format_value(value: float | str) -> str:
    return value if isinstance(value, str) else repr(value)


def _to_xml_characters(text: str) -> str:
    """Replace characters that XML cannot contain."""
    return "".join(c if c not in "\ufffe\uffff" else "\ufffd" for c in escape_control_characters(text))
