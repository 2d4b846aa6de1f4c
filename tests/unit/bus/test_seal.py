"""Damage shows: no flipped bit, cut or swapped message passes for whole."""

from __future__ import annotations

from saflite.bus.base import seal, unseal
from saflite.contract.rng import derive


def test_a_whole_message_names_its_sender() -> None:
    assert unseal("k", seal("k", "fly-1", b"payload"), b"payload") == ("fly-1", "")


def test_every_single_flipped_bit_shows() -> None:
    payload = bytes(derive(1, "seal").integers(0, 256, 300, dtype="uint8"))
    attachment = seal("k", "fly-1", payload)
    for bit in range(8 * len(payload)):
        damaged = bytearray(payload)
        damaged[bit // 8] ^= 1 << bit % 8
        assert unseal("k", attachment, bytes(damaged))[1]
    for bit in range(8 * len(attachment)):
        damaged = bytearray(attachment)
        damaged[bit // 8] ^= 1 << bit % 8
        assert unseal("k", bytes(damaged), payload)[1]


def test_cuts_other_keys_and_missing_seals_show() -> None:
    payload = b"payload" * 9
    attachment = seal("k", "fly-1", payload)
    assert all(unseal("k", attachment, payload[:length])[1] for length in range(len(payload)))
    assert all(unseal("k", attachment[:length], payload)[1] for length in range(len(attachment)))
    assert unseal("other", attachment, payload)[1]
    assert unseal("k", None, payload)[1]
