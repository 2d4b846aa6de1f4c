"""The compiled library beside the sources, loaded once per process."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

from saflite.contract.errors import Unavailable

LIBRARY = Path(__file__).parent / "native" / "_native.so"


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
