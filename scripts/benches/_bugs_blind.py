"""Part of `scripts/bench bugs-real`: flights until a bug's rule is first seen broken by a search that is not told how.

The rule, not the bug, ends a search, as in the paper: another way of breaking the same rule counts, so each row keeps
the inputs of the flight that ended it. Bugs of one rule share their searches.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from _inline import Flights, Inline
from _search_run import PUBLISHED

from saflite.campaign.presets.policy_campaigns import PREFIX, pgfuzz_settings, policy_campaign, policy_campaigns
from saflite.conformance.flying import DEADLINE_S
from saflite.console.evaluation.bugs import bugs
from saflite.console.operations.judging import OwnSimulator
from saflite.contract.config import Campaign, ScorerConfig, StrategyConfig
from saflite.contract.flight import Flight
from saflite.contract.service import Cancelled
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Setting, identity, told_in_order, under_noise
from saflite.contract.work import FlyWork, JudgeResult, PolicyTexts, Result
from saflite.runtime.stages import brief_of
from saflite.scorer_pool.model import BriefOf, PolicyBrief

ARMS = {
    "list, chance": "PGFuzz's list for the rule, drawn as it draws; flown as they come",
    "list, text": "the same, 8 of 24 chosen by `relevance`, told only the paper's words of the rule",
    "open, chance": "every input that the binary has, drawn in the same way; flown as they come",
    "open, text": "the same, 8 of 24 chosen by `relevance`, told only the paper's words",
    "own campaign": "the rule's campaign as we ship it; who wrote its procedures knew the bugs",
    "policy-all": "all rules that fit, as shipped, until this one is broken; by who knew the bugs, too",
}
SHIPPED = ("own campaign", "policy-all")
CANDIDATES, CHOSEN = 24, 8
NO_LOG = {"log": "none"}  # a target that keeps its own log cannot fork a flight from its start


class Row(NamedTuple):
    """One search. `found` is the number of first flights judged up to the first that breaks the rule, 0 if none did."""

    bench: str
    part: str
    target: str
    autopilot: str
    bugs: tuple[str, ...]
    policy: str
    arm: str
    rng_seed: int
    budget: int
    inputs: int
    flights: int
    judged: int
    applied: int
    found: int
    trigger: str
    load: str
    wall_s: float


class OnTarget(Flights):
    """Flies on whatever target the test cases name, in one session."""

    def __init__(self) -> None:
        super().__init__()
        self._simulator = OwnSimulator()
        self.told: dict[str, str] = {}

    def _fly(self, work: FlyWork, cancelled: Cancelled) -> tuple[Flight, bytes]:
        self.flown += 1
        case = under_noise(work.test_case, work.noise)
        self.told[identity(work.test_case)] = told_in_order(work.test_case.stimuli)
        flown = self._simulator.fly(case, DEADLINE_S)
        return flown.flight, flown.packed

    def close(self) -> None:
        """End the simulator."""
        self._simulator.close()


class Watch:
    """Counts the first flights judged, until one breaks the rule."""

    def __init__(self, policy: str) -> None:
        self._policy = policy
        self.judged = self.applied = self.found = 0
        self.case = ""

    def saw(self, result: Result) -> None:
        """Take a judgement."""
        if not isinstance(result, JudgeResult) or result.judgement.flight_index or self.found:
            return
        self.judged += 1
        said = {one.policy: one.outcome for one in result.judgement.verdicts}.get(self._policy)
        self.applied += said in ("held", "violated")
        if said == "violated":
            self.found, self.case = self.judged, result.judgement.test_case


def campaign_of(base: Campaign, policy: str, arm: str, target: TargetInfo, rng_seed: int, budget: int) -> Campaign:
    """Return the campaign of an arm: start and parameters are those of the rule's own but for "policy-all"."""
    forked = {name: value for name, value in NO_LOG.items() if name in target.settings}
    search = msgspec.structs.replace(base.search, shrink=False, confirm_flights=1, confirm_needed=1)
    base = msgspec.structs.replace(
        base,
        name="bench-bugs-real",
        target=msgspec.structs.replace(base.target, settings={**base.target.settings, **forked}),
        search=search,
        budget_flights=budget,
        rng_seed=rng_seed,
        record="none",
    )
    if arm in SHIPPED:
        return base
    listed, _, chooses = arm.partition(", ")
    settings: dict[str, Setting] = {**pgfuzz_settings(policy, target), **PUBLISHED}
    if listed == "open":
        settings = dict(PUBLISHED)
    return msgspec.structs.replace(
        base,
        strategy=StrategyConfig(name="pgfuzz", settings=settings),
        scorer=ScorerConfig(model="relevance" if chooses == "text" else "constant", batch=16),
        search=msgspec.structs.replace(
            search, candidates_per_round=CANDIDATES if chooses == "text" else CHOSEN, flights_per_round=CHOSEN
        ),
    )


def only_text(policy: str, words: str) -> BriefOf:
    """Return what scorers are told: of the rule the paper's words alone, none of our own nor its inputs."""

    def brief(name: str, texts: PolicyTexts | None = None) -> PolicyBrief:
        whole = brief_of(name, texts)
        return whole._replace(interestingness=words, inputs=()) if name == policy else whole

    return brief


def searches(
    info: TargetInfo,
    ids: Sequence[str],
    arms: Sequence[str],
    seeds: Sequence[int],
    budget: int,
    done: set[tuple[str, str, int]],
) -> Iterator[Row]:
    """Search for the rules of the bugs named; those of `done` (policy, arm, seed) are passed over."""
    campaigns, everything = policy_campaigns(info), policy_campaign("policy-all", info)
    assert everything is not None
    wanted = [bug for bug in bugs() if bug.id in ids]
    for policy in dict.fromkeys(bug.policy for bug in wanted):
        of_it = [bug for bug in wanted if bug.policy == policy]
        brief = only_text(policy, of_it[0].paper_words)
        for rng_seed in seeds:
            for arm in [arm for arm in arms if (policy, arm, rng_seed) not in done]:
                base = everything if arm == "policy-all" else campaigns[PREFIX + policy]
                campaign = campaign_of(base, policy, arm, info, rng_seed, budget)
                start, flights, watch = time.perf_counter(), OnTarget(), Watch(policy)
                spent = _spent(campaign, info, brief_of if arm in SHIPPED else brief, flights, watch)
                yield Row(
                    bench="bugs-real",
                    part="blind",
                    target=info.name,
                    autopilot=info.autopilot,
                    bugs=tuple(bug.id for bug in of_it),
                    policy=policy,
                    arm=arm,
                    rng_seed=rng_seed,
                    budget=budget,
                    inputs=len(info.inputs),
                    flights=spent,
                    judged=watch.judged,
                    applied=watch.applied,
                    found=watch.found,
                    trigger=flights.told.get(watch.case, ""),
                    load=f"{os.getloadavg()[0]:.0f} on {os.cpu_count()} cores",
                    wall_s=round(time.perf_counter() - start, 1),
                )


def _spent(campaign: Campaign, info: TargetInfo, brief: BriefOf, flights: OnTarget, watch: Watch) -> int:
    """Run the campaign until the watch has found; return its first flights."""
    with tempfile.TemporaryDirectory(prefix="saflite-bugs-") as folder:
        inline = Inline(campaign, Path(folder) / "run", flights, info, brief)
        inline.watch("judge", watch.saw)
        try:
            return inline.run(lambda _: bool(watch.found)).flights
        finally:
            inline.close()
