"""YAML as plain data with the line every value stands on, so that a fault can be named where it is."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import yaml

from saflite.contract.errors import Refused
from saflite.contract.outside import DEPTH_MAX, check_plain

TEXT_MAX = 250_000
NODES_MAX = 20_000
"""A test case of 1,000 commands has 16,000; the parser takes some 65 microseconds for each."""

NUMBER_CHARS_MAX = 400
"""More than the digits of any that a machine holds; whole numbers of base 60 take time with the square of theirs."""

_TAG = "tag:yaml.org,2002:"
_NUMBERS = (f"{_TAG}int", f"{_TAG}float")
_DATE = f"{_TAG}timestamp"
_PLAIN = tuple(_TAG + kind for kind in ("str", "int", "float", "bool", "null", "seq", "map"))
"""What JSON holds, too. Bytes, sets, dates and pairs, which a text may ask for by their tag, it does not."""


class _Reader(yaml.SafeLoader):
    """Safe YAML without dates: what looks like one stays text, so that nothing is lost on the way through JSON."""

    nodes = depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose one value, of no more and no deeper than there may be in a text."""
        self.nodes += 1
        self.depth += 1
        if self.nodes > NODES_MAX:
            raise self._too_much(f"more than {NODES_MAX} values")
        if self.depth > DEPTH_MAX + 1:  # the scanner takes time with the depth for every word
            raise self._too_much(f"more than {DEPTH_MAX} levels of nesting")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def _too_much(self, problem: str) -> yaml.MarkedYAMLError:
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


_Reader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != _DATE]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}

Path = tuple[str | int, ...]


class Located(NamedTuple):
    """Data and the line (from 1) each of its parts begins on, and that each key of a mapping stands on, by path."""

    data: dict[str, Any]
    where: str
    lines: Mapping[Path, int] = MappingProxyType({})
    key_lines: Mapping[Path, int] = MappingProxyType({})

    def at(self, path: Path) -> str:
        """Return the place of a part for a fault text: file and line of it or of the nearest part around it."""
        while path and path not in self.lines:
            path = path[:-1]
        return self._line(self.lines.get(path, 1))

    def at_key(self, path: Path) -> str:
        """Return the place of the word before a part, as `at` does: the part may begin lines below it."""
        return self._line(self.key_lines[path]) if path in self.key_lines else self.at(path)

    def _line(self, line: int) -> str:
        return f"{self.where}, line {line}" if self.where else f"line {line}"


def read(text: str, where: str) -> Located:
    """Return a YAML mapping; raises Refused with the line for text that is no YAML, has aliases, or is no mapping."""
    if len(text) > TEXT_MAX:
        raise Refused("YAML", where=where, expected=f"at most {TEXT_MAX} characters", got=len(text))
    loader = None
    try:
        loader = _Reader(text)
        node = loader.get_single_node()
        lines: dict[Path, int] = {}
        key_lines: dict[Path, int] = {}
        if node is not None:
            _walk(node, (), lines, key_lines, where)
        data = None if node is None else loader.construct_document(node)
    except yaml.MarkedYAMLError as fault:
        mark = fault.problem_mark or fault.context_mark
        place = f"{where}, line {mark.line + 1}" if mark else where
        got = fault.problem or fault.context or "something else"
        raise Refused("YAML", where=place, expected="well-formed YAML", got=got) from fault
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as fault:
        raise Refused("YAML", where=where, expected="well-formed YAML", got=str(fault).splitlines()[0]) from fault
    finally:
        if loader is not None:
            loader.dispose()
    located = Located(data if isinstance(data, dict) else {}, where, lines, key_lines)
    if not isinstance(data, dict):
        raise Refused("YAML", where=located.at(()), expected="a mapping", got=_called(data))
    check_plain(data, "YAML", where, finite=False)  # parsers of documents name the line
    return located


def _called(data: object) -> str:
    """Return in words what stands where a mapping should."""
    if data is None:
        return "nothing"
    return "a list" if isinstance(data, list) else f"{data!r:.80}"


def _walk(node: yaml.Node, path: Path, lines: dict[Path, int], key_lines: dict[Path, int], where: str) -> None:
    if path in lines:
        raise Refused("YAML", where=f"{where}, line {node.start_mark.line + 1}", expected="one value", got="two of it")
    lines[path] = node.start_mark.line + 1
    if node.tag not in _PLAIN:
        place = f"{where}, line {node.start_mark.line + 1}"
        raise Refused(
            "YAML", where=place, expected="words, numbers, lists and mappings", got=node.tag.replace(_TAG, "!!")
        )
    if node.tag in _NUMBERS and len(node.value) > NUMBER_CHARS_MAX:
        place, got = f"{where}, line {node.start_mark.line + 1}", f"{len(node.value)}"
        raise Refused("YAML", where=place, expected=f"numbers of at most {NUMBER_CHARS_MAX} characters", got=got)
    if isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            _walk(_once(child, where), (*path, index), lines, key_lines, where)
    elif isinstance(node, yaml.MappingNode):
        for key, child in node.value:
            if key.tag != f"{_TAG}str":
                place = f"{where}, line {key.start_mark.line + 1}"
                raise Refused("YAML", where=place, expected="keys that are words", got=repr(key.value))
            key_lines[(*path, key.value)] = key.start_mark.line + 1
            _walk(_once(child, where), (*path, key.value), lines, key_lines, where)


def _once(node: yaml.Node, where: str) -> yaml.Node:
    """Refuse a node met twice: aliases could grow without bound and would be lost when written again."""
    seen = getattr(node, "saflite_seen", False)
    if seen and not isinstance(node, yaml.ScalarNode):
        place = f"{where}, line {node.start_mark.line + 1}"
        raise Refused("YAML", where=place, expected="no anchors and aliases", got="an alias")
    node.saflite_seen = True  # type: ignore[attr-defined]
    return node


def write(data: dict[str, Any]) -> str:
    """Return the data as YAML in the order of its keys; reading it again gives the same data."""
    text: str = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    return text
