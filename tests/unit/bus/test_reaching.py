"""How a client comes to a router that does not let it in yet: ever less often, and not all at once."""

from __future__ import annotations

import itertools
import threading
from typing import Any

import pytest
import zenoh

from saflite.bus import zenoh as bus
from saflite.contract.errors import Unavailable


class Herd:
    """Clients that never get in; each attempt takes as long as it is allowed to, and no time passes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self.looks = 0.0, 0
        self.attempts: list[tuple[float, float]] = []  # from, to
        monkeypatch.setattr(bus, "_open", self._open)
        monkeypatch.setattr(bus, "why_unreached", self._look)
        monkeypatch.setattr(threading, "Event", lambda: self)

    def come(self, name: str, patience_s: float) -> str:
        self.now_s, self.attempts, self.looks = 0.0, [], 0
        with pytest.raises(Unavailable) as fault:
            bus.open_client(name, "unixsock-stream//nowhere/bus", patience_s=patience_s)
        return str(fault.value)

    def wait(self, pause_s: float) -> None:
        self.now_s += pause_s

    def _open(self, config: dict[str, Any]) -> None:
        try_s = config["connect/timeout_ms"] / 1000
        self.attempts.append((self.now_s, self.now_s + try_s))
        self.now_s += try_s
        raise zenoh.ZError("Timeout! at /source")

    def _look(self, *_: object) -> str:
        self.looks += 1
        return "Connection refused"


def test_each_attempt_waits_longer_up_to_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    herd = Herd(monkeypatch)
    herd.come("fly-1", 600.0)
    lasted = [until_s - from_s for from_s, until_s in herd.attempts]
    assert lasted[:3] == pytest.approx([2.0, 4.0, 8.0])
    assert lasted[3:] == pytest.approx([10.0] * len(lasted[3:]))
    assert 600.0 <= herd.now_s < 640.0


def test_two_hundred_that_come_at_once_do_not_come_again_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A TLS router lets ten a second go that gave up half way; each second of them more came than that."""
    herd = Herd(monkeypatch)
    began: list[float] = []
    for number in range(200):
        herd.come(f"fly-{number}", 120.0)
        began += [from_s for from_s, _ in herd.attempts]
    late = [at_s for at_s in began if 40.0 < at_s < 100.0]
    busiest = max(len(list(some)) for _, some in itertools.groupby(sorted(late), key=int))
    assert busiest < 25
    assert len(late) / 60.0 < 10.0


def test_few_attempts_cost_the_router_a_second_link(monkeypatch: pytest.MonkeyPatch) -> None:
    herd = Herd(monkeypatch)
    herd.come("fly-1", 600.0)
    assert herd.looks <= len(herd.attempts) / 5


def test_who_gives_up_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    herd = Herd(monkeypatch)
    assert herd.come("console", 2.0) == "no router at unixsock-stream//nowhere/bus (tried 1 times): Connection refused"
