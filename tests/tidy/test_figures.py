"""Every figure on a page has a command that gives it, and the pages made from rows are those the rows give."""

from __future__ import annotations

import importlib
import json
import re
from collections import Counter
from pathlib import Path

import pytest

from saflite.console.view.catalogue import policies_told
from saflite.oracle.policy import load_policy, policies_for, policy_names

ROOT = Path(__file__).resolve().parents[2]
BENCHES = ROOT / "scripts" / "benches"
PAGES = [ROOT / "README.md", BENCHES / "FIDELITY.md", *sorted((ROOT / "deploy" / "docs").glob("*.md"))]
MADE = ("books", "rq1", "rq2", "rq3", "search")

MADE_OF_ROWS = re.compile(r"This page\s+is\s+made\s+of.{1,600}?scripts/bench \w+ +--page", re.DOTALL)
RESULT = re.compile(
    r"\bmedians?\b[^|\n]{0,20}\d"  # median 6
    r"|\d+(?:\.\d+)? ?(?:%|×)(?!\s*(?:interval|confidence|inter))"  # 81 %, 454 ×
    r"|\b\d+ of \d+\b"  # 28 of 28
    r"|\b\d+\.\d+ ?\[\d"  # 0.76 [0.7, 0.8]
)
COMMAND = re.compile(
    r"scripts/(?:bench \w+|demo|soak|farm|test|golden)|saflite (?:evaluate|conformance|audit|scorer|run|fly|judge|list)"
)
BENCH = re.compile(r"scripts/bench (\w[\w-]*)((?:[^\S\n]+(?:--?[\w-]+|[\w.:/=]+))*)")
OPTION = re.compile(r"(?<!\S)--[a-z][\w-]*")


def sections(text: str) -> list[tuple[str, str]]:
    """Return heading and text of each part of a page, tables and words with it."""
    parts = re.split(r"^(?=#{1,2} )", text, flags=re.MULTILINE)
    return [(part.partition("\n")[0], part) for part in parts if part.strip()]


def without_command(text: str) -> list[str]:
    """Return the parts of a page that give figures and name no command that gives them, with the figures.

    A page made of rows names its command once; a part under `###` may lean on the command of the part it belongs to.
    """
    if MADE_OF_ROWS.search(text):
        return []
    found = []
    for heading, part in sections(text):
        figures = [match.group().strip() for match in RESULT.finditer(part)]
        if figures and not COMMAND.search(part):
            found.append(f"{heading}: {', '.join(figures[:6])}")
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_figures_stand_beside_a_command_that_gives_them(page: Path) -> None:
    assert without_command(page.read_text()) == []


def test_every_line_of_the_first_page_names_its_command() -> None:
    (part,) = (part for heading, part in sections((ROOT / "README.md").read_text()) if heading == "## Measured")
    lines = [line for line in part.splitlines() if line.startswith("|")][2:]
    assert len(lines) > 10
    assert [line for line in lines if not COMMAND.search(line) and not line.endswith("| the same |")] == []


def test_a_figure_without_a_command_is_found() -> None:
    assert without_command("# A\n\nwords\n\n## B\n\nIt found 28 of 28, median 6.\n") == ["## B: 28 of 28, median 6"]
    assert without_command("## B\n\nIt found 28 of 28 (`scripts/bench defects`).\n") == []
    assert without_command("## B\n\nA lease of 10 s, 95 % interval, at most 20 tests.\n") == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_on_a_page_are_there_with_their_options(page: Path) -> None:
    wrong = []
    for name, rest in BENCH.findall(page.read_text()):
        file = BENCHES / f"{name.replace('-', '_')}.py"
        if not file.is_file():
            wrong.append(f"scripts/bench {name}")
            continue
        known = file.read_text()
        wrong += [f"scripts/bench {name} {option}" for option in OPTION.findall(rest) if f'"{option}"' not in known]
    assert wrong == []


@pytest.mark.parametrize("name", MADE)
def test_a_page_is_what_its_rows_give(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHES))
    module = importlib.import_module(name)
    assert module.PAGE.read_text() == module.page(module.rows(module.ROWS)), f"run scripts/bench {name} --page"


def test_the_page_of_scale_holds_the_tables_that_are_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHES))
    tables = importlib.import_module("_scale_table").tables()
    page = (ROOT / "deploy" / "docs" / "scale.md").read_text()
    computed, _, loop = page.partition("\n## The books' loop\n")
    assert tables in computed
    assert _table(computed) == _table(tables), "a table that no command makes stands where the page says one does"
    rows = [json.loads(line) for line in (BENCHES / "results" / "bus.jsonl").read_text().splitlines()]
    measured = {(f"{row['results_per_s']:.0f}", f"{row['books_ms_per_result']:.1f}") for row in rows}
    written = [tuple(cell.strip() for cell in line.split("|")) for line in _table(loop)[2:]]
    assert written
    assert [line for line in written if (line[3], line[5]) not in measured] == []


def test_the_page_of_rules_names_every_fault_that_no_rule_sees() -> None:
    page = (ROOT / "deploy" / "docs" / "rules-measured.md").read_text()
    rows = [json.loads(line) for line in (BENCHES / "results" / "rules-planted.jsonl").read_text().splitlines()]
    unseen = [row["fault"] for row in rows if not row["seen_by"]]
    (part,) = (part for heading, part in sections(page) if heading == "## What is still unseen?")
    assert sorted(re.findall(r"`([\w-]+)`", "".join(_table(part)))) == sorted(unseen)
    assert f"\n{len(unseen)} of the {len(rows)}, " in part
    assert f"| all | {len(rows)} | | | **{len(rows) - len(unseen)}** |" in page


def _table(page: str) -> list[str]:
    return [line for line in page.splitlines() if line.startswith("|")]


def test_the_pages_count_the_policies_there_are() -> None:
    page = (ROOT / "deploy" / "docs" / "policies.md").read_text()
    many = {target: len(policies_for(target)) for target in ("px4", "ardupilot")}
    assert f"({many['px4']} for PX4, {many['ardupilot']} for\nArduCopter)" in page
    lists = Counter(load_policy(name).file.published[:1] for name in policy_names())
    assert f"# {lists['A'] + lists['P']} published ones ({lists['A']} ArduPilot, {lists['P']} PX4)" in page
    whole, good, rules = map(int, re.findall(r"\d+", policies_told("reference")))
    row = f"| policies | {whole}, of which {good} can be checked on the reference vehicle, by {rules} different rules |"
    assert row in (ROOT / "README.md").read_text()


def test_the_totals_of_real_flights_are_the_sums_of_their_seeds() -> None:
    def added(cell: str) -> int:
        return sum(int(number) for number in re.findall(r"\d+", cell.partition(";")[0].replace(",", " ")))

    page = (ROOT / "deploy" / "docs" / "rules-on-real.md").read_text()
    totals = re.findall(r"^\| (?:ArduCopter|PX4) [^|]*\| ([\d,]+) \| (\d+)[^|\n]*\| \d+, ", page, re.MULTILINE)
    tables = re.split(r"^### (?:ArduCopter|PX4) .*$", page, flags=re.MULTILINE)[1:]
    assert len(totals) == len(tables) == 3
    for (flights, broken), table in zip(totals, tables, strict=True):
        rows = re.findall(r"^\| \d{3}[^|\n]*\| ([^|\n]*)\| ([^|\n]*)\|", table, re.MULTILINE)
        sums = sum(added(cell) for cell, _ in rows), sum(added(cell) for _, cell in rows)
        assert sums == (int(flights.replace(",", "")), int(broken))
