"""Writing templates: a working part of a kind under a name of one's own."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from saflite.console.io import outputs
from saflite.contract.errors import Refused

TEMPLATES = Path(__file__).parent.parent / "templates"
PLACEHOLDER = "NAME"
FILES: dict[str, dict[str, str]] = {
    "policy": {"policy.toml": "NAME.toml"},
    "campaign": {"campaign.toml": "NAME.toml"},
    "strategy": {"strategy.py": "NAME.py"},
    "scorer": {"scorer.py": "NAME.py"},
    "target": {
        "target.py": "NAME.py",
        "target-policy.toml": "NAME-policy.toml",
        "target-campaign.toml": "NAME-campaign.toml",
    },
}
NEXT: dict[str, tuple[str, ...]] = {
    "policy": ("saflite run NAME.toml --budget 24", "saflite schema policy > policy.schema.json"),
    "campaign": ("saflite run NAME.toml", "saflite schema campaign > campaign.schema.json"),
    "strategy": (
        "saflite conformance strategy NAME --module NAME.py",
        "saflite run policy-upright --strategy NAME --module NAME.py --budget 24",
    ),
    "scorer": (
        "saflite conformance scorer NAME --module NAME.py",
        "saflite run avoidance-m2 --scorer NAME --module NAME.py --budget 24",
    ),
    "target": (
        "saflite conformance target NAME --module NAME.py",
        "saflite run NAME-campaign.toml --module NAME.py",
    ),
}
WORDS = {".py": re.compile(r"[a-z][a-z0-9_]*"), ".toml": re.compile(r"[a-z][a-z0-9-]*")}


def begin(kind: str, name: str, folder: Path, *, force: bool) -> list[Path]:
    """Write the template of a kind under a name; returns the files.

    Raises:
        Refused: the name is not fit, is one of ours, or a file stands there.
        Unavailable: the disk refuses.
    """
    _check_name(kind, name)
    places = {template: folder / place.replace(PLACEHOLDER, name) for template, place in FILES[kind].items()}
    for path in places.values():
        outputs.check_file(path, force=force, option="file")
    for template, path in places.items():
        outputs.write(path, text_of(template, name).encode(), force=force, option="file")
    return list(places.values())


def text_of(template: str, name: str) -> str:
    """Return the text of a template for a name; an id of a policy has dashes where a module has underscores."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    if template == "target-policy.toml":
        text = text.replace(f'id = "{PLACEHOLDER}', f'id = "{name.replace("_", "-")}')
    return text.replace(PLACEHOLDER, name)


def after(kind: str, name: str) -> list[str]:
    """Return the commands to go on with."""
    return [text.replace(PLACEHOLDER, name) for text in NEXT[kind]]


def _check_name(kind: str, name: str) -> None:
    suffix = next(iter(FILES[kind].values()))[len(PLACEHOLDER) :]
    if not WORDS[suffix].fullmatch(name):
        joined = "underscores" if suffix == ".py" else "dashes"
        raise Refused("name", expected=f"small letters, digits and {joined}, a letter first", got=repr(name))
    if name in _ours(kind):
        raise Refused("name", expected=f"one that no {kind} of ours has", got=repr(name))


def _ours(kind: str) -> tuple[str, ...]:
    from saflite.mutator.registry import strategy_names
    from saflite.oracle.policy import policy_names
    from saflite.scorer_pool.registry import model_names
    from saflite.simulator_worker.registry import target_names

    names: dict[str, Callable[[], tuple[str, ...]]] = {
        "policy": policy_names,
        "strategy": strategy_names,
        "scorer": model_names,
        "target": target_names,
    }
    return names[kind]() if kind in names else ()
