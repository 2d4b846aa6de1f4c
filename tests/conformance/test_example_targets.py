"""The example targets pass the suites that targets from outside are held to, and their policies tell good from bad."""

from __future__ import annotations

from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.conformance.flying import opened
from saflite.conformance.kit import Check, findings, name_of
from saflite.conformance.targets import checks_of
from saflite.contract.flight import Flight
from saflite.contract.test_case import Stimulus, StimulusKind, TestCase, identity
from saflite.oracle.judge import judge
from saflite.simulator_worker.registry import load_target

FOLDER = Path(__file__).parents[2] / "deploy" / "examples" / "targets"
MODULES = sorted(FOLDER.glob("*.py"))
LINES_MAX = 80


@pytest.mark.parametrize(
    "check", [check for path in MODULES for check in checks_of(load_target(path.stem, MODULES))], ids=name_of
)
def test_the_example_passes(check: Check) -> None:
    assert findings([check]) == []


def test_the_examples_stay_small() -> None:
    assert {path.name for path in MODULES} == {"point_mass.py", "drifting_mass.py"}
    assert [path.name for path in MODULES if len(path.read_text().splitlines()) > LINES_MAX] == []


def given(at_s: float, kind: StimulusKind, name: str, value: float) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=(value,))


def margins(campaign_file: str, stimuli: tuple[Stimulus, ...], flights: int) -> list[float]:
    campaign = load_campaign(str(FOLDER / campaign_file))
    plain = template(campaign)
    test_case = TestCase(target=plain.target, scenario=plain.scenario, stimuli=stimuli, rng_seed=1)
    found = []
    with opened(load_target(plain.target.name, MODULES)) as session:
        for index in range(flights):
            record = session.fly(test_case, 60.0, lambda: False)
            flight = Flight(
                test_case=identity(test_case), flight_index=index, ending=record.ending, delivered=record.delivered
            )
            (verdict,) = judge(test_case, flight, record.trace, campaign.policies, campaign.policy_texts).verdicts
            assert verdict.robustness is not None
            found.append(verdict.robustness)
    return found


def test_the_fault_of_the_point_mass_breaks_its_policy_and_nothing_less_does() -> None:
    aim, stiff = given(1.0, "parameter", "AIM", 5.0), given(2.0, "parameter", "GAIN", 11.0)
    weak = given(3.0, "sensor_fault", "WEAK", 0.9)
    (broken,) = margins("point-mass.toml", (aim, stiff, weak), 1)
    assert broken < 0.0
    for less in ((aim, stiff), (aim, weak), (stiff,), (given(1.0, "parameter", "AIM", 2000.0),)):
        assert margins("point-mass.toml", less, 1)[0] > 0.0


def test_outcomes_of_the_drifting_mass_vary() -> None:
    found = margins("drifting-mass.toml", (given(1.0, "parameter", "LEAN", 9.5),), 40)
    assert min(found) < 0.0 < max(found)
    assert max(margins("drifting-mass.toml", (given(1.0, "parameter", "LEAN", 3.0),), 10)) > 0.0
