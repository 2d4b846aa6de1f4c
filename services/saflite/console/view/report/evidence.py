"""One violation on the page: the picture, the robustness over time, the facts, the recipe to see it again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saflite.console.view.html_text import escape
from saflite.console.view.report import charts, layout, timeline
from saflite.console.view.report.data import Exhibit
from saflite.console.view.report.svg import tag
from saflite.contract.circumstances import in_words
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, Given, given
from saflite.contract.plain import argument
from saflite.contract.test_case import Obstacle, setting_text, stimulus_text
from saflite.contract.verdict import Verdict, failed_again

FAR_M = 12.0  # distances beyond it are cut off in charts: what matters is near the limit


def section(number: int, exhibit: Exhibit, run_name: str) -> str:
    """Return the section of one violation; of one that is shown alone the number is 0, and left out."""
    violation = exhibit.violation
    verdict = _verdict(exhibit)
    place = f"{number}. " if number else ""
    title = f"{place}{escape(violation.policy)} <small>{escape(violation.fingerprint)}</small>"
    pictures = [f"<figure>{drawn}</figure>" for drawn in (_picture(exhibit), *_charts(exhibit, verdict)) if drawn]
    facts = "".join(f"<tr><th>{escape(key)}</th><td>{text}</td></tr>" for key, text in _facts(exhibit, run_name))
    badge = f'<span class="badge {violation.confirmation}">{violation.confirmation}</span>'
    hard = f'<span class="badge {violation.severity}">{violation.severity}</span>'
    return (
        f'<section class="violation" id="v{number}"><h3>{title} {badge}{hard}</h3>'
        f'<p class="muted">{escape(violation.message)}</p>'
        f'<div class="pictures">{"".join(pictures)}</div><table class="facts">{facts}</table></section>'
    )


def _verdict(exhibit: Exhibit) -> Verdict | None:
    verdicts = exhibit.judgement.verdicts if exhibit.judgement is not None else ()
    return next((verdict for verdict in verdicts if verdict.policy == exhibit.violation.policy), None)


def _track(exhibit: Exhibit) -> NDArray[np.float64]:
    trace = exhibit.trace
    names = ("x_m", "y_m", "altitude_m")
    if trace is not None and all(name in trace.signals for name in names):
        return np.stack([trace.array(name).astype(float) for name in names], axis=1)
    rows = exhibit.judgement.track if exhibit.judgement is not None else ()
    return np.array([row[1:] for row in rows], dtype=float).reshape(-1, 3)


def _picture(exhibit: Exhibit) -> str:
    track, scenario = _track(exhibit), exhibit.test_case.scenario
    if not len(track) and not scenario.obstacles and scenario.mission is None:
        return ""  # a target that has no place
    return layout.picture(exhibit.test_case, track, _twin(exhibit)) + layout.legend(exhibit.test_case)


def _twin(exhibit: Exhibit) -> NDArray[np.float64]:
    """Return where the twin of the flight was while both flew, shape (n, 3); none where none was flown."""
    trace = exhibit.trace
    if trace is None or "twin" not in trace.signals:
        return layout.NO_TWIN
    apart = zip(("x_m", "y_m", "altitude_m"), ("twin_x_apart_m", "twin_y_apart_m", "twin_height_apart_m"), strict=True)
    places = np.stack([np.add(trace.array(name), trace.array(more), dtype=np.float64) for name, more in apart], axis=1)
    return places[trace.array("twin") > 0.0].astype(np.float64)


def _charts(exhibit: Exhibit, verdict: Verdict | None) -> list[str]:
    trace = exhibit.trace
    if trace is None or verdict is None:
        return []
    times = np.arange(trace.samples, dtype=np.float64) * trace.step_s
    marks = [charts.Mark(verdict.witness_from_s, until=verdict.witness_to_s)]
    marks += [charts.Mark(one.stimulus.at_s, _short(one)) for one in _given(exhibit)]
    drawn = [_robustness(exhibit, times, marks)]
    if "altitude_m" in trace.signals:
        curves = [charts.Curve(times, trace.array("altitude_m"), "curve1", "altitude [m]")]
        if "vx_mps" in trace.signals and "vy_mps" in trace.signals:
            speed = np.hypot(trace.array("vx_mps"), trace.array("vy_mps"))
            curves.append(charts.Curve(times, speed, "curve2", "speed [m/s]"))
        drawn.append(charts.chart("altitude and ground speed", curves, x_name="s", marks=marks))
    return [*drawn, *timeline.around(trace, verdict, _given(exhibit), _needed(exhibit))]


def _needed(exhibit: Exhibit) -> tuple[str, ...]:
    """Return the signals that the policy looks at."""
    from saflite.oracle.policy import load_policy

    try:
        return tuple(sorted(load_policy(exhibit.violation.policy, exhibit.policy_texts).needed))
    except Refused:
        return ()


def _robustness(exhibit: Exhibit, times: NDArray[np.float64], marks: list[charts.Mark]) -> str:
    trace = exhibit.trace
    assert trace is not None, "asked for with a trace only"
    if exhibit.test_case.scenario.obstacles and "obstacle_distance_m" in trace.signals:
        distance = trace.array("obstacle_distance_m")
        level = [charts.Level(layout.SAFE_M, "1.5 m", "limit")]
        curve = [charts.Curve(times, np.minimum(distance, FAR_M), "curve1")]
        return charts.chart("distance to the nearest box [m]", curve, x_name="s", levels=level, marks=marks)
    values, unit = _policy_robustness(exhibit)
    if values is None:
        return ""
    curve = [charts.Curve(times[: len(values)], values, "curve1")]
    level = [charts.Level(0.0, "broken below", "limit")]
    return charts.chart(
        f"robustness of {exhibit.violation.policy} {unit}", curve, x_name="s", levels=level, marks=marks
    )


def _policy_robustness(exhibit: Exhibit) -> tuple[NDArray[np.float64] | None, str]:
    """Return the robustness of what the policy promises at every moment, None where it is undefined."""
    from saflite.oracle.policy import load_policy
    from saflite.oracle.signals import FlightSignals
    from saflite.oracle.stl import Evaluator

    trace = exhibit.trace
    assert trace is not None, "asked for with a trace only"
    try:
        policy = load_policy(exhibit.violation.policy, exhibit.policy_texts).on(exhibit.test_case.target.name)
        signals = FlightSignals(exhibit.test_case, _flight_of(exhibit), trace, between=True)
        picked = signals.pick(policy.needed)
    except Refused:
        return None, ""
    body = policy.formula.args[0] if policy.formula.op == "always" else policy.formula
    if not policy.needed <= set(picked):
        return None, ""
    moments = signals.moments
    at_moments = np.asarray(Evaluator(picked, trace.step_s, moments.row).trace(body), dtype=float)
    values = np.full(trace.samples, np.inf)  # of the moments of a sample the worst
    np.minimum.at(values, moments.row[: len(at_moments)], at_moments)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return np.sign(values), "(holds or not)"
    return np.clip(values, finite.min() - 1.0, finite.max() + 1.0), f"[{policy.unit}]" if policy.unit else ""


def _given(exhibit: Exhibit) -> tuple[Given, ...]:
    """Return the stimuli as they were given; as planned where that is not known."""
    return given(exhibit.test_case.stimuli, exhibit.flight.delivered if exhibit.flight else None)


def _flight_of(exhibit: Exhibit) -> Flight:
    if exhibit.flight is not None:
        return exhibit.flight
    row = exhibit.flights[0]
    return Flight(
        test_case=row.test_case,
        flight_index=row.flight_index,
        ending=row.ending,
        simulated_s=row.simulated_s,
    )


def _facts(exhibit: Exhibit, run_name: str) -> list[tuple[str, str]]:
    """Return what is known of a violation: each fact's name, and what it says as HTML."""
    violation, case = exhibit.violation, exhibit.test_case
    first = next((row for row in exhibit.flights if row.shows(violation)), None)
    proposer = f"{case.origin.strategy or '?'}, round {case.origin.round}"
    origin = f"<code>{escape(violation.test_case)}</code> by {escape(proposer)}"
    if case.origin.parent:
        origin += f", child of <code>{escape(case.origin.parent)}</code>"
    facts = [("robustness", f"{violation.robustness:+.3f}"), ("flown again", _again(exhibit)), ("test case", origin)]
    if exhibit.circumstances is not None:
        answers = in_words(exhibit.circumstances, exhibit.smallest_form)
        facts += [(question, escape(answer)) for question, answer in answers.items()]
    if first is not None:
        flown = f"{first.ending}, {first.simulated_s:.1f} s"
        facts.append(("flight", f"{escape(flown)}, trace <code>{escape(first.trace_digest[:16])}</code>"))
    facts += [(f"box {number}", _box(box)) for number, box in enumerate(case.scenario.obstacles, start=1)]
    facts += [(f"at {one.stimulus.at_s:g} s", escape(_given_text(one))) for one in _given(exhibit)]
    facts += [(escape(name), escape(setting_text(value))) for name, value in case.target.settings.items()]
    if never := len(case.stimuli) - len(_given(exhibit)):
        facts.append(("never given", f"{never} of {len(case.stimuli)} inputs: the flight was over before"))
    if exhibit.artefacts:
        names = ", ".join(f"{escape(one.name)} ({one.blob.size_bytes} bytes)" for one in exhibit.artefacts)
        command = f"saflite artefacts {argument(run_name)} --test-case {violation.test_case} --out DIR"
        facts.append(("files left", f"{names}: <code>{escape(command)}</code>"))
    if exhibit.recording:
        facts.append(("recording", f'<a href="{escape(exhibit.recording)}">{escape(exhibit.recording)}</a>'))
    replay = f"saflite replay {argument(run_name)} --violation {violation.fingerprint}"
    facts.append(("see it again", f"<code>{escape(replay)}</code>"))
    return facts


def _again(exhibit: Exhibit) -> str:
    violation = exhibit.violation
    workers = f" (workers {escape(', '.join(violation.workers))})" if violation.workers else ""
    return f"violates again in {failed_again(violation)}{workers}"


def _box(box: Obstacle) -> str:
    size = f"{box.length_m:.2f} × {box.width_m:.2f} × {box.height_m:.2f} m"
    return f"{size} at ({box.x_m:.2f}, {box.y_m:.2f}), turned {box.rotation_deg:.1f}°"


def _given_text(one: Given) -> str:
    """Return a stimulus with what became of it, where that is not as usual."""
    answer = "" if one.answer in ("accepted", "unanswered") else f", {one.answer}"
    return stimulus_text(one.stimulus) + answer + (f": {one.message}" if one.message else "")


def _short(one: Given) -> str:
    return one.stimulus.name[:14] + (f" ({one.answer.replace('_', ' ')})" if not one.is_cause else "")


def anchor(number: int, text: str) -> str:
    """Return a link to the section of a violation."""
    return tag("a", escape(text), href=f"#v{number}")
