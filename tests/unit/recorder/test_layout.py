"""The layout that ships for Foxglove names what a recording of a flight holds, topic by topic and field by field."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.contract.blobs import ref_of
from saflite.contract.flight import Flight, pack_trace, trace_digest
from saflite.contract.test_case import Obstacle, identity
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import RecordWork
from saflite.flight.autopilots.reference.flight import ReferenceFlight
from saflite.recorder import mcap

LAYOUT = Path(__file__).parents[3] / "deploy" / "foxglove-layout.json"
START_UNIX_S = 1_790_000_000.0


@pytest.fixture(scope="module")
def recorded() -> bytes:
    """The first half minute of a mission past a box."""
    base = template(load_campaign("avoidance-m2"))
    box = Obstacle(length_m=6.0, width_m=4.0, height_m=20.0, x_m=1.0, y_m=15.0, rotation_deg=20.0)
    scenario = msgspec.structs.replace(base.scenario, obstacles=(box,), time_limit_s=30.0)
    case = msgspec.structs.replace(base, scenario=scenario)
    record = ReferenceFlight(case).run(lambda: False)
    assert record.trace is not None
    packed = pack_trace(record.trace)
    flight = Flight(
        test_case=identity(case),
        flight_index=0,
        ending=record.ending,
        simulated_s=30.0,
        trace_digest=trace_digest(record.trace),
        trace=ref_of(packed),
    )
    verdict = Verdict(policy="min-obstacle-distance", outcome="violated", robustness=-1.0, witness_from_s=5.0)
    judgement = Judgement(test_case=flight.test_case, flight_index=0, verdicts=(verdict,), fingerprint=16 * "a")
    return mcap.write(RecordWork(test_case=case, flight=flight, judgement=judgement), packed, START_UNIX_S)


def texts(part: Any) -> list[str]:
    """All texts of the layout, keys too."""
    if isinstance(part, dict):
        return [*part, *(text for value in part.values() for text in texts(value))]
    if isinstance(part, list):
        return [text for value in part for text in texts(value)]
    return [part] if isinstance(part, str) else []


def test_every_topic_and_field_of_the_layout_is_in_a_recording(recorded: bytes) -> None:
    held: dict[str, set[str]] = {}
    frames = set()
    for schema, channel, message in make_reader(io.BytesIO(recorded), validate_crcs=True).iter_messages():
        fields = held.setdefault(channel.topic, set())
        if channel.message_encoding == "json":
            fields |= set(json.loads(message.data))
        elif channel.topic == "/tf":
            decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
            assert decode is not None
            frames |= {one.child_frame_id for one in decode(message.data).transforms}
    layout = texts(json.loads(LAYOUT.read_text(encoding="utf-8")))
    paths = [re.fullmatch(r"(/\w+)(?:\.(\w+))?", text) for text in layout]
    named = [(path[1], path[2]) for path in paths if path]
    assert len(named) >= 10
    assert {topic for topic, _ in named} <= set(held)
    assert [f"{topic}.{field}" for topic, field in named if field and field not in held[topic]] == []
    shown = [text.removeprefix("frame:") for text in layout if text.startswith("frame:")]
    assert shown
    assert set(shown) <= frames
