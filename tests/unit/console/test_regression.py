"""What flights on another build make of a known violation, and the files it leaves for continuous integration."""

from __future__ import annotations

import itertools
from pathlib import Path
from xml.etree import ElementTree as Xml

import msgspec
import pytest

from saflite.console.operations import beginning, builds, comparing, flaking, regressing
from saflite.console.operations.builds import Build, Sample
from saflite.console.operations.regressing import State
from saflite.console.run_data import known
from saflite.console.run_data.known import Known
from saflite.console.view import ci_files
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase
from saflite.contract.verdict import Ruling, Verdict, modes_named

HERE = Build("reference", Target(), None, "abc")
WAY = "upright, soft, in mode 5"
KNOWN = Known(
    fingerprint="0123456789abcdef",
    name="fedcba9876543210",
    policy="upright",
    behaviour=WAY,
    test_case=TestCase(target=Target(), scenario=Scenario()),
    policies=("upright", "a-chute", "a-rtl1"),
    also=("a-rtl1",),
)


def flight(outcome: Ruling, way: str = WAY, also: str = "") -> Sample:
    verdicts = [Verdict(policy="upright", outcome=outcome, behaviour=way if outcome == "violated" else "")]
    verdicts += [Verdict(policy=also, outcome="violated")] if also else []
    return Sample(0, "completed", tuple(verdicts))


LOST = Sample(0, "infra", None, message="no simulator")


@pytest.mark.parametrize(
    ("samples", "standing", "state", "counts"),
    [
        ([flight("held")] * 3, "violates", "fixed", (0, 3, 0)),
        ([flight("vacuous")] * 3, "violates", "fixed", (0, 3, 0)),
        ([flight("violated")] * 3, "violates", "still there", (3, 3, 0)),
        ([flight("violated"), flight("held"), LOST], "violates", "flaky", (1, 2, 1)),
        ([flight("violated", "upright, hard, in mode 5")] * 3, "violates", "changed", (3, 3, 0)),
        ([flight("held"), flight("held", also="a-chute")], "violates", "changed", (0, 2, 0)),
        ([flight("held"), flight("held", also="a-rtl1")], "violates", "fixed", (0, 2, 0)),
        ([flight("held"), flight("violated")], "fixed", "came back", (1, 2, 0)),
        ([flight("inconclusive")] * 3, "violates", "not judged", (0, 0, 0)),
        ([LOST] * 3, "violates", "not flown", (0, 0, 3)),
        ([LOST] * 3, "fixed", "not flown", (0, 0, 3)),
        ([flight("held"), LOST, LOST], "violates", "not flown", (0, 1, 2)),
        ([LOST, flight("vacuous"), flight("held")], "fixed", "not flown", (0, 2, 1)),
        ([flight("inconclusive"), LOST, flight("held")], "violates", "not flown", (0, 1, 1)),
        ([flight("held"), flight("inconclusive"), flight("held")], "violates", "not judged", (0, 2, 0)),
        ([LOST, flight("held", also="a-chute")], "violates", "changed", (0, 1, 1)),
        ([flight("inconclusive", also="a-chute"), LOST], "violates", "changed", (0, 0, 1)),
        ([LOST, flight("violated")], "violates", "still there", (1, 1, 1)),
        ([LOST, flight("held"), flight("violated")], "fixed", "came back", (1, 2, 1)),
    ],
)
def test_each_state_has_its_flights(
    samples: list[Sample], standing: known.Standing, state: State, counts: tuple[int, int, int]
) -> None:
    told = regressing.told(msgspec.structs.replace(KNOWN, standing=standing), samples, HERE)
    assert (told.state, (told.violated, told.judged, told.lost)) == (state, counts)


def test_modes_of_other_targets_are_not_compared() -> None:
    samples = [flight("violated", "upright, soft, in mode 2")]
    assert regressing.told(KNOWN, samples, HERE).state == "changed"
    assert regressing.told(KNOWN, samples, HERE._replace(target=Target(name="px4"))).state == "still there"


def test_nothing_is_taken_for_fixed_that_a_lost_flight_could_have_shown(tmp_path: Path) -> None:
    samples = [flight("held"), LOST, flight("held")]
    result = regressing.told(KNOWN, samples, HERE)
    assert (result.words, regressing.exit_code([result], known_ok=True)) == ("no simulator", 3)
    assert regressing.check(result, known_ok=True).outcome == "error"
    known.keep([regressing.after(result)], tmp_path)
    assert known.read(tmp_path) == [KNOWN], "the corpus takes nothing from it"


def told(state: State) -> regressing.Regressed:
    return regressing.Regressed(KNOWN, state, 1, 3, 0, "", "abc")


@pytest.mark.parametrize(
    ("states", "code", "known_ok"),
    [
        (["fixed", "fixed"], 0, 0),
        (["fixed", "still there", "not flown"], 1, 3),
        (["flaky"], 1, 0),
        (["came back"], 1, 1),
        (["changed"], 1, 1),
        (["not judged"], 3, 3),
        ([], 0, 0),
    ],
)
def test_exit_codes(states: list[State], code: int, known_ok: int) -> None:
    results = [told(state) for state in states]
    assert regressing.exit_code(results, known_ok=False) == code
    assert regressing.exit_code(results, known_ok=True) == known_ok


def test_a_fixed_one_stays_in_the_corpus_and_is_remembered(tmp_path: Path) -> None:
    known.keep([regressing.after(told("fixed"))], tmp_path)
    assert [one.standing for one in known.read(tmp_path)] == ["fixed"]
    assert [one.standing for one in known.with_standing([KNOWN], tmp_path)] == ["fixed"]
    known.keep([regressing.after(told("not flown"))], tmp_path / "other")
    assert known.read(tmp_path / "other") == [KNOWN], "flights that say nothing change nothing"
    assert known.one_of(tmp_path, "0123", ()).name == KNOWN.name
    assert known.one_of(tmp_path, "", ("a-chute",)).policy == "a-chute"


def test_several_policies_or_flights_of_one_fingerprint_can_be_told_apart(tmp_path: Path) -> None:
    other = msgspec.structs.replace(KNOWN, fingerprint="1" * 16, policy="a-chute")
    twin = msgspec.structs.replace(KNOWN, name="7" * 16)
    known.keep([KNOWN, other, twin], tmp_path)
    with pytest.raises(Refused) as told:
        known.one_of(tmp_path, "", ())
    assert all(word in str(told.value) for word in (KNOWN.name, twin.name, "a-chute", "--policy"))
    assert known.one_of(tmp_path, "7777", ()).name == twin.name
    assert known.one_of(tmp_path, "fedc", ("a-chute",)).fingerprint == other.fingerprint


def test_of_the_test_cases_of_one_behaviour_the_smallest_is_meant(tmp_path: Path) -> None:
    """A find and its smallest form share a fingerprint, which is what summary, report and pages name it by."""
    steps = tuple(Stimulus(at_s=1.0 + at, kind="mode", name="RTL") for at in range(3))
    found, small = (
        msgspec.structs.replace(
            KNOWN, name=name, test_case=msgspec.structs.replace(KNOWN.test_case, stimuli=steps[:many])
        )
        for name, many in (("1" * 16, 3), ("7" * 16, 1))
    )
    known.keep([found, small], tmp_path)
    assert known.one_of(tmp_path, KNOWN.fingerprint, ()).name == small.name
    assert known.one_of(tmp_path, found.name, ()).name == found.name


def test_of_a_run_one_of_each_behaviour_is_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = tuple(Stimulus(at_s=1.0 + at, kind="mode", name="RTL") for at in range(3))
    long = msgspec.structs.replace(KNOWN.test_case, stimuli=steps)
    found = msgspec.structs.replace(KNOWN, name="1" * 16, test_case=long)
    small = msgspec.structs.replace(KNOWN, name="7" * 16)
    other = msgspec.structs.replace(KNOWN, fingerprint="f" * 16, policy="a-chute")
    for came in itertools.permutations([found, small, other]):  # as workers returned them
        monkeypatch.setattr(known, "_of_run", lambda *_, came=came: list(came))
        assert known.read(tmp_path) == [small, other]
        assert known.read(tmp_path, found.name) == [found], "one that is named is told as it is"
        assert known.read(tmp_path, everything=True) == [found, small, other]


def test_a_policy_file_is_judged_by_the_id_in_it(tmp_path: Path) -> None:
    known.keep([KNOWN], tmp_path)
    (file,) = beginning.begin("policy", "stays-below", tmp_path, force=False)
    meant = known.one_of(tmp_path, "", (str(file), "upright"))
    assert (meant.policy, meant.policies) == ("stays-below", ("stays-below", "upright"))
    assert meant.policy_texts["stays-below"].text == file.read_text(encoding="utf-8")


def test_what_is_not_known_is_refused(tmp_path: Path) -> None:
    known.keep([KNOWN], tmp_path)
    with pytest.raises(Refused, match=KNOWN.fingerprint):
        known.read(tmp_path, "ffff")
    (tmp_path / KNOWN.file).write_text('{"fingerprint": 1}')
    with pytest.raises(Refused, match="regress"):
        known.read(tmp_path)


@pytest.mark.parametrize("field", ["fingerprint", "name"])
@pytest.mark.parametrize("value", ["../../outside", "/tmp/outside", "0123456789abcde\n", "0123456789ABCDEF", "x"])
def test_a_corpus_that_others_made_names_no_file_elsewhere(field: str, value: str, tmp_path: Path) -> None:
    """`regress` writes what it found over the file of each: by names that were read from it."""
    told = msgspec.to_builtins(KNOWN)
    (tmp_path / KNOWN.file).write_bytes(msgspec.json.encode({**told, field: value}))
    with pytest.raises(Refused, match=field):
        known.read(tmp_path)


def test_junit_and_sarif_tell_all(tmp_path: Path) -> None:
    states: list[State] = ["fixed", "still there", "came back", "not flown", "not judged", "flaky"]
    checks = [regressing.check(told(state), known_ok=True) for state in states]
    suite = Xml.fromstring(ci_files.junit("nightly", checks))
    assert [suite.get(word) for word in ("tests", "failures", "errors", "skipped")] == ["6", "1", "1", "3"]
    run = ci_files.sarif("nightly", checks)["runs"][0]
    assert [one["baselineState"] for one in run["results"]] == ["absent", "unchanged", "new", "unchanged", "unchanged"]
    assert [one["level"] for one in run["results"]] == ["none", "none", "warning", "none", "none"]
    assert run["invocations"][0]["executionSuccessful"] is False


def test_files_for_others_withhold_findings_of_memory_safety() -> None:
    way = "autopilot-alive, hard, in mode 0, heap-buffer-overflow in somewhere"
    died = Verdict(
        policy="autopilot-alive",
        outcome="violated",
        behaviour=way,
        message="died: AddressSanitizer: heap",
    )
    result = regressing.told(
        msgspec.structs.replace(KNOWN, policy="autopilot-alive", behaviour=way),
        [Sample(0, "autopilot_died", (died,))],
        HERE,
    )
    assert (result.state, result.words) == ("still there", way.replace("mode 0", "STABILIZE"))
    row = regressing.check(result, known_ok=False)
    assert "somewhere" not in ci_files.junit("x", [row]) + str(ci_files.sarif("x", [row]))


def test_builds_are_named_in_one_argument() -> None:
    build = builds.parse("reference+parachute-in-acro+flip-rolls-left")
    assert build.target.settings == {"defects": ["parachute-in-acro", "flip-rolls-left"]}
    assert build.digest
    for wrong, expected in (("nosuch", "reference"), ("reference+nosuch", "parachute-in-acro"), ("", "TARGET")):
        with pytest.raises(Refused, match=expected):
            builds.parse(wrong)
    case = TestCase(target=Target(name="px4", parameters={"RTL_ALT": 3.0}, build="x"), scenario=Scenario())
    assert build.carrying(case).target == Target(parameters={"RTL_ALT": 3.0}, settings=build.target.settings)


def test_a_build_that_does_not_run_is_left_out_and_a_wrong_name_is_refused(tmp_path: Path) -> None:
    broken = tmp_path / "firmware.py"
    broken.write_text("def describe(:")
    assert "SyntaxError" in builds.parse_or_leave(str(broken)).trouble
    with pytest.raises(Refused):
        builds.parse_or_leave(str(tmp_path / "gone.py"))
    with pytest.raises(Refused):
        builds.parse_or_leave("nosuch")


def test_noises_begin_with_the_one_of_the_record() -> None:
    assert builds.noises(1, first=2) == (2,)
    assert builds.noises(4) == (0, *builds.fresh_noises(3))
    assert builds.noises(4, first=2) == (2, *builds.fresh_noises(3))


def test_rates_are_told_by_policy_with_lost_flights_apart() -> None:
    samples = (flight("violated"), flight("held"), LOST, flight("held", also="a-chute"))
    rates = tuple(flaking._rate(name, samples) for name in ("upright", "a-chute"))
    flown = flaking.Flaked(KNOWN, HERE, samples, rates, LOST)
    assert [(one.violated, one.judged) for one in rates] == [(1, 3), (1, 1)]
    assert flaking.exit_code(flown) == 1
    assert any("1 x upright, soft, in LOITER" in text for text in flaking.lines(flown)), "modes have names"
    assert flaking.plain(flown)["policies"]["upright"]["ways"] == {"upright, soft, in LOITER": 1}, "for scripts, too"
    assert any("1 of 4 flights say nothing: no simulator" in text for text in flaking.lines(flown))
    assert flaking.lines(flown)[-1].endswith("not counted: says nothing: no simulator")
    silent = flaking.Flaked(KNOWN, HERE, (LOST,), (flaking._rate("upright", (LOST,)),), LOST)
    assert flaking.exit_code(silent) == 3
    assert flaking.exit_code(silent._replace(own=flight("held"))) == 3, "one flight that is not counted shows no rate"
    assert flaking.exit_code(silent._replace(own=flight("violated"))) == 1


def test_a_violation_on_a_target_that_tells_no_mode_says_so() -> None:
    assert modes_named("upright, soft, in mode -1", {"LOITER": 5}) == "upright, soft, in an unknown mode"
    assert modes_named("upright, soft, in mode 77", {"LOITER": 5}) == "upright, soft, in mode 77"


def test_new_is_what_the_flights_show_to_be_new() -> None:
    new = comparing._compared(KNOWN, [flight("held")] * 5, [flight("violated")] * 5)
    same = comparing._compared(KNOWN, [flight("violated")] * 5, [flight("violated")] * 5)
    lost = comparing._compared(KNOWN, [LOST] * 5, [flight("violated")] * 5)
    partly = comparing._compared(KNOWN, [flight("held")] * 5, [flight("violated"), flight("held"), *[LOST] * 3])
    enough = comparing._compared(KNOWN, [flight("held")] * 5, [*[flight("violated")] * 4, LOST])
    assert new.is_new(0.95)
    assert enough.is_new(0.95)
    assert not partly.is_new(0.95)
    assert same.chance == pytest.approx(0.5)
    assert not lost.is_new(0.95), "with nothing flown on the old build nobody knows"

    def code(*compared: comparing.Compared) -> int:
        return comparing.exit_code(comparing.Difference(compared, 0, (0, 1), (9, 9)), 0.95)

    assert [code(), code(same), code(lost), code(same, new, lost)] == [0, 0, 3, 1]
    difference = comparing.Difference((new, same), 0, (0, 2), (9, 9))
    told = comparing.plain(difference, 0.95)["finds"]
    assert [one["behaviour"] for one in told] == ["upright, soft, in LOITER"] * 2, "modes have names for scripts, too"
    assert comparing.lines(difference, HERE, HERE, 0.95)[-1].endswith(
        "(of 2 compared; by chance alone about 0.10 would be told so)"
    ), "what is expected of all that was compared, not of what was told only"
    assert [code(partly), code(same, partly), code(enough)] == [3, 3, 1], "what is lost could have shown it"
    assert [comparing.check(one, 0.95).outcome for one in (same, partly, enough)] == ["skipped", "error", "failed"]


def test_the_build_of_a_test_case_says_why_it_cannot_fly_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SAFLITE_PX4", raising=False)
    build = builds.of_case(TestCase(target=Target(name="px4"), scenario=Scenario()))
    assert "no PX4 binary is named" in build.trouble
    with pytest.raises(Unavailable, match="cannot fly here: no PX4"):
        builds.use(build)
