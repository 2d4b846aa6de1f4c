"""Can the reference target fly this test case? Said before anything is started."""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.reference.defects import planted_in, unchecked_parameters
from saflite.flight.autopilots.reference.mission_items import understand
from saflite.flight.autopilots.reference.modes.table import mode_table
from saflite.flight.autopilots.reference.parameters import parameter_table
from saflite.flight.autopilots.reference.stimuli import check_stimulus

TIME_LIMIT_MAX_S, ALTITUDE_MAX_M, WIND_MAX_MPS = 7200.0, 2000.0, 15.0


def check_test_case(test_case: TestCase) -> None:
    """Raise Refused for unknown parameters, settings, modes, mission commands, or numbers without sense."""
    scenario, target = test_case.scenario, test_case.target
    if not 0.0 < scenario.time_limit_s <= TIME_LIMIT_MAX_S:
        raise Refused("time_limit_s", expected=f"above 0, at most {TIME_LIMIT_MAX_S:g}", got=scenario.time_limit_s)
    wind = scenario.wind
    if (
        not 0.0 <= wind.mean_mps <= WIND_MAX_MPS
        or not 0.0 <= wind.gust_mps <= WIND_MAX_MPS
        or wind.gust_period_s <= 0.0
    ):
        raise Refused("wind", expected=f"speeds of 0 to {WIND_MAX_MPS:g} m/s, a period above 0", got=wind)
    unchecked = unchecked_parameters(planted_in(target))
    for name, value in target.parameters.items():
        row = parameter_table().get(name)
        if row is None:
            raise Refused(
                "parameter", expected="one of `saflite list parameters`", got=repr(name), known=parameter_table()
            )
        if name not in unchecked and not row.low <= value <= row.high:
            raise Refused(f"parameter {name}", expected=f"{row.low:g} to {row.high:g} {row.unit}".rstrip(), got=value)
    if scenario.mission is not None:
        understand(scenario.mission)
    elif scenario.start is not None:
        _check_start(scenario.start.mode, scenario.start.altitude_m)
    for index, stimulus in enumerate(test_case.stimuli):
        check_stimulus(stimulus, f"stimulus {index}")


def _check_start(mode: str, altitude_m: float) -> None:
    modes = [name for name in mode_table() if name != "AUTO"]
    if mode not in modes:
        raise Refused("start mode", expected=f"one of {', '.join(modes)} (AUTO needs a mission)", got=repr(mode))
    if not 0.0 <= altitude_m <= ALTITUDE_MAX_M:
        raise Refused("start altitude_m", expected=f"0 to {ALTITUDE_MAX_M:g}", got=altitude_m)
