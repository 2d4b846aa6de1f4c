"""Workers of another machine: a process group in a network namespace of its own joins, flies, and is refused in words.

The target stands outside the package and flies in no time; how near it comes to its obstacle is drawn from what it
flies, so that a search finds violations, and finds the same wherever it is flown.
"""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
from network_namespace import NetworkNamespace, why_not

import saflite
from saflite.bus.endpoints import free_endpoint
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.zenoh import open_router
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.console.run_data.run_folder import open_run
from saflite.contract import topics
from saflite.contract.config import Campaign, LeaseConfig, ScorerConfig, SearchConfig
from saflite.contract.control import Status
from saflite.contract.errors import Unavailable
from saflite.contract.events import FaultSeen, Flown, ViolationFound, WorkerChanged
from saflite.contract.test_case import Target
from saflite.runtime.campaign_runner import resume, run_campaign
from saflite.runtime.client import FarmClient, read_info
from saflite.simulator_worker.targets import reference

pytestmark = pytest.mark.live

BUDGET = 40
BUILD = "b" * 64
DART = '''
"""A dart that flies past its obstacle at a distance drawn from where that stands, whatever the noise."""
import time

import msgspec
import numpy as np

from saflite.contract.flight import FlightRecord, Trace
from saflite.contract.rng import derive
from saflite.simulator_worker.targets import reference


def describe():
    return msgspec.structs.replace(reference.describe(), name="dart", build=BUILD, snapshots=False)


def check(test_case):
    pass


def open(slot):
    return Session()


class Session:
    def fly(self, test_case, deadline_s, cancelled):
        time.sleep(0.1)
        distance_m = 1.0 + 5.0 * float(derive(0, "dart", repr(test_case.scenario.obstacles)).random())
        column = np.full(10, distance_m, dtype="<f4")
        column[0] = 10.0  # it begins far from the obstacle
        return FlightRecord("completed", Trace(step_s=0.1, signals=dict.fromkeys(describe().signals, column.tobytes())))

    def close(self):
        pass
'''


class Far(NamedTuple):
    """A worker group in the namespace."""

    process: subprocess.Popen[str]

    def ended(self, within_s: float = 60.0) -> tuple[int, str]:
        """Return its exit code and what it said."""
        said, _ = self.process.communicate(timeout=within_s)
        return self.process.returncode, said


@pytest.fixture
def network() -> Iterator[NetworkNamespace]:
    reason = why_not()
    if reason:
        pytest.skip(reason)
    with NetworkNamespace() as made:
        yield made


@pytest.fixture
def dart(tmp_path: Path) -> Path:
    path = tmp_path / "dart.py"
    path.write_text(DART.replace("BUILD", repr(BUILD)))
    return path


def _campaign(budget: int = BUDGET) -> Campaign:
    return Campaign(
        name="far",
        mission="mission1",
        target=Target(name="dart", build=BUILD),
        budget_flights=budget,
        rng_seed=5,
        scorer=ScorerConfig(model="gap"),
        search=SearchConfig(candidates_per_round=12, flights_per_round=6),
        lease=LeaseConfig(lease_s=3.0, wall_limit_s=30.0),
    )


def _new_run(run_dir: Path, campaign: Campaign) -> Path:
    Store.create(run_dir, campaign, template(campaign), reference.describe()).close()
    return run_dir


def _listen(network: NetworkNamespace) -> str:
    return f"tcp/{network.host_ip}:{free_endpoint().rpartition(':')[2]}"


def _join(
    network: NetworkNamespace,
    endpoint: str,
    module: Path,
    *more: str,
    package: Path | None = None,
    once: Path | None = None,
) -> Far:
    """Start a group; `once` lets it wait until that file is there: what starts after a farm counts as its stray."""
    waiting = ("sh", "-c", f'until [ -e {once} ]; do sleep 0.1; done; exec "$@"', "sh") if once else ()
    command = [
        *waiting,
        *network.prefix,
        sys.executable,
        "-m",
        "saflite",
        "worker",
        "--join",
        endpoint,
        "--workers",
        "2",
    ]
    command += ["--module", str(module), *more]
    environment = {**os.environ, **({"PYTHONPATH": str(package)} if package else {})}
    return Far(
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=module.parent
        )
    )


def _facts(run_dir: Path) -> list[object]:
    with open_run(run_dir) as run:
        return [event.fact for event in run.events(1)]


def _found(run_dir: Path) -> set[tuple[str, str, str]]:
    found = (fact.violation for fact in _facts(run_dir) if isinstance(fact, ViolationFound))
    return {(one.test_case, one.policy, one.confirmation) for one in found}


def test_workers_in_another_namespace_fly_a_campaign_and_find_what_one_machine_finds(
    tmp_path: Path, network: NetworkNamespace, dart: Path
) -> None:
    run_campaign(_campaign(), tmp_path / "near", simulators=2, modules=[dart])
    endpoint, run_dir = _listen(network), _new_run(tmp_path / "far", _campaign())
    group = _join(network, endpoint, dart, "--insecure", "--name", "lab", "--stages", "fly,judge,record")
    killed: list[int] = []

    def kill_the_books_once(status: Status) -> None:
        """The router goes with them."""
        if status.flights >= BUDGET // 3 and not killed:
            killed.append(read_info(run_dir).processes["books"])
            os.kill(killed[0], signal.SIGKILL)

    summary = resume(run_dir, simulators=0, listen=endpoint, insecure=True, on_status=kill_the_books_once)
    code, said = group.ended()
    assert summary.ended
    assert killed
    assert (code, said.splitlines()[-1]) == (0, "the campaign is over"), said
    assert "joining campaign far" in said
    assert _found(run_dir) == _found(tmp_path / "near")
    assert any(confirmation == "confirmed" for _, _, confirmation in _found(run_dir))
    facts = _facts(run_dir)
    assert {fact.worker for fact in facts if isinstance(fact, Flown)} <= {"lab-fly-1", "lab-fly-2"}
    joined = [fact for fact in facts if isinstance(fact, WorkerChanged) and fact.present and fact.worker == "lab-fly-1"]
    assert len(joined) >= 2, "it did not join again after the books were restarted"
    assert all(fact.build == BUILD and fact.host for fact in joined)
    recorders = {fact.worker for fact in facts if isinstance(fact, WorkerChanged) and fact.present}
    assert "lab-record-1" in recorders, "the other machine offered no recorder"
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as books:  # by whom is a race with the recorder beside them
        recorded = books.execute("SELECT count(*) FROM attempts WHERE stage = 'record' AND how = 'recorded'")
        assert recorded.fetchone()[0] > 0, "nothing was recorded"
    assert audit(run_dir)["problems"] == []


def test_what_does_not_fit_is_refused_in_words_on_both_sides(
    tmp_path: Path, network: NetworkNamespace, dart: Path
) -> None:
    endpoint, run_dir = _listen(network), _new_run(tmp_path / "run", _campaign())
    other = dart.with_name("other") / "dart.py"
    other.parent.mkdir()
    other.write_text(dart.read_text().replace("b" * 64, "c" * 64))
    package = _changed_package(tmp_path)
    cases = {
        "add --insecure": _join(network, endpoint, dart, "--name", "open"),
        "build of dart": _join(network, endpoint, other, "--insecure", "--name", "other-build"),
        "software of fly": _join(network, endpoint, dart, "--insecure", "--name", "other-code", package=package),
        "protocol: expected": _join(
            network, endpoint, dart, "--insecure", "--name", "other-protocol", package=_other_protocol(tmp_path)
        ),
        "worker name": _join(network, endpoint, dart, "--insecure", "--name", "../up"),
    }
    ends: dict[str, tuple[int, str]] = {}

    def until_all_have_ended(_: Status) -> None:
        for words, far in cases.items():
            if words not in ends and far.process.poll() is not None:
                ends[words] = far.ended()
        if len(ends) == len(cases):
            os.kill(os.getpid(), signal.SIGINT)

    resume(run_dir, simulators=0, listen=endpoint, insecure=True, on_status=until_all_have_ended)
    for words, (code, said) in ends.items():
        assert code == 2, said
        refusal = said.splitlines()[-1]
        assert refusal.startswith("saflite: refused: "), said
        assert words in refusal, said
    told = [fact.message for fact in _facts(run_dir) if isinstance(fact, FaultSeen) and "joining" in fact.where]
    for words in ("build of dart", "software of fly", "protocol: expected"):
        assert any(words in message for message in told), told
    books = (run_dir / "logs" / "books.log").read_text()
    assert "build of dart" in books
    assert not [fact for fact in _facts(run_dir) if isinstance(fact, Flown)]


def test_a_name_in_use_is_refused_and_ctrl_c_hands_back_what_is_held(
    tmp_path: Path, network: NetworkNamespace, dart: Path
) -> None:
    dart.write_text(dart.read_text().replace("time.sleep(0.1)", "[time.sleep(0.05) for _ in iter(cancelled, True)]"))
    endpoint, run_dir = _listen(network), _new_run(tmp_path / "run", _campaign())
    first = _join(network, endpoint, dart, "--insecure", "--name", "lab")
    start = tmp_path / "start"
    second = _join(network, endpoint, dart, "--insecure", "--name", "lab", once=start)
    ends: list[tuple[int, str]] = []

    def act(status: Status) -> None:
        flying = sum(one.state == "busy" for one in status.workers if one.stage == "fly")
        if flying == 2:
            start.touch()
        if not ends and second.process.poll() is not None:
            ends.append(second.ended())
            first.process.send_signal(signal.SIGINT)
        if ends and first.process.poll() is not None:
            os.kill(os.getpid(), signal.SIGINT)

    resume(run_dir, simulators=0, listen=endpoint, insecure=True, on_status=act)
    code, said = ends[0]
    assert code == 2, said
    assert "in use by a live fly worker" in said.splitlines()[-1]
    code, said = first.ended()
    assert code == 0, said
    assert "handed back" in said
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as books:
        rows = books.execute("SELECT how, count(*) FROM attempts GROUP BY how").fetchall()
    assert dict(rows).get("handed_back", 0) >= 2
    assert "lost" not in dict(rows)


def test_a_farm_that_never_answers_ends_with_3(dart: Path, network: NetworkNamespace) -> None:
    began_s = time.monotonic()
    far = _join(network, _listen(network), dart, "--insecure", "--patience", "4")
    code, said = far.ended()
    assert code == 3, said
    assert said.splitlines()[-1].startswith("saflite: unavailable: no router at"), said
    assert time.monotonic() - began_s < 30


def test_where_several_farms_are_at_an_endpoint_the_campaign_has_to_be_named() -> None:
    socket = PrivateSocket()
    router = open_router("router", socket.endpoint)
    for name in ("day", "night"):
        router.appear(topics.farm(name))
    for command in (["worker", "--join"], ["control", "status", "--connect"]):
        words = [sys.executable, "-m", "saflite", *command, socket.endpoint]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 2
        assert "--campaign: expected one of day, night" in done.stderr
    router.close()
    socket.close()


def test_a_client_without_a_campaign_takes_the_one_that_runs_there() -> None:
    with PrivateSocket() as socket:
        router = open_router("router", socket.endpoint)
        with pytest.raises(Unavailable, match="no farm at"):
            FarmClient.connect(socket.endpoint, "")
        router.appear(topics.farm("night"))
        client = FarmClient.connect(socket.endpoint, "")
        assert client.campaign == "night"
        client.close()
        router.close()


def test_a_campaign_that_is_not_there_is_told_with_those_that_are(dart: Path) -> None:
    with PrivateSocket() as socket:
        router = open_router("router", socket.endpoint)
        router.appear(topics.farm("night"))
        command = [sys.executable, "-m", "saflite", "worker", "--join", socket.endpoint, "--campaign", "nigth"]
        command += ["--module", str(dart), "--workers", "1", "--patience", "3"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        router.close()
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1].endswith(f"answered for 3 s; at {socket.endpoint} runs night"), done.stderr


def _copied(folder: Path) -> Path:
    shutil.copytree(Path(saflite.__file__).parent, folder / "saflite", ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def _changed_package(tmp_path: Path) -> Path:
    """Return where a package stands that differs in one line a simulator runs."""
    folder = _copied(tmp_path / "changed")
    with (folder / "saflite" / "simulator_worker" / "work.py").open("a") as file:
        file.write("\n# another line\n")
    return folder


def _other_protocol(tmp_path: Path) -> Path:
    """Return where a package stands that speaks the next protocol."""
    folder = _copied(tmp_path / "next")
    table = folder / "saflite" / "contract" / "topics.py"
    table.write_text(table.read_text().replace("PROTOCOL = 2", "PROTOCOL = 3"))
    return folder
