"""Files from outside: the one reader for whatever a user hands in. Nothing is believed about them.

A path may name a device, a pipe that never ends or a file larger than memory; a text may nest without end or hold
numbers no machine has. All of that is `Refused` here, before any parser sees it.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Callable
from itertools import zip_longest
from pathlib import Path
from typing import Any

from saflite.contract.closed import check_private
from saflite.contract.errors import Refused

TEXT_BYTES_MAX = 4 * 2**20
"""Campaigns, policies, test cases, mission plans, labels: the largest that ship have some kilobytes."""

LOG_BYTES_MAX = 512 * 2**20
"""Flight logs and recordings."""

DEPTH_MAX = 32
COLUMNS_MAX = 1_000
FIELDS_MAX = TEXT_BYTES_MAX
"""Of a table, those that its rows leave out among them: a text of full rows has no more."""

NAME_SHOWN = 80
WHOLE_MAX = 2**63 - 1
_Place = tuple[Any, str | int] | None
"""Where a value stands: the place of what holds it, and its key there."""

# A key of one word more than DEPTH_MAX, looked for where a key can begin: anywhere else, long words take ever longer.
_LONG_KEY = re.compile(r"""(?<![\w.-])(?>(?>[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){33}""")


def read_bytes(path: Path, what: str, bytes_max: int, *, private: bool = False) -> bytes:
    """Return the content of a regular file of at most `bytes_max` bytes; of one that holds a secret if `private`.

    Raises:
        Refused: it is missing, unreadable, no regular file (device, pipe, folder), larger, or not closed to others.
    """
    handle = _open(path, what)
    with os.fdopen(handle, "rb") as file:
        opened = os.fstat(handle)
        if private:
            check_private(opened, path, what)
        size = opened.st_size
        if size > bytes_max:
            raise Refused(what, where=_named(path), expected=f"at most {bytes_max} bytes", got=f"{size} bytes")
        try:
            data = file.read(bytes_max + 1)
        except OSError as fault:
            raise Refused(what, where=_named(path), expected="a readable file", got=_said(fault)) from fault
    if len(data) > bytes_max:  # it grew while it was read
        raise Refused(what, where=_named(path), expected=f"at most {bytes_max} bytes", got="more")
    return data


def read_text(path: Path, what: str, bytes_max: int = TEXT_BYTES_MAX, *, private: bool = False) -> str:
    """Return a text file, without the byte-order mark that some programs begin it with.

    Raises Refused as `read_bytes` does, or where it is no UTF-8 text.
    """
    return as_text(read_bytes(path, what, bytes_max, private=private), path, what)


def as_text(data: bytes, path: Path, what: str) -> str:
    """Return what was read of a text file as `read_text` does; raises Refused where it is no UTF-8 text."""
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as fault:
        raise Refused(what, where=_named(path), expected="a readable UTF-8 text file", got=_said(fault)) from fault


def check_file(path: Path, what: str, bytes_max: int = LOG_BYTES_MAX) -> Path:
    """Return the path of a regular file of at most `bytes_max` bytes, for readers of libraries that open it themselves.

    Raises:
        Refused: as `read_bytes` does.
    """
    handle = _open(path, what)
    try:
        size = os.fstat(handle).st_size
    finally:
        os.close(handle)
    if size > bytes_max:
        raise Refused(what, where=_named(path), expected=f"at most {bytes_max} bytes", got=f"{size} bytes")
    return path


def begins_with(path: Path, count: int) -> bytes | None:
    """Return the first bytes of a regular file, by which its kind is known; None of anything else, or of none.

    Why it cannot be read is said when it is.
    """
    try:
        with os.fdopen(_open(path, "file"), "rb") as file:
            return file.read(count)
    except (Refused, OSError):
        return None


def parse_toml(text: str, what: str, where: str) -> dict[str, Any]:
    """Return TOML text as plain data; raises Refused for what is no TOML, or as `check_plain` does."""
    if _LONG_KEY.search(text):  # the parser takes time with the square of a key's length
        raise Refused(what, where=where, expected=f"keys of at most {DEPTH_MAX} words", got="more")
    data: dict[str, Any] = _parsed(tomllib.loads, text, what, where, "TOML")
    return data


def assignment(option: str, text: str) -> tuple[str, Any]:
    """Return the name and value in `name=value`, the value read as TOML where it is, as text elsewhere; or Refused.

    Numbers and nesting that no machine holds are refused as in files.
    """
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise Refused(option, expected="NAME=VALUE", got=text)
    try:
        tomllib.loads(f"value = {value}")
    except tomllib.TOMLDecodeError:
        return name, value
    except (ValueError, RecursionError):  # no machine holds it; said below
        pass
    return name, parse_toml(f"value = {value}", option, name[:NAME_SHOWN])["value"]


def parse_json(text: str, what: str, where: str) -> Any:
    """Return JSON text as plain data; raises Refused for what is no JSON, or as `check_plain` does."""
    return _parsed(json.loads, text, what, where, "JSON")


def parse_csv(text: str, what: str, where: str) -> list[list[str]]:
    """Return the rows of a CSV text; raises Refused for what is none."""
    try:
        return list(csv.reader(text.splitlines()))
    except csv.Error as fault:
        raise Refused(what, where=where, expected="CSV", got=_said(fault)) from fault


def parse_table(text: str, what: str, where: str) -> list[dict[str, str]]:
    """Return the rows of a CSV text by the columns its first row names, a missing field as empty; raises Refused.

    Also for more than `COLUMNS_MAX` columns, or `FIELDS_MAX` fields.
    """
    heads, *rows = parse_csv(text, what, where) or [[]]
    if len(heads) > COLUMNS_MAX:  # each row has all of them, however short it is
        raise Refused(what, where=where, expected=f"at most {COLUMNS_MAX} columns", got=len(heads))
    if len(heads) * len(rows) > FIELDS_MAX:
        got = f"{len(rows)} rows of {len(heads)}"
        raise Refused(what, where=where, expected=f"at most {FIELDS_MAX} fields", got=got)
    return [dict(zip_longest(heads, row[: len(heads)], fillvalue="")) for row in rows if row]


def check_plain(data: Any, what: str, where: str, *, finite: bool = True) -> None:
    """Raise Refused where plain data nests deeper than `DEPTH_MAX`, or holds a number that is none or none we can hold.

    `finite` False leaves numbers that are none to the caller. Iterative, so that no depth can exhaust the stack.
    """
    left: list[tuple[Any, int, _Place]] = [(data, 0, None)]
    while left:
        value, depth, place = left.pop()
        if depth > DEPTH_MAX:
            raise Refused(what, where=where, expected=f"at most {DEPTH_MAX} levels of nesting", got="more")
        if isinstance(value, dict):
            left += [(key, depth + 1, place) for key in value]
            left += [(part, depth + 1, (place, key)) for key, part in value.items()]
        elif isinstance(value, str) and not value.isascii() and any("\ud800" <= char <= "\udfff" for char in value):
            raise Refused(what, where=where, expected=f"texts in Unicode{_at(place)}", got="half a pair of surrogates")
        elif isinstance(value, list):
            left += [(part, depth + 1, (place, number)) for number, part in enumerate(value)]
        elif finite and isinstance(value, float) and not math.isfinite(value):
            raise Refused(what, where=where, expected=f"finite numbers{_at(place)}", got=value)
        elif isinstance(value, int) and not isinstance(value, bool) and abs(value) > WHOLE_MAX:
            expected = f"whole numbers below 2^63{_at(place)}"
            raise Refused(what, where=where, expected=expected, got=f"one of {value.bit_length()} bits")


def _at(place: _Place) -> str:
    """Return in words at which key a value stands, empty for what stands alone."""
    keys: list[str | int] = []
    while place is not None:
        place, key = place
        keys.append(key)
    named = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in reversed(keys)).removeprefix(".")
    return f" at `{named[:NAME_SHOWN]}`" if named else ""


def _parsed(parse: Callable[[str], Any], text: str, what: str, where: str, language: str) -> Any:
    try:
        data = parse(text)
    except RecursionError as fault:
        raise Refused(what, where=where, expected=f"at most {DEPTH_MAX} levels of nesting", got="more") from fault
    except (ValueError, OverflowError) as fault:  # TOMLDecodeError, JSONDecodeError, a number of 5,000 digits
        raise Refused(what, where=where, expected=language, got=_said(fault)) from fault
    check_plain(data, what, where)
    return data


def _open(path: Path, what: str) -> int:
    """Open without waiting for whoever writes a pipe, and keep only what is a regular file."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError as fault:
        gone = next((folder for folder in reversed(path.absolute().parents) if not folder.exists()), None)
        got = "none of that name" if gone is None else f"no folder {_named(gone)}"
        raise Refused(what, where=_named(path), expected="a readable file", got=got) from fault
    except (OSError, ValueError) as fault:
        raise Refused(what, where=_named(path), expected="a readable file", got=_said(fault)) from fault
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise Refused(what, where=_named(path), expected="a regular file", got="a folder, device or pipe")
    return handle


def _named(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 200 else f"{text[:100]}…{text[-80:]}"


def _said(fault: Exception) -> str:
    text = fault.strerror if isinstance(fault, OSError) and fault.strerror else str(fault)
    return text.splitlines()[0][:200] if text else type(fault).__name__
