"""Tokens that vanish: one worker is gone at once, many together mean that the router was away, not they.

A router that restarts takes every token with it although the workers fly on. Freeing all their leases would fly
everything twice and count against test cases that did nothing, so those who vanish together get one lease time to
come back.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

SETTLE_S = 0.15  # tokens that vanish within this time vanished together
TOGETHER_MIN = 2
TOKENS_MAX = 2_000  # of a key: as many workers as may be there, each in two lives
TOGETHER_SHARE = 0.5  # of the workers known

Who = tuple[str, str, str]  # worker, stage, session


class _Gone(NamedTuple):
    at_s: float
    until_s: float | None  # None until it is known whether others went too


class Liveness:
    """Who is there, who vanished, and whose absence is certain."""

    def __init__(self, patience_s: float, key_of: Callable[[str], str] = lambda _: "") -> None:
        """Have patience, in seconds; `key_of` tells whose key a worker's name begins with, empty where nobody's."""
        self._patience_s, self.key_of = patience_s, key_of
        self._of_key: Counter[str] = Counter()
        self._here: set[Who] = set()
        self._gone: dict[Who, _Gone] = {}
        self._awaited: dict[Who, float] = {}  # joined without a token: until when one is waited for

    def back(self, who: Who) -> bool:
        """Note that a token is there; False if its key has as many already as are heeded."""
        self._gone.pop(who, None)
        if who not in self._here:
            key = self.key_of(who[0])
            if key and self._of_key[key] >= TOKENS_MAX:
                return False
            self._of_key[key] += bool(key)
        self._awaited.pop(who, None)
        self._here.add(who)
        return True

    def joined(self, who: Who, now_s: float) -> None:
        """Note that a worker has joined: it is absent where no token of it shows, for none could vanish."""
        if who not in self._here:
            self._awaited.setdefault(who, now_s + self._patience_s)

    def vanished(self, who: Who, now_s: float) -> None:
        """Note that a token vanished."""
        if who in self._here:
            self._gone.setdefault(who, _Gone(now_s, None))

    def is_gone(self, who: Who) -> bool:
        """Return whether a token has vanished, certain or not."""
        return who in self._gone

    def due(self, now_s: float) -> list[Who]:
        """Return whose absence is certain now; each is returned once."""
        fresh = [who for who, gone in self._gone.items() if gone.until_s is None]
        if fresh and now_s - min(self._gone[who].at_s for who in fresh) >= SETTLE_S:
            together = len(fresh) >= TOGETHER_MIN and len(fresh) >= TOGETHER_SHARE * len(self._here)
            for who in fresh:
                at_s = self._gone[who].at_s
                self._gone[who] = _Gone(at_s, at_s + (self._patience_s if together else 0.0))
        certain = [who for who, gone in self._gone.items() if gone.until_s is not None and gone.until_s <= now_s]
        for who in certain:
            del self._gone[who]
            self._here.discard(who)
            key = self.key_of(who[0])
            self._of_key[key] -= bool(key)
        late = [who for who, until_s in self._awaited.items() if until_s <= now_s]
        for who in late:
            del self._awaited[who]
        return certain + late
