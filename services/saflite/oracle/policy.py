"""Policies: safety rules as files. Words for scorers, a formula for the oracle, examples that prove the formula right.

A rule `always (condition implies promise)` has a crisp condition: it says where the rule applies, the promise says by
how much it is kept. Comparisons of flags and codes are crisp everywhere.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.gaps import told
from saflite.contract.modules import given
from saflite.contract.outside import parse_toml, read_text
from saflite.contract.signals import MODES, SIGNALS, Signal
from saflite.contract.test_case import StartState, Twin
from saflite.contract.work import PolicyTexts
from saflite.oracle.effects import silencing
from saflite.oracle.examples import Example, completed, example_signals
from saflite.oracle.finding import find
from saflite.oracle.formula import FUTURE, Node, harden, interned, parts, reach_s, signals_of
from saflite.oracle.parse import check_size, parse
from saflite.oracle.silence import is_silenced
from saflite.oracle.stl import Evaluator
from saflite.oracle.text_places import Place, line_of, near
from saflite.oracle.units import margin_unit

FOREIGN_KEPT = 256  # texts that came with work: no number of them fills the memory
POLICIES_DIR = Path(__file__).parent / "policies"
DEFAULT_POLICY = "min-obstacle-distance"
ID = re.compile(r"[a-z0-9][a-z0-9-]*")

ENTRIES_MAX = 1_000
"""Of a kind in a policy file: each is looked for in the text, and examples are judged."""
TARGETS_MAX = 16
"""With constants of their own: the formula is read once for each."""


class Inputs(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What may be mutated to break the policy. `published` names the PGFuzz list it comes from, if any."""

    published: str = ""
    obstacles: bool = False
    parameters: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    sticks: tuple[str, ...] = ()
    modes: tuple[str, ...] = ()
    sensor_faults: tuple[str, ...] = ()


class Severity(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When a violation is hard: robustness at or below `hard_at`, or `hard_when` true at some moment."""

    hard_at: float | None = None
    hard_when: str = ""


class Points(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Points of the competition: `points` for a flight whose `feature` is below `below`."""

    feature: str
    below: float
    points: float


class PolicyFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A policy as it stands in its file.

    `terms` are named parts of the formula; each may use those above it.
    `procedures` say how the rule is put to the test, step by step (`mutator/exposure/procedures.py`).
    `twin` is the second flight that the rule compares with (`contract/test_case.py`).
    `constants_on` narrows constants for flights of a target, by its name: what is known of how closely that one keeps
    to its orders in our world need not hold for a log, which is judged by `constants`.
    `assumed` gives values to signals that only excuse, for flights that do not hold them.
    `signals` gives each signal its unit. Names beyond those of `contract/signals.py` are signals of a target's own;
    `flag` or `code` in place of a unit says that such a one is 0 or 1, or a number from a closed list.
    """

    id: str
    title: str
    source: str
    interestingness: str
    formula: str
    terms: dict[str, str] = {}
    signals: dict[str, str]
    published: str = ""
    constants: dict[str, float] = {}
    constants_on: dict[str, dict[str, float]] = {}
    state: tuple[str, ...] = ()
    inputs: Inputs = Inputs()
    severity: Severity = Severity()
    points: tuple[Points, ...] = ()
    preconditions: dict[str, float] = {}
    start: StartState | None = None
    procedures: tuple[str, ...] = ()
    needs_mission: bool = False
    twin: Twin = ""
    not_checked_on: dict[str, str] = {}
    assumed: dict[str, float] = {}
    deviations: tuple[str, ...] = ()
    examples: tuple[Example, ...]


class Policy(NamedTuple):
    """A policy ready for use: the file, its formula with crisp parts made crisp, the unit of its robustness.

    A trace must hold the `needed` signals; `signals` are these and those that only tell how hard a violation is.
    `narrowed` holds the formula with the constants of a target's own, by target.
    """

    file: PolicyFile
    formula: Node
    hard_when: Node | None
    unit: str
    needed: frozenset[str]
    signals: frozenset[str]
    narrowed: Mapping[str, Node] = MappingProxyType({})

    def on(self, target: str) -> Policy:
        """Return the policy as flights of a target are judged by it."""
        narrowed = self.narrowed.get(target)
        return self if narrowed is None else self._replace(formula=narrowed)

    @property
    def id(self) -> str:
        """Name of the policy."""
        return self.file.id


Family = Literal["avoidance", "ArduPilot", "PX4", "general"]


def family(policy: PolicyFile) -> Family:
    """Return where the policy comes from: the published lists, the competition, or our own."""
    if policy.inputs.obstacles:
        return "avoidance"
    return {"A": "ArduPilot", "P": "PX4"}.get(policy.published[:1], "general")  # type: ignore[return-value]


@cache
def policy_names() -> tuple[str, ...]:
    """Return the names of all policies, sorted."""
    return tuple(sorted(path.stem for path in POLICIES_DIR.glob("*.toml")))


@cache
def policies_for(target: str) -> tuple[str, ...]:
    """Return the policies that a flight of `target` is judged by if none is named.

    For the log of a real autopilot: not those published for another one, nor those that read signals of a target's own,
    nor those that compare with a second flight.
    """
    other = {"px4": "A", "ardupilot": "P"}.get(target)
    if other is None:
        return policy_names()
    files = [load_policy(name).file for name in policy_names()]
    fit = (file for file in files if not file.published.startswith(other) and not file.twin)
    return tuple(file.id for file in fit if file.signals.keys() <= SIGNALS.keys())


def load_policy(name: str, texts: PolicyTexts | None = None) -> Policy:
    """Return a policy by name, from `texts` or from those that ship, or from a file if `name` ends in `.toml`.

    Raises:
        Refused: there is none of that name, or what stands there is wrong.
    """
    if texts and name in texts:
        return _foreign(texts[name].text, texts[name].file)
    if name in given("policy"):
        path = given("policy")[name].path
        return _foreign(read_text(path, "policy file"), str(path))
    return parse_policy(read_text(Path(name), "policy file"), name) if name.endswith(".toml") else _shipped(name)


def check_told(names: Sequence[str], texts: PolicyTexts) -> None:
    """Raise Refused for the name of a file whose text was not told with it: who sends work names no files here."""
    for name in names:
        if name.endswith(".toml") and name not in texts:
            raise Refused("policy", expected="the text of one that does not ship", got=f"the name of a file, {name!r}")


@lru_cache(maxsize=FOREIGN_KEPT)
def _foreign(text: str, where: str) -> Policy:
    policy = parse_policy(text, where)
    if policy.id in policy_names():
        line = str(Place(text, where, "id"))
        raise Refused("id", where=line, expected="one that no shipped policy has", got=repr(policy.id))
    return policy


@cache
def _shipped(name: str) -> Policy:
    if name not in policy_names():
        raise Refused(
            "policy", expected="a name of `saflite list policies` or a .toml file", got=repr(name), known=policy_names()
        )
    path = POLICIES_DIR / f"{name}.toml"
    policy = _without_examples(read_text(path, "policy file"), str(path.name))  # tests judge those: they take longest
    assert policy.id == name, f"{path} holds policy {policy.id}"
    return policy


def parse_policy(text: str, where: str) -> Policy:
    """Return the policy in TOML `text`.

    Raises:
        Refused: with file, line and reason: unknown key, unknown signal, wrong unit, a window without end, or an
            example that contradicts the formula.
    """
    policy = _without_examples(text, where)
    _check_examples(policy, text, where)
    return policy


def _without_examples(text: str, where: str) -> Policy:
    """Return the policy in TOML `text`, of whose examples nothing is known; raises Refused as `parse_policy`."""
    data = parse_toml(text, "policy file", where)
    try:
        file = wire.convert(data, PolicyFile)
    except msgspec.ValidationError as fault:
        place, got = near(text, where, str(fault)), told(fault, data, PolicyFile)
        raise Refused("policy file", where=place, expected="a policy", got=got) from fault
    most = max(len(file.examples), len(file.terms), len(file.signals), len(file.constants))
    if most > ENTRIES_MAX:
        expected = f"at most {ENTRIES_MAX} examples, terms, signals and constants"
        raise Refused("policy file", where=where, expected=expected, got=most)
    if len(file.constants_on) > TARGETS_MAX:
        expected = f"constants_on for at most {TARGETS_MAX} targets"
        raise Refused("policy file", where=where, expected=expected, got=len(file.constants_on))
    _check_names(file, text, where)
    place = str(Place(text, where, "formula"))
    policy = _compiled(file, text, where, place)
    _check_windows(policy.formula, place)
    _check_inputs(policy, text, where)
    return policy


def _compiled(file: PolicyFile, text: str, where: str, place: str) -> Policy:
    names, formula = _parsed(file, file.constants, text, where)
    said = file.severity.hard_when
    hard = parse(said, names, Place(text, where, "hard_when")) if said else None
    needed = signals_of(formula)
    used = needed | (signals_of(hard) if hard else frozenset())
    _check_signals(file, used, text, where)
    table = signal_table(file)
    crisp, hard_crisp = interned(crispened(formula, table)), interned(crispened(hard, table)) if hard else None
    for made in filter(None, (crisp, hard_crisp)):  # each `iff` and `xor` in it names both its sides twice by now
        check_size(made, place)
    narrowed = {
        target: interned(crispened(_parsed(file, {**file.constants, **own}, text, where)[1], table))
        for target, own in file.constants_on.items()
    }
    return Policy(file, crisp, hard_crisp, margin_unit(crisp, place, table), needed, used, narrowed)


def _parsed(
    file: PolicyFile, constants: Mapping[str, float], text: str, where: str
) -> tuple[dict[str, float | Node], Node]:
    """Return what the names of the file stand for, and its formula."""
    names: dict[str, float | Node] = {**MODES, **constants}
    for name, part in file.terms.items():
        names[name] = parse(part, names, Place(text, where, name), whole=False)
    return names, parse(file.formula, names, Place(text, where, "formula"))


def signal_table(file: PolicyFile) -> dict[str, Signal]:
    """Return the signals a policy may read: the common ones, and those of a target's own that it declares."""
    own = {name: unit for name, unit in file.signals.items() if name not in SIGNALS}
    return {**SIGNALS, **{name: _own_signal(unit) for name, unit in own.items()}}


def _own_signal(unit: str) -> Signal:
    if unit == "flag":
        return Signal("", "", "flag")
    return Signal("", "", "code") if unit == "code" else Signal(unit, "")


def crispened(formula: Node, table: Mapping[str, Signal] = SIGNALS) -> Node:
    """Return the formula with crisp conditions and crisp comparisons of flags and codes."""

    def flags_only(node: Node) -> bool:
        return all(table[name].kind != "real" for name in signals_of(node))

    return harden(formula, flags_only)


# ---- checks -------------------------------------------------------------------------------------------------------


def _check_names(file: PolicyFile, text: str, where: str) -> None:
    """Refuse an id unfit for topics and file names.

    Modes, sticks, parameters, commands and faults are the target's: they are checked where a campaign is made of the
    policy.
    """
    if not ID.fullmatch(file.id):
        line = str(Place(text, where, "id"))
        raise Refused("id", where=line, expected="small letters, digits and '-'", got=repr(file.id))
    for own in file.constants_on.values():
        for name in own.keys() - file.constants.keys():
            line = str(Place(text, where, "constants_on"))
            raise Refused("constants_on", where=line, expected="names that stand under [constants]", got=repr(name))


def _check_signals(file: PolicyFile, used: frozenset[str], text: str, where: str) -> None:
    def refused(what: str, key: str, expected: str, got: str) -> Refused:
        return Refused(what, where=str(Place(text, where, key)), expected=expected, got=got)

    for name in sorted(used - file.signals.keys()):
        if name in SIGNALS:
            raise refused("signals", name, f"'{name}' with its unit under [signals], '{SIGNALS[name].unit}'", "nothing")
        expected = "one of `saflite list signals`, one declared under [signals], a mode, or a constant"
        known = (*file.constants, *file.terms, *file.signals, *SIGNALS)
        raise Refused("signal", where=str(Place(text, where, name)), expected=expected, got=repr(name), known=known)
    for name, unit in file.signals.items():
        if name not in used:
            raise refused("signals", name, "only signals the formula reads", repr(name))
        if name in SIGNALS and unit != SIGNALS[name].unit:
            raise refused(f"unit of {name}", name, repr(SIGNALS[name].unit), repr(unit))
    for name in file.assumed:
        if name not in used:
            raise refused("assumed", "assumed", "signals the formula reads", repr(name))
    for name in file.state:
        if name not in SIGNALS and name not in file.signals:
            raise refused("state", "state", "signals", repr(name))


def _check_windows(formula: Node, place: str) -> None:
    """Only the outermost `always` may look ahead without end: anything else could never be judged."""
    inner = formula.args if formula.op == "always" else (formula,)
    for part in (part for top in inner for part in parts(top)):
        if part.op in FUTURE and math.isinf(part.high_s):
            raise Refused(
                "formula", where=place, expected=f"a window [from:to] after '{part.op}'", got="a window without end"
            )


def _check_inputs(policy: Policy, text: str, where: str) -> None:
    """Refuse an input that keeps the rule silent for the rest of a flight: it could only hide what it should find."""
    inputs = policy.file.inputs
    for kind, names in (("parameter", inputs.parameters), ("sensor_fault", inputs.sensor_faults)):
        for name in names:
            flags = frozenset(silencing(kind, name))
            if flags and is_silenced(policy.formula, flags):
                told = f"{name}, in force, holds {', '.join(sorted(flags & policy.needed))} at 0: the rule never speaks"
                place = str(Place(text, where, kind))
                raise Refused("inputs", where=place, expected="inputs that leave the rule a time to speak", got=told)


def _check_examples(policy: Policy, text: str, where: str) -> None:
    kinds = {example.holds for example in policy.file.examples}
    if kinds != {True, False}:
        line = str(Place(text, where, "examples"))
        expected = "one that holds and one that violates at least (holds = true, holds = false)"
        got = " and ".join(f"holds = {str(holds).lower()} only" for holds in kinds) or "none"
        raise Refused("examples", where=line, expected=expected, got=got)
    whole = list(policy.file.examples)  # each completed once, whatever takes it over
    for number in range(1, len(whole) + 1):
        place = f"{where} line {line_of(text, 'examples', number)}"
        whole[number - 1] = completed(whole, number, place)
        _check_example(policy, whole[number - 1], f"example {number}", place)


def _check_example(policy: Policy, example: Example, name: str, place: str) -> None:
    signals = example_signals(example, policy.signals, name, place, signal_table(policy.file))
    finding = find(Evaluator(signals, example.step_s), policy.formula)
    if finding is None:
        raise Refused(name, where=place, expected="a trace longer than the formula's windows", got="a shorter one")
    said = "hold" if finding.robustness >= 0 else "violate"
    if np.isnan(finding.robustness) or (finding.robustness >= 0) != example.holds:
        expected = f"to {'hold' if example.holds else 'violate'} ({example.why})"
        raise Refused(name, where=place, expected=expected, got=f"to {said}, robustness {finding.robustness:g}")
    if example.holds and example.applies != (finding.applied_share > 0):
        expected = "the rule to apply" if example.applies else "the rule not to apply"
        raise Refused(name, where=place, expected=expected, got=f"a share of {finding.applied_share:.2f}")


def reach_s_of(policy: Policy) -> float:
    """Return how far ahead the rule looks: a flight must be longer than that to be judged, seconds."""
    body = policy.formula.args[0] if policy.formula.op == "always" else policy.formula
    return reach_s(body)
