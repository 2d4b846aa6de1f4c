"""The report shows every violation with a picture, loads nothing, and takes no text for markup."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest
from shapely.geometry import Point, Polygon

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.console.run_data.in_force import at_first
from saflite.console.run_data.rows import ArtefactRow, FlightRow
from saflite.console.view.report import bars, charts, evidence, layout, page
from saflite.console.view.report.data import Exhibit, Progress, ReportData
from saflite.console.view.report.svg import nice_step
from saflite.contract.blobs import BlobRef
from saflite.contract.events import Quarantined
from saflite.contract.flight import Delivered, Flight, Trace
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, TestCase
from saflite.contract.verdict import Judgement, Verdict, Violation
from saflite.contract.work import PolicyText
from saflite.flight.geometry import corner_points
from saflite.recorder.summary import Rulings
from saflite.scorer_pool.calibration import Row, calibrate_all

STAYS = Path(__file__).parents[3] / "deploy" / "examples" / "targets" / "point-mass-stays.toml"
EVIL = '<script>alert("x")</script>'


def signal(values: np.ndarray) -> bytes:
    return values.astype("<f4").tobytes()


def trace() -> Trace:
    times = np.arange(0.0, 60.0, 0.05)
    signals = {
        "x_m": signal(0.2 * times - 5.0),
        "y_m": signal(0.5 * times),
        "altitude_m": signal(np.full_like(times, 10.0)),
        "vx_mps": signal(np.full_like(times, 0.2)),
        "vy_mps": signal(np.full_like(times, 0.5)),
        "obstacle_distance_m": signal(np.abs(times - 30.0) / 4.0),
    }
    return Trace(step_s=0.05, signals=signals)


def case() -> TestCase:
    base = template(load_campaign("avoidance-m2"))
    box = Obstacle(length_m=6.0, width_m=4.0, height_m=20.0, x_m=1.0, y_m=15.0, rotation_deg=20.0)
    assert base.scenario.mission is not None
    return TestCase(target=base.target, scenario=Scenario(mission=base.scenario.mission, obstacles=(box,)))


def exhibit(fingerprint: str) -> Exhibit:
    violation = Violation(
        fingerprint=fingerprint,
        test_case="0123456789abcdef",
        policy="min-obstacle-distance",
        robustness=-1.2,
        severity="soft",
        confirmation="confirmed",
        reflown=1,
        failed_again=1,
        workers=("fly-1", "fly-2"),
        message=EVIL,
    )
    verdict = Verdict(
        policy="min-obstacle-distance", outcome="violated", robustness=-1.2, witness_from_s=28.0, witness_to_s=32.0
    )
    judgement = Judgement(test_case="0123456789abcdef", flight_index=0, verdicts=(verdict,), fingerprint=fingerprint)
    row = FlightRow(
        "0123456789abcdef", 0, "search", "completed", 60.0, 0.3, "ab" * 32, "fly-1", -1.2, (verdict.policy,)
    )
    return Exhibit(violation, case(), judgement, "recordings/x.mcap", trace(), (row,))


def test_inputs_stand_where_they_were_given_with_what_became_of_them() -> None:
    one = exhibit("f" * 16)
    plan = tuple(
        Stimulus(at_s=at_s, kind="parameter", name=name, values=(1.0,))
        for at_s, name in ((5.0, "LATE"), (6.0, "NO"), (59.0, "NEVER"))
    )
    delivered = (Delivered(index=0, at_s=7.5, answer="late"), Delivered(index=1, at_s=8.0, answer="denied"))
    flight = Flight(test_case="0123456789abcdef", flight_index=0, ending="completed", delivered=delivered)
    log = ArtefactRow("0123456789abcdef", "search", 0, "autopilot.log", BlobRef(digest="a" * 64, size_bytes=12))
    case = msgspec.structs.replace(one.test_case, stimuli=plan)
    drawn = evidence.section(1, one._replace(test_case=case, flight=flight, artefacts=(log,)), "runs/x")
    told = "at 7.5 s|LATE 1, late|at 8 s|NO 1, denied|NO (denied)|1 of 3 inputs|autopilot.log"
    assert [words for words in told.split("|") if words not in drawn] == []
    assert "NEVER" not in drawn
    assert "at 5 s" not in drawn
    planned = evidence.section(1, one._replace(test_case=case), "runs/x")
    assert "at 5 s" in planned
    assert "NEVER" in planned


def test_robustness_is_drawn_where_several_inputs_fall_on_one_instant() -> None:
    steps = 40
    made = Trace(step_s=0.5, signals={"place_m": signal(np.where(np.arange(steps) < 20, 1.0, 3.0))})
    places = (40.0, 3.0)
    plan = tuple(Stimulus(at_s=9.5, kind="parameter", name="PLACE", values=(value,)) for value in places)
    changes = tuple(
        Delivered(index=place, at_s=9.5, changed={"place_m": one.values[0]}) for place, one in enumerate(plan)
    )
    flight = Flight(test_case="0123456789abcdef", flight_index=0, ending="completed", delivered=changes)
    one = exhibit("f" * 16)
    scenario = Scenario(start=StartState(), time_limit_s=20.0)
    shown = one._replace(
        test_case=msgspec.structs.replace(one.test_case, scenario=scenario, stimuli=plan),
        violation=msgspec.structs.replace(one.violation, policy="point-mass-stays"),
        trace=made,
        flight=flight,
        policy_texts={"point-mass-stays": PolicyText(file=STAYS.name, text=STAYS.read_text())},
    )
    values, _ = evidence._policy_robustness(shown)
    assert values is not None
    assert len(values) == steps
    assert (values[18], values[19], values[20]) == (29.0, -10.0, 27.0)


def data(count: int) -> ReportData:
    exhibits = tuple(exhibit(f"{number:016x}") for number in range(count))
    steps = np.arange(count + 2, dtype=float)  # a flight at least, whatever was found
    rows = [Row("blend", 8.0, True), Row("blend", 2.0, False), Row("blend", 9.0, True, "random")]
    return ReportData(
        campaign=load_campaign("avoidance-m2"),
        in_force=at_first(load_campaign("avoidance-m2")),
        state="ended: the budget is spent",
        elapsed_s=30.0,
        exhibits=exhibits,
        flights=tuple(exhibit.flights[0] for exhibit in exhibits),
        progress=Progress(steps, -steps, steps, steps),
        calibrations=calibrate_all(rows),
        usage=(),
        faults=(f"worker: {EVIL}",),
        finds=Counter("f"),
        rulings={
            "min-obstacle-distance": Rulings(held=3, violated=2),
            "a-chute": Rulings(vacuous=5),
            EVIL: Rulings(inconclusive=5),
        },
        quarantined=(Quarantined(test_case="abc", attempts=3, last="wedged", message=EVIL),),
        states={"AUTO": 4, EVIL: 1},
        modes_unseen=("FLIP",),
    )


class Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.counts: dict[str, int] = {}
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        for name, value in attrs:
            if name in ("src", "href") and value and not value.startswith(("#", "recordings/")):
                self.loads.append(value)
        if tag != "meta":
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.stack.pop() == tag


@pytest.mark.parametrize("count", [0, 1, 7])
def test_every_violation_has_its_pictures_and_nothing_is_loaded(count: int) -> None:
    text = page.render(data(count), "runs/x")
    reader = Reader()
    reader.feed(text)
    assert reader.stack == []
    assert reader.loads == []
    assert text.count('class="chart"') == 2 + 3 * count  # distance, height and speed, the signal around the violation
    assert text.count('class="layout"') == count
    assert text.count('<section class="violation"') == count
    assert text.count("saflite replay runs/x --violation") == count
    assert "http" not in text.replace("http-equiv", "")


def test_a_policy_that_never_applied_is_named_and_the_others_are_not() -> None:
    text = page.render(data(0), "runs/x")
    rows = [row for row in text.split("<tr>") if "<td>5</td>" in row]
    assert len(rows) == 3
    assert ["never applied" in row for row in rows] == [False, True, False]
    assert "<td>min-obstacle-distance</td><td>5</td><td>5</td><td>2</td><td>0</td><td>0</td>" in rows[0]


def test_a_run_without_a_judged_flight_draws_no_empty_charts_and_says_nothing_of_the_vehicle() -> None:
    empty = data(0)._replace(progress=Progress(*[np.zeros(1)] * 4), rulings={"a-chute": Rulings(inconclusive=5)})
    told = page.render(empty, "runs/x")
    assert "No flight was judged: this says nothing of the vehicle." in told
    assert "No violation was found" not in told
    assert "violations over flights" not in told
    assert "No violation was found." in page.render(data(0), "runs/x")


def test_reliability_is_drawn_for_every_model_with_enough_flights() -> None:
    rows = [Row("blend", float(place), place > 6) for place in range(10)] + [Row("gap", 5.0, True)] * 7
    text = page.render(data(0)._replace(calibrations=calibrate_all(rows)), "runs/x")
    assert "blend: share violated, by score" in text
    assert "gap: share violated" not in text
    (blend, _) = calibrate_all(rows)[:2]
    drawn = bars.reliability(blend)
    heights = [float(part.split('height="')[1].split('"')[0]) for part in drawn.split("<rect")[1:]]
    assert heights == pytest.approx([0.0, 0.0, 0.0, 57.0, 114.0])  # nothing below 6, one of two, both
    assert drawn.count("2 flights") == 5


def test_picture_of_the_bugs_says_what_its_colours_mean() -> None:
    drawn = bars.bugs(())
    assert [word in drawn for word in ("score above 7", "between", "below 4")] == [True] * 3


def test_texts_are_never_markup() -> None:
    text = page.render(data(2), EVIL)
    assert text.count("<script") == 1, "the report's own"
    assert EVIL not in text
    assert "&lt;script&gt;" in text


def test_the_closest_point_and_its_distance_are_drawn() -> None:
    track = np.array([[-5.0, 0.0, 10.0], [-3.0, 14.0, 10.0], [-3.0, 16.0, 10.0], [0.0, 40.0, 10.0]])
    drawn = layout.picture(case(), track)
    assert 'class="danger"' in drawn
    assert 'class="closest"' in drawn
    assert "x, north [m]" in drawn
    assert "y, east [m]" in drawn
    distance = float(drawn.split('class="closestname"')[1].split(">")[1].split(" m")[0])
    box = Polygon(corner_points(case().scenario.obstacles[0]))
    assert distance == pytest.approx(min(box.distance(Point(*place[:2])) for place in track), abs=0.006)


def test_the_second_flight_is_drawn_and_named_beside_the_first() -> None:
    pair = msgspec.structs.replace(template(load_campaign("avoidance-m1")), twin="turned")
    track = np.array([[0.0, 0.0, 10.0], [0.0, 20.0, 10.0]])
    drawn = layout.picture(pair, track, -track)
    assert drawn.count('class="twin"') == 1
    assert "turned by a right angle, shown turned back" in layout.legend(pair)
    assert "twin" not in layout.picture(pair, track) + layout.legend(msgspec.structs.replace(pair, twin=""))


def test_a_picture_without_track_or_boxes_is_still_one() -> None:
    bare = template(load_campaign("avoidance-m1"))
    assert layout.picture(bare, np.empty((0, 3))).startswith("<svg")


def test_charts_keep_peaks_and_survive_what_is_no_number() -> None:
    ys = np.zeros(100_000)
    ys[77_777] = 5.0
    ys[10] = np.nan
    drawn = charts.chart("x", [charts.Curve(np.arange(100_000.0), ys)])
    top = min(float(pair.split(",")[1]) for pair in drawn.split('points="')[1].split('"')[0].split())
    assert top < 40.0, "the one peak is drawn"
    assert "nan" not in drawn
    assert charts.chart("empty", [charts.Curve([], [])]).startswith("<svg")


@pytest.mark.parametrize(("span", "step"), [(70.0, 10.0), (0.3, 0.05), (1234.0, 200.0), (0.0, 1.0)])
def test_axes_are_cut_at_round_numbers(span: float, step: float) -> None:
    assert nice_step(span, 7) == pytest.approx(step)


def placed(svg: str, text: str) -> tuple[float, float]:
    """Return where a text begins, in px."""
    found = re.search(rf'<text x="([0-9.]+)" y="([0-9.]+)"[^>]*>{text}</text>', svg)
    assert found, text
    return float(found[1]), float(found[2])


def test_a_level_is_named_below_the_chart_where_no_curve_runs() -> None:
    ys = np.tile([-3.0, 5.0], 50)
    drawn = charts.chart(
        "t", [charts.Curve(np.arange(100.0), ys)], levels=[charts.Level(0.0, "violated below", "limit")]
    )
    _, foot = placed(drawn, "violated below")
    assert foot > charts.HEIGHT_PX - charts.BOTTOM_PX + charts.NAME_ROW_PX


def test_counts_are_told_in_whole_numbers() -> None:
    drawn = charts.chart("t", [charts.Curve([0.0, 9.0], [0.0, 1.0])], counts=True)
    assert ">0.5<" not in drawn
    assert ">1<" in drawn


def test_many_marks_are_drawn_without_their_names_which_would_hide_the_curve() -> None:
    curve = [charts.Curve([0.0, 99.0], [0.0, 1.0])]
    few, many = ([charts.Mark(float(at), f"input {at}") for at in range(count)] for count in (12, 13))
    assert 'class="tick name"' in charts.chart("t", curve, marks=few)
    drawn = charts.chart("t", curve, marks=many)
    assert 'class="tick name"' not in drawn
    assert drawn.count("<title>input") == 13, "each is told when it is pointed at"


@pytest.mark.parametrize("way", [(0.05, 80.0), (80.0, 0.05), (0.1, 0.1), (300.0, 40.0)])
def test_the_numbers_on_a_map_do_not_overlap(way: tuple[float, float]) -> None:
    bare = msgspec.structs.replace(case(), scenario=Scenario(start=StartState()))
    shares = np.linspace(0.0, 1.0, 50)
    track = np.stack([way[0] * shares, way[1] * shares, np.full_like(shares, 10.0)], axis=1)
    drawn = layout.picture(bare, track)
    ticks = re.findall(r'<text x="([-0-9.]+)" y="([-0-9.]+)" class="tick"[^>]*>(-?[0-9.]+)</text>', drawn)
    assert len(ticks) >= 4
    columns = sorted(float(x) for x, _, _ in ticks if float(x) != 2.0)
    rows = sorted(float(y) for x, y, _ in ticks if float(x) == 2.0)
    assert all(after - before >= 20.0 for before, after in itertools.pairwise(columns))
    assert all(after - before >= 12.0 for before, after in itertools.pairwise(rows))
