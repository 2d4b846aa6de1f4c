"""A procedure of a policy flown by itself: the flight that is to bring its rule to speak."""

from __future__ import annotations

from saflite.campaign.presets.policy_campaigns import ALL, policy_campaign
from saflite.contract.rng import derive
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.mutator.exposure.drawing import Drawing, Shares
from saflite.mutator.exposure.phases import Script, Tempo
from saflite.mutator.exposure.procedures import Procedure, moves, read_procedures
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.operators.inputs import target_inputs
from saflite.oracle.policy import load_policy

LAST_S, AFTER_S = 500.0, 4.0


class ProcedureFlights:
    """The procedures of all policies that fit a target, and the flights they make."""

    def __init__(self, target: TargetInfo) -> None:
        campaign = policy_campaign(ALL, target)
        assert campaign is not None, "there is one for every target with policies"
        have = target_inputs(target, {})
        texts = campaign.strategy.settings["procedures"]
        self.procedures = read_procedures(texts, campaign.policies, have)  # type: ignore[arg-type]
        """Per policy, in the order of its file."""
        self._target = target.name
        self._rest = {(entry.kind, entry.name): entry.default for entry in target.inputs if entry.default is not None}
        shares = Shares(own=0.75, swarm=0.8, faults=0.15, beyond=0.15)
        self._drawing = Drawing(Vocabulary(have, Taken()), self._rest, shares)

    def by_itself(self, procedure: Procedure, rng_seed: int) -> TestCase:
        """Return the procedure, what it leaves open drawn by the seed, begun where it begins, with its rule's twin."""
        rng = derive(rng_seed, procedure.policy)
        start = StartState(mode="STABILIZE", altitude_m=0.0, armed=False)
        if procedure.height_m is not None:
            start = StartState(mode="LOITER", altitude_m=round(procedure.height_m.draw(rng), 1))
        script = Script(Tempo(first_s=1.0, last_s=LAST_S, settle_s=(1.0, 5.0), rest=self._rest))
        script.follow(rng, moves(rng, procedure, self._drawing))
        scenario = Scenario(start=start, time_limit_s=round(script.at_s + AFTER_S, 1))
        twin = load_policy(procedure.policy).file.twin
        target = Target(name=self._target)
        return TestCase(target=target, scenario=scenario, stimuli=script.stimuli(), rng_seed=rng_seed, twin=twin)
