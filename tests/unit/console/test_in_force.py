"""What an operator changed while a campaign flew is told of the run at rest as it was of the farm that flew it."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.run_data.in_force import at_first, in_force
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.dashboard.source import RunSource
from saflite.console.view.report import data, page
from saflite.contract.control import Control
from saflite.contract.events import BudgetChanged

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

ORDERS = (
    Control(verb="budget", number=14),
    Control(verb="shadow", text="watcher"),
    Control(verb="scorer", text="broken"),
    Control(verb="budget", number=14),  # once more: its answer was lost
    Control(verb="scorer", text="another"),
    Control(verb="shadow", text=""),
)


def ordered(run: Path, *orders: Control) -> Driver:
    """Fly a campaign of 10 flights by `scripted` to its end, with orders given while it flies."""
    store = Store.create(run, doubles.campaign(10, lag=1), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=3)
    for order in orders:
        assert driver.books.control(order, driver.now).accepted
        while driver.books.status(driver.now).scorer_pending:
            driver.do("score", many=9)
    driver.run()
    return driver


def shown(run: Path) -> tuple[int, str, str]:
    """What the dashboard at rest and the report say: the budget, the report's tile of it, and its scorer."""
    with open_run(run) as folder:
        html = page.render(data.read(folder), "runs/x")
    tile, scorer = re.search(r"flights of ([^<]+)<", html), re.search(r"scorer ([^·]+) ·", html)
    assert tile
    assert scorer
    assert f"scorer {scorer[1]} ·" in RunSource(run).settings()
    return RunSource(run).figures().budget, tile[1], scorer[1]


def test_the_budget_and_scorer_in_force_at_the_end_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    driver = ordered(run, *ORDERS)
    status = driver.books.status(driver.now)
    assert driver.store is not None
    driver.store.close()
    assert (status.budget, status.flights, status.scorer) == (14, 14, "another")
    assert shown(run) == (14, "14 (10 at first)", "another (scripted at first)")
    with open_run(run) as folder:
        assert folder.facts(BudgetChanged) == [BudgetChanged(budget=14, previous=10)]
    assert main(["scorer", "list", str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scorer"] == "another"
    assert main(["watch", str(run), "--kind", "budget"]) == 1, "there are violations"
    assert "14 flights, 10 before" in capsys.readouterr().out


def test_without_orders_what_the_campaign_says_is_told(tmp_path: Path) -> None:
    run = tmp_path / "run"
    driver = ordered(run)
    assert driver.store is not None
    driver.store.close()
    assert shown(run) == (10, "10", "scripted")
    with open_run(run) as folder:
        assert in_force(folder) == at_first(folder.campaign)


def test_a_budget_raised_after_the_end_is_told_by_the_books_opened_again(tmp_path: Path) -> None:
    run = tmp_path / "run"
    driver = ordered(run, Control(verb="budget", number=12))
    assert driver.books.control(Control(verb="budget", number=15), driver.now).accepted
    driver.run()
    assert driver.store is not None
    driver.store.close()
    store = Store.open(run)
    assert store.rebuild().status(driver.now).budget == 15
    store.close()
    assert shown(run) == (15, "15 (10 at first, 2 changes)", "scripted")
