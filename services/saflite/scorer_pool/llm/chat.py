"""The protocol of chat servers: one question, one answer in its own time, or the reason why there is none."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from saflite.contract.errors import Unavailable
from saflite.scorer_pool.llm.parse import Reply

TOKENS_MAX = 10**9  # of one answer
Messages = list[dict[str, str]]


class Busy(Unavailable):
    """The server has too much to do (503, 429): ask again a little later."""


class Question(NamedTuple):
    """One question: messages, JSON schema of the answer (a hint), and the longest answer that makes sense."""

    messages: Messages
    schema: dict[str, Any]
    tokens_max: int


class ChatResult(NamedTuple):
    """The answer of a server and what it took; `cut` where it stopped at the longest answer allowed."""

    reply: Reply
    tokens_in: int = 0
    tokens_out: int = 0
    cut: bool = False


def tokens(said: Any) -> int:
    """Return how many tokens a server says it took, 0 where it says nothing that can be believed."""
    is_count = isinstance(said, int) and not isinstance(said, bool)
    return said if is_count and 0 <= said <= TOKENS_MAX else 0


class Chat(Protocol):
    """A server with one model. Deadlines are the caller's: a call that is cancelled must stop asking."""

    async def ask(self, question: Question) -> ChatResult:
        """Return the answer; raises Busy, Unavailable, or Refused where the server will never answer this."""
        ...

    async def load(self) -> str:
        """Load the model and return a line about it; raises Busy, Unavailable or Refused (no such model)."""
        ...

    async def digest(self) -> str:
        """Return what identifies the model's weights or version; raises Unavailable or Refused."""
        ...
