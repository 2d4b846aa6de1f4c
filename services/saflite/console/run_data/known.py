"""Known violations: the confirmed ones of a run, or a corpus, a folder of files that outlives the run.

A corpus is flown again on new builds (`saflite regress`); one that is fixed stays in it, so that it is seen if it
comes back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from saflite.campaign.presets.policy_campaigns import policy_text
from saflite.campaign.storage.own_folder import STORE
from saflite.console.io import outputs
from saflite.console.run_data.run_folder import open_run
from saflite.contract import wire
from saflite.contract.bounds import Count, Text, Word
from saflite.contract.errors import Refused
from saflite.contract.names import ShortId
from saflite.contract.outside import parse_json, read_text
from saflite.contract.plain import cut, some
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement, Violation
from saflite.contract.work import PolicyTexts
from saflite.oracle.policy import check_told, policy_names
from saflite.recorder.recording import Recording
from saflite.recorder.recording import read as read_recording

Standing = Literal["violates", "fixed"]
Words = Annotated[tuple[Word, ...], msgspec.Meta(max_length=1_000)]


class Known(msgspec.Struct, frozen=True, kw_only=True):
    """A violation to be flown again. `also` are policies that its flight violated besides; `noise` that of its flight.

    `memory_safety`: told in files for others by its counts only.
    `standing` is what the last flights of the corpus made of it, on the build `seen_on`.
    """

    fingerprint: ShortId
    name: ShortId
    policy: Word
    behaviour: Text
    test_case: TestCase
    policies: Words
    policy_texts: PolicyTexts = {}
    also: Words = ()
    noise: Count = 0
    severity: Literal["none", "soft", "hard"] = "soft"
    found_in: Word = ""
    memory_safety: bool = False
    standing: Standing = "violates"
    seen_on: Word = ""

    @property
    def file(self) -> str:
        """The name of its file in a corpus."""
        return f"{self.fingerprint}-{self.name}.json"


def read(place: Path, wanted: str = "", *, everything: bool = False) -> list[Known]:
    """Return the known violations of a run folder or corpus, those whose fingerprint or test case begins so.

    In the order of a corpus, whatever the order in which a run found them. Of a find and the smallest form made of
    it, which violate in one way, the smaller is told, unless one is named.
    `everything`: of a run the flaky and unconfirmed ones, too.

    Raises:
        Refused: neither stands there, a file is damaged, or nothing is called so.
    """
    if place.is_dir() and _files(place):
        found = _corpus(place)
    else:
        found = sorted(_of_run(place, everything), key=_place)  # a run tells them as its results came in
        found = found if wanted or everything else _smallest(found)
    chosen = [one for one in found if one.fingerprint.startswith(wanted) or one.name.startswith(wanted)]
    if wanted and not chosen:
        raise no_violation([one.fingerprint for one in found], wanted, str(place))
    return chosen


def no_violation(known: Sequence[str], wanted: str, where: str) -> Refused:
    """Return what to raise where no fingerprint or test case begins as wanted."""
    expected = f"the start of a fingerprint or test case: {some(known) or 'there is none'}"
    return Refused("--violation", where=where, expected=expected, got=repr(cut(wanted, 80)), known=known)


def keep(known: Iterable[Known], folder: Path) -> None:
    """Write violations into a corpus, each over the one of its name; raises Unavailable if the disk refuses."""
    for one in known:
        text = msgspec.json.format(msgspec.json.encode(one)) + b"\n"
        outputs.write(folder / one.file, text, force=True, option="--corpus")


def _files(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.glob("*-*.json")) if len(path.stem.split("-")) == 2]


def _corpus(folder: Path) -> list[Known]:
    return [_read(path) for path in _files(folder)]


def _read(path: Path) -> Known:
    data = parse_json(read_text(path, "known violation"), "known violation", str(path))
    try:
        return wire.convert(data, Known)
    except msgspec.ValidationError as fault:
        raise Refused(
            "known violation", where=str(path), expected="one that `regress` wrote", got=str(fault)
        ) from fault


def _of_run(run_dir: Path, everything: bool) -> list[Known]:
    with open_run(run_dir) as run:
        standings = ("confirmed", "flaky", "unconfirmed") if everything else ("confirmed",)
        chosen = [one for one in run.violations() if one.confirmation in standings]
        memory = run.memory_faults()
        return [
            Known(
                fingerprint=one.fingerprint,
                name=one.test_case,
                policy=one.policy,
                behaviour=one.behaviour,
                test_case=run.test_case(one.test_case),
                policies=run.campaign.policies,
                policy_texts=run.campaign.policy_texts,
                also=_also(run.judgement(one.test_case, one.flight_index), one),
                noise=one.flight_index,
                severity=one.severity,
                memory_safety=one.test_case in memory,
                found_in=run_dir.name,
                seen_on=run.target.build,
            )
            for one in chosen
        ]


def _smallest(found: Sequence[Known]) -> list[Known]:
    """Return of those that violate one policy in one way the one that takes the least."""
    least: dict[tuple[str, str], Known] = {}
    for one in found:
        key = (one.fingerprint, one.policy)
        least[key] = min(least.get(key, one), one, key=_size)
    return list(least.values())


def _also(judgement: Judgement | None, violation: Violation) -> tuple[str, ...]:
    verdicts = judgement.verdicts if judgement is not None else ()
    return tuple(one.policy for one in verdicts if one.outcome == "violated" and one.policy != violation.policy)


def with_standing(known: Iterable[Known], folder: Path) -> list[Known]:
    """Return the violations with the standing that a corpus gives them, where it holds them."""
    held = {one.file: one for one in _corpus(folder)} if folder.is_dir() else {}
    return [
        msgspec.structs.replace(one, standing=held[one.file].standing) if one.file in held else one for one in known
    ]


def one_of(what: Path, wanted: str, policies: tuple[str, ...], *, anywhere: bool = False) -> Known:
    """Return the violation meant: of a run or corpus the one named, a file of a corpus, a recording or a test case.

    Of several test cases that violate one policy in one way the smallest is meant.

    Args:
        what: folder or file.
        wanted: fingerprint or test case, or the start of it; empty where there is only one.
        policies: judged by these, names or policy files; the first is the one in question. Those of the record if
            none is given.
        anywhere: allow a test case boxes outside the competition's area and count, as a recording may have.

    Raises:
        Refused: nothing or more than one thing is meant, nobody says which policy is in question, or a test case has
            boxes that `fly` refuses.
    """
    files = dict(policy_text(Path(name)) for name in policies if name.endswith(".toml"))
    named = {text.file: name for name, text in files.items()}
    policies = tuple(named.get(str(Path(name)), name) for name in policies)
    if what.is_dir():
        found = read(what, wanted)
        if len(found) > 1:  # one flight may violate several policies, and several flights one in the same way
            found = [one for one in found if one.policy in policies[:1]] or found
        if len({(one.fingerprint, one.policy) for one in found}) == 1:
            found = [min(found, key=_size)]
        if len(found) != 1:
            names = some(f"{one.fingerprint} ({one.policy}, test case {one.name})" for one in found) or "none"
            raise Refused("--violation", where=str(what), expected="one violation, maybe by --policy", got=names)
        known = found[0]
    elif what.suffix == ".json" and len(what.stem.split("-")) == 2:
        known = _read(what)
    else:
        known = _of_file(what, policies, anywhere)
    if not policies:
        return known
    texts = {**known.policy_texts, **files}
    return msgspec.structs.replace(known, policy=policies[0], policies=policies, policy_texts=texts, behaviour="")


def _place(known: Known) -> tuple[str, str, str]:
    return known.fingerprint, known.name, known.policy


def _size(known: Known) -> tuple[int, int, str]:
    case = known.test_case
    return len(case.stimuli), len(case.scenario.obstacles), known.name


def own_policies(found: Recording) -> PolicyTexts:
    """Return the rules of one's own that a recording carries; one that ships is judged by as it ships."""
    return _own(found.policy_texts)


def _own(texts: PolicyTexts) -> PolicyTexts:
    return {name: text for name, text in texts.items() if name not in policy_names()}


def policies_with(case_file: Path) -> PolicyTexts:
    """Return the rules of one's own that a test case comes with: its recording's, or those of the run it lies in."""
    if case_file.suffix == ".mcap":
        return own_policies(read_recording(case_file))
    run_dir = case_file.absolute().parent.parent
    if not (run_dir / STORE).exists():
        return {}
    with suppress(Refused), open_run(run_dir) as run:  # a damaged run is no reason not to fly
        return _own(run.campaign.policy_texts)
    return {}


def _of_file(what: Path, policies: tuple[str, ...], anywhere: bool) -> Known:
    from saflite.console.io.cases import check_layout, load_case
    from saflite.contract.test_case import identity

    texts: PolicyTexts = {}
    case, judged, noise = load_case(what), policies, 0
    check_layout(case, str(what), anywhere or what.suffix == ".mcap")
    if what.suffix == ".mcap":
        record = read_recording(what)
        noise = record.flight.flight_index
        verdicts = sorted(record.judgement.verdicts, key=lambda one: one.outcome != "violated")
        texts = own_policies(record)
        if not judged:
            judged = tuple(one.policy for one in verdicts)
            check_told(judged, texts)
    elif case.scenario.obstacles:
        judged = judged or ("min-obstacle-distance",)
    if not judged:
        fix = "name it by --policy, or name the run and --violation ID"
        raise Refused("--policy", where=str(what), expected="the policy in question", got="none", fix=fix)
    name = identity(case)
    return Known(
        fingerprint=name,
        name=name,
        policy=judged[0],
        behaviour="",
        test_case=case,
        policies=judged,
        policy_texts=texts,
        noise=noise,
    )
