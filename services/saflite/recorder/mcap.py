"""One flight as an MCAP file with Foxglove's well-known protobuf schemas, and back.

Topics: `/scene` (boxes, safety shells, mission, path flown, closest point), `/tf`, `/path`, `/location`,
`/log`, and the signals as flat JSON records in groups (`/position`, `/attitude`, `/safety`, ...). Attached are the test
case, the flight, its verdicts and the bit-exact trace, so a recording is enough to judge or re-fly the flight.
"""

from __future__ import annotations

import io
import json
from typing import Any, NamedTuple

import msgspec
import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema
from numpy.typing import NDArray

from saflite.contract.flight import Trace, given, unpack_trace
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Verdict, worst
from saflite.contract.work import RecordWork
from saflite.flight.mission import places_of, to_geographic
from saflite.recorder import frames, scalars, scene

RATE_HZ = 10.0
"""At most, of the vehicle's motion; samples that a line between the others comes close to are left out."""
PLOT_RATE_HZ = 5.0
"""At most, of everything else: every sample is in the trace attached."""
CALM = frozenset({"/settings", "/failsafe", "/autopilot", "/sensors"})
"""Topics of what holds still for long."""
STEADY_S, CALM_S = 2.0, 10.0
"""A topic speaks at least this often, a calm one."""
GRID = np.float32(1024)
"""Places drawn are whole parts of this of a metre: numbers that pack well."""
MOTION = ("x_m", "y_m", "altitude_m", "roll_deg", "pitch_deg", "yaw_deg")
_LEVELS = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}
_NS = 1_000_000_000
FLIGHT_MAX_S = 1e8
START_MAX_S = 1.6e10  # MCAP counts nanoseconds since 1970 in 64 bits, which end in 2554; clocks say anything


class _Message(NamedTuple):
    at_ns: int
    topic: str
    content: Any  # a protobuf message, or bytes of JSON


def write(work: RecordWork, packed: bytes, start_unix_s: float) -> bytes:
    """Return the recording of one flight as the bytes of an MCAP file.

    Args:
        work: the flight, its test case and verdicts.
        packed: the packed trace.
        start_unix_s: when the flight began, for the time stamps; viewers refuse stamps near zero.

    Raises:
        Refused: the trace is damaged.
    """
    trace = unpack_trace(packed)
    start_ns = int(min(max(0.0, start_unix_s), START_MAX_S) * _NS)
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile="", library="saflite-farm")
    _attach(writer, work, packed, start_ns)
    messages = _geometry(work, trace, _moving(trace), start_ns) + _texts(work, trace, start_ns)
    channels = _Channels(writer, {topic: scalars.schema(names) for topic, names in scalars.groups(trace).items()})
    messages += _plots(trace, _sampled(trace, PLOT_RATE_HZ), start_ns)
    for number, message in enumerate(sorted(messages, key=lambda entry: entry.at_ns)):
        channels.add(message, number)
    writer.finish()
    return buffer.getvalue()


class _Channels:
    """Registers a schema and a channel the first time a topic is written."""

    def __init__(self, writer: Writer, json_schemas: dict[str, bytes]) -> None:
        self._writer, self._json, self._known = writer, json_schemas, dict[str, int]()

    def add(self, message: _Message, sequence: int) -> None:
        """Write one message."""
        if message.topic not in self._known:
            self._known[message.topic] = self._register(message)
        is_json = isinstance(message.content, bytes)
        data = message.content if is_json else message.content.SerializeToString(deterministic=True)
        self._writer.add_message(self._known[message.topic], message.at_ns, data, message.at_ns, sequence)

    def _register(self, message: _Message) -> int:
        if isinstance(message.content, bytes):
            name = f"saflite{message.topic.replace('/', '.')}"
            schema = self._writer.register_schema(name, "jsonschema", self._json.get(message.topic, b"{}"))
            return int(self._writer.register_channel(message.topic, "json", schema))
        schema = register_schema(self._writer, type(message.content))
        return int(self._writer.register_channel(message.topic, "protobuf", schema))


def _attach(writer: Writer, work: RecordWork, packed: bytes, start_ns: int) -> None:
    parts: dict[str, tuple[str, bytes]] = {
        "test_case.json": ("application/json", msgspec.json.encode(work.test_case)),
        "flight.json": ("application/json", msgspec.json.encode(work.flight)),
        "judgement.json": ("application/json", msgspec.json.encode(work.judgement)),
        "scores.json": ("application/json", msgspec.json.encode(work.scores)),
        "trace.bin": ("application/octet-stream", packed),
    }
    if work.violation is not None:
        parts["violation.json"] = ("application/json", msgspec.json.encode(work.violation))
    if work.policy_texts:
        parts["policies.json"] = ("application/json", msgspec.json.encode(work.policy_texts))
    for name, (media, data) in parts.items():
        writer.add_attachment(start_ns, start_ns, name, media, data)
    verdict = worst(work.judgement)
    writer.add_metadata(
        "saflite",
        {
            "test_case": work.flight.test_case,
            "flight_index": str(work.flight.flight_index),
            "ending": work.flight.ending,
            "trace_digest": work.flight.trace_digest,
            "policy": verdict.policy if verdict else "",
            "robustness": f"{verdict.margin:.6g}" if verdict else "",
            "fingerprint": work.judgement.fingerprint,
            "target": work.test_case.target.name,
        },
    )


def _sampled(trace: Trace, rate_hz: float) -> NDArray[np.intp]:
    """Return the indices of the samples to show, about so many a second, the last one included."""
    stride = max(1, round(1.0 / (rate_hz * trace.step_s)))
    at = np.arange(0, trace.samples, stride, dtype=np.intp)
    last = trace.samples - 1
    return np.append(at, last) if trace.samples and at[-1] != last else at


def _moving(trace: Trace) -> NDArray[np.intp]:
    """Return the indices of the samples that draw the motion; the one closest to an obstacle is among them."""
    at, names = _sampled(trace, RATE_HZ), tuple(name for name in MOTION if name in trace.signals)
    if not names or not len(at):
        return at
    shown = scalars.telling(trace, names, at, round(STEADY_S * RATE_HZ))
    return np.union1d(shown, [_nearest(trace)]) if "obstacle_distance_m" in trace.signals else shown


def _nearest(trace: Trace) -> int:
    """Return the index of the sample closest to an obstacle."""
    return int(np.nan_to_num(trace.array("obstacle_distance_m"), nan=np.inf).argmin())


def _later(start_ns: int, by_s: float) -> int:
    """Return a moment of the flight; what no flight can last is cut off, for a log or a trace may say anything."""
    return start_ns + round(min(max(0.0, by_s), FLIGHT_MAX_S) * _NS)


def _stamp(at_ns: int) -> Timestamp:
    return Timestamp(seconds=at_ns // _NS, nanos=at_ns % _NS)


def _track(trace: Trace, at: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return the places flown, shape (n, 3) north, east, up; empty if the trace has no position."""
    names = ("x_m", "y_m", "altitude_m")
    if any(name not in trace.signals for name in names):
        return np.empty((0, 3), dtype=np.float32)
    places = np.stack([trace.array(name)[at] for name in names], axis=1)
    return np.asarray(np.round(places * GRID) / GRID, dtype=np.float32)


def _geometry(work: RecordWork, trace: Trace, at: NDArray[np.intp], start_ns: int) -> list[_Message]:
    track = _track(trace, at)
    stamp = _stamp(start_ns)
    entities = scene.obstacles(work.test_case.scenario.obstacles) + scene.mission(_mission(work.test_case))
    distance = trace.array("obstacle_distance_m")[at] if "obstacle_distance_m" in trace.signals else None
    entities += scene.path(track, distance)
    if distance is not None and len(track) and work.test_case.scenario.obstacles:
        nearest = int(np.searchsorted(at, _nearest(trace)))
        text = f"{distance[nearest]:.2f} m at {at[nearest] * trace.step_s:.1f} s"
        x_m, y_m, z_m = track[nearest].tolist()
        entities.append(scene.closest((x_m, y_m, z_m), text))
    update = scene.scene(stamp, entities)
    update.entities.append(scene.vehicle(stamp))
    messages = [_Message(start_ns, "/scene", update)]
    if len(track):
        path = PosesInFrame(
            timestamp=stamp, frame_id=frames.MAP, poses=[frames.pose(x, y, z) for x, y, z in track.tolist()]
        )
        messages.append(_Message(start_ns, "/path", path))
        messages += _motion(work.test_case, trace, at, track, start_ns)
    return messages


def _mission(test_case: TestCase) -> list[scene.Place]:
    mission = test_case.scenario.mission
    return [(0.0, 0.0, 0.0), *((p.x_m, p.y_m, p.z_m) for p in places_of(mission))] if mission is not None else []


def _motion(
    test_case: TestCase, trace: Trace, at: NDArray[np.intp], track: NDArray[np.float32], start_ns: int
) -> list[_Message]:
    zeros = np.zeros(len(at), dtype=np.float32)
    names = ("roll_deg", "pitch_deg", "yaw_deg")
    angles = np.stack([trace.array(name)[at] if name in trace.signals else zeros for name in names], axis=1)
    mission = test_case.scenario.mission
    messages, next_s = list[_Message](), 0.0
    for index, (x_m, y_m, z_m), (roll, pitch, yaw) in zip(at.tolist(), track.tolist(), angles.tolist(), strict=True):
        at_ns = _later(start_ns, index * trace.step_s)
        stamp, rotation = _stamp(at_ns), frames.attitude(roll, pitch, yaw)
        shift = Vector3(x=y_m, y=x_m, z=z_m)
        step = FrameTransform(
            timestamp=stamp,
            parent_frame_id=frames.MAP,
            child_frame_id=frames.VEHICLE,
            translation=shift,
            rotation=rotation,
        )
        messages.append(_Message(at_ns, "/tf", FrameTransforms(transforms=[step])))
        if mission is not None and index * trace.step_s >= next_s:
            next_s += STEADY_S
            lat, lon = to_geographic(x_m, y_m, mission.home_lat_deg, mission.home_lon_deg)
            height = mission.home_alt_m + z_m
            fix = LocationFix(timestamp=stamp, frame_id=frames.MAP, latitude=lat, longitude=lon, altitude=height)
            messages.append(_Message(at_ns, "/location", fix))
    return messages


def _texts(work: RecordWork, trace: Trace, start_ns: int) -> list[_Message]:
    end_ns = _later(start_ns, trace.duration_s)
    messages = [
        _log(_later(start_ns, message.at_s), _LEVELS[message.severity], "autopilot", message.text)
        for message in trace.messages
    ]
    for one in given(work.test_case.stimuli, work.flight.delivered):
        values = " ".join(f"{value:g}" for value in one.stimulus.values)
        text = f"{one.stimulus.kind} {one.stimulus.name} {values}".rstrip()
        if one.answer not in ("accepted", "unanswered"):
            text += f" ({': '.join(filter(None, (one.answer.replace('_', ' '), one.message)))})"
        messages.append(_log(_later(start_ns, one.stimulus.at_s), Log.INFO, "stimulus", text))
    for verdict in work.judgement.verdicts:
        messages += _verdict(verdict, start_ns)
    messages.append(_log(end_ns, Log.INFO, "flight", f"{work.flight.ending} {work.flight.message}".strip()))
    return messages


def _verdict(verdict: Verdict, start_ns: int) -> list[_Message]:
    at_ns = _later(start_ns, verdict.witness_from_s)
    level = Log.ERROR if verdict.outcome == "violated" else Log.INFO
    ruling = f"{verdict.policy} {verdict.outcome}"
    record: dict[str, object] = {"policy": verdict.policy, "outcome": verdict.outcome}
    if verdict.robustness is None:
        text, record["nearness"] = f"{ruling}: {verdict.message}", verdict.nearness
    else:
        text = f"{ruling}, robustness {verdict.robustness:.3g}. {verdict.message}".strip()
        record |= {"witness_to_s": verdict.witness_to_s, "robustness": verdict.robustness}
    return [_log(at_ns, level, "oracle", text), _Message(at_ns, "/verdict", json.dumps(record).encode())]


def _log(at_ns: int, level: Log.Level.ValueType, name: str, text: str) -> _Message:
    return _Message(at_ns, "/log", Log(timestamp=_stamp(at_ns), level=level, name=name, message=text))


def _plots(trace: Trace, at: NDArray[np.intp], start_ns: int) -> list[_Message]:
    messages = []
    for topic, names in scalars.groups(trace).items():
        steady_s = CALM_S if topic in CALM else STEADY_S
        shown = scalars.telling(trace, names, at, round(steady_s * PLOT_RATE_HZ))
        for index, record in zip(shown.tolist(), scalars.records(trace, names, shown), strict=True):
            messages.append(_Message(_later(start_ns, index * trace.step_s), topic, record))
    return messages
