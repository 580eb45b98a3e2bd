"""Write the JUnit XML of a report."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from analysis.report.judging.checks import FAIL, NONE, FlightCheck


def write_junit(path: Path, name: str, checks: Sequence[FlightCheck]) -> None:
    """Write the checks as a JUnit test suite: FAIL is a failure, "not judged" is skipped."""
    suite = ET.Element(
        "testsuite",
        name=name,
        tests=str(len(checks)),
        failures=str(sum(check.verdict == FAIL for check in checks)),
        errors="0",
        skipped=str(sum(check.verdict == NONE for check in checks)),
    )
    for check in checks:
        case = ET.SubElement(suite, "testcase", classname=_clean(name), name=_clean(check.name))
        text = f"{check.evidence} ({check.limit})" if check.limit else check.evidence
        if check.verdict == FAIL:
            ET.SubElement(case, "failure", message=_clean(text))
        elif check.verdict == NONE:
            ET.SubElement(case, "skipped", message=_clean(text))
        else:
            ET.SubElement(case, "system-out").text = _clean(f"{check.verdict}: {text}")
    tree = ET.ElementTree(suite)
    ET.indent(tree)
    tree.write(path, encoding="utf-8", xml_declaration=True)


def _clean(text: str) -> str:
    """Replace control characters, which XML 1.0 does not allow."""
    return "".join(c if c >= " " or c in "\t\n" else "�" for c in text)
