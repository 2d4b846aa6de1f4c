"""Procedures of all rules, and drawn missions, flown with something more given in between, no defect planted.

What a rule's own hand did not think of: any input of the target at any time, half of them close to a step of the
procedure's own, where a rule counts from.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import msgspec
import numpy as np

from saflite.campaign.presets.campaigns import template
from saflite.campaign.presets.policy_campaigns import ALL, policy_campaign
from saflite.conformance.procedures import ProcedureFlights
from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Stimulus, TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.drawing import Drawing, Shares
from saflite.mutator.exposure.scenarios import scenarios_of
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.operators.inputs import Input, target_inputs

Rng = np.random.Generator
MISSIONS = 0.2  # of all flights
MOST = 3
NEAR_S = (-0.05, 0.02, 0.1, 0.5)  # from a step of the procedure's own
MISSION_LAST_S, AFTER_S = 90.0, 2.0


def disturbed(rng_seed: int, names: str = "") -> Iterator[tuple[str, TestCase]]:
    """Yield test cases without end, each with the rule or mission it is of.

    `names` is a pattern that the name of each input holds which is given in between; raises Refused where none does.
    """
    target = describe()
    have = target_inputs(target, {})
    kinds = _by_kind([entry for entry in have.values() if re.search(names, entry.name)])
    if not kinds:
        raise Refused("inputs", expected="a pattern that the name of an input of the reference holds", got=repr(names))
    rest = {(entry.kind, entry.name): entry.default for entry in target.inputs if entry.default is not None}
    drawing = Drawing(Vocabulary(have, Taken()), rest, Shares(own=0.75, swarm=0.8, faults=0.15, beyond=0.15))
    flights = ProcedureFlights(target)
    every = [one for _, known in sorted(flights.procedures.items()) for one in known]
    campaign = policy_campaign(ALL, target)
    assert campaign is not None, "there is one for the reference"
    usual = template(campaign)
    missions = scenarios_of(usual.scenario, target)
    number = 0
    while True:
        rng = derive(rng_seed, "disturbed", number)
        if rng.random() < MISSIONS:
            case, what = msgspec.structs.replace(usual, scenario=missions.mission(rng), rng_seed=number), "mission"
        else:
            procedure = every[int(rng.integers(len(every)))]
            case, what = flights.by_itself(procedure, int(rng.integers(1_000_000))), procedure.policy
        more = [_one(rng, kinds, drawing, case) for _ in range(int(rng.integers(1, MOST + 1)))]
        stimuli = tuple(sorted((*case.stimuli, *more), key=lambda one: one.at_s))
        yield what, msgspec.structs.replace(case, stimuli=stimuli, twin="")
        number += 1


def _by_kind(entries: list[Input]) -> list[list[Input]]:
    return [[one for one in entries if one.kind == kind] for kind in sorted({one.kind for one in entries})]


def _one(rng: Rng, kinds: list[list[Input]], drawing: Drawing, case: TestCase) -> Stimulus:
    entries = kinds[int(rng.integers(len(kinds)))]
    given = drawing.given(rng, entries[int(rng.integers(len(entries)))])
    own = [one.at_s for one in case.stimuli]
    if own and rng.random() < 0.5:
        at_s = own[int(rng.integers(len(own)))] + NEAR_S[int(rng.integers(len(NEAR_S)))]
    else:
        at_s = float(rng.uniform(0.5, max(own, default=MISSION_LAST_S) + AFTER_S))
    return msgspec.structs.replace(given, at_s=round(max(0.1, at_s), 2))
