"""`scripts/bench bugs-real`: which of the paper's ten bugs a real binary still has, by flying each one's known trigger.

    scripts/bench bugs-real [--target ardupilot|px4] [--json]
    scripts/bench bugs-real --blind BUG ... [--arms ARM ...] [--seeds 5] [--budget 100] [--out FILE.jsonl]

The triggers are those of the public reports (`services/saflite/console/evaluation/data/rq2_bugs.toml`); parameters
that were renamed since have today's names, or those of then where the binary has them. Each is flown once for every
random seed and judged by the bug's own policy:
`present` where that is violated in all flights, `sometimes` in some, `absent` where it holds or where the binary lacks
what triggers it, `never applied` where the rule's condition did not come about, `not judged` where a signal is missing.
Where the rule of the table asks something else than the report complains of, `as_reported` says in how many flights
that was seen.

With `--blind` the rules of the bugs named are searched for without being told the triggers, by PGFuzz's own draws from
its list and from every input of the binary, with and without a scorer that has read the paper's words, and by our
campaigns as they are shipped. Searches of this binary that are in the file are passed over.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from _bugs_blind import ARMS, searches

from saflite.conformance.flying import DEADLINE_S
from saflite.console.evaluation.bugs import bugs
from saflite.console.operations import judging
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, Trace, unpack_trace
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
from saflite.simulator_worker.registry import load_target, why_missing

ROWS = Path(__file__).resolve().parent / "results" / "bugs_real.jsonl"
SEEDS = 3
LIMIT_S = 45.0
TARGETS = {"ArduPilot": "ardupilot", "PX4": "px4"}
Given = tuple[float, StimulusKind, str, tuple[float, ...]]
HOME = (47.3977419, 8.5455938)


class Known(NamedTuple):
    """A known trigger as it is flown: start state, parameters set before, timed inputs."""

    start: StartState
    inputs: tuple[Given, ...]
    parameters: dict[str, float] = {}  # noqa: RUF012  (never changed)


_CHUTE: Given = (2.2, "command", "MAV_CMD_DO_PARACHUTE", (2.0,))
_LOST: Given = (2.0, "sensor_fault", "gps_off", (1.0,))
_DELAY = {"COM_POS_FS_DELAY": -1.0}
ALT_HOLD, LEAP_M = 2.0, 50.0
_FF = {"ATC_RAT_RLL_FF": 0.432304, "ATC_RATE_R_MAX": 11.0}
_GROUND = {"BARO_GND_TEMP": 40.0, "BARO_ALT_OFFSET": 300.0, "GPS_POS1_Z": 2.474742}
_FLIP: Given = (6.0, "mode", "FLIP", ())
_HELD = StartState(mode="BRAKE", altitude_m=20.0)
KNOWN: dict[str, Known] = {
    "3": Known(StartState(mode="ALT_HOLD", altitude_m=8.0), ((2.0, "mode", "FLIP", ()),)),
    "23 case 1": Known(
        StartState(mode="ALT_HOLD", altitude_m=30.0), ((2.0, "mode", "FLIP", ()), _CHUTE), {"CHUTE_ENABLED": 1.0}
    ),
    "23 case 2": Known(
        StartState(mode="LOITER", altitude_m=30.0), ((0.2, "stick", "RC3", (1900.0,)), _CHUTE), {"CHUTE_ENABLED": 1.0}
    ),
    "24": Known(
        StartState(mode="STABILIZE", altitude_m=0.0, armed=False),
        (
            *((1.0 + 0.2 * i, "parameter", name, (value,)) for i, (name, value) in enumerate(_GROUND.items())),
            (3.0, "command", "MAV_CMD_COMPONENT_ARM_DISARM", (1.0,)),
            (5.0, "stick", "RC3", (1900.0,)),
            (8.0, "stick", "RC3", (1300.0,)),
            (9.5, "stick", "RC3", (1500.0,)),
            (10.0, "mode", "ALT_HOLD", ()),
            (16.0, "mode", "FLIP", ()),
        ),
    ),
    "25": Known(StartState(mode="ALT_HOLD", altitude_m=50.0), (_FLIP,), _FF),
    "133": Known(_HELD, ((1.0, "command", "MAV_CMD_DO_ORBIT", (10.0, 3.0)), _LOST), _DELAY),
    "134": Known(_HELD, ((1.0, "mode", "RTL", ()), _LOST), _DELAY),
    "135": Known(_HELD, (_LOST,), _DELAY),
    "new A": Known(_HELD, ((1.0, "command", "MAV_CMD_DO_REPOSITION", (-1.0, 0.0, 0.0, 0.0, *HOME, 518.8)),)),
    "new B": Known(_HELD, ((2.0, "mode", "ACRO", ()), _CHUTE)),
}
"""The unknown values of "new A" are a height 10 m up; "flying to another place" of 134 is a return."""


def _aims_far_off(flight: Flight, trace: Trace) -> bool:
    """Whether the height aimed at leaps in ALT_HOLD while the vehicle stays within a tenth of that."""
    holding = trace.array("mode") == ALT_HOLD
    aimed, height = (trace.array(name)[holding] for name in ("altitude_target_m", "altitude_m"))
    return bool(len(aimed)) and float(np.ptp(aimed)) >= max(LEAP_M, 10.0 * float(np.ptp(height)))


AS_REPORTED: dict[str, Callable[[Flight, Trace], bool]] = {
    "24": _aims_far_off,
    "25": lambda flight, trace: flight.ending == "crashed",
}
"""What the public report shows: 14425 a wrong target height, 14446 a crash."""
NAMES_OF_THEN = {"BARO_GND_TEMP": "GND_TEMP", "BARO_ALT_OFFSET": "GND_ALT_OFFSET"}
"""Renamed in ArduPilot 4.1 (its `AP_Baro.cpp` before and after)."""


def case(number: str, target: str, rng_seed: int, has: Collection[str]) -> TestCase:
    """Return the test case of a bug's known trigger; `has` are the binary's inputs."""
    known = KNOWN[number]

    def here(name: str) -> str:
        return next((one for one in (name, NAMES_OF_THEN.get(name, name)) if one in has), name)

    return TestCase(
        target=Target(name=target, parameters={here(name): value for name, value in known.parameters.items()}),
        scenario=Scenario(start=known.start, time_limit_s=LIMIT_S),
        stimuli=tuple(
            Stimulus(at_s=at, kind=kind, name=here(name), values=values) for at, kind, name, values in known.inputs
        ),
        rng_seed=rng_seed,
    )


def flown(simulator: judging.OwnSimulator, number: str, policy: str, target: TargetInfo) -> dict[str, Any]:
    """Fly a trigger once for each seed; return what the policy said, and what became of the inputs."""
    rows, answers, seen = [], [], AS_REPORTED.get(number)
    for rng_seed in range(SEEDS):
        given = case(number, target.name, rng_seed, {one.name for one in target.inputs})
        try:
            made = simulator.fly(given, DEADLINE_S)
        except Refused as fault:
            return {"state": "absent", "why": str(fault)}
        (verdict,) = judging.judge(given, made, (policy,)).verdicts
        row = {"outcome": verdict.outcome, "robustness": verdict.robustness, "ending": made.flight.ending}
        if seen is not None and made.packed:
            row["as_reported"] = seen(made.flight, unpack_trace(made.packed))
        rows.append(row)
        answers = [f"{one.answer} {one.message}".strip() for one in made.flight.delivered or ()]
    return {"state": _state({str(row["outcome"]) for row in rows}), "flights": rows, "answers": answers}


def _state(outcomes: set[str]) -> str:
    if outcomes == {"violated"}:
        return "present"
    if "violated" in outcomes:
        return "sometimes"
    return "absent" if "held" in outcomes else "not judged" if "inconclusive" in outcomes else "never applied"


def blind(options: argparse.Namespace) -> int:
    """Search for the rules of bugs, and add a row for each search."""
    lines = options.out.read_text(encoding="utf-8").splitlines() if options.out.exists() else []
    info = load_target(options.target).describe()
    had = [row for row in map(json.loads, lines) if row.get("part") == "blind" and row["autopilot"] == info.autopilot]
    done = {(row["policy"], row["arm"], row["rng_seed"]) for row in had}
    seeds = range(1, options.seeds + 1)
    for row in searches(info, options.blind, options.arms, seeds, options.budget, done):
        with options.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row._asdict()) + "\n")
        told = f"flight {row.found}: {row.trigger}" if row.found else f"not found in {row.judged}"
        print(f"{row.policy}, {row.arm}, seed {row.rng_seed}: {told} ({row.wall_s:.0f} s)", flush=True)
    return 0


def main(argv: list[str]) -> int:
    """Fly the triggers of a target's bugs; 3 where the target cannot fly here."""
    parser = argparse.ArgumentParser(prog="scripts/bench bugs-real", description=__doc__)
    parser.add_argument("--target", choices=sorted(TARGETS.values()), default="ardupilot")
    parser.add_argument("--json", action="store_true", help="one JSON object a bug, as in the committed rows")
    parser.add_argument("--blind", nargs="+", choices=sorted(KNOWN), metavar="BUG", help="search for these")
    parser.add_argument("--arms", nargs="+", choices=sorted(ARMS), default=list(ARMS), metavar="ARM", help="by these")
    parser.add_argument("--seeds", type=int, default=5, help="searches of each arm")
    parser.add_argument("--budget", type=int, default=100, help="first flights of a search")
    parser.add_argument("--out", type=Path, default=ROWS, help="rows of searches are added to it")
    options = parser.parse_args(argv)
    lacking = why_missing(options.target)
    if lacking:
        sys.stderr.write(f"{options.target}: {lacking}\n")
        return 3
    if options.blind:
        return blind(options)
    load = f"{os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"
    target = load_target(options.target).describe()
    simulator = judging.OwnSimulator()
    try:
        for bug in bugs():
            if TARGETS[bug.autopilot] == options.target:
                found = flown(simulator, bug.id, bug.policy, target)
                row = {"bench": "bugs-real", "target": target.name, "autopilot": target.autopilot, "bug": bug.id}
                row |= {"policy": bug.policy, "load": load, **found}
                print(json.dumps(row) if options.json else f"{bug.id}: {json.dumps(found)}", flush=True)
    finally:
        simulator.close()
    return 0
