"""Several threads that read messages for the first time at once: none meets a type half learnt."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import sys, threading
from contextlib import suppress
import msgspec
from saflite.contract import wire
from saflite.contract.control import Answer
from saflite.contract.errors import Refused
from saflite.contract.work import FlyWork, Grant, JudgeWork, Lease, Report

sys.setswitchinterval(1e-6)
kinds = (Grant, Report, Lease, Answer, FlyWork, JudgeWork)
together = threading.Barrier(len(kinds))

def read(kind, decode, data):
    together.wait()
    for _ in range(3):
        with suppress(Refused, msgspec.ValidationError):
            decode(data, kind)

case = {"scenario": {"obstacles": [{"x_m": 1}], "start": {"mode": "x"}}}
grant = {"leases": [{"lease_id": "a", "epoch": 1, "lease_s": 1.0, "work": {"type": "fly", "test_case": case}}]}
ways = {
    "msgpack": (wire.decode, msgspec.msgpack.encode(grant)),
    "json": (wire.decode_json, msgspec.json.encode(grant)),
    "convert": (wire.convert, grant),
    "plain json": (wire.unpack_json, msgspec.json.encode(grant)),
}
asked = [ways[word] for word in sys.argv[1].split(",")]
threads = [
    threading.Thread(target=read, args=(kind, *asked[place % len(asked)])) for place, kind in enumerate(kinds)
]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
"""


@pytest.mark.parametrize("ways", ["msgpack", "json", "convert", "plain json", "convert,plain json,msgpack"])
def test_threads_that_read_for_the_first_time_at_once(ways: str) -> None:
    words = [sys.executable, "-c", PROGRAM, ways]
    ended = [subprocess.run(words, check=False, timeout=60).returncode for _ in range(3)]
    assert ended == [0] * 3, "without the lock, about every second one died of SIGSEGV"
