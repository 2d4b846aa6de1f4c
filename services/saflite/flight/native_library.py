"""The compiled library beside the sources, loaded once per process, and its structs as named numbers."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import count
from pathlib import Path
from typing import TypeVar

from saflite.contract.errors import Unavailable
from saflite.flight.mending import builds_library
from saflite.flight.native_sources import digest

LIBRARY = Path(__file__).parent / "native" / "_native.so"
AnyLibrary = TypeVar("AnyLibrary", bound=ctypes.CDLL)
Memory = ctypes.Array[ctypes.c_char]


@cache
def native_library() -> ctypes.CDLL:
    """Return the library.

    Raises:
        Unavailable: it was not built, for another machine, or from sources other than those beside it.
    """
    return _loaded(ctypes.CDLL)


@cache
def python_library() -> ctypes.PyDLL:
    """Return the library for functions that call back into Python objects (the interpreter lock stays held).

    Raises:
        Unavailable: as by `native_library`.
    """
    return _loaded(ctypes.PyDLL)


def _loaded(kind: type[AnyLibrary]) -> AnyLibrary:
    try:
        library = kind(str(LIBRARY))
    except OSError as fault:
        raise Unavailable(f"native library: {fault}; {builds_library()} mends that") from fault
    if built_from(library) != digest():
        raise Unavailable(
            f"native library: built from other sources than those beside it; {builds_library()} mends that"
        )
    return library


def built_from(library: ctypes.CDLL) -> str:
    """Return the digest of the sources a library was built from, empty for one that does not tell."""
    if not hasattr(library, "native_sources"):
        return ""
    library.native_sources.restype = ctypes.c_char_p
    return str(library.native_sources().decode())


def slot_names(prefix: str) -> tuple[str, ...]:
    """Return the names of a struct's doubles, in order, as `<prefix>_slot_name` of the library lists them."""
    function = getattr(python_library(), f"{prefix}_slot_name")
    function.restype = ctypes.c_char_p
    return tuple(_until_none(function))


def _until_none(function: ctypes._NamedFuncPointer) -> Iterator[str]:
    for slot in count():
        name = function(slot)
        if name is None:
            return
        yield name.decode()


def struct_size(prefix: str) -> int:
    """Return the size in bytes of a struct, as `<prefix>_size` of the library tells it."""
    function = getattr(python_library(), f"{prefix}_size")
    function.restype = ctypes.c_size_t
    return int(function())


class Board:
    """A native struct's memory as named doubles: `board["altitude_m"]` reads and writes a slot.

    Args:
        memory: the struct; of a size that is a multiple of 8.
        slots: name to place, counted in doubles from the start.
    """

    def __init__(self, memory: Memory, slots: Mapping[str, int]) -> None:
        self._memory, self._slots = memory, slots
        self.address = ctypes.addressof(memory)
        self.at: memoryview[float] = memoryview(memory).cast("B").cast("d")

    def __getitem__(self, name: str) -> float:
        return self.at[self._slots[name]]

    def __setitem__(self, name: str, value: float) -> None:
        self.at[self._slots[name]] = value

    def set(self, **values: float) -> None:
        """Write several slots."""
        at, index = self.at, self._slots
        for name, value in values.items():
            at[index[name]] = value
