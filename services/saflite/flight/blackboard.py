"""A flight's blackboard: one native struct made of parts, its numbers by name, and a recorder of them.

The library offers for a struct called `bridge`, say, `bridge_size`, `bridge_offset(part)`, `bridge_record` and
`bridge_rows`, and of each of its parts `<part>_size` and `<part>_slot_name`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from saflite.contract.signals import grid
from saflite.flight.native_library import Board, Memory, python_library, slot_names, struct_size
from saflite.flight.world.state import STEP_S


@cache
def slots_of(whole: str, parts: tuple[str, ...]) -> dict[str, int]:
    """Return name to index of every slot of the parts, in doubles from the start of the whole struct."""
    offset = getattr(python_library(), f"{whole}_offset")
    offset.restype = ctypes.c_size_t
    found = {
        name: offset(part) // 8 + place
        for part, prefix in enumerate(parts)
        for place, name in enumerate(slot_names(prefix))
    }
    assert len(found) == sum(len(slot_names(prefix)) for prefix in parts), "a slot is listed twice"
    return found


class Blackboard(Board):
    """The struct `WHOLE` made of `PARTS`, in the order of the native source, zeroed.

    Raises:
        Unavailable: the native library is missing.
    """

    WHOLE: ClassVar[str]
    PARTS: ClassVar[tuple[str, ...]]

    def __init__(self) -> None:
        super().__init__(ctypes.create_string_buffer(struct_size(self.WHOLE)), self.slots())
        library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
        self._record = getattr(library, f"{self.WHOLE}_record")
        self._record.argtypes = [pointer, pointer, pointer, number, number, number]
        self._row_count = getattr(library, f"{self.WHOLE}_rows")
        self._row_count.argtypes = [pointer]
        self._rows = np.zeros((0, 0), np.float32)
        self._columns = np.zeros(0, np.int32)
        self.record_names: tuple[str, ...] = ()

    @classmethod
    def slots(cls) -> dict[str, int]:
        """Return name to index of every slot, in doubles from the start of the struct."""
        return slots_of(cls.WHOLE, cls.PARTS)

    def part(self, name: str) -> Memory:
        """Return the memory of a part."""
        offset = getattr(python_library(), f"{self.WHOLE}_offset")(self.PARTS.index(name))
        return (ctypes.c_char * struct_size(name)).from_buffer(self._memory, offset)

    def record(self, names: Sequence[str], row_limit: int, step_s: float) -> None:
        """Record the slots `names` every `step_s` from now on, at most `row_limit` rows, the first at once."""
        self.record_names = tuple(names)
        self._columns = np.array([self._slots[name] for name in names], np.int32)
        self._rows = np.empty((row_limit, len(names)), np.float32)
        places = (self._rows.ctypes.data, self._columns.ctypes.data)
        self._record(self.address, *places, len(names), row_limit, round(step_s / STEP_S))

    def columns(self) -> dict[str, bytes]:
        """Return what was recorded: each name's samples as little-endian float32, on the signal's grid."""
        table = np.ascontiguousarray(self._rows[: int(self._row_count(self.address))].T, dtype="<f4")
        return {name: _on_grid(table[i], grid(name)).tobytes() for i, name in enumerate(self.record_names)}


def _on_grid(samples: NDArray[np.float32], parts: int) -> NDArray[np.float32]:
    """Return the samples rounded to whole parts; a power of two of them, so that no other rounding happens."""
    return np.asarray(np.rint(samples.astype(np.float64) * parts) / parts + 0.0, "<f4") if parts else samples
