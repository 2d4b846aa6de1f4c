"""Golden results: digests of flights, the files they are kept in, and what differs in words."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from golden_campaigns import SEARCHES, finds
from golden_cases import cases

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Trace
from saflite.contract.test_case import TestCase

FOLDER = Path(__file__).resolve().parent
FLIGHTS_FILE, FINDS_FILE = FOLDER / "golden_flights.json", FOLDER / "golden_finds.json"
SHORT, SHOWN = 16, 8

Entry = dict[str, Any]


def fly(test_case: TestCase) -> Entry:
    """Return how a flight of the reference target ended and the digests of its trace."""
    record = fly_once(test_case)
    assert record.trace is not None, record.message
    trace = record.trace
    return {
        "ending": record.ending,
        "simulated_s": round(trace.duration_s, 6),
        "samples": trace.samples,
        "digest": digest(trace),
        "parts": {name: hashlib.sha256(data).hexdigest()[:SHORT] for name, data in parts(trace).items()},
    }


def parts(trace: Trace) -> dict[str, bytes]:
    """Return what a trace holds by name: its step, its messages, its signals."""
    messages = [[message.at_s, message.severity, message.text] for message in trace.messages]
    first = {"(step)": repr(trace.step_s).encode(), "(messages)": json.dumps(messages).encode()}
    return first | {name: trace.signals[name] for name in sorted(trace.signals)}


def digest(trace: Trace) -> str:
    """Return the SHA-256 of all a trace holds, whatever form it travels in."""
    whole = hashlib.sha256()
    for name, data in parts(trace).items():
        whole.update(f"{name} {len(data)}\n".encode())
        whole.update(data)
    return whole.hexdigest()


def flight_differences(golden: Entry, now: Entry) -> list[str]:
    """Return in words where a flight differs from the golden one; nothing if it does not."""
    told = [
        f"{word}: golden {golden[word]}, now {now[word]}"
        for word in ("ending", "simulated_s", "samples")
        if golden[word] != now[word]
    ]
    then, new = golden["parts"], now["parts"]
    for what, names in (
        ("moved", [name for name in then if name in new and then[name] != new[name]]),
        ("gone", [name for name in then if name not in new]),
        ("added", [name for name in new if name not in then]),
    ):
        if names:
            rest = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            told.append(f"signals {what}: {', '.join(names[:SHOWN])}{rest}")
    return told or ([] if golden["digest"] == now["digest"] else ["the digest alone: parts were left out of it"])


def find_differences(golden: Sequence[Entry], now: Sequence[Entry]) -> list[str]:
    """Return in words the first flight of a search that differs; nothing if none does."""
    told = [] if len(golden) == len(now) else [f"flights: golden {len(golden)}, now {len(now)}"]
    for then, new in zip(golden, now, strict=False):
        words = [f"{word}: golden {then[word]}, now {new[word]}" for word in then if then[word] != new[word]]
        if words:
            return [*told, f"first at round {then['round']}, rank {then['rank']}", *words]
    return told


def load(path: Path) -> dict[str, Any]:
    """Return a golden file."""
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def write() -> None:
    """Fly everything and write both files anew."""
    _write(FLIGHTS_FILE, {name: fly(case) for name, case in cases().items()})
    _write(FINDS_FILE, {name: finds(name) for name in SEARCHES})


def _write(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
