"""Flying and judging one test case outside a campaign, with the very parts the farm uses."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from saflite.console.cli import NOTHING_JUDGED
from saflite.console.view import out
from saflite.contract.errors import Unavailable
from saflite.contract.flight import Flight, unpack_trace
from saflite.contract.plain import some
from saflite.contract.test_case import TestCase, identity, stimulus_text
from saflite.contract.verdict import NEVER_APPLIED, Judgement, Ruling, Verdict
from saflite.contract.work import FlyResult, FlyWork, PolicyTexts
from saflite.evidence.memory import MemoryBlobs

UNTAKEN_SHOWN = 5  # inputs that the autopilot did not take; `--json` has all
INPUT_SHOWN = 80


class Flown(NamedTuple):
    """A flight, its packed trace, empty if there is none, and the named files that it left behind."""

    flight: Flight
    packed: bytes
    files: tuple[tuple[str, bytes], ...] = ()


class OwnSimulator:
    """A simulator worker of one's own, for flights outside a campaign."""

    def __init__(self) -> None:
        from saflite.runtime.clock import WallClock
        from saflite.simulator_worker.work import open_service

        self._blobs = MemoryBlobs()
        self._flyer = open_service("console", WallClock(), self._blobs)

    def fly(self, case: TestCase, wall_limit_s: float, flight_index: int = 0, noise: int = 0) -> Flown:
        """Fly the test case once, under its own noise or another (`under_noise`).

        Raises:
            Refused: the target is unknown or cannot fly it.
            Unavailable: the simulator does not come up.
        """
        work = FlyWork(
            test_case=case, flight_index=flight_index, purpose="replay", wall_limit_s=wall_limit_s, noise=noise
        )
        result = self._flyer.do(work, lambda: False)
        assert isinstance(result, FlyResult)
        trace = result.flight.trace
        packed = b"" if trace is None else self._blobs.get(trace)
        files = tuple((one.name, self._blobs.get(one.blob)) for one in result.flight.artefacts)
        self._blobs.kept.clear()
        return Flown(result.flight, packed, files)

    def close(self) -> None:
        """End the simulator."""
        self._flyer.close()


def check_flies_here(target: str) -> None:
    """Raise Unavailable where something is missing here without which nothing of a target can be flown."""
    from saflite.simulator_worker.registry import describe_target

    if missing := describe_target(target).missing:
        raise Unavailable(missing)


def fly(case: TestCase, wall_limit_s: float) -> Flown:
    """Fly the test case once in a sandbox; raises as `OwnSimulator.fly` and `check_flies_here` do."""
    check_flies_here(case.target.name)
    simulator = OwnSimulator()
    try:
        return simulator.fly(case, wall_limit_s)
    finally:
        simulator.close()


def why_alone(case: TestCase, flown: Flown) -> str:
    """Return in words why a flight that asks for a twin was compared with none; empty if it was, or asks for none."""
    from saflite.simulator_worker.registry import describe_target
    from saflite.simulator_worker.twins import why_alone as why

    if not case.twin:
        return ""
    trace = unpack_trace(flown.packed) if flown.packed else None
    return why(describe_target(case.target.name), case, flown.flight.delivered, trace)


class Apart(NamedTuple):
    """How far a flight and its twin were apart at most at the same moment, and when."""

    apart_m: float
    at_s: float


def apart(flown: Flown) -> Apart | None:
    """Return how far the twin of a flight was from it at most; None where none was compared."""
    trace = unpack_trace(flown.packed) if flown.packed else None
    if trace is None or "twin" not in trace.signals or not trace.samples:
        return None
    sides = [trace.array(f"twin_{side}_apart_m").astype(float) for side in ("x", "y", "height")]
    apart_m = np.nan_to_num(np.sqrt(sum(side**2 for side in sides)))  # a target from outside may tell of no place
    at = int(np.argmax(apart_m))
    return Apart(round(float(apart_m[at]), 3), round(at * trace.step_s, 3))


def silent_on_twin(case: TestCase, judgement: Judgement, texts: PolicyTexts) -> list[Verdict]:
    """Return the verdicts of rules that compare with such a twin and said nothing of this flight."""
    from saflite.oracle.policy import load_policy, policy_names

    known = {*policy_names(), *texts}
    quiet = [one for one in judgement.verdicts if one.robustness is None and one.policy in known]
    return [one for one in quiet if load_policy(one.policy, texts).file.twin == case.twin]


def twin_in_words(case: TestCase, judgement: Judgement, found: Apart, texts: PolicyTexts) -> str:
    """Return how far the twin was apart, and which rules about it said nothing."""
    words = f"{case.twin}: at most {found.apart_m:.3g} m apart at the same moment, at {found.at_s:g} s"
    quiet = [f"{one.policy} is {one.outcome}: {one.message}" for one in silent_on_twin(case, judgement, texts)]
    return "; ".join((words, *quiet))


def judge(
    case: TestCase, flown: Flown, policies: tuple[str, ...], policy_texts: PolicyTexts | None = None
) -> Judgement:
    """Judge a flight by the policies named; by all there are if none is."""
    from saflite.oracle.judge import judge as oracle_judge
    from saflite.oracle.policy import policy_names

    trace = unpack_trace(flown.packed) if flown.packed else None
    return oracle_judge(case, flown.flight, trace, policies or policy_names(), policy_texts)


def exit_code(judgement: Judgement) -> int:
    """Return 1 if a policy was violated, 4 if none applied or none could be judged, else 0."""
    outcomes = {verdict.outcome for verdict in judgement.verdicts}
    return 1 if "violated" in outcomes else 0 if "held" in outcomes else NOTHING_JUDGED


def show(case: TestCase, flight: Flight, judgement: Judgement, everything: bool = False) -> None:
    """Print a flight and its verdicts, those without a robustness one by one only if `everything` is asked for."""
    boxes = len(case.scenario.obstacles)
    out.line(f"test case  {identity(case)} on {case.target.name}, {boxes} {'box' if boxes == 1 else 'boxes'}")
    if flight.simulated_s:
        speed = (
            f" in {flight.wall_s:.2f} s ({flight.simulated_s / flight.wall_s:.0f}x real time)" if flight.wall_s else ""
        )
        out.line(f"flight     {flight.ending}, {flight.simulated_s:.1f} s{speed}")
    _show_untaken(case, flight)
    if flight.trace_digest:
        out.line(f"trace      {flight.trace_digest[:16]}")
    listed = [verdict for verdict in judgement.verdicts if everything or verdict.robustness is not None]
    rows = [
        (
            verdict.outcome.upper() if verdict.outcome == "violated" else verdict.outcome,
            verdict.policy,
            "" if verdict.robustness is None else f"{verdict.robustness:+.3g}",
            verdict.message,
        )
        for verdict in sorted(listed, key=_order)
    ]
    out.table(rows, indent="  ")
    left = Counter(verdict.outcome for verdict in judgement.verdicts if verdict not in listed)
    whys: dict[Ruling, str] = {"vacuous": NEVER_APPLIED, "inconclusive": "the rule could not be judged"}
    for outcome, why in whys.items():
        if count := left[outcome]:
            out.line(f"  {count} {'policy' if count == 1 else 'policies'} {outcome}: {why}")


def _show_untaken(case: TestCase, flight: Flight) -> None:
    """Say what became of inputs other than that they were taken: a typo must not look like a flight that held."""
    if flight.delivered is None or not case.stimuli:
        return
    became = {one.index: one for one in flight.delivered if one.index < len(case.stimuli)}
    untaken = {place: became.get(place) for place in range(len(case.stimuli))}
    words = {"accepted": "", "unanswered": "", "timed_out": "timed out"}
    told: list[tuple[str, str]] = []
    for place, one in untaken.items():
        how = "not given" if one is None else words.get(one.answer, one.answer)
        why = f": {one.message}" if one is not None and one.message else ""
        if how:
            stimulus = case.stimuli[place]
            told.append(
                (how, f"{stimulus.at_s:g} s {stimulus_text(stimulus)[:INPUT_SHOWN]} ({how}{why[:INPUT_SHOWN]})")
            )
    if not told:
        return
    counts = ", ".join(f"{count} {how}" for how, count in Counter(how for how, _ in told).items())
    out.line(
        f"inputs     {len(case.stimuli)}, of which {counts}: {some((text for _, text in told), UNTAKEN_SHOWN, '; ')}"
    )


def _order(verdict: Verdict) -> tuple[int, float, str]:
    """Violated first, then held, each by robustness; then those without a robustness by name."""
    rank = ("violated", "held", "vacuous", "inconclusive").index(verdict.outcome)
    return rank, verdict.robustness or 0.0, verdict.policy
