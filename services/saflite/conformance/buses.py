"""What every bus promises: questions end once, facts reach late followers, tokens vanish with their owner.

from saflite.conformance.buses import Stand, check_bus
from saflite.conformance.kit import findings

assert findings(check_bus(open_stand)) == []      # open_stand() -> a context manager that gives a Stand
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, NamedTuple

from saflite.bus.base import Bus, Presence, Reply, Request, Sample
from saflite.conformance.kit import Check

Inbox = queue.SimpleQueue[Any]
BIG = b"\x00\xff" * (8 * 2**20)
FACTS = 20
TRIES = 5
LONG_S, SHORT_S = 3.0, 0.2  # simulated, where the bus has a clock of its own


class Stand(NamedTuple):
    """Two participants, a way to open more, and a way to take the next happening out of an inbox.

    `take` moves the bus on where nothing does so by itself; it raises queue.Empty if nothing comes.
    """

    books: Bus
    worker: Bus
    connect: Callable[[str], Bus]
    take: Callable[[Inbox], Any]


OpenStand = Callable[[], AbstractContextManager[Stand]]
Promise = Callable[[Stand], Iterator[str]]


def check_bus(open_stand: OpenStand) -> tuple[Check, ...]:
    """Return the checks of a bus; each opens a stand of its own."""
    promises: tuple[Promise, ...] = (
        question_and_answer_arrive_whole,
        nobody_serving_is_no_reply,
        time_running_out_is_no_reply,
        refusal_carries_the_words,
        only_the_first_answer_counts,
        an_answer_may_come_much_later,
        late_followers_are_given_the_past_in_order,
        what_nobody_follows_is_not_made,
        tokens_appear_and_vanish,
        a_new_link_carries_all_on,
        big_messages_pass,
    )
    return tuple(Check(promise.__name__, partial(_kept, promise, open_stand)) for promise in promises)


def question_and_answer_arrive_whole(stand: Stand) -> Iterator[str]:
    """A question arrives with its key, its sender and every byte; so does the answer."""
    payload = bytes(range(256)) * 100
    request, answers = _asked(stand, payload)
    yield from _equal("question", (request.key, request.sender), ("farm/work/fly", "worker"))
    yield from _equal("bytes of the question", request.payload, payload)
    request.reply(payload)
    yield from _equal("answer", stand.take(answers), Reply("tag", payload))


def nobody_serving_is_no_reply(stand: Stand) -> Iterator[str]:
    """A question nobody serves ends without an answer, not with an error."""
    answers: Inbox = queue.SimpleQueue()
    stand.worker.ask("farm/work/fly", b"", 7, answers.put, 1.0)
    yield from _equal("reply", stand.take(answers), Reply(7, None))


def time_running_out_is_no_reply(stand: Stand) -> Iterator[str]:
    """A question that is not answered in time ends."""
    served: Inbox = queue.SimpleQueue()
    answers: Inbox = queue.SimpleQueue()
    stand.books.serve("farm/work/*", served.put)
    stand.worker.ask("farm/work/fly", b"", 7, answers.put, SHORT_S)
    yield from _equal("reply", stand.take(answers), Reply(7, None))


def refusal_carries_the_words(stand: Stand) -> Iterator[str]:
    """Who cannot read a question says so in words."""
    request, answers = _asked(stand)
    request.refuse("expected a valid message")
    yield from _equal("reply", stand.take(answers), Reply("tag", None, "expected a valid message"))


def only_the_first_answer_counts(stand: Stand) -> Iterator[str]:
    """A second answer does no harm and reaches nobody."""
    request, answers = _asked(stand)
    request.reply(b"first")
    request.reply(b"second")
    yield from _equal("reply", stand.take(answers), Reply("tag", b"first"))
    stand.worker.ask("farm/nobody", b"", "next", answers.put, SHORT_S)
    yield from _equal("tag of what came next", stand.take(answers).tag, "next")


def an_answer_may_come_much_later(stand: Stand) -> Iterator[str]:
    """A question may be kept and answered later (long poll)."""
    request, answers = _asked(stand)
    other: Inbox = queue.SimpleQueue()
    stand.worker.ask("farm/nobody", b"", 1, other.put, SHORT_S)
    yield from _equal("other reply", stand.take(other), Reply(1, None))
    request.reply(b"late")
    yield from _equal("reply", stand.take(answers), Reply("tag", b"late"))


def late_followers_are_given_the_past_in_order(stand: Stand) -> Iterator[str]:
    """Who follows late is given the recent facts first, in order."""
    for number in range(FACTS):
        stand.books.announce("farm/event/flown", str(number).encode())
    facts: Inbox = queue.SimpleQueue()
    stand.worker.follow("farm/event/*", facts.put)
    past = [stand.take(facts) for _ in range(FACTS)]
    yield from _equal("past", past, [Sample("farm/event/flown", str(number).encode()) for number in range(FACTS)])
    stand.books.announce("farm/event/judged", b"new")
    yield from _equal("news", stand.take(facts), Sample("farm/event/judged", b"new"))


def what_nobody_follows_is_not_made(stand: Stand) -> Iterator[str]:
    """What is told only to those who follow reaches them, and is not even made where nobody does."""
    made: list[int] = []

    def fact() -> bytes:
        made.append(1)
        return b"told"

    stand.books.tell("farm/told/flown", fact)
    yield from _equal("facts made for nobody", len(made), 0)
    facts: Inbox = queue.SimpleQueue()
    stand.worker.follow("farm/told/*", facts.put)
    for _ in range(TRIES):  # following takes a moment to be known
        stand.books.tell("farm/told/flown", fact)
        try:
            yield from _equal("fact", stand.take(facts), Sample("farm/told/flown", b"told"))
        except queue.Empty:
            continue
        return
    yield f"a fact told {TRIES} times never reached who follows it"


def tokens_appear_and_vanish(stand: Stand) -> Iterator[str]:
    """Tokens already there are told first; one vanishes when its owner leaves."""
    seen: Inbox = queue.SimpleQueue()
    early = stand.connect("early")
    early.appear("farm/alive/fly/early")
    stand.books.watch("farm/alive/**", seen.put)
    yield from _equal("token already there", stand.take(seen), Presence("farm/alive/fly/early", True))
    stand.worker.appear("farm/alive/fly/worker")
    yield from _equal("new token", stand.take(seen), Presence("farm/alive/fly/worker", True))
    early.close()
    yield from _equal("token of who left", stand.take(seen), Presence("farm/alive/fly/early", False))


def a_new_link_carries_all_on(stand: Stand) -> Iterator[str]:
    """Who connects anew serves, follows and is seen as before, and is answered."""
    facts, served, seen, answers = (queue.SimpleQueue[Any]() for _ in range(4))
    stand.worker.follow("farm/event/*", facts.put)
    stand.worker.serve("farm/mine/*", served.put)
    stand.worker.appear("farm/alive/fly/worker")
    stand.worker.renew()
    yield from _equal("payload of a question", _asked(stand)[0].payload, b"question")
    stand.connect("late").watch("farm/alive/**", seen.put)
    yield from _equal("token", stand.take(seen), Presence("farm/alive/fly/worker", True))
    stand.books.announce("farm/event/flown", b"new")
    yield from _equal("fact", stand.take(facts), Sample("farm/event/flown", b"new"))
    stand.books.ask("farm/mine/state", b"how", "tag", answers.put, LONG_S)
    yield from _equal("question to it", stand.take(served).payload, b"how")


def big_messages_pass(stand: Stand) -> Iterator[str]:
    """16 MiB pass in both directions."""
    request, answers = _asked(stand, BIG)
    if request.payload != BIG:
        yield f"a question of {len(BIG)} bytes arrived as another one of {len(request.payload)}"
    request.reply(BIG)
    if stand.take(answers).payload != BIG:
        yield f"an answer of {len(BIG)} bytes did not arrive whole"


def _kept(promise: Promise, open_stand: OpenStand) -> Iterator[str]:
    with open_stand() as stand:
        yield from promise(stand)


def _equal(what: str, got: object, expected: object) -> Iterator[str]:
    if got != expected:
        yield f"{what}: expected {expected!r}, got {got!r}"


def _asked(stand: Stand, payload: bytes = b"question") -> tuple[Request, Inbox]:
    served: Inbox = queue.SimpleQueue()
    answers: Inbox = queue.SimpleQueue()
    stand.books.serve("farm/work/*", served.put)
    while True:  # a question may overtake the declaration it is meant for: then nobody answers, and it is asked again
        stand.worker.ask("farm/work/fly", payload, "tag", answers.put, LONG_S)
        try:
            return stand.take(served), answers
        except queue.Empty:
            continue
