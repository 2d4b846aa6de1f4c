"""The pilot's sticks as inputs of a target."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from saflite.contract.target_info import InputInfo


def stick_inputs(
    meanings: Mapping[str, str], low_us: float, high_us: float, centre_us: float, *, no_centre: Collection[str] = ()
) -> Iterator[InputInfo]:
    """Yield a stick per channel, in microseconds of pulse; those of `no_centre` have no place they go back to."""
    for name, meaning in meanings.items():
        default = None if name in no_centre else centre_us
        yield InputInfo(
            kind="stick", name=name, unit="us", low=low_us, high=high_us, type="whole", default=default, meaning=meaning
        )
