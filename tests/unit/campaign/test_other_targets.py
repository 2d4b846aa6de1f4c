"""Campaigns and policies for a target of another kind: made from what it says of itself, refused in words."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import msgspec
import pytest

from saflite.campaign.presets.campaigns import builtin_campaigns, load_campaign
from saflite.campaign.presets.policy_campaigns import POLICIES_DIR, policy_campaigns, why_not
from saflite.contract.errors import Refused
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import StartState
from saflite.flight.autopilots.described import default_target
from saflite.oracle.policy import parse_policy

CHUTE = InputInfo(kind="command", name="MAV_CMD_DO_PARACHUTE")
SETTABLE = tuple(
    InputInfo(kind="parameter", name=name)
    for name in ("CHUTE_ENABLED", "CHUTE_TYPE", "SERVO9_FUNCTION", "SIM_PARA_ENABLE")
)
OTHER = msgspec.structs.replace(default_target(), name="other", inputs=(CHUTE, *SETTABLE), missions=False)
OWN_SIGNALS = """
id = "slow-cart"
title = "The cart stays slow"
source = "test"
interestingness = "The cart must not exceed its top speed; pushes make it fast."
formula = "always (cart_on == 1 implies cart_speed_mps < top_mps)"
[signals]
cart_speed_mps = "m/s"
cart_on = "flag"
[constants]
top_mps = 4
[inputs]
sticks = ["PUSH"]
[[examples]]
holds = true
why = "slow"
duration_s = 2.0
signals = { cart_speed_mps = 1.0, cart_on = 1 }
[[examples]]
holds = false
why = "fast"
duration_s = 2.0
signals = { cart_speed_mps = 5.0, cart_on = [[0.0, 0], [1.0, 1]] }
"""


def chute() -> dict[str, Any]:
    return tomllib.loads((POLICIES_DIR / "a-chute.toml").read_text())


def test_a_policy_campaign_is_made_for_any_target_that_has_what_it_needs() -> None:
    names = [name for name in builtin_campaigns(OTHER) if name.startswith("policy-")]
    assert {"policy-a-chute", "policy-all"} <= set(names)
    assert len(names) < len([name for name in builtin_campaigns() if name.startswith("policy-")])
    campaign = load_campaign("policy-a-chute", OTHER)
    assert campaign.target.name == "other"
    kept_to = [load_campaign(name, OTHER).strategy.settings["beyond"] for name in ("policy-a-chute", "policy-all")]
    assert kept_to == [0.0, 0.0], "makers of autopilots refuse what needs values out of range"
    airborne = (StartState(mode="LOITER", altitude_m=20.0),)
    shown = msgspec.structs.replace(default_target(), start_states=airborne)  # CIRCLE only shows
    told = str(load_campaign("policy-all", shown).strategy.settings["hints"])
    assert set(re.findall(r" start:(\w+)@", told)) == {"LOITER"}
    assert "beyond" not in load_campaign("policy-all").strategy.settings
    assert set(campaign.target.parameters) == {entry.name for entry in SETTABLE}
    given = campaign.strategy.settings["hints"]
    assert isinstance(given, list)
    hinted = str(given[0]).split()
    assert [word for word in hinted if word.startswith(("command:", "stick:", "mode:"))] == [
        "command:MAV_CMD_DO_PARACHUTE"
    ]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"inputs": ()}, "none of its inputs"),
        ({"signals": ("x_m",)}, "does not write .*chute_released"),
        ({"modes": {}, "start_states": ()}, "no mode"),
        ({"inputs": (CHUTE,)}, "no parameter CHUTE_ENABLED, CHUTE_TYPE"),
    ],
)
def test_a_target_that_lacks_something_is_refused_saying_what(changed: dict[str, Any], why: str) -> None:
    lacking = msgspec.structs.replace(OTHER, **changed)
    assert why_not(chute(), OTHER) == ""
    with pytest.raises(Refused, match=why):
        load_campaign("policy-a-chute", lacking)


def test_signals_the_oracle_makes_need_only_what_they_are_made_from() -> None:
    data = {"id": "x", "inputs": {"commands": [CHUTE.name]}, "signals": {"ground_speed_mps": "m/s", "quiet_s": "s"}}
    assert why_not(data, msgspec.structs.replace(OTHER, signals=("vx_mps", "vy_mps"))) == ""
    assert why_not(data, msgspec.structs.replace(OTHER, signals=("vx_mps",))) == "other does not write ground_speed_mps"


def test_a_target_nothing_can_break_has_no_policy_campaigns() -> None:
    bare = TargetInfo(
        name="bare", build="1", repeats="bitwise", inputs=(), signals=("x_m",), start_states=(StartState(),)
    )
    assert policy_campaigns(bare) == {}


def test_a_policy_may_read_signals_of_a_targets_own_with_their_units() -> None:
    policy = parse_policy(OWN_SIGNALS, "cart.toml")
    assert policy.unit == "m/s"
    assert policy.needed == {"cart_speed_mps", "cart_on"}
    mixed = OWN_SIGNALS.replace("< top_mps", "< x_m").replace("[constants]", 'x_m = "m"\n[constants]')
    with pytest.raises(Refused, match="one unit on both sides"):
        parse_policy(mixed, "cart.toml")
    with pytest.raises(Refused, match="declared under"):
        parse_policy(OWN_SIGNALS.replace("cart_on == 1", "cart_off == 1"), "cart.toml")
