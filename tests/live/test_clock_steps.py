"""The machine's time is set while a farm works, back by an hour, on by days; and the machine itself sleeps.

A library of ours, preloaded, gives every process of the farm the wall clock that a file says. What runs on the
monotonic clock does not notice; certificates, which run on wall time, end with the words that say so.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from saflite.bus import keyring
from saflite.runtime.client import read_info

pytestmark = pytest.mark.live

CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>
static long offset_s(void) {
    char text[32] = {0};
    int file = open(getenv("OFFSET_FILE"), O_RDONLY | O_CLOEXEC);
    if (file < 0) return 0;
    if (read(file, text, sizeof text - 1) < 0) text[0] = 0;
    close(file);
    return atol(text);
}
int clock_gettime(clockid_t id, struct timespec *at) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int got = real(id, at);
    if (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE) at->tv_sec += offset_s();
    return got;
}
time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at) *at = now.tv_sec;
    return now.tv_sec;
}
int gettimeofday(struct timeval *at, void *zone) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    at->tv_sec = now.tv_sec; at->tv_usec = now.tv_nsec / 1000;
    return 0;
}
"""
SAFLITE = [sys.executable, "-m", "saflite"]
DAY_S = 86_400


class SetClock(NamedTuple):
    """The wall clock of the processes that have `variables`."""

    file: Path
    variables: dict[str, str]

    def step(self, offset_s: float) -> None:
        """Set it to so much after the machine's."""
        part = self.file.with_suffix(".part")
        part.write_text(str(int(offset_s)))
        part.replace(self.file)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("gcc") is None:
        pytest.skip("no gcc to make the clock of")
    folder = tmp_path_factory.mktemp("clock")
    (folder / "clock.c").write_text(CLOCK)
    words = ["gcc", "-O1", "-shared", "-fPIC", "-o", str(folder / "clock.so"), str(folder / "clock.c"), "-ldl"]
    subprocess.run(words, check=True, capture_output=True)
    return folder / "clock.so"


@pytest.fixture
def clock(library: Path, tmp_path: Path) -> SetClock:
    clock = SetClock(tmp_path / "offset", {"LD_PRELOAD": str(library), "OFFSET_FILE": str(tmp_path / "offset")})
    clock.step(-5 * DAY_S)
    words = [sys.executable, "-c", "import time; print(time.time())"]
    told = subprocess.run(words, env={**os.environ, **clock.variables}, capture_output=True, text=True, check=True)
    if abs(float(told.stdout) - time.time() + 5 * DAY_S) > 60:
        pytest.skip("the clock of processes here cannot be set")
    clock.step(0)
    return clock


def started(clock: SetClock, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*SAFLITE, *words],
        env={**os.environ, **clock.variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def said(*words: str) -> str:
    return subprocess.run([*SAFLITE, *words], capture_output=True, text=True, check=False).stdout


def wait_for(what: str, run_dir: Path, farm: subprocess.Popen[str], at_least: int) -> None:
    until_s = time.monotonic() + 120.0
    while time.monotonic() < until_s:
        if farm.poll() is not None:
            raise AssertionError(farm.communicate()[0])
        text = said("control", "status", str(run_dir), "--json")
        if text and json.loads(text)["status"][what] >= at_least:
            return
    raise AssertionError(f"{what} is not {at_least}")


def test_a_clock_that_is_set_changes_nothing(clock: SetClock, tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    farm = started(clock, "run", "avoidance-m2", "--budget", "16", "--workers", "1", "--out", str(run_dir))
    try:
        for flights, offset_s in ((1, -3_600), (4, DAY_S), (8, -time.time())):
            wait_for("flights", run_dir, farm, flights)
            clock.step(offset_s)
        assert farm.wait(240) in (0, 1)
    finally:
        farm.kill()
    audit = json.loads(said("audit", str(run_dir), "--json"))
    assert audit["clean"], audit
    assert audit["attempts_issued"] == audit["attempts_by_end"]["settled"], "no lease ended for the clock's sake"
    at_s = [json.loads(line)["at_unix_s"] for line in said("watch", str(run_dir), "--from", "1", "--json").splitlines()]
    assert at_s == sorted(at_s), "the wall time of a sitting is its first, gone on with"


def test_time_that_passed_while_all_stood_still_ends_no_lease(clock: SetClock, tmp_path: Path) -> None:
    """A machine that sleeps, or a virtual one that is held: every process stands still, longer than a lease runs."""
    run_dir = tmp_path / "run"
    campaign = tmp_path / "night.toml"
    text = 'name = "night"\nmission = "mission2"\npolicies = ["min-obstacle-distance"]\nbudget_flights = 10\n'
    campaign.write_text(f"{text}[lease]\nlease_s = 6.0\n")  # shorter ones end by themselves on a busy machine
    farm = started(clock, "run", str(campaign), "--workers", "1", "--out", str(run_dir))
    try:
        wait_for("flights", run_dir, farm, 1)
        everybody = [*read_info(run_dir).processes.values(), farm.pid]
        for process in everybody:
            os.kill(process, signal.SIGSTOP)
        time.sleep(8.0)
        clock.step(7 * 3_600)
        for process in everybody:
            os.kill(process, signal.SIGCONT)
        assert farm.wait(240) in (0, 1)
    finally:
        farm.kill()
    audit = json.loads(said("audit", str(run_dir), "--json"))
    assert audit["clean"], audit
    assert audit["attempts_by_end"].keys() <= {"settled", "wedged"}, audit["attempts_by_end"]


def test_a_key_that_ends_by_the_clock_is_told_in_words(clock: SetClock, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keyring.init(keys, ["127.0.0.1"], now_s=time.time(), days=365)
    keyring.add(keys, "lab", ("worker",), now_s=time.time(), days=2)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tls/127.0.0.1:{probe.getsockname()[1]}"
    join = ["worker", "--join", endpoint, "--keys", str(keys / "peers" / "lab"), "--workers", "1", "--patience", "5"]
    for offset_s, words in ((3 * DAY_S, "expired"), (-3 * DAY_S, "set the clock of this machine")):
        clock.step(offset_s)
        worker = started(clock, *join)
        told, _ = worker.communicate(timeout=120)
        assert worker.returncode in (2, 3), told
        assert words in told, told
        assert told.count("\n") <= 2, told
