"""Findings of memory safety stay out of what others see until each is released."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.storage.store import Store
from saflite.console.run_data.embargo import ALL, is_public
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.dashboard.source import RunSource
from saflite.console.view.report import data
from saflite.contract.circumstances import Circumstances
from saflite.contract.flight import Purpose
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.contract.verdict import Violation
from saflite.contract.work import FlyResult, FlyWork, Result, Work
from saflite.recorder.export import export
from saflite.recorder.summary import Finding

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

FAULT = "the firmware died: AddressSanitizer: heap-buffer-overflow in parse < read"


class DiesWhenFlownFor(doubles.Service):
    """A farm whose autopilot dies of a fault of memory in flights of one purpose."""

    def __init__(self, store: Store, purpose: Purpose) -> None:
        super().__init__(store.blobs)
        self._purpose = purpose

    def do(self, work: Work) -> Result:
        """Fly, and die where it is time to."""
        result = super().do(work)
        if isinstance(work, FlyWork) and isinstance(result, FlyResult) and work.purpose == self._purpose:
            died = msgspec.structs.replace(result.flight, ending="autopilot_died", message=FAULT)
            return msgspec.structs.replace(result, flight=died)
        return result


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
