"""Events for others: a webhook over restarts of the farm, the receiver and the bridge; a subscriber in Rust."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import jsonschema
import pytest
from test_joining import BUDGET, _campaign, _facts, _new_run, dart  # noqa: F401 (a fixture)
from test_keys import _free_port

from saflite.bus import keyring
from saflite.console.run_data.run_folder import open_run
from saflite.contract.control import Status
from saflite.contract.events import Event, ViolationFound
from saflite.runtime.campaign_runner import resume
from saflite.runtime.client import FarmClient, read_info

pytestmark = pytest.mark.live

ROOT = Path(__file__).resolve().parents[2]
SUBSCRIBER = ROOT / "deploy" / "examples" / "rust" / "target" / "release" / "saflite-subscriber"
SECRET = b"not a secret, a test"
SCHEMA = json.loads((ROOT / "schemas" / "CloudEvent.schema.json").read_text())


class Receiver(HTTPServer):
    """Takes posts; now and then it is too busy, or takes one and its answer is lost."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.taken: list[dict[str, object]] = []
        self.posts, self.is_away = 0, False
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/finds"


class _Handler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        signed = f"{self.headers['webhook-id']}.{self.headers['webhook-timestamp']}.".encode() + body
        mac = base64.b64encode(hmac.new(SECRET, signed, hashlib.sha256).digest()).decode()
        assert self.headers["webhook-signature"] == f"v1,{mac}"
        self.server.posts += 1
        if self.server.is_away or self.server.posts % 10 == 3:
            self.send_response(503)
            self.end_headers()
            return
        event = json.loads(body)
        jsonschema.validate(event, SCHEMA)
        self.server.taken.append(event)
        if self.server.posts % 10 == 6:
            return  # the connection ends without an answer
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        return


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    server = Receiver()
    yield server
    server.shutdown()
    server.server_close()


def _stopping_at(flights: int) -> object:
    def stop(status: Status) -> None:
        if status.flights >= flights:
            os.kill(os.getpid(), signal.SIGINT)

    return stop


def _events(run_dir: Path) -> list[Event]:
    with open_run(run_dir) as folder:
        return list(folder.events(1))


def _farm_of(run_dir: Path, module: Path, *more: str) -> subprocess.Popen[bytes]:
    """Start a farm that goes on with a run, and return it once it says where it is reached."""
    words = ["resume", str(run_dir), "--workers", "2", "--module", str(module), "--json", *more]
    farm = subprocess.Popen([sys.executable, "-m", "saflite", *words], stdout=subprocess.DEVNULL, cwd=run_dir.parent)
    until_s = time.monotonic() + 60
    while not (run_dir / "farm.json").exists() and time.monotonic() < until_s:
        time.sleep(0.1)
    return farm


def test_a_webhook_is_told_every_event_over_restarts_of_farm_receiver_and_bridge(
    tmp_path: Path,
    dart: Path,  # noqa: F811
    receiver: Receiver,
) -> None:
    run_dir = _new_run(tmp_path / "far", _campaign())
    (tmp_path / "secret").touch(0o600)
    (tmp_path / "secret").write_bytes(SECRET)
    bridge = [sys.executable, "-m", "saflite", "watch", str(run_dir), "--webhook", receiver.url]
    bridge += ["--secret", str(tmp_path / "secret")]
    started = [subprocess.Popen(bridge, cwd=tmp_path)]
    half = resume(run_dir, simulators=2, modules=[dart], on_status=_stopping_at(BUDGET // 2))  # type: ignore[arg-type]
    assert not half.ended
    started[0].kill()
    started[0].wait()
    started.append(subprocess.Popen(bridge, cwd=tmp_path))
    assert resume(run_dir, simulators=2, modules=[dart]).ended
    assert started[1].wait(timeout=120) == 0
    told = [int(str(event["sequence"])) for event in receiver.taken]
    assert sorted(set(told)) == [event.seq for event in _events(run_dir)]
    assert list(dict.fromkeys(told)) == sorted(set(told)), "out of order"
    assert len({event["id"] for event in receiver.taken}) == len(set(told)), "told again under another id"
    assert len(told) > len(set(told)), "no answer was lost"


def test_a_webhook_of_a_farm_elsewhere_is_told_every_event_though_it_was_away_when_the_farm_ended(
    tmp_path: Path,
    dart: Path,  # noqa: F811
    receiver: Receiver,
) -> None:
    run_dir, cursor = _new_run(tmp_path / "far", _campaign()), tmp_path / "c.json"
    (tmp_path / "secret").touch(0o600)
    (tmp_path / "secret").write_bytes(SECRET)
    receiver.is_away = True
    farm = _farm_of(run_dir, dart)
    info = read_info(run_dir)
    words = ["watch", "--connect", info.endpoint, "--campaign", info.campaign, "--webhook", receiver.url]
    words += ["--cursor", str(cursor), "--secret", str(tmp_path / "secret")]
    bridge = subprocess.Popen([sys.executable, "-m", "saflite", *words], cwd=tmp_path)
    assert farm.wait(timeout=120) == 1
    assert not receiver.taken
    assert bridge.poll() is None
    receiver.is_away = False
    assert bridge.wait(timeout=120) == 0
    told = [int(str(event["sequence"])) for event in receiver.taken]
    assert list(dict.fromkeys(told)) == [event.seq for event in _events(run_dir)]
    assert not Path(f"{cursor}.waiting").exists()


def test_a_late_follower_hears_everything_after_a_restart_of_all(
    tmp_path: Path,
    dart: Path,  # noqa: F811
) -> None:
    run_dir = _new_run(tmp_path / "far", _campaign())
    resume(run_dir, simulators=2, modules=[dart], on_status=_stopping_at(BUDGET // 2))  # type: ignore[arg-type]
    heard: list[Event] = []
    late: list[threading.Thread] = []

    def follow() -> None:
        info = read_info(run_dir)
        client = FarmClient.connect(info.endpoint, info.campaign)
        heard.extend(client.watch(1))
        client.close()

    def begin_once(status: Status) -> None:
        if not late and status.flights > BUDGET // 2:
            late.append(threading.Thread(target=follow))
            late[0].start()

    assert resume(run_dir, simulators=2, modules=[dart], on_status=begin_once).ended
    late[0].join(60)
    assert heard == _events(run_dir)


@pytest.mark.parametrize("by_key", [False, True])
def test_the_ten_lines_of_python_hear_every_violation_also_by_a_key(
    tmp_path: Path,
    dart: Path,  # noqa: F811
    by_key: bool,
) -> None:
    run_dir, keys = _new_run(tmp_path / "far", _campaign()), tmp_path / "keys"
    keyring.init(keys, [], now_s=time.time())
    ana = keyring.add(keys, "ana", ["viewer"], now_s=time.time())
    endpoint = f"tls/127.0.0.1:{_free_port()}"
    farm = _farm_of(run_dir, dart, "--listen", endpoint, "--keys", str(keys))
    client = FarmClient.of_run(run_dir)
    client.status()  # it is there
    client.close()
    where = [endpoint, str(ana)] if by_key else [read_info(run_dir).endpoint]
    subscriber = subprocess.Popen(
        [sys.executable, str(ROOT / "deploy" / "examples" / "subscriber.py"), *where],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert farm.wait(timeout=120) == 1
    said, _ = subscriber.communicate(timeout=60)
    told = [event.fact.violation for event in _events(run_dir) if isinstance(event.fact, ViolationFound)]
    assert [line.split()[:2] for line in said.splitlines()] == [[one.confirmation, one.fingerprint] for one in told]
    assert told, "the campaign found nothing"


@pytest.mark.skipif(
    not SUBSCRIBER.exists(),
    reason="not built, it takes minutes: cd deploy/examples/rust && cargo build --release",
)
def test_a_subscriber_in_rust_made_from_the_schemas_alone_hears_every_violation(
    tmp_path: Path,
    dart: Path,  # noqa: F811
) -> None:
    run_dir = _new_run(tmp_path / "far", _campaign())
    farm = _farm_of(run_dir, dart)
    until_s = time.monotonic() + 60
    client = FarmClient.of_run(run_dir)
    while not client.status().violations_confirmed and time.monotonic() < until_s:
        time.sleep(0.1)
    assert client.status().violations_confirmed, "a late joiner needs history to be heard"
    client.close()
    info = read_info(run_dir)
    subscriber = subprocess.Popen([str(SUBSCRIBER), info.endpoint, info.campaign], stdout=subprocess.PIPE, text=True)
    said, _ = subscriber.communicate(timeout=120)
    assert (subscriber.returncode, farm.wait(timeout=60)) == (0, 1)
    heard = [json.loads(line) for line in said.splitlines()]
    schema = json.loads((ROOT / "schemas" / "Event.schema.json").read_text())
    for event in heard:
        jsonschema.validate(event, schema)
    assert [event["seq"] for event in heard] == [
        event.seq for event in _events(run_dir) if isinstance(event.fact, ViolationFound)
    ]
    assert heard, "the campaign found nothing"
