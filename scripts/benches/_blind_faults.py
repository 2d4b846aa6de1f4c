"""Faults drawn blindly from the lines of the reference autopilot: one changed operator or number in one function.

Nobody chose them: the sites are all comparisons, tests, sums and numbers of the files named here, the draw is by
`derive(rng_seed, "blind fault", number)`. They are no part of the product and exist only while `planted` is entered.
The operators are those of mutation testing (relational, logical and arithmetic operator replacement, constant
replacement: Offutt et al. 1996).
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import CodeType, FunctionType
from typing import Any, NamedTuple

from _authored_faults import Patch

from saflite.contract.rng import derive

PACKAGE = "saflite.flight.autopilots.reference"
FILES = (
    *("arming", "commands", "failsafes", "landed", "parachute", "radio"),
    *(f"modes.{name}" for name in ("acro", "alt_hold", "auto", "base", "brake", "circle", "flip", "guided")),
    *(f"modes.{name}" for name in ("land", "loiter", "rtl", "stabilize")),
)
_FLIPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.And: ast.Or, ast.Or: ast.And, ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip


class Site(NamedTuple):
    """A place that can be changed: the module, the function, the number of the node in it, and what is there."""

    module: str
    function: str
    node: int
    text: str

    @property
    def name(self) -> str:
        """A name for tables."""
        return f"{self.module.rpartition('.')[2]}.{self.function}:{self.text}"


def sites() -> tuple[Site, ...]:
    """Return every site, in order of file and line."""
    found = []
    for file in FILES:
        module = importlib.import_module(f"{PACKAGE}.{file}")
        for name, _ in _functions(module):
            for number, node in enumerate(ast.walk(_tree(module, name))):
                text = _change(node, apply=False)
                if text:
                    found.append(Site(module.__name__, name, number, f"{getattr(node, 'lineno', 0)} {text}"))
    return tuple(found)


def drawn(rng_seed: int, count: int) -> tuple[Site, ...]:
    """Return so many different sites, drawn blindly."""
    every = sites()
    rng = derive(rng_seed, "blind fault")
    return tuple(every[place] for place in rng.choice(len(every), size=count, replace=False))


@contextmanager
def planted(faults: Iterable[Site | Patch]) -> Iterator[None]:
    """Fly with the changed lines for a while; of one function, one line can be changed at a time."""
    kept = []
    try:
        for fault in faults:
            module = importlib.import_module(fault.module)
            function = dict(_functions(module))[fault.function]
            kept.append((function, function.__code__))
            changed = _patched_code(module, fault) if isinstance(fault, Patch) else _changed_code(module, fault)
            function.__code__ = changed
        yield
    finally:
        for function, code in reversed(kept):
            function.__code__ = code


def _functions(module: Any) -> list[tuple[str, FunctionType]]:
    """Return the functions and methods of a module by qualified name; those with closures stay as they are."""
    found: dict[str, FunctionType] = {}
    for value in vars(module).values():
        for part in vars(value).values() if isinstance(value, type) else (value,):
            one = part.fget if isinstance(part, property) else part
            if not isinstance(one, FunctionType) or one.__closure__ or "<" in one.__qualname__:
                continue
            if one.__code__.co_filename == module.__file__:
                found[one.__qualname__] = one
    return list(found.items())


def _source(module: Any) -> str:
    with open(module.__file__, encoding="utf-8") as file:
        return file.read()


def _tree(module: Any, function: str, whole: ast.Module | None = None) -> ast.AST:
    node: Any = whole or ast.parse(_source(module))
    for part in function.split("."):
        kinds = ast.FunctionDef | ast.ClassDef
        node = next(one for one in node.body if isinstance(one, kinds) and one.name == part)
    found: ast.AST = node
    return found


def _changed_code(module: Any, site: Site) -> CodeType:
    whole = ast.parse(_source(module))
    node = list(ast.walk(_tree(module, site.function, whole)))[site.node]
    _change(node, apply=True)
    return _code_of(compile(ast.fix_missing_locations(whole), module.__file__, "exec"), site.function)


def _patched_code(module: Any, patch: Patch) -> CodeType:
    """Return the code of a function with a text in it replaced; raises ValueError unless it stands there once."""
    source, node = _source(module), _tree(module, patch.function)
    first, last = node.lineno - 1, node.end_lineno  # type: ignore[attr-defined]
    lines = source.splitlines(keepends=True)
    body = "".join(lines[first:last])
    if body.count(patch.old) != 1:
        raise ValueError(f"{patch.name}: {patch.old!r} stands {body.count(patch.old)} times in {patch.function}")
    changed = "".join([*lines[:first], body.replace(patch.old, patch.new), *lines[last:]])
    return _code_of(compile(changed, module.__file__, "exec"), patch.function)


def _code_of(code: CodeType, function: str) -> CodeType:
    for part in function.split("."):
        code = next(one for one in code.co_consts if isinstance(one, CodeType) and one.co_name == part)
    return code


def _change(node: ast.AST, *, apply: bool) -> str:
    """Return what a change of the node would be in words, empty if there is none; make it if asked to."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in _FLIPPED:
        compared, other = type(node.ops[0]), _FLIPPED[type(node.ops[0])]
        if apply:
            node.ops[0] = other()  # type: ignore[call-overload]
        return f"{compared.__name__} to {other.__name__}"
    if isinstance(node, ast.BoolOp | ast.BinOp) and type(node.op) in _FLIPPED:
        old, new = type(node.op), _FLIPPED[type(node.op)]
        if apply:
            node.op = new()  # type: ignore[assignment]
        return f"{old.__name__} to {new.__name__}"
    if isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value not in (0.0,):
        if apply:
            node.value = 2.0 * node.value
        return f"{node.value:g} doubled" if not apply else "doubled"
    return ""
