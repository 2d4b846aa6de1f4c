"""The compiled library beside the sources, loaded once per process, and its structs as named numbers."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import count
from pathlib import Path

from saflite.contract.errors import Unavailable

LIBRARY = Path(__file__).parent / "native" / "_native.so"
Memory = ctypes.Array[ctypes.c_char]


@cache
def python_library() -> ctypes.PyDLL:
    """Return the library for functions that call back into Python objects (the interpreter lock stays held).

    Raises:
        Unavailable: it was not built, or for another machine.
    """
    try:
        return ctypes.PyDLL(str(LIBRARY))
    except OSError as fault:
        raise Unavailable(f"native library: {fault}; build it with `python scripts/build_native.py`") from fault


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
