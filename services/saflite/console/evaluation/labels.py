"""Which logs are interesting: label files in the layouts there are, and which log a label belongs to."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.outside import parse_table, read_text

LAYOUTS = (("log", "interesting"), ("log_id", "shows_issue"))
"""Columns: name of the log, answer. The second is that of the published list of PX4 issues with logs."""

YES, NO, UNCLEAR = ("yes", "true", "1", "interesting"), ("no", "false", "0", "dull"), ("unclear", "")
LETTER_OR_DIGIT = r"[^\W_]"


class Labels(NamedTuple):
    """Answers by the name of the log, None for an unclear one."""

    answers: dict[str, bool | None]

    def name_for(self, path: Path) -> str:
        """Return the name under which a log is labelled, the longest that fits; empty if there is none.

        A name is a file name, its stem, or a part of the stem, as its beginning, between marks that are no letters or
        digits; or a path, of which the log's may have more before it, with or without the suffix.
        """
        fitting = [name for name in self.answers if fits(name, path)]
        return max(fitting, key=len, default="")

    def by_log(self, paths: Iterable[Path]) -> dict[Path, str]:
        """Return for each log the name under which it is labelled, empty if there is none.

        Raises Refused where one name means two logs called alike.
        """
        found = {path: self.name_for(path) for path in paths}
        met: dict[tuple[str, str], Path] = {}
        for path, name in found.items():
            other = met.setdefault((name, path.name), path)
            if name and other != path:
                expected = f"a label for each log called {path.name}: {other.as_posix()}, {path.as_posix()}, ..."
                raise Refused("labels", expected=expected, got=f"{name!r} for both", fix="label them by their paths")
        return found

    def without_log(self, paths: Iterable[Path]) -> tuple[str, ...]:
        """Return the names for which no log is there."""
        met = {self.name_for(path) for path in paths}
        return tuple(name for name in self.answers if name not in met)


def fits(name: str, path: Path) -> bool:
    """Return whether a label's name means this file."""
    if not name:
        return False
    if "/" in name:
        wanted = name.split("/")
        return any(list(one.parts[-len(wanted) :]) == wanted for one in (path, path.with_suffix("")))
    apart = rf"(?<!{LETTER_OR_DIGIT}){re.escape(name)}(?!{LETTER_OR_DIGIT})"
    return path.name == name or re.search(apart, path.stem) is not None


def read_labels(path: Path) -> Labels:
    """Return the labels in a CSV file; raises Refused for another layout, another answer, or a log labelled twice."""
    rows = parse_table(read_text(path, "labels"), "labels", str(path))
    layout = next((pair for pair in LAYOUTS if rows and set(pair) <= set(rows[0])), None)
    if layout is None:
        expected = "columns " + " or ".join(f"{name}, {answer}" for name, answer in LAYOUTS)
        got = ", ".join(map(str, rows[0])) if rows else "no rows"
        raise Refused("labels", where=str(path), expected=expected, got=got)
    answers: dict[str, bool | None] = {}
    for number, row in enumerate(rows, start=2):
        name, word = str(row[layout[0]]).strip(), str(row[layout[1]]).strip().lower()
        where = f"{path} line {number}"
        if word not in YES + NO + UNCLEAR:
            raise Refused(layout[1], where=where, expected="yes, no or unclear", got=repr(row[layout[1]]))
        if not name:
            raise Refused(layout[0], where=where, expected="the name of a log", got="none")
        if name in answers:
            raise Refused(layout[0], where=where, expected="a log not labelled before", got=repr(name))
        answers[name] = None if word in UNCLEAR else word in YES
    return Labels(answers)
