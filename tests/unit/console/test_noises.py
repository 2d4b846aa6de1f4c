"""What is counted of a find is flown under noise that had no part in finding it.

A campaign keeps what violated under the first few noises, and flights repeat bit by bit: counted again, these flights
say what the campaign asked for, and nothing of the rate. The target here is the worst case: it violates under no other.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.campaign.presets.policy_campaigns import policy_text
from saflite.console.operations import bisecting, builds, comparing, flaking, regressing
from saflite.console.operations.builds import Build
from saflite.console.run_data.known import Known
from saflite.console.view import regression
from saflite.contract import modules
from saflite.contract.config import RANGES
from saflite.contract.test_case import Scenario, StartState, Target, TestCase, identity, under_noise

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples" / "targets"
CASE = TestCase(
    target=Target(name="point_mass"),
    scenario=Scenario(start=StartState(mode="KEEP", altitude_m=0.0), time_limit_s=2.0),
)
FLOWN = 5  # noises of a campaign: the first flight, and more than the re-flights it asks for
TIMES, WALL_LIMIT_S = 5, 60.0
POLICY, TEXT = policy_text(EXAMPLES / "point-mass-stays.toml")
FIND = Known(
    fingerprint="0123456789abcdef",
    name=identity(CASE),
    policy=POLICY,
    behaviour="",
    test_case=CASE,
    policies=(POLICY,),
    policy_texts={POLICY: TEXT},
)


@pytest.fixture
def versions(tmp_path: Path) -> Iterator[tuple[Build, Build]]:
    """Two builds: one that never violates, and the one on which the find was selected."""
    text = (EXAMPLES / "point_mass.py").read_text()
    selected = {under_noise(CASE, number).rng_seed for number in range(FLOWN)}
    thrown = f"place_m, speed_mps = [], [], 0.0, 300.0 if test_case.rng_seed in {selected} else 0.0"
    lucky = text.replace("place_m, speed_mps = [], [], 0.0, 0.0", thrown)
    assert lucky != text
    made = []
    for name, content in (("old", text), ("new", lucky)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "point_mass.py").write_text(content)
        made.append(builds.parse(str(tmp_path / name / "point_mass.py")))
    yield made[0], made[1]
    modules.forget()


def test_no_campaign_reaches_the_noises_that_are_counted() -> None:
    """A smallest form may be re-flown from behind as many flights as a find is re-flown at most."""
    assert 2 * RANGES["search.confirm_flights"][1] <= builds.FRESH_NOISE
    assert builds.fresh_noises(3) == tuple(range(builds.FRESH_NOISE, builds.FRESH_NOISE + 3))


def test_a_find_is_not_new_because_the_search_of_the_new_build_selected_it(versions: tuple[Build, Build]) -> None:
    on_old, on_new = (comparing._flown([FIND], build, TIMES, WALL_LIMIT_S)[0] for build in versions)
    assert [one.noise for one in on_old] == [one.noise for one in on_new], "both builds fly under the same"
    compared = comparing._compared(FIND, on_old, on_new)
    assert (compared.old, compared.new, compared.lost) == ((0, TIMES), (0, TIMES), 0)
    assert not compared.is_new(0.5 + 1e-9)


def test_a_rate_is_not_that_of_the_flights_by_which_it_was_found(versions: tuple[Build, Build]) -> None:
    flown = flaking.flake(FIND, versions[1], TIMES, WALL_LIMIT_S)
    (rate,) = flown.rates
    assert (rate.violated, rate.judged, flown.lost) == (0, TIMES, [])
    assert (flown.own.noise, flown.own.violated) == (FIND.noise, (POLICY,))
    assert flaking.lines(flown)[-1].endswith(f"under the noise of its record, not counted: violates {POLICY}")
    assert flaking.plain(flown)["own_noise"]["violated"] == (POLICY,)
    assert flaking.exit_code(flown) == 1, "violated it was"


def test_no_build_broke_what_violates_under_chosen_noise_only(versions: tuple[Build, Build]) -> None:
    found = bisecting.bisect(FIND, versions, confidence=0.8, most=30, wall_limit_s=WALL_LIMIT_S)
    assert (found.change, found.sure) == ("never", True)
    assert [violated for violated, _ in found.counts] == [0, 0]


def test_a_known_violation_has_the_rate_of_fresh_noise(versions: tuple[Build, Build]) -> None:
    def flown(times: int) -> regressing.Regressed:
        (found,) = regressing.regress([FIND], versions[1], times=times, wall_limit_s=WALL_LIMIT_S)
        return found

    told = flown(TIMES)
    assert (told.state, told.violated, told.judged, told.fresh) == ("flaky", 1, TIMES, (0, TIMES - 1))
    assert told.rate == "1 of 5, rate 0.00 to 0.49 under fresh noise"
    assert regression.plain(told)["fresh_noise"] == {"violated": 0, "judged": TIMES - 1}
    alone = flown(1)
    assert (alone.state, alone.rate) == ("still there", "1 of 1"), "the flight that found it has no rate to tell"
