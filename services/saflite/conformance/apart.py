"""Each check in a process of its own: what code from outside does to it, hang or crash, is a finding like any other."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection

from saflite.conformance.kit import Check, findings
from saflite.contract.endings import how_ended

Found = tuple[str, list[str]]
"""A check's name, and what is wrong."""


def findings_apart(checks: Iterable[Check], limit_s: float) -> Iterator[Found]:
    """Yield what each check found; the first that does not end within `limit_s` is the last that is run."""
    for check in checks:
        found, ended = _run(check, limit_s)
        yield check.name, found
        if not ended:
            return


def _run(check: Check, limit_s: float) -> tuple[list[str], bool]:
    here, there = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=_child, args=(check, there))
    process.start()
    there.close()
    try:
        if not here.poll(limit_s):
            return [f"no end within {limit_s:g} s; what follows was not checked"], False
        return list(here.recv()), True
    except EOFError:
        process.join()
        return [f"the process that ran it died: {how_ended(process.exitcode or 0)}"], True
    finally:
        here.close()
        assert process.pid, "it was started: group 0 would be our own"
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.join()


def _child(check: Check, there: Connection) -> None:
    os.setsid()
    os.dup2(2, 1)  # what code from outside prints must not stand among our words
    sys.stdout = sys.stderr
    there.send([finding.text for finding in findings([check])])
