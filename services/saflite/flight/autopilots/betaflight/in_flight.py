"""Settings that serial messages change in flight: read as a block, one field replaced, the block set again.

Fields as in the protocol's messages 75/76 (failsafe), 112/202 (gains), 135/225 (GPS rescue). Only what the firmware
reads while it flies; failsafe delays it reads at arming, so they are not here. Messages know no documented ranges.
"""

from __future__ import annotations

from typing import NamedTuple


class Field(NamedTuple):
    """Where a setting stands: messages that read and set its block, offset and size in bytes, little-endian."""

    read: int
    write: int
    offset: int
    size: int

    def fits(self, value: float) -> bool:
        """Whether a value can be said at all."""
        return 0 <= round(value) < 1 << (8 * self.size)

    def changed(self, block: bytes, value: float) -> bytes:
        """Return the block with the field replaced, empty where it does not hold the field."""
        if len(block) < self.offset + self.size:
            return b""
        said = round(value).to_bytes(self.size, "little")
        return block[: self.offset] + said + block[self.offset + self.size :]


_FAILSAFE = {"landing_time": (1, 1), "throttle": (2, 2), "switch_mode": (4, 1), "procedure": (7, 1)}
_RESCUE = {
    "max_angle": (0, 2),
    "return_alt": (2, 2),
    "descent_dist": (4, 2),
    "ground_speed": (6, 2),
    "sanity_checks": (14, 1),
    "ascend_rate": (16, 2),
    "descend_rate": (18, 2),
    "alt_mode": (21, 1),
    "min_start_dist": (22, 2),
}
_AXES, _TERMS = ("roll", "pitch", "yaw"), ("p", "i", "d")

FIELDS: dict[str, Field] = {
    **{f"failsafe_{name}": Field(75, 76, *place) for name, place in _FAILSAFE.items()},
    **{f"gps_rescue_{name}": Field(135, 225, *place) for name, place in _RESCUE.items()},
    **{
        f"{term}_{axis}": Field(112, 202, len(_TERMS) * row + column, 1)
        for row, axis in enumerate(_AXES)
        for column, term in enumerate(_TERMS)
    },
}
