"""The commands that pages show, each read as the shell would."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "tests/README.md")),
    *sorted((ROOT / "deploy" / "docs").glob("*.md")),
]
PROGRAMS = ("saflite", "pip", "source", "cargo", "docker", "podman", "kubectl", "systemctl", "export", "ray", "python")
_CODE = re.compile(r"^(?: {4}|\$ )(\S.*)$")
_COMMENT = re.compile(r"\s#\s.*$")
_WORDS_ONLY = re.compile(r"^saflite(?: \w+)? \|| \[")
"""Overviews: `saflite watch | audit`, `saflite COMMAND [...]`."""


class PageCommand(NamedTuple):
    """One command as a page shows it."""

    page: str
    text: str

    @property
    def words(self) -> list[str]:
        """The words of it, without the redirection of its output and the sign that it runs beside."""
        return shlex.split(self.text.partition(" > ")[0].removesuffix("&").strip())


def commands() -> Iterator[PageCommand]:
    """Yield every command on a line of its own in a block of code, `a && b` as two."""
    for page in PAGES:
        for line in page.read_text(encoding="utf-8").splitlines():
            code = _CODE.match(line)
            shown = _COMMENT.sub("", code[1]) if code is not None else ""
            if not shown or _WORDS_ONLY.search(shown):
                continue
            for part in shown.split(" && "):
                text = part.strip()
                first = text.split(maxsplit=1)[0]
                if first in PROGRAMS or first.startswith("scripts/") or re.match(r"[A-Z_]+=\S* scripts/", text):
                    yield PageCommand(str(page.relative_to(ROOT)), text)
