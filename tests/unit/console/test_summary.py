"""The end of a run: what it says, and the exit code scripts go by."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import FOUND, INFRASTRUCTURE, NOTHING_FOUND
from saflite.console.io import campaign_options
from saflite.console.run_data.conclusion import conclude
from saflite.contract.work import Failure, FlyWork, Result, Work
from saflite.runtime.campaign_runner import ExitSummary

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles


class CannotFly(doubles.Service):
    """A farm whose simulators fail on our side, all of them or all but one test case in so many."""

    def __init__(self, spared: int) -> None:
        super().__init__()
        self.spared, self._seen = spared, list[str]()

    def do(self, work: Work) -> Result:
        """Fail to fly; everything else works."""
        if isinstance(work, FlyWork):
            name = repr(work.test_case)
            self._seen += [name] if name not in self._seen else []
            if self._seen.index(name) >= self.spared:
                return Failure(message="no simulator here")
        return super().do(work)


def _ended(run_dir: Path, spared: int, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=6)
    store = Store.create(run_dir, campaign, template(campaign))
    driver = Driver(store.rebuild(), store)
    driver.service = CannotFly(spared)
    driver.run()
    store.close()
    code = conclude(run_dir, ExitSummary(True, "the budget is spent", None, 0), as_json=False)
    return code, capsys.readouterr().out


def test_a_run_in_which_nothing_could_be_flown_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = _ended(tmp_path / "run", 0, capsys)
    assert code == INFRASTRUCTURE
    assert "test cases set aside" in said
    assert "says nothing of the vehicle" in said


def test_a_run_in_which_something_was_flown_says_what_was_set_aside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = _ended(tmp_path / "run", 2, capsys)
    assert code in (NOTHING_FOUND, FOUND)
    assert "test cases set aside" in said
    assert "says nothing of the vehicle" not in said
