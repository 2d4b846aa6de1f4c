"""The suite of buses over the bus in memory and (live) Zenoh."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from saflite.bus.base import Bus, Reply, matches
from saflite.bus.memory import MemoryNetwork
from saflite.bus.private_socket import PrivateSocket
from saflite.conformance.buses import Inbox, Stand, check_bus
from saflite.conformance.kit import Check, findings, name_of


@contextmanager
def memory() -> Iterator[Stand]:
    network = MemoryNetwork()

    def take(inbox: Inbox) -> Any:
        while inbox.empty() and network.step():
            pass
        return inbox.get_nowait()

    yield Stand(network.connect("books"), network.connect("worker"), network.connect, take)


@contextmanager
def zenoh() -> Iterator[Stand]:
    from saflite.bus.zenoh import open_client, open_router

    socket = PrivateSocket()
    endpoint = socket.endpoint
    opened = [open_router("books", endpoint), open_client("worker", endpoint)]

    def connect(name: str) -> Bus:
        opened.append(open_client(name, endpoint))
        return opened[-1]

    yield Stand(opened[0], opened[1], connect, lambda inbox: inbox.get(timeout=5))
    for bus in reversed(opened):
        bus.close()
    socket.close()


@pytest.mark.parametrize("check", check_bus(memory), ids=name_of)
def test_the_bus_in_memory(check: Check) -> None:
    assert findings([check]) == []


@pytest.mark.live
@pytest.mark.parametrize("check", check_bus(zenoh), ids=name_of)
def test_the_bus_over_zenoh(check: Check) -> None:
    assert findings([check]) == []


def test_a_bus_that_forgets_is_found_out() -> None:
    @contextmanager
    def forgetful() -> Iterator[Stand]:
        with memory() as stand:
            stand.books.announce = lambda key, payload: None  # type: ignore[method-assign]
            yield stand

    assert {one.check for one in findings(check_bus(forgetful))} == {
        "late_followers_are_given_the_past_in_order",
        "a_new_link_carries_all_on",
    }


@pytest.mark.live
def test_a_killed_process_is_noticed_at_once_and_its_asker_told() -> None:
    with zenoh() as stand:
        seen, answers, served = (queue.SimpleQueue[Any]() for _ in range(3))
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


@pytest.mark.live
def test_who_connects_anew_hears_that_what_it_asked_before_gets_no_answer() -> None:
    with zenoh() as stand:
        answers, served = (queue.SimpleQueue[Any]() for _ in range(2))
        stand.books.serve("farm/slow", served.put)
        stand.worker.ask("farm/slow", b"", "tag", answers.put, 60.0)
        request = stand.take(served)
        stand.worker.renew()
        assert stand.take(answers) == Reply("tag", None)
        request.reply(b"nobody waits for this any more")
        stand.worker.close()
        stand.worker.renew()  # neither left open nor a trouble


@pytest.mark.live
def test_where_no_new_link_can_be_had_the_old_one_stays() -> None:
    from saflite.bus.zenoh import open_client, open_router

    with PrivateSocket() as first:
        books, worker = open_router("books", first.endpoint), open_client("worker", first.endpoint)
        answers, served = (queue.SimpleQueue[Any]() for _ in range(2))
        books.serve("farm/work", served.put)
        Path(first.endpoint.partition("/")[2]).unlink()
        worker.renew()
        worker.ask("farm/work", b"still", "tag", answers.put, 5.0)
        assert served.get(timeout=5).payload == b"still"
        worker.close()
        books.close()


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
