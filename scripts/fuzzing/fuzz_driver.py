"""Say anything to every service, as a valid peer, and count what it says; an exception in a service is a failure.

A dictionary of values that have broken programs before, and small changes, are put into single places of valid
messages: by a peer that has joined and holds real leases, by books that hand out real work, by model servers that
answer real questions.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "tests" / "farm")]

from kinds import KINDS, SAYERS, Fuzzed, Sayer  # noqa: E402

from corpus import kept  # noqa: E402
from saflite.contract.rng import derive  # noqa: E402

SLICE_S = 0.5
SHOWN_MAX = 5


class Counts:
    """What was said and what came of it."""

    def __init__(self) -> None:
        self.said: Counter[str] = Counter()
        self.failed: dict[tuple[str, str], tuple[int, str]] = {}

    def note(self, kind: str, fault: BaseException) -> None:
        """Note an exception, by kind and place."""
        frames = [frame for frame in traceback.extract_tb(fault.__traceback__) if "saflite" in frame.filename]
        place = f"{frames[-1].filename.rpartition('saflite/')[2]}:{frames[-1].lineno}" if frames else "?"
        key = kind, f"{type(fault).__name__} in {place}"
        count = self.failed.get(key, (0, ""))[0]
        self.failed[key] = count + 1, "".join(traceback.format_exception(fault))


def fuzz(kinds: list[str], seconds: float, count: int, rng_seed: int) -> Counts:
    """Say messages of all kinds in turns until the time is up, or `count` of each were said."""
    counts, under_way = Counts(), dict[str, Fuzzed]()
    replay(kinds, counts)
    rngs = {kind: derive(rng_seed, "fuzz", kind) for kind in kinds}
    until_s = time.monotonic() + seconds
    left = list(kinds)
    while left and time.monotonic() < until_s:
        for kind in list(left):
            slice_s = min(time.monotonic() + SLICE_S, until_s)
            while time.monotonic() < slice_s and counts.said[kind] < count:
                try:
                    if kind not in under_way:
                        under_way[kind] = KINDS[kind](rngs[kind])
                    counts.said[kind] += under_way[kind].step()
                except Exception as fault:  # noqa: BLE001 (what we are looking for)
                    counts.note(kind, fault)
                    under_way.pop(kind, None)
            if counts.said[kind] >= count:
                left.remove(kind)
                _close(kind, under_way, counts)
    for kind in list(under_way):
        _close(kind, under_way, counts)
    return counts


def replay(kinds: list[str], counts: Counts) -> None:
    """Say what is kept in the corpus."""
    sayers: dict[str, Sayer] = {}
    for message in kept():
        if message.kind not in kinds:
            continue
        try:
            sayer = sayers.setdefault(message.kind, SAYERS[message.kind](derive(0, message.kind)))
            sayer.say(message.edits)
            counts.said["corpus"] += 1
        except Exception as fault:  # noqa: BLE001 (as above)
            counts.note(f"corpus {message.kind} {message.edits}"[:200], fault)
            sayers.pop(message.kind, None)
    for kind, sayer in sayers.items():
        try:
            sayer.close()
        except Exception as fault:  # noqa: BLE001 (as above)
            counts.note(f"corpus {kind}", fault)


def _close(kind: str, under_way: dict[str, Fuzzed], counts: Counts) -> None:
    try:
        if kind in under_way:
            under_way.pop(kind).close()
    except Exception as fault:  # noqa: BLE001 (what we are looking for)
        counts.note(kind, fault)


def main(argv: list[str]) -> int:
    """Fuzz, print the counts, and return 0 if nothing raised."""
    text = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__.splitlines()[0])
    text.add_argument("--seconds", type=float, default=60.0, help="for how long (default 60)")
    text.add_argument("--count", type=int, default=10**9, help="messages of each kind after which it ends")
    text.add_argument("--kinds", default="", help="only kinds that begin so, separated by commas")
    text.add_argument("--rng-seed", type=int, default=1)
    options = text.parse_args(argv)
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    wanted = tuple(options.kinds.split(",")) if options.kinds else ("",)
    counts = fuzz([kind for kind in KINDS if kind.startswith(wanted)], options.seconds, options.count, options.rng_seed)
    for kind, said in counts.said.items():
        print(f"{kind:22} {said:9d} wrong messages")
    for (kind, place), (times, trace) in list(counts.failed.items())[:SHOWN_MAX]:
        print(f"\nFAILED {times} times: {kind}: {place}\n{trace}")
    for (kind, place), (times, _) in counts.failed.items():
        print(f"FAILED {kind}: {place}, {times} times")
    print(f"{counts.said.total()} wrong messages of {len(counts.said)} kinds, {len(counts.failed)} kinds of failures")
    return 1 if counts.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
