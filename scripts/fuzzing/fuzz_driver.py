"""Say anything to every service, hand any file to every command, and count it; an exception is a failure.

A dictionary of values that have broken programs before, and small changes, are put into single places of valid
messages: by a peer that has joined and holds real leases, by books that hand out real work, by model servers that
answer real questions. Files are made wrong the same way, and read by what the commands read them with (`files.py`).
"""

from __future__ import annotations

import argparse
import logging
import secrets
import sys
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "tests" / "farm")]

import numpy as np  # noqa: E402
from files import Files  # noqa: E402
from files import kept as kept_files  # noqa: E402
from kinds import FILE, KINDS, SAYERS, Fuzzed, Sayer  # noqa: E402

from corpus import kept  # noqa: E402
from saflite.contract.ids import digest  # noqa: E402
from saflite.contract.rng import derive  # noqa: E402

FOREVER = 10**9  # messages
SLICE_S = 0.5
SHOWN_MAX = 5


class Counts:
    """What was said and what came of it."""

    def __init__(self) -> None:
        self.said: Counter[str] = Counter()
        self.failed: dict[tuple[str, str], tuple[int, str]] = {}
        self.slice_s = 0.0  # what the last turn took
        self.keep: Path | None = None
        self.unfinished: list[str] = []  # kinds that time was too short for

    def note(self, kind: str, fault: BaseException, data: bytes = b"") -> None:
        """Note an exception, by kind and place; the file that led to it is kept, if there is a folder for that."""
        frames = [frame for frame in traceback.extract_tb(fault.__traceback__) if "saflite" in frame.filename]
        place = f"{frames[-1].filename.rpartition('saflite/')[2]}:{frames[-1].lineno}" if frames else "?"
        key = kind, f"{type(fault).__name__} in {place}"
        count = self.failed.get(key, (0, ""))[0]
        if self.keep is not None and data and not count:
            folder = self.keep / kind.removeprefix(FILE)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / digest(data)[:16]).write_bytes(data)
        self.failed[key] = count + 1, "".join(traceback.format_exception(fault))


def fuzz(kinds: list[str], seconds: float, count: int, rng_seed: int, keep: Path | None = None) -> Counts:
    """Say messages and hand in files of all kinds until there were `count` of each, or the time is up.

    Whatever kind has had the least time so far is next; the time a service takes to come up is not counted. Each kind
    has random numbers of its own: what is said depends on `rng_seed` alone, how much of it on the time at most.
    """
    counts, under_way = Counts(), dict[str, Fuzzed]()
    counts.keep = keep
    replay(kinds, counts)
    rngs = {kind: derive(rng_seed, "fuzz", kind) for kind in kinds}
    until_s = time.monotonic() + seconds
    spent_s = dict.fromkeys(kinds, 0.0)
    while spent_s and time.monotonic() < until_s:
        kind = min(spent_s, key=lambda one: spent_s[one])
        _say_for_a_while(kind, rngs[kind], under_way, counts, count)
        spent_s[kind] += counts.slice_s
        if counts.said[kind] >= count:
            del spent_s[kind]
            _close(kind, under_way, counts)
    counts.unfinished = [kind for kind in spent_s if count < FOREVER]
    for kind in list(under_way):
        _close(kind, under_way, counts)
    return counts


def _say_for_a_while(
    kind: str, rng: np.random.Generator, under_way: dict[str, Fuzzed], counts: Counts, count: int
) -> None:
    began_s = time.monotonic()
    try:
        if kind not in under_way:
            under_way[kind] = KINDS[kind](rng)
        counts.said[kind] += under_way[kind].step()  # the first one may bring a service up
        began_s = time.monotonic()
        while time.monotonic() < began_s + SLICE_S and counts.said[kind] < count:
            counts.said[kind] += under_way[kind].step()
    except Exception as fault:  # noqa: BLE001 (what we are looking for)
        counts.note(kind, fault, getattr(under_way.pop(kind, None), "last", b""))
    counts.slice_s = max(time.monotonic() - began_s, 1e-3)


def replay(kinds: list[str], counts: Counts) -> None:
    """Say and hand in what is kept in the corpus."""
    _replay_files(kinds, counts)
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


def _replay_files(kinds: list[str], counts: Counts) -> None:
    for kind, path in kept_files():
        if FILE + kind not in kinds:
            continue
        reader = Files(kind, derive(0, kind))
        try:
            reader.take(path.read_bytes())
            counts.said["corpus"] += 1
        except Exception as fault:  # noqa: BLE001 (as above)
            counts.note(f"corpus {kind} {path.name}", fault)
        reader.close()


def _close(kind: str, under_way: dict[str, Fuzzed], counts: Counts) -> None:
    try:
        if kind in under_way:
            under_way.pop(kind).close()
    except Exception as fault:  # noqa: BLE001 (what we are looking for)
        counts.note(kind, fault)


def main(argv: list[str]) -> int:
    """Fuzz, print the counts, and return 0 if nothing raised."""
    text = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__.splitlines()[0])
    text.add_argument("--seconds", type=float, default=60.0, help="for how long at most (default 60)")
    text.add_argument("--count", type=int, default=FOREVER, help="messages or files of each kind after which it ends")
    text.add_argument("--kinds", default="", help="only kinds that begin so, separated by commas")
    text.add_argument("--keep", type=Path, metavar="DIR", help="write the first file of each kind of failure there")
    text.add_argument("--rng-seed", type=int, default=1, help="the same seed and count say the same (default 1)")
    text.add_argument("--fresh", action="store_true", help="draw a seed; it is printed")
    options = text.parse_args(argv)
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    if options.fresh:
        options.rng_seed = secrets.randbelow(2**31)
    wanted = tuple(options.kinds.split(",")) if options.kinds else ("",)
    counts = fuzz(
        [kind for kind in KINDS if kind.startswith(wanted)],
        options.seconds,
        options.count,
        options.rng_seed,
        options.keep,
    )
    for kind, said in counts.said.items():
        print(f"{kind:22} {said:9d}")
    for (kind, place), (times, trace) in list(counts.failed.items())[:SHOWN_MAX]:
        print(f"\nFAILED {times} times: {kind}: {place}\n{trace}")
    for (kind, place), (times, _) in counts.failed.items():
        print(f"FAILED {kind}: {place}, {times} times")
    if counts.unfinished:
        print(f"the time was too short for all of: {', '.join(counts.unfinished)}")
    said, kinds = counts.said.total(), len(counts.said)
    failed = f"{len(counts.failed)} kinds of failures"
    print(f"{said} wrong messages and files of {kinds} kinds, {failed} (--rng-seed {options.rng_seed})")
    return 1 if counts.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
