"""The two server dialects without a server: labels, requests, and every kind of answer named in the pool's words."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import httpx
import ollama
import pytest

from saflite.contract.errors import Refused, Unavailable
from saflite.scorer_pool.llm.chat import Busy, Question
from saflite.scorer_pool.llm.scorer import CONTEXT_TOKENS
from saflite.scorer_pool.models.ollama import OllamaChat
from saflite.scorer_pool.models.openai import OpenAIChat, prices

QUESTION = Question([{"role": "user", "content": "?"}], {"type": "object"}, 100)
GOOD = {
    "choices": [{"message": {"content": "{}", "reasoning_content": "hm"}, "finish_reason": "length"}],
    "usage": {"prompt_tokens": 7, "completion_tokens": 3},
}


@pytest.mark.parametrize("argument", ["", "@host", "with space", "+brief"])
def test_ollama_label_needs_a_tag(argument: str) -> None:
    with pytest.raises(Refused):
        OllamaChat(argument)


@pytest.mark.parametrize("argument", ["", "@http://h/v1", "m@ftp://h", "m@not a url", "+brief@http://h/v1"])
def test_openai_label_needs_model_and_address(argument: str) -> None:
    with pytest.raises(Refused):
        OpenAIChat(argument)


def test_a_model_that_is_to_be_brief_is_asked_by_the_name_its_server_knows() -> None:
    for argument, brief in (("m+brief", True), ("m+brief@host:1", True), ("m", False), ("m+briefly", False)):
        ollama = OllamaChat(argument)
        assert (ollama.brief, ollama._tag) == (brief, "m+briefly" if "briefly" in argument else "m")
    openai = OpenAIChat("m+brief@http://h/v1")
    assert (openai.brief, openai._model, openai._url) == (True, "m", "http://h/v1")


def test_prices_are_two_numbers_or_none() -> None:
    assert prices("0.15,0.60").cost_usd(1_000_000, 2_000_000) == pytest.approx(1.35)
    assert prices("").cost_usd(1_000_000, 1_000_000) == 0.0
    for text in ("cheap", "nan,0", "0,inf", "-1,0", "1e9,0", "1,2,3", "0.15"):
        with pytest.raises(Refused, match="SAFLITE_PRICES"):
            prices(text)


class Scripted(OpenAIChat):
    """Answers with the statuses and bodies of its script instead of asking a server."""

    def __init__(self, *script: tuple[int, bytes]) -> None:
        super().__init__("m@http://127.0.0.1:9/v1")
        self.script = list(script)
        self.bodies: list[dict[str, Any]] = []

    async def _request(self, verb: str, path: str, body: dict[str, Any] | None) -> dict[str, Any]:
        self.bodies.append(body or {})
        return self._understood(*self.script.pop(0))


def ok(message: dict[str, Any]) -> tuple[int, bytes]:
    import json

    return 200, json.dumps(message).encode()


def test_openai_answer_is_read_with_thoughts_tokens_and_cut() -> None:
    chat = Scripted(ok(GOOD))
    result = asyncio.run(chat.ask(QUESTION))
    assert result.reply == ("{}", "hm")
    assert (result.tokens_in, result.tokens_out, result.cut) == (7, 3, True)
    body = chat.bodies[0]
    assert (body["temperature"], body["max_tokens"], body["response_format"]["type"]) == (0, 100, "json_schema")


def test_openai_server_without_schemas_is_asked_without_from_then_on() -> None:
    chat = Scripted((400, b"no schema"), (422, b"no json"), ok(GOOD), ok(GOOD))
    asyncio.run(chat.ask(QUESTION))
    asyncio.run(chat.ask(QUESTION))
    assert [body.get("response_format", {}).get("type") for body in chat.bodies] == [
        "json_schema",
        "json_object",
        None,
        None,
    ]


def refusal(message: str, param: str) -> tuple[int, bytes]:
    import json

    return 400, json.dumps({"error": {"message": message, "type": "invalid_request_error", "param": param}}).encode()


def test_a_model_that_thinks_is_asked_as_it_wants_to_be_from_then_on() -> None:
    """The refusals are those of api.openai.com for its models that think, as its users quote them."""
    tokens = (
        "Unsupported parameter: 'max_tokens' is not supported with this model. Use 'max_completion_tokens' instead."
    )
    warmth = "Unsupported value: 'temperature' does not support 0 with this model. Only the default (1) is supported."
    chat = Scripted(refusal(tokens, "max_tokens"), refusal(warmth, "temperature"), ok(GOOD), ok(GOOD))
    for _ in range(2):
        asyncio.run(chat.ask(QUESTION))
    assert len(chat.bodies) == 4
    for body in chat.bodies[2:]:
        assert (body["max_completion_tokens"], body["seed"]) == (100, 0)
        assert not {"max_tokens", "temperature"} & set(body)
        assert body["response_format"]["type"] == "json_schema"


def test_a_server_that_knows_no_seed_is_asked_without_from_then_on() -> None:
    chat = Scripted((400, b'Invalid JSON payload received. Unknown name "seed": Cannot find field.'), ok(GOOD))
    asyncio.run(chat.ask(QUESTION))
    assert "seed" not in chat.bodies[1]
    assert chat.bodies[1]["temperature"] == 0


def test_thoughts_that_took_all_tokens_are_an_answer_cut_off() -> None:
    said = "Could not finish the message because max_tokens or model output limit was reached. Please try again."
    assert asyncio.run(Scripted(refusal(said, "")).ask(QUESTION)).cut


def test_a_server_that_takes_nothing_is_asked_no_longer() -> None:
    chat = Scripted(*[(400, b"max_completion_tokens temperature seed")] * 6)
    with pytest.raises(Refused, match="temperature seed"):
        asyncio.run(chat.ask(QUESTION))
    assert len(chat.bodies) == 6


@pytest.mark.parametrize(
    ("status", "body", "kind"),
    [
        (429, b"slow down", Busy),
        (503, b"", Busy),
        (401, b"no key", Refused),
        (404, b"no model", Refused),
        (500, b"oops", Unavailable),
        (200, b"<html>", Unavailable),
        (200, b"[1]", Unavailable),
        (200, b'{"choices": []}', Unavailable),
        (200, b'{"choices": [{"message": null}]}', Unavailable),
        (200, b"[" * 100_000, Unavailable),
    ],
)
def test_openai_faults_are_named(status: int, body: bytes, kind: type[Exception]) -> None:
    with pytest.raises(kind):
        asyncio.run(Scripted((status, body)).ask(QUESTION))


def test_openai_key_never_stands_in_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-secret")
    with pytest.raises(Refused) as caught:
        asyncio.run(Scripted((401, b"no")).ask(QUESTION))
    assert "sk-secret" not in str(caught.value)


def test_openai_model_the_server_does_not_have_is_refused_on_loading() -> None:
    assert "answers" in asyncio.run(Scripted(ok({"data": [{"id": "m"}]})).load())
    with pytest.raises(Refused, match="other"):
        asyncio.run(Scripted(ok({"data": [{"id": "other"}]})).load())


async def raising(fault: Exception) -> None:
    raise fault


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (ollama.ResponseError("busy", 503), Busy),
        (ollama.ResponseError("not found", 404), Refused),
        (ollama.ResponseError("broken", 500), Unavailable),
        (ollama.ResponseError("in the middle of a stream"), Unavailable),
        (ConnectionError("no server"), Unavailable),
        (httpx.ReadError("cut"), Unavailable),
    ],
)
def test_ollama_faults_are_named(fault: Exception, kind: type[Exception]) -> None:
    with pytest.raises(kind):
        asyncio.run(OllamaChat("m")._guarded(raising(fault)))


class Part:
    """A piece of a streamed answer."""

    def __init__(self, content: str, done: bool = False, why: str = "") -> None:
        self.message = ollama.Message(role="assistant", content=content)
        self.done, self.done_reason = done, why
        self.prompt_eval_count = 5 if done else None
        self.eval_count = 2 if done else None


def streaming(chat: OllamaChat, parts: list[Part], seen: dict[str, Any]) -> None:
    async def stream() -> AsyncIterator[Part]:
        for part in parts:
            yield part

    async def answer(**asked: Any) -> Any:
        seen.update(asked)
        return stream()

    chat._client.chat = answer  # type: ignore[method-assign, assignment]


def test_ollama_is_asked_with_schema_fixed_context_and_kept_loaded() -> None:
    chat = OllamaChat("m")
    seen: dict[str, Any] = {}
    streaming(chat, [Part('{"a"'), Part(": 1}", done=True, why="stop")], seen)
    result = asyncio.run(chat.ask(QUESTION))
    assert result.reply.content == '{"a": 1}'
    assert (result.tokens_in, result.tokens_out, result.cut) == (5, 2, False)
    assert seen["format"] == QUESTION.schema
    assert seen["options"]["num_ctx"] == CONTEXT_TOKENS
    assert seen["options"]["temperature"] == 0
    assert seen["options"]["num_predict"] == 100
    assert seen["keep_alive"]


def test_ollama_answer_without_end_is_cut_off() -> None:
    chat = OllamaChat("m")
    streaming(chat, [Part("x" * 400_000) for _ in range(100)], {})
    result = asyncio.run(chat.ask(QUESTION))
    assert result.cut
    assert len(result.reply.content) <= 1_200_000
    streaming(chat, [], {})
    with pytest.raises(Unavailable):
        asyncio.run(chat.ask(QUESTION))
