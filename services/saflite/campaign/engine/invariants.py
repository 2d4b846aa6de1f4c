"""The invariants of the books. Each names what would be lost or counted twice if it broke."""

from __future__ import annotations

from saflite.campaign.engine.core import Core
from saflite.campaign.scheduling.leases import Leases
from saflite.campaign.scheduling.work_keys import FlyKey, JudgeKey, RecordKey
from saflite.contract.flight import UNTOLD


def validate(core: Core, leases: Leases) -> None:
    """Assert that the state is one the books can be in."""
    core.tasks.validate()
    _leases_have_deadlines(core, leases)
    _budget_holds(core)
    _every_trial_goes_on(core)
    _repeats_are_on_one_build(core)
    _traces_are_held(core)
    _counts_agree(core)


def _leases_have_deadlines(core: Core, leases: Leases) -> None:
    leased = core.tasks.leased()
    for task in leased:
        deadline = leases.deadline(task.key)
        assert deadline is not None, f"{task.key} is lent for ever"
        assert (deadline.epoch, deadline.worker) == (task.epoch, task.worker), (
            f"{task.key}: deadline of another attempt"
        )
    assert len(leases) == len(leased), "a deadline without a lease"


def _budget_holds(core: Core) -> None:
    most = core.counts.flights + core.rounds.outstanding()
    assert most <= core.rounds.budget, f"up to {most} flights with a budget of {core.rounds.budget}"


def _every_trial_goes_on(core: Core) -> None:
    for trial in core.all_trials():
        flights = [trial.fly_key(index) for index in (trial.first, *trial.reflights)]
        assert trial.waiting or any(core.tasks.get(key) or core.tasks.get(key.judging) for key in flights), (
            f"{trial.name} has not ended, and nothing is to be done for it"
        )
    for key in (task.key for task in core.tasks):
        if isinstance(key, FlyKey | JudgeKey) and key.purpose not in UNTOLD:
            under_way = core.forms if key.purpose == "shrunk" else core.trials
            assert key.test_case in under_way, f"{key} is to be done for a test case that has ended"
            purpose = under_way[key.test_case].purpose_of(key.index)
            assert key.purpose == purpose, f"{key} has another purpose than its test case"
    searched = list(core.trials.values())
    assert all(trial.is_selected for trial in searched), "a smallest form counts as selected"
    assert not any(trial.is_selected for trial in core.forms.values()), "a selected test case counts as a smallest form"
    first = min(searched, key=lambda trial: (trial.round, trial.rank), default=None)
    assert first is None or not first.waiting, f"{first and first.name} waits for nobody"
    for number, round_ in core.rounds.under_way.items():
        open_trials = sum(1 for trial in searched if trial.round == number)
        assert round_.open_trials == open_trials, f"round {number}: {round_.open_trials} open, {open_trials} counted"
        assert round_.phase != "flying" or open_trials, f"round {number} flies nothing and is not closed"
        assert set(round_.scores) <= set(round_.candidates), f"round {number}: scores of unknown test cases"


def _repeats_are_on_one_build(core: Core) -> None:
    """A re-flight on another build repeats nothing."""
    for trial in core.all_trials():
        builds = {note.flight.build for note in trial.flights.values() if note.judged or not note.settled}
        assert len(builds) <= 1, f"{trial.name} is confirmed by flights on several builds: {sorted(builds)}"


def _traces_are_held(core: Core) -> None:
    assert all(hold.times > 0 for hold in core.holds.values()), "a blob is held by nobody"
    for trial in core.all_trials():
        for note in trial.flights.values():
            held = all(blob.digest in core.holds for blob in note.flight.blobs)
            assert note.settled or held, f"{trial.name}: a trace to be judged was dropped"
    for parts in core.records.values():
        held = all(blob.digest in core.holds for blob in parts.flight.blobs)
        assert held, f"{parts.flight.test_case}: a trace to be recorded was dropped"


def _counts_agree(core: Core) -> None:
    counts = core.counts
    assert counts.selected == counts.ended + len(core.trials), "a selected test case neither flies nor has ended"
    assert counts.selected == len(core.flown), "selected test cases and those known as flown differ"
    assert set(core.records) == {task.key for task in core.tasks if isinstance(task.key, RecordKey)}, (
        "recordings do not add up"
    )
