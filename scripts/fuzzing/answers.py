"""A model server that answers anything: valid answers made wrong in text, in JSON and in bytes, over HTTP in memory."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from typing import Any

import httpx
import msgspec
import numpy as np
from farm_doubles import POLICY, TEMPLATE
from mutations import SURROGATE, drawn, torn

from saflite.contract import wire
from saflite.contract.test_case import Obstacle, TestCase
from saflite.contract.work import Report, Result, ScoreResult, ScoreWork
from saflite.runtime.clock import WallClock
from saflite.runtime.stages import brief_of
from saflite.scorer_pool.llm import http
from saflite.scorer_pool.work import ScorerPool

LABELS = {"openai": "openai:m@http://127.0.0.1:9/v1", "ollama": "ollama:m@127.0.0.1:9"}
STATUSES = (201, 204, 307, 400, 401, 404, 418, 422, 500, 502, 999)  # being busy only takes time
LONG_LINE = b"x" * (3 * 2**20)


class Server(httpx.AsyncBaseTransport):
    """Answers every request; `wrong` says whether the next answer is made wrong."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.wrong, self.asked = rng, False, 0

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Answer as the server of that path does, or nearly so."""
        self.asked += 1
        body = self._body(request)
        status = 200
        if self.wrong and self.rng.random() < 0.05:
            status = STATUSES[int(self.rng.integers(len(STATUSES)))]
        parts = _Parts(body) if not (self.wrong and self.rng.random() < 0.002) else _Parts(body, LONG_LINE, LONG_LINE)
        return httpx.Response(status, stream=parts, headers={"content-type": "application/json"})

    def _body(self, request: httpx.Request) -> bytes:
        asked = json.loads(request.content or b"{}")
        content = _text(self._drawn({"test_cases": self._rows(asked)}, 0.5))
        if self.wrong and self.rng.random() < 0.15:
            content = (content[: len(content) // 2], f"```json\n{content}\n```", content * 2, "[" * 100_000)[
                int(self.rng.integers(4))
            ]
        last = request.url.path.rpartition("/")[2]
        body = _text(self._drawn(_reply(last, content), 0.5)).encode("utf-8", "surrogatepass") + b"\n"
        return torn(body, self.rng) if self.wrong and self.rng.random() < 0.1 else body

    def _drawn(self, said: Any, share: float) -> Any:
        return drawn(said, self.rng)[0] if self.wrong and self.rng.random() < share else said

    def _rows(self, asked: dict[str, Any]) -> dict[str, Any]:
        form = asked.get("format") or asked.get("response_format", {}).get("json_schema", {}).get("schema", {})
        keys = form.get("properties", {}).get("test_cases", {}).get("properties", {}) if isinstance(form, dict) else {}
        return {
            key: {"interpretation": "near", "effect": "turns", "score": 5 + place % 3} for place, key in enumerate(keys)
        }


class _Parts(httpx.AsyncByteStream):
    def __init__(self, *parts: bytes) -> None:
        self._parts = parts

    async def __aiter__(self) -> AsyncIterator[bytes]:
        for part in self._parts:
            yield part


def _reply(last: str, content: str) -> dict[str, Any]:
    message = {"role": "assistant", "content": content}
    replies: dict[str, dict[str, Any]] = {
        "completions": {
            "choices": [{"index": 0, "message": message, "finish_reason": "stop"}],
            "usage": {"prompt_tokens": 10, "completion_tokens": 5},
        },
        "models": {"data": [{"id": "m"}]},
        "chat": {"model": "m", "message": message, "done": True, "done_reason": "stop", "eval_count": 5},
        "tags": {"models": [{"model": "m", "digest": "0" * 64, "size": 5}]},
        "show": {"capabilities": ["completion"], "model_info": {"a": 1}},
    }
    return replies.get(last, {"model": "m", "response": "", "done": True, "prompt_eval_count": 3})


def _text(said: Any) -> str:
    """Return plain values as JSON, with what JSON of others may hold: NaN, lone surrogates, bytes read as text."""
    text = json.dumps(said, default=lambda value: value.decode("latin-1") if isinstance(value, bytes) else None)
    return text.replace(json.dumps(SURROGATE)[1:-1], "\\ud800")


class Answers:
    """The scorer pool on such a server."""

    def __init__(self, server: str, rng: np.random.Generator) -> None:
        self.label, self.server, self.rng = LABELS[server], Server(rng), rng
        self._pool: ScorerPool | None = None
        self._left = 0

    def step(self) -> int:
        """Have one batch scored from wrong answers; returns how many there were. Raises what the pool raises."""
        http.BoundedTransport.__init__ = _on(self.server)  # type: ignore[method-assign]
        if self._pool is None or self._left <= 0:
            self._renew()
        assert self._pool is not None
        before, self.server.wrong = self.server.asked, True
        result = self._pool.do(self._work(), lambda: False)
        assert isinstance(result, ScoreResult), result
        wire.checked(result, Result)
        wire.checked(Report(worker="w", lease_id="l", epoch=1, result=result), Report)
        assert [score.test_case for score in result.scores], "a test case without a score"
        self._left -= 1
        if self.server.asked == before:  # the breaker is open
            self._left = 0
        return self.server.asked - before

    def _renew(self) -> None:
        if self._pool is not None:
            self._pool.close()
        self._pool, self._left = ScorerPool(brief_of, WallClock()), 8
        self.server.wrong = bool(self.rng.random() < 0.3)  # loading, too
        self._pool.do(self._work(), lambda: False)

    def _work(self) -> ScoreWork:
        return ScoreWork(
            round=0, model=self.label, shadow=(), policies=(POLICY,), test_cases=(self._case(), self._case()),
            rng_seed=1, deadline_s=1.0,
        )  # fmt: skip

    def _case(self) -> TestCase:
        x_m, y_m = (round(float(value), 4) for value in self.rng.uniform(0.0, 30.0, 2))
        box = Obstacle(length_m=5, width_m=4, height_m=20, x_m=x_m, y_m=y_m)
        return msgspec.structs.replace(TEMPLATE, scenario=msgspec.structs.replace(TEMPLATE.scenario, obstacles=(box,)))

    def close(self) -> None:
        """Close the pool."""
        if self._pool is not None:
            self._pool.close()


def _on(server: Server) -> Any:
    def connect(self: Any, inner: httpx.AsyncBaseTransport | None = None) -> None:
        self._inner = server

    return connect
