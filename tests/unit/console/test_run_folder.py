"""A run folder read: every flight counted once."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from saflite.campaign.storage.store import Store
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.report.data import calibrations

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles


def test_a_flight_answers_one_score_of_a_model(tmp_path: Path) -> None:
    """A test case that comes up in several rounds is scored in each and flown once."""
    campaign = doubles.campaign(60, rng_seed=1, random_share=0.4)
    store = Store.create(tmp_path / "run", campaign, doubles.TEMPLATE, doubles.TARGET)
    Driver(store.rebuild(), store).run()
    store.close()
    with open_run(tmp_path / "run") as run:
        flown = {row.test_case: bool(row.violated) for row in run.flights() if row.purpose == "search"}
        scored = Counter((one.test_case, one.model, one.shadow) for one in run.scores())
        assert any(times > 1 and name in flown for (name, _, _), times in scored.items()), "nothing came up again"
        answered = [one for one in run.scores() if one.violated is not None]
        assert max(Counter((one.test_case, one.model, one.shadow) for one in answered).values()) == 1
        assert {one.test_case: one.violated for one in answered} == flown
        assert all(one.selected_by for one in answered)
        (whole,) = (one for one in calibrations(run) if one.sample == "all")
        assert (whole.flights, whole.violations) == (len(flown), sum(flown.values()))
