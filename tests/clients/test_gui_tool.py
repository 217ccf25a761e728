"""The DroneCAN GUI Tool shows what the node measures: its own program, without a screen.

The tool has no panel for batteries and shafts. Its subscriber's window shows every message.
"make .venv/gui" installs it.
"""

import os
import re
import sys

import pytest
from dronecan import uavcan

from conftest import ROOT, node_elf, wait_until

DRIVER = ROOT / "tests/clients/gui_tool.py"


class GuiTool:
    """The tool on the bench's SLCAN adapter, with its subscriber's window for a type of message."""

    def __init__(self, bench, data_type):
        directory = bench.directory / "gui"
        directory.mkdir()
        self.shown, self.log = directory / "shown.txt", directory / "log.txt"
        self.picture = directory / "picture.png"
        with open(self.shown, "wb") as shown, open(self.log, "wb") as log:
            self.process = bench.start(
                sys.executable,
                DRIVER,
                f"slcan:{bench.slcan[0]}",
                data_type,
                self.picture,
                stdout=shown,
                stderr=log,
                # The tool leaves a log there.
                env={**os.environ, "TMPDIR": str(directory)},
            )

    def messages(self):
        """The numbers of each message that the window has shown, by the names of the fields."""
        assert self.process.poll() is None, self.log.read_text()
        # The last one may not be complete.
        blocks = self.shown.read_text().split("### Message from 120 to All ")[1:-1]
        return [
            {name: float(number) for name, number in re.findall(r"^(\w+): ([\w.-]+)", block, re.M)}
            for block in blocks
        ]


def eeprom_with(bench, elf, parameters):
    """The EEPROM of a board on which these parameters have been saved."""
    used = bench(elf=elf)
    client = used.dronecan()
    for name, value in parameters.items():
        client.set(name, value)
    client.save()
    used.end()
    return used.eeprom(0).read_bytes()


def test_the_gui_tool_shows_the_battery(bench, tmp_path):
    """18 A from 12.6 V are drawn for 15 s, 75 mAh of 375, and then none."""
    elf = node_elf("full", board="uno")
    # A divider of 10 and 1 kOhm, and 0.2 V for an ampere.
    parameters = {"PWR1_VOLT_MULT": 11000, "PWR1_AMP_PERVLT": 500, "BATT_CAPACITY": 375}
    parameters |= {"BATT_ID": 5, "BATT_TEMP": 1, "BATT_RATE": 5}
    eeprom = eeprom_with(bench, elf, parameters)
    script = tmp_path / "script"
    script.write_text("(15.0) pwr-current 0\n")
    options = ["--pwr-voltage", "1145", "--pwr-current", "3600", "--temperature", "30"]
    used = bench(*options, "--script", script, elf=elf, eeproms=[eeprom])
    tool = GuiTool(used, "uavcan.equipment.power.BatteryInfo")

    def after_the_current():
        messages = tool.messages()
        return messages if messages and messages[-1]["current"] == 0 else None

    messages = wait_until(after_the_current, "BatteryInfo without a current", timeout=60)
    for message in messages:
        assert message["voltage"] == pytest.approx(12.6, abs=0.08)
        assert message["temperature"] == pytest.approx(273.15 + 30, abs=0.6)
        assert message["full_charge_capacity_wh"] == pytest.approx(0.375 * 12.6, abs=0.07)
        assert message["battery_id"] == 5 and message["state_of_health_pct"] == 127
        assert message["status_flags"] == uavcan.equipment.power.BatteryInfo().STATUS_FLAG_IN_USE
    drawn = [message for message in messages if message["current"] == pytest.approx(18, abs=0.08)]
    charges = [message["state_of_charge_pct"] for message in drawn]
    assert 100 > charges[0] > charges[-1] and charges == sorted(charges, reverse=True)
    # The node measures a fraction of a second after power-on for the first time.
    last = messages[-1]
    assert last["state_of_charge_pct"] in (80, 81)
    assert last["remaining_capacity_wh"] == pytest.approx(0.3 * 12.6, abs=0.07)
    wait_until(tool.picture.exists, "picture of the window")


def test_the_gui_tool_shows_the_revolutions_of_a_shaft(bench):
    elf = node_elf("rpm", board="uno")
    eeprom = eeprom_with(bench, elf, {"RPM_ID": 3, "RPM_RATE": 5, "RPM_PULSES": 2})
    tool = GuiTool(
        bench("--rpm", "12034", elf=elf, eeproms=[eeprom]), "dronecan.sensors.rpm.RPM"
    )
    message = wait_until(lambda: tool.messages()[2:], "three RPM", timeout=60)[0]
    assert (message["sensor_id"], message["flags"]) == (3, 0)
    assert message["rpm"] == pytest.approx(12034 / 2, rel=0.002)
