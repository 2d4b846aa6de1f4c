"""Who may read a file that is made: what its user's `umask` says."""

from __future__ import annotations

from pathlib import Path


def new_file_mode() -> int:
    """Return the mode of a new file as this user wants it (`umask`), 0600 where the kernel does not say.

    What is written whole is made with 0600 and renamed; asking `umask` itself would change it for a moment.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return 0o600
    masks = [int(line.split()[1], 8) for line in lines if line.startswith("Umask:")]
    return 0o666 & ~masks[0] if masks else 0o600
