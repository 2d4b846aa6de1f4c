"""What maintainers ask first of a finding: worked out from test case, flights and what the target says of itself.

For every target alike: documented ranges and links are those of `TargetInfo.inputs`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Annotated, Literal

import msgspec

from saflite.contract.bounds import Count, Text
from saflite.contract.flight import Delivered, given
from saflite.contract.target_info import InputInfo, Link, Repeats, TargetInfo
from saflite.contract.test_case import Stimulus, StimulusKind, TestCase, setting_text, stimulus_text, twin_text

InRange = Literal["inside", "outside", "undocumented"]
Texts = Annotated[tuple[Text, ...], msgspec.Meta(max_length=20_000)]
LINKS: tuple[Link, ...] = ("none", "setup", "pilot", "trusted")
_OF_KIND: dict[StimulusKind, Link] = {
    "parameter": "trusted",
    "command": "trusted",
    "stick": "pilot",
    "mode": "pilot",
    "sensor_fault": "none",
}


class Circumstances(msgspec.Struct, frozen=True, kw_only=True):
    """What a finding takes, and how sure it is.

    `values` is `inside` where every value given lies in its documented range; `outside` and `undocumented` name those
    that do not, or have none. `link` is what somebody needs who brings it about: `none` (the world does), `setup`
    (settings made before the flight), `pilot` (the pilot's own radio), `trusted` (a telemetry or serial link).
    `stock` tells whether the build is as its makers ship it, `options` what it was built with otherwise. Of `repeated`
    flights more under the same noise `equal` were the same bit by bit (0 of 0: the target repeats statistically, or
    none was flown); how often it violates under other noise stands in `Violation`. `steps` are boxes, then inputs in
    order; `minimal` where what can be left out was left out. `memory_safety`: any flight of the test case ended
    by a fault of memory, reported in private first.
    """

    values: InRange
    outside: Texts = ()
    undocumented: Texts = ()
    link: Link
    stock: bool
    options: Text = ""
    repeats: Repeats
    repeated: Count = 0
    equal: Count = 0
    steps: Texts = ()
    minimal: bool = False
    memory_safety: bool = False


def circumstances_of(
    test_case: TestCase, target: TargetInfo, delivered: tuple[Delivered, ...] | None = None
) -> Circumstances:
    """Return what a test case takes; inputs that were denied or not given any more do not count.

    One whose answer never came does: it may be what ended the autopilot. In a case made as small as it goes one that
    was denied counts, too: without it nothing showed, so the autopilot denied what it did.
    """
    known = {(info.kind, info.name): info for info in target.inputs}
    shrunk = test_case.origin.note.startswith("shrunk")
    heard = [one for one in given(test_case.stimuli, delivered) if shrunk or one.answer != "denied"]
    denied = [one.stimulus for one in heard if one.answer == "denied"]
    taken = [*_set_before(test_case), *(one.stimulus for one in heard)]
    outside = [words for one in taken if (words := _outside(one, known))]
    undocumented = sorted({one.name for one in taken if not _is_documented(one, known)})
    changed = {name: value for name, value in test_case.target.settings.items() if _is_changed(target, name, value)}
    planted = [name for name in changed if target.settings[name].breaks]
    options = [
        *([target.options] if target.options else []),
        *(f"planted: {setting_text(test_case.target.settings[name])}" for name in planted),
    ]
    steps = tuple(_steps(test_case, changed, taken, denied))
    return Circumstances(
        values="outside" if outside else "undocumented" if undocumented else "inside",
        outside=tuple(outside),
        undocumented=tuple(undocumented),
        link=_widest(_link(one, known) for one in taken),
        stock=target.stock and not planted,
        options="; ".join(options),
        repeats=target.repeats,
        steps=steps,
        minimal=shrunk or len(steps) <= 1,
    )


def ranges_kept(test_case: TestCase, target: TargetInfo) -> dict[str, tuple[float, float]]:
    """Return the documented ranges, by kind and name, of the inputs whose values all lie within."""
    known, found, left = {(info.kind, info.name): info for info in target.inputs}, {}, set()
    for one in test_case.stimuli:
        info, name = known.get((one.kind, one.name)), f"{one.kind} {one.name}"
        if info is None or info.low is None or info.high is None or not _is_documented(one, known):
            continue
        found[name] = (info.low, info.high)
        left |= {name} if _outside(one, known) else set()
    return {name: ends for name, ends in found.items() if name not in left}


def in_words(found: Circumstances, smallest_form: str = "") -> dict[str, str]:
    """Return it for people: question to answer, in the order in which they are asked.

    `smallest_form` names the test case that was made of it by minimising.
    """
    smaller = f"{smallest_form} is its smallest form" if smallest_form else "not minimised"
    values = {
        "inside": "all within documented ranges",
        "outside": "outside documented ranges: " + "; ".join(found.outside),
        "undocumented": "no range is documented for " + ", ".join(found.undocumented),
    }
    links = {
        "none": "none: the world brings it about",
        "setup": "none: settings made before the flight",
        "pilot": "the pilot's own radio, no trusted link",
        "trusted": "a trusted one (telemetry or serial)",
    }
    equal = f"{found.equal} of {found.repeated} flown again under the same noise are equal bit by bit"
    return {
        "values": values[found.values],
        "link needed": links[found.link],
        "build": "stock" if found.stock else f"not stock: {found.options or 'options unknown'}",
        "repeats": equal if found.repeated else f"{found.repeats}; none flown again under the same noise",
        "steps": f"{len(found.steps)}, " + ("minimal" if found.minimal else smaller),
    }


# ---- underneath ---------------------------------------------------------------------------------------------------

Known = Mapping[tuple[StimulusKind, str], InputInfo]


def _set_before(test_case: TestCase) -> Iterator[Stimulus]:
    for name, value in sorted(test_case.target.parameters.items()):
        yield Stimulus(at_s=0.0, kind="parameter", name=name, values=(value,))


def _is_changed(target: TargetInfo, name: str, value: object) -> bool:
    return name in target.settings and target.settings[name].default != value


def _is_documented(stimulus: Stimulus, known: Known) -> bool:
    info = known.get((stimulus.kind, stimulus.name))
    if stimulus.kind == "mode" or not stimulus.values:
        return info is not None
    bounded = info is not None and (bool(info.choices) or (info.low is not None and info.high is not None))
    return bounded and (stimulus.kind != "command" or (info is not None and info.type == "flag"))


def _outside(stimulus: Stimulus, known: Known) -> str:
    info = known.get((stimulus.kind, stimulus.name))
    if info is None or stimulus.kind == "mode" or not _is_documented(stimulus, known):
        return ""
    for value in stimulus.values:
        if info.low is not None and info.high is not None and not info.low <= value <= info.high:
            return f"{stimulus.name} {value:g}, documented {info.low:g} to {info.high:g} {info.unit}".rstrip()
        if info.choices and value not in info.choices:
            return f"{stimulus.name} {value:g}, documented {', '.join(f'{one:g}' for one in info.choices)}"
    return ""


def _link(stimulus: Stimulus, known: Known) -> Link:
    info = known.get((stimulus.kind, stimulus.name))
    if stimulus.kind == "parameter" and (stimulus.at_s <= 0.0 or (info is not None and info.at_start)):
        return "setup"
    return _OF_KIND[stimulus.kind] if info is None or info.link == "" else info.link


def _widest(links: Iterable[Link]) -> Link:
    return max(links, key=LINKS.index, default="none")


def _steps(
    test_case: TestCase, changed: Mapping[str, object], taken: Iterable[Stimulus], denied: Collection[Stimulus]
) -> Iterator[str]:
    for box in test_case.scenario.obstacles:
        size = f"{box.length_m:g} x {box.width_m:g} x {box.height_m:g} m"
        yield f"box of {size} at ({box.x_m:g}, {box.y_m:g}) m, turned {box.rotation_deg:g} degrees"
    if test_case.twin:
        yield twin_text(test_case.twin)
    for name in changed:
        yield f"{name} = {setting_text(test_case.target.settings[name])}"
    for one in taken:
        at = "" if one.kind == "parameter" and one.at_s <= 0.0 else f"at {one.at_s:g} s: "
        yield at + stimulus_text(one) + (" (denied)" if one in denied else "")
