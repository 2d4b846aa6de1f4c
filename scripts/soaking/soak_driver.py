"""The soak itself: starts the farm, injects faults, lets the campaign end, audits, prints the figures."""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from block_flips import corruptions
from byzantine_client import ByzantineClient
from faults import HEAVY, KINDS, Done, FaultContext, Injected
from figures import CENTRE, figures_of, is_clean
from forgers import forgeries
from testbed import Testbed

from saflite.bus.zenoh import leave_process
from saflite.campaign.storage.projections import FORMAT
from saflite.contract.errors import FarmError
from saflite.contract.rng import derive
from saflite.runtime.client import FarmClient

FUZZ = Path(__file__).parents[1] / "fuzzing" / "fuzz_driver.py"
POLL_S = 0.02
WARM_UP_S = 5.0
WORKERS_SHARE = 0.25  # of the time only workers are harmed, so that noticing it can be measured
FROZEN_MAX = 2
END_PATIENCE_S = 180.0
LAST_FLIGHTS = 24  # how many more flights the campaign may make once the faults are over


class SoakDriver:
    """Injects faults in a shuffled order, every kind as often as any other (heavy ones less often)."""

    def __init__(self, testbed: Testbed, context: FaultContext, per_minute: float) -> None:
        self._testbed, self._context, self._gap_s = testbed, context, 60.0 / per_minute
        self._next_kinds: list[str] = []
        self._undo: list[tuple[float, str, Done]] = []
        self._passes = 0
        self._only_workers_until_s = 0.0
        self.injected: list[Injected] = []

    def run(self, duration_s: float) -> None:
        """Inject faults for a while, then undo them all."""
        clock = self._testbed.clock
        until_s = clock.monotonic_s() + duration_s
        self._only_workers_until_s = clock.monotonic_s() + duration_s * WORKERS_SHARE
        next_s = clock.monotonic_s() + WARM_UP_S
        while (now_s := clock.monotonic_s()) < until_s:
            self._testbed.farm.poll()
            self._heal(now_s)
            if now_s >= next_s:
                self._inject(now_s)
                next_s = max(next_s + self._gap_s, now_s)
            clock.sleep_s(POLL_S)
        self._heal(float("inf"))

    def _inject(self, now_s: float) -> None:
        for _ in range(len(KINDS)):
            kind = self._draw()
            if now_s < self._only_workers_until_s and any(word in kind for word in CENTRE):
                continue
            if not self._may(kind):
                continue
            done = KINDS[kind](self._context)
            if done is None:
                continue
            clock = self._testbed.clock
            done_s = clock.monotonic_s()  # some faults wait for their moment
            self.injected.append(Injected(kind, done.whom, done_s, clock.unix_s(), done_s + done.after_s))
            if done.undo is not None:
                self._undo.append((done_s + done.after_s, kind, done))
            return

    def _may(self, kind: str) -> bool:
        """Return whether this kind may be injected now: none of a kind twice at once, and not all roles frozen."""
        under_way = [other for _, other, _ in self._undo]
        frozen = sum("freeze" in other for other in under_way)
        return kind not in under_way and not ("freeze" in kind and frozen >= FROZEN_MAX)

    def _draw(self) -> str:
        if not self._next_kinds:
            self._passes += 1
            kinds = [kind for kind in KINDS if kind not in HEAVY or self._passes % 2]
            self._next_kinds = [kinds[place] for place in self._context.rng.permutation(len(kinds))]
        return self._next_kinds.pop()

    def _heal(self, now_s: float) -> None:
        for entry in [entry for entry in self._undo if entry[0] <= now_s]:
            self._undo.remove(entry)
            if entry[2].undo is not None:
                entry[2].undo()


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Run one soak and return its figures."""
    testbed = Testbed(options.rng_seed, options.fault_share)
    false_client, damaging_client = clients = [
        ByzantineClient(name, testbed.endpoint, testbed.campaign.name, derive(options.rng_seed, name))
        for name in ("false-results", "damage")
    ]
    context = FaultContext(
        testbed, false_client, damaging_client, derive(options.rng_seed, "soak_driver"), options.freeze_s
    )
    soak_driver = SoakDriver(testbed, context, options.faults_per_min)
    try:
        testbed.start()
        for client in clients:
            client.start()
        soak_driver.run(60.0 * options.minutes)
        for client in clients:
            client.end()
        ended = _let_end(testbed)
        left = testbed.stop()
        figures = figures_of(testbed, soak_driver.injected, clients, left, ended)
        figures["damaged_blocks"] = corruptions(testbed.run_dir, options.flips, derive(options.rng_seed, "flips"))
        figures["forged_messages"] = forgeries(options.forgeries, derive(options.rng_seed, "forgers"))
        figures["fuzz"] = _fuzzed(options.fuzz)
        if options.keep:
            shutil.copytree(testbed.run_dir, options.keep, ignore=shutil.ignore_patterns("ballast"))
        return figures
    finally:
        testbed.farm.stop()
        testbed.close()


def _fuzzed(seconds: float) -> dict[str, Any]:
    """Return what `scripts/fuzz` says last with a fresh seed, and whether nothing raised."""
    if seconds <= 0.0:
        return {"said": "not run", "clean": True}
    words = [sys.executable, str(FUZZ), "--fresh", "--seconds", str(seconds)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stdout, done.stderr, file=sys.stderr)
    return {"said": (done.stdout.splitlines() or [""])[-1], "clean": not done.returncode}


def _let_end(testbed: Testbed) -> bool:
    """Give the campaign a last few flights and let it come to its end in peace; return whether it did."""
    client: FarmClient | None = None
    until_s = testbed.clock.monotonic_s() + END_PATIENCE_S
    ordered = False
    while testbed.clock.monotonic_s() < until_s and not testbed.farm.over():
        testbed.farm.poll()  # the last fault may have been the router's, and nobody else starts it again
        testbed.clock.sleep_s(0.2)
        try:
            client = client or FarmClient.connect(
                testbed.endpoint, testbed.campaign.name, patience_s=2.0, insecure=True
            )
            status = client.status(within_s=0.5)
            if not ordered:
                ordered = client.order("budget", number=status.flights + LAST_FLIGHTS, within_s=0.5).accepted
        except FarmError as fault:
            logging.info("%s", fault)
            continue
        if status.state == "ended":
            client.close()
            testbed.watcher.join(10)
            return True
    if client is not None:
        client.close()
    return testbed.farm.over()


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    text = argparse.ArgumentParser(prog="scripts/soak", description="Run the real farm under faults, then audit it.")
    text.add_argument("--minutes", type=float, default=2.0, help="how long faults are injected (default 2)")
    text.add_argument("--faults-per-min", type=float, default=75.0, help="default 75")
    text.add_argument("--freeze-s", type=float, default=5.0, help="how long a frozen process stays so (long soak: 30)")
    text.add_argument("--fault-share", type=float, default=0.05, help="share of test cases that crash or hang")
    text.add_argument("--forgeries", type=int, default=500, help="forged messages to a farm with keys (default 500)")
    text.add_argument("--flips", type=int, default=20, help="blocks of the run's books flipped or cut (default 20)")
    text.add_argument("--fuzz", type=float, default=0.0, metavar="SECONDS", help="run scripts/fuzz with a fresh seed")
    text.add_argument("--rng-seed", type=int, default=1)
    text.add_argument("--keep", type=Path, help="copy the run folder here at the end")
    text.add_argument("--row", type=Path, metavar="FILE", help="append the figures as one line of JSON")
    text.add_argument("--json", action="store_true")
    return text


def _add_row(figures: dict[str, Any], options: argparse.Namespace) -> None:
    """Append one line: the commit, the store's format, what was asked for, all figures, and whether all is clean."""
    words = ["git", "-C", str(FUZZ.parent), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(words, check=False, capture_output=True, text=True)
    asked = {key: value for key, value in vars(options).items() if key not in ("keep", "row", "json")}
    row = {
        "commit": commit.stdout.strip(),
        "date": time.strftime("%Y-%m-%d"),
        "store_format": FORMAT,
        **asked,
        "clean": is_clean(figures),
        "figures": figures,
    }
    with options.row.open("a") as file:
        file.write(json.dumps(row) + "\n")


def main(argv: list[str]) -> int:
    """Run, print, and return 0 if the audit is clean."""
    options = parser().parse_args(argv)
    logging.basicConfig(
        level=logging.ERROR, stream=sys.stderr, format="%(asctime)s %(levelname).1s %(name)s: %(message)s"
    )
    figures = run(options)
    if options.row is not None:
        _add_row(figures, options)
    if options.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            if isinstance(value, dict):
                print(name)
                for key, inner in value.items():
                    print(f"  {key:32} {inner}")
            else:
                print(f"{name:34} {value}")
    sys.stdout.flush()
    leave_process(0 if is_clean(figures) else 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
