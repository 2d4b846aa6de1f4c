"""One search for faults that are on together: a campaign in one process, finds told apart by flying them again."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec
from _authored_faults import Patch
from _blind_faults import Site, planted
from _inline import Flights, Inline
from _search_exposure import Exposure

from saflite.campaign.presets.campaigns import load_campaign
from saflite.campaign.presets.policy_campaigns import pgfuzz_settings
from saflite.conformance.flying import fly_once
from saflite.console.io.campaign_options import changed
from saflite.console.run_data.run_folder import RunFolder
from saflite.contract.config import Campaign, ScorerConfig, SearchConfig, StrategyConfig
from saflite.contract.control import Status
from saflite.contract.flight import AUTOPILOT_ALIVE, Flight
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Setting, StartState, TestCase, identity
from saflite.contract.work import FlyResult, FlyWork, JudgeResult, Result, Work
from saflite.flight.autopilots.reference.defects import SETTING, TABLE
from saflite.flight.autopilots.reference.describe import describe
from saflite.oracle.judge import judge

EXAMINED_MAX = 8  # violations of one policy that are flown again to tell which fault they are from
OLD_SEARCH = SearchConfig(candidates_per_round=96, flights_per_round=16, lag=3)
UNIFORM: dict[str, Setting] = {
    "own": 0.0,
    "kept": 0.0,
    "routed": 0.0,
    "recalled": 0.0,
    "starts": 0.9,
    "missions": 0.1,
    "swarm": 1.0,
    "faults": 1.0,
}
ARMS: dict[str, str] = {
    "all": "policy-all as it ships",
    "own": "the campaign of the fault's own policy as it ships; of a changed line, of the rule that `--policy` names",
    "hidden": "the same without the policy's list of inputs: what its formula reads and names is left",
    "blanked": "the same, and no scorer reads the policy's words: a random choice among the same proposals",
    "pgfuzz": "policy-all as it was before: one start, PGFuzz's draws over all inputs, the scorer chooses 16 of 96",
    "published": "the own campaign, drawn as the published PGFuzz draws: its list, its rounds; no scorer",
    "random": "the vocabulary, starts and phases of policy-all drawn evenly; no hints, no memory, no scorer",
    "unscored": "policy-all, its proposals flown as they come",
    "portfolio": "policy-all, its strategy one arm of a portfolio beside pgfuzz",
}


PUBLISHED: dict[str, Setting] = {"focus": 0.0, "mutated": 0.0, "bursts": 0.0, "echoed": 0.0, "release": 1.0}
OF_ONE_POLICY = ("own", "hidden", "blanked", "published")
FORMULA_HINTS = ("start:", "in:", "reads:")


class Job(NamedTuple):
    """One search: planted defects by name, or faults in the autopilot's lines."""

    arm: str
    defects: tuple[str, ...]
    lines: tuple[Site | Patch, ...]
    rng_seed: int
    budget: int
    policy: str = ""  # whose campaign flies, where no planted defect names one

    @property
    def own(self) -> str:
        """The policy whose campaign the arms of one policy fly."""
        return self.policy or TABLE[self.defects[0]].policy


class Row(NamedTuple):
    """What it came to. `found` gives by fault the flights spent when it was confirmed; one not there was not found."""

    arm: str
    faults: tuple[str, ...]
    rng_seed: int
    budget: int
    flights: int
    found: dict[str, int]
    by_policy: dict[str, list[str]]
    false_alarms: dict[str, int]
    judged: int
    applied_share: float
    spoke_share: float
    silent: list[str]
    states: int
    wall_s: float
    alarm_cases: tuple[dict[str, Any], ...] = ()
    crashed: int = 0  # of the first flights
    core_s: float = 0.0
    by_way: Mapping[str, str] = MappingProxyType({})  # how the test case that found a fault was made
    exposure: Mapping[str, Any] = MappingProxyType({})  # of the first flights: `_search_exposure.py`
    policy: str = ""


class Faulty(Flights):
    """Flies with faults planted in its lines; one that stops the autopilot's own code is found by that."""

    def __init__(self, lines: tuple[Site | Patch, ...]) -> None:
        super().__init__()
        self._lines = lines
        self.exposure = Exposure()
        self.cases: dict[str, TestCase] = {}

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Fly the test case of the lease."""
        with planted(self._lines):
            result = super().do(work, cancelled)
        if isinstance(work, FlyWork) and isinstance(result, FlyResult) and not work.flight_index:
            self.cases[identity(work.test_case)] = work.test_case
            if result.flight.trace is not None:
                self.exposure.flew(work.test_case, result.flight, self.blobs.get(result.flight.trace))
        return result


class Watch:
    """Looks over the shoulder of a campaign: what was judged, which faults its confirmed violations are from."""

    def __init__(self, job: Job, campaign: Campaign, flights: Faulty | None = None) -> None:
        self._job, self._campaign, self._flights = job, campaign, flights
        self.found: dict[str, int] = {}
        self.by_policy: dict[str, set[str]] = {}
        self.by_way: dict[str, str] = {}
        self.false_alarms: Counter[str] = Counter()
        self.alarm_cases: list[dict[str, Any]] = []
        self.spoke: Counter[str] = Counter()
        self.states: set[str] = set()
        self.judged = self.any_spoke = self.crashed = 0
        self._examined: Counter[str] = Counter()
        self._seen: set[tuple[str, str]] = set()

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults that are on."""
        return (*self._job.defects, *(line.name for line in self._job.lines))

    def saw(self, result: Result) -> None:
        """Count what rules said of a first flight."""
        if not isinstance(result, JudgeResult) or result.judgement.flight_index:
            return
        spoke = [one.policy for one in result.judgement.verdicts if one.outcome in ("held", "violated")]
        self.judged += 1
        self.spoke.update(spoke)
        self.any_spoke += bool(spoke)
        self.states |= {step.after for step in result.judgement.transitions}
        if self._flights is not None:
            self._flights.exposure.judged(self._flights.cases[result.judgement.test_case], result.judgement)

    def flew(self, result: Result) -> None:
        """Count the first flights that crashed."""
        if isinstance(result, FlyResult) and not result.flight.flight_index:
            self.crashed += result.flight.ending == "crashed"

    def look(self, run_dir: Path, status: Status) -> bool:
        """Take the new confirmed violations; return whether all faults there are have been found."""
        if status.violations_confirmed > len(self._seen):
            for case, policy in confirmed(run_dir):
                if (identity(case), policy) not in self._seen:
                    self._seen.add((identity(case), policy))
                    self._attribute(case, policy, status.flights)
        return bool(self.faults) and len(self.found) == len(self.faults)

    def _attribute(self, case: TestCase, policy: str, flights: int) -> None:
        left = [fault for fault in self.faults if fault not in self.found]
        self._examined[policy] += 1
        if (self.faults and not left) or self._examined[policy] > EXAMINED_MAX:
            return
        if self._breaks(case, (), (), policy):
            self.false_alarms[policy] += 1
            self.alarm_cases.append(msgspec.to_builtins(case))
            return
        lines = {line.name: line for line in self._job.lines}
        for fault in left:
            line = (lines[fault],) if fault in lines else ()
            if len(self.faults) == 1 or self._breaks(case, () if line else (fault,), line, policy):
                self.found[fault] = flights
                self.by_policy.setdefault(fault, set()).add(policy)
                self.by_way[fault] = case.origin.note.partition(" for ")[0]

    def is_of(self, case: TestCase, defect: str, policy: str) -> bool:
        """Whether a test case breaks a policy with a planted defect alone, and not without any."""
        return self._breaks(case, (defect,), (), policy) and not self._breaks(case, (), (), policy)

    def _breaks(self, case: TestCase, defects: tuple[str, ...], lines: tuple[Site | Patch, ...], policy: str) -> bool:
        settings: dict[str, Setting] = {SETTING: list(defects)} if defects else {}
        target = msgspec.structs.replace(case.target, settings=settings)
        changed = msgspec.structs.replace(case, target=target)
        with planted(lines):
            record = fly_once(changed)
        flight = Flight(test_case="", flight_index=0, ending=record.ending, delivered=record.delivered)
        wanted = () if policy == AUTOPILOT_ALIVE else (policy,)
        verdicts = judge(changed, flight, record.trace, wanted, self._campaign.policy_texts).verdicts
        return any(verdict.policy == policy and verdict.outcome == "violated" for verdict in verdicts)


def confirmed(run_dir: Path) -> list[tuple[TestCase, str]]:
    """Return the confirmed violations of the books so far: test case and policy."""
    with RunFolder(run_dir) as run:
        return [(run.test_case(one.test_case), one.policy) for one in run.violations("confirmed")]


def campaign_of(job: Job) -> Campaign:
    """Return the campaign of an arm with the defects planted."""
    base = load_campaign(f"policy-{job.own}" if job.arm in OF_ONE_POLICY else "policy-all")
    target = msgspec.structs.replace(base.target, settings={SETTING: list(job.defects)} if job.defects else {})
    search, strategy, scorer = base.search, base.strategy, base.scorer
    if job.arm == "pgfuzz":
        search, strategy = OLD_SEARCH, StrategyConfig(name="pgfuzz", settings={"focus": 0.0})
        base = msgspec.structs.replace(base, start=StartState(mode="LOITER", altitude_m=30.0))
    if job.arm == "published":
        policy = job.own
        told = strategy.settings if policy == AUTOPILOT_ALIVE else pgfuzz_settings(policy, describe())
        strategy = StrategyConfig(name="pgfuzz", settings={**told, **PUBLISHED})
    if job.arm in ("hidden", "blanked"):
        strategy = without_lists(strategy)
    if job.arm == "blanked":
        scorer = ScorerConfig(model="random", batch=16)
    if job.arm == "portfolio":
        strategy = changed(base, strategy="portfolio").strategy
    if job.arm in ("random", "unscored", "published"):
        search = msgspec.structs.replace(search, candidates_per_round=search.flights_per_round)
        scorer = ScorerConfig(model="constant", batch=16)
    if job.arm == "random":
        strategy = StrategyConfig(name=strategy.name, settings=UNIFORM)
    return msgspec.structs.replace(
        base,
        name="bench-search",
        target=target,
        strategy=strategy,
        scorer=scorer,
        search=msgspec.structs.replace(search, shrink=False, confirm_flights=1, confirm_needed=1),
        budget_flights=job.budget,
        rng_seed=job.rng_seed,
        record="none",
    )


def without_lists(strategy: StrategyConfig) -> StrategyConfig:
    """Return the strategy told of each policy only its name, its start and what its formula names or reads."""
    told = strategy.settings.get("hints", [])
    assert isinstance(told, list)
    kept = [[word for word in str(text).split()[1:] if word.startswith(FORMULA_HINTS)] for text in told]
    hints: list[str] = [" ".join([str(text).split()[0], *words]) for text, words in zip(told, kept, strict=True)]
    return msgspec.structs.replace(strategy, settings={**strategy.settings, "hints": hints} if hints else {})


def search(job: Job) -> Row:
    """Search until every fault is found or the flights are spent."""
    campaign, start, core = campaign_of(job), time.perf_counter(), time.process_time()
    flights = Faulty(job.lines)
    watch = Watch(job, campaign, flights)
    with tempfile.TemporaryDirectory(prefix="saflite-search-") as folder:
        run_dir = Path(folder) / "run"
        inline = Inline(campaign, run_dir, flights)
        inline.watch("judge", watch.saw)
        inline.watch("fly", watch.flew)
        status = inline.run(lambda now: watch.look(run_dir, now))
        inline.close()
    judged = max(1, watch.judged)
    return Row(
        arm=job.arm,
        faults=watch.faults,
        rng_seed=job.rng_seed,
        budget=job.budget,
        flights=status.flights,
        found=watch.found,
        by_policy={fault: sorted(policies) for fault, policies in sorted(watch.by_policy.items())},
        false_alarms=dict(watch.false_alarms),
        judged=watch.judged,
        applied_share=round(sum(watch.spoke.values()) / judged / len(campaign.policies), 4),
        spoke_share=round(watch.any_spoke / judged, 4),
        silent=[policy for policy in campaign.policies if not watch.spoke[policy]],
        states=len(watch.states),
        wall_s=round(time.perf_counter() - start, 1),
        alarm_cases=tuple(watch.alarm_cases),
        crashed=watch.crashed,
        core_s=round(time.process_time() - core, 1),
        by_way=watch.by_way,
        exposure=flights.exposure.figures(),
        policy=job.policy,
    )
