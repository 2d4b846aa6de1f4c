"""Where a key of a policy file stands in its text, for those who are to mend it."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

NEAR_CHARS = 200  # of what is said of a fault: each word in it is looked for in the whole text


class Place(NamedTuple):
    """Where `key` stands in the text of a file: looked for when it is told, as nearly none is."""

    text: str
    file: str
    key: str

    def __str__(self) -> str:
        return f"{self.file} line {line_of(self.text, self.key)}"


def line_of(text: str, key: str, occurrence: int = 1) -> int:
    """Return the line on which `key` first stands as a key, a table or a word; 1 if nowhere."""
    starts = _starts(text, key)
    if len(starts) >= occurrence:
        return starts[occurrence - 1]
    return text.count("\n", 0, max(text.find(key), 0)) + 1


@lru_cache(maxsize=4)  # examples are looked for one by one
def _starts(text: str, key: str) -> list[int]:
    return [n for n, line in enumerate(_bare_lines(text), 1) if line.startswith(key)]


@lru_cache(maxsize=4)
def _bare_lines(text: str) -> list[str]:
    return [line.lstrip(' ["') for line in text.splitlines()]


def near(text: str, where: str, fault: str) -> str:
    """Return the line of what a fault names in backticks, line 1 if that stands nowhere."""
    said = fault[:NEAR_CHARS].replace(".", " ").split()
    words = [word.strip("`.$[]…") for word in said if "`" in word]
    line = next((line_of(text, word) for word in words if word and word in text), 1)
    return f"{where} line {line}"
