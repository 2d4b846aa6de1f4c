"""When and by what a run was made, as far as its folder tells: nothing of the moment or machine of the writing."""

from __future__ import annotations

from typing import NamedTuple

from saflite.console.run_data import provenance
from saflite.console.run_data.run_folder import RunFolder
from saflite.console.view.html_text import escape
from saflite.contract.clock import in_utc

CAMPAIGN = "campaign.toml"
SHOWN = 16  # digits of a build


class Made(NamedTuple):
    """Facts of a run, each with its name."""

    facts: tuple[tuple[str, str], ...] = ()


def read(run: RunFolder, *, over: bool) -> Made:
    """Return when a run began and ended, or was worked on last, in UTC, and the software and campaign it began with."""
    first, last = run.first_event(), next(iter(run.last_events(1)), None)
    software = provenance.read(run.path)
    facts = {
        "begun": _moment(first.at_unix_s) if first else "",
        "ended" if over else "last event": _moment(last.at_unix_s) if last else "",
        "saflite": software.saflite if software else "",
        "Python": software.python if software else "",
        "machine": software.machine if software else "",
        "target": run.target.name,
        "build": run.target.build[:SHOWN],
        "random seed": str(run.campaign.rng_seed),
        "campaign": f"{run.campaign.name}, as it was run: {CAMPAIGN}" if _is_kept(run) else run.campaign.name,
    }
    return Made(tuple((name, text) for name, text in facts.items() if text))


def section(made: Made) -> str:
    """Return the foot of the page; empty where nothing is known."""
    if not made.facts:
        return ""
    return f'<footer class="muted">{escape(" · ".join(f"{name} {text}" for name, text in made.facts))}</footer>'


def _is_kept(run: RunFolder) -> bool:
    return (run.path / CAMPAIGN).is_file()


def _moment(unix_s: float) -> str:
    return in_utc(unix_s).strftime("%Y-%m-%d %H:%M:%S UTC")
