"""An input that no target has is refused, whatever its kind: given and ignored, a typo would look like a rule held."""

from __future__ import annotations

import msgspec
import pytest

from saflite.conformance.target_cases import scenario
from saflite.conformance.targets import checks_of
from saflite.contract.errors import Refused
from saflite.contract.test_case import Stimulus, StimulusKind, Target, TestCase
from saflite.simulator_worker import registry
from saflite.simulator_worker.targets import reference


@pytest.mark.parametrize("name", ["reference", "betaflight"])
def test_what_no_target_has_is_refused(name: str) -> None:
    target = registry.load_target(name)
    if target.describe().missing:
        pytest.skip(target.describe().missing)
    (check,) = (one for one in checks_of(target) if one.name == "refuses_what_it_does_not_have")
    assert list(check.run()) == []


@pytest.mark.parametrize(
    ("kind", "typo", "meant"),
    [
        ("mode", "LOITTER", "LOITER"),
        ("parameter", "RTL_ATL", "RTL_ALT"),
        ("command", "MAV_CMD_NAV_LNAD", "MAV_CMD_NAV_LAND"),
        ("sensor_fault", "SIM_WIND_SDP", "SIM_WIND_SPD"),
    ],
)
def test_the_near_name_is_suggested(kind: StimulusKind, typo: str, meant: str) -> None:
    with pytest.raises(Refused, match=f"stimulus 0.*did you mean {meant}?"):
        reference.check(_given(Stimulus(at_s=1.0, kind=kind, name=typo, values=() if kind == "mode" else (1.0,))))


def test_a_value_out_of_range_is_the_autopilots_to_refuse() -> None:
    reference.check(_given(Stimulus(at_s=1.0, kind="parameter", name="RTL_ALT", values=(3.3e38,))))
    reference.check(_given(Stimulus(at_s=1.0, kind="command", name="MAV_CMD_DO_SET_MODE", values=(1.0, 77.0))))


def _given(stimulus: Stimulus) -> TestCase:
    info = reference.describe()
    short = msgspec.structs.replace(scenario(info), time_limit_s=2.0)
    return TestCase(target=Target(name=info.name), scenario=short, stimuli=(stimulus,))
