"""The whole farm as processes on real Zenoh, with a target that flies nothing so that it takes seconds."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.contract.config import Campaign, LeaseConfig, ScorerConfig, SearchConfig
from saflite.contract.control import Status
from saflite.contract.errors import Refused
from saflite.contract.events import CampaignChanged, Event, WorkerChanged
from saflite.contract.test_case import Target
from saflite.runtime import stop_note
from saflite.runtime.campaign_runner import resume, run_campaign
from saflite.runtime.client import FarmClient, read_info
from saflite.runtime.farm import LocalFarm, roles
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.registry import describe_target

pytestmark = pytest.mark.live

TARGET = Path(__file__).parents[2] / "scripts" / "soaking" / "soak.py"
QUIET, SLOW = 8.0, 7.0


def _campaign(budget: int, fault: float = QUIET) -> Campaign:
    return Campaign(
        name="live",
        mission="mission1",
        target=Target(name="soak", parameters={"SOAK_FAULT": fault}),
        budget_flights=budget,
        scorer=ScorerConfig(model="gap"),
        search=SearchConfig(candidates_per_round=12, flights_per_round=6),
        lease=LeaseConfig(lease_s=2.0, wall_limit_s=30.0),
    )


def _rows(run_dir: Path, sql: str) -> list[tuple[object, ...]]:
    connection = sqlite3.connect(run_dir / "books.sqlite")
    try:
        return connection.execute(sql).fetchall()
    finally:
        connection.close()


def test_a_campaign_runs_to_its_end_and_leaves_nothing_behind(tmp_path: Path) -> None:
    before = children(os.getpid())
    seen: list[Status] = []
    summary = run_campaign(_campaign(30), tmp_path / "run", simulators=2, on_status=seen.append, modules=[TARGET])
    assert summary.ended
    assert summary.status is not None
    assert (summary.status.state, summary.status.flights) == ("ended", 30)
    assert _rows(
        tmp_path / "run", "SELECT count(*), count(DISTINCT test_case) FROM flights WHERE purpose = 'search'"
    ) == [(30, 30)]
    assert len(seen) >= 2
    assert children(os.getpid()) == before
    assert not (tmp_path / "run" / "farm.json").exists()
    with pytest.raises(Refused, match="resume"):
        run_campaign(_campaign(30), tmp_path / "run", modules=[TARGET])


def _follow(run_dir: Path, into: list[Event]) -> None:
    while not (run_dir / "farm.json").exists():
        time.sleep(0.02)
    info = read_info(run_dir)
    client = FarmClient.connect(info.endpoint, info.campaign, patience_s=None)
    into.extend(client.watch(1))
    client.close()


def test_books_and_workers_are_killed_and_the_budget_stays_exact(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    campaign = _campaign(400)
    Store.create(run_dir, campaign, template(campaign), describe_target("soak", [TARGET])).close()
    farm = LocalFarm("live", run_dir, roles(2), modules=[TARGET])
    farm.start()
    events: list[Event] = []
    watcher = threading.Thread(target=_follow, args=(run_dir, events), daemon=True)
    watcher.start()
    victims = ["fly-1", "books", "judge-1", "score-1", "fly-2", "books", "mutate-1", "record-1"]
    next_s = time.monotonic() + 2.0
    until_s = time.monotonic() + 90
    while not farm.over() and time.monotonic() < until_s:
        farm.poll()
        if victims and time.monotonic() > next_s and victims[0] in farm.pids():
            os.kill(farm.pids()[victims.pop(0)], signal.SIGKILL)
            next_s = time.monotonic() + 0.4
        time.sleep(0.02)
    assert farm.over()
    watcher.join(10)
    farm.stop()
    assert _rows(
        run_dir, "SELECT count(*), count(DISTINCT test_case || flight_index) FROM flights WHERE purpose = 'search'"
    ) == [(400, 400)]
    assert [event.seq for event in events] == list(range(1, len(events) + 1))
    assert any(isinstance(event.fact, CampaignChanged) and event.fact.state == "ended" for event in events)


def test_a_stopped_run_goes_on_where_it_was(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    campaign = _campaign(4, fault=SLOW)
    began_s = time.monotonic()

    def stop_in_flight(status: Status) -> None:
        if any(worker.stage == "fly" and worker.state == "busy" for worker in status.workers):
            os.kill(os.getpid(), signal.SIGINT)

    summary = run_campaign(campaign, run_dir, simulators=1, modules=[TARGET], on_status=stop_in_flight)
    assert not summary.ended
    assert stop_note.read(run_dir) == summary.why == "signal SIGINT"
    assert time.monotonic() - began_s < 30
    assert _rows(run_dir, "SELECT count(*) FROM attempts WHERE how = 'lost'") == [(0,)]
    handed_back = _rows(run_dir, "SELECT count(*) FROM attempts WHERE how = 'handed_back'")[0][0]
    assert isinstance(handed_back, int)
    assert handed_back >= 1
    again = Store.open(run_dir)
    with pytest.raises(Refused, match="use"):
        resume(run_dir, simulators=1, modules=[TARGET])
    again.close()
    assert resume(run_dir, simulators=2, modules=[TARGET]).ended
    assert not stop_note.read(run_dir), "it was taken up again"


def test_a_frozen_worker_is_noticed_within_four_seconds(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    campaign = _campaign(4, fault=SLOW)
    Store.create(run_dir, campaign, template(campaign), describe_target("soak", [TARGET])).close()
    farm = LocalFarm("live", run_dir, roles(1), modules=[TARGET])
    farm.start()
    try:
        client = FarmClient.connect(farm.endpoint, "live", patience_s=None)
        while not any(worker.stage == "fly" for worker in client.status().workers):
            time.sleep(0.05)
        os.kill(read_info(run_dir).processes["fly-1"], signal.SIGSTOP)
        frozen_s = time.time()
        for event in client.watch(1):
            gone = isinstance(event.fact, WorkerChanged) and event.fact.worker == "fly-1" and not event.fact.present
            if gone:
                assert event.at_unix_s - frozen_s < 4
                break
        client.close()
    finally:
        farm.stop()


LAUNCH = """
import sys
from pathlib import Path
from saflite.runtime.campaign_runner import resume
resume(Path(sys.argv[1]), simulators=2, modules=[Path(sys.argv[2])])
"""


def _marked(mark: str) -> list[str]:
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            with suppress(OSError):
                if f"LIVE_MARK={mark}".encode() in (folder / "environ").read_bytes():
                    found.append((folder / "cmdline").read_bytes().decode())
    return found


def test_nothing_outlives_a_killed_launcher_and_the_run_goes_on(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    campaign = _campaign(300)
    Store.create(run_dir, campaign, template(campaign), describe_target("soak", [TARGET])).close()
    mark = str(tmp_path)
    command = [sys.executable, "-c", LAUNCH, str(run_dir), str(TARGET)]
    launcher = subprocess.Popen(command, env={**os.environ, "LIVE_MARK": mark})
    while not list((run_dir / "spool").glob("fly-*")):
        time.sleep(0.05)
    time.sleep(1.0)
    launcher.kill()
    launcher.wait()
    until_s = time.monotonic() + 5
    while _marked(mark) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert _marked(mark) == []
    assert resume(run_dir, simulators=2, modules=[TARGET]).ended
    assert _rows(
        run_dir, "SELECT count(*), count(DISTINCT test_case || flight_index) FROM flights WHERE purpose = 'search'"
    ) == [(300, 300)]
