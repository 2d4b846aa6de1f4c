"""Ray's head goes and stays away: the farm goes on without its workers, and is stopped as any other."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from test_joining import _campaign, _new_run, dart  # noqa: F401 (fixture)
from test_keys import _free_port

from saflite.bus import keyring
from saflite.contract.control import Status
from saflite.contract.errors import Refused, Unavailable
from saflite.runtime.client import FarmClient

pytestmark = pytest.mark.live

ENDS_OTHERS_S = 60.0  # Ray's own patience, after which it ends whoever had joined
ENVIRONMENT = {**os.environ, "RAY_AUTH_MODE": "disabled"}


class Head(NamedTuple):
    """A Ray cluster of one node, whose processes all bear the name of its folder."""

    address: str
    folder: str

    def kill(self) -> None:
        """End all of it at once."""
        subprocess.run(["pkill", "-KILL", "-f", self.folder], check=False)


@pytest.fixture
def head(tmp_path: Path) -> Iterator[Head]:
    pytest.importorskip("ray")
    with tempfile.TemporaryDirectory(prefix="sfr", ignore_cleanup_errors=True) as folder:
        made = Head(f"127.0.0.1:{_free_port()}", folder)
        command = [str(Path(sys.executable).with_name("ray")), "start", "--head", "--include-dashboard=false"]
        command += [f"--port={made.address.rpartition(':')[2]}", "--node-ip-address=127.0.0.1", "--num-cpus=2"]
        command += ["--disable-usage-stats", f"--object-store-memory={100 * 2**20}", f"--temp-dir={folder}"]
        subprocess.run(command, check=True, env=ENVIRONMENT, stdout=(tmp_path / "ray.log").open("wb"))
        yield made
        made.kill()


def test_a_farm_outlives_the_head_of_its_cluster(
    tmp_path: Path,
    head: Head,
    dart: Path,  # noqa: F811
) -> None:
    """It was ended in the middle, with the exit code for violations, and without a report."""
    keyring.init(tmp_path / "keys", [], now_s=time.time())
    run_dir = _new_run(tmp_path / "far", _campaign(100_000))
    command = [
        sys.executable,
        "-m",
        "saflite",
        "resume",
        str(run_dir),
        "--on",
        f"ray:{head.address}",
        "--module",
        str(dart),
    ]
    command += ["--listen", f"tls/127.0.0.1:{_free_port()}", "--keys", str(tmp_path / "keys"), "--workers", "1"]
    with (tmp_path / "farm.log").open("wb") as log:
        farm = subprocess.Popen(command, stdout=log, stderr=log, env=ENVIRONMENT)
    try:
        _until(run_dir, lambda status: status.flights >= 3)
        head.kill()
        time.sleep(ENDS_OTHERS_S + 15.0)
        assert farm.poll() is None, (tmp_path / "farm.log").read_text()[-2000:]
        _until(run_dir, lambda status: status.state == "running" and not status.workers)
        farm.send_signal(signal.SIGINT)
        assert farm.wait(60) in (0, 1), (tmp_path / "farm.log").read_text()[-2000:]
        assert (run_dir / "report.html").exists()
    finally:
        farm.kill()


def _until(run_dir: Path, holds: Callable[[Status], bool]) -> None:
    until_s = time.monotonic() + 180.0
    seen: Status | None = None
    while time.monotonic() < until_s:
        try:
            client = FarmClient.of_run(run_dir)
            seen = client.status()
            client.close()
        except (Refused, Unavailable):
            time.sleep(0.5)
            continue
        if holds(seen):
            return
        time.sleep(0.5)
    raise AssertionError(f"not yet: {seen}")
