"""Built-in campaigns, campaign files of others, and the test case that every mutant of a campaign starts from.

A campaign is one TOML file in `campaign/presets/`, named like the campaign; those over policies are made from the
policy files (`policy_campaigns.py`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import msgspec

from saflite.campaign.presets.policy_campaigns import (
    PREFIX,
    campaign_over,
    is_policy,
    policy_campaign,
    policy_campaign_descriptions,
    policy_text,
    refuse_unfit,
)
from saflite.contract.config import Campaign, check_campaign, parse_campaign
from saflite.contract.errors import Refused
from saflite.contract.modules import given
from saflite.contract.outside import read_text
from saflite.contract.plain import cut
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Scenario, TestCase
from saflite.contract.topics import prefix
from saflite.contract.work import PolicyText
from saflite.flight.autopilots.described import default_target
from saflite.flight.mission import find_mission

BUILTIN_DIR = Path(__file__).parent


def builtin_campaigns(target: TargetInfo | None = None) -> dict[str, str]:
    """Return the names of the built-in campaigns and what each is for, sorted by name; over policies for `target`."""
    made = policy_campaign_descriptions(target or default_target())
    files = {path.stem: load_campaign(path.stem).description for path in BUILTIN_DIR.glob("*.toml")}
    return dict(sorted({**made, **files}.items()))


def load_campaign(name_or_path: str, target: TargetInfo | None = None) -> Campaign:
    """Return a built-in campaign by name, or the one in a `.toml` file.

    Campaigns over policies are made for `target`, the default target if none is given.
    A `.plan` file and policy files named in a campaign file are looked for beside it. A policy file stands for the
    campaign over that policy. Raises Refused naming file, key and what was expected for an unknown name, TOML that is
    none, unknown keys, or values that make no sense.
    """
    if name_or_path.endswith(".toml"):
        path = Path(name_or_path)
        text = read_text(path, "campaign file")
        if is_policy(text):
            return campaign_over(path, text, target or default_target())
        return _found(parse_campaign(text, str(path)), path)
    path = BUILTIN_DIR / f"{name_or_path}.toml"
    if Path(name_or_path).name != name_or_path or not path.is_file():
        info = target or default_target()
        outside = given("policy").get(name_or_path.removeprefix(PREFIX)) if name_or_path.startswith(PREFIX) else None
        if outside is not None:
            return campaign_over(outside.path, read_text(outside.path, "policy file"), info)
        made = policy_campaign(name_or_path, info)
        if made is not None:
            return made
        refuse_unfit(name_or_path, info)
        if "/" in name_or_path:
            expected = "the name of a campaign, or a .toml file"
            raise Refused("campaign file", where=cut(name_or_path, 200), expected=expected, got="another kind of file")
        known = (*(path.stem for path in BUILTIN_DIR.glob("*.toml")), *policy_campaign_descriptions(info))
        fix = "see `saflite list campaigns`"
        expected = f"a name such as avoidance-m2 or {PREFIX}<policy>, or a .toml file"
        raise Refused("campaign", expected=expected, got=repr(cut(name_or_path, 80)), fix=fix, known=known)
    return parse_campaign(read_text(path, "campaign file"), path.name)


def _found(campaign: Campaign, path: Path) -> Campaign:
    """Return the campaign with the place of its mission file made absolute and the text of its policy files in it.

    Raises Refused for a name that is not fit for the bus, or a policy file that cannot be read.
    """
    prefix(campaign.name)
    if campaign.mission.endswith(".plan"):
        campaign = msgspec.structs.replace(campaign, mission=os.path.realpath(path.parent / campaign.mission))
    names, texts = with_texts(campaign.policies, path.parent)
    found = msgspec.structs.replace(campaign, policies=names, policy_texts={**campaign.policy_texts, **texts})
    check_campaign(found, str(path))  # two files may hold policies of one name
    return found


def with_texts(policies: Iterable[str], folder: Path) -> tuple[tuple[str, ...], dict[str, PolicyText]]:
    """Return the names of policies, and the texts of those that are files in `folder` or were given by `--module`.

    Raises Refused for a policy file that cannot be read.
    """
    names, texts = [], dict[str, PolicyText]()
    for name in policies:
        if name.endswith(".toml"):
            name, texts[name] = policy_text(folder / name)
        elif name in given("policy"):
            _, texts[name] = policy_text(given("policy")[name].path)
        names.append(name)
    return tuple(names), texts


def template(campaign: Campaign, build: str = "") -> TestCase:
    """Return the test case all mutants of the campaign start from: no obstacles, no stimuli; to be flown on `build`.

    Raises Refused for an unknown or broken mission, or if not exactly one of `mission` and `start` is given.
    """
    if bool(campaign.mission) == (campaign.start is not None):
        got = "both" if campaign.mission else "neither"
        where = f"campaign {campaign.name}"
        raise Refused("campaign file", where=where, expected="`mission` or `[start]`, one of them", got=got)
    return TestCase(
        target=msgspec.structs.replace(campaign.target, build=build or campaign.target.build),
        scenario=Scenario(
            mission=find_mission(campaign.mission) if campaign.mission else None,
            start=campaign.start,
            wind=campaign.wind,
            time_limit_s=campaign.time_limit_s,
        ),
        rng_seed=campaign.rng_seed,
    )
