"""Keys that are replaced, on a real router: which certificate of a name counts, and how the router is given another."""

from __future__ import annotations

import queue
import signal
import socket
import ssl
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_keys import CAMPAIGN, PATIENCE_S, _answers, _asked_of, _free_port, _intended, _open

from saflite.bus import keyring
from saflite.bus.access import Role
from saflite.bus.certificates import Pair, make_certificate
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.zenoh import Gate, open_client, open_router
from saflite.contract.clock import in_utc
from saflite.contract.errors import Unavailable
from saflite.runtime.clock import WallClock
from saflite.runtime.serve import KEYS_CHANGED, _keys_now, _on_change

pytestmark = pytest.mark.live

DAY_S = 86_400.0


@pytest.mark.parametrize("role", ["operator", "viewer"])
def test_a_revoked_certificate_stays_refused_when_its_name_is_given_another(tmp_path: Path, role: Role) -> None:
    keys, now_s = tmp_path / "keys", time.time()
    keyring.init(keys, [], now_s=now_s)
    stolen = keyring.add(keys, "boss", ["operator"], now_s=now_s).rename(tmp_path / "stolen")
    keyring.revoke(keys, "boss")
    keyring.add(keys, "boss", [role], now_s=now_s)
    asked = _asked_of(CAMPAIGN)
    with PrivateSocket() as private:
        router = _open(keys, private)
        thief = open_client("boss", router.endpoint, patience_s=2.0, keys=keyring.peer_credentials(stolen, time.time()))
        boss = router.client("boss")
        got, meant = _answers(thief, asked), _answers(boss, asked)
        told = (thief.access(), boss.access())
        for bus in (thief, boss, router.bus):
            bus.close()
    assert not [name for name, answer in got.items() if answer is not None]
    assert {name for name, answer in meant.items() if answer is not None} == _intended(role)
    assert {answer for answer in meant.values() if answer is not None} == {b"boss"}
    assert "another key of boss was made after this one" in told[0]
    assert told[1] == f"the key of boss is for {role} in every campaign"


def test_workers_whose_key_counts_no_more_are_refused_in_words(tmp_path: Path) -> None:
    """Whether they begin with it or have worked: those that are patient without end asked for ever."""
    keys = tmp_path / "keys"
    keyring.init(keys, [], now_s=time.time())
    lab = keyring.add(keys, "lab", ["worker"], now_s=time.time())
    keyring.revoke(keys, "lab")
    with PrivateSocket() as private:
        router = _open(keys, private)
        command = [sys.executable, "-m", "saflite", "worker", "--join", router.endpoint, "--keys", str(lab)]
        command += ["--patience", "0", "--workers", "1"]
        ends = [
            subprocess.run([*command, *more], capture_output=True, text=True, check=False, timeout=120)
            for more in ([], ["--campaign", CAMPAIGN])
        ]
        router.bus.close()
    for end in ends:
        assert (end.returncode, end.stderr.count("\n")) == (2, 1), end.stderr
        assert end.stderr.startswith("saflite: refused: "), end.stderr
        assert end.stderr.endswith("the key of lab is revoked\n"), end.stderr


def test_what_was_changed_while_a_router_began_is_noticed(tmp_path: Path) -> None:
    keys, now_s, stops = tmp_path / "keys", time.time(), queue.SimpleQueue[str]()
    keyring.init(keys, [], now_s=now_s)
    keyring.add(keys, "boss", ["operator"], now_s=now_s)
    let_in = _keys_now(keys)
    keyring.revoke(keys, "boss")
    _on_change(let_in, WallClock(), stops.put)
    assert stops.get(timeout=60.0) == KEYS_CHANGED


def _served(endpoint: str, keys: Path) -> bytes:
    """Return the certificate that a router shows, as DER; empty where it shows none that is accepted."""
    host, _, port = endpoint.removeprefix("tls/").rpartition(":")
    context = ssl.create_default_context(cafile=str(keys / "farm" / "ca.pem"))
    try:
        with (
            socket.create_connection((host, int(port)), 2.0) as link,
            context.wrap_socket(link, server_hostname=host) as secured,
        ):
            return secured.getpeercert(binary_form=True) or b""
    except OSError:
        return b""


def _wait_for_certificate(endpoint: str, keys: Path) -> None:
    wanted = ssl.PEM_cert_to_DER_cert((keys / "farm" / "cert.pem").read_text())
    until_s = time.monotonic() + PATIENCE_S
    while _served(endpoint, keys) != wanted:
        assert time.monotonic() < until_s, "the router does not show the certificate it was given"
        time.sleep(0.2)


@pytest.mark.parametrize("kind", ["expired", "of another name"])
def test_a_router_that_is_not_accepted_is_told_how_to_be_and_is_then_with_the_same_keys(
    tmp_path: Path, kind: str
) -> None:
    keys, now_s = tmp_path / "keys", time.time()
    began_s = now_s - 366 * DAY_S if kind == "expired" else now_s
    host = "127.0.0.2" if kind == "of another name" else "127.0.0.1"
    keyring.init(keys, [], now_s=began_s)
    bundle = keyring.add(keys, "ana", ["viewer"], now_s=now_s)
    endpoint = f"tls/{host}:{_free_port()}"
    for renewed in (False, True):
        with PrivateSocket() as private:
            gate = Gate(
                endpoint, keyring.farm_credentials(keys, now_s if renewed else began_s), keyring.read_register(keys)
            )
            router = open_router("books", private.endpoint, gate=gate)
            try:
                client = open_client(
                    "ana", endpoint, patience_s=2.0, keys=keyring.peer_credentials(bundle, time.time())
                )
                assert renewed
                assert client.access() == "the key of ana is for viewer in every campaign"
                client.close()
            except Unavailable as fault:
                told = str(fault)
                assert not renewed, told
            router.close()
        if not renewed:
            keyring.renew(keys, [] if kind == "expired" else [host], now_s=now_s)
    assert "router's certificate is not accepted" in told
    assert ("`saflite keys renew`" if kind == "expired" else f"`saflite keys renew --host {host}`") in told


def test_a_farm_that_runs_takes_the_new_certificate_of_its_router(tmp_path: Path) -> None:
    keys, endpoint = tmp_path / "keys", f"tls/127.0.0.1:{_free_port()}"
    saflite = [sys.executable, "-m", "saflite"]
    subprocess.run([*saflite, "keys", "init", "--keys", str(keys)], check=True)
    run = ["run", "avoidance-m2", "--budget", "1000000", "--workers", "1", "--out", str(tmp_path / "run")]
    farm = subprocess.Popen([*saflite, *run, "--listen", endpoint, "--keys", str(keys)], cwd=tmp_path)
    try:
        _wait_for_certificate(endpoint, keys)
        subprocess.run([*saflite, "keys", "renew", "--keys", str(keys)], check=True)
        _wait_for_certificate(endpoint, keys)
    finally:
        farm.send_signal(signal.SIGINT)
        try:
            farm.wait(120)
        finally:
            farm.kill()


def test_a_key_made_before_each_had_a_common_name_of_its_own_counts(tmp_path: Path) -> None:
    keys, now_s = tmp_path / "keys", time.time()
    keyring.init(keys, [], now_s=now_s)
    bundle = keyring.add(keys, "ana", ["viewer"], now_s=now_s)
    authority = Pair((keys / "authority.key").read_bytes(), (keys / "authority.pem").read_bytes())
    old = make_certificate(authority, "ana", in_utc(now_s), in_utc(now_s + 90 * DAY_S))
    (bundle / "cert.pem").write_bytes(old.certificate)
    (bundle / "key.pem").write_bytes(old.key)
    for path in (keys / "register.toml", bundle / "peer.toml"):
        kept = [line for line in path.read_text().splitlines() if not line.startswith("common_name")]
        path.write_text("\n".join(kept))
    with PrivateSocket() as private:
        router = _open(keys, private)
        bus = router.client("ana")
        got, told = _answers(bus, _asked_of(CAMPAIGN)), bus.access()
        bus.close()
        router.bus.close()
    assert {name for name, answer in got.items() if answer is not None} == _intended("viewer")
    assert told == "the key of ana is for viewer in every campaign"
