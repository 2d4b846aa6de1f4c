"""Ray as the place where workers run: the launcher's promises, and a campaign on two nodes of which one dies."""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from test_joining import BUDGET, BUILD, DART, _campaign, _facts, _found, _new_run

from saflite.bus import keyring
from saflite.conformance.kit import findings
from saflite.conformance.launchers import check_launcher
from saflite.contract.control import Status, Verb
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import FaultSeen, Flown, WorkerChanged
from saflite.runtime import autoscaling
from saflite.runtime.autoscaling import Bounds
from saflite.runtime.campaign_runner import resume, run_campaign
from saflite.runtime.client import FarmClient
from saflite.runtime.launchers.base import Meeting, RoleSpec
from saflite.runtime.on_ray import check_place

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra [ray] is not installed"),
]
STORE_BYTES = 100 * 2**20
WAIT = """
BEGAN_S = time.monotonic()


def wait():  # a flight lasts until there are two actors: on a busy machine the second takes longer than a campaign
    import pathlib

    until_s = time.monotonic() + 20.0
    while not pathlib.Path(PLACE).exists() and time.monotonic() < min(until_s, BEGAN_S + 200.0):
        time.sleep(0.1)
    time.sleep(0.1)
"""


@pytest.fixture
def one_node() -> Iterator[None]:
    import ray

    ray.init(include_dashboard=False, log_to_driver=False, num_cpus=2, object_store_memory=STORE_BYTES)
    yield
    ray.shutdown()


class Near(NamedTuple):
    """The target from outside, and what a campaign with it finds on one machine."""

    dart: Path
    found: set[tuple[str, str, str]]


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Near:
    folder = tmp_path_factory.mktemp("near")
    dart = folder / "dart.py"
    dart.write_text(DART.replace("BUILD", repr(BUILD)))
    run_campaign(_campaign(), folder / "run", simulators=2, modules=[dart])
    return Near(dart, _found(folder / "run"))


def test_the_ray_launcher_keeps_the_promises_of_launchers(one_node: None) -> None:
    from saflite.runtime.launchers.ray import RayLauncher

    assert findings(check_launcher(RayLauncher)) == []


def test_a_role_whose_process_dies_of_a_signal_is_told_as_killed(one_node: None) -> None:
    from saflite.runtime.launchers.ray import RayLauncher

    launcher = RayLauncher(Meeting(campaign="c", connect="tcp/127.0.0.1:9", insecure=True))
    name = f"judge-{os.getpid()}"  # other farms of this machine have a judge-1, too
    launcher.start(RoleSpec(kind="judge", name=name))
    pid = 0
    until_s = time.monotonic() + 120
    while not pid and time.monotonic() < until_s:
        commands = Path("/proc").glob("[0-9]*/cmdline")
        found = [path for path in commands if f"\0--worker={name}\0".encode() in _content(path)]
        pid = int(found[0].parent.name) if found else 0
    assert pid, "its process never came up"  # and signal 8 to process 0 would end all of us
    until_s = time.monotonic() + 60
    os.kill(pid, 8)  # SIGFPE: where SIGCHLD is ignored, Python reads that end as exit code 0
    while (state := launcher.poll()[name]).condition == "running" and time.monotonic() < until_s:
        time.sleep(0.05)
    launcher.stop()
    assert state.condition == "broken"


def test_an_actor_that_hangs_is_given_up(one_node: None, monkeypatch: pytest.MonkeyPatch) -> None:
    import ray

    from saflite.runtime.launchers import ray as launchers

    monkeypatch.setattr(launchers, "HANGS_S", 2.0)
    launcher = launchers.RayLauncher(Meeting(campaign="c", connect="tcp/127.0.0.1:9", insecure=True))
    launcher.start(RoleSpec(kind="judge", name="judge-1"))
    actor = launcher._placed["judge-1"].actor
    pid = ray.get(actor.__ray_call__.remote(lambda _: os.getpid()), timeout=60)
    until_s = time.monotonic() + 30
    while launcher._placed["judge-1"]._heard_s is None and time.monotonic() < until_s:
        assert launcher.poll()["judge-1"].condition == "running"
        time.sleep(0.05)
    os.kill(pid, 19)  # SIGSTOP
    while (state := launcher.poll()["judge-1"]).condition == "running" and time.monotonic() < until_s:
        time.sleep(0.05)
    launcher.stop()
    assert state.condition == "killed"
    assert "has not answered" in state.message


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


def test_actors_follow_the_queue_and_those_that_leave_take_no_work_with_them(
    tmp_path: Path, one_node: None, near: Near, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(autoscaling, "STABILIZATION_S", 0.0)
    run_dir = _new_run(tmp_path / "run", _campaign())
    seen: list[int] = []
    given: list[str] = []
    two_are_there = tmp_path / "two are there"
    waiting = near.dart.read_text().replace("time.sleep(0.1)", "wait()")
    (tmp_path / "dart.py").write_text(waiting + WAIT.replace("PLACE", repr(str(two_are_there))))

    def pause_until_one_is_left(status: Status) -> None:
        """A queue without work, in the middle of the campaign."""
        seen.append(sum(worker.stage == "fly" for worker in status.workers))
        order: Verb | None = None
        if not given and seen[-1] == 2:
            order = "pause"
        elif given == ["pause"] and seen[-1] == 1:
            order = "resume"
        if order is not None:
            client = FarmClient.of_run(run_dir)
            client.order(order)
            client.close()
            given.append(order)
            two_are_there.touch()  # not before: the flights that wait for it would end the campaign unpaused

    summary = resume(
        run_dir,
        modules=[tmp_path / "dart.py"],
        on="ray",
        scale={"fly": Bounds(1, 2), "score": Bounds(1, 1)},
        on_status=pause_until_one_is_left,
    )
    assert summary.ended
    assert given == ["pause", "resume"], "the campaign ended before two simulators were there"
    assert (max(seen), summary.restarts) == (2, 0)
    assert _found(run_dir) == near.found
    facts = _facts(run_dir)
    assert [fact for fact in facts if isinstance(fact, WorkerChanged | Flown) and fact.worker == "ray-fly-2"]
    lost = [fact for fact in facts if isinstance(fact, FaultSeen) and "ray-fly-2" in fact.message]
    assert not lost, "a lease was lost"  # others may starve on a busy machine


def test_a_campaign_on_two_nodes_finds_what_one_machine_finds_though_a_node_is_killed(
    tmp_path: Path, near: Near
) -> None:
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 1, "include_dashboard": False, "object_store_memory": STORE_BYTES},
    )
    other = cluster.add_node(num_cpus=1, object_store_memory=STORE_BYTES)
    keyring.init(tmp_path / "keys", ["127.0.0.1"], now_s=time.time())
    run_dir = _new_run(tmp_path / "far", _campaign())
    killed: list[int] = []

    def kill_a_node_once(status: Status) -> None:
        if status.flights >= BUDGET // 3 and not killed:
            killed.append(status.flights)
            cluster.remove_node(other, allow_graceful=False)

    try:
        summary = resume(
            run_dir,
            simulators=2,
            modules=[near.dart],
            listen=f"tls/127.0.0.1:{_free_port()}",
            keys=tmp_path / "keys",
            on=f"ray:{cluster.address}",
            on_status=kill_a_node_once,
        )
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert summary.ended
    assert killed
    assert _found(run_dir) == near.found
    facts = _facts(run_dir)
    flew = {fact.worker for fact in facts if isinstance(fact, Flown)}
    assert flew == {"ray-fly-1", "ray-fly-2"}
    assert [fact for fact in facts if isinstance(fact, WorkerChanged) and not fact.present], "nobody was missed"


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.mark.parametrize("place", ["", "there", "ray:", "rays", "ray:auto"])
def test_a_place_that_is_none_is_refused(place: str) -> None:
    with pytest.raises(Refused, match="--on"):
        check_place(place, listen="")


def test_a_cluster_that_is_not_there_is_told() -> None:
    from saflite.runtime.launchers.ray import connect

    with pytest.raises(Unavailable, match=r"no Ray cluster at 127\.0\.0\.1:9"):
        connect("127.0.0.1:9")


def test_a_cluster_that_wants_a_token_is_told_how_to_get_one() -> None:
    from saflite.runtime.launchers.ray import _unreached

    assert _unreached("lab:6379", "no", "").endswith("no; where it asks for a token, as one of `ray start` does, "
                                                     "set RAY_AUTH_MODE=token")  # fmt: skip
    assert _unreached("lab:6379", "no", "token") == "no Ray cluster at lab:6379: no"
    assert _unreached("", "no", "") == "no Ray cluster on this machine: no"


def test_a_person_runs_a_campaign_on_a_cluster_started_here(tmp_path: Path) -> None:
    """In a process of its own: Ray looks once whether tokens are asked for, which another test may have had it do."""
    words = [sys.executable, "-m", "saflite", "run", "avoidance-m2", "--on", "ray", "--budget", "2", "--workers", "1"]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    done = subprocess.run(
        [*words, "--out=-rr"], cwd=tmp_path, env=plain, capture_output=True, text=True, check=False, timeout=240.0
    )
    assert done.returncode in (0, 1), done.stdout + done.stderr
    assert "2 flights in" in done.stdout
