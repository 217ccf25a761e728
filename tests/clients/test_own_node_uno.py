"""own-node on a simulated Uno and Diecimila, on arduino-hal: scripts/own-node-uno builds it."""

import re

import pytest
from dronecan import uavcan

from conftest import TARGET, run_sim, wait_until

protocol = uavcan.protocol
CHIPS = {"uno": "atmega328p", "diecimila": "atmega168"}
OWN_NODE = 42
# More frames of eight bytes than a bus of 1 Mbit/s has room for.
FILLER_US = 125

pytestmark = [
    pytest.mark.parametrize("board", CHIPS),
    pytest.mark.skipif(
        not (TARGET / "own-node/diecimila.elf").exists(), reason="make own-node-uno builds it"
    ),
]


def elf(board):
    return TARGET / f"own-node/{board}.elf"


def wiring(board):
    return ["--mcu", CHIPS[board], "--cs", "D10", "--int", "D2", "--crystal", "16", "--servo", "D9"]


@pytest.mark.parametrize(
    "autopilot",
    [
        ["ardupilot"],
        ["px4"],
        ["ardupilot", "--motors", "20", "--motor-rate", "400"],
        ["ardupilot", "--script", "full"],
    ],
    ids=["ardupilot", "px4", "motors", "full-bus"],
)
def test_no_frame_is_lost_and_each_command_moves_the_servo(board, autopilot, tmp_path):
    with (tmp_path / "full").open("w") as script:
        for number in range(5_000_000 // FILLER_US):
            time = number * FILLER_US / 1e6
            print(f"({time:.6f}) can0 1F4{number % 16:X}0014#{number:016X}", file=script)
    options = ["--strict", "--for", "5s", *wiring(board), "--autopilot", *autopilot]
    text = run_sim(tmp_path, *options, elf=elf(board))
    assert "0 frames lost, 0 driver mistakes" in text
    # The chip takes 5 ms to start, and the autopilot moves the servo each 20 ms.
    pulses, commands = re.search(r"^servo +(\d+) pulses for (\d+) commands", text, re.M).groups()
    assert int(commands) == 250 and int(pulses) >= 248
    loads = [float(load) for load in re.findall(r" bus +([\d.]+) %", text)]
    assert "full" not in autopilot or min(loads[1:]) > 98, loads


def test_pydronecan_reads_sets_saves_and_restarts(bench, board):
    started = bench(*wiring(board), "--temperature", "30", elf=elf(board), fresh=True)
    started.wait_for_text("serial  on the bus")
    client = started.dronecan()
    info = client.ask(protocol.GetNodeInfo.Request(), OWN_NODE)
    assert str(info.name) == "org.example.own-node"
    temperature = client.wait_for(uavcan.equipment.device.Temperature, source=OWN_NODE)
    assert temperature.temperature == pytest.approx(303.15, abs=0.3)

    def moves_to(actuator, width_us):
        client.command((2, 0, -0.25), (actuator, 0, 0.5))
        wait_until(lambda: started.pulse_us() == pytest.approx(width_us, abs=1), "pulse")

    moves_to(1, 1750)
    client.set("ACTUATOR_ID", 2, OWN_NODE)
    moves_to(9, 1375)
    client.save(OWN_NODE)
    # Saved, though the restart is asked for at once.
    restart = protocol.RestartNode.Request()
    restart.magic_number = restart.MAGIC_NUMBER
    assert client.ask(restart, OWN_NODE).ok
    client.spin_until(
        lambda: client.wait_for(protocol.NodeStatus, source=OWN_NODE).uptime_sec == 0, "restart"
    )
    assert client.get("ACTUATOR_ID", OWN_NODE) == 2
    assert client.get("NODE_ID", OWN_NODE) == OWN_NODE
    moves_to(9, 1375)


def test_the_monitor_names_a_missing_chip(bench, board):
    started = bench(*wiring(board), "--inject", "chip-power@0s", elf=elf(board), fresh=True)
    started.wait_for_text("serial  CAN: no MCP2515")
