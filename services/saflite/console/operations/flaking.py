"""How often one test case violates under noise that had no part in finding it; what it does under its own, apart."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

from saflite.console.operations.builds import Bench, Build, Sample, fresh_noises
from saflite.console.run_data.known import Known
from saflite.contract.flight import AUTOPILOT_ALIVE
from saflite.contract.interval import Interval, wilson
from saflite.contract.verdict import modes_named
from saflite.simulator_worker.registry import describe_target


class PolicyRate(NamedTuple):
    """One policy over the flights: `violated` of `judged`, the least robustness, the ways it was violated in."""

    policy: str
    violated: int
    judged: int
    rate: Interval
    least: float | None
    ways: Counter[str]


class Flaked(NamedTuple):
    """Flights of one test case on a build: those that `rates` count; `own` is the one under the noise of its record."""

    known: Known
    build: Build
    samples: tuple[Sample, ...]
    rates: tuple[PolicyRate, ...]
    own: Sample

    @property
    def lost(self) -> list[Sample]:
        """The flights that say nothing of the vehicle."""
        return [sample for sample in self.samples if sample.verdicts is None]


def flake(known: Known, build: Build, count: int, wall_limit_s: float) -> Flaked:
    """Fly the test case under the noise of its record, then `count` times under noise of its own each; count these."""
    policies = tuple(dict.fromkeys((known.policy, *known.policies)))
    with Bench(build, wall_limit_s) as bench:
        own, *others = (
            bench.fly(known.test_case, policies, known.policy_texts, noise)
            for noise in (known.noise, *fresh_noises(count))
        )
    samples = tuple(others)
    died = (AUTOPILOT_ALIVE,) if any(AUTOPILOT_ALIVE in sample.violated for sample in samples) else ()
    rates = tuple(_rate(name, samples) for name in dict.fromkeys((*policies, *died)))
    told = tuple(one for one in rates if one.violated or one.policy == known.policy)
    return Flaked(known, build, samples, told, own)


def _rate(policy: str, samples: tuple[Sample, ...]) -> PolicyRate:
    verdicts = [verdict for sample in samples if (verdict := sample.of(policy)) is not None]
    broken = [verdict for verdict in verdicts if verdict.outcome == "violated"]
    least = min((one.robustness for one in verdicts if one.robustness is not None), default=None)
    ways = Counter(one.behaviour for one in broken)
    return PolicyRate(policy, len(broken), len(verdicts), wilson(len(broken), len(verdicts)), least, ways)


def exit_code(flown: Flaked) -> int:
    """Return 1 where something was violated, be it under its own noise, 3 where no flight counted could be judged."""
    if flown.own.violated or any(one.violated for one in flown.rates):
        return 1
    return 0 if any(one.judged for one in flown.rates) else 3


def lines(flown: Flaked) -> list[str]:
    """Return the counts in words."""
    found = [f"test case {flown.known.name} on {flown.build.label}, build {flown.build.digest[:12]}"]
    for one in flown.rates:
        if one.rate.value is None:
            found.append(f"  {one.policy}: could not be judged in any of {len(flown.samples)} flights")
            continue
        least = f", least robustness {one.least:+.3f}" if one.least is not None else ""
        interval = f"rate {one.rate.value:.2f} (95 %: {one.rate.low:.2f} to {one.rate.high:.2f})"
        found.append(f"  {one.policy}: violated in {one.violated} of {one.judged}, {interval}{least}")
        modes = describe_target(flown.build.target.name).modes
        found += [f"    {count} x {modes_named(way, modes)}" for way, count in one.ways.most_common()]
    if flown.lost:
        found.append(f"  {len(flown.lost)} of {len(flown.samples)} flights say nothing: {flown.lost[0].message}")
    found.append(f"  under the noise of its record, not counted: {_own(flown.own)}")
    return found


def _own(sample: Sample) -> str:
    if sample.verdicts is None:
        return f"says nothing: {sample.message}"
    return f"violates {', '.join(sample.violated)}" if sample.violated else "violates nothing"


def plain(flown: Flaked) -> dict[str, Any]:
    """Return the counts for scripts."""
    modes = describe_target(flown.build.target.name).modes
    return {
        "test_case": flown.known.name,
        "target": flown.build.label,
        "build": flown.build.digest,
        "flights": len(flown.samples),
        "lost": len(flown.lost),
        "own_noise": {
            "noise": flown.own.noise,
            "ending": flown.own.ending,
            "violated": None if flown.own.verdicts is None else flown.own.violated,
        },
        "policies": {
            one.policy: {
                "violated": one.violated,
                "judged": one.judged,
                "rate": one.rate,
                "least_robustness": one.least,
                "ways": {modes_named(way, modes): count for way, count in one.ways.items()},
            }
            for one in flown.rates
        },
    }
