"""WaitingPoll polls: first come first served, cheap however many wait."""

from __future__ import annotations

from saflite.contract.work import Ask
from saflite.runtime.long_poll_queue import PASSED_OVER_MAX, Line, LongPollQueue

LINE: Line = ("fly", ())


class _Request:
    key, payload, sender, peer, damaged = "k", b"", "s", "", ""

    def reply(self, payload: bytes) -> None:
        raise AssertionError

    def refuse(self, text: str) -> None:
        raise AssertionError


def _long_polls(count: int) -> LongPollQueue:
    polls = LongPollQueue()
    for number in range(count):
        assert polls.add(_Request(), Ask(worker=f"w{number}", stage="fly", wait_s=5.0), now_s=0.1 * number)
    return polls


def _in_line(polls: LongPollQueue) -> list[str]:
    names = []
    for waiting in polls.to_try(LINE):
        names.append(waiting.ask.worker)
        polls.passed_over(LINE, waiting)
    return names


def test_a_poll_that_does_not_want_to_wait_is_not_kept() -> None:
    assert not LongPollQueue().add(_Request(), Ask(worker="w", stage="fly", wait_s=0.0), 0.0)


def test_a_worker_waits_once() -> None:
    polls = _long_polls(3)
    polls.add(_Request(), Ask(worker="w1", stage="fly", wait_s=5.0), 9.0)
    assert _in_line(polls) == ["w0", "w2", "w1"]


def test_those_passed_over_go_to_the_end_and_only_a_few_are_tried() -> None:
    polls = _long_polls(10)
    tried = []
    for line in polls.lines():
        for waiting in polls.to_try(line):
            tried.append(waiting.ask.worker)
            if not polls.passed_over(line, waiting):
                break
    assert tried == ["w0", "w1", "w2", "w3"]
    assert len(tried) == PASSED_OVER_MAX
    assert _in_line(polls)[:2] == ["w4", "w5"]


def test_polls_leave_when_granted_gone_or_out_of_time() -> None:
    polls = _long_polls(4)
    polls.granted(LINE, next(polls.to_try(LINE)))
    polls.forget("w3")
    assert polls.expired(5.0) == []
    assert [waiting.ask.worker for waiting in polls.expired(5.11)] == ["w1"]
    assert [waiting.ask.worker for waiting in polls.expired(99.0)] == ["w2"]
    assert len(polls) == 0
    assert polls.expired(100.0) == []
