"""Files for deployment fit the code: commands parse, ports agree, metrics and volumes named are there."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

from saflite.bus.access import STAGE_OF
from saflite.bus.keyring import AUTHORITY_KEY, read_register
from saflite.console.cli import command_names
from saflite.console.io.farm_file import FarmFile, read_farm_file
from saflite.contract.control import Status, WorkerStatus
from saflite.runtime.clock import WallClock
from saflite.runtime.metrics import FarmMetrics

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
YAML = sorted(path for path in DEPLOY.rglob("*.y*ml") if "examples" not in path.parts)
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))


def _documents(path: Path) -> list[Any]:
    return [one for one in yaml.safe_load_all(path.read_text()) if one is not None]


def _pods() -> Iterator[Any]:
    for document in _documents(DEPLOY / "kubernetes" / "farm.yaml"):
        if "template" in document["spec"] if "spec" in document else False:
            yield document


def _commands() -> list[list[str]]:
    """Return the words after `saflite` of every command that a file runs."""
    services = _documents(DEPLOY / "compose.yaml")[0]["services"].values()
    found = [service["command"] for service in services if service.get("image") == "saflite-farm"]
    found += [box["args"] for pod in _pods() for box in pod["spec"]["template"]["spec"]["containers"]]
    for unit in UNITS:
        lines = re.findall(r"^ExecStart=\S+/saflite (.*)$", unit.read_text(), re.MULTILINE)
        found += [shlex.split(line) for line in lines]
    script = (DEPLOY / "ray-job.sh").read_text().replace("\\\n", " ")
    found += [shlex.split(line) for line in re.findall(r"^\s*saflite (keys .*)$", script, re.MULTILINE)]
    found += [shlex.split(line) for line in re.findall(r"-- +saflite (run .*)$", script, re.MULTILINE)]
    return found


@pytest.mark.parametrize("path", YAML, ids=lambda path: str(path.relative_to(DEPLOY)))
def test_yaml_can_be_read(path: Path) -> None:
    assert _documents(path)


def test_every_command_is_one_of_ours() -> None:
    commands = _commands()
    assert len(commands) >= 9
    for name, *words in commands:
        assert name in command_names()
        parser = argparse.ArgumentParser()
        import_module(f"saflite.console.commands.{name}").configure(parser)
        parser.parse_args(words)


def _farms(tmp_path: Path) -> list[FarmFile]:
    (config,) = [one for one in _documents(DEPLOY / "kubernetes" / "farm.yaml") if one["kind"] == "ConfigMap"]
    (tmp_path / "farm.toml").write_text(config["data"]["farm.toml"])
    return [read_farm_file(DEPLOY / "farm.toml"), read_farm_file(tmp_path / "farm.toml")]


def test_ports_agree(tmp_path: Path) -> None:
    farms = _farms(tmp_path)
    (bus,) = {farm.listen.rpartition(":")[2] for farm in farms}
    (metrics,) = {farm.metrics.rpartition(":")[2] for farm in farms}
    services = _documents(DEPLOY / "compose.yaml")[0]["services"]
    assert services["farm"]["ports"] == [f"{bus}:{bus}"]
    scraped = _documents(DEPLOY / "prometheus" / "prometheus.yml")[0]["scrape_configs"][0]["static_configs"][0]
    assert scraped["targets"] == [f"farm:{metrics}"]
    (service,) = [one for one in _documents(DEPLOY / "kubernetes" / "farm.yaml") if one["kind"] == "Service"]
    assert [str(port["port"]) for port in service["spec"]["ports"]] == [bus, metrics]
    joined = {words[words.index("--join") + 1] for words in _commands() if "--join" in words}
    assert {place.rpartition(":")[2] for place in joined if place != "${FARM}"} == {bus}


def test_metrics_that_are_drawn_or_watched_exist() -> None:
    worker = WorkerStatus(worker="w", stage="fly", state="idle", leases=0, done=0, busy_share=0.0, silent_s=0.0)
    counts = dict.fromkeys(
        [
            "round",
            "budget",
            "flights",
            "reflown",
            "test_cases",
            "candidates",
            "violations_confirmed",
            "violations_flaky",
            "violations_pending",
            "quarantined",
            "fallbacks",
            "seq",
        ],
        0,
    )
    rates = dict.fromkeys(("flights_per_s", "real_time_factor", "elapsed_s"), 0.0)
    words = dict.fromkeys(("campaign", "state", "scorer", "scorer_pending"), "x")
    status = Status(**counts, **rates, **words, since_last_find_s=None, queues={}, workers=(worker,))  # type: ignore[arg-type]
    metrics = FarmMetrics(WallClock())
    metrics.update(status)
    known = {f"{one.name}_total" if one.type == "counter" else one.name for one in metrics.collect()}
    dashboard = (DEPLOY / "grafana" / "dashboards" / "saflite.json").read_text()
    assert {panel["datasource"]["uid"] for panel in json.loads(dashboard)["panels"]} == {"prometheus"}
    expressions = [part["expr"] for panel in json.loads(dashboard)["panels"] for part in panel["targets"]]
    groups = _documents(DEPLOY / "prometheus" / "alerts.yml")[0]["groups"]
    expressions += [rule["expr"] for group in groups for rule in group["rules"]]
    named = {name for text in expressions for name in re.findall(r"saflite_\w+", text)}
    assert named
    assert named <= known
    joined = [text for text in expressions if re.search(r"(?:on|by) ?\([^)]*campaign", text)]
    assert joined
    assert all("instance" in text for text in joined), "two farms may have campaigns of one name"


def test_work_that_no_worker_is_there_for_is_an_alert_while_the_campaign_runs() -> None:
    (group,) = _documents(DEPLOY / "prometheus" / "alerts.yml")[0]["groups"]
    (rule,) = [rule for rule in group["rules"] if rule["alert"] == "NobodyWorks"]
    waits, nobody, runs = re.split(r" (?:unless|and) on ", rule["expr"])
    assert waits == "sum by (instance, campaign, stage) (saflite_queue_tasks) > 0"
    assert nobody == "(instance, stage) count by (instance, stage) (saflite_worker_leases)"
    assert runs == '(instance) saflite_campaign_state{state="running"}'


def test_a_farm_whose_process_is_gone_is_told_of() -> None:
    """It tells `saflite_up` 0 no more: the series is absent, and what is compared with it matches nothing."""
    (group,) = _documents(DEPLOY / "prometheus" / "alerts.yml")[0]["groups"]
    (rule,) = [rule for rule in group["rules"] if rule["alert"] == "FarmAway"]
    jobs = [one["job_name"] for one in _documents(DEPLOY / "prometheus" / "prometheus.yml")[0]["scrape_configs"]]
    parts = {part.strip() for part in rule["expr"].split(" or ")}
    gone = [f'up{{job="{job}"}} == 0' for job in jobs]
    away = {"saflite_up == 0", *gone, " unless on() ".join(["absent(saflite_up)", *gone])}
    assert parts == away, "not told: books that are silent, a target that is gone, one that is looked for no more"
    assert "over" in rule["annotations"]["summary"], "a farm that ended in order is away, too"


Labels = dict[str, str]
Series = dict[str, list[tuple[Labels, float]]]
A, B = ({"job": "saflite", "instance": f"{host}:9464"} for host in "ab")
WORKS: Series = {"up": [(A, 1.0)], "saflite_up": [({**A, "campaign": "night"}, 1.0)]}


def _selected(text: str, series: Series) -> list[Labels]:
    """Return the elements of a part of FarmAway's expression, as PromQL has it."""
    left, _, unless = text.partition(" unless on() ")
    if unless:
        return [] if _selected(unless, series) else _selected(left, series)
    if absent := re.fullmatch(r"absent\((\w+)\)", text):
        return [] if series.get(absent[1]) else [{}]
    named = re.fullmatch(r'(\w+)(?:\{job="(\w+)"\})? == 0', text)
    assert named, f"an expression this test does not know: {text}"
    return [labels for labels, value in series.get(named[1], []) if not value and named[2] in (None, labels.get("job"))]


@pytest.mark.parametrize(
    ("series", "count"),
    [
        (WORKS, 0),
        ({**WORKS, "saflite_up": [({**A, "campaign": "night"}, 0.0)]}, 1),  # its books do not answer
        ({"up": [(A, 0.0)]}, 1),  # its process is gone, and listed
        ({}, 1),  # its process is gone, and no longer discovered
        ({**WORKS, "up": [(A, 1.0), (B, 0.0)]}, 1),  # one of two
        ({"up": [(A, 0.0), (B, 0.0)]}, 2),  # both
        ({"up": [({"job": "other", "instance": "c:1"}, 0.0)]}, 1),  # of another job nothing is known
    ],
)
def test_a_farm_that_is_away_is_one_alert(series: Series, count: int) -> None:
    (group,) = _documents(DEPLOY / "prometheus" / "alerts.yml")[0]["groups"]
    (expression,) = [rule["expr"] for rule in group["rules"] if rule["alert"] == "FarmAway"]
    alerts: list[Labels] = []
    for part in expression.split(" or "):
        alerts += [labels for labels in _selected(part, series) if labels not in alerts]
    assert len(alerts) == count, alerts


def test_no_alert_asks_for_a_job_that_is_not_scraped() -> None:
    jobs = {one["job_name"] for one in _documents(DEPLOY / "prometheus" / "prometheus.yml")[0]["scrape_configs"]}
    rules = (DEPLOY / "prometheus" / "alerts.yml").read_text()
    asked = set(re.findall(r'job="([^"]*)"', rules))
    assert asked
    assert asked <= jobs


def test_pods_mount_what_they_have_and_are_selected_by_their_labels() -> None:
    pods = list(_pods())
    assert {pod["kind"] for pod in pods} == {"StatefulSet", "Deployment"}
    for pod in pods:
        spec = pod["spec"]["template"]["spec"]
        have = {one["name"] for one in spec["volumes"]}
        have |= {one["metadata"]["name"] for one in pod["spec"].get("volumeClaimTemplates", ())}
        boxes = [*spec["initContainers"], *spec["containers"]]
        assert {mount["name"] for box in boxes for mount in box["volumeMounts"]} == have
        assert pod["spec"]["selector"]["matchLabels"] == pod["spec"]["template"]["metadata"]["labels"]


def test_compose_mounts_files_that_are_there() -> None:
    compose = _documents(DEPLOY / "compose.yaml")[0]
    sources = [volume.split(":")[0] for one in compose["services"].values() for volume in one.get("volumes", ())]
    files = [source for source in sources if source.startswith("./") and not source.startswith("./keys")]
    assert [source for source in files if not (DEPLOY / source).exists()] == []
    assert {source for source in sources if not source.startswith(".")} == set(compose["volumes"])


@pytest.mark.live
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_units_pass_systemds_own_check(unit: Path, tmp_path: Path) -> None:
    here = tmp_path / unit.name
    here.write_text(unit.read_text().replace("/opt/saflite/bin/saflite", str(Path(sys.executable).parent / "saflite")))
    done = subprocess.run(["systemd-analyze", "verify", str(here)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.live
@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed (Debian: prometheus)")
def test_prometheus_files_pass_its_own_check() -> None:
    subprocess.run(["promtool", "check", "config", str(DEPLOY / "prometheus" / "prometheus.yml")], check=True)


@pytest.mark.live
def test_manifests_pass_the_schemas_of_kubernetes() -> None:
    """By the schemas that Kubernetes publishes; KubeRay's own kind is in none of them."""
    validate = [sys.executable, "-m", "kubernetes_validate", "--strict", "--no-warn"]
    files = sorted(map(str, (DEPLOY / "kubernetes").glob("*.yaml")))
    done = subprocess.run([*validate, *files], capture_output=True, text=True, check=False)
    passed = re.findall(r"passed for resource (\w+)/", done.stdout + done.stderr)
    assert (done.returncode, set(passed)) == (0, {"configmap", "service", "statefulset", "deployment"}), done.stderr


@pytest.mark.live
@pytest.mark.skipif(
    shutil.which("docker") is None
    or subprocess.run(["docker", "compose", "version"], capture_output=True, check=False).returncode != 0,
    reason="docker compose is not installed",
)
def test_the_compose_file_passes_its_own_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRAFANA_PASSWORD", "x")
    subprocess.run(["docker", "compose", "-f", str(DEPLOY / "compose.yaml"), "config", "--quiet"], check=True)


def test_a_ray_job_is_given_no_key_that_could_make_keys(tmp_path: Path) -> None:
    """What is given to a job is kept in Ray's store: the authority's key stays where `saflite keys` made it."""
    ray, given, keys = tmp_path / "bin" / "ray", tmp_path / "given", tmp_path / "keys"
    ray.parent.mkdir()
    ray.write_text(f'#!/bin/sh\nwhile [ "$1" != --working-dir ]; do shift; done\ncp -R "$2" {given}\n')
    ray.chmod(0o700)
    (tmp_path / "night.toml").write_text('name = "night"\n')
    path = f"{ray.parent}:{Path(sys.executable).parent}:/usr/bin:/bin"
    job = [str(DEPLOY / "ray-job.sh"), "http://head:8265", str(tmp_path / "night.toml"), "10.0.0.5", str(keys)]
    for _ in range(2):  # the second time with the keys of the first
        shutil.rmtree(given, ignore_errors=True)
        subprocess.run(["bash", *job], check=True, timeout=120, env={"PATH": path, "HOME": str(tmp_path)})
        there = {str(one.relative_to(given)) for one in given.rglob("*") if one.is_file()}
        assert (keys / AUTHORITY_KEY).is_file()
        assert not [name for name in there if AUTHORITY_KEY in name]
        assert {"campaign.toml", "keys/register.toml", "keys/farm/key.pem", "keys/peers/ray/key.pem"} <= there
        ray_peer = read_register(given / "keys").named("ray")
        assert ray_peer is not None
        assert ray_peer.may("night")
        assert set(ray_peer.roles) == set(STAGE_OF)
