"""A campaign as TOML text that `saflite run` reads again."""

from __future__ import annotations

from typing import Any

import msgspec
import tomli_w

from saflite.contract.config import Campaign


def dump(campaign: Campaign) -> str:
    """Return the campaign file; what is None or an empty table is left out."""
    return tomli_w.dumps(_told(msgspec.to_builtins(campaign)))


def _told(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table without what TOML cannot say (None) and without empty tables."""
    inner = {key: _told(value) if isinstance(value, dict) else value for key, value in table.items()}
    return {key: value for key, value in inner.items() if value is not None and value != {}}
