"""What there is to choose from, by kind. Every list is read off the files that make it; nothing is registered."""

from __future__ import annotations

import pkgutil
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from saflite.console.io.target_options import DEFECTS
from saflite.console.view import out
from saflite.contract.errors import Refused
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET, StimulusKind


class Item(NamedTuple):
    """One thing that can be chosen. `details` are settings or the rest of what is known, by name."""

    name: str
    summary: str
    details: Mapping[str, str] = MappingProxyType({})


def _campaigns(info: TargetInfo) -> list[Item]:
    from saflite.campaign.presets.campaigns import builtin_campaigns

    return [Item(name, text) for name, text in builtin_campaigns(info).items()]


def _missions() -> list[Item]:
    from saflite.flight.mission import builtin_mission, mission_names, waypoints

    found = []
    for name in mission_names():
        places = waypoints(builtin_mission(name))
        note = "stand-in, not the official mission; " if "standin" in name else ""
        found.append(Item(name, f"{note}{len(places)} places, up to {max(place.z_m for place in places):g} m high"))
    return found


def _strategies() -> list[Item]:
    from saflite.mutator.registry import describe, options_of, strategy_names

    return [
        Item(
            name,
            _first(describe(name)),
            {
                key: f"{option.meaning} (default {option.default!r}{_range(option.least, option.most)})"
                for key, option in options_of(name).items()
            },
        )
        for name in strategy_names()
    ]


def _range(least: float, most: float) -> str:
    bounded = [text for text in (f"from {least:g}" * (least > -1e300), f"to {most:g}" * (most < 1e300)) if text]
    return f", {' '.join(bounded)}" if bounded else ""


def _scorers() -> list[Item]:
    from saflite.scorer_pool.registry import describe, model_names

    return [Item(name, _first(describe(name))) for name in model_names()]


def _targets() -> list[Item]:
    from saflite.contract.errors import Unavailable
    from saflite.simulator_worker.registry import describe_target, target_names

    found = []
    for name in target_names():
        try:
            found.append(_target(describe_target(name)))
        except Unavailable as fault:
            found.append(Item(name, f"[cannot tell here: {fault}]"))
    return found


def _target(info: TargetInfo) -> Item:
    missing = f" [cannot fly here: {info.missing}]" if info.missing else ""
    counts = Counter(entry.kind for entry in info.inputs)
    takes = [word for word in ("missions", "obstacles", "wind", "snapshots") if getattr(info, word)]
    takes += ["a heading to begin with"] if info.turns else []
    details = {
        "repeats": {"bitwise": "bit by bit", "statistically": "statistically only"}[info.repeats],
        "inputs": ", ".join(f"{count} {kind}s" for kind, count in counts.items()) or "none",
        "modes": ", ".join(info.modes) or "none",
        "signals": str(len(info.signals)),
        "takes": ", ".join(takes) or "only start states",
        "settings": ", ".join(info.settings) or "none",
        "needs": ", ".join(info.needs) or "nothing more",
        "build": info.build[:16],
    }
    return Item(info.name, f"{info.autopilot or info.name}, {info.vehicle or 'no vehicle named'}{missing}", details)


def _policies() -> list[Item]:
    from saflite.contract.modules import given
    from saflite.oracle.policy import family, load_policy, policy_names

    found = []
    for name in (*policy_names(), *given("policy")):
        file = load_policy(name).file
        details = {"source": file.source, "formula": " ".join(file.formula.split()), "family": family(file)}
        if file.published:
            details["published as"] = file.published
        details |= {f"not checked on {target}": why for target, why in file.not_checked_on.items()}
        for target, own in file.constants_on.items():
            told = (f"{constant} = {value:g} (else {file.constants[constant]:g})" for constant, value in own.items())
            details[f"constants on {target}"] = ", ".join(told)
        details |= {f"deviation ({number})": text for number, text in enumerate(file.deviations, 1)}
        found.append(Item(name, file.title, details))
    return found


def policies_told(target: str) -> str:
    """Return how many policies there are, how many can be checked on the target, and by how many different rules."""
    from saflite.oracle.policy import load_policy, policy_names

    every = [load_policy(name) for name in policy_names()]
    checkable = [policy for policy in every if target not in policy.file.not_checked_on]
    rules = len({id(policy.formula) for policy in checkable})  # interned: the same rule is one object
    return f"{len(every)} policies, {len(checkable)} of them can be checked on {target}, by {rules} different rules"


def _exports() -> list[Item]:
    from saflite.recorder.export import describe, format_names

    return [Item(name, _first(describe(name))) for name in format_names()]


def _commands() -> list[Item]:
    from saflite.console import commands

    return _modules(commands.__path__)


def _modules(path: list[str]) -> list[Item]:
    return [
        Item(info.name.rstrip("_"), out.summary_of(Path(folder) / f"{info.name}.py"))
        for folder in path
        for info in sorted(pkgutil.iter_modules([folder]), key=lambda info: info.name)
        if not info.name.startswith("_")
    ]


def _first(text: str) -> str:
    return " ".join(text.strip().split("\n\n")[0].split())


# ---- what a target says of itself ---------------------------------------------------------------------------------


def _inputs(info: TargetInfo, kind: StimulusKind | None = None) -> list[Item]:
    shown = [entry for entry in info.inputs if kind in (None, entry.kind)]
    return [
        Item(entry.name, f"{'' if kind else entry.kind + ': '}{entry.meaning}{_bounds(entry)}".strip())
        for entry in shown
    ]


def _bounds(entry: InputInfo) -> str:
    limits = [
        f"{entry.low:g} to {entry.high:g}" if entry.low is not None and entry.high is not None else "",
        f"one of {', '.join(f'{value:g}' for value in entry.choices)}" if entry.choices else "",
    ]
    ranges = f"{' '.join(text for text in limits if text)} {entry.unit}".strip()
    default = f"default {entry.default:g}" if entry.default is not None else ""
    parts = [text for text in (ranges, default) if text]
    return f" [{'; '.join(parts)}]" if parts else ""


def _settings(info: TargetInfo) -> list[Item]:
    return [
        Item(name, f"{setting.meaning} (default {setting.default!r})", {str(key): "" for key in setting.choices})
        for name, setting in info.settings.items()
    ]


def _defects(info: TargetInfo) -> list[Item]:
    setting = info.settings.get(DEFECTS)
    if setting is None:
        return []
    return [Item(str(name), _first(setting.choice_meanings.get(str(name), ""))) for name in setting.choices]


def _signals(info: TargetInfo) -> list[Item]:
    from saflite.contract.signals import SIGNALS

    own = {name: signal.as_signal() for name, signal in info.own_signals.items()}
    return [Item(name, f"{signal.meaning} [{signal.unit or '-'}]") for name, signal in {**SIGNALS, **own}.items()]


KINDS: dict[str, Callable[[], list[Item]]] = {
    "missions": _missions,
    "strategies": _strategies,
    "scorers": _scorers,
    "targets": _targets,
    "policies": _policies,
    "exports": _exports,
    "commands": _commands,
}
OF_TARGET: dict[str, Callable[[TargetInfo], list[Item]]] = {
    "campaigns": _campaigns,
    "settings": _settings,
    "defects": _defects,
    "signals": _signals,
    "inputs": _inputs,
    "parameters": partial(_inputs, kind="parameter"),
    "sensor-faults": partial(_inputs, kind="sensor_fault"),
    "mav-commands": partial(_inputs, kind="command"),
    "sticks": partial(_inputs, kind="stick"),
    "modes": partial(_inputs, kind="mode"),
}


def kinds() -> tuple[str, ...]:
    """Return the kinds of things there are to list."""
    return (*KINDS, *OF_TARGET)


def names(kind: str, target: str = DEFAULT_TARGET) -> list[str]:
    """Return the names of `items`, of policies without reading what stands in their files."""
    if kind != "policies":
        return [item.name for item in items(kind, target)]
    from saflite.contract.modules import given
    from saflite.oracle.policy import policy_names

    return [*policy_names(), *given("policy")]


def items(kind: str, target: str = DEFAULT_TARGET) -> list[Item]:
    """Return what there is of a kind; inputs, signals and settings are those of `target`.

    Raises:
        Refused: no such kind or target.
        Unavailable: the target cannot tell on this machine.
    """
    from saflite.simulator_worker.registry import describe_target

    if kind in KINDS:
        return KINDS[kind]()
    if kind not in OF_TARGET:
        raise Refused("kind", expected=f"one of {', '.join(kinds())}", got=repr(kind))
    return OF_TARGET[kind](describe_target(target))
