"""Tokens of an answer beyond what it should take: a model that thinks first, or is wordy, is cut off without them."""

from __future__ import annotations

MORE_TOKENS_MAX = 2048


class Allowance:
    """What the answers of one model have shown to be wanted: nothing until one is cut off, then more each time."""

    def __init__(self) -> None:
        self.more = 0

    def was_cut(self, tokens_max: int) -> None:
        """Grant more from now on: an answer came to the end of `tokens_max` tokens and of what was granted before."""
        self.more = min(MORE_TOKENS_MAX, max(2 * self.more, tokens_max))
