"""How a farm scales, and what outages do to it: real Zenoh, real processes, simulators that sleep, nodes that are
network namespaces with addresses of their own.

A cell is a farm (books, router, mutator, scorer, oracle) and so many workers, spread over the nodes and joined by
`saflite worker`. Its efficiency is the rate of flights over the rate that its simulators alone would have. `--link`
says what carries the messages: `tls` with keys (mTLS) or plain `tcp`; the processor time of the books per flight under
both is what encryption costs.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from _scale_farm import Farm, Group, campaign_of, connected, flying, new_run, until, write_keys, write_sleeper
from _scale_nodes import FARM_IP, nodes
from _scale_outages import OUTAGES, outage
from _scale_table import tables

from saflite.contract.errors import Refused, Unavailable
from saflite.runtime.client import FarmClient, read_info

FLIGHTS_PER_S_MAX = 60.0  # of a whole farm, unless --think is given


def cell(workers: int, node_count: int, link: str, seconds: float, think_s: float) -> dict[str, Any]:
    """Run one farm and return its figures."""
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="saflite-scale-")))
        spread = opened.enter_context(nodes(node_count, farm_here=True))
        module = write_sleeper(folder, think_s)
        keys = write_keys(folder, [FARM_IP], node_count) if link == "tls" else ["--insecure"]
        run_dir = new_run(folder / "run", campaign_of(workers))
        opened.enter_context(Farm(run_dir, module, link, keys, folder / "farm.log").on())
        client = opened.enter_context(connected(run_dir))
        up = 0
        for number, node in enumerate(spread):  # one after the other: nodes with cores of their own would not starve
            share = workers // node_count + (number < workers % node_count)
            group = Group(folder, f"{link}/{FARM_IP}", share, module, keys, number)
            opened.enter_context(group.on(node.prefix))
            up += share
            until(partial(_flying_are, client, up), f"{up} workers", folder)
        time.sleep(2 * think_s)
        return {"workers": workers, "nodes": node_count, "link": link, "think_s": think_s} | _measured(
            client, run_dir, seconds, workers / think_s
        )


def _flying_are(client: FarmClient, count: int) -> bool:
    try:
        return flying(client.status()) >= count
    except Unavailable:  # the books have no core meanwhile
        return False


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
    parser.add_argument("--outages", default="", help=f"instead: some of {','.join(OUTAGES)}, under load")
    parser.add_argument("--cut", type=float, default=60.0, help="seconds a node is cut off")
    parser.add_argument("--table", action="store_true", help="only print the tables of deploy/docs/scale.md")
    options = parser.parse_args(argv)
    if options.table:
        print(tables())
        return 0
    if os.geteuid() != 0:
        raise Unavailable("network namespaces need root")
    wanted = [kind for kind in options.outages.split(",") if kind]
    if unknown := [kind for kind in wanted if kind not in OUTAGES]:
        raise Refused("--outages", expected=f"some of {', '.join(OUTAGES)}", got=", ".join(unknown))
    for repeat in range(options.repeats):
        for workers in (int(text) for text in options.workers.split(",")):
            for kind in wanted:
                _keep(
                    options.rows, {"repeat": repeat, **outage(kind, workers, min(workers, options.nodes), options.cut)}
                )
            for link in options.link.split(",") if not wanted else ():
                think_s = options.think or max(2.0, workers / FLIGHTS_PER_S_MAX)
                row = cell(workers, min(workers, options.nodes), link, options.seconds, think_s)
                _keep(options.rows, {"repeat": repeat, **row})
    return 0


def _keep(rows: Path | None, row: dict[str, Any]) -> None:
    line = json.dumps(row)
    print(line, flush=True)
    if rows is not None:
        with rows.open("a") as file:
            file.write(line + "\n")
