"""From a selected test case to its end: flights, judgements, re-flights, quarantine."""

from __future__ import annotations

from saflite.campaign.engine.core import Core, RecordingParts
from saflite.campaign.engine.exposure import ARMS_MAX, ArmCounts
from saflite.campaign.engine.journal import Pick
from saflite.campaign.lifecycle.behaviours import Behaviours
from saflite.campaign.lifecycle.confirmation import (
    Broken,
    FlightNote,
    Trial,
    reflights_wanted,
    similar_ones,
    violated_verdicts,
    violations_of,
    worst_robustness,
)
from saflite.campaign.lifecycle.minimization import Minimization, MinimizationCandidate
from saflite.campaign.lifecycle.outcomes import outcome_of, state_of
from saflite.campaign.lifecycle.repeat_checks import RepeatChecks
from saflite.campaign.lifecycle.retention import is_full, keep
from saflite.campaign.scheduling.rounds import Round
from saflite.campaign.scheduling.selection import count_promise
from saflite.campaign.scheduling.tasks import Task, is_enough
from saflite.campaign.scheduling.work_keys import FlightKey, FlyKey, JudgeKey, RecordKey
from saflite.contract import wire
from saflite.contract.events import Flown, Judged, Quarantined, ViolationFound
from saflite.contract.flight import FLOWN_ENDINGS, Ending, Flight
from saflite.contract.test_case import TestCase, identity
from saflite.contract.verdict import Judgement, Verdict, Violation, vacuous
from saflite.contract.work import FlyResult, JudgeResult, TargetBuild
from saflite.flight.novelty import features


class Flights:
    """Flies, judges and re-flies every selected test case until it has ended in one recorded way."""

    def __init__(self, core: Core, minimization: Minimization, checks: RepeatChecks, behaviours: Behaviours) -> None:
        self._core, self._minimization, self._checks, self._behaviours = core, minimization, checks, behaviours

    # ---- beginning -----------------------------------------------------------------------------------------------

    def begin(self, round_: Round, rank: int, pick: Pick) -> None:
        """Take up a selected test case."""
        core = self._core
        test_case = round_.candidates[pick.test_case]
        assert pick.test_case not in core.flown, f"{pick.test_case} is selected twice"
        trial = Trial(test_case, pick.test_case, round_.number, rank, core.confirm.flights)
        trial.wanted_build = test_case.target.build
        trial.score = round_.scores.get(pick.test_case)
        core.flown[trial.name] = trial.round
        core.latest.append(features(test_case))
        if trial.score is not None:
            count_promise(core.promised, trial.score.kind, trial.score.value)
        core.trials[trial.name] = trial
        self._behaviours.expect(trial)
        core.counts.selected += 1
        round_.open_trials += 1
        core.out.row("selected", trial.name, round_.number, rank, pick.selected_by, pick.score, pick.novelty)
        self._fly(trial, 0)

    def fly_smallest(self, candidate: MinimizationCandidate) -> None:
        """Fly the smallest form of a violation as a test case of its own, if it is one and was not flown already."""
        self._fly_form(candidate.trial, candidate.violation, candidate.minimizer.forms)

    def _fly_larger(self, trial: Trial) -> None:
        """Fly a form half the way back to the original where a smallest form was not confirmed.

        The last of many smaller test cases tried is the likeliest to have violated by luck. Halving keeps the flights
        this takes logarithmic in the steps.
        """
        forms = trial.larger_forms
        if trial.shrunk_from is not None:
            self._fly_form(trial, trial.shrunk_from, forms[: (len(forms) + 1) // 2])

    def _fly_form(self, like: Trial, larger: Violation, forms: tuple[TestCase, ...]) -> None:
        core = self._core
        if not forms or core.was_flown(identity(forms[-1])):
            return
        test_case, name = forms[-1], identity(forms[-1])
        core.shrunk.add(name)
        trial = Trial(test_case, name, like.round, like.rank, max(1, core.confirm.flights))
        trial.shrunk_from, trial.larger_forms, trial.wanted_build = larger, forms[:-1], like.build
        core.forms[name] = trial
        origin = test_case.origin
        content = wire.encode(test_case)
        core.out.row("test_cases", name, trial.round, -1, origin.strategy, origin.parent, None, content)
        self._fly(trial, 0)

    def _fly(self, trial: Trial, index: int) -> None:
        avoid = frozenset(note.flight.worker for note in trial.flights.values())
        order = (trial.round, trial.rank, index, 0)
        target = TargetBuild(trial.test_case.target.name, trial.build)
        self._core.tasks.add(Task(trial.fly_key(index), order, target=target, avoid=avoid))

    def test_case(self, key: FlightKey) -> TestCase:
        """Return the test case of a flight under way."""
        return self._trial(key).test_case

    def flight(self, key: JudgeKey) -> Flight:
        """Return the flight to be judged."""
        return self._trial(key).flights[key.index].flight

    # ---- flown ---------------------------------------------------------------------------------------------------

    def on_flown(self, task: Task, key: FlyKey, result: FlyResult) -> None:
        """Take the record of a flight."""
        flight = result.flight
        if flight.ending in FLOWN_ENDINGS:
            self._take(task, key, flight)
        elif flight.ending == "infra":
            self.on_failure(task, key, flight.message)
        else:
            self.on_lost(task, key, flight.message, flight.ending)

    def on_nobody(self, task: Task, key: FlightKey, message: str) -> None:
        """Nobody is there who could fly it."""
        self._core.fault(str(key), message)
        self._set_aside(task, key, "infra", message)

    def on_failure(self, task: Task, key: FlightKey, message: str) -> None:
        """Our side could not fly or judge: elsewhere again, set aside in the end."""
        task.failures += 1
        self._try_again(task, key, "infra", message)

    def on_lost(self, task: Task, key: FlightKey, message: str, ending: Ending = "lost") -> None:
        """The worker vanished with the work, or the flight came to no end in time."""
        task.losses += 1
        self._try_again(task, key, ending, message)

    def _try_again(self, task: Task, key: FlightKey, ending: Ending, message: str) -> None:
        self._core.fault(str(key), f"{ending}: {message}" if message else ending)
        if is_enough(task, self._core.campaign.lease):
            self._set_aside(task, key, ending, message)
        else:
            self._core.again(task, ending, message)

    def _take(self, task: Task, key: FlyKey, flight: Flight) -> None:
        core, trial = self._core, self._trial(key)
        assert flight.flight_index == key.index, f"{key} is not flight {flight.flight_index}"
        core.done(task, flight.ending, flight.message)
        self._note(trial, flight)
        core.hold(*flight.blobs)
        core.tasks.add(Task(key.judging, (trial.round, trial.rank, key.index, 1)))
        if key.index == 0:
            self._checks.offer(trial, flight)
            return
        first = trial.flights.get(trial.first)
        assert first is not None, f"{trial.name}: a re-flight ended before the first flight"
        assert first.flight.build == flight.build, f"{key} is on another build than the first flight"

    def _note(self, trial: Trial, flight: Flight) -> FlightNote:
        core, index = self._core, flight.flight_index
        assert index not in trial.flights, f"{trial.name} flight {index} is counted twice"
        note = trial.flights[index] = FlightNote(flight)
        self._charge(trial, index, 1)
        core.counts.simulated_s += flight.simulated_s
        core.counts.wall_s += flight.wall_s
        purpose = trial.purpose_of(index)
        core.note_flight(flight, purpose)
        core.tell(
            Flown(
                test_case=trial.name,
                flight_index=index,
                ending=flight.ending,
                simulated_s=flight.simulated_s,
                wall_s=flight.wall_s,
                worker=flight.worker,
                purpose=purpose,
                build=flight.build,
            )
        )
        return note

    def _charge(self, trial: Trial, index: int, sign: int) -> None:
        counts = self._core.counts
        if not trial.is_selected:
            counts.shrink_flights += sign
            return
        if index:
            counts.reflown += sign
            return
        counts.flights += sign
        self._core.rounds.under_way[trial.round].cost += sign

    def on_trace_missing(self, task: Task, key: JudgeKey, message: str) -> None:
        """Fly a flight again whose trace was lost before it was judged; set it aside where that goes on."""
        core, trial, index = self._core, self._trial(key), key.index
        core.fault(str(task.key), message)
        note = trial.flights.pop(index)
        self._charge(trial, index, -1)
        core.counts.simulated_s -= note.flight.simulated_s
        core.counts.wall_s -= note.flight.wall_s
        core.let_go(*note.flight.blobs)
        trial.traces_lost[index] += 1
        if trial.traces_lost[index] < core.campaign.lease.attempts_max:
            core.done(task, "trace_missing", message)
            self._fly(trial, index)
        else:
            task.losses = trial.traces_lost[index]
            self._set_aside(task, key.flying, "infra", f"its trace was lost {task.losses} times: {message}")

    # ---- judged --------------------------------------------------------------------------------------------------

    def on_judged(self, task: Task, key: JudgeKey, result: JudgeResult) -> None:
        """Take the verdicts on a flight; a violated one is flown again."""
        core, trial, judgement = self._core, self._trial(key), result.judgement
        core.done(task, "judged")
        note = trial.flights[judgement.flight_index]
        note.judged = True
        bad = violated_verdicts(judgement)
        note.violated = {verdict.policy: Broken(verdict.margin, verdict.severity == "hard") for verdict in bad}
        self._tell_judged(trial, judgement, bad)
        if key.index != trial.first:
            if not (bad or core.campaign.record == "all"):
                core.let_go(*note.flight.blobs)
            self._confirm(trial)
            return
        trial.judgement = judgement
        if self._may_still_show(trial, note):
            core.let_go(*note.flight.blobs)
            trial.first += 1
            self._fly(trial, trial.first)
        elif not bad:
            self._held(trial, note)
        elif trial.is_selected:
            trial.waiting = True
        else:
            self._confirm(trial)

    def settle(self) -> None:
        """Re-fly the finds that stand for their behaviours, and end those of behaviours that others have confirmed."""
        while decided := self._behaviours.decided():
            for trial, stands in decided:
                if stands:
                    self._confirm(trial)
                else:
                    self._similar(trial)

    def _confirm(self, trial: Trial) -> None:
        """Fly a test case again, no more often than it takes, until its violations are decided."""
        if not trial.reflown_all:
            return
        wanted = reflights_wanted(trial, self._core.confirm.needed)
        trial.asked += wanted
        for index in trial.reflights[trial.asked - wanted :]:
            self._fly(trial, index)
        if not wanted:
            self._confirmed(trial)

    def _similar(self, trial: Trial) -> None:
        note = trial.flights[trial.first]
        for violation in similar_ones(trial, self._behaviours.representatives):
            self._announce(trial, violation)
        self._record_if_all(trial, note)
        self._end(trial, note.flight.ending, "similar")

    def _may_still_show(self, trial: Trial, note: FlightNote) -> bool:
        """Whether a smallest form, known to violate by chance, may show so in another flight after one that held."""
        rule, larger = self._core.confirm, trial.shrunk_from
        if larger is None or larger.policy in note.violated:
            return False
        return rule.repeats == "statistically" and trial.first + 1 < rule.flights

    def _tell_judged(self, trial: Trial, judgement: Judgement, bad: list[Verdict]) -> None:
        robustness = worst_robustness(judgement)
        policies = tuple(verdict.policy for verdict in bad)
        self._core.tell(
            Judged(
                test_case=judgement.test_case,
                flight_index=judgement.flight_index,
                robustness=robustness,
                violated=policies,
                vacuous=vacuous(judgement),
            )
        )
        line, key = self._core.out.line_count, (judgement.test_case, judgement.flight_index)
        if self._core.stands(trial):
            self._core.out.row("judgements", *key, robustness, ",".join(policies), line)

    def _held(self, trial: Trial, note: FlightNote) -> None:
        self._record_if_all(trial, note)
        assert trial.judgement is not None, f"{trial.name} was not judged"
        self._end(trial, note.flight.ending, state_of(trial.judgement))

    def _confirmed(self, trial: Trial) -> None:
        """Give the violations of a test case their confirmation."""
        core, first = self._core, trial.flights[trial.first]
        found = violations_of(trial, core.confirm)
        trial.stood = frozenset(one.policy for one in found if one.confirmation == "confirmed")
        if any(not self._behaviours.has_stood(policy) for policy in trial.stood):
            self._checks.prove(trial)
        for violation in found:
            self._announce(trial, violation)
        if keep(core, trial) and core.campaign.record != "none":
            self._record(trial, found[0] if found else None)
        self._end(trial, first.flight.ending, found[0].confirmation if found else "held")
        for violation in found if trial.is_selected else ():
            if violation.confirmation == "confirmed" and self._behaviours.represents(violation):
                is_first = self._behaviours.is_first(violation)
                leads = self._behaviours.leads(trial, violation.policy)
                self._minimization.begin(trial, violation, is_first=is_first, leads=leads)

    def _announce(self, trial: Trial, violation: Violation) -> None:
        core = self._core
        if not trial.is_selected:
            pass  # counted when it was found
        elif violation.confirmation == "confirmed":
            core.counts.confirmed += 1
            core.counts.last_find_s = core.elapsed_s(core.at_s)
        elif violation.confirmation == "flaky":
            core.counts.flaky += 1
        elif violation.confirmation == "similar":
            core.counts.similar += 1
        else:
            core.counts.unconfirmed += 1
        core.tell(ViolationFound(violation=violation))
        key = (violation.fingerprint, violation.test_case, violation.policy)
        told = violation.confirmation, violation.robustness, violation.severity
        if core.stands(trial):
            core.out.row("violations", *key, *told, core.out.seq)

    def _record_if_all(self, trial: Trial, note: FlightNote) -> None:
        """Record a flight that shows no violation of its own where the campaign records all; else let go of it."""
        core = self._core
        if core.campaign.record == "all" and not is_full(core):
            core.flush(*note.flight.blobs)
            self._record(trial, None)
        else:
            core.let_go(*note.flight.blobs)

    def _record(self, trial: Trial, violation: Violation | None) -> None:
        core, first = self._core, trial.flights[trial.first]
        assert trial.judgement is not None, f"{trial.name} was not judged"
        scores = () if trial.score is None else (trial.score,)
        key = RecordKey(trial.name, trial.purpose_of(trial.first), trial.first)
        core.records[key] = RecordingParts(trial.test_case, first.flight, trial.judgement, violation, scores)
        core.tasks.add(Task(key, (trial.round, trial.rank, 0, 2)))

    # ---- the end -------------------------------------------------------------------------------------------------

    def _set_aside(self, task: Task, key: FlightKey, ending: Ending, message: str) -> None:
        """Give up on a flight: the end of the test case if it was its first, otherwise one re-flight less."""
        core, trial, index = self._core, self._trial(key), key.index
        attempts = task.losses + task.failures
        worker = task.worker
        core.done(task, ending, message)
        if isinstance(key, FlyKey):
            note = self._note(
                trial, Flight(test_case=trial.name, flight_index=index, ending=ending, worker=worker, message=message)
            )
        else:
            note = trial.flights[index]
            core.let_go(*note.flight.blobs)
        note.given_up = True
        if index != trial.first:
            self._confirm(trial)
            return
        if trial.is_selected:
            core.counts.quarantined += 1
            core.tell(Quarantined(test_case=trial.name, attempts=attempts, last=ending, message=message))
        self._end(trial, ending, "quarantined")

    def _end(self, trial: Trial, ending: Ending, state: str) -> None:
        core = self._core
        del (core.trials if trial.is_selected else core.forms)[trial.name]
        if core.stands(trial):
            core.out.row("endings", trial.name, state, ending, len(trial.flights))
        if not trial.is_selected:
            if state != "confirmed":
                self._fly_larger(trial)
            return
        core.counts.ended += 1
        if trial.judgement is not None:
            core.exposure.add(trial.test_case, trial.judgement)
        arm = trial.test_case.origin.arm
        if arm and (arm in core.arms or len(core.arms) < ARMS_MAX):
            core.arms.setdefault(arm, ArmCounts()).add(trial.founded)
        round_ = core.rounds.under_way[trial.round]
        ways = tuple(sorted(trial.behaviours.values()))
        outcome = outcome_of(trial.test_case, trial.round, ending, trial.judgement, ways, trial.founded)
        round_.outcomes[trial.rank] = outcome
        core.out.row(
            "outcomes", trial.round, trial.rank, trial.name, ending, trial.first, ",".join(ways), trial.founded
        )
        self._behaviours.ended(trial)
        for policy in trial.behaviours.keys() - trial.stood:
            if self._behaviours.leads(trial, policy):
                self._minimization.lead(policy, None)
        round_.open_trials -= 1
        if round_.open_trials == 0:
            core.rounds.close(trial.round)

    def _trial(self, key: FlightKey) -> Trial:
        return self._core.trial_of(key)
