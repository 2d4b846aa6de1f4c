"""Which commands of the pages need nothing but this checkout, and what the others need."""

from __future__ import annotations

from typing import NamedTuple

FEW = ("--budget", "2")
ANYTHING = (0, 1)


class Run(NamedTuple):
    """A command is run as it stands, but for the placeholders, with words added that keep it short."""

    more: tuple[str, ...] = ()
    codes: tuple[int, ...] = ANYTHING


PLACES = {
    "RUN": "runs/avoidance-m2",
    "CASE": "case.yaml",
    "BUILD": "reference",
    "BUILD_A": "reference",
    "BUILD_B": "reference",
    "NAME": "avoidance-m2",
    "N": "1",
    "FILE": "log.ulg",
    "...": "reference+parachute-in-acro",
}
"""What stands for the placeholders of the pages where a command is run."""

RUNS: dict[str, Run] = {
    "saflite replay runs/avoidance-m2": Run(),
    "saflite fly case.yaml": Run(),
    "saflite fly case.yaml --twin turned": Run(),
    "saflite fly case.yaml --target reference": Run(),
    "saflite judge log.ulg": Run(codes=(0, 1, 4)),
    "saflite judge FILE": Run(codes=(0, 1, 4)),
    "saflite judge log.ulg --policy stays-below.toml": Run(codes=(0, 1, 4)),
    "saflite judge logs/ --quiet --csv all.csv --html all.html": Run(codes=(0, 1, 4)),
    "saflite run policy-a-chute --defect parachute-in-acro": Run(FEW),
    "saflite run policy-a-chute": Run(FEW),
    "saflite run avoidance-m3 --strategy portfolio": Run(FEW),
    'saflite run avoidance-m3 --strategy portfolio --set \'arms=["camba", "near_miss:fresh=0.5,population=8"]\'': Run(
        FEW
    ),
    "saflite run policy-all --strategy portfolio": Run(FEW),
    "saflite run my-policy.toml": Run(FEW),
    "saflite run my-campaign.toml": Run(FEW),
    "saflite run my-campaign.toml --minutes 10 --stop-at-first": Run(FEW),
    "saflite regress runs/night --target BUILD": Run(("--times", "1")),
    "saflite compare RUN --target BUILD": Run(("--count", "2")),
    "saflite flake CASE -n 50": Run(("-n", "6")),
    "saflite export RUN --format junit": Run(),
    "saflite audit RUN": Run(),
    "saflite audit RUN --rebuild": Run(),
    "saflite resume RUN": Run(),
    "saflite watch RUN --from N": Run(),
    "saflite keys init --host 10.0.0.5": Run(),
    "saflite keys add lab2 --role worker --role oracle": Run(),
    "saflite keys add ana --role viewer": Run(),
    "saflite keys renew --host lab.example.org": Run(),
    "saflite new campaign tips-over": Run(),
    "saflite run tips-over.toml": Run(FEW),
    "saflite schema campaign > campaign.schema.json": Run(),
    "saflite new policy stays-below": Run(),
    "saflite run stays-below.toml --budget 24": Run(FEW),
    "saflite new scorer my_scorer": Run(),
    "saflite conformance scorer my_scorer --module my_scorer.py": Run(),
    "saflite run avoidance-m2 --scorer my_scorer --module my_scorer.py --budget 24": Run(FEW),
    "saflite new strategy my_strategy": Run(),
    "saflite conformance strategy my_strategy --module my_strategy.py": Run(),
    "saflite run policy-upright --strategy my_strategy --module my_strategy.py --budget 24": Run(FEW),
    "saflite new target my_vehicle": Run(),
    "saflite conformance target my_vehicle --module my_vehicle.py": Run(),
    "saflite run my_vehicle-campaign.toml --module my_vehicle.py": Run(FEW),
    "saflite list policies": Run(),
    "saflite list policies -v": Run(),
    "saflite list defects": Run(),
    "saflite evaluate bugs": Run(),
    "saflite prune runs/night --dry-run": Run(),
    "saflite report runs/avoidance-m2": Run(),
}

_SERVES = "it serves until it is ended: tests/live/"
_SCALED = "as tests/live/test_ray.py runs it, with numbers for this machine"
_CLUSTER = "needs a Ray cluster: tests/live/test_ray.py"
_KEYS = "needs a second machine of that address: tests/live/test_keys.py does it in network namespaces"
_MODEL = "needs a model server: tests/live/test_ollama.py"
_BETAFLIGHT = "needs the firmware: tests/live/test_betaflight.py, and CI's own step"
_AUTOPILOT = "needs a build of that autopilot: tests/live fly a stand-in"
_SCRIPT = "a step of CI itself, or a measurement of minutes to days"
_INSTALLS = "changes the environment that runs the tests"

_IMAGE = "needs a container engine and an image of gigabytes"

NOT_RUN: dict[str, str] = {
    "saflite run avoidance-m3 --scorer ollama:mistral": _MODEL,
    "saflite run avoidance-m2 --scorer ollama:mistral --shadow surrogate": _MODEL,
    "saflite run avoidance-m2 --scorer ollama:mistral+brief --shadow ollama:mistral": _MODEL,
    "saflite scorer use gap": "needs a running farm: tests/live/test_console.py",
    "saflite scorer use ollama:mistral": _MODEL,
    "saflite scorer list": "needs a running farm: tests/live/test_console.py",
    "saflite run avoidance-m2 --scorer ollama:smollm2@127.0.0.1:11435": _MODEL,
    "saflite scorer use ollama:tiny-b@127.0.0.1:11435": _MODEL,
    "saflite evaluate bugs --model relevance --plot bugs.svg": "as `saflite evaluate bugs`, a minute more",
    "saflite evaluate logs FOLDER --labels labels.csv --model ollama:mistral": _MODEL,
    "docker pull skhatiri/aerialist:2.0": _IMAGE,
    "saflite run aerialist-avoidance --workers 2": _IMAGE,
    "saflite run avoidance-m2 --on ray": _CLUSTER,
    "saflite run night.toml --on ray": _CLUSTER,
    "saflite run night.toml --on ray:10.0.0.5:6379 --listen tls/0.0.0.0:7447 --keys keys": _CLUSTER,
    "saflite run night.toml --scale fly=2:16": _SCALED,
    "saflite run night.toml --on ray --scale fly=0:64 --scale score=1:8": _SCALED,
    "saflite resume runs/night --scale fly=4:4": _SCALED,
    "saflite worker --join tls/HOST:7447 --keys lab2": _KEYS,
    "saflite run night.toml --listen tls/0.0.0.0:7447 --keys keys": _KEYS,
    "saflite worker --join tls/10.0.0.5:7447 --keys lab2 --stages fly,judge --workers 8": _KEYS,
    "saflite watch --connect tls/10.0.0.5:7447 --campaign night --keys ana": _KEYS,
    "saflite watch --connect tls/10.0.0.5:7447 --campaign night --keys ana --webhook URL --cursor ana.json": _KEYS,
    "saflite watch runs/night --kind violation --webhook https://example.org/finds --secret hook.secret": (
        "posts to a server: tests/live/test_events.py"
    ),
    "saflite dashboard tls/lab:7447 --campaign night --keys lab2": _KEYS,
    "saflite dashboard runs": f"{_SERVES}test_dashboard.py",
    "saflite dashboard runs/avoidance-m2": f"{_SERVES}test_dashboard.py",
    "saflite dashboard runs --host 0.0.0.0 --tokens tokens.txt": f"{_SERVES}test_dashboard.py",
    "saflite sitl": f"{_SERVES}test_mavlink.py",
    "saflite sitl --defect parachute-in-acro": f"{_SERVES}test_mavlink.py",
    "saflite up farm.toml": f"{_SERVES}test_keys.py, tests/unit/console/test_farm_file.py",
    "saflite worker --join runs/night": f"{_SERVES}test_joining.py",
    "saflite worker --join runs/night --metrics 0.0.0.0:9465": f"{_SERVES}test_joining.py",
    "saflite run night.toml --metrics 9464 --json-logs": f"{_SERVES}test_events.py",
    "saflite resume RUN --accept-loss": "only for books that lost commits: tests/unit/campaign/test_witness.py",
    "saflite regress RUN --target BUILD": "as `saflite regress runs/night --target BUILD`, which is run",
    "saflite regress RUN": "as `saflite regress runs/night --target BUILD`, on the same build",
    "saflite diff BUILD_A BUILD_B --campaign NAME": "two whole searches: tests/live/test_other_builds.py",
    "saflite bisect CASE BUILD BUILD ...": "a hundred flights: tests/live/test_other_builds.py",
    "saflite run policy-all": "a search over all policies: the soak and the benches run it",
    "saflite conformance target point_mass --module deploy/examples/targets/point_mass.py": "scripts/house runs it",
    "saflite run betaflight-failsafe": _BETAFLIGHT,
    "saflite run betaflight-policies": _BETAFLIGHT,
    "saflite run betaflight-msp": _BETAFLIGHT,
    "saflite export RUN --standalone TEST_CASE": _BETAFLIGHT,
}


def why_not(text: str) -> str:
    """Return why a command is not run, empty if that is not known."""
    if text in NOT_RUN:
        return NOT_RUN[text]
    if " --autopilot " in text:
        return _AUTOPILOT
    if text.startswith(("pip install ", "pipx ", "scripts/setup ")):
        return _INSTALLS
    return _SCRIPT if "scripts/" in text.partition(" saflite")[0] else ""
