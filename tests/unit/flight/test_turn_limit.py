"""The greatest yaw rate (ATC_RATE_Y_MAX) binds the stick and an order alike; a limit below 20 deg/s counts as 20."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase

STICK = Stimulus(at_s=0.5, kind="stick", name="RC4", values=(1800.0,))
TURN = Stimulus(at_s=0.5, kind="command", name="MAV_CMD_CONDITION_YAW", values=(170.0, 0.0, 1.0, 0.0))


@pytest.mark.parametrize(("mode", "given"), [("LOITER", STICK), ("ALT_HOLD", STICK), ("GUIDED", TURN)])
@pytest.mark.parametrize(("limit_dps", "kept_dps"), [(10.0, 20.0), (35.0, 35.0)])
def test_nothing_turns_faster_than_the_greatest_yaw_rate(
    mode: str, given: Stimulus, limit_dps: float, kept_dps: float
) -> None:
    scenario = Scenario(start=StartState(mode=mode, altitude_m=20.0), time_limit_s=4.0)
    target = Target(parameters={"ATC_RATE_Y_MAX": limit_dps})
    trace = fly_once(TestCase(target=target, scenario=scenario, stimuli=(given,))).trace
    assert trace is not None
    rate_dps = trace.array("yaw_rate_dps")[int(2.0 / trace.step_s) :]
    assert float(np.mean(rate_dps)) == pytest.approx(kept_dps, rel=0.1)
