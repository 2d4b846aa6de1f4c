"""The firmware's settings as its own command line lists them: name, range or words, default."""

from __future__ import annotations

import re
from collections.abc import Iterator

import msgspec

_RANGE = re.compile(r"^Allowed range: (-?\d+) - (-?\d+)")
_LINE = re.compile(r"^(\w+) = (.*)$")


class BetaflightSetting(msgspec.Struct, frozen=True, kw_only=True):
    """One setting that holds one number or one of a few words (`words`; then its number is the place among them).

    Settings that hold a text or several numbers are not listed.
    """

    name: str
    default: float
    low: float
    high: float
    words: tuple[str, ...] = ()

    def why_not(self, value: float) -> str:
        """Return what would be taken, where a value is not; empty where it is."""
        if self.low <= round(value) <= self.high:
            return ""
        words = f" ({', '.join(self.words)})" if self.words else ""
        return f"{self.low:g} to {self.high:g}{words}"

    def value_text(self, value: float) -> str:
        """Return a value as the command line takes it."""
        return self.words[round(value)] if self.words else str(round(value))


def read_settings(listing: str) -> Iterator[BetaflightSetting]:
    """Yield the settings in the answer to `get`."""
    for block in listing.replace("\r", "").split("\n\n"):
        head = next((match for match in map(_LINE.match, block.splitlines()) if match), None)
        if head is not None:
            found = _setting(head[1], head[2], block.splitlines())
            if found is not None:
                yield found


def _setting(name: str, value: str, lines: list[str]) -> BetaflightSetting | None:
    for line in lines:
        span = _RANGE.match(line)
        if span and re.fullmatch(r"-?\d+", value):
            return BetaflightSetting(name=name, default=float(value), low=float(span[1]), high=float(span[2]))
        if line.startswith("Allowed values: "):
            words = tuple(line.removeprefix("Allowed values: ").split(", "))
            if value in words:
                place = float(words.index(value))
                return BetaflightSetting(name=name, default=place, low=0.0, high=len(words) - 1.0, words=words)
    return None
