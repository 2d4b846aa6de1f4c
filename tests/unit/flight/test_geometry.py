"""Geometry against shapely, and the rules of a layout."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate
from shapely.geometry import Point, Polygon, box

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle
from saflite.flight import geometry

boxes = st.builds(
    Obstacle,
    length_m=st.floats(0.5, 30),
    width_m=st.floats(0.5, 30),
    height_m=st.floats(5, 25),
    x_m=st.floats(-40, 30),
    y_m=st.floats(10, 40),
    rotation_deg=st.floats(-360, 360),
)


def polygon(o: Obstacle) -> Polygon:
    upright = box(o.x_m - o.length_m / 2, o.y_m - o.width_m / 2, o.x_m + o.length_m / 2, o.y_m + o.width_m / 2)
    return rotate(upright, o.rotation_deg, origin=(o.x_m, o.y_m))


def a_box(**changes: float) -> Obstacle:
    return Obstacle(**{"length_m": 10, "width_m": 5, "height_m": 20, "x_m": 0, "y_m": 25, **changes})


@given(boxes)
def test_corners_are_those_of_the_turned_rectangle(o: Obstacle) -> None:
    ours = Polygon(geometry.corners(o))
    assert ours.hausdorff_distance(polygon(o)) < 1e-6
    assert ours.exterior.is_ccw


def test_rotation_is_counter_clockwise_in_the_xy_plane() -> None:
    tip = geometry.corners(a_box(length_m=10, width_m=0.001, rotation_deg=30))[0]
    assert tip == pytest.approx([5 * np.cos(np.pi / 6), 25 + 5 * np.sin(np.pi / 6)], abs=0.01)


@settings(max_examples=300)
@given(boxes, boxes)
def test_overlap_and_gap_agree_with_shapely(a: Obstacle, b: Obstacle) -> None:
    shared = polygon(a).intersection(polygon(b)).area
    if shared > 1e-6:
        assert geometry.overlap(a, b)
    if not polygon(a).intersects(polygon(b)):
        assert not geometry.overlap(a, b)
    assert geometry.gap(a, b) == pytest.approx(polygon(a).distance(polygon(b)), abs=1e-6)
    assert geometry.gap(a, b) == pytest.approx(geometry.gap(b, a), abs=1e-9)


def test_boxes_that_touch_do_not_overlap() -> None:
    assert not geometry.overlap(a_box(x_m=0), a_box(x_m=10))
    assert geometry.overlap(a_box(x_m=0), a_box(x_m=9.99))
    assert geometry.gap(a_box(x_m=0), a_box(x_m=10)) == 0


@given(boxes)
def test_inside_looks_at_the_whole_rotated_box(o: Obstacle) -> None:
    area = geometry.COMPETITION_AREA
    allowed = box(area.x_min_m, area.y_min_m, area.x_max_m, area.y_max_m)
    outside = polygon(o).difference(allowed).area
    if outside > 1e-6:
        assert not geometry.inside(o, area)
    if polygon(o).within(allowed.buffer(-1e-6)):
        assert geometry.inside(o, area)


def test_distance_agrees_with_shapely_and_knows_heights() -> None:
    rng = derive(7, "geometry")
    layout = [
        a_box(x_m=rng.uniform(-30, 20), y_m=rng.uniform(15, 35), rotation_deg=rng.uniform(0, 360), height_m=8)
        for _ in range(3)
    ]
    points = np.column_stack([rng.uniform(-40, 30, 400), rng.uniform(0, 50, 400), np.full(400, 9.5)])
    got = geometry.distance_to_boxes(points, geometry.boxes_array(layout))
    for (x, y, z), distance in zip(points, got, strict=True):
        apart = [polygon(o).distance(Point(x, y)) or z - 8.0 for o in layout]
        assert distance == pytest.approx(min(apart), abs=1e-9)
    assert (got == 1.5).any(), "no point lay above a box: the test says nothing about heights"


def test_distance_inside_a_box_is_zero_and_without_boxes_far() -> None:
    here = np.array([[0.0, 25.0, 10.0]])
    assert geometry.distance_to_boxes(here, geometry.boxes_array([a_box()])) == [0.0]
    assert geometry.distance_to_boxes(here, geometry.boxes_array([])) == [geometry.NO_OBSTACLE_M]


def test_box_rows_have_the_layout_compiled_code_reads() -> None:
    rows = geometry.boxes_array([a_box(z_m=1.0, rotation_deg=90)])
    assert rows.shape == (1, geometry.BOX_COLUMNS)
    assert rows.flags.c_contiguous
    assert rows.dtype == np.float64
    assert rows[0] == pytest.approx([0, 25, 5, 2.5, 0, 1, 1, 21], abs=1e-12)


@pytest.mark.parametrize(
    ("layout", "word"),
    [
        ([a_box(x_m=-30 + 11 * n) for n in range(5)], "at most 4"),
        ([a_box(), a_box(x_m=5)], "1 overlaps 2"),
        ([a_box(x_m=28)], "-40 < x < 30"),
        ([a_box(x_m=25, rotation_deg=0), a_box(x_m=-36, rotation_deg=45, width_m=9)], "obstacle 2"),
        ([a_box(length_m=0)], "above 0"),
        ([a_box(x_m=float("nan"))], "finite"),
        ([a_box(length_m=21)], "length_m"),
        ([a_box(height_m=9)], "height_m"),
    ],
)
def test_layouts_beyond_the_rules_are_refused(layout: list[Obstacle], word: str) -> None:
    with pytest.raises(Refused, match=word):
        geometry.check_layout(layout, sizes=geometry.COMPETITION_SIZES)


def test_a_good_layout_passes() -> None:
    geometry.check_layout([a_box(x_m=10, y_m=20), a_box(x_m=-10, y_m=20)], sizes=geometry.COMPETITION_SIZES)
