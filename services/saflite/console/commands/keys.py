"""Make and withdraw the keys by which machines and people reach a farm over a network: certificates, one per name.

`init` makes a farm's own authority, once, on the machine that will run farms; `--host` is how others reach it. `add`
makes a folder for one name: copy it to where it is used, over a channel you trust. `revoke` withdraws a key; farms that
run take notice within seconds. `renew` makes a new certificate for the router, before the one it has is over (`list`
says when) or for more names. What a key may do is settled by its roles: worker (flies), scorer, oracle, mutator,
recorder, viewer (reads), operator (reads and orders).

examples:
  saflite keys init --host lab.example.org --host 10.0.0.5
  saflite keys add lab2 --role worker --role recorder
  saflite keys add ana --role viewer --campaign night --days 30
  saflite keys revoke lab2
  saflite keys renew --host farm.example.org
  saflite run night.toml --listen tls/0.0.0.0:7447 --keys keys
  saflite worker --join tls/10.0.0.5:7447 --keys lab2
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from datetime import datetime

FOLDER = Path("keys")
INSTANT = "%Y-%m-%dT%H:%M:%SZ"


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="init|add|list|revoke|renew")
    init = verbs.add_parser("init", help="make a farm's authority and the certificate of its router")
    add = verbs.add_parser("add", help="make a key")
    add.add_argument("name", help="whose it is; names of its workers begin with it")
    add.add_argument("--role", action="append", default=[], required=True, metavar="ROLE", help="may be repeated")
    add.add_argument("--campaign", action="append", default=[], help="only for this campaign (may be repeated)")
    add.add_argument("--days", type=int, default=90, help="how long it is good (90)")
    for verb in (init, add):
        verb.add_argument("--if-needed", action="store_true", help="leave one that counts, for the same, as it is")
    listing = verbs.add_parser("list", help="who has a key, for what, until when")
    listing.add_argument("--json", action="store_true", help="print as JSON")
    revoke = verbs.add_parser("revoke", help="let a key count no more")
    revoke.add_argument("name", help="whose")
    renew = verbs.add_parser("renew", help="make a new certificate for the router, by the same authority")
    reached = "name or address others reach it by (may be repeated)"
    for verb in (init, renew):
        verb.add_argument("--host", action="append", default=[], metavar="NAME", help=reached)
        verb.add_argument("--days", type=int, default=365, help="how long the router's certificate is good (365)")
    for verb in (init, add, listing, revoke, renew):
        verb.add_argument("--keys", type=Path, default=FOLDER, metavar="FOLDER", help=f"the farm's keys ({FOLDER}/)")


def run(args: argparse.Namespace) -> int:
    """Do it and say what to do next."""
    from saflite.console.view import out
    from saflite.contract.errors import Unavailable
    from saflite.runtime.clock import WallClock

    now_s = WallClock().unix_s()
    if args.verb == "list":
        _list(args, now_s)
        return 0
    try:
        done = _do(args, now_s)
    except OSError as fault:
        raise Unavailable(f"{args.keys} cannot be written: {fault.strerror or fault}") from fault
    for line in done:  # what is wrong with where that goes is not said of the keys
        out.line(line)
    return 0


def _do(args: argparse.Namespace, now_s: float) -> list[str]:
    """Do it and return what to say."""
    from saflite.bus import keyring
    from saflite.contract.plain import argument

    if args.verb == "init":
        register = keyring.init(args.keys, args.host, now_s=now_s, days=args.days, if_needed=args.if_needed)
        return [
            f"keys in {args.keys}; the router is reached by {', '.join(register.hosts)}",
            f"next: saflite keys add NAME --role ROLE --keys {argument(args.keys)}",
        ]
    if args.verb == "add":
        return _add(args, now_s)
    if args.verb == "renew":
        register = keyring.renew(args.keys, args.host, now_s=now_s, days=args.days)
        until = _until(keyring.ends(args.keys).router, now_s)
        return [
            f"the router has a new certificate, for {', '.join(register.hosts)}, {until}",
            f"farms that run with {args.keys} take it within seconds: their router starts again, nothing is lost",
        ]
    keyring.revoke(args.keys, args.name)
    return [f"the key of {args.name} counts no more"]


def _add(args: argparse.Namespace, now_s: float) -> list[str]:
    from saflite.bus import keyring
    from saflite.bus.access import ANY_CAMPAIGN, ROLES
    from saflite.contract.errors import Refused

    unknown = [role for role in args.role if role not in ROLES]
    if unknown:
        raise Refused("--role", expected=f"any of {', '.join(ROLES)}", got=repr(unknown[0]))
    bundle = keyring.add(
        args.keys,
        args.name,
        args.role,
        campaigns=args.campaign or [ANY_CAMPAIGN],
        now_s=now_s,
        days=args.days,
        if_needed=args.if_needed,
    )
    return [
        f"{bundle}: copy this folder to where {args.name} works, and keep it as secret as a password",
        "there: --keys FOLDER with `saflite worker --join`, `watch`, `control` and `scorer`",
    ]


def _until(end: datetime, now_s: float) -> str:
    from saflite.contract.clock import in_utc

    return f"{'until' if in_utc(now_s) < end else 'expired'} {end:{INSTANT}}"


def _list(args: argparse.Namespace, now_s: float) -> None:
    from saflite.bus import keyring
    from saflite.console.view import out
    from saflite.contract.clock import in_utc

    register, ends = keyring.read_register(args.keys), keyring.ends(args.keys)
    for warning in keyring.warnings(args.keys, now_s):
        out.complain("warning", warning)
    if args.json:
        ends_at = {f"{what}_expires": f"{end:{INSTANT}}" for what, end in ends._asdict().items()}
        out.json({"hosts": register.hosts, "peers": register.peers, **ends_at})
        return
    router, authority = (_until(end, now_s) for end in ends)
    out.line(f"router, reached by {', '.join(register.hosts)}: {router}; authority: {authority}")
    today = in_utc(now_s).isoformat()
    for peer in register.peers:
        past = "expired" if peer.expires and peer.expires < today else "until"
        state = "revoked" if peer.revoked else f"{past} {peer.expires}"
        out.line(f"  {peer.name:<16} {', '.join(peer.roles):<24} {', '.join(peer.campaigns):<16} {state}")
