"""The campaign as JUnit XML for continuous integration: one test per policy and find, a find fails it.

The smallest form of a find is named in the text of its test and is none of its own, so counts are those of the report.

An unconfirmed find fails, too, and a policy that was violated in flights nobody has decided upon: neither confirmed nor
refuted. A flaky violation is a skipped test with its rate, so that it shows without breaking a build; so is a policy
whose rule applied in no flight: it was not put to the test. A campaign that broke before its budget was flown, was
killed, or of which nothing could be flown and judged, is an error: a test of its own.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

from saflite.contract.plain import plain
from saflite.contract.verdict import failed_again
from saflite.recorder.files import write_file
from saflite.recorder.summary import Find, Finding, PolicyFacts, RunSummary

FILE = "junit.xml"
FAILS = ("confirmed", "unconfirmed")


def export(summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write `junit.xml` into `folder`; returns the file written."""
    path = folder / FILE
    suite = _suite(summary)
    Xml.indent(suite)
    write_file(path, Xml.tostring(suite, encoding="unicode", xml_declaration=True) + "\n")
    return (path,)


def _suite(summary: RunSummary) -> Xml.Element:
    finds = summary.finds()
    failed = [find for find in finds if find.finding.violation.confirmation in FAILS]
    broken = {*(find.finding.violation.policy for find in finds), *summary.pending}
    held = [policy for policy in summary.policies if policy.id not in broken]
    skipped = [policy for policy in held if not policy.rulings.held or policy.rulings.violated]
    suite = Xml.Element(
        "testsuite",
        name=clean(summary.campaign.name),
        tests=str(len(finds) + len(summary.pending) + len(held) + bool(summary.failed)),
        failures=str(len(failed) + len(summary.pending)),
        errors=str(int(bool(summary.failed))),
        skipped=str(len(finds) - len(failed) + len(skipped)),
        time=f"{summary.elapsed_s:.3f}",
    )
    _properties(suite, summary)
    if summary.failed:
        case = Xml.SubElement(suite, "testcase", classname="campaign", name="flown to its end")
        Xml.SubElement(case, "error", message=clean(summary.shortfall), type="campaign")
    for find in finds:
        _add(suite, find)
    for name, count in summary.pending.items():
        _add_pending(suite, name, count)
    for policy in held:
        case = Xml.SubElement(suite, "testcase", classname=clean(policy.id), name=_told(policy))
        if policy in skipped:
            Xml.SubElement(case, "skipped", message=clean(policy.rulings.text()))
    return suite


def _told(policy: PolicyFacts) -> str:
    """Return in words what became of a policy without a finding that is shown."""
    if policy.rulings.violated:
        return "violated, findings withheld"
    return "held on every flight it applied in" if policy.rulings.applied else "applied in no flight"


def _add_pending(suite: Xml.Element, policy: str, count: int) -> None:
    case = Xml.SubElement(suite, "testcase", classname=clean(policy), name="violated, neither confirmed nor refuted")
    text = f"unconfirmed: {count} test cases violated it and have not been flown again to say"
    Xml.SubElement(case, "failure", message=clean(text), type=clean(policy))


def _properties(suite: Xml.Element, summary: RunSummary) -> None:
    properties = Xml.SubElement(suite, "properties")
    facts = {
        "flights": summary.flights,
        "budget": summary.budget,
        "state": summary.state,
        "test cases without violation": summary.held,
        "rng_seed": summary.campaign.rng_seed,
        "target": summary.campaign.target.name,
        "version": summary.version,
    }
    for name, value in facts.items():
        Xml.SubElement(properties, "property", name=name, value=clean(str(value)))


def _add(suite: Xml.Element, find: Find) -> None:
    finding, violation = find.finding, find.finding.violation
    case = Xml.SubElement(
        suite, "testcase", classname=clean(violation.policy), name=f"{violation.test_case} {violation.fingerprint}"
    )
    again = f"violated again in {failed_again(violation)}" if violation.reflown else "not flown again"
    text = (
        f"{violation.severity} violation, robustness {violation.robustness:.3f}, {again}. {violation.message}".strip()
    )
    kind = "failure" if violation.confirmation in FAILS else "skipped"
    node = Xml.SubElement(case, kind, message=clean(f"{violation.confirmation}: {text}"))
    if kind == "failure":
        node.set("type", clean(violation.policy))
    node.text = clean(f"test case {_file(finding)}\nrecording {finding.recording or 'none'}\n")
    for form in find.smallest_forms:
        node.text += clean(f"smallest form {_file(form)} ({form.violation.confirmation})\n")


def _file(finding: Finding) -> str:
    return f"test_cases/{finding.violation.test_case}.yaml"


def clean(text: str) -> str:
    """Return the text made plain, without characters that XML 1.0 cannot hold."""
    return "".join(char for char in plain(text) if ord(char) not in (0xFFFE, 0xFFFF))
