"""The picture of a flight from above: area, boxes with their safety shells, mission, path flown, closest point.

Drawn as the competition draws: x to the right, y upwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.console.view.report.svg import Point, label, nice_step, points, tag
from saflite.contract.test_case import TWIN_WORDS, Obstacle, TestCase
from saflite.flight.geometry import COMPETITION_AREA, boxes_array, corner_points, distances_to_boxes
from saflite.flight.mission import places_of

SAFE_M = 1.5
WIDTH_PX, HEIGHT_MAX_PX, MARGIN_M = 560.0, 460.0, 4.0
HEIGHT_BARE_PX = 300.0  # without boxes there is less to see
NARROWEST = 0.5  # width by height
CORNER_PX = 16.0
TRACK_POINTS_MAX = 400


class View(NamedTuple):
    """From metres to pixels."""

    left_m: float
    top_m: float
    scale: float
    width_px: float
    height_px: float

    def at(self, x_m: float, y_m: float) -> Point:
        """Return the pixel of a place."""
        return (x_m - self.left_m) * self.scale, (self.top_m - y_m) * self.scale


NO_TWIN: NDArray[np.float64] = np.empty((0, 3))


def picture(test_case: TestCase, track: NDArray[np.float64], twin: NDArray[np.float64] = NO_TWIN) -> str:
    """Return the picture as an SVG element.

    Args:
        test_case: what was flown.
        track: places flown, shape (n, 3) x, y, z in metres; may be empty.
        twin: those of the second flight it is compared with, turned back, of the same shape.
    """
    boxes = test_case.scenario.obstacles
    mission = test_case.scenario.mission
    places = [(0.0, 0.0), *((p.x_m, p.y_m) for p in places_of(mission))] if mission is not None else [(0.0, 0.0)]
    view = _view(boxes, places, np.concatenate([track, twin]))
    parts = [_grid(view)]
    if boxes:
        parts.append(_area(view))
    parts += [_box(view, number, box) for number, box in enumerate(boxes, start=1)]
    if mission is not None:
        parts.append(tag("polyline", points=points(view.at(*place) for place in places), class_="mission"))
        parts += [_dot(view, place, "waypoint", 3.5) for place in places[1:]]
    parts += _path(view, boxes, track)
    if len(twin) > 1:
        parts.append(_line(view, twin, "twin"))
    parts.append(_dot(view, (0.0, 0.0), "start", 4.5))
    box = f"0 0 {view.width_px:.0f} {view.height_px:.0f}"
    return tag(
        "svg", "".join(parts), viewBox=box, class_="layout", role="img", style=f"max-width:{view.width_px:.0f}px"
    )


def legend(test_case: TestCase) -> str:
    """Return what lines and marks of the picture mean."""
    boxes = bool(test_case.scenario.obstacles)
    rows = [("path", "flown", True), ("twin", _twin_words(test_case), bool(test_case.twin))]
    rows += [("mission", "mission", test_case.scenario.mission is not None)]
    rows += [("danger", f"nearer than {SAFE_M:g} m to a box", boxes)]
    drawn = [(tag("line", x1=1, y1=6, x2=25, y2=6, class_=css), text) for css, text, wanted in rows if wanted]
    drawn += [(tag("circle", cx=13, cy=6, r=4.5, class_="closest"), "closest point")] if boxes else []
    shown = [f"<span>{tag('svg', mark, viewBox='0 0 26 12')} {text}</span>" for mark, text in drawn]
    return f'<div class="legend">{"".join(shown)}</div>'


def _twin_words(test_case: TestCase) -> str:
    back = {"turned": ", shown turned back", "mirrored": ", shown mirrored back"}.get(test_case.twin, "")
    return f"the same flight {TWIN_WORDS[test_case.twin]}{back}" if test_case.twin else ""


def _view(boxes: Sequence[Obstacle], places: Sequence[Point], track: NDArray[np.float64]) -> View:
    corners = [corner for box in boxes for corner in corner_points(box)]
    xs = [x for x, _ in (*places, *corners)] + track[:, 0].tolist()
    ys = [y for _, y in (*places, *corners)] + track[:, 1].tolist()
    if boxes:
        xs += [COMPETITION_AREA.x_min_m, COMPETITION_AREA.x_max_m]
        ys += [COMPETITION_AREA.y_min_m, COMPETITION_AREA.y_max_m]
    left, right, bottom, top = min(xs) - MARGIN_M, max(xs) + MARGIN_M, min(ys) - MARGIN_M, max(ys) + MARGIN_M
    narrow = max(0.0, NARROWEST * (top - bottom) - (right - left))
    left, right = left - narrow / 2, right + narrow / 2
    height_max = HEIGHT_MAX_PX if boxes else HEIGHT_BARE_PX
    scale = min(WIDTH_PX / (right - left), height_max / (top - bottom))
    return View(left, top, scale, (right - left) * scale, (top - bottom) * scale)


def _grid(view: View) -> str:
    step = nice_step(max(view.width_px, view.height_px) / view.scale, 7)
    bottom_m, right_m = view.top_m - view.height_px / view.scale, view.left_m + view.width_px / view.scale
    parts = []
    for number in range(math.ceil(view.left_m / step), math.floor(right_m / step) + 1):
        x, _ = view.at(number * step, 0.0)
        parts.append(tag("line", x1=x, y1=0.0, x2=x, y2=view.height_px, class_="grid"))
        if CORNER_PX <= x <= view.width_px - CORNER_PX:  # in the corner stand those of the other axis
            parts.append(label(x + 2, view.height_px - 3, f"{number * step:g}", "tick"))
    for number in range(math.ceil(bottom_m / step), math.floor(view.top_m / step) + 1):
        _, y = view.at(0.0, number * step)
        parts.append(tag("line", x1=0.0, y1=y, x2=view.width_px, y2=y, class_="grid"))
        if CORNER_PX <= y <= view.height_px - CORNER_PX:
            parts.append(label(2, y - 2, f"{number * step:g}", "tick"))
    parts.append(label(view.width_px - 3, view.height_px - CORNER_PX, "x, north [m]", "tick", "end"))
    parts.append(label(CORNER_PX, 9, "y, east [m]", "tick"))
    return "".join(parts)


def _area(view: View) -> str:
    x, y = view.at(COMPETITION_AREA.x_min_m, COMPETITION_AREA.y_max_m)
    width = (COMPETITION_AREA.x_max_m - COMPETITION_AREA.x_min_m) * view.scale
    height = (COMPETITION_AREA.y_max_m - COMPETITION_AREA.y_min_m) * view.scale
    return tag("rect", x=x, y=y, width=width, height=height, class_="area")


def _box(view: View, number: int, box: Obstacle) -> str:
    outline = points(view.at(*corner) for corner in corner_points(box))
    x, y = view.at(box.x_m, box.y_m)
    shell = tag("polygon", points=outline, class_="shell", stroke_width=2 * SAFE_M * view.scale)
    body = tag("polygon", points=outline, class_="box")
    return shell + body + label(x, y + 4, str(number), "boxname", "middle")


def _dot(view: View, place: Point, css: str, radius: float) -> str:
    x, y = view.at(*place)
    return tag("circle", cx=x, cy=y, r=radius, class_=css)


def _path(view: View, boxes: Sequence[Obstacle], track: NDArray[np.float64]) -> list[str]:
    if len(track) < 2:
        return []
    parts = [_line(view, track, "path")]
    if not boxes:
        return parts
    distances = distances_to_boxes(track, boxes_array(boxes))
    nearest = distances.min(axis=1)
    parts += [_line(view, track[start:end], "danger") for start, end in _stretches(nearest < SAFE_M)]
    at = int(nearest.argmin())
    return [*parts, _closest(view, boxes[int(distances[at].argmin())], track[at], float(nearest[at]))]


def _line(view: View, track: NDArray[np.float64], css: str) -> str:
    shown = track[:: max(1, len(track) // TRACK_POINTS_MAX)]
    return tag("polyline", points=points(view.at(x, y) for x, y, _ in shown.tolist()), class_=css)


def _stretches(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the runs of True as (first, one past the last)."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return [(int(start), int(end)) for start, end in zip(edges[::2], edges[1::2], strict=True)]


def _closest(view: View, box: Obstacle, place: NDArray[np.float64], distance_m: float) -> str:
    x_m, y_m = float(place[0]), float(place[1])
    foot_x, foot_y = _foot(box, x_m, y_m)
    (x, y), (fx, fy) = view.at(x_m, y_m), view.at(foot_x, foot_y)
    parts = [
        tag("line", x1=x, y1=y, x2=fx, y2=fy, class_="gapline"),
        tag("circle", cx=x, cy=y, r=5.5, class_="closest"),
    ]
    side = "end" if x > view.width_px - 90 else "start"
    shift = -9 if side == "end" else 9
    return "".join([*parts, label(x + shift, y - 9, f"{distance_m:.2f} m", "closestname", side)])


def _foot(box: Obstacle, x_m: float, y_m: float) -> Point:
    """Return the point of the box nearest to a place, in the plane."""
    turn = math.radians(box.rotation_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    dx, dy = x_m - box.x_m, y_m - box.y_m
    along = max(-box.length_m / 2, min(box.length_m / 2, dx * cos + dy * sin))
    across = max(-box.width_m / 2, min(box.width_m / 2, dy * cos - dx * sin))
    return box.x_m + along * cos - across * sin, box.y_m + along * sin + across * cos
