"""Who may do what on a bus that is open to a network: a table of roles, as Zenoh's access control on the router.

A participant proves its name by its certificate (mTLS). Each certificate has a common name of its own, all that Zenoh
tells certificates apart by; the register says whose it is (`Peer.common_name`), so one that was replaced stays refused.
What it asks travels on keys that begin with `by/NAME/`, and the router lets through only those of whose certificate it
is: a name in such a key is proven. Everything not listed is denied. Participants on the farm's private Unix socket are
the user who runs the farm, and may do everything.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, get_args

import msgspec

from saflite.contract.control import Verb
from saflite.contract.errors import Refused
from saflite.contract.names import NAME, Name, NameOrAny
from saflite.contract.topics import FARM_ROOT, JOIN_ROOT, PROTOCOL, TOPICS
from saflite.contract.wire import MESSAGE_BYTES_MAX
from saflite.contract.work import Stage

Role = Literal["worker", "scorer", "oracle", "mutator", "recorder", "viewer", "operator"]
ROLES: tuple[Role, ...] = get_args(Role)
STAGE_OF: Mapping[Role, Stage] = {
    "worker": "fly",
    "scorer": "score",
    "oracle": "judge",
    "mutator": "mutate",
    "recorder": "record",
}
VERBS_OF: Mapping[Role, tuple[Verb, ...]] = {"viewer": ("status", "events"), "operator": get_args(Verb)}
ANY_CAMPAIGN = "*"
BY = "by"
ACCESS_KEY = "saflite/access"
"""On `by/NAME/saflite/access` anybody with a certificate of the farm may ask what NAME may do, to tell denial from
silence. The question's payload is the common name that the asker shows; nothing counts by it."""

SEAL_BYTES_MAX = 2**10
_OWN_NAME = re.compile(rf"(?:farm|books|router|{'|'.join(get_args(Stage))})(?:-[0-9]+)?")
_PLACEHOLDER = re.compile(r"\{\w+\}")
_MESSAGES = (
    "put",
    "delete",
    "query",
    "reply",
    "declare_subscriber",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


CommonName = Annotated[str, msgspec.Meta(pattern=rf"^(?:{NAME}~[0-9a-f]{{16}})?(?![\s\S])")]


class Peer(msgspec.Struct, frozen=True, kw_only=True):
    """Somebody with a certificate of the farm's authority, and what they may do, in which campaigns (`*`: in all).

    `common_name` is the certificate's; empty in a register made before each had its own: then it is the name.
    """

    name: Name
    roles: tuple[Role, ...]
    campaigns: tuple[NameOrAny, ...] = (ANY_CAMPAIGN,)
    expires: str = ""
    revoked: bool = False
    common_name: CommonName = ""

    @property
    def shown(self) -> str:
        """The common name of its certificate."""
        return self.common_name or self.name

    @property
    def counting(self) -> tuple[Role, ...]:
        """Its roles, without those of workers where an older version made it under a name of a farm's own processes."""
        return tuple(role for role in self.roles if role not in STAGE_OF or not is_reserved(self.name))

    def may(self, campaign: str) -> bool:
        """Return whether any of its roles counts in a campaign."""
        return not self.revoked and (ANY_CAMPAIGN in self.campaigns or campaign in self.campaigns)

    def may_order(self, verb: Verb) -> bool:
        """Return whether any of its roles may give an order."""
        return any(verb in VERBS_OF.get(role, ()) for role in self.roles)

    def in_words(self) -> str:
        """Return what it may do."""
        if self.revoked:
            return f"the key of {self.name} is revoked"
        if self.counting != self.roles:
            return f"the key of {self.name} is for no worker: a farm gives that name itself; add a key of another name"
        where = "every campaign" if ANY_CAMPAIGN in self.campaigns else ", ".join(self.campaigns)
        return f"the key of {self.name} is for {', '.join(self.roles)} in {where}"


def in_words(peer: Peer | None, name: str, shown: str) -> str:
    """Return what somebody may do who goes by a name and says to show the certificate of a common name."""
    if peer is None:
        return f"{name} has no key in this farm's register"
    if not peer.revoked and shown != peer.shown:
        return f"another key of {name} was made after this one, which counts no more: use the folder of the later one"
    return peer.in_words()


def is_reserved(name: str) -> bool:
    """Return whether a farm gives its own processes that name, or one that begins with it: no key speaks for those."""
    return _OWN_NAME.fullmatch(name) is not None


def speaks_for(peer: str, worker: str, owner: str | None = None) -> bool:
    """Return whether a proven name may use a worker's name; on the private socket, where none is, anybody may.

    `owner` is by whose key the worker has joined: empty for the farm's own user, None if it has not.
    """
    if not peer:
        return True
    named_so = not is_reserved(peer) and (worker == peer or worker.startswith(f"{peer}-"))
    return named_so and owner in (None, peer)


def check_speaker(peer: str, worker: str, owner: str | None = None) -> None:
    """Raise Refused unless a proven name may use a worker's name; see `speaks_for`."""
    if not speaks_for(peer, worker):
        raise Refused("worker", expected=f"{peer} or {peer}-..., as its key is named", got=worker)
    if not speaks_for(peer, worker, owner):
        raise Refused("worker", expected=f"one that joined with the key of {peer}", got=worker)


def split(key: str) -> tuple[str, str]:
    """Return the proven name in a key, empty without one, and the key without it."""
    if not key.startswith(f"{BY}/"):
        return "", key
    peer, _, rest = key.removeprefix(f"{BY}/").partition("/")
    return peer, rest


def access_control(peers: Sequence[Peer]) -> dict[str, Any]:
    """Return the router's `access_control`: default deny, the socket's users allow, each peer what its roles list."""
    everything = [_Grant(flow, _MESSAGES, ["**"]) for flow in ("ingress", "egress")]
    asking = [f"{BY}/*/{ACCESS_KEY}"]
    table: list[tuple[dict[str, Any], list[_Grant]]] = [
        ({"id": "socket:", "link_protocols": ["unixsock-stream"]}, everything),
        (
            {"id": "network:", "link_protocols": ["tls"]},
            [_Grant("ingress", ("query",), asking), _Grant("egress", ("reply",), asking)],
        ),
    ]
    table += [
        ({"id": peer.name, "cert_common_names": [peer.shown]}, list(_grants(peer)))
        for peer in peers
        if not peer.revoked and peer.counting
    ]
    rules, policies = [], []
    for subject, grants in table:
        ids = [f"{subject['id']}/{number}" for number in range(len(grants))]
        rules += [_rule(name, grant) for name, grant in zip(ids, grants, strict=True)]
        policies.append({"rules": ids, "subjects": [subject["id"]]})
    subjects = [subject for subject, _ in table]
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def size_limits() -> list[dict[str, Any]]:
    """Return the router's `low_pass_filter`: how long a message may be that comes in on each key, with its seal."""
    limits = [_limit(["**"], ["put", "delete", "query"], MESSAGE_BYTES_MAX)]
    for topic in TOPICS:
        if topic.answer is not None:
            key = _PLACEHOLDER.sub("*", topic.key)
            limits.append(_limit([key, f"{BY}/*/{key}"], ["query"], topic.bytes_max))
    return limits


def _limit(keys: list[str], messages: list[str], bytes_max: int) -> dict[str, Any]:
    size_limit = bytes_max + SEAL_BYTES_MAX
    return {"flows": ["ingress"], "messages": messages, "key_exprs": keys, "size_limit": size_limit}


class _Grant(NamedTuple):
    flow: str
    messages: Sequence[str]
    keys: list[str]


def _grants(peer: Peer) -> Iterator[_Grant]:
    asked, tokens, facts = [], [], []
    for campaign in [ANY_CAMPAIGN] if ANY_CAMPAIGN in peer.campaigns else peer.campaigns:
        for role in peer.counting:
            asked += [f"{BY}/{peer.name}/{key}" for key in _asked(role, campaign)]
            if role in STAGE_OF:
                alive = f"saflite/{PROTOCOL}/{campaign}/alive/{STAGE_OF[role]}"
                tokens += [f"{alive}/{peer.name}/*", f"{alive}/{peer.name}-$*/*"]
            else:
                event = f"saflite/{PROTOCOL}/{campaign}/event"
                facts += [f"{event}/*", f"{event}-json/*"]
    yield _Grant("ingress", ("query",), asked)
    yield _Grant("egress", ("reply",), asked)
    yield _Grant("ingress", ("liveliness_query", "declare_liveliness_subscriber"), [f"{FARM_ROOT}/*"])
    yield _Grant("egress", ("liveliness_token",), [f"{FARM_ROOT}/*"])
    if tokens:
        yield _Grant("ingress", ("liveliness_token",), tokens)
    if facts:  # without the past that Zenoh keeps: its own threads would tell that, and wait for who does not read
        yield _Grant("ingress", ("declare_subscriber",), facts)
        yield _Grant("egress", ("put",), facts)


def _asked(role: Role, campaign: str) -> Iterator[str]:
    """Yield the keys on which a role may ask."""
    root = f"saflite/{PROTOCOL}/{campaign}"
    if role in STAGE_OF:
        stage = STAGE_OF[role]
        yield f"{JOIN_ROOT}/{campaign}/{stage}"
        yield from (f"{root}/{topic}/{stage}" for topic in ("work", "result", "beat"))
        yield from (f"{root}/blob/{verb}" for verb in ("open", "get", "put"))
    yield from (f"{root}/control/{verb}" for verb in VERBS_OF.get(role, ()))


def _rule(name: str, grant: _Grant) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [grant.flow],
        "messages": list(grant.messages),
        "key_exprs": grant.keys,
    }
