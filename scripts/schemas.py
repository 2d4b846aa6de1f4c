"""Write `schemas/` from the contract, or with `--check` say what drifted."""

from __future__ import annotations

import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent / "schemas"


def main(argv: list[str]) -> int:
    """Return 1 if `--check` found a difference."""
    from saflite.console.io import schemas

    names = schemas.drift(FOLDER) if "--check" in argv else schemas.write(FOLDER)
    for name in names:
        print(f"schemas/{name}: {'differs from the code; run scripts/schemas' if '--check' in argv else 'written'}")
    return 1 if names and "--check" in argv else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
