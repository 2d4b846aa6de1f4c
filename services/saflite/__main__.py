"""`python -m saflite` is the `saflite` command."""

from __future__ import annotations

import sys

from saflite.console.cli import main

if __name__ == "__main__":
    sys.exit(main())
