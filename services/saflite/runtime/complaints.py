"""Unreadable messages counted by sender, so that a flood of them is told as a number, not as a flood of lines."""

from __future__ import annotations

COMPLAINT_S = 1.0
SENDERS_MAX = 10  # told apart: each is a line of the journal a second


class Complaints:
    """Unreadable messages, by sender and kind: the first is told at once, a flood once a second as a number."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._words: dict[str, str] = {}
        self._told_s: dict[str, float] = {}

    def add(self, where: str, words: str) -> None:
        """Note one; beyond `SENDERS_MAX` senders all count as one."""
        known = self._told_s.keys() | self._counts.keys()
        if where not in known and len(known) >= SENDERS_MAX:
            where = "many senders"
        self._counts[where] = self._counts.get(where, 0) + 1
        self._words[where] = words

    def due(self, now_s: float) -> list[tuple[str, str]]:
        """Return whom and what to tell now."""
        due = [where for where in self._counts if now_s - self._told_s.get(where, -COMPLAINT_S) >= COMPLAINT_S]
        told: list[tuple[str, str]] = []
        self._told_s = {where: at_s for where, at_s in self._told_s.items() if now_s - at_s < COMPLAINT_S}
        for where in due:
            count = self._counts.pop(where)
            self._told_s[where] = now_s
            told.append(
                (where, self._words[where] if count == 1 else f"{count} messages, the last: {self._words[where]}")
            )
        return told
