"""What `saflite replay` does: fly again, compare digests, judge."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from saflite.console.io import cases
from saflite.console.operations import judging
from saflite.console.run_data.known import no_violation, own_policies
from saflite.console.run_data.run_folder import open_run
from saflite.console.run_data.unproven import pending, unproven
from saflite.contract.plain import counted
from saflite.contract.target_info import Repeats
from saflite.contract.test_case import TestCase, identity
from saflite.contract.verdict import NEVER_APPLIED, vacuous, worst
from saflite.contract.work import PolicyTexts
from saflite.oracle.policy import check_told
from saflite.recorder.recording import read
from saflite.simulator_worker.registry import describe_target

REPLAYS: dict[Repeats, int] = {"bitwise": 1, "statistically": 5}
"""How often each is flown if nothing else is asked for."""


class Entry(NamedTuple):
    """One flight to be repeated, under the `noise` it had (`under_noise`).

    `trace_digest` is empty where the first repetition sets what is to be met.
    """

    name: str
    test_case: TestCase
    policies: tuple[str, ...]
    trace_digest: str
    policy_texts: PolicyTexts | None = None
    noise: int = 0


class Replayed(NamedTuple):
    """One repetition beside its record."""

    name: str
    test_case: str
    ending: str
    simulated_s: float
    wall_s: float
    recorded_digest: str
    trace_digest: str
    repeats: Repeats
    bit_equal: bool
    violated: tuple[str, ...]
    vacuous: tuple[str, ...]
    robustness: float | None


def entries(
    what: Path, wanted: str, everything: bool, policies: tuple[str, ...], anywhere: bool = False
) -> list[Entry]:
    """Return what is to be flown again.

    Raises Refused if there is nothing of that name, or a test case has boxes that `fly` refuses (`cases.check_layout`).
    """
    if what.is_dir():
        return _of_run(what, wanted, everything, policies)
    if what.suffix == ".mcap":
        found = read(what)
        judged, texts = tuple(verdict.policy for verdict in found.judgement.verdicts), own_policies(found)
        check_told(judged, texts)
        return [
            Entry(
                what.name,
                found.test_case,
                policies or judged,
                found.flight.trace_digest,
                texts,
                found.flight.flight_index,
            )
        ]
    case = cases.load_case(what)
    cases.check_layout(case, str(what), anywhere)
    return [Entry(what.name, case, policies or ("min-obstacle-distance",), "")]


def _of_run(run_dir: Path, wanted: str, everything: bool, policies: tuple[str, ...]) -> list[Entry]:
    with open_run(run_dir) as run:
        violations = run.violations()
        chosen = [
            violation
            for violation in violations
            if (everything or wanted or violation.confirmation == "confirmed")
            and (violation.fingerprint.startswith(wanted) or violation.test_case.startswith(wanted))
        ]
        waiting = {one.test_case for one in pending(run.flights(), violations) if one.test_case.startswith(wanted)}
        if not (chosen or waiting) and wanted:
            raise no_violation([violation.fingerprint for violation in violations], wanted, str(run_dir))
        found: dict[str, Entry] = {}
        for violation in chosen:
            digest = next((row.trace_digest for row in run.flights(violation.test_case) if row.shows(violation)), "")
            case = run.test_case(violation.test_case)
            judged, texts = policies or run.campaign.policies, run.campaign.policy_texts
            entry = Entry(violation.fingerprint, case, judged, digest, texts, violation.flight_index)
            found.setdefault(violation.test_case, entry)
        for name in sorted(waiting) if everything or wanted else ():
            digest = next(row.trace_digest for row in run.flights(name) if row.purpose == "search")
            found[name] = Entry(
                name, run.test_case(name), policies or run.campaign.policies, digest, run.campaign.policy_texts
            )
    return list(found.values())


def left_out(what: Path, found: Sequence[Entry]) -> int:
    """Return how many violations of a run are neither confirmed nor refuted and not among those to be flown."""
    if not what.is_dir():
        return 0
    with open_run(what) as run:
        flown = {identity(entry.test_case) for entry in found}
        return sum(one.test_case not in flown for one in unproven(run.flights(), run.violations()))


def replay(found: Sequence[Entry], times: int | None, wall_limit_s: float) -> Iterator[Replayed]:
    """Yield each repetition as it lands; a test case without a record is flown once more and compared with itself.

    `times` None flies each once where flights repeat bit by bit, five times on other targets.

    Raises Unavailable before the first where something is missing that one of them needs to be flown.
    """
    for target in dict.fromkeys(entry.test_case.target.name for entry in found):
        judging.check_flies_here(target)
    simulator = judging.OwnSimulator()
    try:
        for entry in found:
            repeats, digest = describe_target(entry.test_case.target.name).repeats, entry.trace_digest
            if not digest and repeats == "bitwise":
                digest = simulator.fly(entry.test_case, wall_limit_s, noise=entry.noise).flight.trace_digest
            for index in range(times or REPLAYS[repeats]):
                flown = simulator.fly(entry.test_case, wall_limit_s, index, entry.noise)
                judgement = judging.judge(entry.test_case, flown, entry.policies, entry.policy_texts)
                violated = tuple(one.policy for one in judgement.verdicts if one.outcome == "violated")
                least = worst(judgement)
                yield Replayed(
                    name=entry.name,
                    test_case=identity(entry.test_case),
                    ending=flown.flight.ending,
                    simulated_s=flown.flight.simulated_s,
                    wall_s=flown.flight.wall_s,
                    recorded_digest=digest,
                    trace_digest=flown.flight.trace_digest,
                    repeats=repeats,
                    bit_equal=bool(digest) and digest == flown.flight.trace_digest,
                    violated=violated,
                    vacuous=vacuous(judgement),
                    robustness=least.robustness if least else None,
                )
    finally:
        simulator.close()


def line(result: Replayed) -> str:
    """Return a repetition in one line."""
    trace = f"trace {result.trace_digest[:12]}" if result.trace_digest else "no trace,"
    return f"{result.name}  {result.ending}  {_said(result)}  {trace}{_compared(result)}"


def differs(result: Replayed) -> bool:
    """Return whether a flight is not the one on record though its target repeats bit by bit."""
    return result.repeats == "bitwise" and not result.bit_equal


def conclusion(results: Sequence[Replayed]) -> str:
    """Return all repetitions in one line, and one for each test case whose flights differ by nature."""
    lines = []
    for name in dict.fromkeys(result.test_case for result in results if result.repeats == "statistically"):
        flights = [result for result in results if result.test_case == name]
        again = sum(1 for result in flights if result.violated)
        lines.append(f"{flights[0].name}  test case {name}: violated in {again} of {len(flights)} flights")
    exact = [result for result in results if result.repeats == "bitwise"]
    equal = f" {sum(1 for result in exact if result.bit_equal)} bit-equal," if exact else ""
    violated = sum(1 for result in results if result.violated)
    return "\n".join([*lines, f"{counted(len(results), 'flight')}:{equal} {violated} violated"])


def _compared(result: Replayed) -> str:
    if result.repeats == "statistically":
        return ""
    return " bit-equal" if result.bit_equal else f" DIFFERS from {result.recorded_digest[:12] or 'no record'}"


def _said(result: Replayed) -> str:
    if result.robustness is None:
        return f"vacuous: {NEVER_APPLIED}" if result.vacuous else "inconclusive: nothing could be judged"
    word = f"violates {', '.join(result.violated)}" if result.violated else "holds"
    return f"{word}, robustness {result.robustness:+.3f}"
