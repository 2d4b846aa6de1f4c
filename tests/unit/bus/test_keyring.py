"""Keys on disk: who is given one, who is refused one, and what is told when one is damaged, open or expired."""

from __future__ import annotations

import errno
import os
import stat
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import NameOID

from saflite.bus import keyring
from saflite.bus.access import ROLES, STAGE_OF, Peer, Role, access_control, in_words, speaks_for, split
from saflite.bus.endpoints import check_endpoint
from saflite.console.io.campaign_options import WORKERS_MAX
from saflite.contract.errors import Refused
from saflite.contract.names import is_name
from saflite.contract.topics import STAGES
from saflite.runtime.worker_group import _name_here

NOW_S = 1_800_000_000.0
DAY_S = 86_400.0


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    keyring.init(tmp_path / "keys", ["10.0.0.5", "lab.example.org"], now_s=NOW_S)
    return tmp_path / "keys"


def test_everything_written_is_for_its_user_only(keys: Path) -> None:
    keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in [keys, *keys.rglob("*")]}
    assert {mode for path, mode in modes.items() if path.is_dir()} == {0o700}
    assert {mode for path, mode in modes.items() if path.is_file()} == {0o600}


@pytest.mark.parametrize("role", ROLES)
def test_a_key_for_workers_leaves_room_for_what_follows_in_their_names(keys: Path, role: Role, tmp_path: Path) -> None:
    """A key was made, copied to a far machine, and no worker could use it there: its own name was refused."""
    longest = "k" * keyring.WORKER_KEY_CHARS_MAX
    keyring.add(keys, longest, [role], now_s=NOW_S)
    assert all(is_name(f"{_name_here(tmp_path, longest)}-{stage}-{WORKERS_MAX}") for stage in STAGES)
    if role in STAGE_OF:
        with pytest.raises(Refused, match=f"at most {len(longest)} characters"):
            keyring.add(keys, "j" + longest, ["viewer", role], now_s=NOW_S)
    else:
        keyring.add(keys, "j" * 64, [role], now_s=NOW_S)


def test_a_key_that_could_not_be_written_leaves_nothing(keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    before = {path for path in keys.rglob("*") if path.is_file()}
    with pytest.raises(OSError, match="No space"):
        keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    assert {path for path in keys.rglob("*") if path.is_file()} == before


def test_the_folder_given_away_holds_no_key_of_the_authority(keys: Path) -> None:
    bundle = keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    assert {path.name for path in bundle.iterdir()} == {"ca.pem", "cert.pem", "key.pem", "peer.toml"}
    assert (keys / "authority.key").read_bytes() not in {path.read_bytes() for path in bundle.iterdir()}


def test_a_farm_runs_without_the_key_of_the_authority(keys: Path) -> None:
    (keys / "authority.key").unlink()
    assert keyring.farm_credentials(keys, NOW_S).tls()["enable_mtls"] is True


def test_a_key_says_whose_it_is_what_for_and_until_when(keys: Path) -> None:
    bundle = keyring.add(keys, "ana", ["viewer"], campaigns=["night"], now_s=NOW_S, days=30)
    peer = keyring.peer_credentials(bundle, NOW_S).peer
    assert peer == keyring.read_register(keys).named("ana")
    assert peer is not None
    assert (peer.may("night"), peer.may("day"), peer.expires) == (True, False, "2027-02-14T08:00:00Z")


def test_a_revoked_key_may_nothing_and_can_be_made_anew(keys: Path) -> None:
    keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    keyring.revoke(keys, "lab2")
    (peer,) = keyring.read_register(keys).peers
    assert not peer.may("night")
    assert "cert_common_names" not in str(access_control([peer]))
    keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    assert [one.revoked for one in keyring.read_register(keys).peers] == [False]


def _common_name(bundle: Path) -> str:
    subject = x509.load_pem_x509_certificate((bundle / "cert.pem").read_bytes()).subject
    return str(subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def _let_in(keys: Path) -> list[str]:
    """Return the common names that the router's access control knows."""
    subjects = access_control(keyring.read_register(keys).peers)["subjects"]
    return [name for subject in subjects for name in subject.get("cert_common_names", [])]


@pytest.mark.parametrize("later", ["revoked", "expired", "for less", "elsewhere"])
@pytest.mark.parametrize(("name", "role"), [("lab2", "worker"), ("x" * 64, "viewer")])
def test_no_certificate_of_a_name_counts_again_when_another_is_made(
    keys: Path, name: str, role: Role, later: str
) -> None:
    then_s = NOW_S + 91 * DAY_S if later == "expired" else NOW_S
    roles: list[Role] = [role] if later == "for less" else [role, "operator"]
    campaigns = ["day"] if later == "elsewhere" else ["*"]
    earlier = set()
    for _ in range(3):
        bundle = keyring.add(keys, name, [role, "operator"], now_s=NOW_S)
        earlier.add(_common_name(bundle))
        if later != "expired":
            keyring.revoke(keys, name)
        bundle = keyring.add(keys, name, roles, campaigns=campaigns, now_s=then_s)
        assert _common_name(bundle) not in earlier
        assert _let_in(keys) == [_common_name(bundle)]
        earlier.add(_common_name(bundle))
        keyring.revoke(keys, name)
        assert not _let_in(keys)
    assert len(earlier) == 6


def test_a_register_made_before_each_key_had_a_common_name_counts_until_it_is_made_anew(keys: Path) -> None:
    register = keys / "register.toml"
    old = '[[peers]]\nname = "old"\nroles = ["viewer"]\nexpires = "2027-02-14T08:00:00Z"\n'
    register.write_text(register.read_text().replace("peers = []\n", old))
    assert _let_in(keys) == ["old"]
    keyring.revoke(keys, "old")
    bundle = keyring.add(keys, "old", ["viewer"], now_s=NOW_S)
    assert _let_in(keys) == [_common_name(bundle)] != ["old"]


def test_who_shows_an_earlier_key_is_told_that_there_is_a_later_one() -> None:
    peer = Peer(name="lab2", roles=("viewer",), common_name="lab2~0123456789abcdef")
    assert in_words(peer, "lab2", peer.shown) == "the key of lab2 is for viewer in every campaign"
    for shown in ("lab2", "lab2~fedcba9876543210"):
        assert "another key of lab2 was made after this one" in in_words(peer, "lab2", shown)
    assert in_words(None, "eve", "eve") == "eve has no key in this farm's register"


def _at_once(*calls: Callable[[], object]) -> list[object]:
    """Call all at the same time; returns what each returned, or why it was refused."""
    begin = threading.Barrier(len(calls))

    def call(one: Callable[[], object]) -> object:
        begin.wait()
        try:
            return one()
        except Refused as fault:
            return fault

    with ThreadPoolExecutor(len(calls)) as pool:
        return list(pool.map(call, calls))


def test_changes_made_at_once_all_count(keys: Path) -> None:
    revoked = [f"thief{number}" for number in range(4)]
    added = [f"lab{number}" for number in range(8)]
    for name in revoked:
        keyring.add(keys, name, ["operator"], now_s=NOW_S)
    said = _at_once(
        *(partial(keyring.revoke, keys, name) for name in revoked),
        *(partial(keyring.add, keys, name, ["worker"], now_s=NOW_S) for name in added),
    )
    assert said == [*[None] * 4, *(keys / "peers" / name for name in added)]
    register = keyring.read_register(keys)
    assert {peer.name: peer.revoked for peer in register.peers} == {
        **dict.fromkeys(revoked, True),
        **dict.fromkeys(added, False),
    }
    assert not [path for path in keys.rglob("*") if "part" in path.name]


def test_keys_made_at_once_in_one_folder_are_of_one_authority(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    said = _at_once(*[partial(keyring.init, keys, ["lab"], now_s=NOW_S)] * 4)
    assert len([one for one in said if isinstance(one, keyring.Register)]) == 1
    assert len([one for one in said if "no keys in it yet" in str(one)]) == 3
    authority = x509.load_pem_x509_certificate((keys / "authority.pem").read_bytes())
    x509.load_pem_x509_certificate((keys / "farm" / "cert.pem").read_bytes()).verify_directly_issued_by(authority)
    key = load_pem_private_key((keys / "authority.key").read_bytes(), None)
    assert key.public_key() == authority.public_key()


def test_a_key_that_is_needed_is_made_once(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    made = partial(keyring.init, keys, ["lab"], now_s=NOW_S, if_needed=True)
    assert len({str(one) for one in _at_once(*[made] * 4)}) == 1
    needed = partial(keyring.add, keys, "ray", ["worker", "oracle"], now_s=NOW_S, if_needed=True)
    assert _at_once(*[needed] * 4) == [keys / "peers" / "ray"] * 4
    first = _common_name(keys / "peers" / "ray")
    assert _let_in(keys) == [first]
    keyring.add(keys, "ray", ["worker"], campaigns=["night"], now_s=NOW_S, if_needed=True)
    assert _let_in(keys) == [first]
    with pytest.raises(Refused, match="revoke it first"):
        keyring.add(keys, "ray", ["operator"], now_s=NOW_S, if_needed=True)
    keyring.add(keys, "ray", ["worker"], now_s=NOW_S + 91 * DAY_S, if_needed=True)
    assert _let_in(keys) == [_common_name(keys / "peers" / "ray")] != [first]


def _router_names(keys: Path) -> list[str]:
    certificate = x509.load_pem_x509_certificate((keys / "farm" / "cert.pem").read_bytes())
    certificate.verify_directly_issued_by(x509.load_pem_x509_certificate((keys / "farm" / "ca.pem").read_bytes()))
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(name.value) for name in names]


def test_the_router_is_given_a_new_certificate_for_the_names_it_has_and_more(keys: Path) -> None:
    bundle = keyring.add(keys, "lab2", ["worker"], now_s=NOW_S, days=3000)
    before = keyring.read_register(keys)
    late_s = NOW_S + 400 * DAY_S
    with pytest.raises(Refused, match="keys renew") as fault:
        keyring.farm_credentials(keys, late_s)
    assert f"--keys {keys}" in str(fault.value)
    keyring.renew(keys, ["farm.example.org", "10.0.0.5"], now_s=late_s, days=100)
    assert keyring.farm_credentials(keys, late_s + 99 * DAY_S)
    names = ["10.0.0.5", "lab.example.org", "localhost", "127.0.0.1", "farm.example.org"]
    register = keyring.read_register(keys)
    assert (list(register.hosts), register.peers) == (names, before.peers)
    assert _router_names(keys) == names
    assert (bundle / "ca.pem").read_bytes() == (keys / "farm" / "ca.pem").read_bytes()
    with pytest.raises(Refused, match="--host"):
        keyring.renew(keys, ["no host"], now_s=late_s)


def test_nothing_is_promised_beyond_the_end_of_the_authority(keys: Path) -> None:
    keyring.renew(keys, now_s=NOW_S + 3600 * DAY_S)
    bundle = keyring.add(keys, "lab2", ["worker"], now_s=NOW_S + 3600 * DAY_S)
    end = keyring.ends(keys).authority
    assert keyring.ends(keys).router == end
    peer = keyring.peer_credentials(bundle, NOW_S + 3649 * DAY_S).peer
    assert peer is not None
    assert peer.expires == f"{end:%Y-%m-%dT%H:%M:%SZ}"
    late_s = NOW_S + 3651 * DAY_S
    for late in (
        partial(keyring.renew, keys, now_s=late_s),
        partial(keyring.add, keys, "lab3", ["worker"], now_s=late_s),
        partial(keyring.farm_credentials, keys, late_s),
        partial(keyring.peer_credentials, bundle, late_s),
    ):
        with pytest.raises(Refused, match="keys init"):
            late()


@pytest.mark.parametrize(
    ("days", "words"),
    [
        (300, []),
        (340, ["router's certificate ends at 2028-01-15 08:00 UTC: `saflite keys renew"]),
        (366, ["router's certificate expired at 2028-01-15 08:00 UTC: `saflite keys renew"]),
        (3630, ["router's certificate expired", "authority, and with it every key, ends"]),
    ],
)
def test_what_ends_soon_or_is_over_is_said(keys: Path, days: int, words: list[str]) -> None:
    said = keyring.warnings(keys, NOW_S + days * DAY_S)
    assert len(said) == len(words)
    assert all(part in one for part, one in zip(words, said, strict=True)), said


@pytest.mark.parametrize("name", ["", "../up", "a b", "farm", "lab2", "lab2-b", "x" * 65, "by/lab", "lab\n", "*"])
def test_a_name_that_could_be_another_s_is_refused(keys: Path, name: str) -> None:
    keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    with pytest.raises(Refused, match="key name"):
        keyring.add(keys, name, ["worker"], now_s=NOW_S)


def test_a_name_that_begins_another_s_is_refused(keys: Path) -> None:
    keyring.add(keys, "lab2-b", ["worker"], now_s=NOW_S)
    with pytest.raises(Refused, match="none that begins"):
        keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)


def test_faults_of_a_folder_are_told_by_name(keys: Path, tmp_path: Path) -> None:
    bundle = keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    with pytest.raises(Refused, match="expired"):
        keyring.peer_credentials(bundle, NOW_S + 91 * DAY_S)
    with pytest.raises(Refused, match="set the clock of this machine"):
        keyring.peer_credentials(bundle, NOW_S - DAY_S)
    (bundle / "key.pem").chmod(0o644)
    with pytest.raises(Refused, match="mode 0600"):
        keyring.peer_credentials(bundle, NOW_S)
    (bundle / "key.pem").unlink()
    with pytest.raises(Refused, match=r"no key\.pem"):
        keyring.peer_credentials(bundle, NOW_S)
    (bundle / "peer.toml").write_text("name = 3")
    with pytest.raises(Refused, match=r"peer\.toml"):
        keyring.peer_credentials(bundle, NOW_S)
    with pytest.raises(Refused, match=r"no peer\.toml"):
        keyring.peer_credentials(tmp_path, NOW_S)
    with pytest.raises(Refused, match="saflite keys init"):
        keyring.read_register(tmp_path)
    with pytest.raises(Refused, match="no keys in it yet"):
        keyring.init(keys, [], now_s=NOW_S)
    with pytest.raises(Refused, match="one of lab2"):
        keyring.revoke(keys, "lab3")


def test_endpoints_with_and_without_keys() -> None:
    assert check_endpoint("tls/0.0.0.0:7447", insecure=False, keys=True).from_here == "tls/127.0.0.1:7447"
    for text, has_keys in [("tls/10.0.0.5:7447", False), ("tcp/10.0.0.5:7447", True), ("unixsock-stream//a", True)]:
        with pytest.raises(Refused, match="keys" if not has_keys else "endpoint"):
            check_endpoint(text, insecure=True, keys=has_keys)


def test_a_name_speaks_only_for_workers_named_after_it() -> None:
    assert speaks_for("lab2", "lab2-fly-1")
    assert speaks_for("", "whoever")
    assert not speaks_for("lab2", "lab22-fly-1")
    assert not speaks_for("lab2", "lab3-fly-1")


def test_the_key_of_a_worker_is_told_by_its_name() -> None:
    peers = tuple(Peer(name=name, roles=("worker",)) for name in ("lab2", "site-a", "site-b"))
    key_of = keyring.Register(hosts=(), peers=peers).key_of()
    assert [key_of(name) for name in ("lab2", "lab2-fly-1", "site-a-0-fly-1", "site-b")] == [
        "lab2",
        "lab2",
        "site-a",
        "site-b",
    ]
    assert [key_of(name) for name in ("fly-1", "site-c-1", "lab22-1", "", "-")] == [""] * 5


RESERVED = ["farm", "books", "router", *STAGES, "fly-1", "judge-1000"]


@pytest.mark.parametrize("name", RESERVED)
def test_names_that_a_farm_gives_itself_are_no_key_s(tmp_path: Path, name: str) -> None:
    keyring.init(tmp_path / "keys", [], now_s=NOW_S)
    with pytest.raises(Refused, match=r"its own processes.*lab-"):
        keyring.add(tmp_path / "keys", name, ["worker"], now_s=NOW_S)
    for own in (name, f"{name}-1", f"{name}-1-fly-2"):
        assert not speaks_for(name, own), "a key of an older version may have that name"
    assert keyring.add(tmp_path / "keys", f"lab-{name}", ["worker"], now_s=NOW_S).is_dir()
    assert speaks_for(f"lab-{name}", f"lab-{name}-fly-1")


def test_a_key_of_an_older_version_with_a_name_of_the_farm_s_own_is_for_no_worker_and_told_so() -> None:
    peer = Peer(name="fly", roles=("worker", "viewer"))
    granted = [key for rule in access_control([peer])["rules"] if "by/fly" in str(rule) for key in rule["key_exprs"]]
    assert any("control/status" in key for key in granted)
    assert not [key for key in granted if "control/" not in key]
    assert "alive" not in str(access_control([peer]))
    settings = access_control([msgspec.structs.replace(peer, roles=("worker",))])  # Zenoh refuses empty lists
    assert all(rule["key_exprs"] for rule in settings["rules"])
    assert all(policy["rules"] for policy in settings["policies"])
    assert "by/fly" not in str(settings)
    assert "add a key of another name" in in_words(peer, "fly", "fly")


def test_a_key_speaks_for_no_worker_that_another_or_the_farm_s_own_user_joined() -> None:
    assert speaks_for("host", "host-fly-1", None)
    assert speaks_for("host", "host-fly-1", "host")
    assert not speaks_for("host", "host-fly-1", "")
    assert not speaks_for("host-a", "host-a-1", "host")
    assert speaks_for("", "host-fly-1", "host"), "on the private socket is who runs the farm"


def test_a_key_holds_the_proven_name_before_the_rest() -> None:
    assert split("by/lab2/saflite/2/night/work/fly") == ("lab2", "saflite/2/night/work/fly")
    assert split("saflite/2/night/work/fly") == ("", "saflite/2/night/work/fly")


@pytest.mark.parametrize("role", ROLES)
def test_every_rule_of_a_role_names_its_holder_or_is_for_reading(role: Role) -> None:
    peer = Peer(name="lab2", roles=(role,), campaigns=("night",))
    rules = [rule for rule in access_control([peer])["rules"] if rule["id"].startswith("lab2/")]
    assert rules
    for rule in rules:
        for key in rule["key_exprs"]:
            if rule["flows"] == ["ingress"] and set(rule["messages"]) & {"put", "delete", "declare_queryable"}:
                pytest.fail(f"{role} may publish on {key}")
            if "query" in rule["messages"] and rule["flows"] == ["ingress"]:
                assert key.startswith("by/lab2/") or "/event/" in key or "/event-json/" in key
                assert "night" in key
