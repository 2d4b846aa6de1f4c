"""A thread that works and never waits is told from one that works as hard and waits between, whatever else answers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from saflite.flight.autopilots.external.spinning import Spinning

SPINS_S = 0.3
WORK = "import hashlib, sys, threading, time\nwork = lambda: hashlib.pbkdf2_hmac('sha256', b'', b'', {rounds})\n"
SPIN = WORK.format(rounds=10**9) + "threading.Thread(target=work, daemon=True).start()\nprint(); time.sleep(60)"
ODD = "import ctypes\nctypes.CDLL(None).prctl(15, b'\\xff\\x1b[2J\\nme', 0, 0, 0)\n"
WAITS = WORK.format(rounds=1000) + "print()\nwhile True: work(); time.sleep(1e-4)\n"


@contextmanager
def running(program: str) -> Iterator[Spinning]:
    with subprocess.Popen([sys.executable, "-u", "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            process.stdout.readline()
            yield Spinning(process.pid, SPINS_S)
        finally:
            process.kill()


def worked_s(spinning: Spinning) -> float:
    return spinning._looked_s


def test_a_thread_that_never_waits_is_named_while_the_others_wait() -> None:
    with running(SPIN) as spinning:
        name = ""
        while not name and worked_s(spinning) < 20.0:
            name = spinning.named()
        assert name.startswith("python")


def test_a_thread_may_have_any_bytes_for_a_name() -> None:
    with running(ODD + WORK.format(rounds=10**9) + "print(); work()") as spinning:
        name = ""
        while not name and worked_s(spinning) < 20.0:
            name = spinning.named()
        assert name == r"\xff\x1b[2J\x0ame"


def test_one_that_works_as_hard_and_waits_between_is_none() -> None:
    with running(WAITS) as spinning:
        while worked_s(spinning) < 4 * SPINS_S:
            assert spinning.named() == ""


def test_nothing_is_said_of_a_process_that_has_ended() -> None:
    with subprocess.Popen([sys.executable, "-c", "pass"]) as process:
        spinning = Spinning(process.pid, SPINS_S)
        process.wait()
        assert spinning.named() == ""
        assert Spinning(process.pid, SPINS_S).named() == ""
