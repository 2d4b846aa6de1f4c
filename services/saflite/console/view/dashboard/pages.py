"""The pages of the dashboard as HTML: all runs, and one run. Everything that came from elsewhere is escaped."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from saflite.console.view.dashboard.access import Role
from saflite.console.view.dashboard.source import Figures, Head, Source
from saflite.console.view.html_text import escape
from saflite.console.view.report.page import duration, html_table
from saflite.contract.clock import in_utc
from saflite.contract.errors import FarmError
from saflite.contract.verdict import Violation, failed_again, worst_first

KEYS = (
    *(("j", "next find"), ("k", "find before"), ("Enter", "open it"), ("Esc", "close it"), ("/", "filter")),
    *(("p", "pause or resume"), ("d", "dark or light"), ("r", "all runs"), ("?", "these keys")),
)
FINDS_SHOWN = 500
"""Rows of the table of finds, confirmed and worst first: a page of bounded size, whatever the run found."""


def day_of(unix_s: float) -> str:
    """Return a moment in words, in UTC."""
    return in_utc(unix_s).strftime("%Y-%m-%d %H:%M UTC")


def document(title: str, body: str, *, role: Role, run: str = "") -> str:
    """Return a whole page."""
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)} · SaFliTe Farm</title>"
        '<link rel="icon" href="data:,"><link rel="stylesheet" href="/assets/style.css">'
        '<script defer src="/assets/script.js"></script>'
    )
    rows = "".join(f"<tr><td><kbd>{key}</kbd></td><td>{text}</td></tr>" for key, text in KEYS)
    closing = '<button class="close" aria-label="close">close</button>'
    keys = f'<dialog id="help" aria-label="keys"><h3>Keys</h3><table>{rows}</table><p>{closing}</p></dialog>'
    return (
        f'<!doctype html><html lang="en"><head>{head}</head>'
        f'<body data-role="{role}" data-run="{escape(run)}">{body}{keys}</body></html>\n'
    )


def of_run(number: int, source: Source, role: Role, *, alone: bool) -> str:
    """Return the page of one run."""
    head, figures, found = source.head(), source.figures(), source.violations(public=role != "operator")
    home = "" if alone else '<a href="/">all runs</a>'
    bar = (
        f'<header class="bar">{home}<h1>{escape(head.name)}</h1>'
        f'<span class="state" data-state="{escape(figures.state)}" role="status">{escape(figures.state)}</span>'
        '<span class="grow"></span><button id="keys" aria-label="keys">?</button>'
        '<button id="look" aria-label="dark or light">◐</button></header>'
    )
    parts = [("search", "Search"), ("coverage", ""), ("scorers", ""), ("faults", "Faults")]
    sections = "".join(
        f'<section id="{name}">{f"<h2>{title}</h2>" if title else ""}<div data-part="{name}"></div></section>'
        for name, title in parts
    )
    links = (("finds-title", "finds"), ("workers", "workers"), *((name, name) for name, _ in parts))
    nav = "".join(f'<a href="#{name}">{text}</a>' for name, text in links)
    body = (
        f"{bar}<main><p>{escape(head.description)}</p>"
        f'<p class="muted">{source.settings()}{_built(head)}</p><nav>{nav}</nav>'
        f"{_tiles(figures)}{_orders() if role == 'operator' else ''}"
        f'<h2 id="finds-title">Behaviours found</h2><div id="finds">{finds(found)}</div>'
        f"{_workers()}{sections}</main>{_dialog()}"
    )
    return document(head.name, body, role=role, run=str(number))


def _built(head: Head) -> str:
    began = f" · begun {day_of(head.began_unix_s)}" if head.began_unix_s else ""
    return escape(f" · build {head.build[:12]}{began}" if head.build else began)


def _tiles(now: Figures) -> str:
    tiles = (
        ("behaviours", str(now.behaviours), "behaviours confirmed", ""),
        ("finds", str(now.finds), "finds of them", ""),
        ("flaky", str(now.flaky), "flaky", ""),
        ("flights", f"{now.flights} of {now.budget}", "flights of the budget", ""),
        ("reflown", str(now.reflown), "flights more to confirm", ""),
        ("elapsed", duration(now.elapsed_s), "since the start", ""),
        ("eta", "–", "to go, about", "data-live hidden"),
        ("rate", "–", "flights a second", "data-live hidden"),
        ("speed", "–", "real time, all workers", "data-live hidden"),
        ("scorer", "–", "scorer", "data-live hidden"),
        ("queues", "–", "waiting", "data-live hidden"),
    )
    drawn = "".join(
        f'<div class="tile" {flags}><b data-figure="{name}">{escape(value)}</b><span>{text}</span></div>'
        for name, value, text, flags in tiles
    )
    return f'<div class="tiles">{drawn}</div><p class="hard" data-figure="trouble"></p>'


def _orders() -> str:
    return (
        '<div class="orders" data-live hidden><button id="pause">pause</button><button id="stop">stop</button>'
        '<form id="budget"><input type="number" name="number" min="1" placeholder="budget" aria-label="budget">'
        '<button>set</button></form><form id="scorer"><select name="role_" aria-label="role of the scorer">'
        '<option value="scorer">decides</option><option value="shadow">shadow</option></select>'
        '<input name="model" placeholder="scorer, e.g. gap" aria-label="scorer"><button>use</button></form>'
        '</div><p id="said" class="muted" role="status"></p>'
    )


def _workers() -> str:
    heads = ("worker", "stage", "state", "done", "busy", "silent", "memory", "host", "build")
    return f'<section id="workers" hidden><h2>Workers</h2>{html_table(heads, ())}</section>'


def _dialog() -> str:
    closing = '<button class="close" aria-label="close">close</button>'
    return f'<dialog id="find" aria-label="find"><p>{closing}</p><div id="find-content"></div></dialog>'


def finds(found: Sequence[Violation]) -> str:
    """Return the table of finds, confirmed and worst first; a row opens its evidence."""
    if not found:
        return '<p class="quiet">No violation was found.</p>'
    ranked = sorted(found, key=worst_first)
    rows = []
    for one in ranked[:FINDS_SHOWN]:
        cells = (
            f"<code>{escape(one.fingerprint[:8])}</code>",
            escape(one.policy),
            f"{one.robustness:+.3f}",
            f'<span class="badge {one.severity}">{one.severity}</span>',
            f'<span class="badge {one.confirmation}">{one.confirmation}</span>',
            escape(_way(one)),
            f'<span class="words">{escape(failed_again(one))}</span>',
        )
        row = "".join(f"<td>{cell}</td>" for cell in cells)
        rows.append(f'<tr class="find" data-find="{escape(one.test_case)}">{row}</tr>')
    left = len(ranked) - len(rows)
    more = "" if left == 0 else f'<p class="muted">and {left} more: <code>saflite export RUN --format csv</code></p>'
    heads = ("find", "policy", "robustness", "severity", "confirmation", "behaviour", "re-flown")
    return html_table(heads, rows) + more


def _way(one: Violation) -> str:
    return one.behaviour.removeprefix(f"{one.policy}, {one.severity}, ")


class _Run(NamedTuple):
    """A run among others: its place in time, its number in the address, what it holds, or why it tells nothing."""

    place: int
    number: int
    head: Head
    now: Figures | None
    found: Sequence[Violation] = ()
    fault: str = ""


def of_all(sources: Sequence[Source], role: Role) -> str:
    """Return the page of several runs: when, on what, what was found, and each behaviour over them.

    One that cannot be read is named with the reason, and stands in nobody's way.
    """
    order = sorted(range(len(sources)), key=lambda at: sources[at].head().began_unix_s)
    runs = [_looked_at(place, at, sources[at], role) for place, at in enumerate(order, start=1)]
    table = html_table(
        ("", "run", "campaign", "begun", "target", "build", "state", "flights", "behaviours", "finds", "flaky"),
        [_row(run) for run in runs],
    )
    body = (
        '<header class="bar"><h1>Runs</h1><span class="grow"></span><button id="keys" aria-label="keys">?</button>'
        '<button id="look" aria-label="dark or light">◐</button></header>'
        f"<main>{table}{_matrix([run for run in runs if not run.fault])}</main>"
    )
    return document("runs", body, role=role)


def _looked_at(place: int, number: int, source: Source, role: Role) -> _Run:
    head = source.head()
    try:
        return _Run(place, number, head, source.figures(), source.violations(public=role != "operator"))
    except FarmError as fault:
        return _Run(place, number, head, None, fault=str(fault))


def _row(run: _Run) -> str:
    head, now = run.head, run.now
    cells = (
        str(run.place),
        f'<a href="/run/{run.number}/">{escape(head.where or head.name)}</a>',
        escape(head.name),
        day_of(head.began_unix_s) if head.began_unix_s else "",
        escape(head.target),
        f"<code>{escape(head.build[:12])}</code>",
    )
    told = f'<td colspan="5" class="hard">{escape(run.fault)}</td>'
    if now is not None:
        figures = (escape(now.state), f"{now.flights} of {now.budget}", now.behaviours, now.finds, now.flaky)
        told = "".join(f"<td>{figure}</td>" for figure in figures)
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + told + "</tr>"


def _matrix(runs: Sequence[_Run]) -> str:
    """Return the behaviours, by words, over runs in order of time: a dot where some were found, a link to one find.

    Behaviours of one run may share their words (they differ in track or cause): the dot says how many do.
    """
    ways: dict[tuple[str, str], list[list[Violation]]] = {}
    for column, run in enumerate(runs):
        for one in sorted(run.found, key=worst_first):
            ways.setdefault((one.policy, _way(one)), [[] for _ in runs])[column].append(one)
    if not ways:
        return ""
    titles = [
        f'<a class="build" href="/run/{run.number}/" title="{escape(_named(run.head))}">{run.place}</a>' for run in runs
    ]
    rows = []
    for (policy, way), marks in sorted(ways.items()):
        cells = "".join(
            f'<td class="mark">{_mark(run.number, ones)}</td>' for run, ones in zip(runs, marks, strict=True)
        )
        rows.append(f"<tr><td>{escape(policy)}</td><td>{escape(way)}</td>{cells}</tr>")
    return (
        '<h2>Behaviours over runs</h2><p class="muted">Oldest run first, each under its number above. An empty place '
        "says that the run did not find it, not that it is gone: <code>saflite regress</code> flies it again.</p>"
        + html_table(("policy", "behaviour", *titles), rows)
    )


def _named(head: Head) -> str:
    return f"{head.where or head.name}, build {head.build[:12]}"


def _mark(number: int, ones: Sequence[Violation]) -> str:
    """Return a dot for the behaviours of a run that share their words, the best confirmed first."""
    if not ones:
        return ""
    one, many = ones[0], len({each.fingerprint for each in ones})
    css = one.confirmation if one.confirmation in ("confirmed", "flaky") else "other"
    label = escape(f"{one.confirmation}, {one.robustness:+.2f}")
    place = f"/run/{number}/#{escape(one.test_case)}"
    count = f"&thinsp;{many}" if many > 1 else ""
    return f'<a class="dot-{css}" title="{label}" aria-label="{label}" href="{place}">●{count}</a>'
