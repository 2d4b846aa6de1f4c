"""Hands the oracle's policies to the scorer pool: words, signals and inputs, without the slices knowing one another."""

from __future__ import annotations

from saflite.oracle.policy import Inputs, load_policy
from saflite.scorer_pool.model import PolicyBrief


def policy_brief(name: str) -> PolicyBrief:
    """Return what a scorer is told of a policy; raises Refused for an unknown one."""
    policy = load_policy(name)
    file = policy.file
    return PolicyBrief(
        name=file.id,
        words=" ".join(file.words.split()),
        signals=tuple(sorted(policy.signals)),
        show=file.state,
        inputs=_inputs(file.inputs),
    )


def _inputs(inputs: Inputs) -> tuple[str, ...]:
    return (*inputs.parameters, *inputs.commands, *inputs.sticks, *inputs.modes, *inputs.sensor_faults)
