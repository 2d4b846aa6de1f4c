"""@DESCRIPTION@"""

# A template: `export.py` beside it puts the facts of a finding in. What it makes runs in ArduPilot's own autotest.

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import arducopter  # type: ignore[import-not-found]
from pymavlink import mavutil
from vehicle_test_suite import NotAchievedException  # type: ignore[import-not-found]

FACTS: dict[str, Any] = json.loads(r"""{"@FACTS@": 0}""")
GUIDED, START_MISSION, TAKEOFF = "GUIDED", 300, 22
CLIMB_S, SETTLE_S, RULE_BROKEN = 90, 30, 1


class Findings(arducopter.AutoTestCopter):  # type: ignore[misc]
    """ArduPilot's suite for Copter with one case; to keep it, move the method and its line of `tests` to that suite."""

    def buildlogs_dirpath(self) -> str:
        """Return where its logs go."""
        return str(self.logs_dir)

    def sitl_start_location(self) -> Any:
        """Return where it flies: latitude, longitude in degrees, height above sea in metres, heading in degrees."""
        return mavutil.location(*FACTS["home"])

    def tests(self) -> list[Any]:
        """Return the one case."""
        return [self.SafliteFinding]

    def SafliteFinding(self) -> None:  # noqa: N802  (autotest's cases are named so)
        """Fly a finding's inputs at their times; the rule must hold and the autopilot live"""
        if FACTS["parameters"]:
            self.set_parameters(FACTS["parameters"])
            self.reboot_sitl()
        self._reach_start()
        began_s = self.get_sim_time()
        for one in FACTS["inputs"]:
            self._wait_until(began_s + one["at_s"])
            self._give(one)
        self._wait_until(began_s + FACTS["limit_s"])
        self.wait_heartbeat()
        self.disarm_vehicle(force=True)
        self._judge()

    def _reach_start(self) -> None:
        if FACTS["items"]:
            self._upload()
        self.set_rc(3, 1000)
        if not FACTS["armed"] and not FACTS["items"]:
            self.change_mode(FACTS["mode_name"])
            return
        flies = bool(FACTS["items"]) or FACTS["altitude_m"] > 0
        self.change_mode(GUIDED if flies else FACTS["mode_name"])
        self.wait_ready_to_arm()
        self.arm_vehicle()
        if FACTS["items"]:
            self.set_rc(3, 1500)
            self.run_cmd(START_MISSION)
        elif flies:
            height_m = FACTS["altitude_m"]
            self.run_cmd(TAKEOFF, p7=height_m)
            self.wait_altitude(height_m - 0.5, height_m + 0.5, relative=True, timeout=CLIMB_S)
            self.set_rc(3, 1500)
            self._wait_until(self.get_sim_time() + SETTLE_S)
            self.change_mode(FACTS["mode_name"])

    def _upload(self) -> None:
        items = []
        for number, (frame, command, current, more, *numbers, x, y, z) in enumerate(FACTS["items"]):
            fields = (int(frame), int(command), int(current), int(more), *numbers, int(x), int(y), z, 0)
            items.append(self.mav.mav.mission_item_int_encode(1, 1, number, *fields))
        self.check_mission_upload_download(items)

    def _wait_until(self, time_s: float) -> None:
        left_s = time_s - self.get_sim_time()
        if left_s > 0:
            self.delay_sim_time(left_s)

    def _give(self, one: dict[str, Any]) -> None:
        self.progress(f"given: {one['kind']} {one['name']} {one['values']}")
        if one["kind"] == "stick":
            self.set_rc(int(one["name"][2:]), round(min(2200, max(800, one["values"][0]))))
        elif one["kind"] in ("parameter", "sensor_fault"):
            self.set_parameter(one["name"], one["values"][0] if one["values"] else 1.0)
        elif "placed" in one:
            self.mav.mav.command_int_send(1, 1, *one["placed"])
        else:
            values = [*one["values"], *[0.0] * 7][:7]
            self.send_cmd(one["number"], **{f"p{place + 1}": value for place, value in enumerate(values)})

    def _judge(self) -> None:
        """Have the rule judged on the log, where the farm's command is installed; else tell how to."""
        log = self.current_onboard_log_filepath()
        words = ["saflite", "judge", str(log), "--policy", FACTS["policy"]]
        if shutil.which(words[0]) is None:
            self.progress(f"The rule: {FACTS['title']}. To judge it: {' '.join(words)}")
        elif subprocess.run(words, check=False).returncode == RULE_BROKEN:
            raise NotAchievedException(f"rule broken: {FACTS['title']}")


def main() -> int:
    """Run the case; 0 when it passed: the finding did not show."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=Path, help="ArduCopter built for SITL")
    parser.add_argument("--speedup", type=float, default=10.0)
    options = parser.parse_args()
    binary = str(options.binary.resolve())
    os.chdir(Path(arducopter.__file__).parents[2])  # it looks for its files from there
    logs = tempfile.mkdtemp(prefix="autotest-")
    return 0 if Findings(binary, speedup=options.speedup, frame="X", logs_dir=logs).autotest() else 1


if __name__ == "__main__":
    sys.exit(main())
