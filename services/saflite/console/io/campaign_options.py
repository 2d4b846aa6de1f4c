"""What the command line changes in a campaign file."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from saflite.console.io.target_options import with_settings
from saflite.contract.bounds import COUNT_MAX
from saflite.contract.config import Campaign, StrategyConfig, check_campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import AUTOPILOT_ALIVE
from saflite.contract.outside import assignment
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Settings
from saflite.contract.work import PolicyTexts

WORKERS_MAX = 1_000  # of a farm at a time (`campaign/engine/worker_registry.py`)


def at_least(name: str, number: float, least: float, most: float = COUNT_MAX) -> None:
    """Raise Refused if a number of the command line is too small, or larger than anybody means."""
    if not number >= least:
        raise Refused(name, expected=f"{least:g} or more", got=number)
    if number > most:
        raise Refused(name, expected=f"at most {most:g}", got=number if number < COUNT_MAX else "a larger number")


def seconds_of(minutes: float | None) -> float | None:
    """Return what `--minutes` says in seconds; raises Refused if it is too little to do anything."""
    if minutes is None:
        return None
    at_least("--minutes", minutes, 0.01)
    return 60.0 * minutes


def changed(
    campaign: Campaign,
    *,
    rng_seed: int | None = None,
    budget: int | None = None,
    strategy: str = "",
    settings: Sequence[str] = (),
    scorer: str = "",
    shadow: Sequence[str] = (),
    target_settings: Sequence[str] = (),
    defects: Sequence[str] = (),
) -> Campaign:
    """Return the campaign with the changes given; raises Refused for unknown strategies, scorers and settings.

    A strategy other than the campaign's starts from its own defaults; a portfolio hands the campaign's settings on to
    its arms if the campaign's strategy is one of them.
    """
    from saflite.mutator.registry import load_strategy
    from saflite.scorer_pool.registry import check_label
    from saflite.simulator_worker.registry import describe_target

    own = dict(assignment("--set", text) for text in settings)
    found = _chosen(campaign.strategy, strategy or campaign.strategy.name, own)
    models = msgspec.structs.replace(
        campaign.scorer, model=scorer or campaign.scorer.model, shadow=tuple(shadow) or campaign.scorer.shadow
    )
    target = campaign.target
    if target_settings or defects:
        target = with_settings(target, describe_target(target.name), target_settings, defects)
    new = msgspec.structs.replace(
        campaign,
        strategy=found,
        scorer=models,
        target=target,
        rng_seed=campaign.rng_seed if rng_seed is None else rng_seed,
        budget_flights=campaign.budget_flights if budget is None else budget,
    )
    load_strategy(new.strategy.name)
    for label in (new.scorer.model, *new.scorer.shadow):
        check_label(label)
    check_campaign(new, "command line")
    return new


def _chosen(old: StrategyConfig, name: str, own: Settings) -> StrategyConfig:
    from saflite.mutator.strategies import portfolio

    if name == old.name:
        return StrategyConfig(name=name, settings={**old.settings, **own})
    if name != portfolio.NAME or not portfolio.may_be_arm(old.name, own):
        return StrategyConfig(name=name, settings=own)
    typed = own.get("given", [])
    given = [*portfolio.given_of(old.settings), *typed] if isinstance(typed, list) else typed
    return StrategyConfig(name=name, settings={**own, "given": given})


def remarks(campaign: Campaign) -> list[str]:
    """Return what a campaign may be started with but its user may not have meant."""
    from saflite.simulator_worker.registry import describe_target

    known = describe_target(campaign.target.name).settings
    chosen = [
        (name, str(part))
        for name, value in campaign.target.settings.items()
        for part in (value if isinstance(value, list) else [value])
    ]
    broken = [(name, part, known[name].breaks.get(part, AUTOPILOT_ALIVE)) for name, part in chosen if name in known]
    return [
        f"note: {name} {part} breaks {policy}, which this campaign does not check"
        for name, part, policy in broken
        if policy not in (*campaign.policies, AUTOPILOT_ALIVE)
    ]


def load(name_or_path: str, target: str = "") -> Campaign:
    """Return a campaign by name or file, put on `target` if one is named; see `load_campaign` and `told`.

    Warns of what the plan it names says that is not flown.
    """
    from saflite.campaign.presets.campaigns import load_campaign
    from saflite.campaign.presets.policy_campaigns import told
    from saflite.console.io.cases import warn_of_plan
    from saflite.flight.mission import find_mission
    from saflite.simulator_worker.registry import describe_target

    campaign = load_campaign(name_or_path, describe_target(target) if target else None)
    if campaign.mission.endswith(".plan"):
        warn_of_plan(find_mission(campaign.mission), campaign.mission)
    if target:
        campaign = msgspec.structs.replace(campaign, target=msgspec.structs.replace(campaign.target, name=target))
    return told(campaign, describe_target(campaign.target.name))


def check_runnable(campaign: Campaign) -> None:
    """Raise Refused now for what a worker would refuse later: policies, target, mission, strategy settings."""
    from saflite.campaign.presets.campaigns import template
    from saflite.contract.outside_code import of_outside
    from saflite.mutator import registry as strategy_registry
    from saflite.simulator_worker import registry as target_registry

    base, target = template(campaign), target_registry.describe_target(campaign.target.name)
    if target.missing:
        raise Unavailable(target.missing)  # a target without its binary writes fewer signals than policies need
    for name in campaign.policies:
        _check_policy(name, campaign, target)
    name = campaign.target.name
    with of_outside("target", name, outside=target_registry.is_outside(name)):
        target_registry.load_target(name).check(base)  # says first what is missing here
    name = campaign.strategy.name
    with of_outside("strategy", name, outside=strategy_registry.is_outside(name)):
        strategy_registry.load_strategy(name)(base, campaign.strategy.settings, campaign.policies, target)


def check_policies(names: Sequence[str], texts: PolicyTexts | None = None) -> None:
    """Raise Refused for a policy that there is not, or in whose file something is wrong: who only wants to know what it
    is about would not be told.
    """
    from saflite.oracle.policy import load_policy

    for name in names:
        load_policy(name, texts)


def _check_policy(name: str, campaign: Campaign, target: TargetInfo) -> None:
    """Raise Refused for a policy that nobody could judge a flight of the target by."""
    from saflite.oracle.policy import load_policy

    policy = load_policy(name, campaign.policy_texts)
    why = policy.file.not_checked_on.get(target.name, "")
    if why:
        raise Refused(f"policy {name}", expected=f"one that can be checked on {target.name}", got=why)
    twin = policy.file.twin
    if twin and not target.flies_twin(twin):
        raise Refused(f"policy {name}", expected=f"a target that flies a twin that is {twin}", got=target.name)
    unseen = target.unseen(policy.needed, twin)
    if unseen:
        expected = f"one whose signals {target.name} writes"
        raise Refused(f"policy {name}", expected=expected, got=f"{', '.join(unseen)}, which it does not write")
