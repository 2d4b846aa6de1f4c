"""A language model on an Ollama server: `ollama:<tag>`, `ollama:<tag>@<host:port>`; default host from OLLAMA_HOST.

`ollama:<tag>+brief` asks for scores without the two sentences about each test case, which take most of the time.

The model is loaded under its own deadline and kept loaded, with a fixed context, temperature 0 and a schema.
"""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

from saflite.contract.config import environment
from saflite.contract.errors import Refused, Unavailable
from saflite.scorer_pool.labels import check_no_password, split_brief
from saflite.scorer_pool.llm.chat import Busy, ChatResult, Question, tokens
from saflite.scorer_pool.llm.parse import ANSWER_CHARS_MAX, Reply
from saflite.scorer_pool.llm.scorer import CONTEXT_TOKENS, LanguageModel
from saflite.scorer_pool.model import Tools

THINKING_TOKENS = 2048
"""More room for the answer of a model that thinks first."""

KEEP_ALIVE = "30m"
DEFAULT_HOST = "http://127.0.0.1:11434"


class _Place(NamedTuple):
    tag: str
    host: str
    brief: bool


def _place(argument: str) -> _Place:
    name, _, host = argument.partition("@")
    check_no_password(host)
    tag, brief = split_brief(name)
    if not tag or any(char.isspace() for char in argument):
        raise Refused(
            "scorer model", expected="'ollama:<tag>' or 'ollama:<tag>@<host:port>'", got=f"'ollama:{argument}'"
        )
    return _Place(tag, host or environment("OLLAMA_HOST", DEFAULT_HOST), brief)


class OllamaChat:
    """One model on one Ollama server."""

    def __init__(self, argument: str) -> None:
        import httpx
        import ollama

        from saflite.scorer_pool.key_hosts import may_have_key
        from saflite.scorer_pool.llm.http import BoundedTransport

        logging.getLogger("httpx").setLevel(logging.WARNING)  # it tells of every single request
        self._tag, host, self.brief = _place(argument)
        try:
            self._client = ollama.AsyncClient(
                host=host,
                timeout=None,  # the caller's deadlines hold
                follow_redirects=False,
                transport=BoundedTransport(),
            )
        except (ValueError, httpx.InvalidURL) as fault:
            raise Refused("scorer model", where=argument, expected="a host and port", got=str(fault)) from fault
        if not may_have_key(host, environment("OLLAMA_HOST", DEFAULT_HOST)):
            self._client._client.headers.pop("Authorization", None)  # the client's own, from OLLAMA_API_KEY
        self._more_tokens = 0

    async def ask(self, question: Question) -> ChatResult:
        """Return the answer; see `Chat`."""
        tokens_max = question.tokens_max + self._more_tokens
        options = {"temperature": 0, "num_ctx": CONTEXT_TOKENS, "num_predict": tokens_max, "seed": 0}
        result: ChatResult = await self._guarded(self._streamed(question, options))
        return result

    async def load(self) -> str:
        """Load the model with the context it will be asked with."""
        await self._guarded(
            self._client.generate(
                model=self._tag, prompt="", keep_alive=KEEP_ALIVE, options={"num_ctx": CONTEXT_TOKENS}
            )
        )
        about = await self._guarded(self._client.show(self._tag))
        thinks = "thinking" in (getattr(about, "capabilities", None) or [])
        self._more_tokens = THINKING_TOKENS if thinks else 0
        return f"{self._tag} is loaded{', it thinks first' if thinks else ''}"

    async def digest(self) -> str:
        """Return the digest of the model's files."""
        listed = await self._guarded(self._client.list())
        for model in listed.models:
            if model.model in {self._tag, f"{self._tag}:latest"}:
                return str(model.digest or "")
        raise Refused("ollama model", expected="a model the server has", got=repr(self._tag), fix="`ollama pull` it")

    async def _streamed(self, question: Question, options: dict[str, Any]) -> ChatResult:
        """Read the answer piece by piece, so that an endless one is cut off instead of filling the memory."""
        content, thinking, last = [], [], None
        length = 0
        stream = await self._client.chat(
            model=self._tag,
            messages=question.messages,
            format=question.schema,
            options=options,
            keep_alive=KEEP_ALIVE,
            stream=True,
        )
        async for part in stream:
            content.append(part.message.content or "")
            thinking.append(part.message.thinking or "")
            length += len(content[-1]) + len(thinking[-1])
            last = part
            if length > ANSWER_CHARS_MAX:
                break
        if last is None:
            raise Unavailable(f"ollama: {self._tag} closed the answer without a word")
        return ChatResult(
            Reply("".join(content), "".join(thinking)),
            tokens_in=tokens(last.prompt_eval_count),
            tokens_out=tokens(last.eval_count),
            cut=last.done_reason == "length" or not last.done,
        )

    async def _guarded(self, call: Any) -> Any:
        """Return what the call returns; name its faults in the pool's words."""
        import httpx
        import ollama

        try:
            return await call
        except ollama.ResponseError as fault:
            if fault.status_code in {429, 503}:
                raise Busy(f"ollama: {fault.error}") from fault
            if fault.status_code in {400, 404}:
                raise Refused(
                    "ollama model", expected="a model the server has", got=f"{self._tag}: {fault.error}"
                ) from fault
            raise Unavailable(f"ollama: {fault.error} ({fault.status_code})") from fault
        except (ConnectionError, httpx.HTTPError, httpx.InvalidURL) as fault:
            raise Unavailable(f"ollama: {type(fault).__name__}: {fault}") from fault
        except (ValueError, TypeError, AttributeError, RecursionError) as fault:  # what the client makes of nonsense
            raise Unavailable(f"ollama: {type(fault).__name__}: {fault}") from fault


class Model(LanguageModel):
    """A scorer model on an Ollama server."""

    def __init__(self, argument: str, tools: Tools) -> None:
        label, chat = f"ollama:{argument}", OllamaChat(argument)
        clock, deadline_s = tools.clock, tools.load_deadline_s
        super().__init__(label, chat, clock, deadline_s, transcript=tools.transcript, brief=chat.brief)
