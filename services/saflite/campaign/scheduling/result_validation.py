"""Does a result fit the work it claims to answer? Checked before anything is counted."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import msgspec

from saflite.campaign.engine.core import Core
from saflite.campaign.scheduling.proposal_check import unfit
from saflite.campaign.scheduling.tasks import Task
from saflite.campaign.scheduling.work_keys import FlightKey, FlyKey, JudgeKey, MutateKey, RecordKey, ScoreKey, WarmKey
from saflite.contract import wire
from saflite.contract.blobs import BLOBS_PER_RESULT_MAX, RESULT_BYTES_MAX
from saflite.contract.bounds import told
from saflite.contract.errors import Refused
from saflite.contract.flight import AUTOPILOT_ALIVE, FLOWN_ENDINGS, Flight
from saflite.contract.score import SCORE_MAX, SCORE_MIN
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Verdict
from saflite.contract.work import (
    Failure,
    FlyResult,
    HandedBack,
    JudgeResult,
    MutateResult,
    RecordResult,
    Result,
    ScoreResult,
    WarmResult,
    blobs_left,
)

SAID_MAX = 500  # characters of what a result says, in our words
JUDGEMENT_BYTES_MAX = 2**20
FLIGHT_BYTES_MAX = SCORES_BYTES_MAX = 2**22
WATCHING_MAX = 101  # as many as work may name, and the embedded scorer


def check_result(
    core: Core, task: Task, result: Result, damage: str, test_case_of: Callable[[FlightKey], TestCase]
) -> None:
    """Raise Refused if the result is of another kind, for another test case, or says what cannot be.

    Args:
        core: what the books know.
        task: the work that it answers.
        result: what was handed in.
        damage: in words, how the blobs it names are not those that were left; empty where they are.
        test_case_of: tells what is flown or judged.
    """
    match task.key, result:
        case _, Failure() | HandedBack():
            pass
        case _ if damage:
            _refuse(task, "blobs that are there and whole", damage)
        case MutateKey(), MutateResult():
            _same(task, "round", task.key.round, result.round)
            _check_mutants(core, task, result)
        case ScoreKey(), ScoreResult():
            _check_scores(task, result, core.rounds.under_way[task.key.round].batches[task.key.batch])
        case WarmKey(), WarmResult():
            _same(task, "model", task.key.model, result.model)
        case FlyKey(), FlyResult():
            _same_flight(task, task.key, result.flight.test_case, result.flight.flight_index)
            _check_flight(task, result)
            _check_build(task, task.key, result.flight)
            given = [one.index for one in result.flight.delivered or ()]
            _check_places(task, "delivered stimuli", given, test_case_of(task.key))
        case JudgeKey(), JudgeResult():
            _same_flight(task, task.key, result.judgement.test_case, result.judgement.flight_index)
            _check_verdicts(core, task, result)
            named = [place for step in result.judgement.transitions for place in (step.stimulus, step.preceding)]
            _check_places(task, "steps after stimuli", named, test_case_of(task.key))
        case RecordKey(), RecordResult():
            _same_flight(task, task.key, result.test_case, result.flight_index)
        case _:
            _refuse(task, f"a result of {task.stage}", type(result).__name__)


def _same_flight(task: Task, key: FlightKey | RecordKey, test_case: str, flight_index: int) -> None:
    _same(task, "test case and flight index", (key.test_case, key.index), (test_case, flight_index))


def _check_verdicts(core: Core, task: Task, result: JudgeResult) -> None:
    """One verdict on each policy, and at most one that the autopilot died: finds are told apart by their policy."""
    verdicts = result.judgement.verdicts
    judged = [verdict.policy for verdict in verdicts]
    beside = {AUTOPILOT_ALIVE}.intersection(judged).difference(core.campaign.policies)
    _same(task, "policies", sorted([*core.campaign.policies, *beside]), sorted(judged))
    for verdict in verdicts:
        _check_verdict(task, verdict)
    _check_size(task, "a judgement", (result.judgement,), JUDGEMENT_BYTES_MAX)


def _check_mutants(core: Core, task: Task, result: MutateResult) -> None:
    most, batch = core.rounds.search.candidates_per_round, core.campaign.scorer.batch
    why = unfit(result.test_cases, core.template, most, batch)
    if why is not None:
        _refuse(task, why.expected, why.got)


def _check_size(task: Task, what: str, parts: Sequence[msgspec.Struct], bytes_max: int) -> None:
    """What is told to others must stay far below what a message may hold: none could read it."""
    size_bytes = sum(len(wire.encode(part)) for part in parts)
    if size_bytes > bytes_max:
        _refuse(task, f"{what} of at most {bytes_max} bytes", size_bytes)


def _check_scores(task: Task, result: ScoreResult, names: tuple[str, ...]) -> None:
    deciding = [score for score in result.scores if not score.shadow]
    _same(task, "deciding scores, one for each test case asked", sorted(names), sorted(s.test_case for s in deciding))
    _check_beside(task, result, set(names))
    _check_size(task, "scores", (result,), SCORES_BYTES_MAX)
    for score in result.scores:
        if not (math.isfinite(score.value) and SCORE_MIN <= score.value <= SCORE_MAX):
            _refuse(task, f"scores from {SCORE_MIN:g} to {SCORE_MAX:g}", score.value)
        if not score.shadow and score.model != task.model:
            _refuse(task, f"deciding scores of {task.model}", score.model)


def _check_beside(task: Task, result: ScoreResult, asked: set[str]) -> None:
    """Scores that only watch are rows, too: one for each test case asked and model, of as many models as may watch.

    Which these are may have changed since the work was given.
    """
    beside = [(score.test_case, score.model) for score in result.scores if score.shadow]
    models = {model for _, model in beside}
    if len(models) > WATCHING_MAX or len(set(beside)) < len(beside) or any(name not in asked for name, _ in beside):
        _refuse(task, f"one score of each of at most {WATCHING_MAX} models beside for a test case asked", len(beside))
    others = sorted(set(result.usage) - models - {task.model})
    if others:
        _refuse(task, "the usage of models that gave scores", f"that of {len(others)} others")


def _check_flight(task: Task, result: FlyResult) -> None:
    flight = result.flight
    _check_size(task, "a flight", (flight,), FLIGHT_BYTES_MAX)
    if flight.simulated_s < 0 or not math.isfinite(flight.simulated_s) or not math.isfinite(flight.wall_s):
        _refuse(task, "finite times", (flight.simulated_s, flight.wall_s))
    delivered = flight.delivered or ()
    if len({one.index for one in delivered}) < len(delivered):
        _refuse(task, "each stimulus delivered once", [one.index for one in delivered])
    if not all(math.isfinite(one.at_s) and one.index >= 0 for one in delivered):
        _refuse(task, "delivered stimuli with a place and a finite time", [(one.index, one.at_s) for one in delivered])
    if bool(flight.trace_digest) != (flight.trace is not None):
        _refuse(task, "a trace together with its digest", f"{flight.trace}, digest {flight.trace_digest!r}")
    if excess := too_much_left(result):
        _refuse(task, f"at most {BLOBS_PER_RESULT_MAX} blobs of {RESULT_BYTES_MAX} bytes together", excess)


def _check_places(task: Task, what: str, places: Sequence[int], test_case: TestCase) -> None:
    """Who reads of a stimulus that the test case has not can tell nothing of the flight, nor of the run it is in."""
    if max(places, default=-1) >= (count := len(test_case.stimuli)):
        _refuse(task, f"{what} of the {count} there are", max(places))


def too_much_left(result: Result) -> str:
    """Return in words by how much the blobs a result names are more than it may name, empty if they are not."""
    blobs = blobs_left(result)
    size_bytes = sum(blob.size_bytes for blob in blobs)
    is_much = len(blobs) > BLOBS_PER_RESULT_MAX or size_bytes > RESULT_BYTES_MAX
    return f"{len(blobs)} of {size_bytes} bytes" if is_much else ""


def _check_verdict(task: Task, verdict: Verdict) -> None:
    """Only what held or was violated has a robustness, and its sign says which."""
    robustness, told = verdict.robustness, f"{verdict.policy} {verdict.outcome}, robustness {verdict.robustness}"
    if (robustness is not None) != (verdict.outcome in ("held", "violated")):
        _refuse(task, "a robustness exactly of what held or was violated", told)
    if robustness is not None and not (
        math.isfinite(robustness) and (robustness < 0) == (verdict.outcome == "violated")
    ):
        _refuse(task, "a finite robustness, negative exactly of what was violated", told)
    if not 0.0 <= verdict.nearness <= 1.0:
        _refuse(task, "a nearness from 0 to 1", f"{verdict.policy} {verdict.nearness}")


def _check_build(task: Task, key: FlyKey, flight: Flight) -> None:
    """A first flight is on the build its test case names, if it names any; all others on the build of the first.

    So is the smallest form of a find, whichever of its flights is the first to show the violation.
    """
    wanted = task.target.build if task.target else ""
    if flight.ending in FLOWN_ENDINGS and flight.build != wanted and (wanted or key.purpose != "search"):
        _refuse(task, f"a flight on build {wanted or 'unknown'!r}", flight.build or "unknown")


def _same(task: Task, what: str, expected: object, got: object) -> None:
    if expected != got:
        _refuse(task, f"{what} {expected}", got)


def _refuse(task: Task, expected: str, got: object) -> None:
    raise Refused(f"result for {task.key}", expected=told(expected, SAID_MAX), got=told(f"{got}", SAID_MAX))
