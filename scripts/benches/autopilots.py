"""Real autopilots in lockstep: how fast beside bare JSBSim, whether a flight repeats bit by bit, what is left behind.

    speed   a hover by the core time of autopilot and world together, a long flight less a short one, so that bringing
            up does not count, each from power-up; the F450 that JSBSim ships is stepped alone in the same turn
    again   drawn cases flown in one session, then in another in the opposite order: after others as alone
    round   the same on mission 2 round boxes drawn across its legs, by the autopilot's own avoidance
    forks   drawn cases flown from power-up, and forked from the held start state: outcome, and core time of each
    leaks   cases in a row, from the ground: processes, open files, listening ports and files on disk that are left

Core time counts: a busy machine stretches wall time. The binary is the one that the environment names for the target.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any

from flight import bare_shipped
from msgspec.structs import replace

from saflite.conformance.flying import DEADLINE_S
from saflite.contract.flight import FlightRecord, trace_digest
from saflite.contract.rng import derive
from saflite.contract.target import Session
from saflite.contract.target_info import InputInfo
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.mission import builtin_mission
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.registry import load_target, why_missing
from saflite.simulator_worker.slots import take_slot
from saflite.simulator_worker.targets._external import ForkingExternalSession

SHORT_S, LONG_S, ROUND_S = 10.0, 70.0, 200.0
DISTANCE, FAR_M = "obstacle_distance_m", 1_000.0
STARTS = 20
KINDS = ("stick", "mode", "parameter", "sensor_fault", "command")
LISTENING = "0A"  # TCP state in /proc/net/tcp


def hover(target: Target, limit_s: float, *stimuli: Stimulus) -> TestCase:
    """Return a flight from the target's first start state, 20 m up, with some inputs."""
    name = target.name
    start = load_target(name).describe().start_states[0]
    scenario = Scenario(start=StartState(mode=start.mode, altitude_m=20.0), time_limit_s=limit_s)
    return TestCase(target=target, scenario=scenario, stimuli=stimuli, rng_seed=1)


def on_ground(case: TestCase) -> TestCase:
    """Return the same from the ground: the target's last start state."""
    start = load_target(case.target.name).describe().start_states[-1]
    return replace(case, scenario=replace(case.scenario, start=start))


def drawn(target: Target, number: int, limit_s: float) -> TestCase:
    """Return a test case with three inputs, each of a kind drawn first, values within documented ranges."""
    name = target.name
    rng = derive(number, "bench", "autopilots", name)
    info = load_target(name).describe()
    without = info.lacking(target.settings)
    inputs = [one for one in info.inputs if not one.at_start and one.name not in without]
    groups = [found for kind in KINDS if (found := [one for one in inputs if one.kind == kind and _usable(one)])]
    stimuli = []
    for at_s in sorted(rng.uniform(0.1, 0.8 * limit_s, 3)):
        group = groups[int(rng.integers(len(groups)))]
        one = group[int(rng.integers(len(group)))]
        values = () if one.low is None or one.high is None else (round(float(rng.uniform(one.low, one.high)), 3),)
        stimuli.append(Stimulus(at_s=round(float(at_s), 2), kind=one.kind, name=one.name, values=values))
    return hover(target, limit_s, *stimuli)


def round_boxes(target: Target, number: int) -> TestCase:
    """Return mission 2 with two boxes drawn over the field of its first legs."""
    rng = derive(number, "bench", "autopilots", "round")
    middles = ((rng.uniform(-10.0, 30.0), rng.uniform(10.0, 40.0)) for _ in range(2))
    boxes = tuple(
        Obstacle(
            length_m=round(float(rng.uniform(3.0, 12.0)), 2),
            width_m=round(float(rng.uniform(3.0, 8.0)), 2),
            height_m=25.0,
            x_m=round(float(x_m), 2),
            y_m=round(float(y_m), 2),
            rotation_deg=round(float(rng.uniform(0.0, 90.0)), 1),
        )
        for x_m, y_m in middles
    )
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=boxes, time_limit_s=ROUND_S)
    return TestCase(target=target, scenario=scenario, rng_seed=number)


def _usable(one: InputInfo) -> bool:
    return one.kind in ("mode", "command") or (one.low is not None and one.high is not None)


def fly(session: Session, case: TestCase) -> FlightRecord:
    """Fly a case to its end."""
    return session.fly(case, DEADLINE_S, lambda: False)


# ---- parts --------------------------------------------------------------------------------------------------------


def speed(options: argparse.Namespace) -> dict[str, Any]:
    """Return factors of real time by core time: bare, flown, bringing up; medians over the turns."""
    held = take_slot()
    session = load_target(options.target.name).open(held.info.slot(WallClock()))
    rows = []
    try:
        for _ in range(options.turns):
            bare_s, _, bare_core_s, _ = bare_shipped()
            short, long = (_core_s(session, hover(options.target, limit_s)) for limit_s in (SHORT_S, LONG_S))
            flown = (LONG_S - SHORT_S) / (long["core_s"] - short["core_s"])
            wall = (LONG_S - SHORT_S) / (long["wall_s"] - short["wall_s"])
            bring_up_s = short["core_s"] - SHORT_S / flown
            rows.append({"bare_x": bare_s / bare_core_s, "x": flown, "wall_x": wall, "bring_up_core_s": bring_up_s})
    finally:
        session.close()
        held.release()
    middle = {key: round(median(row[key] for row in rows), 3) for key in rows[0]}
    share = median(row["x"] / row["bare_x"] for row in rows)
    return {**middle, "share_of_bare": round(share, 3), "turns": [_rounded(row) for row in rows]}


def _core_s(session: Session, case: TestCase) -> dict[str, float]:
    before, began_s = _used_s(), time.monotonic()
    if isinstance(session, ForkingExternalSession):  # a fork's core time is its root's, and told when that ends
        record = session.fly_cold(case, DEADLINE_S, lambda: False)
    else:
        record = fly(session, case)
    assert record.ending == "completed", record.message
    return {"core_s": _used_s() - before, "wall_s": time.monotonic() - began_s}


def _used_s() -> float:
    """Return the core time of this process and of all that it has taken leave of."""
    own = os.times()
    return own.user + own.system + own.children_user + own.children_system


def _rounded(row: dict[str, float]) -> dict[str, float]:
    return {key: round(value, 3) for key, value in row.items()}


def again(options: argparse.Namespace) -> dict[str, Any]:
    """Fly drawn cases in one session, then in another in the opposite order; return how many are equal, and endings."""
    return _compared([drawn(options.target, number, SHORT_S) for number in range(options.again)])


def round_again(options: argparse.Namespace) -> dict[str, Any]:
    """Do the same round boxes; `nearest_m` is how near each flight came to one."""
    return _compared([round_boxes(options.target, number) for number in range(options.round)])


def _compared(cases: list[TestCase]) -> dict[str, Any]:
    numbers = list(range(len(cases)))
    first = _flown(cases, numbers)
    second = _flown(cases, numbers[::-1])
    wrong = {number: list(differences(first[number], second[number])) for number in numbers}
    wrong = {number: parts for number, parts in wrong.items() if parts}
    endings = [record.ending for record in first.values()]
    digests = {"" if one.trace is None else trace_digest(one.trace) for one in first.values()}
    return {
        "flown": len(numbers),
        "equal_after_others_in_another_order": len(numbers) - len(wrong),
        "distinct_traces": len(digests),
        "endings": {ending: endings.count(ending) for ending in sorted(set(endings))},
        **_nearest(first.values()),
        "wrong": wrong,
    }


def _nearest(flown: Iterable[FlightRecord]) -> dict[str, Any]:
    traces = [one.trace for one in flown if one.trace is not None and DISTANCE in one.trace.signals]
    nearest_m = sorted(round(float(trace.array(DISTANCE).min()), 1) for trace in traces)
    return {"nearest_m": nearest_m} if any(one < FAR_M for one in nearest_m) else {}


def _flown(cases: list[TestCase], numbers: list[int]) -> dict[int, FlightRecord]:
    held = take_slot()
    session = load_target(cases[0].target.name).open(held.info.slot(WallClock()))
    try:
        return {number: fly(session, cases[number]) for number in numbers}
    finally:
        session.close()
        held.release()


def forks(options: argparse.Namespace) -> dict[str, Any]:
    """Fly drawn cases from power-up and forked from their start; return how many are equal bit by bit, and the times.

    `fork_wall_ms` is the wall time, of a flight cut short, until a forked flight is over: an upper bound of its start.
    `fork_alone_ms` is that of the autopilot's fork, from the order until it is there and waits where the held one does.
    """
    cases = [drawn(options.target, number, SHORT_S) for number in range(options.forks)]
    cut_short = hover(options.target, 0.05)
    held = take_slot()
    session = load_target(options.target.name).open(held.info.slot(WallClock()))
    assert isinstance(session, ForkingExternalSession), "this target does not fork"
    try:
        began_s = time.monotonic()
        cold = [session.fly_cold(case, DEADLINE_S, lambda: False) for case in cases]
        cold_s = time.monotonic() - began_s
        fly(session, cases[0])  # reaches the start state
        began_s = time.monotonic()
        forked = [fly(session, case) for case in cases]
        forked_s = time.monotonic() - began_s
        fly(session, cut_short)
        starts_ms = [_wall_ms(session, cut_short) for _ in range(STARTS)]
        session.close()
        alone_ms = _forks_alone_ms(session, cut_short)
    finally:
        session.close()
        held.release()
    wrong = {number: list(differences(*pair)) for number, pair in enumerate(zip(cold, forked, strict=True))}
    endings = [record.ending for record in cold]
    return {
        "flown": len(cases),
        "equal": sum(not parts for parts in wrong.values()),
        "endings": {ending: endings.count(ending) for ending in sorted(set(endings))},
        "cold_wall_s": round(cold_s / len(cases), 3),
        "forked_wall_s": round(forked_s / len(cases), 3),
        "fork_wall_ms": {"least": round(min(starts_ms), 2), "median": round(median(starts_ms), 2)},
        "fork_alone_ms": {"least": round(min(alone_ms), 2), "median": round(median(alone_ms), 2)},
        "wrong": {number: parts for number, parts in wrong.items() if parts},
    }


def _forks_alone_ms(session: ForkingExternalSession, case: TestCase) -> list[float]:
    held, taken_ms = session._begin(case), []
    try:
        for _ in range(STARTS):
            began_s = time.monotonic()
            with held.forking():
                taken_ms.append(1000.0 * (time.monotonic() - began_s))
    finally:
        held.close()
    return taken_ms


def _wall_ms(session: Session, case: TestCase) -> float:
    began_s = time.monotonic()
    fly(session, case)
    return 1000.0 * (time.monotonic() - began_s)


def leaks(options: argparse.Namespace) -> dict[str, Any]:
    """Fly drawn cases in a row in one session; return what grew between the first and the last."""
    held = take_slot()
    info = held.info
    ports = range(info.first_port, info.first_port + info.ports)
    session = load_target(options.target.name).open(info.slot(WallClock()))
    try:
        fly(session, on_ground(drawn(options.target, 0, 1.0)))
        before = _left(Path(info.folder), ports)
        cases = (on_ground(drawn(options.target, number, 1.0)) for number in range(options.leaks))
        endings = [fly(session, case).ending for case in cases]
        after = _left(Path(info.folder), ports)
    finally:
        session.close()
        held.release()
    grown = {key: after[key] - before[key] for key in before}
    counted = {ending: endings.count(ending) for ending in sorted(set(endings))}
    return {"flown": len(endings), "grown": grown, "endings": counted}


def _left(folder: Path, ports: range) -> dict[str, int]:
    return {
        "processes": len(children(os.getpid())),
        "open_files": len(os.listdir("/proc/self/fd")),
        "listening_ports": len(_bound() & set(ports)),
        "files_on_disk": sum(1 for _ in folder.rglob("*")),
    }


def _bound() -> set[int]:
    """Return the ports of this host that are listened on (TCP) or bound (UDP)."""
    found = set()
    for kind in ("tcp", "udp"):
        for line in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]:
            words = line.split()
            if kind == "udp" or words[3] == LISTENING:
                found.add(int(words[1].rpartition(":")[2], 16))
    return found


PARTS: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
    "speed": speed,
    "again": again,
    "round": round_again,
    "forks": forks,
    "leaks": leaks,
}


def main(argv: list[str]) -> int:
    """Run the parts asked for; 3 where the target cannot fly here."""
    parser = argparse.ArgumentParser(prog="scripts/bench autopilots", description=__doc__)
    parser.add_argument("--target", default="ardupilot")
    parser.add_argument(
        "--set", dest="settings", action="append", default=[], metavar="NAME=VALUE", help="of the target"
    )
    parser.add_argument("--parts", nargs="+", choices=sorted(PARTS), default=["speed", "again", "leaks"])
    for name, default in (("turns", 5), ("again", 40), ("round", 20), ("forks", 40), ("leaks", 200)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--json", action="store_true", help="one JSON object a part, as in the committed rows")
    options = parser.parse_args(argv)
    name, settings = options.target, dict(one.split("=", 1) for one in options.settings)
    options.target = Target(name=name, settings=settings)
    lacking = why_missing(name)
    if lacking:
        sys.stderr.write(f"{name}: {lacking}\n")
        return 3
    autopilot = load_target(name).describe().autopilot
    for part in options.parts:
        load = f"{os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"
        found = PARTS[part](options)
        row = {
            "bench": "autopilots",
            "part": part,
            "target": name,
            **({"settings": settings} if settings else {}),
            "autopilot": autopilot,
            "load": load,
            **found,
        }
        print(json.dumps(row) if options.json else f"{part}: {json.dumps(found)}", flush=True)
    return 0
