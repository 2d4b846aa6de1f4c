"""Tracks come back from the journal bit by bit, packed where they are told as usual, as they are where they are not."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saflite.campaign.engine.journal import Granted, Line, Settled, decode_line, encode_line
from saflite.campaign.engine.track_packing import WHOLE_MAX, Track, pack_track, unpack_track
from saflite.campaign.scheduling.work_keys import JudgeKey, MutateKey
from saflite.contract.verdict import Judgement
from saflite.contract.work import JudgeResult

USUAL = st.builds(
    lambda t, x, y, z: (t / 1000.0, x / 100.0, y / 100.0, z / 100.0),
    st.integers(0, 10**7),
    *[st.integers(-(10**7), 10**7)] * 3,
)
ANY = st.tuples(*[st.floats(-1e300, 1e300)] * 4)


def line_of(track: Track) -> Line:
    judgement = Judgement(test_case="0" * 16, flight_index=0, verdicts=(), track=track)
    return Line(
        1.5, Settled(key=JudgeKey("0" * 16, "search", 0), epoch=1, worker="w", result=JudgeResult(judgement=judgement))
    )


@given(st.lists(USUAL, max_size=50).map(tuple))
@settings(max_examples=50, deadline=None)
def test_a_usual_track_is_packed_and_comes_back(track: Track) -> None:
    packed = pack_track(track)
    assert bool(packed) == bool(track)
    if track:
        assert unpack_track(packed) == track


@given(st.lists(USUAL | ANY, max_size=6).map(tuple))
@settings(max_examples=100, deadline=None)
def test_a_line_comes_back_bit_by_bit_whatever_its_track(track: Track) -> None:
    line = line_of(track)
    again = decode_line(encode_line(line))
    assert repr(again) == repr(line)  # tells 0.0 from -0.0
    assert encode_line(again) == encode_line(line)


@pytest.mark.parametrize("odd", [0.001, -0.0, WHOLE_MAX, 1e300, 1e-320])
def test_what_steps_of_a_centimetre_do_not_hold_stays_as_it_is(odd: float) -> None:
    assert pack_track(((0.0, odd, 1.0, 2.0),)) == b""


def test_a_track_takes_a_quarter_of_its_numbers() -> None:
    track = tuple((float(t), 1.37 * t % 40.0, -0.91 * t % 30.0, 10.0) for t in range(100))
    usual = tuple((t, round(x, 2), round(y, 2), z) for t, x, y, z in track)
    assert len(pack_track(usual)) < 100 * 4 * 9 / 4


@pytest.mark.parametrize("data", [b"h\0\0\0", b"x" * 9, b"i" + b"\0" * 17])
def test_bytes_that_are_no_track_are_told(data: bytes) -> None:
    with pytest.raises(ValueError):
        unpack_track(data)
    stored = msgspec.msgpack.encode([1.5, msgspec.to_builtins(line_of(()).entry), data])
    with pytest.raises(msgspec.DecodeError, match="track"):
        decode_line(stored)


def test_a_track_beside_what_is_no_judgement_is_told() -> None:
    granted = Granted(key=MutateKey(0), epoch=1, worker="w")
    with pytest.raises(msgspec.DecodeError, match="track"):
        decode_line(msgspec.msgpack.encode([1.5, granted, pack_track(((0.0, 1.0, 2.0, 3.0),))]))
