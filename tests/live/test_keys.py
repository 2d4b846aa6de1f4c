"""Keys on a real network: what each role may, what strangers get, and a campaign flown over it by another namespace."""

from __future__ import annotations

import itertools
import queue
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple, get_args

import pytest
import zenoh
from network_namespace import NetworkNamespace
from test_joining import BUDGET, _campaign, _facts, _found, _new_run, dart, network  # noqa: F401 (fixtures)

from saflite.bus import keyring
from saflite.bus.access import ROLES, SEAL_BYTES_MAX, STAGE_OF, Role
from saflite.bus.base import Happening, Presence, Reply, Sample, seal
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.questions import ZenohRequest
from saflite.bus.zenoh import Gate, ZenohBus, open_client, open_router
from saflite.contract import topics
from saflite.contract.control import Verb
from saflite.contract.errors import Unavailable
from saflite.contract.events import Flown
from saflite.runtime.campaign_runner import resume, run_campaign

pytestmark = pytest.mark.live

CAMPAIGN, OTHER = "night", "day"
PATIENCE_S = 60.0


READERS = ("viewer", "operator")


class Router(NamedTuple):
    """A router with a gate, which answers whatever it is asked, and the folder of its keys."""

    bus: ZenohBus
    endpoint: str
    keys: Path
    heard: queue.SimpleQueue[Happening]

    def client(self, name: str) -> ZenohBus:
        """Return a bus with the key of a name."""
        credentials = keyring.peer_credentials(self.keys / "peers" / name, time.time())
        return open_client(name, self.endpoint, patience_s=2.0, keys=credentials)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _open(keys: Path, private: PrivateSocket) -> Router:
    endpoint = f"tls/127.0.0.1:{_free_port()}"
    gate = Gate(endpoint, keyring.farm_credentials(keys, time.time()), keyring.read_register(keys))
    bus = open_router("books", private.endpoint, gate=gate)
    heard: queue.SimpleQueue[Happening] = queue.SimpleQueue()

    def answer(request: Happening) -> None:
        heard.put(request)
        assert isinstance(request, ZenohRequest)
        request.reply(request.peer.encode())

    for root in (f"saflite/{topics.PROTOCOL}", topics.JOIN_ROOT):
        bus.serve(f"{root}/**", answer)
    bus.watch("saflite/**/alive/**", heard.put)
    bus.appear(topics.farm(CAMPAIGN))
    return Router(bus, endpoint, keys, heard)


@pytest.fixture(scope="module")
def router(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Router]:
    keys = tmp_path_factory.mktemp("farm") / "keys"
    keyring.init(keys, [], now_s=time.time())
    for role in ROLES:
        keyring.add(keys, role, [role], campaigns=[CAMPAIGN], now_s=time.time())
    keyring.add(keys, "gone", ["operator"], now_s=time.time())
    keyring.revoke(keys, "gone")
    with PrivateSocket() as private:
        opened = _open(keys, private)
        yield opened
        opened.bus.close()


def _asked_of(campaign: str) -> dict[str, str]:
    """Return every key one can ask on in a campaign, by what it is."""
    keys = {f"control {verb}": topics.control(campaign, verb) for verb in get_args(Verb)}
    for stage in topics.STAGES:
        keys[f"join {stage}"] = topics.join(campaign, stage)
        keys[f"work {stage}"] = topics.work(campaign, stage)
        keys[f"result {stage}"] = topics.result(campaign, stage)
        keys[f"beat {stage}"] = topics.beat(campaign, stage)
    blobs = {f"blob {verb}": f"saflite/{topics.PROTOCOL}/{campaign}/blob/{verb}" for verb in ("open", "get", "put")}
    return {**keys, **blobs}


def _intended(role: Role) -> set[str]:
    """The table of SECURITY.md, written down a second time."""
    stage = {"worker": "fly", "scorer": "score", "oracle": "judge", "mutator": "mutate", "recorder": "record"}.get(role)
    if stage is not None:
        return {f"{what} {stage}" for what in ("join", "work", "result", "beat")} | {
            "blob open",
            "blob get",
            "blob put",
        }
    return {"control status", "control events"} | (
        {f"control {verb}" for verb in ("pause", "resume", "stop", "budget", "scorer", "shadow")}
        if role == "operator"
        else set()
    )


def _answers(bus: ZenohBus, keys: dict[str, str]) -> dict[str, bytes | None]:
    inbox: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    for name, key in keys.items():
        bus.ask(key, b"", name, inbox.put, 2.0)
    replies = [inbox.get(timeout=10.0) for _ in keys]
    return {str(reply.tag): reply.payload for reply in replies if isinstance(reply, Reply)}


@pytest.mark.parametrize("role", ROLES)
def test_each_role_may_ask_what_its_row_says_and_nothing_else(router: Router, role: Role) -> None:
    bus = router.client(role)
    answers = _answers(bus, _asked_of(CAMPAIGN))
    elsewhere = _answers(bus, _asked_of(OTHER))
    bus.close()
    assert {name for name, answer in answers.items() if answer is not None} == _intended(role)
    assert {answer for answer in answers.values() if answer is not None} == {role.encode()}, "the name is not proven"
    assert not [name for name, answer in elsewhere.items() if answer is not None], "it may ask in another campaign"


@pytest.mark.parametrize("role", ROLES)
def test_no_role_speaks_under_another_name_or_outside_its_own_keys(router: Router, role: Role) -> None:
    credentials = keyring.peer_credentials(router.keys / "peers" / role, time.time())
    for other in (*(one for one in ROLES if one != role), ""):
        bus = open_client(role, router.endpoint, patience_s=2.0, keys=credentials)
        bus._peer = other  # what somebody with other software would send
        answers = _answers(bus, _asked_of(CAMPAIGN))
        bus.close()
        assert not [name for name, answer in answers.items() if answer is not None], other


@pytest.mark.parametrize("name", [*ROLES, "gone"])
def test_only_those_who_read_hear_events_and_nobody_can_forge_one(router: Router, name: str) -> None:
    reader, heard = router.client("viewer"), Heard()
    bus, own = router.client(name), Heard()
    key, in_json, reads = topics.event(CAMPAIGN, name), topics.event_json(CAMPAIGN, name), name in READERS
    for one, inbox in ((reader, heard), (bus, own)):
        one.follow(key, inbox)
        one.follow(in_json, inbox)
    _settled(bus, reader)
    router.bus.announce(key, b"after")
    router.bus.tell(in_json, lambda: b"{}")
    for forged_on in (key, in_json):
        bus._session.put(forged_on, b"forged", attachment=seal(forged_on, "books", b"forged"))
    for inbox in (heard, own) if reads else (heard,):
        inbox.wait_for(b"after", b"{}")
    _settled(bus, reader)
    bus.close()
    reader.close()
    assert sorted(heard.payloads) == [b"after", b"{}"]
    own_words = [b"forged", b"forged"]  # come back to it, and reach nobody else
    assert sorted(own.payloads) == ([b"after", *own_words, b"{}"] if reads else own_words)


@pytest.mark.parametrize("name", [*ROLES, "gone"])
def test_nobody_answers_for_the_books_or_sees_who_works(router: Router, name: str) -> None:
    forger, asked, seen = router.client(name), Heard(), Heard()
    for key in (topics.control(CAMPAIGN, "status"), topics.work(CAMPAIGN, "fly")):
        for pattern in (key, f"by/*/{key}", f"by/operator/{key}"):
            forger._session.declare_queryable(pattern, asked, complete=True)
    forger.watch("saflite/**/alive/**", seen)
    with_token = router.client("worker")
    with_token.appear(topics.alive(CAMPAIGN, "fly", f"worker-for-{name}", "life"))
    _settled(with_token, forger)
    for asker, key in (("operator", "control status"), ("worker", "work fly")):
        bus = router.client(asker)
        answers = _answers(bus, {key: _asked_of(CAMPAIGN)[key]})
        bus.close()
        assert answers == {key: asker.encode()}, "somebody else answered"
    _settled(forger)
    with_token.close()
    forger.close()
    assert (asked.things, seen.things) == ([], [])


@pytest.mark.parametrize("role", [*ROLES, "gone"])
def test_only_workers_are_seen_alive_and_only_under_their_own_name(router: Router, role: Role) -> None:
    bus = router.client(role)
    _drained(router.heard)
    names = [f"{role}-1", role, "lab9", f"{role}x-1", *(f"{one}-1" for one in ROLES if one != role)]
    for stage, name in itertools.product(topics.STAGES, names):
        bus.appear(topics.alive(CAMPAIGN, stage, name, "life"))
    _settled(bus)
    seen = {one.key for one in _drained(router.heard) if isinstance(one, Presence) and one.present}
    bus.close()
    stage_of = STAGE_OF.get(role)
    wanted = {topics.alive(CAMPAIGN, stage_of, name, "life") for name in names[:2]} if stage_of else set()
    assert seen == wanted


def test_what_is_longer_than_its_row_says_does_not_arrive_and_its_sender_is_told(
    router: Router, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus, key = router.client("worker"), topics.blob(CAMPAIGN, "put")
    longest = topics.bytes_max(key)
    told = _asked(bus, key, bytes(longest + 1))
    assert told.refused == f"message: expected at most {longest} bytes on {key}, got {longest + 1}"
    assert _asked(bus, key, bytes(longest)).payload == b"worker"
    _drained(router.heard)
    monkeypatch.setattr(topics, "bytes_max", lambda key: 2**30)  # what somebody with other software would send
    assert _asked(bus, key, bytes(longest + SEAL_BYTES_MAX + 1)).payload is None
    result = topics.result(CAMPAIGN, "fly")
    assert _asked(bus, result, bytes(2 * longest)).payload == b"worker", "results may be longer"
    assert [one.key for one in _drained(router.heard) if isinstance(one, ZenohRequest)] == [result]
    bus.close()


class Heard:
    """An inbox that can be waited for."""

    def __init__(self) -> None:
        self.things: list[object] = []

    def __call__(self, happening: object) -> None:
        self.things.append(happening)

    @property
    def payloads(self) -> list[bytes]:
        """What was published, without who is there."""
        return [one.payload for one in self.things if isinstance(one, Sample)]

    def wait_for(self, *payloads: bytes) -> None:
        """Wait until all these have been heard."""
        until_s = time.monotonic() + PATIENCE_S
        while not set(payloads) <= set(self.payloads):
            assert time.monotonic() < until_s, f"expected {payloads}, heard {self.payloads}"
            time.sleep(0.01)


def _settled(*buses: ZenohBus) -> None:
    """Wait until what these have sent has reached the router and what it sent them before has reached them: a question
    that any key may ask, and its answer, go the same way. Twice, for what the first word of the router brought about.
    """
    for bus in (*buses, *buses):
        assert bus.access()


def _asked(bus: ZenohBus, key: str, payload: bytes) -> Reply:
    inbox: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    bus.ask(key, payload, "one", inbox.put, 5.0)
    reply = inbox.get(timeout=PATIENCE_S)
    assert isinstance(reply, Reply)
    return reply


def _drained(inbox: queue.SimpleQueue[Happening]) -> list[Happening]:
    return [inbox.get() for _ in range(inbox.qsize())]


def _stranger(router: Router, folder: Path, kind: str) -> Path:
    """Return the folder of a key that must not count."""
    now_s = time.time()
    if kind == "of another farm":
        keyring.init(folder / "other", [], now_s=now_s)
        return keyring.add(folder / "other", "ana", ["operator"], now_s=now_s)
    keys = folder / "keys"
    shutil.copytree(router.keys, keys)
    if kind == "signed by itself":
        keyring.init(folder / "own", [], now_s=now_s)
        bundle = keyring.add(folder / "own", "ana", ["operator"], now_s=now_s)
        shutil.copy(router.keys / "farm" / "ca.pem", bundle / "ca.pem")  # so that it trusts this farm's router
        return bundle
    return keyring.add(keys, "late", ["operator"], now_s=now_s - 3 * 86_400, days=1)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("of another farm", "router's certificate is not accepted: .*; it is of another farm than these keys"),
        ("signed by itself", "does not accept this certificate"),
        ("expired", "does not accept this certificate"),
    ],
)
def test_a_certificate_that_does_not_count_gets_nothing_and_is_told_why(
    router: Router, tmp_path: Path, kind: str, words: str
) -> None:
    bundle = _stranger(router, tmp_path, kind)
    good_at_s = time.time() - (2.5 * 86_400 if kind == "expired" else 0.0)  # else its own machine refuses it at once
    credentials = keyring.peer_credentials(bundle, good_at_s)
    with pytest.raises(Unavailable, match=words):
        open_client("stranger", router.endpoint, patience_s=2.0, keys=credentials)


def test_without_a_certificate_nobody_gets_in(router: Router) -> None:
    config = zenoh.Config()
    for key, value in {
        "mode": '"client"',
        "connect/endpoints": f'["{router.endpoint}"]',
        "connect/timeout_ms": "1500",
        "connect/exit_on_failure": "true",
        "scouting/multicast/enabled": "false",
        "transport/link/tls/root_ca_certificate": f'"{router.keys / "farm" / "ca.pem"}"',
    }.items():
        config.insert_json5(key, value)
    with pytest.raises(zenoh.ZError):
        zenoh.open(config)


def test_a_revoked_key_is_connected_to_nothing_and_told_so(router: Router) -> None:
    bus = router.client("gone")
    assert not [name for name, answer in _answers(bus, _asked_of(CAMPAIGN)).items() if answer is not None]
    assert bus.access() == "the key of gone is revoked"
    bus.close()


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_a_campaign_is_flown_by_keys_from_another_namespace_watched_from_a_third_and_a_stranger_gets_nothing(
    tmp_path: Path,
    network: NetworkNamespace,  # noqa: F811
    dart: Path,  # noqa: F811
    opened: ExitStack,
) -> None:
    run_campaign(_campaign(), tmp_path / "near", simulators=2, modules=[dart])
    keys, now_s = tmp_path / "keys", time.time()
    keyring.init(keys, [network.host_ip], now_s=now_s)
    lab = keyring.add(keys, "lab", ["worker", "oracle"], now_s=now_s)
    viewer = keyring.add(keys, "ana", ["viewer"], now_s=now_s)
    endpoint, run_dir = f"tls/{network.host_ip}:{_free_port()}", _new_run(tmp_path / "far", _campaign())
    keyring.init(tmp_path / "other", [], now_s=now_s)
    stranger = keyring.add(tmp_path / "other", "eve", ["operator"], now_s=now_s)
    plain = endpoint.replace("tls/", "tcp/")
    saflite = [sys.executable, "-m", "saflite"]
    there = [*saflite, "watch", "--campaign", "far", "--connect"]
    group = [*saflite, "worker", "--join", endpoint, "--keys", str(lab), "--stages", "fly,judge", "--module", str(dart)]
    pause = [*saflite, "control", "pause", "--connect", endpoint, "--campaign", "far", "--keys", str(viewer)]
    elsewhere = [[*there, endpoint, "--keys", str(viewer)], pause, [*there, endpoint, "--keys", str(stranger)]]
    third = opened.enter_context(NetworkNamespace(1))
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path)
        for command in (
            [*network.prefix, *group],
            *([*third.prefix, *command] for command in (*elsewhere, [*there, plain, "--insecure"])),
        )
    ]
    added: list[Path] = []

    def add_a_key_once(status: object) -> None:
        """The books start anew with it, in the middle of the campaign."""
        if getattr(status, "flights", 0) >= BUDGET // 3 and not added:
            added.append(keyring.add(keys, "late", ["viewer"], now_s=time.time()))

    summary = resume(run_dir, simulators=0, listen=endpoint, keys=keys, on_status=add_a_key_once)
    ends = [process.communicate(timeout=90)[0] for process in started]
    assert summary.ended
    assert added
    assert summary.restarts >= 1
    assert (started[0].returncode, ends[0].splitlines()[-1]) == (0, "the campaign is over"), ends[0]
    assert _found(run_dir) == _found(tmp_path / "near")
    assert {fact.worker for fact in _facts(run_dir) if isinstance(fact, Flown)} <= {
        f"{name}-fly-{number}" for name in _names(ends[0]) for number in range(1, 9)
    }
    assert "VIOLATION" in ends[1], ends[1]
    assert (started[2].returncode, ends[2]) == (
        2,
        "saflite: refused: key: expected one that may `pause`, got the key of ana is for viewer in every campaign\n",
    )
    assert [process.returncode for process in started[3:]] == [3, 3], ends[3:]
    assert "VIOLATION" not in "".join(ends[3:])
    # or it came as the books were starting anew; the words are tested above
    assert "router's certificate is not accepted" in ends[3] or "Connection refused" in ends[3], ends[3]


def _names(said: str) -> set[str]:
    line = next(line for line in said.splitlines() if line.startswith("joining campaign"))
    return {name.rpartition("-fly-")[0] for name in line.partition(": ")[2].split(", ") if "-fly-" in name}
