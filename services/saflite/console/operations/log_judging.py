"""Judging recordings and logs: one file or a folder of them, as text, JSON, CSV or HTML."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from saflite.console.cli import NOTHING_JUDGED
from saflite.console.io import cases, log_files
from saflite.console.run_data.known import own_policies
from saflite.console.view.html_text import escape
from saflite.console.view.report.style import CSS
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.plain import cell, in_unicode
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement, Verdict
from saflite.flight.logs import files
from saflite.flight.logs.extract import is_extract
from saflite.flight.logs.files import read_log
from saflite.oracle.judge import judge
from saflite.oracle.policy import load_policy, policies_for
from saflite.recorder import recording

SUFFIXES = (".mcap", *files.SUFFIXES)
_FIRST = ("violated", "held", "inconclusive", "vacuous")
_LONG = 26  # letters
_HEADERS = ("log", "result", "violated", "held", "vacuous", "inconclusive", "why")


class Judged(NamedTuple):
    """What came of one file: the judgement, or why the file was refused; what of it is damaged (`FlightLog.lost`).

    `below` is the folder that was judged, from which the file is named.
    """

    path: Path
    case: TestCase | None = None
    flight: Flight | None = None
    judgement: Judgement | None = None
    refused: str = ""
    lost: tuple[str, ...] = ()
    below: Path | None = None

    @property
    def name(self) -> str:
        """Return the path below the folder that was judged, of a single file its name."""
        return self.path.name if self.below is None else self.path.relative_to(self.below).as_posix()

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The verdicts; none of a file that was refused."""
        return self.judgement.verdicts if self.judgement else ()

    @property
    def result(self) -> str:
        """Return `violated`, `passed`, `nothing judged` or `refused`."""
        outcomes = {verdict.outcome for verdict in self.verdicts}
        if self.refused:
            return "refused"
        return "violated" if "violated" in outcomes else "passed" if "held" in outcomes else "nothing judged"


def judge_file(path: Path, case_path: Path | None, policies: tuple[str, ...]) -> Judged:
    """Judge one file by the policies named, or by those that fit what flew.

    Raises:
        Refused: the file cannot be read, or a policy is unknown.
    """
    if path.suffix.lower() == ".mcap":
        found = recording.read(path)
        case = cases.load_case(case_path) if case_path else found.test_case
        own = own_policies(found)
        chosen = policies or (*policies_for(""), *own)
        return Judged(path, case, found.flight, judge(case, found.flight, found.trace, chosen, own))
    log = read_log(path)
    case = log_files.case_of(files.kind_of(path), log, cases.load_case(case_path) if case_path else None)
    flight = log_files.flight_of(case, log)
    chosen = policies or policies_for(case.target.name)
    told = judge(case, flight, log.trace, chosen, sources=log.sources or None, untold=log.untold)
    return Judged(path, case, flight, told, lost=log.lost)


def judge_folder(folder: Path, case_path: Path | None, policies: tuple[str, ...]) -> Iterator[Judged]:
    """Judge every recording and log of a folder and of those in it, by name; one that is refused is told as such.

    Raises Refused if there is none, or if a policy is unknown to all of them.
    """
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and _is_log(path))
    if not paths:
        raise Refused("folder of logs", where=str(folder), expected=f"files {', '.join(SUFFIXES)}", got="none")
    if not any(path.suffix.lower() == ".mcap" for path in paths):  # which may carry a rule of one's own
        for name in policies:
            load_policy(name)
    for path in paths:
        try:
            yield judge_file(path, case_path, policies)._replace(below=folder)
        except Refused as fault:
            yield Judged(path, refused=str(fault), below=folder)


def _is_log(path: Path) -> bool:
    """Whether it is known by what it begins with, or by the end of its name; a table is one if it tells a flight."""
    suffix = path.suffix.lower()
    return is_extract(path) if suffix == ".csv" else suffix in SUFFIXES or files.begins_as_log(path)


def exit_code(judged: Iterable[Judged]) -> int:
    """Return 1 if a policy was violated, 2 if a file was refused, 4 if nothing was judged in one, else 0."""
    results = {one.result for one in judged}
    codes = {"violated": 1, "refused": 2, "nothing judged": NOTHING_JUDGED}
    return next((code for result, code in codes.items() if result in results), 0)


def missing(verdicts: Iterable[Verdict]) -> str:
    """Return in a line what most policies that could not be judged lacked."""
    whys = Counter(verdict.message.removeprefix("the log has no ") for verdict in verdicts if _lacks(verdict))
    each = Counter[str]()
    for why, count in whys.items():
        for part in why.split("), "):
            each[part.rstrip(")") + ")"] += count
    return "; ".join(f"{part}: {count}" for part, count in each.most_common(6))


def why_nothing(verdicts: Sequence[Verdict]) -> str:
    """Return in words why of all these policies none could be judged, or none applied."""
    lacked = missing(verdicts)
    if lacked:
        return f"Missing: {lacked}"
    whys = Counter(verdict.message for verdict in verdicts)
    return f"Why: {'; '.join(f'{why}: {count}' for why, count in whys.most_common(6))}"


def _lacks(verdict: Verdict) -> bool:
    return verdict.outcome == "inconclusive" and verdict.message.startswith("the log has no ")


def rows(judged: Sequence[Judged]) -> list[tuple[object, ...]]:
    """Return a row of `_HEADERS` for each file."""
    found: list[tuple[object, ...]] = []
    for one in judged:
        count = Counter(verdict.outcome for verdict in one.verdicts)
        broken = ", ".join(verdict.policy for verdict in one.verdicts if verdict.outcome == "violated")
        counts = (count["violated"], count["held"], count["vacuous"], count["inconclusive"])
        found.append((one.name, one.result, *counts, broken or one.refused))
    return found


def headers() -> tuple[str, ...]:
    """Return the heads of `rows`."""
    return _HEADERS


def as_csv(judged: Sequence[Judged]) -> bytes:
    """Return a row for each verdict: log, policy, outcome, robustness, from_s, to_s, severity, message."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("log", "policy", "outcome", "robustness", "from_s", "to_s", "severity", "message"))
    for one in judged:
        if one.refused:
            writer.writerow(map(cell, (str(one.path), "", "refused", "", "", "", "", one.refused)))
        for verdict in one.verdicts:
            value = "" if verdict.robustness is None else verdict.robustness
            spans = (verdict.witness_from_s, verdict.witness_to_s) if verdict.outcome == "violated" else ("", "")
            told = (str(one.path), verdict.policy, verdict.outcome, value, *spans, verdict.severity, verdict.message)
            writer.writerow(map(cell, told))
    return text.getvalue().encode()


def as_html(judged: Sequence[Judged]) -> bytes:
    """Return one page without network: the table, then each log's verdicts."""
    parts = [_html_table(_HEADERS, rows(judged))]
    for one in judged:
        told = [
            (verdict.outcome, verdict.policy, "" if verdict.robustness is None else f"{verdict.robustness:+.3g}", why)
            for verdict in sorted(one.verdicts, key=lambda verdict: _FIRST.index(verdict.outcome))
            if (why := verdict.message) or verdict.outcome == "held"
        ]
        body = f"<p>{escape(one.refused)}</p>" if one.refused else _html_table(("outcome", "policy", "by", "why"), told)
        body = "".join(f"<p>Damaged: {escape(part)}.</p>" for part in one.lost) + body
        parts.append(f"<h2>{escape(one.name)} <small>{one.result}</small></h2>{body}")
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Logs</title><style>{CSS}'
    page = f"<!doctype html><html lang=en><head>{head}</style></head><body><main><h1>{len(judged)} logs judged</h1>"
    return (page + "".join(parts) + "</main></body></html>\n").encode()


def _html_table(heads: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    head = "".join(f"<th>{escape(word)}</th>" for word in heads)
    body = "".join("<tr>" + "".join(map(_html_cell, row)) + "</tr>" for row in lines)
    return f"<div class=scroll><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def _html_cell(value: object) -> str:
    """Return a cell; what is long, such as names of files, is broken into lines."""
    text = str(value)
    wraps = ' class="words" style="min-width:26ch;overflow-wrap:anywhere"' if len(text) > _LONG else ""
    return f"<td{wraps}>{escape(text)}</td>"


def as_json(judged: Sequence[Judged]) -> list[Mapping[str, Any]]:
    """Return what scripts read: file, result, judgement or why it was refused."""
    return [
        {"file": in_unicode(one.path), "result": one.result, "judgement": one.judgement, "refused": one.refused}
        for one in judged
    ]
