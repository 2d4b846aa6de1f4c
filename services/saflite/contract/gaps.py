"""All that a file lacks, and every key it should not have, told at once: a reader stops at the first."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from itertools import islice
from typing import Any

import msgspec
from msgspec import inspect

TOLD_MAX = 20


def gaps(data: object, kind: type[msgspec.Struct]) -> list[str]:
    """Return in words the keys that plain data lacks to be a struct, and those that no struct of its place has."""
    return list(_look(data, inspect.type_info(kind), "", lenient=False))


def unknown(data: object, kind: type[msgspec.Struct]) -> list[str]:
    """Return in words the keys of plain data that its struct, which forbids none, would drop; at most `TOLD_MAX`."""
    said = _look(data, inspect.type_info(kind), "", lenient=True)
    return list(islice((words for words in said if " is unknown" in words), TOLD_MAX))


_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "bool": "true or false",
    "object": "a table",
    "array": "a list",
    "null": "nothing",
}


_IS_OF_A_KEY = re.compile("^Object contains unknown field|^Invalid enum value .* at `key` in")


def _plainly(said: str) -> str:
    """Return what msgspec says of a value in words that name its key first."""
    found = re.fullmatch(r"Expected (.+?)(?:, got (.+))? - at `\$\.?(.+)`", said)
    if found is None:
        return said
    expected, got = (
        re.sub(r"`(\w+)`", lambda one: _WORDS.get(one[1], one[0]), part or "") for part in found.groups()[:2]
    )
    got = got.replace("a number", "a number with a fraction") if expected == _WORDS["int"] else got
    return f"`{found[3]}`: {expected.replace(' | ', ' or ')} is expected" + (f", not {got}" if got else "")


def told(fault: msgspec.ValidationError, data: object, kind: type[msgspec.Struct]) -> str:
    """Return what is wrong with data in words: the fault found first, and where there are more keys wrong, all."""
    found = gaps(data, kind)
    if len(found) == 1 and _IS_OF_A_KEY.search(str(fault)):
        return found[0]
    if len(found) < 2:
        return _plainly(str(fault))
    more = f" and {len(found) - TOLD_MAX} more" if len(found) > TOLD_MAX else ""
    return f"{_plainly(str(fault))}; in all {len(found)} keys: {', '.join(found[:TOLD_MAX])}{more}"


def _look(data: object, info: Any, place: str, *, lenient: bool) -> Iterator[str]:
    """Say what is wrong with data; `lenient` tells unknown keys where they are dropped, too."""
    if isinstance(info, inspect.StructType) and isinstance(data, dict):
        yield from _struct(data, info, place, lenient=lenient)
    elif isinstance(info, inspect.UnionType):
        structs = [part for part in info.types if isinstance(part, inspect.StructType)]
        if len(structs) == 1:
            yield from _look(data, structs[0], place, lenient=lenient)
    elif isinstance(info, inspect.VarTupleType | inspect.ListType) and isinstance(data, list):
        for number, part in enumerate(data):
            yield from _look(part, info.item_type, f"{place}[{number}]", lenient=lenient)
    elif isinstance(info, inspect.DictType) and isinstance(data, dict):
        may = info.key_type.values if isinstance(info.key_type, inspect.LiteralType) else None
        for key, part in data.items():
            if may is not None and key not in may:
                yield f"`{place}.{key}` is unknown (one of {', '.join(map(str, may))}?)"
            yield from _look(part, info.value_type, f"{place}.{key}" if place else str(key), lenient=lenient)


def _struct(data: dict[str, object], info: inspect.StructType, place: str, *, lenient: bool) -> Iterator[str]:
    fields = {field.encode_name: field for field in info.fields}
    before = f"{place}." if place else ""
    for name, field in fields.items():
        if field.required and name not in data:
            yield f"`{before}{name}` is missing"
    for key, part in data.items():
        if key in fields:
            yield from _look(part, fields[key].type, f"{before}{key}", lenient=lenient)
        elif info.forbid_unknown_fields or lenient:
            near = difflib.get_close_matches(key, fields, 1)
            yield f"`{before}{key}` is unknown" + (f" (`{near[0]}`?)" if near else "")
