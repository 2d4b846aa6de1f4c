"""The oracle: 30 policies at once over 60 s at 100 Hz (aim: at most 20 ms), beside rtamt on one of their formulas.

The trace is made up, with all signals in motion and modes that change, so that every rule has work to do. Beside it a
flight of a search (the first of five minutes kept in `clean.jsonl`) is judged by all rules: its inputs make moments
between samples, which the made-up trace has none of. Everything is measured in one run on one core; the median of the
repetitions counts.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight, Trace, pack_trace
from saflite.contract.rng import derive
from saflite.contract.signals import MODES, SIGNALS
from saflite.contract.test_case import Obstacle, Scenario, Stimulus, Target, TestCase, identity
from saflite.contract.work import JudgeWork
from saflite.evidence.memory import MemoryBlobs
from saflite.oracle.effects import FLAGS
from saflite.oracle.formula import signals_of, text_of
from saflite.oracle.judge import judge
from saflite.oracle.parse import parse
from saflite.oracle.policy import load_policy, policy_names
from saflite.oracle.signals import FlightSignals
from saflite.oracle.stl import Evaluator
from saflite.oracle.work import open_service

STEP_S, DURATION_S, POLICIES, FLOWN_S = 0.01, 60.0, 30, 299.0
KEPT = Path(__file__).resolve().parent / "results" / "clean.jsonl"
MADE_BY_ORACLE = frozenset(
    (
        "time_s",
        "ground_speed_mps",
        "tilt_deg",
        "quiet_s",
        "order_quiet_s",
        "crashed",
        *FLAGS,
        "stop_ordered",
        "battery_timer_set_s",
    )
)
RTAMT_FORMULA = "always ((mode <= 4.5) implies eventually[0:4] (altitude_m >= 10))"


def made_trace() -> Trace:
    """Return 60 s of all signals at 100 Hz."""
    samples, rng = int(DURATION_S / STEP_S), derive(1, "bench-oracle")
    signals = {}
    for name, row in SIGNALS.items():
        if name in MADE_BY_ORACLE:
            continue
        values = rng.normal(scale=0.1, size=samples).cumsum() if row.kind == "real" else rng.random(samples) < 0.9999
        signals[name] = np.asarray(values, dtype="<f4").tobytes()
    modes = np.repeat(rng.choice(list(MODES.values()), size=20), samples // 20)
    return Trace(step_s=STEP_S, signals={**signals, "mode": modes.astype("<f4").tobytes()})


def made_case() -> TestCase:
    """Return a test case with obstacles and stimuli for the reference target."""
    box = Obstacle(length_m=4, width_m=4, height_m=20, x_m=5, y_m=20)
    stimuli = tuple(Stimulus(at_s=at, kind="mode", name="LOITER") for at in (5.0, 20.0, 40.0))
    return TestCase(target=Target(), scenario=Scenario(obstacles=(box,)), stimuli=stimuli)


def flown() -> tuple[TestCase, Flight, Trace]:
    """Fly the first kept test case of a search that lasts its five minutes."""
    kept = (told for line in KEPT.read_text().splitlines() for told in json.loads(line).get("alarm_cases") or ())
    for case in (msgspec.convert(told, TestCase) for told in kept):
        record = fly_once(case)
        if record.trace is not None and record.trace.samples * record.trace.step_s >= FLOWN_S:
            ended = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
            return case, ended, record.trace
    raise LookupError(f"{KEPT} keeps no test case of {FLOWN_S:g} s")


def median_ms(task: Callable[[], Any], repeats: int) -> float:
    """Return the median wall time of `task`, after one run to warm up."""
    task()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        task()
        taken.append(1e3 * (time.perf_counter() - start))
    return statistics.median(taken)


def by_rtamt(text: str, signals: dict[str, Any]) -> Callable[[], Any]:
    """Return a task that evaluates `text` with rtamt on lists made beforehand."""
    import rtamt

    lists = {name: [float(value) for value in values] for name, values in signals.items()}
    times = [index * STEP_S for index in range(len(next(iter(lists.values()))))]

    def task() -> Any:
        specification = rtamt.StlDiscreteTimeSpecification()
        for name in lists:
            specification.declare_var(name, "float")
        specification.set_sampling_period(int(STEP_S * 1e3), "ms", 0.1)
        specification.spec = text
        specification.parse()
        return specification.evaluate({"time": times, **{name: list(values) for name, values in lists.items()}})

    return task


def measure(repeats: int) -> dict[str, Any]:
    """Return all figures."""
    trace, case = made_trace(), made_case()
    blobs = MemoryBlobs()
    packed = blobs.put(pack_trace(trace))
    flight = Flight(test_case=identity(case), flight_index=0, ending="completed", trace=packed)
    checked = tuple(name for name in policy_names() if "reference" not in load_policy(name).file.not_checked_on)
    assert len(checked) >= POLICIES
    busiest = tuple(sorted(checked, key=lambda name: -len(text_of(load_policy(name).formula)))[:POLICIES])
    work = JudgeWork(test_case=case, flight=flight, policies=busiest)
    outcomes = [verdict.outcome for verdict in judge(case, flight, trace, busiest).verdicts]
    assert "inconclusive" not in outcomes, "the made-up trace lacks a signal"
    node = parse(RTAMT_FORMULA)
    signals = FlightSignals(case, flight, trace).pick(signals_of(node))
    searched = flown()
    ours_ms = median_ms(lambda: Evaluator(signals, STEP_S).trace(node), repeats)
    rtamt_ms = median_ms(by_rtamt(RTAMT_FORMULA, signals), 3)
    return {
        "samples": trace.samples,
        "policies": len(busiest),
        "judge_30_policies_ms": median_ms(lambda: judge(case, flight, trace, busiest), repeats),
        "aim_ms": 20.0,
        "all_policies": len(checked),
        "judge_all_policies_ms": median_ms(lambda: judge(case, flight, trace, checked), repeats),
        "judge_a_search_flight_ms": median_ms(lambda: judge(*searched, checked), max(3, repeats // 6)),
        "search_flight_ms": median_ms(lambda: fly_once(searched[0]), 3),
        "with_unpacking_30_ms": median_ms(lambda: open_service(blobs).do(work, lambda: False), repeats),
        "packed_trace_kib": round(packed.size_bytes / 1024, 1),
        "violated": outcomes.count("violated"),
        "one_formula_ms": ours_ms,
        "one_formula_rtamt_ms": rtamt_ms,
        "times_faster_than_rtamt": rtamt_ms / ours_ms,
    }


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench oracle", description=__doc__)
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    found = measure(args.repeats)
    if args.json:
        print(json.dumps(found))
        return 0
    rows = (
        ("judge_30_policies_ms", "30 policies at once", f"(aim {found['aim_ms']:.0f} ms)"),
        ("with_unpacking_30_ms", "unpacking included", f"({found['packed_trace_kib']:.0f} KiB packed)"),
        ("judge_all_policies_ms", f"all {found['all_policies']} that apply", ""),
        ("judge_a_search_flight_ms", "the same, five minutes", f"(to fly it: {found['search_flight_ms']:.0f} ms)"),
        ("one_formula_ms", "one formula, ours", ""),
        ("one_formula_rtamt_ms", "one formula, rtamt", f"({found['times_faster_than_rtamt']:.0f} x ours)"),
    )
    print(f"{found['samples']} samples; the {found['policies']} longest formulas, {found['violated']} of them violated")
    for key, label, remark in rows:
        print(f"  {label:24} {found[key]:9.3f} ms  {remark}")
    return 0
