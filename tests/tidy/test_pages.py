"""What the pages name is there: files of the package, of the repository, and functions of the suites."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "services" / "saflite"
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "tests/README.md")),
    *sorted((ROOT / "deploy" / "docs").glob("*.md")),
]
PLACE = re.compile(r"`([\w.-]+(?:/[\w.-]+)+/?|[\w-]+/)`")
ELSEWHERE = re.compile(r"runs/|\.hypothesis/|unixsock-stream/")  # of a user, not of the repository


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_named_on_a_page_exist(page: Path) -> None:
    named = {place for place in PLACE.findall(page.read_text()) if not ELSEWHERE.match(place)}
    roots = (ROOT, PACKAGE, page.parent)
    assert sorted(place for place in named if not any((root / place).exists() for root in roots)) == []


def test_suites_named_on_the_page_are_there() -> None:
    from saflite.conformance import buses, launchers, scorers, strategies, targets

    rooms = {"buses": buses, "launchers": launchers, "scorers": scorers, "strategies": strategies, "targets": targets}
    text = (ROOT / "deploy" / "docs" / "conformance.md").read_text()
    named = re.findall(r"`(\w+)\.(\w+)", text)
    assert {room for room, _ in named if room in rooms} == set(rooms)
    assert [f"{room}.{word}" for room, word in named if room in rooms and not hasattr(rooms[room], word)] == []
