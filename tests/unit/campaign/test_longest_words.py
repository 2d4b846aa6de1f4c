"""Workers that say as much as a message may hold: what the books make of it, every reader can still read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from books_drive import Driver, doubles, new_books
from msgspec import inspect

from saflite.campaign.engine.exposure import ARMS_MAX
from saflite.campaign.engine.worker_registry import WORKERS_MAX
from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.contract import wire
from saflite.contract.bounds import TEXT_CHARS_MAX, WORD_CHARS_MAX
from saflite.contract.control import Answer, Control
from saflite.contract.events import Event
from saflite.contract.flight import Delivered
from saflite.contract.join import Join
from saflite.contract.names import LABEL_CHARS_MAX
from saflite.contract.rng import derive
from saflite.contract.test_case import Stimulus, TestCase
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import (
    Failure,
    FlyResult,
    HandedBack,
    JudgeResult,
    MutateResult,
    Result,
    ScoreResult,
    Stage,
    Work,
)
from saflite.runtime.admission import Terms, objection

MEANT = (
    "model",
    "scored_by",
    "policy",
    "worker",
    "name",
    "target",
    "vehicle",
)  # words that have to fit what was asked for
TROUBLE: tuple[Result, ...] = (Failure(message="x" * TEXT_CHARS_MAX), HandedBack(message="x" * TEXT_CHARS_MAX))


def _longest(value: Any, info: inspect.Type) -> Any:
    """Return a value in which every text that is for people is as long as its type lets it be."""
    match info:
        case inspect.StructType():
            fields = {
                field.name: _longest(getattr(value, field.name), field.type)
                for field in info.fields
                if field.name not in MEANT
            }
            if isinstance(value, TestCase):  # the one text that has to be a document
                fields["source"] = json.dumps({"note": "x" * (TEXT_CHARS_MAX - len('{"note": ""}'))})
            return msgspec.structs.replace(value, **fields)
        case inspect.UnionType():
            fitting = [one for one in info.types if getattr(one, "cls", None) is type(value)]
            fitting += [one for one in info.types if isinstance(value, str) and isinstance(one, inspect.StrType)]
            return _longest(value, fitting[0]) if fitting else value
        case inspect.VarTupleType():
            return tuple(_longest(one, info.item_type) for one in value)
        case inspect.StrType() if info.pattern is None and info.max_length is not None:
            return value.ljust(min(info.max_length, TEXT_CHARS_MAX), "x")
    return value


def _said(result: Result) -> Result:
    longest: Result = _longest(result, inspect.type_info(type(result)))
    return longest


def _work(driver: Driver, stage: Stage, worker: str, share: float) -> None:
    rng = derive(int(10 * driver.now), stage, worker)
    for lease in driver.ask(stage, worker, 2):
        trouble = TROUBLE[int(rng.integers(len(TROUBLE)))]
        done = driver.service.do(lease.work)
        receipt = driver.report(lease, trouble if rng.random() < share else _said(done), worker)
        assert receipt.status == "accepted", receipt.message[:500]


@pytest.mark.parametrize("share", [0.0, 0.4, 0.7])
def test_whatever_is_made_of_the_longest_words_can_be_read(share: float, tmp_path: Path) -> None:
    campaign = doubles.campaign(12, record="all")
    driver = Driver(
        (store := Store.create(tmp_path / "run", campaign, doubles.TEMPLATE, doubles.TARGET)).rebuild(), store
    )
    while not driver.books.ended:
        for stage in get_args(Stage):
            for worker in ("a", "b"):
                _work(driver, stage, worker, share)
        for verb in ("status", "events"):
            answer = driver.books.control(Control(verb=verb, number=1), driver.now)
            wire.decode(wire.encode(answer), Answer)
            for fact in answer.events:
                wire.decode(fact, Event)
        driver.now += 0.5
        driver.books.tick(driver.now)
        driver.commit()
    again = store.rebuild()
    again.begin(0.0, 1.7e9)
    again.validate()
    store.close()
    assert audit(tmp_path / "run")["clean"]


def _large(result: Result, share: float) -> Result:
    """Return a result of about this share of the bytes that the books may be given."""
    match result:
        case MutateResult():
            source = json.dumps({"note": "x" * round(share * 250_000)})
            many = tuple(Stimulus(at_s=9.0, kind="parameter", name=f"S{place}") for place in range(68))
            cases = tuple(msgspec.structs.replace(case, source=source, stimuli=many) for case in result.test_cases)
            return msgspec.structs.replace(result, test_cases=cases)
        case ScoreResult():
            long = msgspec.structs.replace(result.scores[0], reason="x" * 60_000, shadow=True)
            beside = (msgspec.structs.replace(long, model=f"m{place}") for place in range(round(share * 68)))
            return msgspec.structs.replace(result, scores=(*result.scores, *beside))
        case FlyResult():
            given = (Delivered(index=place, at_s=0.0, message="x" * 60_000) for place in range(round(share * 68)))
            return FlyResult(flight=msgspec.structs.replace(result.flight, delivered=tuple(given)))
        case JudgeResult():
            track = ((1.0, 2.0, 3.0, 4.0),) * round(share * 28_000)
            return JudgeResult(judgement=msgspec.structs.replace(result.judgement, track=track))
    return result


def test_a_status_can_be_read_while_scorers_with_the_longest_labels_are_changed() -> None:
    driver = new_books(4)
    labels = [f"m{place}:".ljust(LABEL_CHARS_MAX, "x") for place in range(8)]
    shadows, decides = Control(verb="shadow", text=",".join(labels[:7])), Control(verb="scorer", text=labels[7])
    for order in (shadows, decides):
        answer = driver.books.control(order, driver.now)
        assert answer.accepted, answer.message
        driver.commit()
        told = driver.books.control(Control(verb="status"), driver.now)
        assert wire.decode(wire.encode(told), Answer).status == told.status
    while driver.do("score"):  # each is warmed: the event names what was watched before
        driver.commit()
    told = driver.books.control(Control(verb="events", number=1), driver.now)
    assert all(wire.decode(one, Event) for one in wire.decode(wire.encode(told), Answer).events)


def test_names_of_models_are_given_once() -> None:
    driver = new_books(4)
    answer = driver.books.control(Control(verb="shadow", text="gap,gap"), driver.now)
    assert "different names" in answer.message


def test_the_largest_results_leave_no_work_that_nobody_can_read() -> None:
    driver = new_books(40, record="all", batch=30, shrink=False, candidates_per_round=30, flights_per_round=30, lag=1)
    while not driver.books.ended:
        for stage in get_args(Stage):
            for lease in driver.ask(stage, leases_max=16):
                receipt = driver.report(lease, _large(driver.service.do(lease.work), 1.0))
                assert receipt.status == "accepted", receipt.message[:500]
        driver.now += 0.5
        driver.books.tick(driver.now)


def test_what_is_larger_is_refused() -> None:
    driver = new_books(4, batch=30, candidates_per_round=40)
    refused: set[Stage] = set()
    while not driver.books.ended:
        for stage in ("mutate", "score", "fly", "judge"):
            for lease in driver.ask(stage):
                done = driver.service.do(lease.work)
                if stage not in refused:
                    receipt = driver.report(lease, _large(done, 1.2))
                    assert "of at most" in receipt.message, receipt
                    refused.add(stage)
                elif not isinstance(done, MutateResult) or done.test_cases:
                    assert driver.report(lease, done).status == "accepted"
        driver.now += 0.5
        driver.books.tick(driver.now)
    assert len(refused) == 4


class _NewArms(doubles.Service):
    """Says of each test case that another arm of a portfolio thought of it, in words as long as they may be."""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if not isinstance(result, MutateResult):
            return result
        named = (
            msgspec.structs.replace(
                case, origin=msgspec.structs.replace(case.origin, arm=_wordy(f"{result.round} {at}"))
            )
            for at, case in enumerate(result.test_cases)
        )
        return msgspec.structs.replace(result, test_cases=tuple(named))


def _wordy(text: str) -> str:
    """Return a word that takes as many bytes as any, as MessagePack and as JSON."""
    return text.ljust(WORD_CHARS_MAX // 2, "\x01").ljust(WORD_CHARS_MAX, "\U0001f600")


def test_a_status_of_as_many_workers_and_arms_as_there_can_be_is_read() -> None:
    driver = new_books(ARMS_MAX + 8, record="none", confirm_flights=0, flights_per_round=8)
    assert driver.store is not None
    driver.service = _NewArms(driver.store.blobs)
    driver.run(("a",))
    terms = Terms(driver.books.target, "1.0", str)
    card = Join(protocol=PROTOCOL, session="s", stage="record", host=_wordy(""), worker="w" * 64)
    while not objection(larger := _with_label(card, len(card.labels)), terms):
        card = larger
    for number in range(WORKERS_MAX):
        driver.books.join(msgspec.structs.replace(card, worker=f"{number:04}".ljust(64, "w")), driver.now)
    status = driver.books.status(driver.now)
    assert (len(status.workers), len(status.arms)) == (WORKERS_MAX, ARMS_MAX)
    assert card.labels, "a card that may be larger"
    assert sum(one.labels == card.labels for one in status.workers) > WORKERS_MAX - len(get_args(Stage)) - 1
    answer = Answer(accepted=True, status=status)
    for data in (wire.encode(answer), wire.encode_json(answer)):
        assert len(data) < wire.MESSAGE_BYTES_MAX // 2, "room for events beside it"
    assert wire.decode(wire.encode(answer), Answer) == answer


def _with_label(card: Join, number: int) -> Join:
    return msgspec.structs.replace(card, labels={**card.labels, f"{number}": "\x01" * 100})
