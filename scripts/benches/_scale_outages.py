"""Outages under load, for the bench `scale`: what of a campaign is lost or counted twice. One row each.

cut     a node's cable is pulled for a while; its workers fly on and hand in late
node    everything on a node is killed, for good
books   the process that holds books and router is killed; its supervisor starts it again
farm    everything on the farm's node is killed; its run folder is resumed on another node, which takes the address over
"""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from _scale_farm import Farm, Group, campaign_of, connected, flying, new_run, until, write_keys, write_sleeper
from _scale_nodes import FARM_IP, Node, nodes

from saflite.campaign.storage.audit import audit
from saflite.console.run_data.run_folder import open_run
from saflite.contract.events import FaultSeen, Flown
from saflite.runtime.client import read_info

END_S = 900.0
THINK_S = 2.0
CALM_S = 45.0  # of flights besides those in the outage


class Stage:
    """A farm on a node, worker groups on others, and a spare node."""

    def __init__(self, opened: ExitStack, folder: Path, workers: int, node_count: int, budget: int) -> None:
        self._opened, self._folder = opened, folder
        self.head, self.spare, *self.groups = opened.enter_context(nodes(node_count + 2))
        self._module, self._keys = write_sleeper(folder, THINK_S), write_keys(folder, [FARM_IP], node_count)
        self.run_dir = new_run(folder / "run", campaign_of(workers, budget, confirm=1))
        self.farm = self.start(self.head)
        for number, node in enumerate(self.groups):
            share = workers // node_count + (number < workers % node_count)
            group = Group(folder, f"tls/{FARM_IP}", share, self._module, self._keys, number)
            opened.enter_context(group.on(node.prefix))

    def start(self, node: Node) -> subprocess.Popen[bytes]:
        """Run the farm on a node, which takes its address."""
        node.take(FARM_IP)
        farm = Farm(self.run_dir, self._module, "tls", self._keys, self._folder / f"{node.name}.log")
        return self._opened.enter_context(farm.on(node.prefix))

    def move(self) -> None:
        """Lose the farm's node and go on on the spare one, from a copy of what its disk holds."""
        self.head.kill()
        self.run_dir = Path(shutil.copytree(self.run_dir, self._folder / "moved"))
        (self.run_dir / "farm.json").unlink(missing_ok=True)
        self.farm = self.start(self.spare)


def outage(kind: str, workers: int, node_count: int, cut_s: float) -> dict[str, Any]:
    """Run a campaign with an outage in its first half, and return what its books hold at the end."""
    budget = round(workers / THINK_S * (CALM_S + (cut_s if kind == "cut" else 0.0)))
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="saflite-scale-")))
        stage = Stage(opened, folder, workers, node_count, budget)
        with connected(stage.run_dir) as client:
            until(lambda: flying(client.status()) >= workers, f"{workers} workers", folder)
            until(lambda: client.status().flights >= budget // 4, "a quarter of the flights", folder)
        began_s = time.monotonic()
        OUTAGES[kind](stage, cut_s)
        with connected(stage.run_dir) as client:
            back_s = time.monotonic()
            flown = client.status().flights
            until(lambda: client.status().flights > flown, "flights after the outage", folder)
        at_work_s = time.monotonic()
        code = stage.farm.wait(END_S)
        row = {"outage": kind, "workers": workers, "nodes": node_count, "link": "tls", "think_s": THINK_S}
        times = {"outage_s": round(back_s - began_s, 1), "to_next_flight_s": round(at_work_s - back_s, 1)}
        load = {"exit_code": code, "load_1min": round(os.getloadavg()[0], 1)}
        return row | times | {"budget": budget} | _balance(stage.run_dir, budget) | load


def _cut(stage: Stage, cut_s: float) -> None:
    stage.groups[0].cut()
    time.sleep(cut_s)
    stage.groups[0].mend()


def _kill_books(stage: Stage, _: float) -> None:
    os.kill(read_info(stage.run_dir).processes["books"], signal.SIGKILL)


OUTAGES: dict[str, Callable[[Stage, float], None]] = {
    "cut": _cut,
    "node": lambda stage, _: stage.groups[0].kill(),
    "books": _kill_books,
    "farm": lambda stage, _: stage.move(),
}


def _balance(run_dir: Path, budget: int) -> dict[str, Any]:
    """Return what was lost and what was told twice: first flights against the budget, facts by their numbers."""
    with closing(sqlite3.connect(f"file:{run_dir / 'books.sqlite'}?mode=ro", uri=True)) as books:
        attempts = dict(books.execute("SELECT how, count(*) FROM attempts GROUP BY how").fetchall())
    with open_run(run_dir) as run:
        events = list(run.events(1))
    facts = [event.fact for event in events]
    flown = [
        (fact.test_case, fact.flight_index) for fact in facts if isinstance(fact, Flown) and fact.purpose == "search"
    ]
    distinct, rows = len(set(flown)), len(flown)
    return {
        "lost": budget - distinct,
        "double": rows - distinct,
        "events_lost_or_double": sum(event.seq != place for place, event in enumerate(events, 1)),
        "attempts_lost": attempts.get("lost", 0),
        "faults_told": sum(isinstance(fact, FaultSeen) for fact in facts),
        "audit_problems": len(audit(run_dir)["problems"]),
    }
