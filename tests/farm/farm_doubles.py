"""Services of the farm that are cheap and know their lines: what they return depends on their work and nothing else."""

from __future__ import annotations

from functools import cache, lru_cache

import msgspec
import numpy as np

from saflite.contract import wire
from saflite.contract.blobs import Blobs
from saflite.contract.config import Campaign, LeaseConfig, ScorerConfig, SearchConfig
from saflite.contract.flight import Artefact, Ending, Flight, Trace, pack_trace, trace_digest
from saflite.contract.ids import digest
from saflite.contract.rng import derive
from saflite.contract.score import Score, Usage
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import (
    DEFAULT_TARGET,
    Obstacle,
    Origin,
    Scenario,
    StartState,
    Stimulus,
    Target,
    TestCase,
    identity,
)
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import (
    FlyResult,
    FlyWork,
    JudgeResult,
    JudgeWork,
    MutateResult,
    MutateWork,
    Outcome,
    RecordResult,
    RecordWork,
    Result,
    ScoreResult,
    ScoreWork,
    Stage,
    WarmResult,
    WarmWork,
    Work,
)
from saflite.evidence.memory import MemoryBlobs

POLICY = "min-obstacle-distance"
TARGET = TargetInfo(name=DEFAULT_TARGET, build="", repeats="bitwise", inputs=(), signals=("x_m",))
TEMPLATE = TestCase(target=Target(), scenario=Scenario(start=StartState()))


def campaign(
    budget: int = 20, *, rng_seed: int = 1, lease: LeaseConfig | None = None, batch: int = 4, **search: object
) -> Campaign:
    """A small campaign; `search` overrides single settings of the search."""
    record = search.pop("record", "violations")
    rhythm = {"candidates_per_round": 8, "flights_per_round": 3, "lag": 2, "check_share": 0.3}
    settings: dict[str, object] = {**rhythm, **search}
    return Campaign(
        name="farm-test",
        budget_flights=budget,
        record=record,  # type: ignore[arg-type]
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
    return luck(f"poison {name}") < 0.06


def is_flaky(name: str) -> bool:
    """Some test cases fly differently each time."""
    return luck(f"flaky {name}") < 0.15


WAYS = 4
"""In how many ways a test case can violate; two in the same way are one behaviour."""


def is_untrue(name: str) -> bool:
    """Some test cases fly another flight when they are flown over again, under the very same noise."""
    return luck(f"untrue {name}") < 0.3


padding_kib = 0
"""How much noise a trace holds besides, to make it as large as a real one."""

track_points = 0
"""How many places a judgement's track holds."""


@lru_cache(maxsize=64)
def flown(name: str, index: int) -> tuple[Ending, str, bytes]:
    """How a test case ends, and its trace: bit-equal at every flight unless it is a flaky one."""
    distance = 4.0 * luck(name) if not is_flaky(name) else 4.0 * luck(f"{name} {index}")
    samples = padding_kib * 256 or 3
    signals = {"obstacle_distance_m": np.full(samples, distance, dtype="<f4").tobytes()}
    if padding_kib:
        signals["x_m"] = derive(int(distance * 1e6), "padding").random(samples, dtype=np.float32).tobytes()
    trace = Trace(step_s=0.1, signals=signals)
    return ("crashed" if distance < 0.5 else "completed"), trace_digest(trace), pack_trace(trace)


class Memory:
    """What a strategy or a learning scorer was told: by round, without gaps."""

    def __init__(self) -> None:
        self.cursor = -1
        self.rounds: dict[int, list[bytes]] = {}

    def tell(self, outcomes: tuple[Outcome, ...], from_cursor: int, cursor: int) -> None:
        """Take outcomes; telling from -1 starts anew."""
        assert from_cursor <= self.cursor, f"told after round {from_cursor}, but knows up to {self.cursor}"
        if from_cursor == -1:
            self.rounds, self.cursor = {}, -1
        places = [(outcome.round, outcome.test_case.origin.index) for outcome in outcomes]
        assert len(set(places)) == len(places), "an outcome is told twice"
        known = frozenset(self.rounds)
        for outcome in outcomes:
            assert from_cursor < outcome.round <= cursor, f"an outcome of round {outcome.round} for cursor {cursor}"
            if outcome.round not in known:
                self.rounds.setdefault(outcome.round, []).append(wire.encode(outcome))
        self.cursor = max(self.cursor, cursor)

    def upto(self, cursor: int, since: int = -1) -> str:
        """A name for all that was told of the rounds after one up to another, order and all."""
        rounds = [number for number in sorted(self.rounds) if since < number <= cursor]
        told = [outcome for number in rounds for outcome in self.rounds[number]]
        return digest(b"".join(told))[:12]


class Mutator:
    """Boxes drawn from the round's stream and everything told so far; some are old ones, some come twice."""

    def __init__(self) -> None:
        self.memory = Memory()
        self.old: list[TestCase] = []

    @property
    def cursor(self) -> int:
        """See `Service.cursor`."""
        return self.memory.cursor

    def do(self, work: MutateWork) -> MutateResult:
        """Propose."""
        if work.from_cursor == -1:
            self.old = []
        self.memory.tell(work.outcomes, work.from_cursor, work.cursor)
        self.old += [outcome.test_case for outcome in work.outcomes]
        rng = derive(work.rng_seed, "boxes", self.memory.upto(work.cursor))
        cases = [self._box(work, index, rng.random(2).tolist()) for index in range(work.count)]
        if rng.random() < 0.2:
            cases = cases[:1]  # no more comes to its mind
        if cases and rng.random() < 0.5:
            cases[-1] = cases[0]
        if len(cases) > 3 and rng.random() < 0.8:
            cases[3] = self._box(work, 3, [_dangerous_places()[int(rng.integers(2))], 0.5])  # what it always thinks of
        if len(cases) > 2 and self.old and rng.random() < 0.5:
            cases[1] = self.old[int(rng.integers(len(self.old)))]
        return MutateResult(round=work.round, test_cases=tuple(cases))

    def _box(self, work: MutateWork, index: int, place: list[float]) -> TestCase:
        box = Obstacle(length_m=5, width_m=4, height_m=20, x_m=round(10 * place[0], 4), y_m=round(9 * place[1], 4))
        origin = Origin(strategy=work.strategy, round=work.round, index=index)
        scenario = msgspec.structs.replace(work.template.scenario, obstacles=(box,))
        stimuli = tuple(
            Stimulus(at_s=float(5 * number), kind="parameter", name=name, values=(float(index),))
            for number, name in enumerate("PQR")
        )
        return msgspec.structs.replace(work.template, scenario=scenario, stimuli=stimuli, origin=origin)


@cache
def _dangerous_places() -> list[float]:
    """The places of an idea, nearest obstacle first."""
    places = [0.01 * step for step in range(60)]
    work = MutateWork(
        round=0,
        count=1,
        strategy="",
        settings={},
        rng_seed=0,
        template=TEMPLATE,
        target=TARGET,
        policies=(),
        outcomes=(),
        from_cursor=-1,
        cursor=-1,
    )
    names = {place: identity(Mutator()._box(work, 3, [place, 0.5])) for place in places}
    tame = [place for place in places if not is_poison(names[place]) and not is_flaky(names[place])]
    return sorted(tame, key=lambda place: luck(names[place]))


class Scorer:
    """The truth, blurred, and swayed by what it was told."""

    def __init__(self) -> None:
        self.memory = Memory()

    @property
    def cursor(self) -> int:
        """See `Service.cursor`."""
        return self.memory.cursor

    def do(self, work: ScoreWork) -> ScoreResult:
        """Score."""
        if work.cursor > self.memory.cursor:
            self.memory.tell(work.recent, work.from_cursor, work.cursor)
        mood = self.memory.upto(work.cursor, work.since)
        scores = []
        for test_case in work.test_cases:
            name = identity(test_case)
            value = min(10.0, max(0.0, 10.0 - 10.0 * luck(name) + 3.0 * (luck(f"{mood} {name}") - 0.5)))
            scores.append(Score(test_case=name, value=value, model=work.model, scored_by=work.model))
            scores.extend(
                Score(test_case=name, value=1.0, model=shadow, scored_by=shadow, shadow=True) for shadow in work.shadow
            )
        return ScoreResult(scores=tuple(scores), usage={work.model: Usage(calls=1, tokens_in=len(scores))})


def babble(work: ScoreWork, rng: np.random.Generator) -> ScoreResult:
    """What a scorer out of its mind returns; none of it may be taken."""
    good = Scorer.do(Scorer(), msgspec.structs.replace(work, recent=(), from_cursor=-1, cursor=-1)).scores
    bad: list[tuple[Score, ...]] = [
        good[1:],
        (*good, good[0]),
        tuple(msgspec.structs.replace(one, value=11.0) for one in good),
        tuple(msgspec.structs.replace(one, value=float("nan")) for one in good),
        tuple(msgspec.structs.replace(one, test_case="0123456789abcdef") for one in good),
        tuple(msgspec.structs.replace(one, model="another") for one in good),
        tuple(msgspec.structs.replace(one, shadow=True) for one in good),
        (),
    ]
    return ScoreResult(scores=bad[int(rng.integers(len(bad)))])


def fly(work: FlyWork, blobs: Blobs) -> FlyResult:
    """Fly a test case; every third one leaves a log, too."""
    name = identity(work.test_case)
    assert work.noise == work.flight_index, "re-flights and none else are flown under noise of their own"
    over_again = work.purpose == "check" and is_untrue(name)
    ending, trace_name, trace = flown(f"{name} again" if over_again else name, work.flight_index)
    flight = Flight(
        test_case=name,
        flight_index=work.flight_index,
        ending=ending,
        simulated_s=60.0,
        wall_s=0.3,
        trace_digest=trace_name,
        trace=blobs.put(trace),
        artefacts=(Artefact(name="log.txt", blob=blobs.put(name.encode())),) if luck(name) < 0.33 else (),
    )
    return FlyResult(flight=flight)


def judge(work: JudgeWork, blobs: Blobs) -> JudgeResult:
    """Violated below 1.5 m."""
    name, index = identity(work.test_case), work.flight.flight_index
    _, trace_name, trace = flown(name, index)
    _check_trace(work, trace_name, trace, blobs)
    distance = 4.0 * luck(name) if not is_flaky(name) else 4.0 * luck(f"{name} {index}")
    verdict = Verdict(
        policy=POLICY,
        outcome="violated" if distance < 1.5 else "held",
        robustness=distance - 1.5,
        severity="soft" if distance < 1.5 else "none",
        behaviour=f"{POLICY}, way {int(WAYS * luck(f'way {name}'))}" if distance < 1.5 else "",
    )
    fingerprint = digest(f"{POLICY} {name}".encode())[:16] if distance < 1.5 else ""
    features = {"min_distance_m": distance}
    track = tuple((float(second), 0.1 * second, 0.2 * second, 10.0) for second in range(track_points))
    return JudgeResult(
        judgement=Judgement(
            test_case=name,
            flight_index=index,
            verdicts=(verdict,),
            fingerprint=fingerprint,
            features=features,
            track=track,
        )
    )


def _check_trace(work: JudgeWork | RecordWork, trace_name: str, trace: bytes, blobs: Blobs) -> None:
    assert work.flight.trace is not None
    found = blobs.get(work.flight.trace)
    assert (work.flight.trace_digest, found) == (trace_name, trace), "the trace of another flight"


def recording(name: str, index: int) -> bytes:
    """Stand in for the recording of a flight."""
    return f"recording of {name} {index}".encode()


def record(work: RecordWork, blobs: Blobs) -> RecordResult:
    """Pretend no more than a recording."""
    name, index = identity(work.test_case), work.flight.flight_index
    _check_trace(work, *flown(name, index)[1:], blobs)
    return RecordResult(test_case=name, flight_index=index, blob=blobs.put(recording(name, index)))


def warm(work: WarmWork) -> WarmResult:
    """Models called broken do not answer."""
    return WarmResult(model=work.model, ready=not work.model.startswith("broken"), message="probed")


class Service:
    """One stage of the farm, which leaves and finds blobs in `blobs`."""

    def __init__(self, blobs: Blobs | None = None) -> None:
        self._mutator, self._scorer = Mutator(), Scorer()
        self._blobs = blobs or MemoryBlobs()

    @property
    def cursor(self) -> int:
        """The round up to which outcomes were told, whichever stage this is."""
        return max(self._mutator.cursor, self._scorer.cursor)

    def cursor_of(self, stage: Stage) -> int:
        """The round up to which one of its stages was told, where it stands for several."""
        return {"mutate": self._mutator.cursor, "score": self._scorer.cursor}.get(stage, -1)

    def do(self, work: Work) -> Result:
        """Do a piece of work as the stage it is for would."""
        match work:
            case MutateWork():
                return self._mutator.do(work)
            case ScoreWork():
                return self._scorer.do(work)
            case FlyWork():
                return fly(work, self._blobs)
            case JudgeWork():
                return judge(work, self._blobs)
            case RecordWork():
                return record(work, self._blobs)
            case WarmWork():
                return warm(work)
