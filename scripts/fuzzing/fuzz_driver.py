"""Say anything to every service, hand any file to every command, and count it; an exception is a failure.

A dictionary of values that have broken programs before, and small changes, are put into single places of valid
messages: by a peer that has joined and holds real leases, by books that hand out real work, by model servers that
answer real questions. Files are made wrong the same way, and read by what the commands read them with (`files.py`).
"""

from __future__ import annotations

import argparse
import json
import logging
import secrets
import signal
import subprocess
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
TOLD_EVERY_S = 60.0


class Counts:
    """What was said and what came of it."""

    def __init__(self) -> None:
        self.said: Counter[str] = Counter()
        self.before: Counter[str] = Counter()  # in earlier runs that this one goes on from
        self.failed: dict[tuple[str, str], tuple[int, str]] = {}
        self.slice_s = 0.0  # what the last turn took
        self.keep: Path | None = None
        self.unfinished: list[str] = []  # kinds that time was too short for
        self.stopped = False  # by Ctrl-C or SIGTERM: ends after the message or file under way

    def all_of(self, kind: str) -> int:
        """Return how many of a kind were said, in this run and those before."""
        return self.said[kind] + self.before[kind]

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


def fuzz(
    kinds: list[str], seconds: float, count: int, rng_seed: int, keep: Path | None = None, counts: Counts | None = None
) -> Counts:
    """Say messages and hand in files of all kinds until there were `count` of each, or the time is up.

    Whatever kind has had the least time so far is next; the time a service takes to come up is not counted. Each kind
    has random numbers of its own: what is said depends on `rng_seed` alone, how much of it on the time at most.
    """
    counts, under_way = counts or Counts(), dict[str, Fuzzed]()
    counts.keep = keep
    replay(kinds, counts)
    rngs = {kind: derive(rng_seed, "fuzz", kind) for kind in kinds}
    until_s = time.monotonic() + seconds
    spent_s = dict.fromkeys(kinds, 0.0)
    told_s = time.monotonic()
    while spent_s and time.monotonic() < until_s and not counts.stopped:
        kind = min(spent_s, key=lambda one: spent_s[one])
        _say_for_a_while(kind, rngs[kind], under_way, counts, count)
        spent_s[kind] += counts.slice_s
        if counts.all_of(kind) >= count:
            del spent_s[kind]
            _close(kind, under_way, counts)
            print(f"{kind:22} {counts.all_of(kind):9d}  done", flush=True)
        if time.monotonic() > told_s + TOLD_EVERY_S:
            told_s = time.monotonic()
            fewest = min(spent_s, key=counts.all_of, default=kind)
            print(
                f"{counts.said.total()} so far, {len(spent_s)} kinds to go, fewest: {fewest} {counts.all_of(fewest)}, "
                f"{len(counts.failed)} kinds of failures",
                flush=True,
            )
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
        while time.monotonic() < began_s + SLICE_S and counts.all_of(kind) < count and not counts.stopped:
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


def _tell(counts: Counts) -> None:
    for kind, said in counts.said.items():
        print(f"{kind:22} {said:9d}")
    for (kind, place), (times, trace) in list(counts.failed.items())[:SHOWN_MAX]:
        print(f"\nFAILED {times} times: {kind}: {place}\n{trace}")
    for (kind, place), (times, _) in counts.failed.items():
        print(f"FAILED {kind}: {place}, {times} times")
    if counts.unfinished:
        print(f"the time was too short for all of: {', '.join(counts.unfinished)}")


def _add_row(counts: Counts, options: argparse.Namespace) -> None:
    """Append one line: the commit, what was asked for, how many of each kind were said, and what failed."""
    words = ["git", "-C", str(HERE), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(words, check=False, capture_output=True, text=True)
    row = {
        "commit": commit.stdout.strip(),
        "date": time.strftime("%Y-%m-%d"),
        "rng_seed": options.rng_seed,
        "count": options.count,
        "cpu_s": round(time.process_time(), 1),
        "said": dict(counts.said),
        "unfinished": counts.unfinished,
        "failed": {f"{kind}: {place}": times for (kind, place), (times, _) in counts.failed.items()},
    }
    with options.row.open("a") as file:
        file.write(json.dumps(row) + "\n")


def main(argv: list[str]) -> int:
    """Fuzz, print the counts, and return 0 if nothing raised."""
    text = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__.splitlines()[0])
    text.add_argument("--seconds", type=float, default=60.0, help="for how long at most (default 60)")
    text.add_argument("--count", type=int, default=FOREVER, help="messages or files of each kind after which it ends")
    text.add_argument("--kinds", default="", help="only kinds that begin so, separated by commas")
    text.add_argument("--keep", type=Path, metavar="DIR", help="write the first file of each kind of failure there")
    text.add_argument("--row", type=Path, metavar="FILE", help="append what came of it as one line of JSON")
    text.add_argument(
        "--go-on", action="store_true", help="count what the rows of --row hold; --count is of all together"
    )
    text.add_argument("--rng-seed", type=int, default=1, help="the same seed and count say the same (default 1)")
    text.add_argument("--fresh", action="store_true", help="draw a seed; it is printed")
    options = text.parse_args(argv)
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    if options.fresh:
        options.rng_seed = secrets.randbelow(2**31)
    wanted = tuple(options.kinds.split(",")) if options.kinds else ("",)
    counts = Counts()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: setattr(counts, "stopped", True))
    if options.go_on and options.row is not None and options.row.is_file():
        for line in options.row.read_text().splitlines():
            counts.before.update(json.loads(line)["said"])
    fuzz(
        [kind for kind in KINDS if kind.startswith(wanted) and counts.all_of(kind) < options.count],
        options.seconds,
        options.count,
        options.rng_seed,
        options.keep,
        counts,
    )
    _tell(counts)
    if options.row is not None:
        _add_row(counts, options)
    said, kinds = counts.said.total(), len(counts.said)
    failed = f"{len(counts.failed)} kinds of failures"
    print(f"{said} wrong messages and files of {kinds} kinds, {failed} (--rng-seed {options.rng_seed})")
    return 1 if counts.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
