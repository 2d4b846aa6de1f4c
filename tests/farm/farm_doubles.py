"""Services of the farm that are cheap and know their lines: what they return depends on their work and nothing else."""

from __future__ import annotations

from functools import cache

import msgspec
import numpy as np

from saflite.contract.config import Campaign, LeaseConfig, ScorerConfig, SearchConfig
from saflite.contract.flight import Ending, Flight, Trace, pack_trace, trace_digest
from saflite.contract.ids import digest
from saflite.contract.rng import derive
from saflite.contract.score import Score
from saflite.contract.test_case import Obstacle, Origin, Scenario, StartState, Target, TestCase, identity
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import (
    Failure,
    FlyResult,
    FlyWork,
    JudgeResult,
    JudgeWork,
    MutateResult,
    MutateWork,
    RecordResult,
    RecordWork,
    Result,
    ScoreResult,
    ScoreWork,
    WarmResult,
    WarmWork,
    Work,
)

POLICY = "min-obstacle-distance"
TEMPLATE = TestCase(target=Target(), scenario=Scenario(start=StartState()))


def campaign(
    budget: int = 20, *, rng_seed: int = 1, lease: LeaseConfig | None = None, batch: int = 4, **search: object
) -> Campaign:
    """A small campaign; `search` overrides single settings of the search."""
    settings: dict[str, object] = {"candidates_per_round": 8, "flights_per_round": 3, "lag": 2, **search}
    return Campaign(
        name="farm-test",
        budget_flights=budget,
        rng_seed=rng_seed,
        search=msgspec.convert(settings, SearchConfig),
        scorer=ScorerConfig(model="scripted", batch=batch),
        lease=lease or LeaseConfig(lease_s=10.0, heartbeat_s=2.0, wall_limit_s=30.0),
    )


def luck(name: str) -> float:
    """A number in 0..1 that belongs to a test case."""
    return int(digest(name.encode())[:8], 16) / 2**32


def is_poison(name: str) -> bool:
    """Some test cases take the worker down, every time."""
    return luck(f"poison {name}") < 0.03


def is_flaky(name: str) -> bool:
    """Some test cases fly differently each time."""
    return luck(f"flaky {name}") < 0.15


@cache
def flown(name: str, index: int) -> tuple[Ending, str, bytes]:
    """How a test case ends, and its trace: bit-equal at every flight unless it is a flaky one."""
    distance = 4.0 * luck(name) if not is_flaky(name) else 4.0 * luck(f"{name} {index}")
    trace = Trace(step_s=0.1, signals={"obstacle_distance_m": np.full(3, distance, dtype="<f4").tobytes()})
    return ("crashed" if distance < 0.5 else "completed"), trace_digest(trace), pack_trace(trace)


def mutate(work: MutateWork) -> MutateResult:
    """Boxes drawn from the round's stream, drawn towards the nearest outcome told of the last round."""
    known = [outcome for outcome in work.outcomes if outcome.robustness is not None]
    lean = min((outcome.robustness or 0.0 for outcome in known), default=0.0)
    rng = derive(work.rng_seed, "boxes")
    cases = []
    for index in range(work.count):
        x_m, y_m = rng.integers(0, 12, 2).tolist()
        box = Obstacle(length_m=5, width_m=4, height_m=20, x_m=float(x_m), y_m=y_m + round(lean, 3))
        origin = Origin(strategy=work.strategy, round=work.round, index=index)
        scenario = msgspec.structs.replace(work.template.scenario, obstacles=(box,))
        cases.append(msgspec.structs.replace(work.template, scenario=scenario, origin=origin))
    return MutateResult(round=work.round, test_cases=tuple(cases))


def score(work: ScoreWork) -> ScoreResult:
    """The truth, blurred."""
    scores = []
    for test_case in work.test_cases:
        name = identity(test_case)
        value = min(10.0, max(0.0, 10.0 - 2.5 * 4.0 * luck(name) + 3.0 * (luck(f"blur {name}") - 0.5)))
        scores.append(Score(test_case=name, value=value, model=work.model, scored_by=work.model))
        scores.extend(
            Score(test_case=name, value=1.0, model=shadow, scored_by=shadow, shadow=True) for shadow in work.shadow
        )
    return ScoreResult(scores=tuple(scores))


def fly(work: FlyWork) -> FlyResult:
    """Fly a test case."""
    name = identity(work.test_case)
    ending, trace_name, trace = flown(name, work.flight_index)
    flight = Flight(
        test_case=name,
        flight_index=work.flight_index,
        ending=ending,
        simulated_s=60.0,
        wall_s=0.3,
        trace_digest=trace_name,
    )
    return FlyResult(flight=flight, trace=trace)


def judge(work: JudgeWork) -> JudgeResult:
    """Violated below 1.5 m."""
    name, index = identity(work.test_case), work.flight.flight_index
    _, trace_name, trace = flown(name, index)
    assert (work.flight.trace_digest, work.trace) == (trace_name, trace), "the trace of another flight"
    distance = 4.0 * luck(name) if not is_flaky(name) else 4.0 * luck(f"{name} {index}")
    verdict = Verdict(
        policy=POLICY,
        outcome="violated" if distance < 1.5 else "held",
        robustness=distance - 1.5,
        severity="soft" if distance < 1.5 else "none",
    )
    fingerprint = digest(f"{POLICY} {name}".encode())[:16] if distance < 1.5 else ""
    features = {"min_distance_m": distance}
    return JudgeResult(
        judgement=Judgement(
            test_case=name, flight_index=index, verdicts=(verdict,), fingerprint=fingerprint, features=features
        )
    )


def record(work: RecordWork) -> RecordResult:
    """Pretend no more than the name of the file."""
    assert flown(identity(work.test_case), work.flight.flight_index)[2] == work.trace, "the trace of another flight"
    name = identity(work.test_case)
    return RecordResult(
        test_case=name, flight_index=work.flight.flight_index, file=f"recordings/{name}.mcap", digest="0", size_bytes=1
    )


def warm(work: WarmWork) -> WarmResult:
    """Models called broken do not answer."""
    return WarmResult(model=work.model, ready=not work.model.startswith("broken"), message="probed")


def do(work: Work) -> Result:
    """Do a piece of work as the stage it is for would."""
    match work:
        case MutateWork():
            return mutate(work)
        case ScoreWork():
            return score(work)
        case FlyWork():
            return fly(work)
        case JudgeWork():
            return judge(work)
        case RecordWork():
            return record(work)
        case WarmWork():
            return warm(work)
    return Failure(message="unknown work")
