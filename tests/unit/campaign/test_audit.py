"""The audit finds what it is there to find."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from books_drive import Driver, doubles

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store, store_file
from saflite.contract.control import Control
from saflite.contract.errors import Refused
from saflite.contract.work import WarmWork
from saflite.evidence.folder import BlobFolder


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    """A finished run, interrupted once, with lost leases on the way."""
    store = Store.create(tmp_path / "run", doubles.campaign(15, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=6)
    driver.ask("fly", "gone", 2)
    store.close()
    store = Store.open(tmp_path / "run")
    driver = Driver(store.rebuild(), store)
    driver.now += 60.0
    driver.books.tick(driver.now)
    driver.commit()
    driver.run()
    store.close()
    return tmp_path / "run"


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A finished run with recordings."""
    store = Store.create(tmp_path / "recorded", doubles.campaign(15), doubles.TEMPLATE, doubles.TARGET)
    Driver(store.rebuild(), store).run()
    store.close()
    return tmp_path / "recorded"


def change(run_dir: Path, statement: str) -> None:
    database = sqlite3.connect(store_file(run_dir))
    assert database.execute(statement).rowcount
    database.commit()
    database.close()


def test_a_finished_run_balances(finished: Path) -> None:
    figures = audit(finished)
    assert figures["problems"] == []
    assert figures["clean"]
    assert figures["flights"] == figures["budget"] == 15
    assert figures["attempts_issued"] == figures["attempts_ended"] > 30
    assert figures["test_cases_selected"] == figures["test_cases_ended"]
    assert figures["blobs_orphan"] == figures["blobs_missing"] == 0
    assert sum(figures["violations"].values()) > 0


def test_a_run_under_way_balances(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(15, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=6)
    driver.ask("mutate")
    driver.ask("fly", leases_max=2)
    figures = audit(tmp_path / "run")
    assert figures["problems"] == []
    assert figures["state"] == "running"


def test_a_campaign_that_is_over_leaves_no_attempt_open(tmp_path: Path) -> None:
    campaign = doubles.campaign(6, record="none", check_share=1.0)
    store = Store.create(tmp_path / "run", campaign, doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=6)
    assert driver.books.control(Control(verb="shadow", text="chance"), driver.now).accepted
    driver.commit()
    (lease,) = driver.ask("score", worker="slow")
    assert isinstance(lease.work, WarmWork)
    figures = audit(tmp_path / "run")
    assert figures["attempts_open"] >= 1, "it is under way"
    while not driver.books.ended:
        for stage in ("mutate", "fly", "judge", "record"):
            driver.do(stage)
        driver.now += 0.01  # before the lease runs out
        driver.books.tick(driver.now)
        driver.commit()
    store.close()
    figures = audit(tmp_path / "run")
    assert figures["problems"] == []
    assert figures["state"] == "ended"
    assert figures["attempts_open"] == 0
    assert figures["attempts_issued"] == figures["attempts_ended"] == sum(figures["attempts_by_end"].values())


def test_a_stopped_run_balances(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(15, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=6)
    driver.books.control(Control(verb="stop"), driver.now)
    driver.commit()
    store.close()
    assert audit(tmp_path / "run")["problems"] == []


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM flights WHERE rowid = 3",
        "UPDATE flights SET worker = 'somebody' WHERE rowid = 3",
        "UPDATE judgements SET robustness = 9 WHERE test_case = (SELECT min(test_case) FROM judgements)",
        "DELETE FROM endings WHERE test_case = (SELECT min(test_case) FROM endings)",
        "UPDATE scores SET value = value + 1 WHERE rowid = 5",
        "DELETE FROM violations WHERE rowid = 1",
        "UPDATE violations SET event = event + 1 WHERE rowid = 1",
        "INSERT INTO recordings VALUES ('../../x', 0, 'y', 1)",
        "UPDATE attempts SET how = 'lost' WHERE work = (SELECT min(work) FROM attempts)",
        "DELETE FROM events WHERE seq = 9",
        "UPDATE events SET event = x'80' WHERE seq = 9",
        "DELETE FROM journal WHERE n = 20",
        "DELETE FROM journal WHERE n = (SELECT max(n) FROM journal)",
        "UPDATE journal SET chain = chain + 1 WHERE n = 20",
    ],
)
def test_whatever_is_changed_is_found(finished: Path, statement: str) -> None:
    change(finished, statement)
    figures = audit(finished)
    assert not figures["clean"]
    assert figures["problems"]


def test_missing_damaged_and_left_over_blobs_are_found(finished: Path) -> None:
    folder = BlobFolder(finished)
    names = list(folder.digests())
    folder.path(names[0]).unlink()
    data = bytearray(folder.path(names[1]).read_bytes())
    data[len(data) // 2] ^= 1
    folder.path(names[1]).write_bytes(bytes(data))
    orphan = folder.put(b"nobody's")
    quick, deep = audit(finished, quick=True), audit(finished)
    assert (quick["blobs_missing"], quick["blobs_damaged"], quick["blobs_orphan"]) == (1, 0, 1)
    assert (deep["blobs_missing"], deep["blobs_damaged"], deep["blobs_orphan"]) == (1, 1, 1)
    assert not quick["clean"]
    assert not deep["clean"]
    assert any(names[1][:16] in problem for problem in deep["problems"])
    assert orphan.digest not in names


def test_a_recording_is_damaged_together_with_its_blob(recorded: Path) -> None:
    assert audit(recorded)["problems"] == []
    file = next((recorded / "recordings").glob("*.mcap"))
    file.write_bytes(b"x" + file.read_bytes()[1:])
    figures = audit(recorded)
    assert (figures["recordings_damaged"], figures["blobs_damaged"]) == (1, 1)
    assert audit(recorded, quick=True)["clean"]


def test_a_flight_flown_again_for_its_lost_trace_balances(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(15, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    while not driver.books.status(driver.now).queues["judge"]:
        assert any(driver.do(stage, many=9) for stage in ("mutate", "score", "fly"))
    store.close()
    folder = BlobFolder(tmp_path / "run")
    for name in list(folder.digests()):
        folder.path(name).unlink()
    store = Store.open(tmp_path / "run")
    driver = Driver(store.rebuild(), store)
    assert audit(tmp_path / "run")["problems"] == []
    driver.run()
    store.close()
    figures = audit(tmp_path / "run")
    assert (figures["problems"], figures["flights"]) == ([], 15)


def test_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"expected a run with a books\.sqlite"):
        audit(tmp_path)
