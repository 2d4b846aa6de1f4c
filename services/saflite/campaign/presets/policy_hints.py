"""What the search is told of a policy before any flight, made from its file: modes, settings, sticks, inputs."""

from __future__ import annotations

import re
from typing import Any

from saflite.campaign.presets.formula_hints import (
    SETTING,
    antecedents,
    failsafes_named,
    far_asked_m,
    faults_asked,
    modes_barred,
    modes_named,
    quiet_asked_s,
    sensor_lost,
    settings_asked,
    settings_pushed,
    sticks_held,
    whole_formula,
)
from saflite.contract.signals import SIGNALS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import StartState, StimulusKind

DEFAULT_START = StartState()
MODE_COMMAND = "Flight_Mode"  # among the commands of a policy: any mode
INPUTS: dict[str, StimulusKind] = {
    "parameters": "parameter",
    "commands": "command",
    "sticks": "stick",
    "modes": "mode",
    "sensor_faults": "sensor_fault",
}
_EXCUSED = re.compile(r"\b(gps|baro|body)_true\b")  # the rule is silent after a fault of these sensors
_RADIO = "radio"  # faults of the link begin with it: they falsify no sensor
_STICK_SIGNAL = re.compile(r"rc(\d+)_pwm$")


def hint_of(data: dict[str, Any], start: dict[str, Any], inputs: dict[str, list[Any]], target: TargetInfo) -> str:
    """Return what the strategy is told of a policy, a word each: id, start state, what its formula asks for, inputs.

    Commands that are sticks, as in the published lists, are told as such; any mode can be given in any case.
    """
    kinds = {(entry.kind, entry.name) for entry in target.inputs}
    words = ["".join(str(data["id"]).split())]  # an id that is none is refused by the oracle
    if can_start(start, target) and not data.get("needs_mission"):
        state = StartState(**start)
        words.append(f"start:{state.mode}@{state.altitude_m:g}{'' if state.armed else ':disarmed'}")
    formula, asked = whole_formula(data), antecedents(data)
    words += ["mission:"] if data.get("needs_mission") else []
    words += [f"in:{mode}" for mode in modes_of(data) if ("mode", mode) in kinds]
    words += [f"raised:{name}" for name in failsafes_named(formula)]
    words += [f"quiet:{quiet_s:g}" for quiet_s in (quiet_asked_s(formula, data.get("constants")),) if quiet_s]
    words += [f"asks:{entry.name}={value:g}" for entry, value in settings_asked(f"{formula}\n{asked}", target)]
    words += [f"holds:{entry.name}={value:g}" for entry, value in sticks_held(formula, target)]
    words += [f"pushes:{entry.name}={sense:+g}" for entry, sense in settings_pushed(asked, target)]
    words += ["upset:"] if sensor_lost(data) else []
    words += [f"twin:{data['twin']}"] if data.get("twin") else []
    words += [f"far:{far_m:g}" for far_m in (far_asked_m(asked, target),) if far_m]
    words += [f"reads:{kind}:{name}" for kind, name in _read_by(data, target)]
    for word, kind in INPUTS.items():
        excused = kind == "sensor_fault" and _EXCUSED.search(formula)
        for name in (one for one in inputs.get(word, ()) if not excused or one.startswith(_RADIO)):
            if kind == "command" and name == MODE_COMMAND:
                continue
            if kind == "command" and (kind, name) not in kinds and ("stick", name) in kinds:
                words.append(f"stick:{name}")
            else:
                words.append(f"{kind}:{name}")
    words += [f"sensor_fault:{name}" for name in faults_asked(formula, target)]
    return " ".join(dict.fromkeys(words))


def modes_of(data: dict[str, Any]) -> list[str]:
    """Return the modes in which a rule asks something, or which it forbids; none where it names none."""
    formula = whole_formula(data)
    return list(modes_named(antecedents(data)) or modes_named(formula) or modes_barred(formula))


def _read_by(data: dict[str, Any], target: TargetInfo) -> list[tuple[StimulusKind, str]]:
    """Return the inputs that the policy's signals show: sticks; settings and commands by the table of signals."""
    kinds: dict[str, StimulusKind] = {entry.name: entry.kind for entry in target.inputs}
    formula, found = whole_formula(data), []
    for signal in data.get("signals", {}):
        stick, meaning = _STICK_SIGNAL.match(signal), SIGNALS[signal].meaning if signal in SIGNALS else ""
        if signal.endswith("_true") or not re.search(rf"\b{re.escape(signal)}\b(?!\s*==\s*0\b)", formula):
            continue  # what excuses a rule
        names = [f"RC{stick[1]}"] if stick else SETTING.findall(meaning)
        found += [(kinds[name], name) for name in names if name in kinds]
    return list(dict.fromkeys(found))


def can_start(start: dict[str, Any], target: TargetInfo) -> bool:
    """Return whether a start state is given in a mode that does not only show; one that is none is refused later."""
    mode = start.get("mode", DEFAULT_START.mode)
    only_shows = set(target.modes) - {state.mode for state in target.start_states}
    return bool(start) and (not target.start_states or mode not in only_shows)
