"""Betaflight in lockstep: how fast beside bare JSBSim, what a fork costs, whether it is the flight from power-up.

Parts: `lockstep` (simulated time per second of one core's time, firmware and world together, beside the bare F450 that
JSBSim ships and our own bare file of it, at the same step in turns), `forks` (to the first step, on demand and as a
session does it, which forks ahead; memory), `cases`
(test cases of 10 s per second), `equal` (forked flights against cold ones, bit by bit), `again` (cases re-flown),
`leaks` (forks in a row). Core time counts, wall time is beside it: a busy machine stretches the latter.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NoReturn, cast

import flight as flight_bench

from saflite.conformance.flying import DEADLINE_S, opened
from saflite.contract.flight import FlightRecord, trace_digest
from saflite.contract.rng import derive
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.autopilots.betaflight.configuration import configure
from saflite.flight.autopilots.betaflight.firmware import VARIANTS
from saflite.flight.autopilots.betaflight.flight import TICK_STEPS, BetaflightFlight
from saflite.flight.autopilots.betaflight.vehicle import OK
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.state import STEP_S
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.forks import Forks
from saflite.simulator_worker.processes import children, resident_mib
from saflite.simulator_worker.registry import load_target, why_missing
from saflite.simulator_worker.targets._betaflight import BetaflightSession

NAME, VARIANT = "betaflight", VARIANTS["gps"]
CASE_S = 10.0
TURN_TICKS, TURNS = 250, 8
WARM_UP_TICKS = 50
BETWEEN_ORDERS_S = 0.01  # enough for the fork that is made ahead
ENDING_POLLS, ALIKE_POLLS = 100, 10  # of 0.1 s, for the last fork to end: until nothing changes any more


def never() -> bool:
    """Never stop."""
    return False


def hover(limit_s: float = CASE_S, *stimuli: Stimulus) -> TestCase:
    """Return a hover in ANGLE with some inputs."""
    scenario = Scenario(start=StartState(mode="ANGLE", altitude_m=20.0), time_limit_s=limit_s)
    return TestCase(target=Target(name=NAME), scenario=scenario, stimuli=stimuli, rng_seed=1)


def drawn(number: int, limit_s: float) -> TestCase:
    """Return a test case with three inputs drawn from all but settings; each third case with another gain."""
    rng = derive(number, "bench", "betaflight")
    inputs = [one for one in load_target(NAME).describe().inputs if not one.at_start]
    stimuli = []
    for at_s in sorted(rng.uniform(0.1, 0.8 * limit_s, 3)):
        one = inputs[int(rng.integers(len(inputs)))]
        values = () if one.low is None or one.high is None else (round(float(rng.uniform(one.low, one.high)), 3),)
        stimuli.append(Stimulus(at_s=round(float(at_s), 2), kind=one.kind, name=one.name, values=values))
    if number % 3 == 0:
        gain = float(rng.integers(30, 60))
        stimuli.insert(0, Stimulus(at_s=0.0, kind="parameter", name="p_roll", values=(gain,)))
    return hover(limit_s, *stimuli)


def core_s(pid: int) -> float:
    """Return the time a process has had on a core."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) / 1e9


# ---- parts --------------------------------------------------------------------------------------------------------


def lockstep(options: argparse.Namespace) -> dict[str, Any]:
    """Hover and bare JSBSim in turns; medians over the turns."""
    case = hover(600.0)
    with TemporaryDirectory() as place:
        flight = BetaflightFlight(case, VARIANT, configure(VARIANT, {}, Path(place)), Path(place))
        flight.begin()
        bare, shipped, rows = World(20.0), flight_bench.shipped_f450(), []
        try:
            for turn in range(TURNS + 1):
                row = _turn(flight, (bare.step_jsbsim, shipped.run), WARM_UP_TICKS if turn == 0 else TURN_TICKS)
                rows += [row] if turn else []
        finally:
            flight.close()
    middle = {key: median(row[key] for row in rows) for key in rows[0]}
    both = middle["firmware_us"] + middle["world_us"]
    return {
        **{key: round(value, 2) for key, value in middle.items()},
        "bare_ours_x": round(STEP_S * 1e6 / middle["bare_ours_us"], 1),
        "bare_shipped_x": round(STEP_S * 1e6 / middle["bare_shipped_us"], 1),
        "lockstep_x": round(STEP_S * 1e6 / both, 1),
        "of_bare_ours": _share(rows, "bare_ours_us"),
        "of_bare_shipped": _share(rows, "bare_shipped_us"),
        "turns": rows,
    }


def _share(rows: list[dict[str, float]], bare: str) -> float:
    return round(median(row[bare] / (row["firmware_us"] + row["world_us"]) for row in rows), 3)


def _turn(flight: BetaflightFlight, bare: tuple[Callable[[], object], ...], ticks: int) -> dict[str, float]:
    steps, pid = ticks * TICK_STEPS, flight.vehicle.pid
    firmware_s, world_s, wall_s = core_s(pid), time.process_time(), time.monotonic()
    for _ in range(ticks):
        assert flight._step(never) is None, "the hover ended"
    took = {"firmware_us": core_s(pid) - firmware_s, "world_us": time.process_time() - world_s}
    took["wall_us"] = time.monotonic() - wall_s
    for name, step in zip(("bare_ours_us", "bare_shipped_us"), bare, strict=True):
        began_s = time.process_time()
        for _ in range(steps):
            step()
        took[name] = time.process_time() - began_s
    return {key: value / steps * 1e6 for key, value in took.items()}


def forks(options: argparse.Namespace) -> dict[str, Any]:
    """Fork the firmware of a held hover again and again; time to its first step by stages, memory of those held."""
    case = hover()
    with TemporaryDirectory() as place:
        flight = BetaflightFlight(case, VARIANT, configure(VARIANT, {}, Path(place)), Path(place))
        flight.begin()
        try:
            rows = [_forked(flight) for _ in range(options.forks)]
        finally:
            flight.close()
    ordered = _ordered(case, options.forks)
    with _session() as session:
        session.fly(case, DEADLINE_S, never)
        before = resident_mib(os.getpid())
        held = [session.snapshot(case, 0.02 * number, DEADLINE_S, never) for number in range(1, 11)]
        memory = (resident_mib(os.getpid()) - before) / len(held)
    took = [row["to_first_step_ms"] for row in rows]
    return {
        "forks": len(took),
        "to_first_step_ms": _spread(took),
        "ordered_to_first_step_ms": _spread(ordered),
        "least": {key: round(min(row[key] for row in rows), 3) for key in rows[0]},
        "memory_each_mib": round(memory, 1),
    }


def _spread(took: list[float]) -> dict[str, float]:
    places = {"least": 0, "median": len(took) // 2, "p95": int(0.95 * len(took))}
    return {key: round(sorted(took)[place], 3) for key, place in places.items()}


class _FirstStep:
    """A held flight whose forks, ordered to fly on, do one step and say when it was done."""

    def __init__(self, flight: BetaflightFlight) -> None:
        self._flight = flight
        self.forking, self.take_up = flight.forking, flight.take_up
        self.fly_to, self.close = flight.fly_to, flight.close

    @property
    def files(self) -> frozenset[int]:
        """See `HeldFlight`."""
        return self._flight.files

    def fly_on(self, test_case: TestCase, cancelled: Cancelled) -> FlightRecord:
        """Do one step; `message` is the monotonic time at its end."""
        self._flight._follow(test_case)
        self._flight.inputs.tick(0.0)
        assert self._flight.vehicle.run(1) == OK, "no step"
        done_s = time.monotonic()
        self._flight.close()
        return FlightRecord("completed", None, repr(done_s), ())


def _ordered(case: TestCase, count: int) -> list[float]:
    """Order flights of one step from a held hover, with a short pause between them; ms from each order to the step."""
    took = []
    with TemporaryDirectory() as place:
        memory = configure(VARIANT, {}, Path(place))

        def begin(test_case: TestCase) -> _FirstStep:
            flight = BetaflightFlight(test_case, VARIANT, memory, Path(place))
            flight.begin()
            return _FirstStep(flight)

        forks = Forks(begin)
        held = forks.hold(case, 0.0, never)
        for _ in range(count):
            time.sleep(BETWEEN_ORDERS_S)
            began_s = time.monotonic()
            record = forks.fly_from(held, case, never)
            assert record is not None, "the held flight is gone"
            took.append((float(record.message) - began_s) * 1e3)
        forks.close()
    return took


def _forked(flight: BetaflightFlight) -> dict[str, float]:
    """Fork world and firmware and step once in the fork; return how long each stage took there, and page faults."""
    ours, theirs = os.pipe()
    began_s = time.monotonic()
    with flight.forking():
        pid = os.fork()
        if pid == 0:
            _first_step(flight, began_s, theirs)
    os.close(theirs)
    said = os.read(ours, 4096)
    os.close(ours)
    os.waitpid(pid, 0)
    return cast(dict[str, float], json.loads(said))


def _first_step(flight: BetaflightFlight, began_s: float, told: int) -> NoReturn:
    """In the fork: step once, write what each stage took, end."""
    forked_s = time.monotonic()
    flight._fork_firmware()
    answered_s, faults = time.monotonic(), getrusage(RUSAGE_SELF).ru_minflt
    flight.vehicle.run(1)
    done_s = time.monotonic()
    row = {
        "to_first_step_ms": (done_s - began_s) * 1e3,
        "world_ms": (forked_s - began_s) * 1e3,
        "firmware_ms": (answered_s - forked_s) * 1e3,
        "step_ms": (done_s - answered_s) * 1e3,
        "faults_before_step": float(faults),
        "faults_of_step": float(getrusage(RUSAGE_SELF).ru_minflt - faults),
    }
    os.write(told, json.dumps(row).encode())
    flight.close()
    os._exit(0)


def cases(options: argparse.Namespace) -> dict[str, Any]:
    """Fly cases of 10 s that begin alike on as many sessions as asked; bare JSBSim's speed stands in `lockstep`."""
    each = options.cases // options.sessions
    began_s = time.monotonic()
    with ProcessPoolExecutor(options.sessions) as pool:
        used = list(pool.map(_fly_cases, range(options.sessions), [each] * options.sessions))
    wall_s = max(row["wall_s"] for row in used)
    core = sum(row["core_s"] for row in used)
    flown = each * options.sessions
    return {
        "sessions": options.sessions,
        "flown": flown,
        "per_s_of_wall_time": round(flown / wall_s, 2),
        "per_s_on_two_free_cores": round(2 * flown / core, 2),
        "core_s_each": round(core / flown, 3),
        "with_bring_up_wall_s": round(time.monotonic() - began_s, 1),
    }


def _fly_cases(part: int, count: int) -> dict[str, float]:
    with _session() as session:
        session.fly(hover(), DEADLINE_S, never)
        began, core = time.monotonic(), _all_core_s()
        for number in range(count):
            stick = Stimulus(at_s=5.0, kind="stick", name="RC1", values=(1450.0 + (part * count + number) % 100,))
            session.fly(hover(CASE_S, stick), DEADLINE_S, never)
        return {"wall_s": time.monotonic() - began, "core_s": _all_core_s() - core}


def _all_core_s() -> float:
    """Return the core time of this process, of those it holds, and of all that these have taken leave of."""
    own = os.times()
    return own.user + own.system + own.children_user + own.children_system + _held_core_s(os.getpid())


def _held_core_s(pid: int) -> float:
    found = 0.0
    for child in children(pid):
        words = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
        found += sum(map(int, words[11:15])) / os.sysconf("SC_CLK_TCK") + _held_core_s(child)
    return found


def equal(options: argparse.Namespace) -> dict[str, Any]:
    """Fly drawn cases from power-up and forked; return how many are equal bit by bit."""
    with _session() as session:
        wrong = [number for number in range(options.equal) if _differs(session, drawn(number, 4.0))]
    return {"flown_both_ways": options.equal, "equal": options.equal - len(wrong), "wrong": wrong}


def _differs(session: BetaflightSession, case: TestCase) -> bool:
    cold = session.fly_cold(case, DEADLINE_S, never)
    return any(differences(cold, session.fly(case, DEADLINE_S, never)))


def again(options: argparse.Namespace) -> dict[str, Any]:
    """Fly drawn cases in one session, then on three at once in another order; return how many are equal."""
    numbers = list(range(options.again))
    first = dict(_digests(numbers))
    with ProcessPoolExecutor(3) as pool:
        second = dict(pair for part in pool.map(_digests, [numbers[k::3][::-1] for k in range(3)]) for pair in part)
    wrong = [number for number in numbers if first[number] != second[number]]
    return {"flown": len(numbers), "equal_on_three_at_once": len(numbers) - len(wrong), "wrong": wrong}


def _digests(numbers: list[int]) -> list[tuple[int, str]]:
    with _session() as session:
        return [(number, _digest(session.fly(drawn(number, 4.0), DEADLINE_S, never))) for number in numbers]


def _digest(record: FlightRecord) -> str:
    trace = "" if record.trace is None else trace_digest(record.trace)
    return f"{record.ending} {trace} {record.delivered}"


def leaks(options: argparse.Namespace) -> dict[str, Any]:
    """Fly very short forks in a row; what is left in memory, files and processes."""
    with _session() as session:
        session.fly(hover(0.1), DEADLINE_S, never)
        for number in range(50):
            session.fly(_short(number), DEADLINE_S, never)
        before = _left()
        for number in range(options.leaks):
            session.fly(_short(number), DEADLINE_S, never)
        after = _left()
    grown = {key: round(after[key] - before[key], 2) for key in before}
    return {"forks": options.leaks, "grown": grown}


def _short(number: int) -> TestCase:
    return hover(0.1, Stimulus(at_s=0.04, kind="stick", name="RC1", values=(1400.0 + number % 200,)))


def _held(pid: int) -> list[int]:
    """Return the processes below one, without those that have ended and wait for their parent to notice."""
    below = [one for one in children(pid) if _memory_pages(one)]
    return [*below, *(further for one in below for further in _held(one))]


def _memory_pages(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[0])
    except OSError:
        return 0


def _left() -> dict[str, float]:
    """Return what is held once the last fork has ended and the next waits; pages that processes share count once."""
    alike, held = 0, _held(os.getpid())
    for _ in range(ENDING_POLLS):
        time.sleep(0.1)
        now = _held(os.getpid())
        alike, held = (alike + 1 if now == held else 0), now
        if alike >= ALIKE_POLLS:
            break
    files = sum(len(os.listdir(f"/proc/{pid}/fd")) for pid in (os.getpid(), *held))
    return {"memory_mib": resident_mib(os.getpid()), "files": float(files), "processes": float(len(held))}


def _session() -> Any:
    return cast(Any, opened(load_target(NAME)))


PARTS: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
    "lockstep": lockstep,
    "forks": forks,
    "cases": cases,
    "equal": equal,
    "again": again,
    "leaks": leaks,
}


def main(argv: list[str]) -> int:
    """Run the parts asked for; 3 where the firmware is not built."""
    parser = argparse.ArgumentParser(prog="scripts/bench betaflight", description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=sorted(PARTS), default=list(PARTS))
    for name, default in (("forks", 300), ("cases", 100), ("equal", 200), ("again", 1000), ("leaks", 10_000)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--sessions", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    options = parser.parse_args(argv)
    lacking = why_missing(NAME)
    if lacking:
        sys.stderr.write(f"betaflight: {lacking}\n")
        return 3
    found = {}
    for name in options.parts:
        found[name] = PARTS[name](options)
        if not options.json:
            shown = {key: value for key, value in found[name].items() if key != "turns"}
            print(f"{name}: {json.dumps(shown)}", flush=True)
    if options.json:
        print(json.dumps(found))
    return 0
