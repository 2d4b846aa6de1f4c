"""Results for continuous integration: JUnit XML (a test each) and SARIF 2.1.0 (a result for each that violates)."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple
from xml.etree import ElementTree as Xml

from saflite.console.io import outputs
from saflite.contract.plain import plain_data
from saflite.recorder.exports.junit import clean
from saflite.recorder.exports.sarif import SCHEMA

Outcome = Literal["passed", "failed", "skipped", "error"]


class Check(NamedTuple):
    """One thing held against a build. `baseline` is SARIF's: new, unchanged, updated, absent."""

    rule: str
    name: str
    outcome: Outcome
    text: str
    level: str
    baseline: str
    fingerprint: str
    place: str


def write(args: argparse.Namespace, suite: str, checks: Sequence[Check]) -> None:
    """Write the files asked for."""
    if args.junit is not None:
        outputs.write(args.junit, junit(suite, checks).encode(), force=args.force, option="--junit")
    if args.sarif is not None:
        text = json.dumps(plain_data(sarif(suite, checks)), indent=2, ensure_ascii=False) + "\n"
        outputs.write(args.sarif, text.encode(), force=args.force, option="--sarif")


def junit(suite: str, checks: Sequence[Check]) -> str:
    """Return the checks as JUnit XML."""
    counts = {word: sum(1 for one in checks if one.outcome == word) for word in ("failed", "error", "skipped")}
    root = Xml.Element(
        "testsuite",
        name=clean(suite),
        tests=str(len(checks)),
        failures=str(counts["failed"]),
        errors=str(counts["error"]),
        skipped=str(counts["skipped"]),
    )
    for one in checks:
        case = Xml.SubElement(root, "testcase", classname=clean(one.rule), name=clean(one.name))
        if one.outcome != "passed":
            kind = "failure" if one.outcome == "failed" else one.outcome
            Xml.SubElement(case, kind, message=clean(one.text), type=clean(one.rule))
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def sarif(suite: str, checks: Sequence[Check]) -> dict[str, Any]:
    """Return the checks as a SARIF log; what was not judged is a notification of the tool, not a result."""
    rules = sorted({one.rule for one in checks})
    told = [one for one in checks if one.outcome in ("failed", "skipped", "passed")]
    run = {
        "tool": {"driver": {"name": "saflite", "rules": [{"id": rule, "name": rule} for rule in rules]}},
        "automationDetails": {"id": suite},
        "columnKind": "unicodeCodePoints",
        "results": [_result(one, rules.index(one.rule)) for one in told],
        "invocations": [
            {
                "executionSuccessful": len(told) == len(checks),
                "toolExecutionNotifications": [
                    {"level": "error", "message": {"text": f"{one.rule} {one.name}: {one.text}"}}
                    for one in checks
                    if one.outcome == "error"
                ],
            }
        ],
    }
    return {"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}


def _result(one: Check, rule: int) -> dict[str, Any]:
    kinds = {"passed": "pass", "failed": "fail", "skipped": "review"}
    place = {"physicalLocation": {"artifactLocation": {"uri": one.place}, "region": {"startLine": 1}}}
    return {
        "ruleId": one.rule,
        "ruleIndex": rule,
        "kind": kinds[one.outcome],
        "level": one.level if one.outcome == "failed" else "none",
        "baselineState": one.baseline,
        "message": {"text": one.text},
        "locations": [place],
        "partialFingerprints": {"saflite/v1": one.fingerprint},
    }
