"""The page: summary, progress, violations with pictures, scorer calibration, what went wrong. Nothing is loaded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from saflite.campaign.engine.exposure import ArmCounts
from saflite.console.run_data.embargo import withheld_words
from saflite.console.run_data.in_force import InForce, in_words
from saflite.console.run_data.rows import NO_FALLBACKS, Fallbacks, UsageRow
from saflite.console.run_data.unproven import unproven_words
from saflite.console.view.html_text import escape
from saflite.console.view.report import bars, charts, evidence, made
from saflite.console.view.report.data import Progress, ReportData
from saflite.console.view.report.script import TABLES
from saflite.console.view.report.style import CSS
from saflite.contract.config import Campaign
from saflite.contract.events import Quarantined
from saflite.contract.interval import Interval
from saflite.contract.test_case import TestCase, setting_text
from saflite.contract.verdict import NEVER_APPLIED, failed_again
from saflite.recorder.summary import Rulings
from saflite.scorer_pool.calibration import Calibration

DRAWN_FROM = 8
"""Flights from which a model's reliability is drawn."""


def render(data: ReportData, run_name: str) -> str:
    """Return the whole page as HTML."""
    name, chosen = escape(data.campaign.name), settings(data.campaign, data.in_force, data.fallbacks)
    sections = [
        f"<header><h1>{name}</h1><p>{escape(data.campaign.description)}</p>"
        f'<p class="muted">campaign {escape(data.state)} · {chosen}</p></header>',
        _tiles(data),
        progress_charts(data.progress),
        _causes(data),
        _table(data),
        policies(data.rulings),
        states(data.states, data.modes_unseen),
        arms(data.arms),
        *(evidence.section(number, exhibit, run_name) for number, exhibit in enumerate(data.exhibits, start=1)),
        calibration(data.calibrations),
        usage(data.usage),
        troubles(data.quarantined, data.faults),
        made.section(data.made),
    ]
    body = "\n".join(section for section in sections if section)
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{name} · SaFliTe Farm</title><style>{CSS}</style>"
    )
    body = f"<main>{body}</main><script>{TABLES}</script>"
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def settings(campaign: Campaign, now: InForce, fallbacks: Fallbacks = NO_FALLBACKS) -> str:
    """Return what was chosen for a campaign, and what an operator changed, in one line."""
    parts = [
        f"target {campaign.target.name}",
        f"strategy {campaign.strategy.name}",
        f"scorer {in_words(now.scorers)}",
        f"rng_seed {campaign.rng_seed}",
        f"policies {', '.join(campaign.policies)}",
    ]
    parts += [f"{name} {setting_text(value)}" for name, value in campaign.target.settings.items()]
    if told := fallbacks.in_words():
        parts.append(told)
    return escape(" · ".join(parts))


def _tiles(data: ReportData) -> str:
    confirmed = [exhibit for exhibit in data.exhibits if exhibit.violation.confirmation == "confirmed"]
    flaky = data.finds_shown("flaky")
    behaviours = len({exhibit.violation.fingerprint for exhibit in confirmed})
    simulated_s = sum(row.simulated_s for row in data.flights)
    flown = Counter(row.purpose for row in data.flights)
    elapsed_s = max(data.elapsed_s, 1e-9)
    tiles = [
        (str(behaviours), "behaviours confirmed", "bad" if confirmed else "good" if flown["search"] else ""),
        *([(str(len(data.causes)), "smallest sets of inputs behind them", "")] if data.causes else []),
        (str(sum(data.finds.values())), "finds of them", ""),
        (str(flaky), "flaky", "warn" if flaky else ""),
        *([(str(data.unproven), "neither confirmed nor refuted", "warn")] if data.unproven else []),
        (f"{flown['search']}", f"flights of {in_words(data.in_force.budgets)}", ""),
        (f"{flown['confirm']}", "flights more to confirm what was found", ""),
        (f"{flown['check']}", "flown over again to check the farm", ""),
        (f"{simulated_s / 3600:.2f} h", "flown in simulated time", ""),
        (duration(data.elapsed_s), f"wall time, {len(data.flights) / elapsed_s:.2f} flights/s", ""),
        (f"{simulated_s / elapsed_s:.0f}×", "real time, all workers", ""),
    ]
    if shrinking := flown["shrink"] + flown["shrunk"]:
        tiles.append((str(shrinking), "flights more to shrink what was found", ""))
    if data.quarantined:
        tiles.append((str(len(data.quarantined)), "set aside (quarantine)", "warn"))
    drawn = "".join(f'<div class="tile {css}"><b>{value}</b><span>{text}</span></div>' for value, text, css in tiles)
    return f'<div class="tiles">{drawn}</div>'


def duration(seconds: float) -> str:
    """Return a span of time in the unit that suits it."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def progress_charts(progress: Progress) -> str:
    """Return both charts of the search; a word where nothing was flown."""
    if not progress.flights.any():
        return '<p class="muted">No flight yet.</p>'
    drawn = (finds_chart(progress), search_chart(progress))
    return f'<div class="pictures">{"".join(f"<figure>{one}</figure>" for one in drawn)}</div>'


def finds_chart(progress: Progress) -> str:
    """Return finds and behaviours over flights."""
    curves = [
        charts.Curve(progress.flights, progress.found, "curve3", "finds", step=True),
        charts.Curve(progress.flights, progress.behaviours, "curve1", "behaviours", step=True),
    ]
    return charts.chart("violations over flights", curves, x_name="flights", counts=True)


def search_chart(progress: Progress) -> str:
    """Return the robustness of each flight and the least so far."""
    known = np.isfinite(progress.robustness)
    xs, ys = progress.flights[known], progress.robustness[known]
    best = np.minimum.accumulate(ys) if len(ys) else ys
    curves = [charts.Curve(xs, ys, "faint", "each flight"), charts.Curve(xs, best, "curve1", "least so far", step=True)]
    ceiling = float(np.quantile(ys, 0.9)) if len(ys) else None
    level = [charts.Level(0.0, "violated below", "limit")]
    return charts.chart("robustness of the flights", curves, x_name="flights", levels=level, y_max=ceiling)


def _table(data: ReportData) -> str:
    words = withheld_words(data.withheld) + ": reported to the maintainers first" if data.withheld else ""
    withheld = f'<p class="muted">{words}.</p>' if words else ""
    if data.unproven:
        withheld = f"<p>{unproven_words(data.unproven)}.</p>{withheld}"
    if not data.exhibits:
        judged = any(ruled.judged > ruled.inconclusive for ruled in data.rulings.values())
        nothing = "No violation was found." if judged else "No flight was judged: this says nothing of the vehicle."
        return withheld or f'<p class="quiet">{nothing}</p>'
    rows = []
    for number, exhibit in enumerate(data.exhibits, start=1):
        violation = exhibit.violation
        said = f"{violation.policy}, {violation.severity}, "
        cells = [
            evidence.anchor(number, str(number)),
            evidence.anchor(number, violation.fingerprint),
            escape(violation.policy),
            f"{violation.robustness:+.3f}",
            f'<span class="badge {violation.severity}">{violation.severity}</span>',
            f'<span class="badge {violation.confirmation}">{violation.confirmation}</span>',
            f'<span class="words">{escape(violation.behaviour.removeprefix(said))}</span>',
            f'<span class="words">{failed_again(violation)}</span>',
            str(data.finds[violation.fingerprint]),
            _inputs(exhibit.test_case),
        ]
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    heads = (
        "",
        "fingerprint",
        "policy",
        "robustness",
        "severity",
        "confirmation",
        "behaviour",
        "re-flown",
        "finds",
        "inputs",
    )
    return f"<h2>Violations</h2>{html_table(heads, rows)}{withheld}"


def _inputs(test_case: TestCase) -> str:
    boxes, stimuli = len(test_case.scenario.obstacles), len(test_case.stimuli)
    if boxes:
        return f"{boxes} {'box' if boxes == 1 else 'boxes'}"
    return f"{stimuli} {'stimulus' if stimuli == 1 else 'stimuli'}"


def _causes(data: ReportData) -> str:
    if not data.causes:
        return ""
    numbers = {exhibit.violation.test_case: number for number, exhibit in enumerate(data.exhibits, start=1)}
    rows = [
        f"<tr><td>{escape(cause.policy)}</td><td>{cause.violations}</td>"
        f'<td class="words">{escape(cause.words)}</td>'
        f"<td>{_linked(cause.name, numbers)}</td></tr>"
        for cause in data.causes
    ]
    heads = ("policy", "violations", data.inputs, "test case")
    return (
        "<h2>What it takes</h2>"
        '<p class="muted">Violations with the same inputs (by name) behind them count as one here; what only came '
        "along is left out as far as a smaller violation shows it was not needed.</p>" + html_table(heads, rows)
    )


def _linked(name: str, numbers: Mapping[str, int]) -> str:
    """Return a test case, as a link where its violation has a section of its own."""
    return evidence.anchor(numbers[name], name) if name in numbers else escape(name)


def policies(rulings: Mapping[str, Rulings]) -> str:
    """Return what each policy said, as a section."""
    if not any(ruled.judged for ruled in rulings.values()):
        return ""
    rows = []
    for name, ruled in rulings.items():
        never = ruled.judged > 0 and ruled.vacuous == ruled.judged
        word = f'<span class="badge flaky">vacuous: {NEVER_APPLIED}</span>' if never else ""
        cells = (escape(name), ruled.judged, ruled.applied, ruled.violated, ruled.vacuous, ruled.inconclusive, word)
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    heads = ("policy", "test cases judged", "applied in", "violated in", "vacuous in", "inconclusive in", "")
    return (
        "<h2>Verdicts by policy</h2>"
        '<p class="muted">First flights only. A policy is vacuous in a flight in which its rule never applied: such a '
        "flight is no evidence that the rule is kept.</p>" + html_table(heads, rows)
    )


def states(seen: Mapping[str, int], modes_unseen: Sequence[str]) -> str:
    """Return the states of the target that were seen, as a section."""
    if not seen:
        return ""
    rows = [f"<tr><td>{escape(state)}</td><td>{count}</td></tr>" for state, count in seen.items()]
    never = f"Modes never flown: {', '.join(modes_unseen)}." if modes_unseen else "Every mode was flown."
    return (
        f"<h2>States of the target</h2><p>{escape(never)}</p>"
        '<p class="muted">Mode, standing, disarmed, failsafes raised, in first flights.</p>'
        + html_table(("state", "test cases that reached it"), rows)
    )


def arms(found: Mapping[str, ArmCounts]) -> str:
    """Return what came of the arms of a portfolio, as a section."""
    if not found:
        return ""
    flights = sum(one.flights for one in found.values())
    rows = [
        f"<tr><td>{escape(arm)}</td><td>{one.flights}</td><td>{one.flights / flights:.0%}</td>"
        f"<td>{one.founded}</td></tr>"
        for arm, one in found.items()
    ]
    heads = ("arm", "test cases flown", "share", "behaviours first shown")
    return f"<h2>Arms of the portfolio</h2>{html_table(heads, rows)}"


def html_table(heads: Sequence[str], rows: Sequence[str]) -> str:
    """Return a table whose heads sort it, with a field to filter a long one."""
    head = "".join(f"<th>{text}</th>" for text in heads)
    table = f'<table class="sorts"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    return f'<div class="scroll">{table}</div>'


def calibration(found: Sequence[Calibration]) -> str:
    """Return how well scores met outcomes, as a section."""
    if not found:
        return ""
    rows = [_calibration_row(one) for one in found if one.flights]
    drawn = [one for one in found if one.sample == "all" and one.flights >= DRAWN_FROM]
    curves = "".join(f"<figure>{bars.reliability(one)}</figure>" for one in drawn)
    if not rows:
        return ""
    heads = (
        "model",
        "sample",
        "flights",
        "violations",
        "accuracy",
        "precision",
        "recall",
        "F1",
        "ROC area",
        "baseline",
    )
    return (
        "<h2>How well the scores met the outcomes</h2>"
        '<p class="muted">A score above 7 counts as "interesting", a violation as the truth; 95 % intervals. "random" '
        "are the flights drawn by chance, whose figures selection does not bias; baseline is the accuracy of the "
        "better of the two constant answers on the same flights. In the pictures the dashed line is the share a score "
        "promises if it is ten times the chance of a violation.</p>"
        + html_table(heads, rows)
        + (f'<div class="pictures curves">{curves}</div>' if curves else "")
    )


def _calibration_row(one: Calibration) -> str:
    figures = (one.metrics.accuracy, one.metrics.precision, one.metrics.recall, one.metrics.f1, one.roc_area)
    constant = max(value for value in (one.always.accuracy.value, one.never.accuracy.value, 0.0) if value is not None)
    cells = [escape(one.model), one.sample, str(one.flights), str(one.violations)]
    cells += [_interval(figure) for figure in figures]
    cells.append(f"{constant:.2f}")
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _interval(figure: Interval) -> str:
    if figure.value is None:
        return "–"
    if figure.low is None or figure.high is None:
        return f"{figure.value:.2f}"
    return f"{figure.value:.2f} <small>{figure.low:.2f}–{figure.high:.2f}</small>"


def usage(used: Sequence[UsageRow]) -> str:
    """Return what scoring took, as a section."""
    if not used:
        return ""
    rows = []
    for use in used:
        mean = use.latency_s / max(1, use.batches)
        cells = (
            *(escape(use.model), use.batches, use.calls, use.tokens_in, use.tokens_out, f"{mean:.3f} s"),
            *(f"{use.cost_usd:.4f}", use.asked_again, use.cached, use.faults),
        )
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    heads = (
        *("model", "batches", "calls", "tokens in", "tokens out", "per batch"),
        *("cost [USD]", "asked again", "from cache", "faults"),
    )
    return f"<h2>What scoring took</h2>{html_table(heads, rows)}"


def troubles(quarantined: Sequence[Quarantined], faults: Sequence[str]) -> str:
    """Return what went wrong, as a section."""
    parts = [f"<li>set aside: {escape(one.test_case)} after {one.attempts} attempts, last {one.last}: "
             f"{escape(one.message)}</li>" for one in quarantined]  # fmt: skip
    parts += [f"<li>{escape(text)}</li>" for text in faults]
    return f"<h2>Faults the farm got over</h2><ul class='muted'>{''.join(parts)}</ul>" if parts else ""
