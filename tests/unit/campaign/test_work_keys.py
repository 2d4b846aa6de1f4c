"""Keys of work: as text for people and leases, and read back by one strict reader."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saflite.campaign.scheduling.work_keys import (
    FlyKey,
    JudgeKey,
    MutateKey,
    RecordKey,
    ScoreKey,
    WarmKey,
    WorkKey,
    read_key,
)

NAMES = st.text("0123456789abcdef", min_size=1, max_size=16)
PURPOSES = st.sampled_from(["search", "confirm", "shrink", "shrunk", "replay"])
COUNTS = st.integers(0, 10**6)
KEYS = st.one_of(
    st.builds(MutateKey, COUNTS),
    st.builds(ScoreKey, COUNTS, COUNTS),
    st.builds(WarmKey, COUNTS, st.text(max_size=30)),
    *(st.builds(kind, NAMES, PURPOSES, COUNTS) for kind in (FlyKey, JudgeKey, RecordKey)),
)


@given(KEYS)
def test_every_key_is_read_back_from_its_text(key: WorkKey) -> None:
    assert read_key(str(key)) == key


@given(KEYS, KEYS)
def test_two_keys_never_share_a_text(one: WorkKey, other: WorkKey) -> None:
    assert (str(one) == str(other)) == (one == other)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "fly",
        "fly/a/search",
        "fly/a/search/x",
        "fly/a/hunt/0",
        "fly/a/search/0/1",
        "mutate/01",
        "mutate/+1",
        "mutate/1 ",
        "eat/1",
        "score/1",
        "mutate/1/2",
        "fly/a/search/1.0",
    ],
)
def test_anything_else_is_no_key(text: str) -> None:
    assert read_key(text) is None


def test_models_with_slashes_keep_them() -> None:
    assert read_key("warm/3/hf.co/some/model:q4") == WarmKey(3, "hf.co/some/model:q4")


def test_the_judging_of_a_flight_names_the_flight() -> None:
    key = FlyKey("abc", "shrink", 2)
    assert (str(key), str(key.judging), key.judging.flying) == ("fly/abc/shrink/2", "judge/abc/shrink/2", key)
