"""Speed and memory of flights, with bare JSBSim at the same step beside them in the same run.

    bare        JSBSim alone at 400 Hz: the F450 it ships, and our own file of the same aircraft
    seam        world and sensors hovering without an autopilot: in one native loop, and step by step from Python
    free        missions 1 to 3 without boxes
    avoidance   mission 2 among boxes: sensors, control, planner, distance, trace
    policy      60 s from a start state with sticks, modes and faults, trace at 50 Hz
    kinematic   the low-fidelity vehicle on the same layouts

Factors are simulated seconds per second of processor time (and of wall time) of one core; rounds alternate between the
kinds so that a busy machine slows all alike, and the median counts. Standing on the ground before arming costs little
and is left out of `airborne`. `--against CHECKOUT` measures another checkout in turns with this one.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _flight_against
import _flight_seam
import numpy as np

from saflite.conformance.flying import fly_once
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.geometry import boxes_array
from saflite.flight.mission import builtin_mission, waypoints
from saflite.flight.planner.kinematic import fly_kinematic
from saflite.flight.world.jsbsim_world import World

READY_S, BARE_S = 19.5, 20.0
SEAMS = ("seam, one loop", "seam, from Python")
Measured = tuple[float, float, float, float]  # simulated, airborne, processor, wall seconds


def layouts(count: int) -> list[tuple[Obstacle, ...]]:
    """Return layouts of two boxes across mission 2's way, drawn from a fixed stream."""
    rng = derive(1, "bench-flight")
    rows = []
    for _ in range(count):
        first, second = (rng.uniform(-14, -4), rng.uniform(16, 34)), (rng.uniform(2, 12), rng.uniform(16, 34))
        rows.append(tuple(_box(rng, *place) for place in (first, second)))
    return rows


def _box(rng: np.random.Generator, x_m: float, y_m: float) -> Obstacle:
    length, width, height = rng.uniform(4, 10), rng.uniform(4, 8), rng.uniform(15, 25)
    return Obstacle(length_m=length, width_m=width, height_m=height, x_m=x_m, y_m=y_m, rotation_deg=rng.uniform(0, 90))


def _timed(work: Callable[[], tuple[float, float]]) -> Measured:
    cpu, wall = time.process_time(), time.perf_counter()
    simulated, airborne = work()
    return simulated, airborne, time.process_time() - cpu, time.perf_counter() - wall


def bare() -> tuple[float, float]:
    """Step our own file of the aircraft in a hover, nothing else."""
    world = World(30.0)
    world.spin_up(0.435, 1)
    return _stepped(world.step_jsbsim)


def _stepped(step: Callable[[], object]) -> tuple[float, float]:
    for _ in range(round(BARE_S / 0.0025)):
        step()
    return BARE_S, BARE_S


def bare_shipped() -> Measured:
    """Step the aircraft JSBSim ships, in a process of its own: its chatter would spoil our output."""
    output = _child("shipped()")
    words = next(line for line in output.splitlines() if line.startswith("measured")).split()
    return float(words[1]), float(words[2]), float(words[3]), float(words[4])


def shipped() -> None:
    """Measure the shipped F450 and print it."""
    fdm = shipped_f450()
    print("\nmeasured", *_timed(lambda: _stepped(fdm.run)))


def shipped_f450() -> Any:
    """Return the shipped F450 in a hover at 400 Hz; JSBSim chats on standard output meanwhile."""
    import jsbsim

    fdm: Any = jsbsim.FGFDMExec(jsbsim.get_default_root_dir(), None)
    fdm.load_model("F450")
    fdm.set_dt(0.0025)
    fdm["ic/h-agl-ft"] = 100.0
    fdm.run_ic()
    fdm["propulsion/set-running"], fdm["fcs/ScasEngage"] = -1, 0
    for name in ("FR", "AL", "FL", "AR"):
        fdm[f"fcs/cmd{name}_ext_nd"] = 0.435
    return fdm


def _child(call: str) -> str:
    code = f"import sys; sys.path.insert(0, {sys.path[0]!r}); import flight; flight.{call}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def fly(case: TestCase) -> tuple[float, float]:
    """Fly one test case; return simulated and airborne seconds."""
    record = fly_once(case)
    assert record.trace is not None, record
    simulated = record.trace.duration_s
    return simulated, simulated - (READY_S if case.scenario.mission is not None else 0.0)


def mission_case(name: str, boxes: tuple[Obstacle, ...] = (), rng_seed: int = 1) -> TestCase:
    """Return a mission among boxes."""
    return TestCase(
        target=Target(), scenario=Scenario(mission=builtin_mission(name), obstacles=boxes), rng_seed=rng_seed
    )


def policy_case(rng_seed: int) -> TestCase:
    """Return a minute of sticks, modes and a fault from a hover."""
    rows: tuple[tuple[float, str, str, tuple[float, ...]], ...] = (
        (5.0, "stick", "RC2", (1300.0,)),
        (10.0, "stick", "RC2", (1500.0,)),
        (15.0, "mode", "ALT_HOLD", ()),
        (20.0, "mode", "FLIP", ()),
        (30.0, "mode", "CIRCLE", ()),
        (45.0, "sensor_fault", "SIM_GPS_NOISE", (1.0,)),
        (50.0, "mode", "BRAKE", ()),
    )
    stimuli = tuple(Stimulus(at_s=at, kind=kind, name=name, values=values) for at, kind, name, values in rows)  # type: ignore[arg-type]
    scenario = Scenario(start=StartState(mode="LOITER", altitude_m=40.0), time_limit_s=60.0)
    return TestCase(target=Target(), scenario=scenario, stimuli=stimuli, rng_seed=rng_seed)


def kinematic(boxes: tuple[Obstacle, ...], rng_seed: int) -> tuple[float, float]:
    """Fly the low-fidelity vehicle through mission 2."""
    places = np.array([(w.x_m, w.y_m, w.z_m) for w in waypoints(builtin_mission("mission2"))])
    flight = fly_kinematic(places, boxes_array(boxes), rng_seed=rng_seed)
    return flight.duration_s, flight.duration_s - READY_S


def measure(rounds: int) -> dict[str, list[Measured]]:
    """Run everything `rounds` times, taking turns."""
    found: dict[str, list[Measured]] = {}
    _flight_seam.native_loop()
    for i, boxes in enumerate(layouts(rounds)):
        kinds: dict[str, Callable[[], tuple[float, float]]] = {
            "bare, our file": bare,
            "seam, one loop": _flight_seam.fused,
            "seam, from Python": _flight_seam.apart,
            "free": lambda i=i: fly(mission_case(f"mission{1 + i % 3}")),  # type: ignore[misc]
            "avoidance": lambda i=i, boxes=boxes: fly(mission_case("mission2", boxes, i)),  # type: ignore[misc]
            "policy": lambda i=i: fly(policy_case(i)),  # type: ignore[misc]
            "kinematic": lambda i=i, boxes=boxes: kinematic(boxes, i),  # type: ignore[misc]
        }
        found.setdefault("bare, shipped F450", []).append(bare_shipped())
        for name, work in kinds.items():
            found.setdefault(name, []).append(_timed(work))
    return found


def worker_peak_mib() -> float:
    """Return the peak memory of a simulator's own process over ten avoidance flights."""
    return float(_child("child()").split()[-1])


def child() -> None:
    """Fly ten layouts as the simulator process does and print its peak memory in MiB."""
    import saflite.runtime.simulator  # noqa: F401  (what a simulator process holds)

    for i, boxes in enumerate(layouts(10)):
        fly(mission_case("mission2", boxes, i))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)


def summary(found: dict[str, list[Measured]], peak_mib: float) -> dict[str, Any]:
    """Return the figures."""
    rows: dict[str, Any] = {}
    base = statistics.median(simulated / cpu for simulated, _, cpu, _ in found["bare, shipped F450"])
    for name, runs in found.items():
        whole = statistics.median(simulated / cpu for simulated, _, cpu, _ in runs)
        rows[name] = {
            "real_time_factor": round(whole, 1),
            "airborne_factor": round(statistics.median(air / cpu for _, air, cpu, _ in runs), 1),
            "wall_factor": round(statistics.median(simulated / wall for simulated, _, _, wall in runs), 1),
            "of_bare_shipped": round(whole / base, 3),
            "simulated_s": round(sum(simulated for simulated, _, _, _ in runs), 1),
        }
    seam = {name: _of_bare(found, name) for name in SEAMS}
    return {"kinds": rows, "of_bare_ours": seam, "worker_peak_mib": round(peak_mib, 1), "rounds": len(found["free"])}


def _of_bare(found: dict[str, list[Measured]], name: str) -> float:
    """Return the median over the rounds of a kind's speed as a share of bare JSBSim's in the same round."""
    pairs = zip(found[name], found["bare, our file"], strict=True)
    return round(statistics.median((row[0] / row[2]) / (bare[0] / bare[2]) for row, bare in pairs), 3)


def against(other: Path, turns: int, least: float | None, *, as_json: bool) -> int:
    """Compare with another checkout; 1 if a kind of flight is slower than asked for."""
    compared = _flight_against.compare(_flight_against.HERE, other, max(1, turns))
    if as_json:
        print(json.dumps({name: row._asdict() for name, row in compared.items()}, indent=1))
    else:
        _flight_against.show(compared)
    slow = _flight_against.slower(compared, least) if least is not None else []
    if slow:
        sys.stderr.write(f"slower than {least}: {', '.join(slow)}\n")
    return 1 if slow else 0


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench flight", description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="measure another checkout in turns with this")
    parser.add_argument("--turns", type=int, default=20, help="with --against: flights of each kind")
    parser.add_argument("--least", type=float, help="with --against: exit 1 if a median ratio is below, e.g. 0.97")
    options = parser.parse_args(argv)
    if options.against is not None:
        return against(options.against.resolve(), options.turns, options.least, as_json=options.json)
    result = summary(measure(max(1, options.rounds)), worker_peak_mib())
    if options.json:
        print(json.dumps(result, indent=1))
        return 0
    print(f"{'':20} {'x real time':>12} {'airborne':>9} {'wall':>8} {'of bare F450':>13} {'simulated s':>12}")
    for name, row in result["kinds"].items():
        factors = f"{row['real_time_factor']:12.1f} {row['airborne_factor']:9.1f} {row['wall_factor']:8.1f}"
        print(f"{name:20} {factors} {row['of_bare_shipped']:13.3f} {row['simulated_s']:12.1f}")
    shares = ", ".join(f"{name.removeprefix('seam, ')} {share:.3f}" for name, share in result["of_bare_ours"].items())
    print(f"through the seam of the world, of our bare aircraft's speed: {shares}")
    print("no older checkout beside this one (--against CHECKOUT flies both in turns)")
    print(f"peak memory of a simulator process: {result['worker_peak_mib']} MiB (aim 150); rounds: {result['rounds']}")
    return 0
