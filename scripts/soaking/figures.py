"""What came of a soak: the audit of the store and the times it took to notice and to recover."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from field import Field
from rogue import Rogue
from saflite.campaign.audit import audit

from saflite.contract.events import WorkerChanged

if TYPE_CHECKING:
    from siege import Injected

NOTICED_WITHIN_S = 30.0


def figures_of(
    field: Field, injected: Sequence[Injected], rogue: Rogue, left: list[str], ended: bool
) -> dict[str, Any]:
    """Return all figures, the audit's included."""
    counts = Counter(fault.kind for fault in injected)
    from_cases = _attempts_that(field, "lost", "wedged")
    return {
        "faults_injected": len(injected),
        "faults_by_kind": dict(sorted(counts.items())),
        "not_possible_here": _not_possible(field, counts),
        "attempts_lost": from_cases.get("lost", 0),
        "attempts_wedged": from_cases.get("wedged", 0),
        "campaign_ended": ended,
        "orphan_processes": left,
        "restarts": field.farm.restarts,
        "events_watched": len(field.watcher.events),
        "events_without_gap_or_double": field.watcher.is_gapless() and not field.watcher.trouble,
        "damaged_messages_taken": rogue.damaged_taken,
        "garbage_scores_taken": rogue.garbage_taken,
        "replays_sent": rogue.replays,
        "replays_taken": rogue.replays_taken,
        "frozen_worker_noticed_s": _spread(_noticed(field, [fault for fault in injected if "freeze" in fault.kind])),
        "killed_worker_noticed_s": _spread(_noticed(field, [fault for fault in injected if "kill" in fault.kind])),
        "work_freed_after_s": _spread(_freed(field, injected)),
        "books_rebuilt_in_s": _spread(_rebuilt(field)),
        "books_back_after_kill_s": _spread(_away(field, injected)),
        "audit": audit(field.run_dir),
    }


def is_clean(figures: dict[str, Any]) -> bool:
    """Return whether nothing was lost, doubled, taken in by mistake or left behind."""
    return (
        figures["campaign_ended"]
        and not figures["orphan_processes"]
        and figures["events_without_gap_or_double"]
        and not figures["damaged_messages_taken"]
        and not figures["garbage_scores_taken"]
        and not figures["replays_taken"]
        and bool(figures["audit"]["clean"])
    )


def _spread(values: Sequence[float]) -> dict[str, float | int]:
    if not values:
        return {"count": 0}
    p50, p95 = np.percentile(values, [50, 95])
    return {
        "count": len(values),
        "p50": round(float(p50), 3),
        "p95": round(float(p95), 3),
        "max": round(max(values), 3),
    }


def _not_possible(field: Field, counts: Counter[str]) -> list[str]:
    reasons = {"cut network": field.network.why_not, "fill disk": field.disk.why_not}
    return [f"{kind}: {why}" for kind, why in reasons.items() if why and not counts[kind]]


def _noticed(field: Field, injected: Sequence[Injected]) -> list[float]:
    """Return how long after a fault to a worker the books announced that it was gone."""
    waits: list[float] = []
    for fault in injected:
        for at_s, event in field.watcher.events:
            fact = event.fact
            gone = isinstance(fact, WorkerChanged) and fact.worker == fault.whom and not fact.present
            if gone and 0 <= at_s - fault.at_s < NOTICED_WITHIN_S:
                waits.append(at_s - fault.at_s)
                break
    return waits


def _freed(field: Field, injected: Sequence[Injected]) -> list[float]:
    """Return how long after a fault the work the worker held was free for others."""
    waits: list[float] = []
    rows = _query(field, "SELECT worker, from_unix_s, to_unix_s FROM attempts WHERE how = 'lost'")
    for fault in injected:
        ends = [end for worker, start, end in rows if worker == fault.whom and start <= fault.at_unix_s <= end]
        if ends:
            waits.append(min(ends) - fault.at_unix_s)
    return waits


def _attempts_that(field: Field, *how: str) -> dict[str, int]:
    rows = _query(field, "SELECT how, count(*) FROM attempts GROUP BY how")
    return {word: int(count) for word, count in rows if word in how}


def _query(field: Field, sql: str) -> list[tuple[Any, ...]]:
    connection = sqlite3.connect(f"file:{field.run_dir / 'books.sqlite'}?mode=ro", uri=True)
    try:
        return connection.execute(sql).fetchall()
    finally:
        connection.close()


def _rebuilt(field: Field) -> list[float]:
    text = (field.run_dir / "logs" / "books.log").read_text(errors="replace")
    return [float(word) for word in re.findall(r"rebuilt in ([0-9.]+) s", text)]


def _away(field: Field, injected: Sequence[Injected]) -> list[float]:
    """Return for how long the books did not answer after they were killed."""
    answers = field.prober.answers_s
    waits: list[float] = []
    for fault in injected:
        if fault.kind.startswith("kill books"):
            later = [at_s for at_s in answers if at_s > fault.at_s + 0.05]
            waits += [later[0] - fault.at_s] if later else []
    return waits
