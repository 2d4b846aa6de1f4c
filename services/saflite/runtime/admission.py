"""Who may join: the same protocol, the same software where it decides results, a simulator of what is flown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from types import MappingProxyType
from typing import NamedTuple

from saflite.contract import wire
from saflite.contract.config import Needs
from saflite.contract.errors import Refused
from saflite.contract.join import Join, check_worker_name
from saflite.contract.modules import Kind, Outside
from saflite.contract.test_case import Target
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Stage

FREE_STAGES: frozenset[Stage] = frozenset({"record"})
"""Stages whose software changes no result: what they make can be made again from the evidence."""

DECIDES: dict[Stage, Kind] = {"mutate": "strategy", "score": "scorer", "fly": "target"}
"""Kinds of modules from outside that decide what a stage answers; the text of policies travels with the campaign."""

CARD_BYTES_MAX = 2**13
"""What a worker may say of itself, as JSON: one message tells of as many workers as a farm can have."""

WORD_MAX = 80  # of what a stranger says of itself, in our words
DIGEST_SHOWN = 12


class Terms(NamedTuple):
    """What the books ask of those who join.

    `software` gives the digest their own code has for a stage; `guests` names scorers that may run another. `modules`
    are those from outside whose content decides results, too.
    """

    target: Target
    version: str
    software: Callable[[Stage], str]
    guests: Sequence[str] = ()
    modules: Sequence[Outside] = ()
    needs: Mapping[Stage, Needs] = MappingProxyType({})


def objection(card: Join, terms: Terms) -> str:
    """Return in words why a worker cannot join, empty if it can (unless its name is taken, which others know)."""
    if card.protocol != PROTOCOL:
        ours, theirs = f"{PROTOCOL} (version {terms.version})", f"{card.protocol} (version {_said(card.version)})"
        return f"protocol: expected {ours}, got {theirs}; install the same version on both machines"
    try:
        check_worker_name(card.worker)
        check_worker_name(card.session)
    except Refused as fault:
        return str(fault)
    return (
        _size(card)
        or _software(card, terms)
        or _modules(card, terms)
        or (_target(card, terms.target) if card.stage == "fly" else "")
        or _missing(card, terms.needs.get(card.stage, Needs()))
    )


def _size(card: Join) -> str:
    size_bytes = len(wire.encode_json(card))
    if size_bytes <= CARD_BYTES_MAX:
        return ""
    return f"what it says of itself: expected at most {CARD_BYTES_MAX} bytes, got {size_bytes}; give it fewer labels"


def _software(card: Join, terms: Terms) -> str:
    ours = terms.software(card.stage)
    if card.software == ours or card.stage in FREE_STAGES:
        return ""
    if card.stage == "score" and any(fnmatchcase(card.worker, guest) for guest in terms.guests):
        return ""
    wanted, got = f"{ours[:DIGEST_SHOWN]} (version {terms.version})", _said(card.software[:DIGEST_SHOWN])
    remedy = "install the same version on both machines"
    if card.stage == "score":
        remedy += ", or name this worker in scorer.guests of the campaign"
    return f"software of {card.stage}: expected {wanted}, got {got} (version {_said(card.version)}); {remedy}"


def _modules(card: Join, terms: Terms) -> str:
    if any(card.stage == "score" and fnmatchcase(card.worker, guest) for guest in terms.guests):
        return ""
    for module in terms.modules:
        got = card.modules.get(module.key, "")
        if DECIDES.get(card.stage) == module.kind and got != module.digest:
            wanted = f"{module.digest[:DIGEST_SHOWN]} ({module.path.name})"
            remedy = "hand the same file to both machines with --module"
            return f"module {module.key}: expected {wanted}, got {_said(got[:DIGEST_SHOWN])}; {remedy}"
    return ""


def _target(card: Join, target: Target) -> str:
    known = [one.name for one in card.targets]
    if target.name not in known:
        return f"targets: expected {target.name}, which this campaign flies, got {_said(', '.join(known))}"
    build = card.build_of(target.name)
    if target.build and build != target.build:
        wanted, got = target.build[:DIGEST_SHOWN], _said(build[:DIGEST_SHOWN])
        remedy = "fly with the software that it began with, or start another run"
        return f"build of {target.name}: expected {wanted}, which this campaign flies, got {got}; {remedy}"
    return ""


def _missing(card: Join, needs: Needs) -> str:
    for name, wanted, got in (("cores", needs.cores, card.cores), ("gpus", needs.gpus, card.gpus)):
        if got < wanted:
            return f"{name} for {card.stage}: expected at least {wanted}, got {got}"
    for label, pattern in needs.labels.items():
        value = card.labels.get(label, "")
        if not fnmatchcase(value, pattern) or label not in card.labels:
            remedy = f"--label {label}=... says what this machine has"
            return f"label {label} for {card.stage}: expected {_said(pattern)}, got {_said(value)}; {remedy}"
    return ""


def _said(text: str) -> str:
    """Return what a stranger said, short and on one line."""
    return "".join(char if char.isprintable() else "?" for char in text[:WORD_MAX]) or "nothing"
