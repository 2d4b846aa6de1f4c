"""What there is to choose from, by kind. Every list is read off the files that make it; nothing is registered."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from saflite.console.view import out


class Item(NamedTuple):
    """One thing that can be chosen. `details` are settings or the rest of what is known, by name."""

    name: str
    summary: str
    details: Mapping[str, str] = MappingProxyType({})


def _campaigns() -> list[Item]:
    from saflite.campaign.presets.campaigns import builtin_campaigns

    return [Item(name, text) for name, text in builtin_campaigns().items()]


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
    from saflite.simulator_worker.registry import load_target, target_names, why_missing

    found = []
    for name in target_names():
        target = load_target(name)
        missing = why_missing(target)
        found.append(Item(name, _first(target.__doc__ or "") + (f" [cannot fly here: {missing}]" if missing else "")))
    return found


def _policies() -> list[Item]:
    from saflite.oracle.policy import family, load_policy, policy_names

    found = []
    for name in policy_names():
        file = load_policy(name).file
        details = {"source": file.source, "formula": " ".join(file.formula.split()), "family": family(file)}
        if file.published:
            details["published as"] = file.published
        details |= {f"not checked on {target}": why for target, why in file.not_checked_on.items()}
        details |= {f"mended ({number})": text for number, text in enumerate(file.deviations, 1)}
        found.append(Item(name, file.title, details))
    return found


def _defects() -> list[Item]:
    from saflite.flight.autopilots.reference import defects

    found: dict[str, str] = getattr(defects, "DEFECTS", {})
    return [Item(name, _first(str(text))) for name, text in sorted(found.items())]


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


def _signals() -> list[Item]:
    from saflite.contract.signals import SIGNALS

    return [Item(name, f"{signal.meaning} [{signal.unit or '-'}]") for name, signal in SIGNALS.items()]


def _parameters() -> list[Item]:
    from saflite.flight.autopilots.reference.parameters import parameter_table

    return [
        Item(
            row.name,
            f"{row.meaning} [{row.low:g} to {row.high:g}{' ' + row.unit if row.unit else ''}; default {row.default:g}]",
            {"acts": "at the next start" if row.reboot else "at once"},
        )
        for row in parameter_table().values()
    ]


def _mav_commands() -> list[Item]:
    from saflite.flight.autopilots.reference.tables import commands

    return [Item(f"MAV_CMD_{name}", f"{row.meaning} [{row.number}]") for name, row in sorted(commands().items())]


def _first(text: str) -> str:
    return " ".join(text.strip().split("\n\n")[0].split())


KINDS: dict[str, Callable[[], list[Item]]] = {
    "campaigns": _campaigns,
    "missions": _missions,
    "strategies": _strategies,
    "scorers": _scorers,
    "targets": _targets,
    "policies": _policies,
    "defects": _defects,
    "exports": _exports,
    "signals": _signals,
    "parameters": _parameters,
    "mav-commands": _mav_commands,
    "commands": _commands,
}
