"""A finding as a script for the maintainers of an autopilot, and what their tools take; flown without the farm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

from saflite.console.io import outputs
from saflite.console.run_data.embargo import Released, is_public
from saflite.console.run_data.run_folder import RunFolder, open_run
from saflite.console.view import out
from saflite.contract.circumstances import in_words
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.plain import word
from saflite.contract.standalone import Evidence, Standalone
from saflite.contract.test_case import under_noise
from saflite.recorder.summary import Finding


def export_standalone(run_dir: Path, wanted: str, folder: Path, released: Released) -> list[Path]:
    """Write the script of a finding, named by its test case or fingerprint (or the start of one), in its smallest
    confirmed form; returns the files, the one to run first.

    Raises:
        Refused: there is no such finding, its target makes no such scripts, or the finding is withheld.
        Unavailable: the target does not come up, or the disk does not take a file.
    """
    with open_run(run_dir) as run:
        finding = _finding(run, wanted)
        if not is_public(finding, released):
            fix = f"--release {finding.violation.fingerprint}, for its maintainers only"
            raise Refused("finding", where=str(run_dir), expected="one that may be shown", got="memory safety", fix=fix)
        flight, name = _flight(run, finding), f"{run.target.name}-{finding.violation.test_case}.py"
        facts = run.summary((finding.violation.fingerprint,)).policies
    title = next((policy.title for policy in facts if policy.id == finding.violation.policy), "the autopilot died")
    make = _maker(finding)
    case = under_noise(finding.test_case, finding.violation.flight_index)
    files = make(case, flight, _evidence(finding, title, name))
    for file, text in files.items():
        outputs.write(folder / file, text.encode(), force=True)
    return [folder / file for file in files]


def _finding(run: RunFolder, wanted: str) -> Finding:
    found = run.findings(similar=True)
    for finding in found:
        if finding.violation.test_case.startswith(wanted) or finding.violation.fingerprint.startswith(wanted):
            least = smallest_form(finding, found)
            if least is not finding:
                name, size, of = least.violation.test_case, _size(least), _size(finding)
                words = f"the smallest confirmed form of {finding.violation.test_case} is taken"
                out.complain("note", f"{words}: {name}, {size} of {of} inputs")
            return least
    raise Refused("--standalone", where=str(run.path), expected="a finding of this run", got=repr(wanted))


def smallest_form(finding: Finding, found: Sequence[Finding]) -> Finding:
    """Return the confirmed finding that takes the fewest steps to the same behaviour, `finding` where none takes less.

    Whoever reads a script asks what is needed; a find still holds all that the search happened to draw.
    """
    violation = finding.violation
    same = [
        one
        for one in found
        if (one.violation.fingerprint, one.violation.policy) == (violation.fingerprint, violation.policy)
        and one.violation.confirmation == "confirmed"
        and one.circumstances is not None
        and one.circumstances.minimal
    ]
    return min((finding, *same), key=_size)


def _size(finding: Finding) -> int:
    case = finding.test_case
    return len(case.scenario.obstacles) + len(case.target.parameters) + len(case.stimuli)


def _flight(run: RunFolder, finding: Finding) -> Flight:
    violation = finding.violation
    row = next((row for row in run.flights(violation.test_case) if row.shows(violation)), None)
    flight = None if row is None else run.flight(row)
    if flight is None:
        raise Refused("finding", where=str(run.path), expected="one whose flight is on record", got="none")
    return flight


def _maker(finding: Finding) -> Standalone:
    from saflite.simulator_worker.registry import load_target

    name = finding.test_case.target.name
    make = getattr(load_target(name), "standalone", None)
    if make is None:
        raise Refused("--standalone", expected="a target that makes scripts of findings", got=f"{name}, which does not")
    return cast(Standalone, make)


def _evidence(finding: Finding, title: str, name: str) -> Evidence:
    violation, circumstances = finding.violation, finding.circumstances
    assert circumstances is not None, "a finding of a run has its circumstances"
    verdicts = finding.judgement.verdicts if finding.judgement is not None else ()
    verdict = next((one for one in verdicts if one.policy == violation.policy), None)
    return Evidence(
        file=name,
        policy=violation.policy,
        title=word(title),
        from_s=verdict.witness_from_s if verdict else 0.0,
        until_s=verdict.witness_to_s if verdict else 0.0,
        asked={what: word(answer) for what, answer in in_words(circumstances).items()},
        steps=[word(step) for step in circumstances.steps],
    )
