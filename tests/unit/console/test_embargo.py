"""Findings of memory safety stay out of what others see until each is released."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import httpx
import msgspec
import pytest

from saflite.campaign.storage.store import Store
from saflite.console.operations.bridging import Bridge, _carry
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.embargo import ALL, ToldFaults, is_public
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.dashboard import source as source_module
from saflite.console.view.dashboard.source import EndpointSource, RunSource
from saflite.console.view.report import data
from saflite.contract import wire
from saflite.contract.circumstances import Circumstances
from saflite.contract.control import Answer, Verb
from saflite.contract.errors import Refused
from saflite.contract.events import Event, Fact, Flown, ViolationFound
from saflite.contract.flight import AUTOPILOT_ALIVE, Purpose
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.contract.verdict import Confirmation, Violation
from saflite.contract.work import JudgeResult, Result, Work
from saflite.recorder.export import export
from saflite.recorder.summary import Finding
from saflite.runtime.clock import WallClock
from saflite.runtime.webhook import Webhook

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles
from bridge_doubles import FAULT, DiesWhenFlownFor


def finding(memory_safety: bool) -> Finding:
    violation = Violation(
        fingerprint="ab" * 8,
        test_case="cd" * 8,
        policy="autopilot-alive",
        robustness=-1.0,
        severity="hard",
        confirmation="confirmed",
    )
    case = TestCase(target=Target(), scenario=Scenario(start=StartState()))
    circumstances = Circumstances(
        values="inside", link="trusted", stock=True, repeats="bitwise", memory_safety=memory_safety
    )
    return Finding(violation, case, circumstances=circumstances)


def test_only_memory_safety_is_kept_back_and_only_until_released() -> None:
    assert is_public(finding(False), ())
    assert not is_public(finding(True), ())
    assert not is_public(finding(True), ("cd",))
    assert is_public(finding(True), ("abab",))
    assert is_public(finding(True), (ALL,))


@pytest.mark.parametrize("purpose", ["confirm", "check"])
def test_a_test_case_any_flight_of_which_shows_a_fault_of_memory_is_kept_back_everywhere(
    tmp_path: Path, purpose: Purpose
) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(10), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.service = DiesWhenFlownFor(store, purpose)
    driver.run()
    store.close()
    with open_run(tmp_path / "run") as run:
        died = {row.test_case for row in run.flights() if row.ending == "autopilot_died"}
        found = {one.test_case for one in run.violations(similar=False)}
        assert died & found, "no find to keep back"
        summary, report = run.summary(), data.read(run)
        for form in ("yaml", "csv", "sarif", "junit"):
            told = "".join(path.read_text() for path in export(form, summary, tmp_path / form))
            assert not [name for name in died & found if name in told], form
        hidden = [one for one in run.violations(similar=False) if one.test_case in died]
        assert summary.withheld == report.withheld == len(hidden)
        assert {one.violation.test_case for one in report.exhibits} == found - died
        assert {one.test_case for one in RunSource(run.path).violations(public=True)} == found - died
        assert {one.violation.test_case for one in run.summary((ALL,)).findings} == found


class FarmElsewhere:
    """A farm at an endpoint that has told these facts, a few at a time."""

    def __init__(self, facts: tuple[Fact, ...]) -> None:
        self._told = [Event(seq=seq, at_unix_s=1.0, fact=fact) for seq, fact in enumerate(facts, 1)]

    def order(self, verb: Verb, text: str, number: int, *, within_s: float) -> Answer:
        """Tell what comes from a number on."""
        assert verb == "events"
        return Answer(accepted=True, events=tuple(wire.encode(one) for one in self._told[number - 1 : number + 1]))


def found(case: str, policy: str, message: str = "", confirmation: Confirmation = "confirmed") -> ViolationFound:
    violation = finding(False).violation
    return ViolationFound(
        violation=msgspec.structs.replace(
            violation, test_case=case * 16, policy=policy, message=message, confirmation=confirmation
        )
    )


def flown(case: str, index: int) -> Flown:
    return Flown(
        test_case=case * 16,
        flight_index=index,
        ending="autopilot_died",
        simulated_s=1.0,
        wall_s=1.0,
        worker="a",
        purpose="confirm",
    )


def test_a_death_that_a_find_explains_leaves_those_of_other_flights_unexplained() -> None:
    """The first flight died of what is no fault of memory, a re-flight of what no event says."""
    told = ToldFaults()
    facts: tuple[Fact, ...] = (
        flown("a", 0), found("a", AUTOPILOT_ALIVE, "PANIC: told to"), flown("a", 1),
        flown("b", 0), found("b", AUTOPILOT_ALIVE, "PANIC: told to"),
        found("c", AUTOPILOT_ALIVE, "PANIC: told to"), found("c", "upright", FAULT),
    )  # fmt: skip
    events = [Event(seq=seq, at_unix_s=1.0, fact=fact) for seq, fact in enumerate(facts, 1)]
    for event in (*events, events[0], Event(seq=99, at_unix_s=1.0, fact=flown("b", 1))):
        told.take(event)
    assert [name for name in "abcd" if name * 16 in told] == ["a", "c"]
    assert told.knows(events[-1])
    assert not told.knows(Event(seq=8, at_unix_s=1.0, fact=facts[0])), "what came out of order is not known"
    told.begin()
    assert "a" * 16 not in told
    assert not told.knows(events[0])


def test_a_farm_elsewhere_shows_every_find_and_to_viewers_none_of_a_test_case_with_a_fault_of_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    facts = (
        found("a", AUTOPILOT_ALIVE, FAULT), found("a", "upright"), found("a", "stays-near"),  # several, one of memory
        found("b", AUTOPILOT_ALIVE, FAULT, "similar"), found("b", "upright"),  # that of memory is known already
        flown("c", 1), found("c", "upright"),  # a re-flight died, of what nobody says
        flown("d", 0), found("d", AUTOPILOT_ALIVE, "PANIC: told to"), found("d", "upright"),
        found("e", "upright"), found("e", "stays-near"),
        flown("f", 0), found("f", AUTOPILOT_ALIVE, "PANIC: told to"), flown("f", 1), found("f", "upright"),
    )  # fmt: skip
    farm = FarmElsewhere(facts)
    monkeypatch.setattr(farm_lookup, "connect", lambda where: farm)
    source = EndpointSource(farm_lookup.Where(None, "tls/lab:7447", "night"))
    told = [(one.test_case[0], one.policy) for one in source.violations(public=False)]
    assert told == [
        (fact.violation.test_case[0], fact.violation.policy)
        for fact in facts
        if isinstance(fact, ViolationFound) and fact.violation.confirmation != "similar"
    ]
    shown = [(one.test_case[0], one.policy) for one in source.violations(public=True)]
    assert shown == [pair for pair in told if pair[0] in "de"]
    for name in "abcf":
        assert "upright" in source.find(name * 16, public=False)
        with pytest.raises(Refused):
            source.find(name * 16, public=True)
    assert all(policy in source.find("e" * 16, public=True) for policy in ("upright", "stays-near"))


def test_a_farm_elsewhere_that_never_ends_telling_is_listened_to_for_so_long(monkeypatch: pytest.MonkeyPatch) -> None:
    class Endless:
        """It has another find for whoever asks."""

        asked = 0

        def order(self, verb: Verb, text: str, number: int, *, within_s: float) -> Answer:
            self.asked += 1
            fact = found("a", f"rule-{number}")
            return Answer(accepted=True, events=(wire.encode(Event(seq=number, at_unix_s=1.0, fact=fact)),))

    farm = Endless()
    monkeypatch.setattr(farm_lookup, "connect", lambda where: farm)
    monkeypatch.setattr(source_module, "ANSWERS_MAX", 7)
    monkeypatch.setattr(source_module, "FOUND_MAX", 10)
    source = EndpointSource(farm_lookup.Where(None, "tls/lab:7447", "night"))
    assert [len(source.violations(public=False)) for _ in range(3)] == [7, 10, 10], "the first are kept"
    assert farm.asked == 21


class ReportsFaults(doubles.Service):
    """A farm whose violations are all told with a report of a fault of memory."""

    def do(self, work: Work) -> Result:
        """Judge with the report as the message."""
        result = super().do(work)
        if not isinstance(result, JudgeResult):
            return result
        verdicts = tuple(
            msgspec.structs.replace(one, message=FAULT, behaviour="heap-buffer-overflow in parse < read")
            for one in result.judgement.verdicts
        )
        return JudgeResult(judgement=msgspec.structs.replace(result.judgement, verdicts=verdicts))


def test_a_webhook_is_told_of_a_fault_of_memory_without_message_and_place(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(10), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.service = ReportsFaults(store.blobs)
    driver.run()
    store.close()
    bodies: list[str] = []

    def receive(request: httpx.Request) -> httpx.Response:
        bodies.append(request.content.decode())
        return httpx.Response(204)

    webhook = Webhook("http://127.0.0.1:9/finds", WallClock(), transport=httpx.MockTransport(receive))
    args = argparse.Namespace(run=tmp_path / "run", connect="")
    assert _carry(args, Bridge(frozenset({"violation"}), webhook, tmp_path / "cursor.json"))
    webhook.close()
    with open_run(tmp_path / "run") as run:
        told = run.violations()
        assert told, "no find to be told of"
        assert all("parse < read" in one.behaviour + one.message for one in told)
    assert len(bodies) == len(told)
    assert all(any(one.test_case in body for body in bodies) for one in told)
    assert not [body for body in bodies if "parse" in body or "Sanitizer" in body]
    assert all("memory safety withheld" in body for body in bodies)
