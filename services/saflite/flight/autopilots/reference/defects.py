"""Planted defects: known faults of real autopilots, each one switch, off by default: a benchmark with ground truth.

Each has the policy it breaks and the shortest trigger known. Bug numbers are those of the PGFuzz list; the others are
of the families its authors report (unchecked ranges, climb without end, missing failsafe, wrong source).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.target_info import SettingInfo, check_settings
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
from saflite.flight.autopilots.reference.defect_table import ROWS

Input = tuple[float, StimulusKind, str, tuple[float, ...]]


class Defect(NamedTuple):
    """One planted defect.

    `unchecked` lists parameters whose range is not checked while it is on. `start`, `parameters`, `inputs` and
    `time_s` make the shortest test case known that breaks `policy`.
    """

    name: str
    text: str
    policy: str
    bug: str
    start: tuple[str, float]
    inputs: tuple[Input, ...]
    time_s: float
    parameters: Mapping[str, float] = MappingProxyType({})
    unchecked: tuple[str, ...] = ()


TABLE: dict[str, Defect] = {str(row[0]): Defect(*row) for row in ROWS}  # type: ignore[arg-type]
DEFECTS: dict[str, str] = {
    name: f"{defect.text} (breaks {defect.policy}{', bug ' + defect.bug if defect.bug else ''})"
    for name, defect in TABLE.items()
}


SETTING = "defects"
SETTINGS: dict[str, SettingInfo] = {
    SETTING: SettingInfo(
        meaning="planted defects that are switched on",
        default=[],
        choices=tuple(sorted(TABLE)),
        choice_meanings={name: DEFECTS[name] for name in sorted(TABLE)},
        breaks={name: TABLE[name].policy for name in sorted(TABLE)},
    )
}


def planted_in(target: Target) -> tuple[str, ...]:
    """Return the defects that are switched on; raises Refused for one that does not exist."""
    check_settings(target.settings, SETTINGS, target.name)
    given = target.settings.get(SETTING, [])
    assert isinstance(given, list), "check_settings lets only lists through"
    return tuple(str(name) for name in given)


def unchecked_parameters(defects: Iterable[str]) -> frozenset[str]:
    """Return the parameters whose range is not checked while these defects are on."""
    return frozenset(name for defect in defects for name in TABLE[defect].unchecked)


def trigger(name: str, *, planted: bool = True) -> TestCase:
    """Return the shortest test case known for a defect, with the defect on or (for comparison) off."""
    if name not in TABLE:
        raise Refused("defect", expected=f"one of {', '.join(sorted(TABLE))}", got=repr(name))
    defect = TABLE[name]
    mode, altitude_m = defect.start
    return TestCase(
        target=Target(parameters=dict(defect.parameters), settings={SETTING: [name]} if planted else {}),
        scenario=Scenario(start=StartState(mode=mode, altitude_m=altitude_m), time_limit_s=defect.time_s),
        stimuli=tuple(
            Stimulus(at_s=at, kind=kind, name=what, values=values) for at, kind, what, values in defect.inputs
        ),
        rng_seed=1,
    )
