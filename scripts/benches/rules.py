"""`scripts/bench rules`: does each rule bite, does any bark for nothing, how often does any speak?

    scripts/bench rules [--part kills planted lines alarms real] [--policies NAME ...] [--cases 4] [--flights 14]
                        [--lines 100] [--rng-seed 1] [--targets ardupilot px4] [--keep FOLDER] [--out FILE.jsonl]

kills: a mutation score per rule. Flights of the rule's own campaign, all defects off, in which it applied and was kept,
get three behaviour faults planted into what the rule promises (`FAULTS`); a fault is killed if the rule is then broken
in any of them. Rules that applied in no flight, or cannot be checked on the reference, are tried on their examples.
The faults are the same for all rules and know none of them. A rule that kills none is marked.
planted: faults a stranger might plant (`data/rule_faults.toml`), each in a flight that reaches it, all rules judging;
told are the rules that see it, and those that are broken in the same flight without it.
lines: so many places of the reference autopilot, drawn blindly, changed one by one and flown in up to `--flights` of
the procedures that reach them (`_line_faults.py`): a mutation score of all rules together.
alarms: the campaigns of all policies, guided as users run them, all defects off; every flight is judged by all rules,
every violation is a false alarm, its test case is kept in the row. Told is also in which share of flights each rule
applied.

real: `policy-all` within documented ranges on a real autopilot, which SAFLITE_ARDUPILOT or SAFLITE_PX4 names
(`_real_alarms.py`): how often each rule spoke and was broken. Whose fault that is, is for a person to say.

Rows in the `--out` file are not made again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from _blind_faults import drawn
from _inline import Flights, Inline
from _line_faults import known_flights, line_name, seen_in_lines
from _real_alarms import said_of
from _rule_faults import rule_faults, seen_by
from numpy.typing import NDArray

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.presets.policy_campaigns import policy_campaigns
from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight, unpack_trace
from saflite.contract.rng import derive
from saflite.contract.service import Cancelled
from saflite.contract.signals import MADE_FROM, MODES
from saflite.contract.test_case import TestCase, identity, told_in_order
from saflite.contract.work import FlyWork
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.registry import load_strategy
from saflite.oracle.examples import completed, example_signals
from saflite.oracle.finding import find
from saflite.oracle.formula import Node, signals_of
from saflite.oracle.judge import judge
from saflite.oracle.policy import Policy, load_policy, policy_names, signal_table
from saflite.oracle.signals import FlightSignals
from saflite.oracle.stl import Evaluator

Signals = Mapping[str, Any]
Base = tuple[Signals, float]
Values = NDArray[np.float64]
UNIT_SIZE = {"m": 5.0, "m/s": 3.0, "deg": 60.0, "deg/s": 150.0, "": 5.0}
PERIOD_S, LATE_S = 7.0, 15.0
FAULTS = ("leaves", "swings", "fails")
"""What is planted into whatever a rule promises, from the moment it first applied, and from the start of the flight.

leaves: a number runs off by a tenth of its size a second, either way; a flag or mode changes 15 s late. swings: a
number swings by its size; a flag or mode never changes. fails: a number turns into its opposite or stays where it was,
or all numbers do; a flag or mode is the wrong one. Where nothing changes, mode, armed and landed do not either."""
STATES = ("mode", "armed", "landed")


def promises(node: Node) -> Iterator[tuple[Node | None, Node]]:
    """Yield (condition, promise) of every rule in the formula."""
    if node.op in ("always", "and"):
        for part in node.args:
            yield from promises(part)
    elif node.op == "implies":
        yield node.args[0], node.args[1]
    else:
        yield None, node


def promised(policy: Policy) -> frozenset[str]:
    """Return what the rule promises of the flight: signals that are no settings and not made of stimuli."""
    read = [signals_of(promise) for _, promise in promises(policy.formula)]
    of_stimuli = {name for name, sources in MADE_FROM.items() if not sources and name != "crashed"}
    found = frozenset(name for names in read for name in names - of_stimuli if "_set" not in name)
    return found or frozenset(STATES) & policy.needed  # only how long a state lasts is promised


def planted(policy: Policy, base: Base, fault: str) -> Iterator[Signals]:
    """Yield the signals with the fault in each thing promised."""
    signals, step_s = base
    table, evaluator = signal_table(policy.file), Evaluator(signals, step_s)
    names = sorted(promised(policy))
    numbers = [name for name in names if table[name].kind == "real"]
    starts = {_first(evaluator, condition) for condition, _ in promises(policy.formula)} - {None}
    for start in sorted({0, *(at for at in starts if at is not None)}):
        for name in names:
            values = np.asarray(signals[name], dtype=np.float64)
            if name in numbers:
                size = UNIT_SIZE.get(table[name].unit, 5.0)
                yield from ({**signals, name: one} for one in _numbers(values, fault, start, step_s, size))
                continue
            held = {} if fault == "fails" else {one: _held(signals[one], start) for one in STATES if one in signals}
            yield {**signals, **held, name: _state(values, name, fault, start, step_s)}
            if fault == "swings":  # it never leaves the state again, either
                yield {**signals, name: _held(values, start + 1)}
        if fault == "fails" and numbers:
            yield {**signals, **{name: _held(signals[name], start) for name in numbers}}


def _first(evaluator: Evaluator, condition: Node | None) -> int | None:
    if condition is None:
        return 0
    true = np.flatnonzero(evaluator.trace(condition) > 0)
    return int(true[0]) if len(true) else None


def _held(values: Values, start: int) -> Values:
    """Keep the value before `start` from there on."""
    return np.where(np.arange(len(values)) >= start, values[max(0, start - 1)], values)


def _numbers(values: Values, fault: str, start: int, step_s: float, size: float) -> list[Values]:
    since_s = np.maximum(0.0, (np.arange(len(values)) - start) * step_s)
    if fault == "leaves":
        return [values - 0.1 * size * since_s, values + 0.1 * size * since_s]
    if fault == "swings":
        return [values + size * np.sin(2.0 * np.pi * since_s / PERIOD_S)]
    return [np.where(since_s > 0, -values, values), _held(values, start)]


def _state(values: Values, name: str, fault: str, start: int, step_s: float) -> Values:
    after = np.arange(len(values)) >= start
    if fault == "leaves":
        count = min(len(values), round(LATE_S / step_s))
        later = np.concatenate([np.full(count, values[max(0, start - 1)]), values])[: len(values)]
        return np.where(after, later, values)
    if fault == "swings":
        return _held(values, start)
    other = 1.0 - values if name != "mode" else np.where(values == MODES["ACRO"], MODES["STABILIZE"], MODES["ACRO"])
    return np.where(after, other, values)


# ---- kills --------------------------------------------------------------------------------------------------------


def flown(policy: Policy, cases: int, rng_seed: int) -> list[Base]:
    """Return flights of the policy's own campaign in which it applied and was kept."""
    name = f"policy-{policy.id}"
    if name not in policy_campaigns(describe()):
        return []
    campaign = load_campaign(name)
    found: list[Base] = []
    strategy = load_strategy(campaign.strategy.name)(
        template(campaign), dict(campaign.strategy.settings), campaign.policies, describe()
    )
    for case in strategy.ask(cases, derive(rng_seed, "bench-rules", name)):
        record = fly_once(case)
        flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
        if record.trace is not None:
            signals = FlightSignals(case, flight, record.trace)
            found.append((signals.pick(policy.signals), record.trace.step_s))
    return [base for base in found if _kept(policy, base)]


def told(policy: Policy) -> list[Base]:
    """Return the policy's examples in which it applies and is kept."""
    found: list[Base] = []
    for number, example in enumerate(policy.file.examples, start=1):
        if example.holds and example.applies:
            whole = completed(policy.file.examples, number, "")
            found.append((example_signals(whole, policy.signals, "", "", signal_table(policy.file)), whole.step_s))
    return found


def _kept(policy: Policy, base: Base) -> bool:
    finding = find(Evaluator(*base), policy.formula)
    return finding is not None and finding.robustness >= 0 and finding.applied_share > 0


def _broken(policy: Policy, signals: Signals, step_s: float) -> bool:
    finding = find(Evaluator(signals, step_s), policy.formula)
    return finding is not None and finding.robustness < 0


def kills(name: str, cases: int, rng_seed: int) -> dict[str, Any]:
    """Return which of three faults the rule kills, and on how many flights (or examples) they were planted."""
    policy = load_policy(name)
    flights = flown(policy, cases, rng_seed)
    bases = flights or told(policy)
    killed = {
        fault: any(_broken(policy, changed, base[1]) for base in bases for changed in planted(policy, base, fault))
        for fault in FAULTS
    }
    return {"part": "kills", "policy": name, "on": "flights" if flights else "examples", "bases": len(bases), **killed}


# ---- alarms -------------------------------------------------------------------------------------------------------


class JudgedFlights(Flights):
    """Flies, and judges every flight by all rules."""

    def __init__(self) -> None:
        super().__init__()
        self.applied: Counter[str] = Counter()
        self.alarms: list[str] = []
        self.cases: list[Any] = []
        self.endings: Counter[str] = Counter()

    def _fly(self, work: FlyWork, cancelled: Cancelled) -> tuple[Flight, bytes]:
        flight, packed = super()._fly(work, cancelled)
        self._judge(work.test_case, flight, packed)
        return flight, packed

    def _judge(self, case: TestCase, flight: Flight, packed: bytes) -> None:
        self.endings[flight.ending] += 1
        for verdict in judge(case, flight, unpack_trace(packed), tuple(policy_names())).verdicts:
            self.applied[verdict.policy] += verdict.outcome in ("held", "violated")
            if verdict.outcome == "violated":
                self.alarms.append(f"{verdict.message}: {told_in_order(case.stimuli)}")
                self.cases.append(msgspec.to_builtins(case))


def guided(name: str, flights: int, rng_seed: int) -> dict[str, Any]:
    """Return what a guided campaign without defects came to, judged by all rules."""
    base = load_campaign(name)
    search = msgspec.structs.replace(base.search, shrink=False, lag=1)
    campaign = msgspec.structs.replace(base, budget_flights=flights, rng_seed=rng_seed, record="none", search=search)
    flyer = JudgedFlights()
    with tempfile.TemporaryDirectory(prefix="saflite-rules-") as folder:
        inline = Inline(campaign, Path(folder) / "run", flyer)
        inline.run(lambda _: False)
        inline.close()
    return {
        "part": "alarms",
        "campaign": name,
        "rng_seed": rng_seed,
        "flights": flyer.flown,
        "alarms": flyer.alarms,
        "cases": flyer.cases,
        "endings": dict(flyer.endings),
        "applied": dict(sorted(flyer.applied.items())),
    }


# ---- the command --------------------------------------------------------------------------------------------------


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench rules", description=__doc__)
    parser.add_argument(
        "--part", nargs="+", choices=("kills", "planted", "lines", "alarms", "real"), default=["kills", "alarms"]
    )
    parser.add_argument("--policies", nargs="+", default=list(policy_names()))
    parser.add_argument("--campaigns", nargs="+", default=sorted(policy_campaigns(describe())))
    parser.add_argument("--cases", type=int, default=4, help="flights of a rule's own campaign that get faults")
    parser.add_argument("--flights", type=int, default=14, help="guided flights a campaign")
    parser.add_argument("--lines", type=int, default=100, help="places of the autopilot that --part lines changes")
    parser.add_argument("--rng-seed", type=int, default=1)
    parser.add_argument("--targets", nargs="+", default=["ardupilot"], help="real autopilots of --part real")
    parser.add_argument("--keep", type=Path, help="folder for the test cases of --part real in which a rule was broken")
    parser.add_argument("--out", type=Path, help="one JSON line a rule or campaign; those in it are not made again")
    options = parser.parse_args(argv)
    rows = _recorded(options.out)
    done = {(row["part"], _of(row), row.get("rng_seed")) for row in rows}
    if "kills" in options.part:
        wanted = [name for name in options.policies if ("kills", name, None) not in done]
        rows += [_noted(kills(name, options.cases, options.rng_seed), options.out) for name in wanted]
    if "planted" in options.part:
        rows += [_noted(seen_by(name), options.out) for name in rule_faults() if ("planted", name, None) not in done]
    if "lines" in options.part:
        rows += _of_lines(options, done)
    if "alarms" in options.part:
        names = [name for name in options.campaigns if ("alarms", name, options.rng_seed) not in done]
        rows += [_noted(guided(name, options.flights, options.rng_seed), options.out) for name in names]
    if "real" in options.part:
        targets = [name for name in options.targets if ("real", name, options.rng_seed) not in done]
        rows += [
            _noted(said_of(name, options.flights, options.rng_seed, options.keep), options.out) for name in targets
        ]
    _print(rows)
    return 0


def _print_lines(rows: list[dict[str, Any]]) -> None:
    """Print the changed lines that no rule sees, and how many some rule does, of those that move a flight."""
    moving = [row for row in rows if row["moved"] or row["seen_by"]]
    for row in (row for row in moving if not row["seen_by"]):
        print(f"  {row['fault']:60} unseen, moves by {row['moved']}")
    if rows:
        seen = sum(bool(row["seen_by"]) for row in moving)
        print(f"  {len(rows)} lines changed, {len(moving)} move a flight, of which rules see {seen}")


def _of_lines(options: argparse.Namespace, done: Container[tuple[str, Any, Any]]) -> list[dict[str, Any]]:
    places = [one for one in drawn(options.rng_seed, options.lines) if ("lines", line_name(one), None) not in done]
    flights = known_flights() if places else []
    return [_noted(seen_in_lines(place, flights, options.flights), options.out) for place in places]


def _of(row: Mapping[str, Any]) -> Any:
    """Return the rule, fault or campaign that a row is of."""
    return row.get("policy", row.get("campaign", row.get("fault")))


def _recorded(path: Path | None) -> list[dict[str, Any]]:
    if path is None or not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _noted(row: dict[str, Any], path: Path | None) -> dict[str, Any]:
    sys.stderr.write(f"{row['part']} {_of(row)} done\n")
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
    return row


def _print(rows: list[dict[str, Any]]) -> None:
    tried = [row for row in rows if row["part"] == "kills"]
    for row in tried:
        faults = {name: row[name] for name in FAULTS}
        mark = "" if any(faults.values()) else "   kills none"
        words = " ".join(f"{name}:{'killed' if dead else 'lives'}" for name, dead in faults.items())
        print(f"  {row['policy']:26} {words} ({row['bases']} {row['on']}){mark}")
    for row in (row for row in rows if row["part"] == "planted"):
        seen = ", ".join(row["seen_by"]) or "no rule"
        print(
            f"  {row['fault']:40} seen by {seen}" + (f"; false alarms {row['without_it']}" if row["without_it"] else "")
        )
    _print_lines([row for row in rows if row["part"] == "lines"])
    for row in (row for row in rows if row["part"] == "real"):
        broken = ", ".join(f"{name} {count} of {row['spoke'][name]}" for name, count in row["broken"].items())
        said = f"{row['flights']} flights ({row['autopilot']}, seed {row['rng_seed']}): {row['endings']}"
        print(f"  {said}; {len(row['spoke'])} of {row['rules']} rules spoke; broken: {broken or 'none'}")
    flights = sum(row["flights"] for row in rows if row["part"] == "alarms")
    if not flights:
        return
    applied: Counter[str] = Counter()
    for row in rows:
        applied.update(row.get("applied", {}))
    alarms = [alarm for row in rows for alarm in row.get("alarms", [])]
    spoke = sum(applied.values()) / (flights * len(policy_names()))
    print(f"{len(alarms)} false alarms in {flights} guided flights; a rule applied in {spoke:.1%} of verdicts")
    for alarm in alarms:
        print(f"  {alarm}")
    for name in policy_names():
        print(f"  {name:26} applied in {applied[name] / flights:.1%} of flights")
