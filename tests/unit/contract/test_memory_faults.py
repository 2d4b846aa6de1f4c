"""Deaths that tell of misused memory are told from others, by whatever words."""

from __future__ import annotations

import pytest

from saflite.contract.memory_faults import is_memory_fault
from saflite.flight.autopilots.external.process import told

MISUSED = [
    "==1==ERROR: AddressSanitizer: heap-buffer-overflow on address 0x602",
    "==1==ERROR: HWAddressSanitizer: tag-mismatch on address 0x602",
    "==1==WARNING: MemorySanitizer: use-of-uninitialized-value",
    "==1==ERROR: LeakSanitizer: detected memory leaks",
    "WARNING: ThreadSanitizer: heap-use-after-free (pid=1)",
    "==1==ERROR: UndefinedBehaviorSanitizer: SEGV on unknown address 0x000000000008",
    "*** GWP-ASan detected a memory error ***",
    "x.cpp:812:21: runtime error: index 37 out of bounds for type 'uint8_t [32]'",
    "x.c:9:3: runtime error: store to address 0x602 with insufficient space for an object of type 'int'",
    "x.c:9:3: runtime error: load of misaligned address 0x601 for type 'int', which requires 4 byte alignment",
    "x.c:9:3: runtime error: member access within null pointer of type 'struct S'",
    "x.c:9:3: runtime error: applying non-zero offset 8 to null pointer",
    "x.c:9:3: runtime error: pointer index expression with base 0x1 overflowed to 0x0",
    "x.c:9:3: runtime error: load of value 190, which is not a valid value for type 'bool'",
    "x.c:9:3: runtime error: member call on address 0x1 which does not point to an object of type 'T'",
    "x.c:9:3: runtime error: call to function f through pointer to incorrect function type 'void (*)(int)'",
    "*** stack smashing detected ***: terminated",
    "*** stack smashing detected ***: <unknown> terminated",
    "*** buffer overflow detected ***: terminated",
    "*** %n in writable segment detected ***",
    "*** longjmp causes uninitialized stack frame ***: terminated",
    "*** glibc detected *** ./arducopter: double free or corruption (out): 0x0931 ***",
    "double free or corruption (fasttop)",
    "free(): invalid pointer",
    "free(): double free detected in tcache 2",
    "malloc(): corrupted top size",
    "malloc(): unsorted double linked list corrupted",
    "malloc_consolidate(): unaligned fastbin chunk detected",
    "realloc(): invalid next size",
    "munmap_chunk(): invalid pointer",
    "corrupted size vs. prev_size while consolidating",
    "corrupted double-linked list",
    "Fatal glibc error: malloc assertion failure in sysmalloc: (old_top == initial_top (av))",
    "px4: malloc.c:2617: sysmalloc: Assertion `old_size' failed.",
    "ERROR: segmentation fault - aborting",
    "Segmentation fault (core dumped)",
    "run.sh: line 3: 12 Bus error               (core dumped) ./px4",
]

OTHERS = [
    "PANIC: bad thing",
    "ERROR: Floating point exception - aborting",
    "x.c:3:1: runtime error: signed integer overflow: 2147483647 + 1 cannot be represented in type 'int'",
    "x.c:3:1: runtime error: left shift of negative value -1",
    "x.c:3:1: runtime error: shift exponent 40 is too large for 32-bit type 'int'",
    "x.c:3:1: runtime error: division by zero",
    "x.c:3:1: runtime error: -nan is outside the range of representable values of type 'int'",
    "Baro: I2C bus error",
    "pthread_create(): Resource temporarily unavailable",
    "free memory: 4096",
]


@pytest.mark.parametrize("report", MISUSED)
def test_a_report_of_misused_memory_is_found_in_what_an_autopilot_printed(report: str) -> None:
    """Whatever came before, which a sanitizer passed over, and after, and with the exit code of any wrapper."""
    console = f"starting\n{OTHERS[3]}\n{report}\nPANIC: told to\nSUMMARY: UndefinedBehaviorSanitizer: undefined\nbye\n"
    assert is_memory_fault("autopilot_died", told(1, console))
    assert not is_memory_fault("crashed", told(1, console))


@pytest.mark.parametrize("report", OTHERS)
def test_panics_and_arithmetic_are_no_faults_of_memory(report: str) -> None:
    console = f"starting\n{report}\nSUMMARY: UndefinedBehaviorSanitizer: undefined-behavior x.c:3:1\n{report}\n"
    assert not is_memory_fault("autopilot_died", told(1, console))


@pytest.mark.parametrize(
    ("message", "memory"),
    [
        ("the firmware died: AddressSanitizer: heap-buffer-overflow in parse < read < main", True),
        ("the firmware died: firmware: signal 11", True),
        ("arducopter ended by SIGSEGV", True),
        (told(-7, "ready"), True),
        (told(139, "ready"), True),
        (told(135, "ready"), True),
        ("the autopilot ended: SUMMARY: UndefinedBehaviorSanitizer: undefined-behavior", True),
        (told(1, "ready"), False),
        ("arithmetic exception: division by zero", False),
        ("the firmware hangs: it said nothing", False),
    ],
)
def test_deaths_that_can_be_misused_are_told_apart(message: str, memory: bool) -> None:
    assert is_memory_fault("autopilot_died", message) == memory
    assert not is_memory_fault("crashed", message)
