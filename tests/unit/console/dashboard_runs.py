"""Runs for tests of the dashboard: real books, driven by hand, with the flights of the simulated farm."""

from __future__ import annotations

import sys
from pathlib import Path

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.io import campaign_options
from saflite.flight.autopilots.reference.describe import describe

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver


class QuickDriver(Driver):
    """A driver that does not check the whole state after each change."""

    def commit(self) -> None:
        """Commit what changed."""
        batch = self.books.drain()
        if self.store is not None:
            self.store.commit(batch)


def make_run(run_dir: Path, flights: int, *, rng_seed: int = 1, checked: bool = True) -> Path:
    """Make a run of so many first flights in `run_dir`."""
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=flights, rng_seed=rng_seed)
    store = Store.create(run_dir, campaign, template(campaign), describe())
    driver = (Driver if checked else QuickDriver)(store.rebuild(), store)
    driver.run()
    store.close()
    return run_dir
