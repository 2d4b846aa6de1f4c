"""A run folder read: every flight counted once, every find as the books count it."""

from __future__ import annotations

import csv
import json
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from msgspec.structs import replace

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.run_data.conclusion import conclude
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.dashboard.source import RunSource, _of_status
from saflite.console.view.report import data
from saflite.contract.blobs import Blobs
from saflite.contract.work import Result, ScoreResult, Work
from saflite.runtime.campaign_runner import ExitSummary

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles
from test_minimization import Lucky, Stimulated, finish, started

SHOWN = ("flights", "reflown", "behaviours", "finds", "flaky")


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
        (whole,) = (one for one in data.calibrations(run) if one.sample == "all")
        assert (whole.flights, whole.violations) == (len(flown), sum(flown.values()))


class _StoodInFor(doubles.Service):
    """A farm whose embedded scorer stands in for half of the scores, watches all, and is what another one asks."""

    def do(self, work: Work) -> Result:
        result = super().do(work)
        if not isinstance(result, ScoreResult):
            return result
        scores = [replace(one, scored_by="blend") if one.test_case < "8" else one for one in result.scores]
        watching = [
            replace(one, model=model, scored_by="blend", shadow=True)
            for one in result.scores
            for model in ("blend", "surrogate")
        ]
        return replace(result, scores=(*scores, *watching))


def test_a_flight_counts_once_for_a_model_that_decides_and_watches(tmp_path: Path) -> None:
    """The stand-in of a model and its shadow say the same of the same flight: no second piece of evidence."""
    store = Store.create(tmp_path / "run", doubles.campaign(30, random_share=0.4), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.service = _StoodInFor(store.blobs)
    driver.run()
    store.close()
    with open_run(tmp_path / "run") as run:
        flown = {row.test_case: bool(row.violated) for row in run.flights() if row.purpose == "search"}
        random = {one.test_case for one in run.scores() if one.selected_by == "random"}
        found = {(one.model, one.sample): (one.flights, one.violations) for one in data.calibrations(run)}
    own = [name for name in flown if name >= "8"]
    assert found["blend", "all"] == (len(flown), sum(flown.values()))
    assert found["blend", "random"] == (len(random), sum(flown[name] for name in random))
    assert found["scripted", "all"] == (len(own), sum(flown[name] for name in own))


@pytest.mark.parametrize("farm", [Stimulated, Lucky])
def test_a_smallest_form_is_told_and_counts_as_no_find_of_its_own(
    farm: Callable[[Blobs], doubles.Service], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a farm shows while it runs must not jump once it has ended, whichever command counts."""
    driver, run_dir = started(tmp_path / "run"), tmp_path / "run"
    assert driver.store is not None
    driver.service = farm(driver.store.blobs)
    finish(driver)
    status = driver.books.status(driver.now)
    live, rest = _of_status(status), RunSource(run_dir).figures()
    assert {name: getattr(rest, name) for name in SHOWN} == {name: getattr(live, name) for name in SHOWN}
    conclude(run_dir, ExitSummary(True, "the budget is spent", None, 0), as_json=True)
    said = json.loads(capsys.readouterr().out)
    assert (said["confirmed"], said["similar"]) == (status.violations_confirmed, status.violations_similar)
    assert main(["report", str(run_dir), "--json", "--force"]) == 0
    assert json.loads(capsys.readouterr().out)["confirmed"] == status.violations_confirmed
    with open_run(run_dir) as run:
        forms, told, made = run.smallest_forms(), {one.test_case for one in run.violations()}, data.read(run)
        assert forms == {row.test_case for row in run.flights() if row.purpose == "shrunk"} & told
        assert sum(run.endings().values()) == status.test_cases
    assert forms, "nothing was made smaller"
    assert forms <= {one["test_case"] for one in said["violations"]}
    assert forms <= {one.violation.test_case for one in made.exhibits}
    assert made.finds_shown("flaky") == status.violations_flaky
    assert sum(made.finds.values()) == int(made.progress.found[-1]) == live.finds
    assert max(cause["violations"] for cause in said["causes"]) <= live.finds
    assert any(cause["test_case"] in forms for cause in said["causes"]), "the smallest inputs are told"
    assert [cause.plain() for cause in made.causes] == said["causes"], "the report and the summary tell others"
    with open_run(run_dir) as run:
        parent = run.test_case(min(forms)).origin.parent
    page = RunSource(run_dir).find(parent, public=False)
    assert "is its smallest form" in page, "the dashboard says less of a find than the report"
    assert "link needed" in page
    audited, beside = audit(run_dir), ("flights", "confirm_flights", "check_flights", "shrink_flights")
    assert {name: audited[name] for name in beside} == {name: said[name] for name in beside}


@pytest.mark.parametrize("farm", [Stimulated, Lucky])
def test_what_is_exported_for_ci_counts_as_the_report_does(
    farm: Callable[[Blobs], doubles.Service], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    driver, run_dir = started(tmp_path / "run"), tmp_path / "run"
    assert driver.store is not None
    driver.service = farm(driver.store.blobs)
    finish(driver)
    behaviours = RunSource(run_dir).figures().behaviours
    with open_run(run_dir) as run:
        made, forms = data.read(run), run.smallest_forms()
    for name in ("junit", "sarif", "csv"):
        assert main(["export", str(run_dir), "--format", name, "--out", str(tmp_path / name), "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["violations"] == len(made.exhibits) - len(forms)
    suite = ElementTree.parse(tmp_path / "junit" / "junit.xml").getroot()
    assert int(suite.attrib["failures"]) == behaviours == made.finds_shown("confirmed")
    results = json.loads((tmp_path / "sarif" / "violations.sarif").read_text())["runs"][0]["results"]
    places = [result["partialFingerprints"]["saflite/v1"] for result in results if result["level"] != "note"]
    assert len(places) == len(set(places)) == behaviours
    with (tmp_path / "csv" / "violations.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    own = [row for row in rows if not row["smallest_form_of"]]
    assert sum(row["confirmation"] == "confirmed" for row in own) == behaviours
    made_of = {row["test_case"]: row["smallest_form_of"] for row in rows if row["smallest_form_of"]}
    assert set(made_of) == forms, "each names its find"
    assert set(made_of.values()) <= {row["test_case"] for row in own}
