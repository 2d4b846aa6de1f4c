"""A farm over a link, time and a receiver, for tests of bridges to a webhook."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import msgspec

from saflite.bus.base import Inbox, Reply
from saflite.campaign.storage.store import Store
from saflite.console.operations.relaying import StoppableClock, Stopped
from saflite.contract import wire
from saflite.contract.cloud_event import CloudEvent
from saflite.contract.control import Answer, Control
from saflite.contract.errors import Unavailable
from saflite.contract.events import Event
from saflite.contract.flight import Purpose
from saflite.contract.work import FlyResult, FlyWork, Result, Work
from saflite.runtime.client import FarmClient

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

CAMPAIGN = doubles.campaign(1).name
FAULT = "the firmware died: AddressSanitizer: heap-buffer-overflow in parse < read"


class Clock(StoppableClock):
    """Virtual seconds; who waits lets the other thread work."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def sleep_s(self, duration_s: float) -> None:
        if self._stopped.wait(0.001):
            raise Stopped

    def wait_s(self, ended: threading.Event, duration_s: float) -> None:
        self.now_s += duration_s
        ended.wait(0.001)


class Farm:
    """Books that answer over a link, as many questions as said; `at_end` is called when a bridge leaves."""

    def __init__(self, driver: Driver, clock: Clock, *, answers: int = 10**9, page: int = 10**9) -> None:
        self._driver, self._clock, self._answers, self._page = driver, clock, answers, page
        self.at_end: Callable[[], None] = lambda: None

    def connect(self) -> FarmClient:
        if self._answers <= 0:
            raise Unavailable("nobody is there")
        return FarmClient(self, CAMPAIGN, self._clock)  # type: ignore[arg-type]

    def ask(self, _key: str, payload: bytes, tag: Any, inbox: Inbox, timeout_s: float) -> None:
        self._answers -= 1
        if self._answers < 0:
            self._clock.now_s += timeout_s
            inbox(Reply(tag, None))
            return
        answer: Answer = self._driver.books.control(wire.decode(payload, Control), self._driver.now)
        inbox(Reply(tag, wire.encode(msgspec.structs.replace(answer, events=answer.events[: self._page]))))

    def follow(self, _key: str, _inbox: Inbox) -> None:
        pass

    def renew(self) -> None:
        pass

    def access(self) -> str:
        return ""

    def close(self) -> None:
        self.at_end()

    def leaves(self) -> None:
        self._answers = 0


class Receiver:
    """Takes what is posted, once it is up."""

    def __init__(self, *, is_up: bool = True) -> None:
        self.code, self.taken = 204 if is_up else 503, list[Event]()

    def up(self) -> None:
        self.code = 204

    def receive(self, request: httpx.Request) -> httpx.Response:
        if self.code == 204:
            self.taken.append(wire.unpack_json(request.content, CloudEvent).data)
        return httpx.Response(self.code)


class DiesWhenFlownFor(doubles.Service):
    """A farm whose autopilot dies of a fault of memory in flights of one purpose."""

    def __init__(self, store: Store, purpose: Purpose) -> None:
        super().__init__(store.blobs)
        self._purpose = purpose

    def do(self, work: Work) -> Result:
        """Fly, and die where it is time to."""
        result = super().do(work)
        if isinstance(work, FlyWork) and isinstance(result, FlyResult) and work.purpose == self._purpose:
            died = msgspec.structs.replace(result.flight, ending="autopilot_died", message=FAULT)
            return msgspec.structs.replace(result, flight=died)
        return result
