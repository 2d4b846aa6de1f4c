"""What the command line changes in the target of a campaign or test case."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from saflite.contract.errors import Refused
from saflite.contract.outside import assignment
from saflite.contract.target_info import TargetInfo, check_settings
from saflite.contract.test_case import Target

DEFECTS = "defects"


def with_settings(target: Target, info: TargetInfo, settings: Sequence[str], defects: Sequence[str]) -> Target:
    """Return the target with settings changed and defects added; raises Refused for what the target does not have."""
    new = dict(target.settings)
    for text in settings:
        name, value = assignment("--target-set", text)
        takes_list = name in info.settings and isinstance(info.settings[name].default, list)
        new[name] = [value] if takes_list and not isinstance(value, list) else value
    if defects:
        if DEFECTS not in info.settings:
            raise Refused("--defect", expected="a target with planted defects", got=info.name)
        held = new.get(DEFECTS, [])
        assert isinstance(held, list), "the setting is a list of names"
        new[DEFECTS] = [*held, *(name for name in dict.fromkeys(defects) if name not in held)]
    check_settings(new, info.settings, info.name)
    return msgspec.structs.replace(target, settings=new)
