"""Every claim of SECURITY.md has tests that would fail were it untrue; `tests/README.md` names them."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
CLAIM = re.compile(r"^\* \*\*(.+?)\.?\*\*", re.M)
ROW = re.compile(r"^\| ([^|]+) \| (`[^|]+`) \|$", re.M)
NAMED = re.compile(r"`([\w/]+\.py)::(test_\w+)`")


def _rows() -> dict[str, list[tuple[str, str]]]:
    page = (ROOT / "tests" / "README.md").read_text().partition("## What SECURITY.md says")[2]
    return {claim: NAMED.findall(tests) for claim, tests in ROW.findall(page)}


def test_every_claim_has_its_tests() -> None:
    protected = (ROOT / "SECURITY.md").read_text().partition("## What is not")[0]
    claims = CLAIM.findall(protected)
    assert len(claims) == len(re.findall(r"^\* ", protected, re.M)), "a claim begins with its words in bold"
    assert list(_rows()) == claims


def test_the_tests_of_claims_are_there() -> None:
    found = [(claim, *test) for claim, tests in _rows().items() for test in tests]
    assert len(found) > len(_rows())
    for claim, file, name in found:
        text = (ROOT / "tests" / file).read_text()
        assert re.search(rf"^def {name}\(", text, re.M), f"{claim}: {file} has no {name}"
