"""`scripts/bench margins`: how much room does each clause of each rule leave the vehicle without a fault?

    scripts/bench margins [--flights 400] [--rng-seed 1] [--policies NAME ...] [--out FILE.jsonl] [--read FILE ...]
                          [--table FILE.jsonl]

A promise that is kept by far in every flight is lax: a fault has to be as large as its room before it is seen. Flown
are proposals of `policy-all`, procedures of all rules by themselves and drawn missions, in turn, no twin among them. Of
each clause (a condition and what it promises) told are the flights in which its condition held, and the robustness
of the promise alone while it did: the least of all flights, the flight with it, and quantiles of the flights' least, in
the unit of what is compared (Donze and Maler 2010). Promises about states have no room. One JSON line a flight.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rules import promises

from saflite.campaign.presets.campaigns import template
from saflite.campaign.presets.policy_campaigns import ALL, policy_campaign
from saflite.conformance.flying import DEADLINE_S, opened
from saflite.conformance.procedures import ProcedureFlights
from saflite.contract.flight import Flight, FlightRecord
from saflite.contract.rng import derive
from saflite.contract.test_case import TestCase, identity
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.scenarios import scenarios_of
from saflite.mutator.registry import load_strategy
from saflite.oracle.policy import load_policy, policy_names
from saflite.oracle.signals import FlightSignals
from saflite.oracle.stl import Evaluator
from saflite.simulator_worker.registry import load_target

ROUND, LONGEST_S = 16, 200.0
QUANTILES = (0.01, 0.1, 0.5)


def cases(rng_seed: int) -> Iterator[TestCase]:
    """Yield test cases of the three kinds in turn, without end."""
    kinds = (_proposed(rng_seed), _procedures(rng_seed), _missions(rng_seed))
    while True:
        for kind in kinds:
            yield msgspec.structs.replace(next(kind), twin="")


def _proposed(rng_seed: int) -> Iterator[TestCase]:
    campaign = policy_campaign(ALL, describe())
    assert campaign is not None, "there is one for the reference"
    settings = dict(campaign.strategy.settings)
    strategy = load_strategy(campaign.strategy.name)(template(campaign), settings, campaign.policies, describe())
    number = 0
    while True:
        yield from strategy.ask(ROUND, derive(rng_seed, "margins", number))
        number += 1


def _procedures(rng_seed: int) -> Iterator[TestCase]:
    flights = ProcedureFlights(describe())
    every = [one for _, procedures in sorted(flights.procedures.items()) for one in procedures]
    rng = derive(rng_seed, "margins", "procedures")
    while True:
        for place in rng.permutation(len(every)):
            case = flights.by_itself(every[place], int(rng.integers(1_000_000)))
            if case.scenario.time_limit_s <= LONGEST_S:
                yield case


def _missions(rng_seed: int) -> Iterator[TestCase]:
    campaign = policy_campaign(ALL, describe())
    assert campaign is not None, "there is one for the reference"
    usual = template(campaign)
    drawn_from = scenarios_of(usual.scenario, describe())
    number = 0
    while True:
        scenario = drawn_from.mission(derive(rng_seed, "margins mission", number))
        yield msgspec.structs.replace(usual, scenario=scenario, rng_seed=number)
        number += 1


def rooms(case: TestCase, record: FlightRecord, names: list[str]) -> dict[str, float]:
    """Return the room of every clause whose condition held, by the rule's name and the clause's number from 1 on."""
    assert record.trace is not None
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    policies = [load_policy(name).on(case.target.name) for name in names]
    signals = FlightSignals(case, flight, record.trace, between=True)
    wanted = frozenset[str]().union(*(policy.signals for policy in policies))
    evaluator = Evaluator(signals.pick(wanted), record.trace.step_s, signals.moments.row)
    found: dict[str, float] = {}
    for policy in policies:
        if case.target.name in policy.file.not_checked_on or any(name not in signals for name in policy.needed):
            continue
        for number, (condition, promise) in enumerate(promises(policy.formula), start=1):
            worth = evaluator.trace(promise)
            held = worth if condition is None else worth[evaluator.true(condition)]
            held = held[np.isfinite(held)]
            if len(held):
                found[f"{policy.id} {number}"] = round(float(held.min()), 3)
    return found


def flown(flights: int, rng_seed: int, names: list[str], done: int) -> Iterator[dict[str, Any]]:
    """Yield a row for every flight behind the first `done`."""
    with opened(load_target("reference")) as session:
        for number, case in zip(range(flights), cases(rng_seed), strict=False):
            if number < done:
                continue
            record = session.fly(case, DEADLINE_S, lambda: False)
            row = {"rng_seed": rng_seed, "number": number, "ending": record.ending}
            if record.trace is None:
                yield row
                continue
            yield {**row, "case": msgspec.to_builtins(case), "rooms": rooms(case, record, names)}


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench margins", description=__doc__)
    parser.add_argument("--flights", type=int, default=400)
    parser.add_argument("--rng-seed", type=int, default=1)
    parser.add_argument("--policies", nargs="+", default=list(policy_names()))
    parser.add_argument("--out", type=Path, help="one JSON line a flight; those in it are not flown again")
    parser.add_argument("--table", type=Path, help="one JSON line a clause, behind a line that says what was flown")
    parser.add_argument("--read", type=Path, nargs="+", default=[], help="more rows, which are only read")
    options = parser.parse_args(argv)
    rows = [row for path in (*options.read, *([options.out] if options.out else [])) for row in _rows(path)]
    done = sum(row["rng_seed"] == options.rng_seed for row in rows)
    for row in flown(options.flights, options.rng_seed, options.policies, done):
        rows.append(row)
        if options.out:
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        if len(rows) % 50 == 0:
            sys.stderr.write(f"{len(rows)} flights\n")
    _print(rows, options.table)
    return 0


def _rows(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def by_clause(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for every clause: the flights in which it applied, the least room and where, quantiles."""
    found: dict[str, list[tuple[float, int, int]]] = {}
    for row in rows:
        for clause, room in row.get("rooms", {}).items():
            found.setdefault(clause, []).append((room, row["rng_seed"], row["number"]))
    made = []
    for clause, rooms_of in sorted(found.items()):
        least, *place = min(rooms_of)
        spread = np.quantile([room for room, *_ in rooms_of], QUANTILES).round(3).tolist()
        made.append({"clause": clause, "flights": len(rooms_of), "least": least, "in": place, "quantiles": spread})
    return made


def _print(rows: list[dict[str, Any]], table: Path | None) -> None:
    clauses = by_clause(rows)
    if table is not None:
        seeds = sorted({row["rng_seed"] for row in rows})
        head = {"rng_seeds": seeds, "flights": len(rows), "quantiles": QUANTILES}
        table.write_text("".join(json.dumps(row) + "\n" for row in (head, *clauses)), encoding="utf-8")
    print(f"{len(rows)} flights; clause: flights in which it applied, least room (seed, flight), 1 %, 10 %, median")
    for row in clauses:
        spread = " ".join(f"{value:8.2f}" for value in row["quantiles"])
        print(f"  {row['clause']:32} {row['flights']:5} {row['least']:8.2f} {row['in']} {spread}")
