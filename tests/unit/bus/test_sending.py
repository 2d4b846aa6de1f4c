"""Threads that send: each name's own, in order, bounded, and what waits at the end is still sent."""

from __future__ import annotations

import threading
from functools import partial

from saflite.bus import sending
from saflite.bus.sending import Senders

PATIENCE_S = 20.0


def _wait(go: threading.Event, begun: threading.Event | None = None) -> None:
    if begun is not None:
        begun.set()
    assert go.wait(PATIENCE_S)


def _nothing() -> None:
    pass


def test_one_that_is_held_up_holds_up_no_other_and_keeps_its_order() -> None:
    senders, go, done = Senders(), threading.Event(), threading.Event()
    sent: list[int] = []
    assert senders.send("slow", 1, lambda: _wait(go))
    for number in range(3):
        assert senders.send("slow", 1, partial(sent.append, number))
    assert senders.send("quick", 1, done.set)
    assert done.wait(PATIENCE_S)
    assert sent == []
    go.set()
    senders.close()
    assert sent == [0, 1, 2]
    assert not senders.send("quick", 1, done.set), "it takes no more once it is closed"


def test_what_waits_for_one_name_is_bounded_in_bytes_and_in_number() -> None:
    senders, go, begun = Senders(), threading.Event(), threading.Event()
    for name, size_bytes, wanted in (("long", sending.WAITING_BYTES_MAX // 4, 4), ("many", 1, sending.WAITING_MAX)):
        begun.clear()
        senders.send(name, 0, lambda: _wait(go, begun))
        assert begun.wait(PATIENCE_S)
        taken = sum(senders.send(name, size_bytes, _nothing) for _ in range(wanted + 10))
        assert taken == wanted
    assert senders.send("another", 1, go.set)
    senders.close()
