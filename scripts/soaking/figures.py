"""What came of a soak: the audit of the store and the times it took to notice and to recover."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from byzantine_client import ByzantineClient
from faults import Injected
from testbed import Testbed

from saflite.campaign.storage.audit import audit
from saflite.contract.events import WorkerChanged

NOTICED_WITHIN_S = 30.0
APART_S = 4.0
CENTRE = ("books", "router", "network", "disk")


def figures_of(
    testbed: Testbed, injected: Sequence[Injected], clients: Sequence[ByzantineClient], left: list[str], ended: bool
) -> dict[str, Any]:
    """Return all figures, the audit's included."""
    kinds = (*ByzantineClient.FALSE_RESULTS, *ByzantineClient.DAMAGE)
    counts = Counter(fault.kind for fault in injected if fault.kind not in kinds)
    for client in clients:
        counts += Counter(client.committed)
    from_cases = _attempts_that(testbed, "lost", "wedged")
    return {
        "faults_injected": counts.total(),
        "faults_by_kind": dict(sorted(counts.items())),
        "not_possible_here": _not_possible(testbed, counts),
        "attempts_lost": from_cases.get("lost", 0),
        "attempts_wedged": from_cases.get("wedged", 0),
        "campaign_ended": ended,
        "orphan_processes": left,
        "restarts": testbed.farm.restarts,
        "events_watched": len(testbed.watcher.events),
        "events_without_gap_or_double": testbed.watcher.is_gapless() and not testbed.watcher.trouble,
        "damaged_messages_taken": sum(client.damaged_taken for client in clients),
        "garbage_scores_taken": sum(client.garbage_taken for client in clients),
        "replays_sent": sum(client.replays for client in clients),
        "replays_taken": sum(client.replays_taken for client in clients),
        "rogue_messages": sum(client.rogue for client in clients),
        "books_broke": _broke(testbed),
        "frozen_worker_noticed_s": _spread(_noticed(testbed, _alone(injected, "freeze"))),
        "killed_worker_noticed_s": _spread(_noticed(testbed, _alone(injected, "kill"))),
        "work_freed_after_s": _spread(_freed(testbed, _alone(injected, ""))),
        "books_rebuilt_in_s": _spread(_rebuilt(testbed)),
        "books_back_after_kill_s": _spread(_away(testbed, injected)),
        "audit": audit(testbed.run_dir),
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
        and not figures["books_broke"]
        and not figures["damaged_blocks"]["silent"]
        and figures["fuzz"]["clean"]
        and not figures["forged_messages"]["taken"]
        and figures["forged_messages"]["own_result_after_them"] == "accepted"
        and bool(figures["audit"]["clean"])
    )


def _broke(testbed: Testbed) -> int:
    """Return how often the books died of their own code: a kill leaves no traceback."""
    text = (testbed.run_dir / "logs" / "books.log").read_text(errors="replace")
    return text.count("Traceback (most recent call last)")


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


def _not_possible(testbed: Testbed, counts: Counter[str]) -> list[str]:
    reasons = {"cut network": testbed.network.why_not, "fill disk": testbed.disk.why_not}
    return [f"{kind}: {why}" for kind, why in reasons.items() if why and not counts[kind]]


def _alone(injected: Sequence[Injected], kind: str) -> list[Injected]:
    """Return the faults of a kind to workers while books, router, network and disk were well."""
    to_workers = [
        fault for fault in injected if fault.whom.rpartition("-")[2].isdigit() and "simulator" not in fault.kind
    ]
    workers = [fault for fault in to_workers if kind in fault.kind]
    centre = [fault for fault in injected if any(word in fault.kind for word in CENTRE)]
    return [
        fault
        for fault in workers
        if not any(ill.at_s < fault.at_s + APART_S and fault.at_s < ill.until_s + APART_S for ill in centre)
    ]


def _noticed(testbed: Testbed, injected: Sequence[Injected]) -> list[float]:
    """Return how long after a fault to a worker the books wrote down that it was gone."""
    waits: list[float] = []
    for fault in injected:
        if not _was_there(testbed, fault):
            continue
        for _, event in testbed.watcher.events:
            fact, wait_s = event.fact, event.at_unix_s - fault.at_unix_s
            gone = isinstance(fact, WorkerChanged) and fact.worker == fault.whom and not fact.present
            if gone and -0.01 <= wait_s < NOTICED_WITHIN_S:
                waits.append(max(0.0, wait_s))
                break
    return waits


def _was_there(testbed: Testbed, fault: Injected) -> bool:
    """Return whether the worker had joined when the fault hit it (it may have been on its way back)."""
    facts = [event.fact for _, event in testbed.watcher.events if event.at_unix_s < fault.at_unix_s]
    changes = [fact for fact in facts if isinstance(fact, WorkerChanged) and fact.worker == fault.whom]
    return bool(changes) and changes[-1].present


def _freed(testbed: Testbed, injected: Sequence[Injected]) -> list[float]:
    """Return how long after a fault the work the worker held was free for others."""
    waits: list[float] = []
    rows = _query(testbed, "SELECT worker, from_unix_s, to_unix_s FROM attempts WHERE how = 'lost'")
    for fault in injected:
        held = [to_s for worker, from_s, to_s in rows if worker == fault.whom and from_s <= fault.at_unix_s <= to_s]
        waits += [min(held) - fault.at_unix_s] if held else []
    return waits


def _attempts_that(testbed: Testbed, *how: str) -> dict[str, int]:
    rows = _query(testbed, "SELECT how, count(*) FROM attempts GROUP BY how")
    return {word: int(count) for word, count in rows if word in how}


def _query(testbed: Testbed, sql: str) -> list[tuple[Any, ...]]:
    connection = sqlite3.connect(f"file:{testbed.run_dir / 'books.sqlite'}?mode=ro", uri=True)
    try:
        return connection.execute(sql).fetchall()
    finally:
        connection.close()


def _rebuilt(testbed: Testbed) -> list[float]:
    text = (testbed.run_dir / "logs" / "books.log").read_text(errors="replace")
    return [float(word) for word in re.findall(r"rebuilt in ([0-9.]+) s", text)]


def _away(testbed: Testbed, injected: Sequence[Injected]) -> list[float]:
    """Return for how long the books did not answer after they were killed (and nothing else was done to the centre)."""
    answers = testbed.prober.answers_s
    waits: list[float] = []
    for fault in injected:
        ills = [ill for ill in injected if ill is not fault and any(word in ill.kind for word in CENTRE)]
        alone = all(ill.at_s > fault.at_s + APART_S or ill.until_s < fault.at_s - APART_S for ill in ills)
        if fault.kind.startswith("kill books") and alone:
            later = [at_s for at_s in answers if at_s > fault.at_s + 0.05]
            waits += [later[0] - fault.at_s] if later else []
    return waits
