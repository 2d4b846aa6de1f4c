"""The campaign as JUnit XML for continuous integration: one test per policy and violation, a violation fails it.

A flaky or unconfirmed violation is a skipped test with its rate, so that it shows without breaking a build; so is a
policy whose rule applied in no flight: it was not put to the test.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

from saflite.contract.plain import plain
from saflite.contract.verdict import failed_again
from saflite.recorder.files import write_file
from saflite.recorder.summary import Finding, RunSummary

FILE = "junit.xml"


def export(summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write `junit.xml` into `folder`; returns the file written."""
    path = folder / FILE
    suite = _suite(summary)
    Xml.indent(suite)
    write_file(path, Xml.tostring(suite, encoding="unicode", xml_declaration=True) + "\n")
    return (path,)


def _suite(summary: RunSummary) -> Xml.Element:
    failed = [finding for finding in summary.findings if finding.violation.confirmation == "confirmed"]
    broken = {finding.violation.policy for finding in summary.findings}
    held = [policy for policy in summary.policies if policy.id not in broken]
    never = [policy for policy in held if not policy.rulings.applied]
    suite = Xml.Element(
        "testsuite",
        name=clean(summary.campaign.name),
        tests=str(len(summary.findings) + len(held)),
        failures=str(len(failed)),
        errors="0",
        skipped=str(len(summary.findings) - len(failed) + len(never)),
        time=f"{summary.elapsed_s:.3f}",
    )
    _properties(suite, summary)
    for finding in summary.findings:
        _add(suite, finding)
    for policy in held:
        name = "applied in no flight" if policy in never else "held on every flight it applied in"
        case = Xml.SubElement(suite, "testcase", classname=clean(policy.id), name=name)
        if policy in never:
            Xml.SubElement(case, "skipped", message=clean(policy.rulings.text()))
    return suite


def _properties(suite: Xml.Element, summary: RunSummary) -> None:
    properties = Xml.SubElement(suite, "properties")
    facts = {
        "flights": summary.flights,
        "test cases without violation": summary.held,
        "rng_seed": summary.campaign.rng_seed,
        "target": summary.campaign.target.name,
        "version": summary.version,
    }
    for name, value in facts.items():
        Xml.SubElement(properties, "property", name=name, value=clean(str(value)))


def _add(suite: Xml.Element, finding: Finding) -> None:
    violation = finding.violation
    case = Xml.SubElement(
        suite, "testcase", classname=clean(violation.policy), name=f"{violation.test_case} {violation.fingerprint}"
    )
    again = f"violated again in {failed_again(violation)}" if violation.reflown else "not flown again"
    text = (
        f"{violation.severity} violation, robustness {violation.robustness:.3f}, {again}. {violation.message}".strip()
    )
    kind = "failure" if violation.confirmation == "confirmed" else "skipped"
    node = Xml.SubElement(case, kind, message=clean(f"{violation.confirmation}: {text}"))
    if kind == "failure":
        node.set("type", clean(violation.policy))
    node.text = clean(f"test case test_cases/{violation.test_case}.yaml\nrecording {finding.recording or 'none'}\n")


def clean(text: str) -> str:
    """Return the text made plain, without characters that XML 1.0 cannot hold."""
    return "".join(char for char in plain(text) if ord(char) not in (0xFFFE, 0xFFFF))
