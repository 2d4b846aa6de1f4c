"""Rows of a store as the types they are to have: SQLite keeps any value in any column, and others may have made it."""

from __future__ import annotations

import re
import sqlite3
from typing import Any, TypeVar, overload

import msgspec

from saflite.campaign.storage.packing import FIX
from saflite.contract import wire
from saflite.contract.errors import Refused

T = TypeVar("T")

_TABLE = re.compile(r"\b(?:FROM|JOIN) (\w+)")


@overload
def rows(connection: sqlite3.Connection, kind: type[T], query: str, *values: object) -> list[T]: ...
@overload
def rows(connection: sqlite3.Connection, kind: Any, query: str, *values: object) -> list[Any]: ...
def rows(connection: sqlite3.Connection, kind: Any, query: str, *values: object) -> list[Any]:
    """Return the rows that a query finds, each as a `kind` of tuple.

    Raises:
        Refused: a column holds what is none of its type, such as a word where a number belongs.
        sqlite3.DatabaseError: the store is damaged, or not to be had.
    """
    found = connection.execute(query, values).fetchall()
    try:
        read: list[Any] = wire.convert(found, list[kind])
    except msgspec.ValidationError as fault:
        file = connection.execute("PRAGMA database_list").fetchone()[2]
        where = f"{file}, table {', '.join(dict.fromkeys(_TABLE.findall(query)))}"
        raise Refused(
            "books", where=where, expected="values as saflite writes them", got=str(fault), fix=FIX
        ) from fault
    return read
