"""The option that releases findings of memory safety into a report or an export; the line that says some are not."""

from __future__ import annotations

import argparse

from saflite.console.view import out


def add_release(parser: argparse.ArgumentParser) -> None:
    """Add the option."""
    words = "show this finding of memory safety, too (fingerprint, the start of one, or all); withheld otherwise"
    parser.add_argument("--release", action="append", default=[], metavar="FINGERPRINT", help=words)


def tell(withheld: int) -> None:
    """Say that findings were withheld, if some were."""
    from saflite.console.run_data.embargo import withheld_words

    if withheld:
        out.line(f"{withheld_words(withheld)}; --release FINGERPRINT shows one, once its maintainers know")
