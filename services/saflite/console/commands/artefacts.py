"""List the files that flights left behind (autopilot logs, console texts, core reasons), or write them to a folder.

examples:
  saflite artefacts runs/night
  saflite artefacts runs/night --test-case 8c1d2f --out logs/
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from saflite.console.io import outputs


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    arguments.add_run(parser)
    parser.add_argument("--test-case", default="", metavar="ID", help="of this test case (or the start of its name)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write them to this folder, one below it per flight")
    outputs.add_force(parser)
    parser.add_argument("--json", action="store_true", help="print the list as JSON")


def run(args: argparse.Namespace) -> int:
    """List or write them; 0 also where there are none."""
    from saflite.console.run_data import farm_lookup
    from saflite.console.run_data.run_folder import open_run, tell_loss
    from saflite.console.view import out
    from saflite.contract.plain import counted

    args.run = farm_lookup.newest(args.run)
    if args.out is not None:
        outputs.check_folder(args.out, force=args.force)
    tell_loss(args.run)
    with open_run(args.run) as folder:
        rows = [row for row in folder.artefacts() if row.test_case.startswith(args.test_case)]
        if args.test_case and not any(row.test_case.startswith(args.test_case) for row in folder.flights()):
            _refuse_unknown(args.run, args.test_case)
        kept = folder.campaign.record
        named = [(f"{row.test_case}-{row.purpose}-{row.flight_index}", row) for row in rows]
        if args.out is not None:
            _check_names(args.run, (name for flight, row in named for name in (flight, row.name)))
        listed = []
        for flight, row in named:
            entry = {"flight": flight, "name": row.name, "size_bytes": row.blob.size_bytes, "sha256": row.blob.digest}
            if args.out is not None:
                entry["file"] = str(_write(args.out / flight, row.name, folder.content(row.blob), args.force))
            listed.append(entry)
    if args.json:
        out.json(listed)
        return 0
    out.table([(str(one["flight"]), str(one["name"]), f"{one['size_bytes']} bytes") for one in listed])
    place = f" in {args.out}" if args.out is not None else ""
    out.line(counted(len(listed), "file") + place + ("" if listed else _why_none(kept)))
    return 0


def _why_none(kept: str) -> str:
    """Return in words which flights could have left files here."""
    of = "all flights" if kept == "all" else "flights that show a violation (`record` in the campaign)"
    return f": kept are those of {of}, where the target leaves any"


def _refuse_unknown(run_dir: Path, wanted: str) -> None:
    from saflite.contract.errors import Refused

    fix = "see `saflite export RUN --format csv`"
    raise Refused("test case", where=str(run_dir), expected="one flown in this run", got=repr(wanted), fix=fix)


def _check_names(run_dir: Path, names: Iterable[str]) -> None:
    """Raise Refused before anything is written where a name would lead out of its folder.

    Names are checked when a flight is reported; a run that somebody else made may hold any.
    """
    from saflite.contract.errors import Refused
    from saflite.contract.names import NAME_EXPECTED, is_name

    for name in names:
        if not is_name(name):
            fix = "list them without --out; `saflite audit RUN` says what else is wrong with the run"
            raise Refused("artefact", where=str(run_dir), expected=NAME_EXPECTED, got=repr(name[:80]), fix=fix)


def _write(folder: Path, name: str, data: bytes, force: bool) -> Path:
    outputs.write(folder / name, data, force=force)
    return folder / name
