"""`FARM.toml`: a farm that is kept running by a machine, described once. Unknown keys are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec

from saflite.contract import wire
from saflite.contract.bounds import Word
from saflite.contract.errors import Refused
from saflite.contract.gaps import told
from saflite.contract.outside import parse_toml, read_text
from saflite.contract.work import Stage
from saflite.runtime.autoscaling import Bounds, check_bounds

WORKERS_MAX = 1_000
FILE_BYTES_MAX = 2**20


class FarmFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `saflite up` runs. Paths are relative to the file.

    `workers` says how many of each stage run here, none of those left out: they join from elsewhere. Those of `scale`
    are as many as their queue asks for, between `min` and `max`. The other keys are the options of `saflite run` of the
    same names.
    """

    campaign: Word
    run: Word
    listen: Word = ""
    keys: Word = ""
    insecure: bool = False
    metrics: Word = ""
    json_logs: bool = False
    modules: Annotated[tuple[Word, ...], msgspec.Meta(max_length=1_000)] = ()
    workers: dict[Stage, int] = {}
    scale: dict[Stage, Bounds] = {}


def read_farm_file(path: Path) -> FarmFile:
    """Return the farm a file describes, its paths made whole.

    Raises:
        Refused: no such file, no TOML, an unknown key or stage, or a number that makes no sense.
    """
    where = str(path)
    data = parse_toml(read_text(path, "farm file", FILE_BYTES_MAX), "farm file", where)
    try:
        farm = wire.convert(data, FarmFile)
    except msgspec.ValidationError as fault:
        raise Refused("farm file", where=where, expected="a valid farm", got=told(fault, data, FarmFile)) from fault
    for stage, count in farm.workers.items():
        if not 0 <= count <= WORKERS_MAX:
            raise Refused(f"workers.{stage}", where=where, expected=f"0 to {WORKERS_MAX}", got=count)
    check_bounds(farm.scale, "scale", where)
    if both := farm.workers.keys() & farm.scale.keys():
        raise Refused("scale", where=where, expected="stages that are not in `workers`", got=", ".join(sorted(both)))
    here = path.absolute().parent
    is_file = farm.campaign.endswith(".toml")
    return msgspec.structs.replace(
        farm,
        campaign=str(here / farm.campaign) if is_file else farm.campaign,
        run=str(here / farm.run),
        keys=str(here / farm.keys) if farm.keys else "",
        modules=tuple(str(here / module) for module in farm.modules),
    )
