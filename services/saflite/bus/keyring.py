"""Keys of a farm on disk: the farm's own folder, and the folder each participant is given.

    KEYS/authority.key, authority.pem    signs certificates; needed only by `saflite keys`, never by a farm
    KEYS/register.toml                   who has a key, for what, until when, and whose is revoked
    KEYS/register.lock                   held by who changes any of it
    KEYS/farm/                           what the router shows: ca.pem, cert.pem, key.pem
    KEYS/peers/NAME/                     what the participant NAME is given: ca.pem, cert.pem, key.pem, peer.toml

All of it is for its user only (mode 0700 and 0600). What others could have changed, or own, is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import tomli_w

from saflite.bus.access import ANY_CAMPAIGN, STAGE_OF, Peer, Role, is_reserved
from saflite.bus.certificates import Pair, make_authority, make_certificate, new_common_name, validity
from saflite.bus.key_files import alone, check_ours, make_private, write
from saflite.contract import wire
from saflite.contract.clock import in_utc
from saflite.contract.errors import Refused
from saflite.contract.names import NAME_CHARS_MAX, NAME_EXPECTED, is_name
from saflite.contract.outside import parse_toml, read_bytes, read_text
from saflite.contract.plain import argument

REGISTER, FARM, PEERS, PEER = "register.toml", "farm", "peers", "peer.toml"
AUTHORITY_KEY, AUTHORITY = "authority.key", "authority.pem"
CA, CERTIFICATE, KEY = "ca.pem", "cert.pem", "key.pem"
DAYS_MAX = 3650
WARN_BEFORE = timedelta(days=30)
KEY_BYTES_MAX = 65536
WORKER_KEY_CHARS_MAX = NAME_CHARS_MAX - len("-0a1b2c-mutate-1000")
"""Room for what follows a key's name in its workers' names: their folder, stage and number."""
NEW_AUTHORITY = "make new keys, for all, with `saflite keys init` in a folder of their own"
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?|[0-9A-Fa-f:.]+")

T = TypeVar("T", bound=msgspec.Struct)


class Register(msgspec.Struct, frozen=True, kw_only=True):
    """Who has a key. `hosts` are the names and addresses the router is reached by."""

    hosts: tuple[str, ...]
    peers: tuple[Peer, ...] = ()

    def named(self, name: str) -> Peer | None:
        """Return the participant of a name."""
        return next((peer for peer in self.peers if peer.name == name), None)

    def is_revoked(self, name: str) -> bool:
        """Whether a participant's key was revoked, and no other was made for that name."""
        peer = self.named(name)
        return peer is not None and peer.revoked

    def key_of(self) -> Callable[[str], str]:
        """Return what tells the key that a worker's name begins with, empty where that is nobody's."""
        names = frozenset(peer.name for peer in self.peers)

        def key_of(worker: str) -> str:
            while worker and worker not in names:
                worker = worker.rpartition("-")[0]
            return worker

        return key_of


class Credentials(NamedTuple):
    """What one end of the bus proves itself with. `peer` is None for the router's own."""

    folder: Path
    peer: Peer | None = None

    def tls(self) -> dict[str, Any]:
        """Return Zenoh's `transport/link/tls`: both sides show a certificate, and a link ends when one expires."""
        key, certificate = str(self.folder / KEY), str(self.folder / CERTIFICATE)
        return {
            "root_ca_certificate": str(self.folder / CA),
            "enable_mtls": True,
            "listen_private_key": key,
            "listen_certificate": certificate,
            "connect_private_key": key,
            "connect_certificate": certificate,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }


def init(folder: Path, hosts: Sequence[str], *, now_s: float, days: int = 365, if_needed: bool = False) -> Register:
    """Make a farm's authority and the router's certificate for the names and addresses it is reached by.

    With `if_needed` keys that are there already stay as they are.

    Raises:
        Refused: there are keys already, or a host is none.
    """
    now = _instant(now_s)
    _check_days(days)
    _check_hosts(hosts)
    if if_needed and (folder / REGISTER).exists():
        return read_register(folder)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    check_ours(folder)
    with alone(folder):
        if (folder / REGISTER).exists():
            if if_needed:
                return read_register(folder)
            fix = "`saflite keys add` makes more of them, `saflite keys renew --host NAME` adds a name of the router"
            raise Refused("keys folder", where=str(folder), expected="no keys in it yet", got=REGISTER, fix=fix)
        make_private(folder)
        authority = make_authority(now, DAYS_MAX)
        write(folder / AUTHORITY_KEY, authority.key)
        write(folder / AUTHORITY, authority.certificate)
        names = tuple(dict.fromkeys([*hosts, "localhost", "127.0.0.1"]))
        _write_bundle(folder / FARM, authority, make_certificate(authority, FARM, now, now + timedelta(days), names))
        register = Register(hosts=names)
        _write_register(folder, register)
    return register


def renew(folder: Path, hosts: Sequence[str] = (), *, now_s: float, days: int = 365) -> Register:
    """Make a new certificate for the router, for the names it has and `hosts`; farms that run take it by themselves.

    Raises:
        Refused: no keys here, the authority's key is elsewhere or its time is over, or a host is none.
    """
    now = _instant(now_s)
    _check_days(days)
    _check_hosts(hosts)
    with _changing(folder) as register:
        authority, until = _authority(folder, now, days)
        names = tuple(dict.fromkeys([*register.hosts, *hosts]))
        renewed = msgspec.structs.replace(register, hosts=names)
        _write_bundle(folder / FARM, authority, make_certificate(authority, FARM, now, until, names))
        _write_register(folder, renewed)
    return renewed


class Ends(NamedTuple):
    """Until when a router can be reached: its certificate's end, and that of the authority, which no key outlasts."""

    router: datetime
    authority: datetime


def ends(folder: Path) -> Ends:
    """Return until when the router's certificate and the authority are good; raises Refused where there is neither."""
    return Ends(*(validity(_read(folder / FARM / name))[1] for name in (CERTIFICATE, CA)))


def warnings(folder: Path, now_s: float) -> list[str]:
    """Return in words what is over or ends soon; raises Refused as `ends` does."""
    now, until = _instant(now_s), ends(folder)
    said = (
        (until.router, "the router's certificate", _renewing(folder)),
        (until.authority, "the authority, and with it every key,", NEW_AUTHORITY),
    )
    return [
        f"{what} {'ends' if now < end else 'expired'} at {end:%Y-%m-%d %H:%M} UTC: {fix}"
        for end, what, fix in said
        if end - now < WARN_BEFORE
    ]


def add(
    folder: Path,
    name: str,
    roles: Sequence[Role],
    *,
    campaigns: Sequence[str] = (ANY_CAMPAIGN,),
    now_s: float,
    days: int = 90,
    if_needed: bool = False,
) -> Path:
    """Make a key for a participant and return the folder to give to it, also where an earlier one counts no more.

    With `if_needed` a key of that name that counts, for the same and in the same campaigns, stays as it is.

    Raises:
        Refused: no keys here, a name that is taken or reads as another's, a campaign name that is none.
    """
    now = _instant(now_s)
    _check_days(days)
    for campaign in campaigns:
        if campaign != ANY_CAMPAIGN and not is_name(campaign):
            raise Refused("--campaign", expected=NAME_EXPECTED, got=repr(campaign[:80]))
    wanted = Peer(name=name, roles=tuple(dict.fromkeys(roles)), campaigns=tuple(campaigns))
    bundle = folder / PEERS / name
    if if_needed and _has(read_register(folder), wanted, now_s):
        return bundle
    with _changing(folder) as register:
        if if_needed and _has(register, wanted, now_s):
            return bundle
        _check_name(register, wanted, now_s)
        authority, until = _authority(folder, now, days)
        common_name = new_common_name(name)  # never an earlier one's, which stays refused
        pair = make_certificate(authority, common_name, now, until)
        peer = msgspec.structs.replace(wanted, expires=_written(until), common_name=common_name)
        make_private(folder / PEERS)
        _write_bundle(bundle, authority, pair)
        write(bundle / PEER, tomli_w.dumps(msgspec.to_builtins(peer)).encode())
        others = tuple(one for one in register.peers if one.name != name)
        _write_register(folder, msgspec.structs.replace(register, peers=(*others, peer)))
    return bundle


def revoke(folder: Path, name: str) -> None:
    """Let a key count no more; farms that run take notice by themselves. Raises Refused for a name without a key."""
    with _changing(folder) as register:
        if register.named(name) is None:
            known = ", ".join(peer.name for peer in register.peers) or "none"
            raise Refused("key", expected=f"one of {known}", got=repr(name[:80]))
        peers = tuple(msgspec.structs.replace(one, revoked=True) if one.name == name else one for one in register.peers)
        _write_register(folder, msgspec.structs.replace(register, peers=peers))


def counts(peer: Peer, now_s: float) -> bool:
    """Return whether a key is neither revoked nor past its end."""
    return not peer.revoked and peer.expires > _written(_instant(now_s))


@contextmanager
def _changing(folder: Path) -> Iterator[Register]:
    """Give the register to who changes it, one after the other: what another changes meanwhile would be lost."""
    read_register(folder)  # a lock is not made where there are no keys
    with alone(folder):
        yield read_register(folder)


def _has(register: Register, wanted: Peer, now_s: float) -> bool:
    peer = register.named(wanted.name)
    if peer is None or not counts(peer, now_s):
        return False
    in_all = ANY_CAMPAIGN in peer.campaigns
    return set(wanted.roles) <= set(peer.roles) and (in_all or set(wanted.campaigns) <= set(peer.campaigns))


def read_register(folder: Path) -> Register:
    """Return who has a key; raises Refused where there are no keys or the register is damaged."""
    if not (folder / REGISTER).is_file():
        fix = f"`saflite keys init --keys {argument(folder)} --host NAME` makes them"
        raise Refused("keys folder", where=str(folder), expected="the keys of a farm", got=f"no {REGISTER}", fix=fix)
    return _toml(folder / REGISTER, Register)


def farm_credentials(folder: Path, now_s: float) -> Credentials:
    """Return what a router shows; raises Refused where it has nothing that counts."""
    read_register(folder)
    return _checked(Credentials(folder / FARM), now_s)


def peer_credentials(folder: Path, now_s: float) -> Credentials:
    """Return what a participant shows, out of the folder it was given.

    Raises:
        Refused: it is no such folder, others can read its key or change any of it, it has expired, or begins later.
    """
    if not (folder / PEER).is_file():
        fix = "`saflite keys add NAME --role ROLE` makes one, on the machine of the farm"
        raise Refused("--keys", where=str(folder), expected="the folder of one key", got=f"no {PEER}", fix=fix)
    return _checked(Credentials(folder, _toml(folder / PEER, Peer)), now_s)


def _authority(folder: Path, now: datetime, days: int) -> tuple[Pair, datetime]:
    """Return what signs, and until when what it signs for some days is good: no longer than itself."""
    authority = Pair(_read(folder / AUTHORITY_KEY, private=True), _read(folder / AUTHORITY))
    end = validity(authority.certificate)[1]
    if end <= now:
        got = f"one that expired at {end:%Y-%m-%d %H:%M} UTC"
        raise Refused("authority", where=str(folder), expected="one that is good", got=got, fix=NEW_AUTHORITY)
    return authority, min(now + timedelta(days), end)


def _renewing(folder: Path) -> str:
    return f"`saflite keys renew --keys {argument(folder)}`, where the authority's key is, makes a new one"


def _checked(credentials: Credentials, now_s: float) -> Credentials:
    for name in (CA, CERTIFICATE, KEY):
        path = credentials.folder / name
        if not path.is_file():
            raise Refused(
                "key", where=str(credentials.folder), expected=f"{CA}, {CERTIFICATE}, {KEY}", got=f"no {name}"
            )
    _read(credentials.folder / KEY, private=True)
    begins, until = validity(_read(credentials.folder / CERTIFICATE))
    authority_until = validity(_read(credentials.folder / CA))[1]
    until = min(until, authority_until)
    if begins <= _instant(now_s) < until:
        return credentials
    if _instant(now_s) < begins:
        got = f"one that begins at {begins:%Y-%m-%d %H:%M} UTC"
        fix = f"set the clock of this machine, which says {_instant(now_s):%Y-%m-%d %H:%M} UTC"
    else:
        got = f"one that expired at {until:%Y-%m-%d %H:%M} UTC"
        fix = "`saflite keys add NAME --role ROLE`, where the farm's keys are, makes a new one"
        if credentials.peer is None:
            fix = _renewing(credentials.folder.parent)
        if until == authority_until:
            fix = NEW_AUTHORITY
    raise Refused("certificate", where=str(credentials.folder), expected="one that is good", got=got, fix=fix)


def _written(instant: datetime) -> str:
    return instant.strftime("%Y-%m-%dT%H:%M:%SZ")


def _check_name(register: Register, wanted: Peer, now_s: float) -> None:
    name = wanted.name
    if not is_name(name):
        raise Refused("key name", expected=NAME_EXPECTED, got=repr(name[:80]))
    if is_reserved(name):
        fix = f"name it by who uses it: `saflite keys add lab-{name} ...`"
        raise Refused("key name", expected="none that a farm gives its own processes", got=repr(name), fix=fix)
    if len(name) > WORKER_KEY_CHARS_MAX and any(role in STAGE_OF for role in wanted.roles):
        expected = f"at most {WORKER_KEY_CHARS_MAX} characters: the names of workers begin with it"
        raise Refused("key name", expected=expected, got=f"{len(name)} in {name!r}")
    for other in register.peers:
        if other.name == name and counts(other, now_s):
            raise Refused("key name", expected="a new one", got=f"{name!r}, which has a key", fix="revoke it first")
        if other.name != name and (other.name.startswith(f"{name}-") or name.startswith(f"{other.name}-")):
            got = f"{name!r} beside {other.name!r}"
            raise Refused("key name", expected="none that begins with another's and a dash", got=got)


def _check_hosts(hosts: Sequence[str]) -> None:
    for host in hosts:
        if not _HOST.fullmatch(host):
            raise Refused("--host", expected="a host name or an address", got=repr(host))


def _check_days(days: int) -> None:
    if not 1 <= days <= DAYS_MAX:
        raise Refused("--days", expected=f"1 to {DAYS_MAX}", got=days)


def _instant(now_s: float) -> datetime:
    return in_utc(now_s)


def _read(path: Path, *, private: bool = False) -> bytes:
    data = read_bytes(path, "key", KEY_BYTES_MAX, private=private)
    check_ours(path)
    return data


def _toml(path: Path, kind: type[T]) -> T:
    text = read_text(path, "keys")
    check_ours(path)
    try:
        return wire.convert(parse_toml(text, "keys", str(path)), kind)
    except msgspec.ValidationError as fault:
        raise Refused("keys", where=str(path), expected="what `saflite keys` writes", got=str(fault)) from fault


def _write_register(folder: Path, register: Register) -> None:
    write(folder / REGISTER, tomli_w.dumps(msgspec.to_builtins(register)).encode())


def _write_bundle(folder: Path, authority: Pair, pair: Pair) -> None:
    make_private(folder)
    write(folder / CA, authority.certificate)
    write(folder / KEY, pair.key)
    write(folder / CERTIFICATE, pair.certificate)  # last: farms that run look for its change
