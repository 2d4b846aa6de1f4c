"""A run that was left with violations neither confirmed nor refuted says so wherever its result is told."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import FOUND, NOTHING_FOUND, main
from saflite.console.io import campaign_options
from saflite.console.run_data.conclusion import conclude
from saflite.contract.blobs import Blobs
from saflite.contract.verdict import Verdict
from saflite.contract.work import Failure, FlyWork, JudgeResult, JudgeWork, Result, Work
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime.campaign_runner import ExitSummary

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

POLICY = "min-obstacle-distance"
WORDS = "neither confirmed nor refuted"


class FliesOnce(doubles.Service):
    """A farm that flies each test case once: no re-flight comes about."""

    def do(self, work: Work) -> Result:
        """Fail to fly anything again; everything else works."""
        if isinstance(work, FlyWork) and work.flight_index:
            return Failure(message="no simulator here any more")
        return super().do(work)


def _stopped(driver: Driver) -> None:
    """Fly and judge until a violation waits for its re-flights, and stop there."""
    while not driver.books.status(driver.now).violations_pending:
        for stage in ("mutate", "score", "fly", "judge"):
            driver.do(stage)
        driver.now += 0.5
        driver.books.tick(driver.now)
        assert not driver.books.ended, "nothing was violated"


def _run(run_dir: Path, fly: Callable[[Driver], None], service: Callable[[Blobs], doubles.Service]) -> Path:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=6)
    store = Store.create(run_dir, campaign, template(campaign), describe())
    driver = Driver(store.rebuild(), store)
    driver.service = service(store.blobs)
    fly(driver)
    assert driver.books.status(driver.now).violations_confirmed == 0
    store.close()
    return run_dir


@pytest.fixture(params=[(_stopped, doubles.Service), (Driver.run, FliesOnce)], ids=["stopped", "ended"])
def unproven(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A run with violations of which nobody knows whether they show again: stopped early, or never flown again."""
    return _run(tmp_path / "run", *request.param)


def _conclusion(run_dir: Path, *, as_json: bool = False) -> int:
    return conclude(run_dir, ExitSummary(False, "signal SIGINT", None, 0), as_json=as_json)


def test_the_exit_code_and_the_summary_say_so(unproven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _conclusion(unproven) == FOUND
    assert WORDS in capsys.readouterr().out
    assert _conclusion(unproven, as_json=True) == FOUND
    assert json.loads(capsys.readouterr().out)["unproven"] >= 1


def test_the_report_says_so(unproven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(unproven), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unproven"] >= 1
    assert main(["report", str(unproven)]) == 0
    assert WORDS in capsys.readouterr().out
    text = (unproven / "report.html").read_text()
    assert "No violation was found" not in text
    assert WORDS in text


def test_exports_for_continuous_integration_fail(unproven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(unproven), "--format", "junit", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unproven"] >= 1
    suite = ElementTree.parse(unproven / "export-junit" / "junit.xml").getroot()
    failures = suite.findall("testcase/failure")
    assert int(suite.attrib["failures"]) == len(failures) >= 1
    assert int(suite.attrib["tests"]) == len(suite.findall("testcase"))
    assert all("unconfirmed" in one.attrib["message"] for one in failures)
    assert not [test for test in suite.findall("testcase") if "held on every flight" in test.attrib["name"]]
    assert main(["export", str(unproven), "--format", "sarif"]) == 0
    (run,) = json.loads((unproven / "export-sarif" / "violations.sarif").read_text())["runs"]
    assert [(one["ruleId"], one["level"]) for one in run["results"]] == [(POLICY, "warning")] * len(run["results"])
    assert run["results"]


def test_a_replay_of_what_is_proven_is_no_pass_and_all_flies_the_rest(
    unproven: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(unproven)]) == FOUND
    assert WORDS in capsys.readouterr().err
    main(["replay", str(unproven), "--all"])
    said = capsys.readouterr()
    assert not said.out.startswith("0 flights")
    assert WORDS not in said.err


class HoldsAgain(doubles.Service):
    """A farm in which only first flights violate."""

    def do(self, work: Work) -> Result:
        """Judge every re-flight as one that kept the rule."""
        result = super().do(work)
        if not (isinstance(work, JudgeWork) and work.flight.flight_index and isinstance(result, JudgeResult)):
            return result
        held = tuple(Verdict(policy=one.policy, outcome="held", robustness=1.0) for one in result.judgement.verdicts)
        return JudgeResult(judgement=msgspec.structs.replace(result.judgement, verdicts=held, fingerprint=""))


def test_what_was_refuted_is_told_as_before(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_dir = _run(tmp_path / "run", Driver.run, HoldsAgain)
    assert _conclusion(run_dir) == NOTHING_FOUND
    said = capsys.readouterr().out
    assert "flaky" in said
    assert WORDS not in said + (run_dir / "report.html").read_text()
    assert main(["replay", str(run_dir)]) == NOTHING_FOUND
    assert main(["export", str(run_dir), "--format", "junit"]) == 0
    suite = ElementTree.parse(run_dir / "export-junit" / "junit.xml").getroot()
    assert suite.attrib["failures"] == "0"
    assert suite.findall("testcase/skipped")
