"""The violations as SARIF 2.1.0 (OASIS), for code-scanning views: a rule per policy, a result per find.

Severity hard is an error, soft a warning; unconfirmed is a warning, flaky a note. Violations that nobody has decided
upon are one result a policy, at the campaign. The fingerprint keeps results apart over runs. The smallest form of a
find is a related location of its result, so counts are those of the report. Why the budget was not flown is a
notification of the tool: an error where the campaign broke or was killed. The execution is no success then, nor while
the campaign works or where a signal interrupted it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from saflite.contract.plain import plain_data
from saflite.contract.verdict import Violation, failed_again
from saflite.recorder.files import write_file
from saflite.recorder.summary import Find, PolicyFacts, RunSummary

FILE = "violations.sarif"
SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


def export(summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write `violations.sarif` into `folder`; returns the file written."""
    path = folder / FILE
    write_file(path, json.dumps(plain_data(to_sarif(summary)), indent=2, ensure_ascii=False) + "\n")
    return (path,)


def to_sarif(summary: RunSummary) -> dict[str, Any]:
    """Return the SARIF log as data."""
    known = {policy.id: policy for policy in summary.policies}
    for name in (*(finding.violation.policy for finding in summary.findings), *summary.pending):
        known.setdefault(name, PolicyFacts(name, "", "", ""))
    rules = [known[name] for name in sorted(known)]
    index = {policy.id: place for place, policy in enumerate(rules)}
    driver = {
        "name": "saflite",
        "version": summary.version or "0",
        "rules": [_rule(policy) for policy in rules],
    }
    run = {
        "tool": {"driver": driver},
        "properties": {"withheld": summary.withheld, "flights": summary.flights, "budget": summary.budget},
        "invocations": [
            {
                "executionSuccessful": not summary.failed and not summary.unfinished,
                "toolExecutionNotifications": [
                    {"level": "error" if summary.failed else "note", "message": {"text": told}}
                    for told in (summary.shortfall,)
                    if told
                ],
            }
        ],
        "automationDetails": {"id": f"{summary.campaign.name}/{summary.campaign.rng_seed}"},
        "columnKind": "unicodeCodePoints",
        "results": [
            *(_result(find, index) for find in summary.finds()),
            *(_pending(name, count, index) for name, count in summary.pending.items()),
        ],
    }
    return {"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}


def _rule(policy: PolicyFacts) -> dict[str, Any]:
    words = policy.interestingness.strip() or policy.title or policy.id
    return {
        "id": policy.id,
        "name": policy.id,
        "shortDescription": {"text": policy.title or policy.id},
        "fullDescription": {"text": words},
        "help": {"text": f"{words}\nSource: {policy.source or 'not stated'}"},
        "properties": policy.rulings._asdict(),
    }


def _result(find: Find, index: dict[str, int]) -> dict[str, Any]:
    finding, violation = find.finding, find.finding.violation
    text = (
        f"{violation.confirmation} {violation.severity} violation of {violation.policy}: robustness "
        f"{violation.robustness:.3f}; under other noise it violates again in {failed_again(violation)}"
    )
    return {
        "ruleId": violation.policy,
        "ruleIndex": index[violation.policy],
        "level": _level(violation),
        "message": {"text": f"{text}. {violation.message}".strip()},
        "locations": [_location(f"test_cases/{violation.test_case}.yaml")],
        "relatedLocations": [_smallest_form(form.violation) for form in find.smallest_forms],
        "partialFingerprints": {"saflite/v1": violation.fingerprint or violation.test_case},
        "properties": {
            "robustness": violation.robustness,
            "rate": None if violation.rate_low is None else [violation.rate_low, violation.rate_high],
            "recording": finding.recording,
            "features": finding.judgement.features if finding.judgement is not None else {},
            "askedFirst": msgspec.to_builtins(finding.circumstances),
        },
    }


def _pending(policy: str, count: int, index: dict[str, int]) -> dict[str, Any]:
    text = f"unconfirmed violation of {policy} in {count} test cases: neither confirmed nor refuted"
    return {
        "ruleId": policy,
        "ruleIndex": index[policy],
        "level": "warning",
        "message": {"text": text},
        "locations": [_location("campaign.toml")],
        "partialFingerprints": {"saflite/v1": f"pending-{policy}"},
    }


def _level(violation: Violation) -> str:
    if violation.confirmation == "confirmed":
        return "error" if violation.severity == "hard" else "warning"
    return "warning" if violation.confirmation == "unconfirmed" else "note"


def _smallest_form(violation: Violation) -> dict[str, Any]:
    text = f"its smallest form ({violation.confirmation})"
    return {**_location(f"test_cases/{violation.test_case}.yaml"), "message": {"text": text}}


def _location(uri: str) -> dict[str, Any]:
    return {"physicalLocation": {"artifactLocation": {"uri": uri}, "region": {"startLine": 1}}}
