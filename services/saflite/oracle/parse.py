"""From text to formula. The syntax is close to rtamt's.

    always ((mode == RTL and altitude_m < 15) implies eventually[0:4] (climb_mps > 0.2))

Loosest first: `iff <-> xor`, `implies ->` (to the right), `or |`, `and &`, `until since` (to the right), the prefix
words (`not !`, `always G`, `eventually F`, `historically H`, `once O`, each temporal one with an optional `[from:to]`
in seconds, `s` or `ms` may follow a number), comparisons, `+ -`, `* /`, unary minus, and calls: abs, sqrt, exp, pow,
min, max, prev, next, rise, fall, rate(x), ago(x, seconds), mean(x, seconds), latch(x, condition), turn(degrees),
sin(degrees), cos(degrees).
Beyond rtamt: `lasting[8] (x)`, true where x has been true for the last 8 s, and never in the first 8 s.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping

from saflite.contract.errors import Refused
from saflite.oracle.formula import COMPARISONS, Node, is_truth, number, parts

_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|(?P<word>[A-Za-z_]\w*)"
    r"|(?P<sign><->|->|<=|>=|==|!=|[-+*/()<>,!&|:\[\]]))"
)
_WORDS = {"G": "always", "F": "eventually", "H": "historically", "O": "once", "U": "until", "S": "since"}
_SIGNS = {"<->": "iff", "->": "implies", "&": "and", "|": "or", "!": "not"}
_PREFIX = ("always", "eventually", "historically", "once")
_RESERVED = (*_PREFIX, "lasting", "and", "or", "implies", "iff", "xor", "until", "since", "not")
_TRUTH_CALLS = ("rise", "fall", "prev", "next")
_TERM_CALLS = {"abs": 1, "sqrt": 1, "exp": 1, "pow": 2, "min": 2, "max": 2, "rate": 1, "turn": 1, "sin": 1, "cos": 1}
_TIMED_CALLS = ("ago", "mean")
_CALLS = tuple(sorted([*_TERM_CALLS, *_TRUTH_CALLS, *_TIMED_CALLS, "latch"]))
_ELSEWHERE = {"=>": "implies", "&&": "and", "||": "or", "=": "=="}  # signs of other languages, and what they are here
_UNITS = {"s": 1.0, "ms": 1e-3}
_DEPTH_MAX = 100
_LEVELS_MAX = 150
_PARTS_MAX = 10_000
_SECONDS_MAX = 1e6


class Fault(Exception):
    """A formula that cannot be read: offset in the text, what was expected, what was found, what may be meant."""

    def __init__(self, offset: int, expected: str, got: str, fix: str = "") -> None:
        super().__init__(f"expected {expected}, got {got}")
        self.offset, self.expected, self.got, self.fix = offset, expected, got, fix


def parse(
    text: str, names: Mapping[str, float | Node] | None = None, where: object = "", *, whole: bool = True
) -> Node:
    """Return the formula in `text`.

    Args:
        text: the formula; line breaks count as spaces.
        names: named constants and named parts; every other name is a signal.
        where: file or argument, for the message; made a text only for it.
        whole: it must have a truth value; a part of a formula may be a number too.

    Raises:
        Refused: with line and column of the fault.
    """
    try:
        parser = _Parser(text, names or {})
        return parser.formula() if whole else parser.part()
    except RecursionError as fault:
        raise Refused("formula", where=str(where), expected=f"at most {_DEPTH_MAX} levels", got="more") from fault
    except Fault as fault:
        before = text[: fault.offset]
        line, column = before.count("\n") + 1, fault.offset - before.rfind("\n")
        place = f"{where}, formula line {line} column {column}" if where else f"line {line} column {column}"
        raise Refused("formula", where=place, expected=fault.expected, got=fault.got, fix=fault.fix) from fault


def _meant(word: str) -> str:
    """Return a question after the word or call of the language that one unknown to it may be; empty if none is near."""
    near = difflib.get_close_matches(word.lower(), (*_RESERVED, *_CALLS), 1)
    return f"did you mean {near[0]}?" if near else ""


def _tokens(text: str) -> list[tuple[str, str, int]]:
    found, at = [], 0
    end = len(text.rstrip())
    while at < end:
        match = _TOKEN.match(text, at)
        if match is None:
            offset = at + len(text[at:]) - len(text[at:].lstrip())
            raise _no_token(text, offset, text[offset])
        kind = match.lastgroup or ""
        token = match.group(kind)
        if kind == "sign" and token + text[match.end() : match.end() + 1] in _ELSEWHERE:
            raise _no_token(text, match.start(kind), 2 * token)
        canonical = _WORDS.get(token, token) if kind == "word" else _SIGNS.get(token, token)
        found.append((kind, canonical, match.start(kind)))
        if len(found) > _PARTS_MAX:
            raise Fault(at, f"at most {_PARTS_MAX} words and signs", "more")
        at = match.end()
    return [*found, ("end", "the end", end)]


def _no_token(text: str, offset: int, got: str) -> Fault:
    meant = next((f"write {right}" for wrong, right in _ELSEWHERE.items() if text.startswith(wrong, offset)), "")
    return Fault(offset, "a number, a name or an operator", repr(got), meant)


def check_size(formula: Node, where: object) -> None:
    """Raise Refused for a formula that was made of one that was read, and grew on the way; see `_check_size`."""
    try:
        _check_size(formula)
    except Fault as fault:
        raise Refused("formula", where=str(where), expected=fault.expected, got=fault.got) from fault


def _check_size(formula: Node) -> None:
    """Raise Fault for a formula too deep or, with its named parts written out, too long to be worked out.

    By part, however often it is named: parts named twice within parts named twice double each time.
    """
    known: dict[int, tuple[int, int]] = {}  # by the part: its depth, its size written out
    for part in parts(formula):
        below = [known[id(child)] for child in part.args]
        known[id(part)] = 1 + max((one[0] for one in below), default=0), 1 + sum(one[1] for one in below)
    depth, size = known[id(formula)]
    if depth > _LEVELS_MAX:
        raise Fault(0, f"at most {_LEVELS_MAX} levels (each `and` in a row is one)", str(depth))
    if size > _PARTS_MAX:
        raise Fault(0, f"at most {_PARTS_MAX} parts, named ones written out", "more")


class _Parser:
    """Recursive descent, one method per level of binding."""

    def __init__(self, text: str, names: Mapping[str, float | Node]) -> None:
        self._tokens, self._at, self._names, self._depth = _tokens(text), 0, names, 0

    def formula(self) -> Node:
        return self._ended(self._truth(self._iff, self._offset))

    def part(self) -> Node:
        return self._ended(self._iff())

    def _ended(self, node: Node) -> Node:
        if self._kind != "end":
            raise Fault(self._offset, "an operator or the end", repr(self._token), _meant(self._token))
        _check_size(node)
        return node

    # ---- the stream of tokens

    @property
    def _kind(self) -> str:
        return self._tokens[self._at][0]

    @property
    def _token(self) -> str:
        return self._tokens[self._at][1]

    @property
    def _offset(self) -> int:
        return self._tokens[self._at][2]

    def _take(self, *tokens: str) -> str:
        if self._kind in ("sign", "word") and self._token in tokens:
            self._at += 1
            return self._tokens[self._at - 1][1]
        return ""

    def _need(self, token: str) -> None:
        if not self._take(token):
            raise Fault(self._offset, repr(token), repr(self._token))

    # ---- truth values, loosest first

    def _truth(self, level: object, offset: int) -> Node:
        assert callable(level)
        node: Node = level()
        if not is_truth(node):
            raise Fault(offset, "a comparison or a truth value", "a number")
        return node

    def _join(
        self, op: str, left: Node, offset: int, right: Node, low_s: float = 0.0, high_s: float = math.inf
    ) -> Node:
        for side in (left, right):
            if not is_truth(side):
                raise Fault(offset, f"comparisons or truth values around {op!r}", "a number")
        return Node(op, (left, right), low_s, high_s)

    def _iff(self) -> Node:
        left = self._implies()
        while op := self._take("iff", "xor"):
            left = self._join(op, left, self._offset, self._implies())
        return left

    def _implies(self) -> Node:
        left = self._or()
        if op := self._take("implies"):
            return self._join(op, left, self._offset, self._implies())
        return left

    def _or(self) -> Node:
        left = self._and()
        while op := self._take("or"):
            left = self._join(op, left, self._offset, self._and())
        return left

    def _and(self) -> Node:
        left = self._until()
        while op := self._take("and"):
            left = self._join(op, left, self._offset, self._until())
        return left

    def _until(self) -> Node:
        left = self._unary()
        if op := self._take("until", "since"):
            low_s, high_s = self._window()
            return self._join(op, left, self._offset, self._until(), low_s, high_s)
        return left

    def _unary(self) -> Node:
        self._depth += 1
        if self._depth > _DEPTH_MAX:
            raise Fault(self._offset, f"at most {_DEPTH_MAX} levels", "more")
        node = self._prefixed() or self._comparison()
        self._depth -= 1
        return node

    def _prefixed(self) -> Node | None:
        if self._take("not"):
            return Node("not", (self._truth(self._unary, self._offset),))
        if op := self._take("lasting"):
            self._need("[")
            high_s = self._seconds()
            self._need("]")
            return Node(op, (self._truth(self._unary, self._offset),), 0.0, high_s)
        if op := self._take(*_PREFIX):
            low_s, high_s = self._window()
            return Node(op, (self._truth(self._unary, self._offset),), low_s, high_s)
        return None

    def _window(self) -> tuple[float, float]:
        if not self._take("["):
            return 0.0, math.inf
        offset = self._offset
        low_s = self._seconds()
        if not self._take(":", ","):
            raise Fault(self._offset, "':'", repr(self._token))
        high_s = self._seconds()
        self._need("]")
        if high_s < low_s:
            raise Fault(offset, "a window that does not end before it begins", f"[{low_s:g}:{high_s:g}]")
        return low_s, high_s

    def _seconds(self) -> float:
        offset = self._offset
        if self._kind == "number":
            value = float(self._token)
            self._at += 1
        else:
            named = self._names.get(self._token) if self._kind == "word" else None
            if named is None or isinstance(named, Node):
                raise Fault(offset, "a time in seconds", repr(self._token))
            value = named
            self._at += 1
        unit = self._take(*_UNITS)
        if not 0 <= value <= _SECONDS_MAX:
            raise Fault(offset, f"a time of 0 or more, at most {_SECONDS_MAX:g} s", f"{value:g}")
        return value * _UNITS.get(unit, 1.0)

    # ---- comparisons and terms

    def _comparison(self) -> Node:
        left = self._sum()
        op = self._take(*COMPARISONS)
        if not op:
            return left
        offset = self._offset
        right = self._sum()
        if is_truth(left) or is_truth(right):
            raise Fault(offset, f"numbers around {op!r}", "a truth value")
        return Node(op, (left, right))

    def _sum(self) -> Node:
        left = self._product()
        while op := self._take("+", "-"):
            left = self._terms(op, left, self._product())
        return left

    def _product(self) -> Node:
        left = self._negative()
        while op := self._take("*", "/"):
            offset, right = self._offset, self._negative()
            if op == "/" and right.op == "number" and right.value == 0.0:
                raise Fault(offset, "a divisor other than 0", "0")
            left = self._terms(op, left, right)
        return left

    def _negative(self) -> Node:
        if self._take("-"):
            return self._terms("neg", self._negative())
        return self._primary()

    def _terms(self, op: str, *args: Node) -> Node:
        if any(is_truth(arg) for arg in args):
            raise Fault(self._offset, f"numbers for {op!r}", "a truth value")
        return Node(op, args)

    def _primary(self) -> Node:
        if self._take("("):
            node = self._iff()
            self._need(")")
            return node
        kind, token, offset = self._tokens[self._at]
        if kind == "number":
            self._at += 1
            if not math.isfinite(float(token)):
                raise Fault(offset, "a number below 1.8e308", token[:20])
            return number(float(token))
        if (
            kind != "word"
            or token in _PREFIX
            or token in ("and", "or", "implies", "iff", "xor", "until", "since", "not")
        ):
            raise Fault(offset, "a number, a name or '('", repr(token))
        self._at += 1
        if self._take("("):
            return self._call(token, offset)
        if token in self._names:
            named = self._names[token]
            return named if isinstance(named, Node) else number(named)
        return Node("signal", name=token)

    def _call(self, name: str, offset: int) -> Node:
        if name in _TIMED_CALLS:
            inner = self._terms(name, self._sum())
            self._need(",")
            inner = inner._replace(value=self._seconds())
            self._need(")")
            return inner
        args = [self._iff()]
        while self._take(","):
            args.append(self._iff())
        self._need(")")
        return _checked_call(name, tuple(args), offset)


def _checked_call(name: str, args: tuple[Node, ...], offset: int) -> Node:
    truths = [is_truth(arg) for arg in args]
    if name == "prev" and truths == [False]:
        return Node("before", args)
    if name == "latch" and truths == [False, True]:
        return Node(name, args)
    if name in _TRUTH_CALLS and truths == [True]:
        return Node(name, args)
    if _TERM_CALLS.get(name) == len(args) and not any(truths):
        return Node(name, args)
    meant = "" if name in _CALLS else _meant(name)
    raise Fault(offset, f"a call of {', '.join(_CALLS)} with fitting arguments", f"{name} with {len(args)}", meant)
