"""The end of a run: what it says, and the exit code scripts go by."""

from __future__ import annotations

import json
import re
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import FOUND, INFRASTRUCTURE, NOTHING_FOUND, NOTHING_JUDGED, REFUSED, main
from saflite.console.io import campaign_options
from saflite.console.run_data.conclusion import conclude
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.event_lines import event_line
from saflite.contract.blobs import Blobs
from saflite.contract.events import Event, ViolationFound
from saflite.contract.score import UNSCORED
from saflite.contract.verdict import NEVER_APPLIED, Verdict, Violation
from saflite.contract.work import Failure, FlyWork, JudgeResult, Result, ScoreWork, Work
from saflite.flight.autopilots.reference.describe import describe
from saflite.recorder import export
from saflite.runtime.campaign_runner import ExitSummary

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

Farm = Callable[[Blobs], doubles.Service]


class CannotFly(doubles.Service):
    """A farm whose simulators fail on our side, all of them or all but one test case in so many."""

    def __init__(self, blobs: Blobs, spared: int) -> None:
        super().__init__(blobs)
        self.spared, self._seen = spared, list[str]()

    def do(self, work: Work) -> Result:
        """Fail to fly; everything else works."""
        if isinstance(work, FlyWork):
            name = repr(work.test_case)
            self._seen += [name] if name not in self._seen else []
            if self._seen.index(name) >= self.spared:
                return Failure(message="no simulator here")
        return super().do(work)


class NobodyScores(doubles.Service):
    """A farm whose scorers fail on our side, all but `spared` times."""

    def __init__(self, blobs: Blobs, spared: int) -> None:
        super().__init__(blobs)
        self._spared = spared

    def do(self, work: Work) -> Result:
        """Fail to score; everything else works."""
        if isinstance(work, ScoreWork):
            self._spared -= 1
            if self._spared < 0:
                return Failure(message="no model here")
        return super().do(work)


class NeverApplies(doubles.Service):
    """A farm whose policy never applies, but to one test case in so many."""

    def __init__(self, blobs: Blobs, every: int) -> None:
        super().__init__(blobs)
        self._every, self._judged = every, 0

    def do(self, work: Work) -> Result:
        """Judge most flights vacuous; everything else as ever."""
        result = super().do(work)
        if not isinstance(result, JudgeResult):
            return result
        self._judged += 1
        (verdict,) = result.judgement.verdicts
        if self._judged % self._every:
            verdict = Verdict(policy=verdict.policy, outcome="vacuous", nearness=0.5, message=NEVER_APPLIED)
        else:
            verdict = Verdict(policy=verdict.policy, outcome="held", robustness=1.0)
        judgement = msgspec.structs.replace(result.judgement, verdicts=(verdict,), fingerprint="")
        return JudgeResult(judgement=judgement)


class InLoiter(doubles.Service):
    """A farm whose violations tell of a mode, by its number as judgements do."""

    def do(self, work: Work) -> Result:
        """Name a mode in each behaviour; everything else as ever."""
        result = super().do(work)
        if not isinstance(result, JudgeResult):
            return result
        told = tuple(
            msgspec.structs.replace(one, behaviour=f"{one.behaviour}, in mode 5" if one.behaviour else "")
            for one in result.judgement.verdicts
        )
        return JudgeResult(judgement=msgspec.structs.replace(result.judgement, verdicts=told))


def _ended(
    run_dir: Path,
    farm: Callable[[Blobs], doubles.Service],
    capsys: pytest.CaptureFixture[str],
    *,
    as_json: bool = False,
) -> tuple[int, str]:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=6)
    store = Store.create(run_dir, campaign, template(campaign), describe())
    driver = Driver(store.rebuild(), store)
    driver.service = farm(store.blobs)
    driver.run()
    store.close()
    code = conclude(run_dir, ExitSummary(True, "the budget is spent", None, 0), as_json=as_json)
    return code, capsys.readouterr().out


def test_a_run_in_which_nothing_could_be_flown_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = _ended(tmp_path / "run", lambda blobs: CannotFly(blobs, 0), capsys)
    assert code == INFRASTRUCTURE
    assert "test cases set aside" in said
    assert "says nothing of the vehicle" in said
    with open_run(tmp_path / "run") as run:
        (path,) = export.export("junit", run.summary(), tmp_path / "junit")
    assert 'errors="1"' in path.read_text()
    assert "no test case could be flown and judged" in path.read_text()


def test_a_run_in_which_something_was_flown_says_what_was_set_aside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = _ended(tmp_path / "run", lambda blobs: CannotFly(blobs, 2), capsys)
    assert code in (NOTHING_FOUND, FOUND)
    assert "test cases set aside" in said
    assert "says nothing of the vehicle" not in said


def test_a_run_in_which_the_rule_never_applied_says_so_and_no_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "run"
    code, said = _ended(run_dir, lambda blobs: NeverApplies(blobs, 1000), capsys)
    assert code == NOTHING_FOUND
    assert "policy min-obstacle-distance: vacuous: the rule never applied in 6 flights" in said
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
        assert set(database.execute("SELECT robustness, violated FROM judgements")) == {(None, "")}
        assert set(database.execute("SELECT state FROM endings")) == {("vacuous",)}
    report = (run_dir / "report.html").read_text()
    assert "vacuous: the rule never applied" in report
    with open_run(run_dir) as run:
        assert {row.robustness for row in run.flights()} == {None}
        (path,) = export.export("junit", run.summary(), tmp_path / "junit")
    assert "applied in no flight" in path.read_text()
    assert 'name="test cases without violation" value="6"' in path.read_text()
    assert main(["watch", str(run_dir), "--kind", "judged"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6
    assert all(line.endswith("vacuous: the rule never applied") for line in lines)


def test_every_event_is_told_in_words_with_its_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_dir = tmp_path / "run"
    _ended(run_dir, doubles.Service, capsys)
    assert main(["watch", str(run_dir)]) == FOUND
    lines = capsys.readouterr().out.splitlines()
    with open_run(run_dir) as run:
        events = list(run.events())
    assert len(lines) == len(events)
    for line in lines:
        assert re.fullmatch(r" +\d+  \d{4}-\d\d-\d\d \d\d:\d\d:\d\dZ  [a-zA-Z]+  \S.*", line), line
    assert not [line for line in lines if "('" in line or "items" in line or "((" in line]
    assert any("proposed  round 0: " in line for line in lines)
    assert any("scored  round 0: " in line for line in lines)
    assert main(["watch", str(run_dir), "--from", str(len(events) + 1)]) == NOTHING_FOUND
    assert main(["watch", str(run_dir), "--from", "999999"]) == REFUSED
    assert f"the run has {len(events)} events, got 999999" in capsys.readouterr().err


def test_what_the_books_object_to_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _ended(tmp_path / "run", doubles.Service, capsys)
    assert main(["resume", str(tmp_path / "run"), "--budget", "2"]) == REFUSED
    said = capsys.readouterr().err
    assert "refused: budget: expected at least " in said
    assert said.count("expected") == said.count("got") == 1


def test_junit_says_how_often_it_violated_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _ended(tmp_path / "run", doubles.Service, capsys)
    with open_run(tmp_path / "run") as run:
        (path,) = export.export("junit", run.summary(), tmp_path / "junit")
    text = path.read_text()
    assert re.search(r"violated again in \d+ of \d+(, only under its own noise)?, rate \d\.\d\d to \d\.\d\d[.,] ", text)
    assert "re-flights" not in text


def test_a_similar_find_is_told_in_the_words_of_the_others() -> None:
    like = Violation(
        fingerprint="f" * 16, test_case="c" * 16, policy="upright", robustness=-1.0, severity="hard",
        confirmation="similar", behaviour="upright, hard, tips over", representative="e" * 16,
    )  # fmt: skip
    told = event_line(Event(seq=7, at_unix_s=0.0, fact=ViolationFound(violation=like)))
    assert told.startswith("     7  1970-01-01 00:00:00Z  similar  ffffffffffffffff  upright -1.000 (hard)  tips over")
    assert told.endswith("as test case eeeeeeeeeeeeeeee, not flown again  test case cccccccccccccccc")


def test_the_summary_counts_in_how_many_flights_each_rule_applied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, said = _ended(tmp_path / "run", lambda blobs: NeverApplies(blobs, 3), capsys, as_json=True)
    counts = {"held": 2, "violated": 0, "vacuous": 4, "inconclusive": 0}
    assert json.loads(said)["policies"] == {"min-obstacle-distance": counts}


@pytest.mark.parametrize("spared", [0, 1])
def test_what_no_model_scored_is_the_score_of_none(
    spared: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "run"
    _ended(run_dir, lambda blobs: NobodyScores(blobs, spared), capsys)
    with open_run(run_dir) as run:
        answered = {score.scored_by for score in run.scores() if score.violated is not None}
        deciding = run.campaign.scorer.model
    assert UNSCORED in answered
    assert (deciding in answered) == bool(spared)
    assert main(["scorer", "list", str(run_dir), "--json"]) == NOTHING_FOUND
    told = json.loads(capsys.readouterr().out)["calibration"]
    assert {one["model"] for one in told} == answered - {UNSCORED}
    assert main(["scorer", "list", str(run_dir)]) == NOTHING_FOUND
    listed = capsys.readouterr().out
    assert (deciding in listed.partition("\n")[2].split()) == bool(spared)
    assert UNSCORED not in [line.split()[0] for line in listed.splitlines() if line]


@pytest.mark.parametrize("as_json", [False, True])
def test_modes_have_their_names_as_text_and_for_scripts(
    as_json: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = _ended(tmp_path / "run", InLoiter, capsys, as_json=as_json)
    assert code == FOUND
    assert "in LOITER" in said
    assert "in mode" not in said


def test_what_is_so_of_every_find_is_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = _ended(tmp_path / "run", doubles.Service, capsys)
    assert code == FOUND
    lines = said.splitlines()
    assert sum(line.startswith("  VIOLATION") for line in lines) > 1
    (common,) = (line for line in lines if line.startswith("  all of "))
    for question in ("values: ", "link needed: ", "build: "):
        assert question in common
        assert said.count(question) == 1


def test_a_run_that_ended_before_a_flight_was_judged_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=6)
    Store.create(tmp_path / "run", campaign, template(campaign), describe()).close()
    ended = ExitSummary(False, "0.1 minutes are over, as asked for", None, 0)
    assert conclude(tmp_path / "run", ended, as_json=False) == NOTHING_JUDGED
    said = capsys.readouterr().out
    assert "before a flight was judged" in said
    assert "recordings" not in said, "there is no such folder"
