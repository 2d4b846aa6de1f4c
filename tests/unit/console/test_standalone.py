"""A script for maintainers is made of the smallest form of a finding that was confirmed."""

from __future__ import annotations

from saflite.console.operations.standalone import _evidence, smallest_form
from saflite.contract.circumstances import Circumstances
from saflite.contract.test_case import Origin, Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.verdict import Confirmation, Violation
from saflite.recorder.summary import Finding


def finding(
    name: str,
    inputs: int,
    *,
    fingerprint: str = "ab" * 8,
    confirmation: Confirmation = "confirmed",
    shrunk: bool = True,
) -> Finding:
    violation = Violation(
        fingerprint=fingerprint,
        test_case=name * 8,
        policy="upright",
        robustness=-1.0,
        severity="hard",
        confirmation=confirmation,
    )
    given = tuple(Stimulus(at_s=float(at), kind="mode", name="mode", values=(2.0,)) for at in range(inputs))
    case = TestCase(
        target=Target(),
        scenario=Scenario(start=StartState()),
        stimuli=given,
        origin=Origin(note="shrunk: 3 inputs left out" if shrunk else ""),
    )
    told = Circumstances(values="inside", link="pilot", stock=True, repeats="bitwise", minimal=shrunk)
    return Finding(violation, case, circumstances=told)


def test_the_smallest_confirmed_form_is_taken() -> None:
    found, smaller, smallest = finding("a1", 20, shrunk=False), finding("b2", 5), finding("c3", 2)
    luck, other = finding("d4", 1, confirmation="flaky"), finding("e5", 1, fingerprint="cd" * 8)
    assert smallest_form(found, [found, luck, other, smaller, smallest]) is smallest
    assert smallest_form(smallest, [found, smaller, smallest]) is smallest
    assert smallest_form(found, [found, luck, other]) is found


def test_a_find_that_nothing_was_left_out_of_is_no_smallest_form() -> None:
    found, fewer = finding("a1", 20, shrunk=False), finding("b2", 5, shrunk=False)
    assert smallest_form(found, [found, fewer]) is found


def test_no_words_of_a_run_hide_or_turn_what_a_script_says() -> None:
    words = "stays up \u202e\x1b[2J\0\r\nimport os"
    found = finding("a1", 1)
    told = Circumstances(
        values="outside", outside=(words,), link="pilot", stock=False, repeats="bitwise", steps=(words,)
    )
    made = _evidence(found._replace(circumstances=told), words, "script.py")
    assert all(text.isprintable() for text in (made.title, *made.asked, *made.asked.values(), *made.steps))
