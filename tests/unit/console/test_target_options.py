"""Settings of a target from the command line and from files, checked against what the target says of itself."""

from __future__ import annotations

import msgspec
import pytest

from saflite.console.io.target_options import with_settings
from saflite.contract.config import parse_campaign
from saflite.contract.errors import Refused
from saflite.contract.target_info import SettingInfo, TargetInfo
from saflite.contract.test_case import Target
from saflite.flight.autopilots.reference.describe import describe

PLAIN = TargetInfo(
    name="mass",
    build="1",
    repeats="bitwise",
    inputs=(),
    signals=("x_m",),
    settings={
        "drag": SettingInfo(meaning="drag", default=0.1),
        "gear": SettingInfo(meaning="gear", default="wheel", choices=("wheel", "ski")),
    },
)


def test_a_setting_is_read_as_toml_or_text() -> None:
    assert with_settings(Target(), PLAIN, ["drag=0.5", "gear=ski"], []).settings == {"drag": 0.5, "gear": "ski"}


def test_a_list_takes_one_word_or_several_and_defects_are_added_once() -> None:
    info = describe()
    one = with_settings(Target(), info, ["defects=land-fast"], [])
    assert one.settings == {"defects": ["land-fast"]}
    both = with_settings(one, info, [], ["parachute-in-acro", "land-fast", "parachute-in-acro"])
    assert both.settings == {"defects": ["land-fast", "parachute-in-acro"]}
    assert one.settings == {"defects": ["land-fast"]}
    several = with_settings(Target(), info, ['defects=["land-fast", "parachute-in-acro"]'], [])
    assert several == both


@pytest.mark.parametrize(
    ("settings", "defects", "said"),
    [
        (["nosuch=1"], [], "drag, gear"),
        (["drag=fast"], [], "a value like 0.1"),
        (["gear=leg"], [], "one of wheel, ski"),
        (["drag"], [], "NAME=VALUE"),
        ([], ["land-fast"], "planted defects"),
    ],
)
def test_what_the_target_does_not_have_is_refused(settings: list[str], defects: list[str], said: str) -> None:
    with pytest.raises(Refused, match=said):
        with_settings(Target(), PLAIN, settings, defects)


def test_defects_of_an_old_campaign_file_name_their_new_place() -> None:
    with pytest.raises(Refused, match=r"\[target.settings\] defects"):
        parse_campaign('name = "x"\n[target]\ndefects = ["land-fast"]', "x.toml")
    campaign = parse_campaign('name = "x"\n[target.settings]\ndefects = ["land-fast"]', "x.toml")
    assert campaign.target.settings == {"defects": ["land-fast"]}


def test_nothing_but_the_settings_changes() -> None:
    target = Target(name="mass", parameters={"A": 1.0}, build="7")
    assert msgspec.structs.replace(with_settings(target, PLAIN, ["drag=1"], []), settings={}) == target
