"""Serve a target over MAVLink, for a ground station, an SDK, or another fuzzer.

Parameters, mission upload, arming, modes, commands, sticks and telemetry streams work as on ArduCopter. Endpoints:
tcp:HOST:PORT waits for ground stations, udp:HOST:PORT answers whoever writes to it, udpout:HOST:PORT talks to one.
Ctrl-C ends it.

examples:
  saflite sitl                                        then: mavproxy.py --master tcp:127.0.0.1:5760
  saflite sitl --endpoint udpout:127.0.0.1:14550      then: QGroundControl finds it by itself
  saflite sitl --defect parachute-in-acro --speed 5
"""

from __future__ import annotations

import argparse
import signal
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saflite.contract.test_case import TestCase


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("--target", default="", help="which target (see `saflite list targets`)")
    parser.add_argument("--endpoint", default="tcp:127.0.0.1:5760", help="tcp:, udp: or udpout:HOST:PORT")
    parser.add_argument("--speed", type=float, default=1.0, help="times real time (1); 0: as fast as it can")
    arguments.add_target_settings(parser)
    parser.add_argument("--parameter", action="append", default=[], metavar="NAME=NUMBER", help="set at start")
    parser.add_argument("--rng-seed", type=arguments.rng_seed, default=1, help="random seed of noise and gusts")


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from saflite.console.io import campaign_options
    from saflite.console.view import out
    from saflite.contract.test_case import Target
    from saflite.runtime.clock import WallClock
    from saflite.simulator_worker.registry import mavlink_server

    campaign_options.at_least("--speed", args.speed, 0.0)
    target = args.target or Target().name
    serve, case = mavlink_server(target), _case(target, args)
    asked: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda got, _frame: asked.append(got))

    def ready(name: str) -> None:
        out.line(f"serving {name}; Ctrl-C ends it")
        out.flush()

    serve(args.endpoint, WallClock(), test_case=case, speed=args.speed, stop=lambda: bool(asked), ready=ready)
    return 0


def _case(target: str, args: argparse.Namespace) -> TestCase:
    from saflite.console.io import cases
    from saflite.contract.test_case import Scenario, StartState, Target, TestCase
    from saflite.simulator_worker.registry import describe_target, load_target

    standing = (start for start in describe_target(target).start_states if not start.armed)
    start = next(standing, StartState(altitude_m=0.0, armed=False))
    case = cases.with_changes(
        TestCase(target=Target(name=target), scenario=Scenario(start=start), rng_seed=1),
        settings=args.target_set,
        defects=args.defect,
        parameters=args.parameter,
        rng_seed=args.rng_seed,
    )
    load_target(case.target.name).check(case)
    return case
