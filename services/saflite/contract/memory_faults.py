"""Which deaths of an autopilot tell of memory that was misused: such finds are reported in private first.

By the words of whoever saw it: a sanitizer, the checks of the C library, a signal. What they leave open counts.
"""

from __future__ import annotations

import re

from saflite.contract.flight import Ending

# How far a pattern looks is bounded: looking on from each place of a message takes its length squared.
_ARITHMETIC = (
    r"cannot be represented|integer overflow|division by zero|outside the range of representable|"
    r"shift exponent|left shift of|implicit conversion"
)
_SANITIZERS = rf"Sanitizer: |GWP-ASan|runtime error: (?!.{{0,300}}(?:{_ARITHMETIC}))"
_STACK_AND_FORTIFY = r"\*\*\* .{1,200} detected \*\*\*|\*\*\*: .{0,1000}terminated"
_HEAP = (
    r"(?:alloc|free|chunk|tcache)\w{0,64}\(\): "
    r"(?:invalid|corrupted|unaligned|mismatching|memory corruption|double free|too many|unsorted|largebin|smallbin)|"
    r"double free|corrupted (?:size|unsorted|double-linked)|invalid fastbin|malloc(?:\.c:\d+| assertion failure)"
)
_SIGNAL_WORDS = r"(?i:segmentation (?:fault|violation))|(?:^|[:\d] +)Bus error"
_REPORT = re.compile("|".join((_SANITIZERS, _STACK_AND_FORTIFY, _HEAP, _SIGNAL_WORDS)))
_ENDED_BY_SIGNAL = re.compile(r"\bsignal \d+|\bSIG[A-Z]{3,4}\b|firmware died|\bexit code 13[2459]\b|Sanitizer")
"""Signals by name and number, and as a shell tells them, 128 more: ILL, ABRT, BUS, SEGV."""


def is_memory_report(line: str) -> bool:
    """Return whether a line that an autopilot printed reports a fault of memory.

    The undefined-behaviour sanitizer's summary does not: it is the same for arithmetic.
    """
    return not line.startswith("SUMMARY:") and bool(_REPORT.search(line))


def is_memory_fault(ending: Ending, message: str) -> bool:
    """Return whether an autopilot died of what may be misused: a fatal signal, or a report of a fault of memory."""
    return ending == "autopilot_died" and bool(_ENDED_BY_SIGNAL.search(message) or _REPORT.search(message))
