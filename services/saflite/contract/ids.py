"""Identity is the hash of content, so doing a thing twice is harmless."""

from __future__ import annotations

import hashlib

ID_LENGTH = 16


def digest(content: bytes) -> str:
    """Return the full SHA-256 of `content` in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def short_id(content: bytes) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of `content` (64 bits)."""
    return digest(content)[:ID_LENGTH]
