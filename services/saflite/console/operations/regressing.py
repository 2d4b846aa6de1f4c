"""What became of known violations on a build: each flown again, under the noise of its record and fresh ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import msgspec

from saflite.console.operations.builds import FRESH_NOISE, Benches, Build, Sample, noises, of_case
from saflite.console.operations.chances import Count
from saflite.console.run_data.known import Known
from saflite.console.view.ci_files import Check, Outcome
from saflite.contract.interval import wilson
from saflite.contract.target_info import Repeats
from saflite.contract.verdict import Verdict, modes_named
from saflite.simulator_worker.registry import describe_target

TIMES: dict[Repeats, int] = {"bitwise": 3, "statistically": 5}
"""How often each is flown if nothing else is asked for."""

State = Literal["fixed", "still there", "changed", "flaky", "came back", "not judged", "not flown"]
BROKEN: frozenset[State] = frozenset({"still there", "changed", "flaky", "came back"})
NEW: frozenset[State] = frozenset({"changed", "came back"})


WITHHELD = "memory safety, withheld"


class Regressed(NamedTuple):
    """A known violation on a build: `violated` of `judged` flights, `lost` flights that say nothing of the vehicle.

    `fresh` counts those under noise that had no part in finding it.
    """

    known: Known
    state: State
    violated: int
    judged: int
    lost: int
    words: str
    build: str
    memory_safety: bool = False
    fresh: Count = (0, 0)

    @property
    def rate(self) -> str:
        """The counts with the 95 % interval of the rate under fresh noise, where there is one, in words."""
        if not self.judged:
            return f"{self.lost} flights lost"
        found = wilson(*self.fresh)
        lost = f", {self.lost} lost" if self.lost else ""
        interval = "" if found.value is None else f", rate {found.low:.2f} to {found.high:.2f} under fresh noise"
        return f"{self.violated} of {self.judged}{interval}{lost}"


def regress(
    known: Sequence[Known],
    build: Build | None,
    *,
    times: int | None,
    wall_limit_s: float,
    settings: Sequence[str] = (),
    defects: Sequence[str] = (),
) -> Iterator[Regressed]:
    """Yield what became of each on the build; without one on its own target as it is here, with settings changed."""
    with Benches(wall_limit_s) as benches:
        for one in known:
            flown_on = build or of_case(one.test_case, settings, defects)
            bench = benches.of(flown_on._replace(target=msgspec.structs.replace(flown_on.target, parameters={})))
            count = times or TIMES[describe_target(flown_on.target.name).repeats]
            judged = tuple(dict.fromkeys((one.policy, *one.policies)))
            samples = [bench.fly(one.test_case, judged, one.policy_texts, noise) for noise in noises(count, one.noise)]
            yield told(one, samples, flown_on)


def told(known: Known, samples: Sequence[Sample], build: Build) -> Regressed:
    """Return what flights on a build say of a known violation.

    fixed        every flight was judged, and none violated any policy that the record did not
    still there  every flight violated, in the same way in at least one
    changed      every flight violated, in no flight the same way; or none, but another policy
    flaky        some flights violated
    came back    it was fixed, and a flight violated
    not flown    none violated, and a flight that could have shown it says nothing of the vehicle
    not judged   none violated, and in some the policy could not be judged
    """
    verdicts = [verdict for sample in samples if (verdict := sample.of(known.policy)) is not None]
    broken = [verdict for verdict in verdicts if verdict.outcome == "violated"]
    lost = [sample for sample in samples if sample.verdicts is None]
    others = sorted({name for sample in samples for name in sample.violated} - {known.policy, *known.also})
    memory = known.memory_safety or any(sample.memory_safety for sample in samples)
    if broken:
        state, words = _broken(known, verdicts, broken, build)
    elif others:
        state, words = "changed", f"violates {', '.join(others)}" + (" instead" if verdicts else "")
    elif lost:
        state, words = "not flown", lost[0].message
    elif len(verdicts) < len(samples):
        state, words = "not judged", _why_not(samples, known.policy)
    else:
        silent = all(one.outcome == "vacuous" for one in verdicts)
        state, words = "fixed", "the rule no longer applies" if silent else ""
    words = modes_named(words, describe_target(build.target.name).modes)
    fresh = [verdict for one in samples if one.noise >= FRESH_NOISE and (verdict := one.of(known.policy)) is not None]
    count = sum(1 for verdict in fresh if verdict.outcome == "violated"), len(fresh)
    return Regressed(known, state, len(broken), len(verdicts), len(lost), words, build.digest, memory, count)


def _broken(known: Known, verdicts: Sequence[Verdict], broken: Sequence[Verdict], build: Build) -> tuple[State, str]:
    ways = sorted({one.behaviour for one in broken})
    if known.standing == "fixed":
        return "came back", "; ".join(ways)
    if len(broken) < len(verdicts):
        return "flaky", "; ".join(ways)
    other_target = build.target.name != known.test_case.target.name
    same = known.behaviour in ways or not known.behaviour or (other_target and _roughly(known.behaviour, ways))
    return ("still there", ways[0]) if same else ("changed", f"{known.behaviour or known.policy} -> {'; '.join(ways)}")


def _roughly(behaviour: str, ways: Sequence[str]) -> bool:
    """Return whether one of the ways is the same but for the mode, which each target numbers its own way."""

    def bare(text: str) -> list[str]:
        return [part for part in text.split(", ") if not part.startswith("in mode ")]

    return any(bare(way) == bare(behaviour) for way in ways)


def _why_not(samples: Sequence[Sample], policy: str) -> str:
    verdicts = [one for sample in samples for one in sample.verdicts or () if one.policy == policy]
    messages = [one.message for one in verdicts if one.outcome == "inconclusive"]
    return messages[0] if messages else "no verdict"


def after(result: Regressed) -> Known:
    """Return the known violation with what these flights make of it; unchanged where they cannot tell."""
    if result.state == "fixed":
        return msgspec.structs.replace(result.known, standing="fixed", seen_on=result.build)
    if result.state in BROKEN:
        return msgspec.structs.replace(result.known, standing="violates", seen_on=result.build)
    return result.known


def exit_code(results: Sequence[Regressed], *, known_ok: bool) -> int:
    """Return 1 where something is violated (`known_ok`: in a new way, or again), 3 where a flight could not be had."""
    bad = NEW if known_ok else BROKEN
    if any(result.state in bad for result in results):
        return 1
    return 3 if any(result.state in ("not flown", "not judged") for result in results) else 0


def check(result: Regressed, *, known_ok: bool) -> Check:
    """Return it as a row for JUnit and SARIF."""
    bad = NEW if known_ok else BROKEN
    outcomes: dict[State, Outcome] = {"not flown": "error", "not judged": "skipped", "fixed": "passed"}
    outcome = outcomes.get(result.state, "failed" if result.state in bad else "skipped")
    baselines = {"fixed": "absent", "changed": "updated", "came back": "new"}
    return Check(
        rule=result.known.policy,
        name=f"{result.known.fingerprint} {result.known.name}",
        outcome=outcome,
        text=f"{result.state}: {result.rate}. {WITHHELD if result.memory_safety else result.words}".strip(),
        level="error" if result.known.severity == "hard" else "warning",
        baseline=baselines.get(result.state, "unchanged"),
        fingerprint=result.known.fingerprint,
        place=result.known.file,
    )
