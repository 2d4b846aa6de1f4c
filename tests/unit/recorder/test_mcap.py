"""A recording holds the flight bit for bit, in schemas others read, and damage is noticed."""

from __future__ import annotations

import io
import json
import math
import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from saflite.contract.blobs import BlobMissing, ref_of
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, Trace, TraceMessage, pack_trace, trace_digest, unpack_trace
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Scenario, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import NEVER_APPLIED, Judgement, Verdict
from saflite.contract.work import RecordResult, RecordWork
from saflite.evidence.memory import MemoryBlobs
from saflite.flight.mission import builtin_mission, mission_names
from saflite.recorder import frames, mcap, recording, scalars
from saflite.recorder.work import open_service

START_UNIX_S = 1_790_000_000.25


class FixedClock:
    def monotonic_s(self) -> float:
        return 0.0

    def unix_s(self) -> float:
        return START_UNIX_S


def signal(values: np.ndarray) -> bytes:
    return values.astype("<f4").tobytes()


def record_work(seconds: float = 10.0) -> tuple[RecordWork, bytes]:
    """A flight to be recorded and its packed trace."""
    times = np.arange(0.0, seconds, 0.02)
    trace = Trace(
        step_s=0.02,
        signals={
            "x_m": signal(times * 0.0),
            "y_m": signal(times * 2.0),
            "altitude_m": signal(np.full_like(times, 10.0)),
            "roll_deg": signal(5.0 * np.sin(times)),
            "pitch_deg": signal(0.0 * times),
            "yaw_deg": signal(np.full_like(times, 90.0)),
            "obstacle_distance_m": signal(np.abs(times - 5.0) + 0.5),
            "odd_m": signal(np.where(times < 1.0, np.nan, 1.0)),
        },
        messages=(TraceMessage(at_s=1.0, text="taking off"),),
    )
    mission = builtin_mission(mission_names()[0])
    box = Obstacle(length_m=10.0, width_m=4.0, height_m=20.0, x_m=5.0, y_m=20.0, rotation_deg=30.0)
    case = TestCase(
        target=Target(),
        scenario=Scenario(mission=mission, obstacles=(box,)),
        stimuli=(Stimulus(at_s=2.0, kind="mode", name="RTL"),),
    )
    flight = Flight(
        test_case=identity(case),
        flight_index=0,
        ending="completed",
        simulated_s=seconds,
        trace_digest=trace_digest(trace),
        trace=ref_of(pack_trace(trace)),
    )
    verdict = Verdict(policy="min-obstacle-distance", outcome="violated", robustness=-1.0, witness_from_s=5.0)
    judgement = Judgement(test_case=flight.test_case, flight_index=0, verdicts=(verdict,), fingerprint=16 * "a")
    return RecordWork(test_case=case, flight=flight, judgement=judgement), pack_trace(trace)


@pytest.fixture(scope="module")
def made() -> tuple[RecordWork, bytes]:
    return record_work()


@pytest.fixture(scope="module")
def work(made: tuple[RecordWork, bytes]) -> RecordWork:
    return made[0]


@pytest.fixture(scope="module")
def data(made: tuple[RecordWork, bytes]) -> bytes:
    return mcap.write(*made, START_UNIX_S)


def test_what_is_recorded_is_read_back_bit_for_bit(work: RecordWork, data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(data)
    back = recording.read(path)
    assert back.test_case == work.test_case
    assert back.flight == work.flight
    assert trace_digest(back.trace) == work.flight.trace_digest
    assert recording.verify(path) == sum(1 for _ in make_reader(io.BytesIO(data)).iter_messages()) > 30


def test_an_independent_decoder_reads_the_well_known_schemas(data: bytes) -> None:
    reader = make_reader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    kinds: dict[str, str] = {}
    stamps = []
    for schema, channel, message in reader.iter_messages():
        kinds[channel.topic] = schema.name
        stamps.append(message.log_time)
    assert kinds["/scene"] == "foxglove.SceneUpdate"
    assert kinds["/tf"] == "foxglove.FrameTransforms"
    assert kinds["/path"] == "foxglove.PosesInFrame"
    assert kinds["/log"] == "foxglove.Log"
    assert {"/position", "/attitude", "/safety", "/verdict"} <= set(kinds)
    assert min(stamps) == int(START_UNIX_S * 1e9)


def test_a_viewer_finds_a_moment_by_its_indexes(data: bytes) -> None:
    reader = make_reader(io.BytesIO(data))
    summary = reader.get_summary()
    assert summary is not None
    assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)  # Foxglove shows nothing without them
    begin, end = (int((START_UNIX_S + at_s) * 1e9) for at_s in (4, 6))
    between = [message.log_time for *_, message in reader.iter_messages(["/tf"], starting_at=begin, ending_before=end)]
    every = [message.log_time for *_, message in reader.iter_messages(["/tf"])]
    assert between == [at for at in every if begin <= at < end]
    assert len(between) >= 2


def test_a_line_between_records_is_close_to_every_sample_left_out() -> None:
    rng = derive(1, "line")
    jump = np.where(np.arange(2000) < 700, 0.0, 30.0)
    height = np.cumsum(rng.normal(0.0, 0.02, 2000)) + jump
    trace = Trace(step_s=0.05, signals={"altitude_m": signal(height), "mode": signal(jump // 10)})
    at = np.arange(0, 2000, 4)
    kept = scalars.telling(trace, ("altitude_m", "mode"), at, steady=20)
    assert len(kept) < len(at) / 2
    for name, tolerance in (("altitude_m", scalars.TOLERANCE["m"]), ("mode", 1e-3)):
        between = np.interp(at, kept, trace.array(name)[kept])
        assert np.abs(between - trace.array(name)[at]).max() <= tolerance + 1e-3  # records are rounded
    assert np.diff(kept).max() <= 20 * 4


def test_boxes_and_vehicle_stand_where_the_test_case_says(data: bytes) -> None:
    reader = make_reader(io.BytesIO(data), decoder_factories=[DecoderFactory()])
    scene = next(message for *_, message in reader.iter_decoded_messages(topics=["/scene"]))
    cube = next(entity for entity in scene.entities if entity.id == "obstacle-1").cubes[0]
    assert (cube.pose.position.x, cube.pose.position.y, cube.pose.position.z) == (20.0, 5.0, 10.0)
    turn = 2 * math.atan2(cube.pose.orientation.z, cube.pose.orientation.w)
    assert math.degrees(turn) == pytest.approx(60.0)  # 30 degrees from north to east is 60 from east to north
    *_, last = [message.transforms[0] for *_, message in reader.iter_decoded_messages(topics=["/tf"])]
    assert last.translation.x == pytest.approx(2.0 * 9.98, abs=1e-3)
    assert last.rotation.w == pytest.approx(math.cos(math.radians(last_roll()) / 2), abs=1e-4)


def last_roll() -> float:
    return 5.0 * math.sin(9.98)


def test_scalars_are_flat_json_without_nan(data: bytes) -> None:
    reader = make_reader(io.BytesIO(data))
    rows = [json.loads(message.data) for *_, message in reader.iter_messages(topics=["/sensors"])]
    assert "odd_m" not in rows[0]
    assert rows[-1]["odd_m"] == 1.0
    assert all(isinstance(value, int | float) for row in rows for value in row.values())


def test_what_holds_still_is_thinned_without_losing_a_change() -> None:
    rng = derive(1, "calm")
    held = np.repeat(rng.integers(0, 3, 12), rng.integers(1, 60, 12)).astype("<f4")
    held[5:9] = np.nan
    trace = Trace(
        step_s=0.05, signals={"failsafe_gps": held.tobytes(), "failsafe_radio": np.zeros_like(held).tobytes()}
    )
    at = np.arange(len(held))
    names = ("failsafe_gps", "failsafe_radio")
    kept = scalars.telling(trace, names, at, steady=20)
    last_kept = np.searchsorted(kept, at, side="right") - 1
    assert np.array_equal(held[kept][last_kept], held, equal_nan=True)  # held until the next record, nothing is lost
    assert len(kept) < len(held) / 4
    assert np.diff(kept).max() <= 20
    rows = list(scalars.records(trace, names, kept))
    assert [json.loads(row).get("failsafe_gps") for row in rows] == [
        None if np.isnan(value) else value for value in held[kept]
    ]


def test_pitch_up_turns_the_nose_up() -> None:
    rotation = frames.attitude(0.0, 90.0, 90.0)  # heading east, nose straight up: forward points along map z
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    forward = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    assert forward == pytest.approx((0.0, 0.0, 1.0), abs=1e-4)


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.7, 0.999])
def test_a_truncated_recording_is_refused_by_name(data: bytes, tmp_path: Path, keep: float) -> None:
    path = tmp_path / "short.mcap"
    path.write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(Refused, match=r"short\.mcap.*truncated or damaged"):
        recording.read(path)


def test_flipped_bytes_are_noticed(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flipped.mcap"
    for place in range(100, len(data), max(1, len(data) // 25)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        with pytest.raises(Refused):
            recording.verify(path)
        with pytest.raises(Refused):
            recording.read(path)


def test_a_rule_that_never_applied_is_recorded_without_a_number(made: tuple[RecordWork, bytes]) -> None:
    work, packed = made
    verdict = Verdict(policy="a-chute", outcome="vacuous", nearness=0.5, message=NEVER_APPLIED)
    judgement = msgspec.structs.replace(work.judgement, verdicts=(verdict,), fingerprint="")
    data = mcap.write(msgspec.structs.replace(work, judgement=judgement), packed, START_UNIX_S)
    reader = make_reader(io.BytesIO(data), decoder_factories=[DecoderFactory()])
    told = [line.message for *_, line in reader.iter_decoded_messages(["/log"]) if line.name == "oracle"]
    assert told == ["a-chute vacuous: the rule never applied"]
    records = [json.loads(message.data) for _, _, message in make_reader(io.BytesIO(data)).iter_messages(["/verdict"])]
    assert records == [{"policy": "a-chute", "outcome": "vacuous", "nearness": 0.5}]
    (metadata,) = list(make_reader(io.BytesIO(data)).iter_metadata())
    assert (metadata.metadata["policy"], metadata.metadata["robustness"]) == ("", "")


def test_a_recorder_leaves_a_blob(made: tuple[RecordWork, bytes], data: bytes) -> None:
    work, packed = made
    blobs = MemoryBlobs()
    recorder = open_service(blobs, FixedClock())
    with pytest.raises(BlobMissing):
        recorder.do(work, lambda: False)
    assert blobs.put(packed) == work.flight.trace
    result = recorder.do(work, lambda: False)
    assert isinstance(result, RecordResult)
    assert (result.test_case, result.flight_index) == (work.flight.test_case, 0)
    assert len(blobs.get(result.blob)) == pytest.approx(len(data), abs=64)
    without = msgspec.structs.replace(work.flight, trace=None)
    with pytest.raises(Refused, match="trace"):
        recorder.do(msgspec.structs.replace(work, flight=without), lambda: False)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_attitudes_and_places_that_are_no_numbers_are_recorded(value: float) -> None:
    work, packed = record_work(1.0)
    trace = unpack_trace(packed)
    odd = {name: signal(np.full(trace.samples, value)) for name in ("roll_deg", "yaw_deg", "x_m")}
    content = mcap.write(
        work, pack_trace(msgspec.structs.replace(trace, signals={**trace.signals, **odd})), START_UNIX_S
    )
    assert recording_samples(content) == trace.samples


def recording_samples(content: bytes) -> int:
    parts = {one.name: one.data for one in make_reader(io.BytesIO(content)).iter_attachments()}
    return unpack_trace(parts["trace.bin"]).samples


def test_a_flight_said_to_have_lasted_for_ages_begins_at_the_beginning_of_time() -> None:
    work, packed = record_work(1.0)
    blobs = MemoryBlobs()
    flight = msgspec.structs.replace(work.flight, simulated_s=1e12, trace=blobs.put(packed))
    result = open_service(blobs, FixedClock()).do(msgspec.structs.replace(work, flight=flight), lambda: False)
    assert isinstance(result, RecordResult)


@pytest.mark.parametrize("start_unix_s", [-60.0, 1e11, math.inf])
def test_a_clock_that_is_far_off_does_not_cost_the_recording(start_unix_s: float) -> None:
    assert recording_samples(mcap.write(*record_work(1.0), start_unix_s)) == 50


def test_a_recording_that_lists_one_attachment_again_and_again_is_refused(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer, enable_data_crcs=True)
    writer.start()
    writer.add_attachment(0, 0, "trace.bin", "x", b"\0" * 1_000_000)
    listed = next(held for held in vars(writer).values() if isinstance(held, list) and held)
    listed.extend(listed * 10_000)
    writer.finish()
    (tmp_path / "a.mcap").write_bytes(buffer.getvalue())
    with pytest.raises(Refused, match="10001 attachments"):
        recording.read(tmp_path / "a.mcap")


def test_a_recording_whose_attachments_lie_within_each_other_is_refused(tmp_path: Path) -> None:
    """Twenty MB of them, each all of the one around it but its head, took a gigabyte."""
    data, sizes = bytes(100_000), list[int]()
    for _ in range(recording.ATTACHMENTS_MAX):
        content = struct.pack("<QQI1sI1sQ", 0, 0, 1, b"a", 1, b"x", len(data)) + data + bytes(4)
        data = struct.pack("<BQ", 0x09, len(content)) + content
        sizes.append(len(data))
    before = len(data) - sizes[0] - 4 * (len(sizes) - 1)  # each begins behind the heads of those around it
    heads = before // (len(sizes) - 1)
    starts = [(heads * number, size) for number, size in enumerate(reversed(sizes))]
    head = b"\x89MCAP0\r\n" + struct.pack("<BQII", 0x01, 8, 0, 0)
    index = b"".join(
        struct.pack("<BQQQQQQI1sI1s", 0x0A, 50, len(head) + place, size, 0, 0, 0, 1, b"a", 1, b"x")
        for place, size in starts
    )
    body = head + data + struct.pack("<BQI", 0x0F, 4, 0)
    footer = struct.pack("<BQQQI", 0x02, 20, len(body), 0, 0)
    (tmp_path / "a.mcap").write_bytes(body + index + footer + b"\x89MCAP0\r\n")
    with pytest.raises(Refused, match=r"attachments of more than its \d+ bytes"):
        recording.read(tmp_path / "a.mcap")


def packed_zeros(blocks: int) -> bytes:
    """A chunk of so many times 128 KiB of zeros: four bytes each, by zstd's own description of its frames."""
    ends = [(index == blocks - 1) | 1 << 1 | 2**17 << 3 for index in range(blocks)]
    frame = struct.pack("<IBBQ", 0xFD2FB528, 0b11 << 6, 7 << 3, blocks * 2**17)
    frame += b"".join(end.to_bytes(3, "little") + b"\0" for end in ends)
    content = struct.pack("<QQQII4sQ", 0, 0, blocks * 2**17, 0, 4, b"zstd", len(frame)) + frame
    return struct.pack("<BQ", 0x06, len(content)) + content


@pytest.mark.parametrize("place", ["summary", "data"])
def test_no_chunk_is_unpacked_for_what_is_attached(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """80 KB took 2.5 GB where a chunk stood in the summary, or where that said an attachment was."""
    monkeypatch.setattr("zstandard.decompress", lambda *_: pytest.fail("it was unpacked"))
    head = b"\x89MCAP0\r\n" + struct.pack("<BQII", 0x01, 8, 0, 0)
    index = struct.pack("<BQQQQQQI1sI1s", 0x0A, 50, len(head), 9, 0, 0, 0, 1, b"a", 1, b"x")
    body = head + (packed_zeros(4) if place == "data" else b"") + struct.pack("<BQI", 0x0F, 4, 0)
    summary = index if place == "data" else packed_zeros(4)
    footer = struct.pack("<BQQQI", 0x02, 20, len(body), 0, 0)
    (tmp_path / "a.mcap").write_bytes(body + summary + footer + b"\x89MCAP0\r\n")
    expected = rf"no attachment at byte {len(head)}" if place == "data" else r"attachment test_case\.json, got none"
    with pytest.raises(Refused, match=expected):
        recording.read(tmp_path / "a.mcap")


def test_a_summary_longer_than_any_is_refused(tmp_path: Path) -> None:
    """Each of its records is kept by the library, at ten times its bytes; so are the entries of one."""
    body = b"\x89MCAP0\r\n" + struct.pack("<BQIIBQI", 0x01, 8, 0, 0, 0x0F, 4, 0)
    record = struct.pack("<BQQQQQQI1sI1s", 0x0A, 50, 0, 9, 0, 0, 0, 1, b"a", 1, b"x")
    summary = record * (recording.SUMMARY_BYTES_MAX // len(record) + 1)
    footer = struct.pack("<BQQQI", 0x02, 20, len(body), 0, 0)
    (tmp_path / "a.mcap").write_bytes(body + summary + footer + b"\x89MCAP0\r\n")
    with pytest.raises(Refused, match=r"a summary of \d+ bytes, not at most 4194304"):
        recording.read(tmp_path / "a.mcap")


@pytest.mark.parametrize("start_unix_s", [START_UNIX_S, 1e300])
def test_a_trace_longer_than_any_flight_is_recorded_with_its_end_cut_off(start_unix_s: float) -> None:
    """A few packed KiB unfold to more seconds than nanoseconds in 64 bits can count."""
    work, _ = record_work()
    trace = Trace(step_s=3600.0, signals={"obstacle_distance_m": signal(np.full(800_000, -1.0))})
    packed = pack_trace(trace)
    assert len(packed) < 20_000
    flight = msgspec.structs.replace(work.flight, trace=ref_of(packed), trace_digest=trace_digest(trace))
    written = mcap.write(msgspec.structs.replace(work, flight=flight), packed, start_unix_s)
    start_s = min(start_unix_s, mcap.START_MAX_S)
    summary = make_reader(io.BytesIO(written)).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_start_time / 1e9 >= start_s - 1.0
    assert summary.statistics.message_end_time / 1e9 <= start_s + mcap.FLIGHT_MAX_S + 1.0
