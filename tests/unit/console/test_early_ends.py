"""Why a campaign ended before its budget was flown is told wherever its result is, and what broke is no success."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import FOUND, INFRASTRUCTURE, NOTHING_FOUND, NOTHING_JUDGED, main
from saflite.console.io import campaign_options
from saflite.console.operations import running
from saflite.console.run_data.conclusion import conclude
from saflite.console.run_data.run_folder import open_run
from saflite.console.run_data.standing import Standing
from saflite.contract.blobs import Blobs
from saflite.contract.test_case import Obstacle
from saflite.contract.verdict import Verdict
from saflite.contract.work import Failure, FlyResult, JudgeResult, MutateResult, MutateWork, Result, Work
from saflite.flight.autopilots.reference.describe import describe
from saflite.recorder import export
from saflite.runtime import stop_note
from saflite.runtime.campaign_runner import ExitSummary, _as_the_books_tell

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

BUDGET = 30
Proposes = Callable[[MutateWork, MutateResult], Result]


class Farm(doubles.Service):
    """A farm whose strategy does as it is told to from some round on, on a vehicle that breaks no rule if `safe`."""

    def __init__(self, blobs: Blobs, proposes: Proposes, *, safe: bool) -> None:
        super().__init__(blobs)
        self._proposes, self._safe = proposes, safe

    def do(self, work: Work) -> Result:
        """Do a piece of work."""
        result = super().do(work)
        if isinstance(work, MutateWork) and work.count and isinstance(result, MutateResult):
            return self._proposes(work, result)
        if self._safe and isinstance(result, JudgeResult):
            held = tuple(
                Verdict(policy=one.policy, outcome="held", robustness=1.0) for one in result.judgement.verdicts
            )
            return JudgeResult(judgement=msgspec.structs.replace(result.judgement, verdicts=held, fingerprint=""))
        if self._safe and isinstance(result, FlyResult):
            return FlyResult(flight=msgspec.structs.replace(result.flight, ending="completed"))
        return result


def raises_later(work: MutateWork, result: MutateResult) -> Result:
    """Raise from the third round on."""
    return Failure(message="ValueError: boom") if work.round > 1 else result


def raises_always(work: MutateWork, result: MutateResult) -> Result:
    """Raise from the first round on."""
    return Failure(message="ValueError: boom")


def dry_later(work: MutateWork, result: MutateResult) -> Result:
    """Propose nothing from the third round on."""
    return MutateResult(round=work.round, test_cases=()) if work.round > 1 else result


def dry_always(work: MutateWork, result: MutateResult) -> Result:
    """Propose nothing."""
    return MutateResult(round=work.round, test_cases=())


def one_for_all(work: MutateWork, result: MutateResult) -> Result:
    """Propose the same test case each time."""
    box = Obstacle(length_m=5, width_m=4, height_m=20, x_m=3.0, y_m=3.0)
    case = msgspec.structs.replace(
        work.template, scenario=msgspec.structs.replace(work.template.scenario, obstacles=(box,))
    )
    return MutateResult(round=work.round, test_cases=(case,) * work.count)


class Told(NamedTuple):
    """All that is told of a run."""

    code: int
    text: str
    warned: str
    data: dict[str, object]
    suite: ElementTree.Element
    sarif: dict[str, object]
    report: str


BROKE, DRY = "the strategy 'random_boxes' cannot propose: ValueError: boom", "the strategy proposes nothing new"


def _flown(run_dir: Path, proposes: Proposes, *, safe: bool) -> ExitSummary:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=BUDGET, strategy="random_boxes")
    store = Store.create(run_dir, campaign, template(campaign), describe())
    driver = Driver(store.rebuild(), store)
    driver.service = Farm(store.blobs, proposes, safe=safe)
    driver.run()
    store.close()
    return _as_the_books_tell(run_dir, ExitSummary(True, "the campaign is over", None, 0))


def _told(run_dir: Path, ended: ExitSummary, capsys: pytest.CaptureFixture[str]) -> Told:
    capsys.readouterr()
    code = conclude(run_dir, ended, as_json=False)
    said = capsys.readouterr()
    assert conclude(run_dir, ended, as_json=True) == code
    data = json.loads(capsys.readouterr().out)
    suite, sarif = _exported(run_dir)
    report = (run_dir / "report.html").read_text()
    return Told(code, said.out, said.err, data, suite, sarif, report)


@pytest.mark.parametrize("proposes", [raises_later, raises_always])
@pytest.mark.parametrize("safe", [True, False])
def test_a_strategy_that_broke_is_an_error_everywhere(
    proposes: Proposes, safe: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "run"
    told = _told(run_dir, _flown(run_dir, proposes, safe=safe), capsys)
    flights = told.data["flights"]
    assert isinstance(flights, int)
    assert (flights == 0) == (proposes is raises_always)
    found = not safe and proposes is raises_later
    assert told.code == (FOUND if found else INFRASTRUCTURE)
    assert f"ended: {BROKE} ({flights} of {BUDGET} flights)" in told.text
    assert BROKE in told.warned
    assert f"resume {run_dir} --budget {BUDGET}" in told.text
    assert (told.data["why"], told.data["failed"], told.data["budget"]) == (BROKE, True, BUDGET)
    shortfall = f"{flights} of {BUDGET} flights; ended: {BROKE}"
    assert [one.get("message") for one in told.suite.iter("error")] == [shortfall]
    assert told.suite.get("errors") == "1"
    assert told.suite.get("tests") == str(len(told.suite.findall("testcase")))
    assert told.sarif == {
        "executionSuccessful": False,
        "toolExecutionNotifications": [{"level": "error", "message": {"text": shortfall}}],
    }
    assert "cannot propose" in told.report
    assert main(["audit", str(run_dir)]) == 0


@pytest.mark.parametrize(
    ("proposes", "code"), [(dry_later, NOTHING_FOUND), (one_for_all, NOTHING_FOUND), (dry_always, NOTHING_JUDGED)]
)
def test_a_strategy_with_nothing_new_is_told_and_is_no_error(
    proposes: Proposes, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "run"
    told = _told(run_dir, _flown(run_dir, proposes, safe=True), capsys)
    flights = told.data["flights"]
    assert told.code == code
    assert f"ended: {DRY} ({flights} of {BUDGET} flights)" in told.text
    assert (told.data["why"], told.data["failed"]) == (DRY, False)
    properties = {one.get("name"): one.get("value") for one in told.suite.iter("property")}
    expected = {"flights": str(flights), "budget": str(BUDGET), "state": f"ended: {DRY}"}
    assert properties.items() >= expected.items()
    assert not list(told.suite.iter("error"))
    text = f"{flights} of {BUDGET} flights; ended: {DRY}"
    notes = [{"level": "note", "message": {"text": text}}]
    assert told.sarif == {"executionSuccessful": True, "toolExecutionNotifications": notes}
    assert DRY in told.report


def test_a_budget_that_was_flown_needs_no_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_dir = tmp_path / "run"
    told = _told(run_dir, _flown(run_dir, lambda _, result: result, safe=True), capsys)
    assert told.code == NOTHING_FOUND
    assert "ended: the budget is spent\n" in told.text
    assert not list(told.suite.iter("error"))
    assert told.sarif == {"executionSuccessful": True, "toolExecutionNotifications": []}


def _exported(run_dir: Path) -> tuple[ElementTree.Element, dict[str, object]]:
    """Return the JUnit suite and SARIF's invocation of a run as it stands."""
    with open_run(run_dir) as run:
        (junit,) = export.export("junit", run.summary(), run_dir.parent / "junit")
        (sarif,) = export.export("sarif", run.summary(), run_dir.parent / "sarif")
    (log,) = json.loads(sarif.read_text())["runs"]
    return ElementTree.parse(junit).getroot(), log["invocations"][0]


@pytest.mark.parametrize("flights", [0, 6, 10**9])
@pytest.mark.parametrize("note", ["", "signal SIGTERM", "5 minutes are over, as asked for"])
def test_only_a_run_that_came_to_its_end_is_exported_as_a_success(flights: int, note: str, tmp_path: Path) -> None:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=6)
    run_dir = tmp_path / "run"
    store = Store.create(run_dir, campaign, template(campaign), describe())
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=flights)
    store.close()
    if note:
        stop_note.note(run_dir, note)
    with open_run(run_dir) as run:
        ended = run.standing().state == "ended"
        flown = run.summary().flights
    assert ended == (flights > 6)
    suite, sarif = _exported(run_dir)
    errors = [one.get("message") for one in suite.iter("error")]
    notes = sarif["toolExecutionNotifications"]
    assert sarif["executionSuccessful"] is (ended or "as asked for" in note)
    assert suite.get("errors") == str(len(errors))
    if ended:
        assert (errors, notes) == ([], [])
    elif not note:  # killed: nobody noted why it stands still
        (text,) = errors
        assert text is not None
        assert text.startswith(f"{flown} of 6 flights; not running; no end is known: it was killed")
        assert notes == [{"level": "error", "message": {"text": text}}]
    else:
        assert errors == []
        if flown < 6 or "signal" in note:
            text = f"{flown} of 6 flights; not running: {note}"
            assert notes == [{"level": "note", "message": {"text": text}}]


def test_a_run_that_is_worked_on_is_not_exported_as_a_success(tmp_path: Path) -> None:
    for now in (Standing("running", "begun"), Standing("paused", "paused"), Standing("")):
        assert now.is_unfinished
        assert now.broke == ""
    assert not Standing("ended", "stopped").is_unfinished


def test_a_farm_that_broke_before_its_campaign_was_over_is_an_error_in_exports(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=6)
    run_dir = tmp_path / "run"
    Store.create(run_dir, campaign, template(campaign), describe()).close()
    stop_note.note(run_dir, "all of fly break again and again", failed=True)
    told = _told(run_dir, ExitSummary(False, "all of fly break again and again", None, 0, failed=True), capsys)
    assert told.code == INFRASTRUCTURE
    (error,) = told.suite.iter("error")
    assert error.get("message") == "0 of 6 flights; not running: all of fly break again and again"
    assert told.sarif["executionSuccessful"] is False
    stop_note.note(run_dir, "signal SIGINT")
    told = _told(run_dir, ExitSummary(False, "signal SIGINT", None, 0), capsys)
    assert told.code == NOTHING_JUDGED
    assert not list(told.suite.iter("error"))


def test_who_stops_the_report_is_told_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_dir = tmp_path / "my run"
    ended = _flown(run_dir, lambda _work, result: result, safe=True)

    def stopped(*_: object, **__: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(running, "conclude", stopped)
    with pytest.raises(KeyboardInterrupt, match=r"what was flown is kept; `.* report '.*my run'` writes the report"):
        running.follow(run_dir, lambda _on_status: ended, as_json=True)
