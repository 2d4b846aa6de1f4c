"""Example messages made from the types alone: every field filled, every variant of a union shown once.

Golden bytes are made of them, so a new message or field is covered without anyone writing a sample.
"""

from __future__ import annotations

import re
from typing import Any

import msgspec
from msgspec import inspect


def examples(kind: type[msgspec.Struct]) -> dict[str, msgspec.Struct]:
    """Return examples of a message by variant; the variant names the tag chosen wherever a union of structs stands.

    A message without unions has one example under the empty name.
    """
    info = inspect.type_info(kind)
    tags = _tags(info)
    if not tags:
        return {"": _made(info, "", 0)}
    return {f"-{tag}": _made(info, tag, 0) for tag in tags}


def _tags(info: Any, depth: int = 0) -> list[str]:
    """Return the tags of the first union of structs met below `info`."""
    if depth > 6:
        return []
    if isinstance(info, inspect.UnionType):
        structs = [part for part in info.types if isinstance(part, inspect.StructType) and part.tag is not None]
        if len(structs) > 1:
            return [str(part.tag) for part in structs]
    for below in _below(info):
        found = _tags(below, depth + 1)
        if found:
            return found
    return []


def _below(info: Any) -> list[Any]:
    if isinstance(info, inspect.StructType):
        return [field.type for field in info.fields]
    if isinstance(info, inspect.UnionType | inspect.TupleType):
        return list(info.types if isinstance(info, inspect.UnionType) else info.item_types)
    if isinstance(info, inspect.VarTupleType | inspect.ListType):
        return [info.item_type]
    return []


def _made(info: Any, tag: str, place: int) -> Any:
    """Return a value of the type; numbers differ by their place so that swapped fields show."""
    if isinstance(info, inspect.StructType):
        values = {field.name: _made(field.type, tag, at) for at, field in enumerate(info.fields)}
        return info.cls(**values)
    if isinstance(info, inspect.UnionType):
        return _made(_chosen(info, tag), tag, place)
    if isinstance(info, inspect.VarTupleType):
        return (_made(info.item_type, tag, place),) * (info.min_length or 1)
    if isinstance(info, inspect.TupleType):
        return tuple(_made(part, tag, at) for at, part in enumerate(info.item_types))
    if isinstance(info, inspect.ListType):
        return [_made(info.item_type, tag, place)]
    if isinstance(info, inspect.DictType):
        return {_made(info.key_type, tag, place): _made(info.value_type, tag, place)}
    return _plain(info, place)


def _chosen(info: inspect.UnionType, tag: str) -> Any:
    parts = [part for part in info.types if not isinstance(part, inspect.NoneType)]
    tagged = [part for part in parts if isinstance(part, inspect.StructType) and str(part.tag) == tag]
    return (tagged or parts)[0]


def _plain(info: Any, place: int) -> Any:
    makers: dict[type, Any] = {
        inspect.StrType: f"text{place}",
        inspect.IntType: place + 1,
        inspect.FloatType: place + 0.5,
        inspect.BoolType: True,
        inspect.BytesType: bytes([place % 256, 255]),
        inspect.NoneType: None,
    }
    if isinstance(info, inspect.LiteralType):
        return info.values[0]
    if type(info) not in makers:
        raise AssertionError(f"no example for {info!r}: teach {__name__}")
    if isinstance(info, inspect.StrType) and info.pattern is not None:
        return _fitting(info.pattern, place)
    if isinstance(info, inspect.FloatType) and info.le is not None:
        return min(place + 0.5, float(info.le))
    return makers[type(info)]


def _fitting(pattern: str, place: int) -> str:
    """Return a text of the alphabet asked for (`contract/names.py`)."""
    digit = f"{place % 16:x}"
    fitting = (text for text in (f"text{place}", 16 * digit, 64 * digit) if re.search(pattern, text))
    return next(fitting)
