"""Text in pages: no markup of others, and nothing that could hide it or let it read in another order."""

from __future__ import annotations

import html

from saflite.contract.plain import plain


def escape(text: str) -> str:
    """Return `text` as it may stand in a page or an attribute."""
    return html.escape(plain(text))
