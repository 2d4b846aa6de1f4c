"""A language model on any OpenAI-compatible server (GPT class, vLLM, llama.cpp): `openai:<model>@<base url>`.

`openai:<model>+brief@<base url>` asks for scores without the two sentences about each test case.
The key comes from OPENAI_API_KEY (none is sent if it is empty, nor to a host that the user's own settings or campaign
file do not name: `scorer_pool/key_hosts.py`); prices, in dollars per million tokens, from
SAFLITE_PRICES as `<in>,<out>`. Without `@<base url>` the address is OPENAI_BASE_URL or https://api.openai.com/v1.
"""

from __future__ import annotations

import json
import logging
from typing import Any, NamedTuple

from saflite.contract.config import environment
from saflite.contract.errors import Refused, Unavailable
from saflite.scorer_pool.labels import check_no_password, split_brief
from saflite.scorer_pool.llm.chat import Busy, ChatResult, Question, tokens
from saflite.scorer_pool.llm.parse import ANSWER_CHARS_MAX, Reply
from saflite.scorer_pool.llm.scorer import LanguageModel, Prices
from saflite.scorer_pool.model import Tools

DEFAULT_URL = "https://api.openai.com/v1"
BODY_BYTES_MAX = 4 * ANSWER_CHARS_MAX
SAID_BYTES_MAX = 4096  # of a refusal, looked through for what was not taken
NO_LIMIT = None
"""Time limit of the client itself: the caller's deadlines hold."""


log = logging.getLogger(__name__)


NO_ROOM = "output limit was reached"
"""What api.openai.com says, instead of an answer that is cut off, where a model's thoughts took all tokens allowed."""


class _Unfit(Refused):
    """The server does not take the request as it is put; a simpler one may do."""

    said = ""


class _Place(NamedTuple):
    model: str
    url: str
    brief: bool


def _place(argument: str) -> _Place:
    name, _, url = argument.partition("@")
    model, brief = split_brief(name)
    url = url or environment("OPENAI_BASE_URL", DEFAULT_URL)
    check_no_password(url)
    if not model or not url.startswith(("http://", "https://")) or any(char.isspace() for char in argument):
        raise Refused("scorer model", expected="'openai:<model>@<base url>'", got=f"'openai:{argument}'")
    return _Place(model, url.rstrip("/"), brief)


def _key_for(url: str) -> str:
    from saflite.scorer_pool.key_hosts import KEY_HOSTS, host_of, may_have_key

    key = environment("OPENAI_API_KEY")
    if not key or may_have_key(url, environment("OPENAI_BASE_URL", DEFAULT_URL)):
        return key
    log.warning("OPENAI_API_KEY is not sent to %s: your settings do not name it; see %s", host_of(url), KEY_HOSTS)
    return ""


PRICE_MAX = 1e6


def prices(text: str) -> Prices:
    """Return the prices in `<in>,<out>` dollars per million tokens; empty text means none; raises Refused."""
    if not text:
        return Prices()
    try:
        per_in, per_out = (float(part) for part in text.split(","))
    except ValueError as fault:
        raise Refused("SAFLITE_PRICES", expected="two numbers, e.g. 0.15,0.60", got=repr(text[:80])) from fault
    if not (0.0 <= per_in <= PRICE_MAX and 0.0 <= per_out <= PRICE_MAX):  # nan neither
        raise Refused("SAFLITE_PRICES", expected=f"dollars per million tokens, 0 to {PRICE_MAX:g}", got=repr(text[:80]))
    return Prices(per_in, per_out)


class OpenAIChat:
    """One model on one OpenAI-compatible server."""

    def __init__(self, argument: str) -> None:
        logging.getLogger("httpx").setLevel(logging.WARNING)  # it tells of every single request
        self._model, self._url, self.brief = _place(argument)
        self._formats = ["json_schema", "json_object", ""]
        self._fixed: dict[str, Any] = {"temperature": 0, "seed": 0}
        self._limit = "max_tokens"
        self._key = _key_for(self._url)

    async def ask(self, question: Question) -> ChatResult:
        """Return the answer; see `Chat`. What a server does not take is left out from then on, a schema last."""
        while True:
            try:
                return _result(await self._post(self._body(question)))
            except _Unfit as fault:
                if NO_ROOM in fault.said:
                    return ChatResult(Reply(""), cut=True)
                self._simpler(fault)

    def _simpler(self, fault: _Unfit) -> None:
        """Put the next request more simply; raises the fault where it cannot be.

        Models that think take no `max_tokens`, a `temperature` of 1 only; some servers take no `seed`.
        """
        named = next((key for key in self._fixed if key in fault.said), None)
        if self._limit == "max_tokens" and "max_completion_tokens" in fault.said:
            self._limit = "max_completion_tokens"
        elif named is not None:
            del self._fixed[named]
            log.warning("%s takes no %s: its answers may differ from time to time", self._model, named)
        elif len(self._formats) > 1:
            self._formats.pop(0)
        else:
            raise fault

    async def load(self) -> str:
        """Find out whether the server answers and has the model: it loads models by itself."""
        listed = await self._request("GET", "/models", None)
        rows = listed.get("data")
        names = [row.get("id") for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
        if names and self._model not in names:
            known = ", ".join(str(name) for name in names[:10])
            raise Refused("openai model", where=self._url, expected=f"one of {known}", got=repr(self._model))
        return f"{self._model} answers at {self._url}"

    async def digest(self) -> str:
        """Return the model's name: such servers tell no more."""
        return f"{self._model}@{self._url}"

    def _body(self, question: Question) -> dict[str, Any]:
        body: dict[str, Any] = {
            "model": self._model,
            "messages": question.messages,
            self._limit: question.tokens_max,
            **self._fixed,
        }
        if self._formats[0] == "json_schema":
            schema = {"name": "scores", "schema": question.schema, "strict": True}
            body["response_format"] = {"type": "json_schema", "json_schema": schema}
        elif self._formats[0]:
            body["response_format"] = {"type": self._formats[0]}
        return body

    async def _post(self, body: dict[str, Any]) -> dict[str, Any]:
        return await self._request("POST", "/chat/completions", body)

    async def _request(self, verb: str, path: str, body: dict[str, Any] | None) -> dict[str, Any]:
        import httpx

        from saflite.scorer_pool.llm.http import BoundedTransport

        headers = {"Authorization": f"Bearer {self._key}"} if self._key else {}
        try:
            async with httpx.AsyncClient(timeout=NO_LIMIT, headers=headers, transport=BoundedTransport()) as client:
                async with client.stream(verb, f"{self._url}{path}", json=body) as response:
                    text = await _bounded(response)
        except (httpx.HTTPError, httpx.InvalidURL, UnicodeError) as fault:  # the last: a host that is no name in IDNA
            raise Unavailable(f"openai: {type(fault).__name__}: {fault}") from fault
        return self._understood(response.status_code, text)

    def _understood(self, status: int, text: bytes) -> dict[str, Any]:
        short = text[:200].decode("utf-8", "replace")
        if status in {429, 503}:
            raise Busy(f"openai: {status} {short}")
        if status in {400, 401, 403, 404, 422}:
            kind = _Unfit if status in {400, 422} else Refused
            fault = kind("openai request", where=self._url, expected="an answer", got=f"{status} {short}")
            if isinstance(fault, _Unfit):
                fault.said = text[:SAID_BYTES_MAX].decode("utf-8", "replace")
            raise fault
        if status != 200:
            raise Unavailable(f"openai: {status} {short}")
        try:
            found = json.loads(text)
        except (ValueError, RecursionError) as fault:
            raise Unavailable(f"openai: no JSON but {short}") from fault
        if not isinstance(found, dict):
            raise Unavailable(f"openai: no object but {short}")
        return found


async def _bounded(response: Any) -> bytes:
    """Return the body, its beginning only if it is longer than any honest answer."""
    parts: list[bytes] = []
    length = 0
    async for part in response.aiter_bytes():
        parts.append(part)
        length += len(part)
        if length > BODY_BYTES_MAX:
            break
    return b"".join(parts)


def _result(found: dict[str, Any]) -> ChatResult:
    try:
        choice = found["choices"][0]
        message = choice["message"]
        usage = found.get("usage") or {}
        thinking = message.get("reasoning_content") or message.get("reasoning") or ""
        return ChatResult(
            Reply(str(message.get("content") or ""), str(thinking)),
            tokens_in=tokens(usage.get("prompt_tokens")),
            tokens_out=tokens(usage.get("completion_tokens")),
            cut=choice.get("finish_reason") == "length",
        )
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as fault:
        raise Unavailable("openai: an answer without a message") from fault


class Model(LanguageModel):
    """A scorer model on an OpenAI-compatible server."""

    def __init__(self, argument: str, tools: Tools) -> None:
        chat = OpenAIChat(argument)
        super().__init__(
            f"openai:{argument}",
            chat,
            tools.clock,
            tools.load_deadline_s,
            prices(environment("SAFLITE_PRICES")),
            tools.transcript,
            brief=chat.brief,
        )
