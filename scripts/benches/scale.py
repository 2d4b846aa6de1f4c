"""How a farm scales: real Zenoh, real processes, simulators that sleep, nodes that are network namespaces.

A cell is a farm (books, router, mutator, scorer, oracle) and so many workers, spread over the nodes and joined by
`saflite worker`. Its efficiency is the rate of flights over the rate that its simulators alone would have. `--link`
says what carries the messages: `tls` with keys (mTLS) or plain `tcp`; the processor time of the books per flight under
both is what encryption costs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from _scale_table import table

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
FLIGHTS_PER_S_MAX = 60.0  # of a whole farm, unless --think is given
START_S = 600.0
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


class Node(NamedTuple):
    """A network namespace, cabled to this one."""

    name: str
    host_ip: str

    @property
    def prefix(self) -> tuple[str, ...]:
        """What puts a command inside."""
        return ("ip", "netns", "exec", self.name)


@contextmanager
def nodes(count: int) -> Iterator[list[Node]]:
    """Make namespaces with addresses of their own, and remove them."""
    made: list[Node] = []
    try:
        for number in range(count):
            node = Node(f"sfscale-{os.getpid()}-{number}", f"10.213.{number}.1")
            outside, inside = f"sfs{os.getpid() % 100000}o{number}", f"sfs{os.getpid() % 100000}i{number}"
            subprocess.run(["ip", "netns", "add", node.name], check=True)
            made.append(node)
            for command in (
                f"ip link add {outside} type veth peer name {inside}",
                f"ip link set {inside} netns {node.name}",
                f"ip addr add {node.host_ip}/30 dev {outside}",
                f"ip link set {outside} up",
                f"ip netns exec {node.name} ip addr add 10.213.{number}.2/30 dev {inside}",
                f"ip netns exec {node.name} ip link set {inside} up",
            ):
                subprocess.run(command.split(), check=True)
        yield made
    finally:
        for node in made:  # their end of the cable goes with them, and ours with it
            subprocess.run(["ip", "netns", "del", node.name], check=False)


def cell(workers: int, node_count: int, link: str, seconds: float, think_s: float) -> dict[str, Any]:
    """Run one farm and return its figures."""
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="saflite-scale-")))
        spread = opened.enter_context(nodes(node_count))
        module = folder / "sleeper.py"
        module.write_text(SLEEPER.replace("__THINK_S__", repr(think_s)))
        run_dir, how = folder / "run", _keys(folder, spread) if link == "tls" else ["--insecure"]
        campaign = _campaign(workers)
        Store.create(run_dir, campaign, template(campaign), reference.describe()).close()
        farm = ["resume", str(run_dir), "--workers", "0", "--listen", f"{link}/0.0.0.0:{PORT}", "--module", str(module)]
        opened.enter_context(_saflite([], [*farm, "--json", *how], folder / "farm.log"))
        client = opened.enter_context(_connected(run_dir))
        for number, node in enumerate(spread):
            share = workers // node_count + (number < workers % node_count)
            join = ["worker", "--join", f"{link}/{node.host_ip}:{PORT}", "--workers", str(share), "--campaign", NAME]
            join += ["--module", str(module), "--patience", "0", "--state", str(folder / f"node-{number}")]
            proof = ["--keys", str(folder / "keys" / "peers" / f"node{number}")] if link == "tls" else [*how]
            proof += [] if link == "tls" else ["--name", f"node{number}"]
            opened.enter_context(_saflite(node.prefix, [*join, *proof], folder / f"node-{number}.log"))
        _until(lambda: _flying(client.status()) >= workers, f"{workers} workers", folder)
        time.sleep(2 * think_s)
        return {"workers": workers, "nodes": node_count, "link": link, "think_s": think_s} | _measured(
            client, run_dir, seconds, workers / think_s
        )


def _campaign(workers: int) -> Campaign:
    per_round = max(8, workers)
    return Campaign(
        name=NAME,
        mission="mission2",
        target=Target(name="sleeper", build=BUILD),
        budget_flights=1_000_000,
        search=SearchConfig(
            candidates_per_round=per_round, flights_per_round=per_round, lag=8, confirm_flights=0, check_share=0.0
        ),
        scorer=ScorerConfig(model="constant", batch=40),
        lease=LeaseConfig(lease_s=10.0),
        record="none",
    )


def _keys(folder: Path, spread: list[Node]) -> list[str]:
    keyring.init(folder / "keys", [node.host_ip for node in spread], now_s=time.time())
    for number, _ in enumerate(spread):
        keyring.add(folder / "keys", f"node{number}", ["worker"], now_s=time.time())
    return ["--keys", str(folder / "keys")]


@contextmanager
def _saflite(prefix: Any, words: list[str], log: Path) -> Iterator[None]:
    with log.open("wb") as sink:
        process = subprocess.Popen([*prefix, sys.executable, "-m", "saflite", *words], stdout=sink, stderr=sink)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextmanager
def _connected(run_dir: Path) -> Iterator[FarmClient]:
    _until((run_dir / FARM_FILE).exists, "the farm", run_dir.parent)
    info = read_info(run_dir)
    client = FarmClient.connect(info.endpoint, NAME, tries=30, insecure=info.insecure)
    try:
        yield client
    finally:
        client.close()


def _until(there: Any, what: str, folder: Path) -> None:
    until_s = time.monotonic() + START_S
    while not there():
        if time.monotonic() > until_s:
            logs = "\n".join(path.read_text(errors="replace")[-500:] for path in sorted(folder.glob("*.log")))
            raise Unavailable(f"{what} not there after {START_S:.0f} s: {logs}")
        time.sleep(0.5)


def _flying(status: Status) -> int:
    return sum(worker.stage == "fly" for worker in status.workers)


def _measured(client: FarmClient, run_dir: Path, seconds: float, ideal_per_s: float) -> dict[str, Any]:
    pid = read_info(run_dir).processes["books"]
    before, cpu_s, began_s = client.status(), _cpu_s(pid), time.monotonic()
    time.sleep(seconds)
    after, spent_s = client.status(), _cpu_s(pid) - cpu_s
    passed_s = time.monotonic() - began_s
    flights = after.flights + after.reflown - before.flights - before.reflown
    return {
        "seconds": round(passed_s, 1),
        "flights": flights,
        "efficiency": round(flights / passed_s / ideal_per_s, 4),
        "books_core_share": round(spent_s / passed_s, 4),
        "books_ms_per_flight": round(1000.0 * spent_s / flights, 3) if flights else None,
        "events_per_flight": round((after.seq - before.seq) / flights, 2) if flights else None,
        "queue_fly": after.queues["fly"],
        "load_1min": round(os.getloadavg()[0], 1),
    }


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main(argv: list[str]) -> int:
    """Measure cell by cell and print a row of each."""
    parser = argparse.ArgumentParser(prog="scripts/bench scale", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--workers", default="1,2,8,64,256", help="simulators of each cell")
    parser.add_argument("--nodes", type=int, default=8, help="namespaces at most")
    parser.add_argument("--link", default="tls", help="tls, tcp, or tls,tcp for both in turn")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--think", type=float, help="seconds a flight sleeps (2 or more)")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="add the rows to this file")
    parser.add_argument("--table", action="store_true", help="only print the table of deploy/docs/scale.md")
    options = parser.parse_args(argv)
    if options.table:
        print(table())
        return 0
    if os.geteuid() != 0:
        raise Unavailable("network namespaces need root")
    for repeat in range(options.repeats):
        for workers in (int(text) for text in options.workers.split(",")):
            for link in options.link.split(","):
                think_s = options.think or max(2.0, workers / FLIGHTS_PER_S_MAX)
                row = cell(workers, min(workers, options.nodes), link, options.seconds, think_s)
                line = json.dumps({"repeat": repeat, **row})
                print(line, flush=True)
                if options.rows:
                    with options.rows.open("a") as file:
                        file.write(line + "\n")
    return 0
