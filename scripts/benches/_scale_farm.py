"""Parts of the bench `scale`: a farm and groups of workers, each started by the command a user would give."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from saflite.bus import keyring
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.contract.config import Campaign, LeaseConfig, ScorerConfig, SearchConfig
from saflite.contract.control import Status
from saflite.contract.errors import Unavailable
from saflite.contract.test_case import Target
from saflite.runtime.client import FARM_FILE, FarmClient, read_info
from saflite.simulator_worker.targets import reference

NAME = "bench-scale"
BUILD = "5" * 64
PORT = 7447
START_S = 1200.0
BUDGET_WITHOUT_END = 1_000_000
SLEEPER = f'''
"""A simulator that sleeps, as one that flies in real time does."""
import time

import msgspec
import numpy as np

from saflite.contract.flight import FlightRecord, Trace
from saflite.simulator_worker.targets import reference

THINK_S = __THINK_S__


def describe():
    return msgspec.structs.replace(reference.describe(), name="sleeper", build={BUILD!r}, snapshots=False)


def check(test_case):
    pass


def open(slot):
    return Session()


class Session:
    def fly(self, test_case, deadline_s, cancelled):
        until_s = time.monotonic() + THINK_S
        while time.monotonic() < until_s and not cancelled():
            time.sleep(min(0.25, max(0.0, until_s - time.monotonic())))
        column = np.full(10, 10.0, dtype="<f4").tobytes()
        return FlightRecord("completed", Trace(step_s=0.1, signals=dict.fromkeys(describe().signals, column)))

    def close(self):
        pass
'''


class Farm(NamedTuple):
    """`saflite resume` of a run folder, without simulators of its own."""

    run_dir: Path
    module: Path
    link: str
    keys: list[str]
    log: Path

    @contextmanager
    def on(self, prefix: tuple[str, ...] = ()) -> Iterator[subprocess.Popen[bytes]]:
        """Run it, on a node if its prefix is given."""
        listen = f"{self.link}/0.0.0.0:{PORT}"
        words = ["resume", str(self.run_dir), "--workers", "0", "--listen", listen, "--module", str(self.module)]
        with _saflite(prefix, [*words, "--json", *self.keys], self.log) as process:
            yield process


class Group(NamedTuple):
    """`saflite worker` on a node: so many simulators that join at `place`, the endpoint without its port."""

    folder: Path
    place: str
    workers: int
    module: Path
    keys: list[str]
    number: int

    @contextmanager
    def on(self, prefix: tuple[str, ...]) -> Iterator[subprocess.Popen[bytes]]:
        """Run it on a node."""
        name = f"node{self.number}"
        join = ["worker", "--join", f"{self.place}:{PORT}", "--workers", str(self.workers), "--campaign", NAME]
        join += ["--module", str(self.module), "--patience", "0", "--state", str(self.folder / name)]
        encrypted = self.place.startswith("tls/")
        join += ["--keys", str(self.folder / "keys" / "peers" / name)] if encrypted else [*self.keys, "--name", name]
        with _saflite(prefix, join, self.folder / f"{name}.log") as process:
            yield process


def campaign_of(workers: int, budget: int = BUDGET_WITHOUT_END, *, confirm: int = 0) -> Campaign:
    """Return a campaign that keeps so many simulators busy."""
    per_round = max(8, workers)
    return Campaign(
        name=NAME,
        mission="mission2",
        target=Target(name="sleeper", build=BUILD),
        budget_flights=budget,
        search=SearchConfig(
            candidates_per_round=per_round, flights_per_round=per_round, lag=8, confirm_flights=confirm, check_share=0.0
        ),
        scorer=ScorerConfig(model="constant", batch=40),
        lease=LeaseConfig(lease_s=10.0),
        record="none",
    )


def new_run(run_dir: Path, campaign: Campaign) -> Path:
    """Make the run folder of a campaign."""
    Store.create(run_dir, campaign, template(campaign), reference.describe()).close()
    return run_dir


def write_sleeper(folder: Path, think_s: float) -> Path:
    """Write the simulator that sleeps so long a flight."""
    module = folder / "sleeper.py"
    module.write_text(SLEEPER.replace("__THINK_S__", repr(think_s)))
    return module


def write_keys(folder: Path, hosts: list[str], node_count: int) -> list[str]:
    """Make the farm's keys and one for each node; returns the farm's arguments."""
    keyring.init(folder / "keys", hosts, now_s=time.time())
    for number in range(node_count):
        keyring.add(folder / "keys", f"node{number}", ["worker"], now_s=time.time())
    return ["--keys", str(folder / "keys")]


@contextmanager
def connected(run_dir: Path) -> Iterator[FarmClient]:
    """Connect to the farm that works in a run folder, once it is there."""
    until((run_dir / FARM_FILE).exists, "the farm", run_dir.parent)
    info = read_info(run_dir)
    client = FarmClient.connect(info.endpoint, NAME, patience_s=60.0, insecure=info.insecure)
    try:
        yield client
    finally:
        client.close()


def until(there: Callable[[], bool], what: str, folder: Path) -> None:
    """Wait for something; raises Unavailable with the ends of all logs if it does not come."""
    until_s = time.monotonic() + START_S
    while not there():
        if time.monotonic() > until_s:
            logs = "\n".join(path.read_text(errors="replace")[-500:] for path in sorted(folder.glob("*.log")))
            raise Unavailable(f"{what} not there after {START_S:.0f} s: {logs}")
        time.sleep(0.5)


def flying(status: Status) -> int:
    """Return how many simulators have joined."""
    return sum(worker.stage == "fly" for worker in status.workers)


@contextmanager
def _saflite(prefix: tuple[str, ...], words: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    with log.open("wb") as sink:
        process = subprocess.Popen([*prefix, sys.executable, "-m", "saflite", *words], stdout=sink, stderr=sink)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
