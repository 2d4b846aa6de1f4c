"""The faulty bus: its trouble is as bad as asked, and the same for the same seed."""

from __future__ import annotations

from saflite.bus.base import Happening, Reply
from saflite.bus.faulty import FaultyNetwork, Trouble


def _transcript(rng_seed: int, trouble: Trouble, questions: int = 400) -> tuple[list[Happening], int, FaultyNetwork]:
    network = FaultyNetwork(rng_seed, trouble)
    books, worker = network.connect("books"), network.connect("worker")
    asked: list[Happening] = []
    answers: list[Happening] = []

    def serve(happening: Happening) -> None:
        asked.append(happening)
        assert not isinstance(happening, tuple)
        happening.reply(happening.payload)

    books.serve("work/*", serve)
    for number in range(questions):
        worker.ask("work/fly", str(number).encode(), number, answers.append, 5.0)
        network.run_until(network.now_s + 0.01)
    network.run_until(network.now_s + 10)
    return answers, len(asked), network


def test_every_question_ends_once_whatever_is_lost() -> None:
    answers, _, network = _transcript(1, Trouble(loss=0.3, duplicate=0.2))
    assert {reply.tag for reply in answers if isinstance(reply, Reply)} == set(range(400))
    assert len(answers) == 400
    unanswered = sum(1 for reply in answers if isinstance(reply, Reply) and reply.payload is None)
    assert 100 < unanswered < 250  # 1 - 0.7 * 0.7 of 400, less what a double saved
    assert network.lost > 100


def test_doubles_arrive_doubled() -> None:
    _, asked, network = _transcript(2, Trouble(loss=0.0, duplicate=0.5, delay_max_s=0.1))
    assert asked > 500
    assert network.doubled > 200


def test_order_changes() -> None:
    answers, _, _ = _transcript(3, Trouble(loss=0.0, duplicate=0.0, delay_max_s=0.5))
    order = [reply.tag for reply in answers if isinstance(reply, Reply)]
    assert order != sorted(order)  # type: ignore[type-var]


def test_a_cut_network_heals() -> None:
    network = FaultyNetwork(4, Trouble(loss=0.0, duplicate=0.0, delay_max_s=0.0))
    books, worker = network.connect("books"), network.connect("worker")
    books.serve("work/*", lambda request: request.reply(b"yes") if not isinstance(request, tuple) else None)
    answers: list[Happening] = []
    network.part(frozenset({"worker"}))
    worker.ask("work/fly", b"", 1, answers.append, 1.0)
    network.run_until(2.0)
    network.heal()
    worker.ask("work/fly", b"", 2, answers.append, 1.0)
    network.run_until(4.0)
    assert answers == [Reply(1, None), Reply(2, b"yes")]


def test_equal_seeds_give_equal_trouble() -> None:
    assert _transcript(5, Trouble())[0] == _transcript(5, Trouble())[0]
    assert _transcript(5, Trouble())[0] != _transcript(6, Trouble())[0]


def test_the_dead_receive_nothing() -> None:
    network = FaultyNetwork(7, Trouble(loss=0.0, duplicate=0.0, delay_max_s=0.5))
    books, worker = network.connect("books"), network.connect("worker")
    books.serve("work/*", lambda request: request.reply(b"yes") if not isinstance(request, tuple) else None)
    answers: list[Happening] = []
    worker.ask("work/fly", b"", 1, answers.append, 1.0)
    network.crash("worker")
    network.run_until(5.0)
    assert answers == []
