"""Books that hand out anything: real work made wrong, given to the real service of its stage.

Whatever a peer gets past the books comes to the other services as such work. Parts of two works of a kind are mixed,
too: a strategy with the template, target, policies and outcomes of another's campaign.
"""

from __future__ import annotations

import tempfile
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import reduce
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from mutations import FLOATS, Edit, changed, crossed, drawn, encoded, torn
from peer import plain

from saflite.campaign.lifecycle.outcomes import outcome_of
from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.contract import wire
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import Flight, Trace, pack_trace, trace_digest, unpack_trace
from saflite.contract.target import Session, Slot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase, identity
from saflite.contract.work import (
    FlyResult,
    FlyWork,
    Grant,
    JudgeResult,
    JudgeWork,
    MutateResult,
    MutateWork,
    RecordWork,
    Result,
    ScoreWork,
    Stage,
    WarmWork,
    Work,
)
from saflite.evidence.memory import MemoryBlobs
from saflite.mutator.registry import strategy_names
from saflite.oracle.policy import POLICIES_DIR
from saflite.runtime.clock import WallClock
from saflite.runtime.stages import ServiceContext, open_stage
from saflite.simulator_worker.registry import describe_target, load_target

CAMPAIGNS = ("avoidance-m2", "policy-a-flip1")
TARGETS = ("reference", "ardupilot", "betaflight")
POLICIES_TOGETHER = 3
CROSSED_SHARE = 0.4  # of wrong works, first given one to three parts of another of their kind
CHANGES_MAX = 4
INPUTS_OF_A_KIND = 8
ODD_SAMPLES_SHARE = 0.5  # of wrong traces
STAGES: dict[str, Stage] = {"mutate": "mutate", "score": "score", "warm": "score", "judge": "judge", "record": "record"}
MODELS = ("blend", "gap", "surrogate", "relevance", "novelty", "low_fidelity", "random", "ensemble:gap,blend")
FLOWN_S = 5.0  # of simulated time, for traces that others read
TRIED_S = 2.0  # of simulated time, where flying is what is tried: the first inputs come at 0.5 s
WALL_S = 120.0  # beside other work flights take long; with 5 s a machine under load had no trace to show
TRACE_EVERY = 5  # with this message the trace is made wrong, not the work


class Fliers:
    """The reference target in this process: what a simulator does with a test case, without its sandbox."""

    stage: Stage = "fly"

    def __init__(self, flown_s: float = FLOWN_S) -> None:
        self._flown_s = flown_s
        folder = Path(tempfile.mkdtemp(prefix="saflite-fuzz-"))
        self._target = load_target("reference")
        self._session: Session = self._target.open(Slot(index=0, folder=folder, clock=WallClock()))

    def fly(self, case: TestCase) -> tuple[Flight, Trace | None]:
        """Check and fly as `simulator_worker/simulator.py` does."""
        self._target.check(case)
        scenario = case.scenario
        short = msgspec.structs.replace(scenario, time_limit_s=min(scenario.time_limit_s, self._flown_s))
        case = msgspec.structs.replace(case, scenario=short)
        record = self._session.fly(case, WALL_S, lambda: False)
        flight = Flight(
            test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered,
            message=record.message,
        )  # fmt: skip
        return flight, record.trace

    def do(self, work: Work, cancelled: Any) -> Result:
        """Fly."""
        assert isinstance(work, FlyWork), work
        return FlyResult(flight=self.fly(work.test_case)[0])

    def close(self) -> None:
        """End the session."""
        self._session.close()


class Works:
    """Work of one kind for its real service."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self.rng, self.number, self.blobs = rng, 0, MemoryBlobs()
        context = ServiceContext("w", WallClock(), None, self.blobs)
        self.service: Any = Fliers(TRIED_S) if kind == "fly" else open_stage(STAGES[kind], context)
        self.valid = [work for name in CAMPAIGNS for work in works(name, self.blobs) if _kind(work) == kind]
        self._said = [plain(work) for work in self.valid]

    def step(self) -> int:
        """Hand out one wrong lease; returns 1. Raises what the worker would die of."""
        self.number += 1
        place = self.number % len(self.valid)
        work = self.valid[place]
        if isinstance(work, JudgeWork | RecordWork) and self.number % TRACE_EVERY == 0:
            self._do(self._with_wrong_trace(work))
        else:
            self._hand_out(self._wrong(self._said[place]))
        return 1

    def say(self, edits: list[Edit]) -> None:
        """Hand out each valid work that has these places, with other values there."""
        for said in self._said:
            try:
                wrong = reduce(changed, edits, said)
            except (KeyError, IndexError, TypeError):  # it has no such place
                continue
            self._hand_out(wrong)

    def _hand_out(self, said: Any) -> None:
        lease = {"lease_id": "run:x", "epoch": 1, "lease_s": 10.0, "work": said}
        try:
            read = wire.decode(encoded({"leases": [lease]}), Grant)
        except Refused:
            return
        for one in read.leases:
            self._do(one.work)

    def _wrong(self, said: dict[str, Any]) -> Any:
        """Return this work with parts of another one, with wrong values, or with both."""
        way = self.rng.random()
        if way < CROSSED_SHARE:
            said = crossed(said, self._said[int(self.rng.integers(len(self._said)))], self.rng)
        if way > CROSSED_SHARE / 2.0:
            said = drawn(said, self.rng, CHANGES_MAX)[0]
        return said

    def _do(self, work: Work) -> None:
        if isinstance(work, MutateWork) and (work.count > 50 or work.from_cursor != -1):
            return  # the books ask for no more than the campaign says; a memory test, not one of exceptions
        with suppress(Refused, Unavailable):
            wire.checked(self.service.do(work, lambda: False), Result)

    def _with_wrong_trace(self, work: JudgeWork | RecordWork) -> Work:
        assert work.flight.trace is not None
        trace = plain(unpack_trace(self.blobs.get(work.flight.trace)))
        odd = self.rng.random() < ODD_SAMPLES_SHARE
        data = encoded(_with_odd_samples(trace, self.rng) if odd else drawn(trace, self.rng)[0])
        packed = torn(_packed(data), self.rng) if self.rng.random() < 0.2 else _packed(data)
        flight = msgspec.structs.replace(work.flight, trace=self.blobs.put(packed), trace_digest="")
        return msgspec.structs.replace(work, flight=flight)

    def close(self) -> None:
        """Close the service."""
        self.service.close()


def _with_odd_samples(trace: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return a trace of which one to four signals hold values no sensor gives, for a sample or a while."""
    signals = dict(trace["signals"])
    for name in rng.choice(sorted(signals), int(rng.integers(1, 5))).tolist():
        values = np.frombuffer(signals[name], dtype="<f4").copy()
        first = int(rng.integers(len(values) + 1))
        with np.errstate(over="ignore"):
            values[first : first + int(rng.choice((1, 20, len(values))))] = rng.choice(
                np.array(FLOATS, dtype=np.float32)
            )
        signals[name] = values.tobytes()
    return {**trace, "signals": signals}


def _packed(data: bytes) -> bytes:
    return zlib.compress(data, 1)


def _kind(work: Work) -> str:
    return str(work.__struct_config__.tag)


def works(name: str, blobs: MemoryBlobs) -> Iterator[Work]:
    """Yield work of every kind of a campaign, made by the real services."""
    campaign = load_campaign(name)
    base = template(campaign)
    target = msgspec.structs.replace(describe_target(base.target.name), build="", missing="")
    mutate = MutateWork(
        round=0, count=2, strategy=campaign.strategy.name, settings=campaign.strategy.settings, rng_seed=1,
        template=base, target=target, policies=campaign.policies, outcomes=(), from_cursor=-1, cursor=-1,
    )  # fmt: skip
    context = ServiceContext("w", WallClock(), None, blobs)
    proposed = open_stage("mutate", context).do(mutate, lambda: False)
    assert isinstance(proposed, MutateResult)
    flier, oracle = Fliers(), open_stage("judge", context)
    outcomes = []
    for case in proposed.test_cases:
        yield FlyWork(test_case=case, flight_index=0, purpose="search", wall_limit_s=10.0)
        flight, trace = flier.fly(case)
        assert trace is not None
        flight = msgspec.structs.replace(
            flight, test_case=identity(case), trace=blobs.put(pack_trace(trace)), trace_digest=trace_digest(trace)
        )
        judge = JudgeWork(test_case=case, flight=flight, policies=campaign.policies)
        yield judge
        judged = oracle.do(judge, lambda: False)
        assert isinstance(judged, JudgeResult)
        yield RecordWork(test_case=case, flight=flight, judgement=judged.judgement)
        outcomes.append(outcome_of(case, 0, flight.ending, judged.judgement))
    flier.close()
    told = {"outcomes": tuple(outcomes), "cursor": 0}
    yield from _of_every_strategy(msgspec.structs.replace(mutate, round=1, **told))
    yield from _of_every_policy(judge)
    for model in MODELS:
        yield WarmWork(model=model)
        yield ScoreWork(
            round=1, model=model, shadow=(), policies=campaign.policies, test_cases=proposed.test_cases, rng_seed=1,
            recent=tuple(outcomes), cursor=0, deadline_s=5.0,
        )  # fmt: skip


def _of_every_strategy(work: MutateWork) -> Iterator[MutateWork]:
    """Yield the work, and the same for every strategy with its own settings, on every target."""
    yield work
    for target in TARGETS:
        info = _few_inputs(describe_target(target))
        for strategy in strategy_names():
            yield msgspec.structs.replace(work, strategy=strategy, settings={}, target=info)


def _few_inputs(target: TargetInfo) -> TargetInfo:
    """Return a target as every machine describes it, with a few inputs of each kind: what is short is read quickly."""
    count: Counter[str] = Counter()
    kept = []
    for entry in target.inputs:
        count[entry.kind] += 1
        kept += [entry] if count[entry.kind] <= INPUTS_OF_A_KIND else []
    return msgspec.structs.replace(target, build="", missing="", inputs=tuple(kept))


def _of_every_policy(work: JudgeWork) -> Iterator[JudgeWork]:
    """Yield work over all policies that ship, some at a time."""
    names = sorted(path.stem for path in POLICIES_DIR.glob("*.toml"))
    for place in range(0, len(names), POLICIES_TOGETHER):
        yield msgspec.structs.replace(work, policies=tuple(names[place : place + POLICIES_TOGETHER]))
