"""The violations as SARIF 2.1.0 (OASIS), for code-scanning views: a rule per policy, a result per violation.

Severity hard is an error, soft a warning, flaky or unconfirmed a note. The fingerprint keeps results apart over runs.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from saflite.contract.plain import plain_data
from saflite.contract.verdict import failed_again
from saflite.recorder.files import write_file
from saflite.recorder.summary import Finding, PolicyFacts, RunSummary

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
    for finding in summary.findings:
        known.setdefault(finding.violation.policy, PolicyFacts(finding.violation.policy, "", "", ""))
    rules = [known[name] for name in sorted(known)]
    index = {policy.id: place for place, policy in enumerate(rules)}
    driver = {
        "name": "saflite",
        "version": summary.version or "0",
        "rules": [_rule(policy) for policy in rules],
    }
    run = {
        "tool": {"driver": driver},
        "properties": {"withheld": summary.withheld},
        "automationDetails": {"id": f"{summary.campaign.name}/{summary.campaign.rng_seed}"},
        "columnKind": "unicodeCodePoints",
        "results": [_result(finding, index) for finding in summary.findings],
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


def _result(finding: Finding, index: dict[str, int]) -> dict[str, Any]:
    violation = finding.violation
    level = "note" if violation.confirmation != "confirmed" else "error" if violation.severity == "hard" else "warning"
    uri = f"test_cases/{violation.test_case}.yaml"
    text = (
        f"{violation.confirmation} {violation.severity} violation of {violation.policy}: robustness "
        f"{violation.robustness:.3f}; under other noise it violates again in {failed_again(violation)}"
    )
    return {
        "ruleId": violation.policy,
        "ruleIndex": index[violation.policy],
        "level": level,
        "message": {"text": f"{text}. {violation.message}".strip()},
        "locations": [{"physicalLocation": {"artifactLocation": {"uri": uri}, "region": {"startLine": 1}}}],
        "partialFingerprints": {"saflite/v1": violation.fingerprint or violation.test_case},
        "properties": {
            "robustness": violation.robustness,
            "rate": None if violation.rate_low is None else [violation.rate_low, violation.rate_high],
            "recording": finding.recording,
            "features": finding.judgement.features if finding.judgement is not None else {},
            "askedFirst": msgspec.to_builtins(finding.circumstances),
        },
    }
