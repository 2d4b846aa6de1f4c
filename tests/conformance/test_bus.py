"""What every bus must do, over the bus in memory and (live) Zenoh."""

from __future__ import annotations

import queue
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest

from saflite.bus.base import Bus, Presence, Reply, Request, Sample, matches
from saflite.bus.memory import MemoryNetwork


class Stand(NamedTuple):
    """Two participants, a way to open more, and a way to take the next happening out of an inbox."""

    books: Bus
    worker: Bus
    connect: Callable[[str], Bus]
    take: Callable[[queue.SimpleQueue[Any]], Any]


def _memory() -> Iterator[Stand]:
    network = MemoryNetwork()

    def take(inbox: queue.SimpleQueue[Any]) -> Any:
        while inbox.empty() and network.step():
            pass
        return inbox.get_nowait()

    yield Stand(network.connect("books"), network.connect("worker"), network.connect, take)


def _zenoh() -> Iterator[Stand]:
    from saflite.bus.zenoh import open_client, open_router

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    opened = [open_router("books", endpoint), open_client("worker", endpoint)]

    def connect(name: str) -> Bus:
        opened.append(open_client(name, endpoint))
        return opened[-1]

    yield Stand(opened[0], opened[1], connect, lambda inbox: inbox.get(timeout=5))
    for bus in reversed(opened):
        bus.close()


KINDS = {"memory": _memory, "zenoh": _zenoh}


@pytest.fixture(params=["memory", pytest.param("zenoh", marks=pytest.mark.live)])
def stand(request: pytest.FixtureRequest) -> Iterator[Stand]:
    yield from KINDS[request.param]()


def _inbox() -> queue.SimpleQueue[Any]:
    return queue.SimpleQueue()


def _asked(stand: Stand, payload: bytes = b"question") -> tuple[Request, queue.SimpleQueue[Any]]:
    served, answers = _inbox(), _inbox()
    stand.books.serve("farm/work/*", served.put)
    while True:  # a question may overtake the declaration it is meant for: then nobody answers, and it is asked again
        stand.worker.ask("farm/work/fly", payload, "tag", answers.put, 3.0)
        try:
            return stand.take(served), answers
        except queue.Empty:
            continue


def test_question_and_answer_arrive_whole(stand: Stand) -> None:
    request, answers = _asked(stand, bytes(range(256)) * 100)
    assert (request.key, request.sender, request.payload) == ("farm/work/fly", "worker", bytes(range(256)) * 100)
    request.reply(b"answer")
    assert stand.take(answers) == Reply("tag", b"answer")


def test_nobody_serving_is_no_reply_not_an_error(stand: Stand) -> None:
    answers = _inbox()
    stand.worker.ask("farm/work/fly", b"", 7, answers.put, 1.0)
    assert stand.take(answers) == Reply(7, None)


def test_time_running_out_is_no_reply(stand: Stand) -> None:
    served, answers = _inbox(), _inbox()
    stand.books.serve("farm/work/*", served.put)
    stand.worker.ask("farm/work/fly", b"", 7, answers.put, 0.2)
    assert stand.take(answers) == Reply(7, None)


def test_refusal_carries_the_words(stand: Stand) -> None:
    request, answers = _asked(stand)
    request.refuse("expected a valid message")
    assert stand.take(answers) == Reply("tag", None, "expected a valid message")


def test_only_the_first_answer_counts(stand: Stand) -> None:
    request, answers = _asked(stand)
    request.reply(b"first")
    request.reply(b"second")
    assert stand.take(answers) == Reply("tag", b"first")
    stand.worker.ask("farm/nobody", b"", "next", answers.put, 0.2)
    assert stand.take(answers).tag == "next"


def test_an_answer_may_come_much_later(stand: Stand) -> None:
    request, answers = _asked(stand)
    other = _inbox()
    stand.worker.ask("farm/nobody", b"", 1, other.put, 0.3)
    assert stand.take(other) == Reply(1, None)
    request.reply(b"late")
    assert stand.take(answers) == Reply("tag", b"late")


def test_late_followers_are_given_the_past_in_order(stand: Stand) -> None:
    for number in range(20):
        stand.books.announce("farm/event/flown", str(number).encode())
    facts = _inbox()
    stand.worker.follow("farm/event/*", facts.put)
    past = [stand.take(facts) for _ in range(20)]
    assert past == [Sample("farm/event/flown", str(number).encode()) for number in range(20)]
    stand.books.announce("farm/event/judged", b"new")
    assert stand.take(facts) == Sample("farm/event/judged", b"new")


def test_tokens_appear_and_vanish(stand: Stand) -> None:
    seen = _inbox()
    early = stand.connect("early")
    early.appear("farm/alive/fly/early")
    stand.books.watch("farm/alive/**", seen.put)
    assert stand.take(seen) == Presence("farm/alive/fly/early", True)
    stand.worker.appear("farm/alive/fly/worker")
    assert stand.take(seen) == Presence("farm/alive/fly/worker", True)
    early.close()
    assert stand.take(seen) == Presence("farm/alive/fly/early", False)


def test_big_messages_pass(stand: Stand) -> None:
    big = b"\x00\xff" * (8 * 2**20)
    request, answers = _asked(stand, big)
    assert request.payload == big
    request.reply(big)
    assert stand.take(answers).payload == big


@pytest.mark.live
def test_a_killed_process_is_noticed_at_once_and_its_asker_told() -> None:
    for stand in _zenoh():
        seen, answers, served = _inbox(), _inbox(), _inbox()
        stand.books.watch("farm/alive/**", seen.put)
        dying = stand.connect("dying")
        dying.serve("farm/slow", served.put)
        dying.appear("farm/alive/fly/dying")
        assert stand.take(seen).present
        stand.worker.ask("farm/slow", b"", "tag", answers.put, 30.0)
        stand.take(served)
        began_s = time.monotonic()
        dying.close()
        assert stand.take(answers) == Reply("tag", None)
        assert not stand.take(seen).present
        assert time.monotonic() - began_s < 2


@pytest.mark.parametrize(
    ("pattern", "key", "expected"),
    [
        ("a/*", "a/b", True),
        ("a/*", "a/b/c", False),
        ("a/**", "a", True),
        ("a/**", "a/b/c", True),
        ("a/**/d", "a/b/c/d", True),
        ("a/*/c", "a/b/d", False),
        ("*", "a/b", False),
        ("a", "a", True),
    ],
)
def test_patterns_match_as_zenoh_says(pattern: str, key: str, expected: bool) -> None:
    assert matches(pattern, key) is expected


@pytest.mark.live
def test_patterns_agree_with_zenoh() -> None:
    zenoh = pytest.importorskip("zenoh")
    patterns = ["a/*", "a/**", "a/**/d", "a/*/c", "*", "**", "a", "a/b"]
    keys = ["a", "a/b", "a/b/c", "a/b/c/d", "b", "a/d", "a/x/c"]
    for pattern in patterns:
        for key in keys:
            assert matches(pattern, key) == zenoh.KeyExpr(pattern).intersects(zenoh.KeyExpr(key)), (pattern, key)
