"""The bytes that the Rust tests quote are what the installed pydronecan makes."""

import re

import pytest
from dronecan import thirdparty, uavcan
from dronecan.transport import Transfer

from conftest import ROOT


def command(actuator_id, command_type, value):
    return uavcan.equipment.actuator.Command(
        actuator_id=actuator_id, command_type=command_type, command_value=value
    )


def commands(*all_commands):
    message = uavcan.equipment.actuator.ArrayCommand()
    for each in all_commands:
        message.commands.append(command(*each))
    return message


def node_status():
    message = uavcan.protocol.NodeStatus(uptime_sec=0x12345678, health=1, mode=0, vendor_specific_status_code=0xBEEF)
    return message


HALF = (1, 0, 0.5)
CASES = {
    "NodeStatus": (node_status, 42, 24, 5, "1801552A 78 56 34 12 40 EF BE C5"),
    "ArrayCommand of one": (lambda: commands(HALF), 10, 16, 7, "1003F20A 01 00 00 38 C7"),
    "ArrayCommand of three": (
        lambda: commands(HALF, (2, 0, -1.0), (3, 4, 1500)),
        10,
        16,
        8,
        "1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68",
    ),
    "Temperature": (
        lambda: uavcan.equipment.device.Temperature(device_id=1, temperature=298.15),
        120,
        24,
        0,
        "18045678 01 00 A9 5C 00 C0",
    ),
    "thesis.ServoCommand": (lambda: thirdparty.thesis.ServoCommand(position=90), 1, 16, 3, "10045701 5A C3"),
    "thesis.DegreesCelsius": (lambda: thirdparty.thesis.DegreesCelsius(degrees=25), 120, 24, 1, "18045878 19 C1"),
}


def vector(message, source, priority, transfer_id):
    transfer = Transfer(
        payload=message, source_node_id=source, transfer_id=transfer_id, transfer_priority=priority, service_not_message=False
    )
    frames = transfer.to_frames()
    (identifier,) = {frame.message_id for frame in frames}
    return f"{identifier:08X} " + " | ".join(bytes(frame.bytes).hex(" ").upper() for frame in frames)


@pytest.mark.parametrize("name", CASES)
def test_pydronecan_makes_the_bytes_that_are_quoted(name):
    make, source, priority, transfer_id, expected = CASES[name]
    assert vector(make(), source, priority, transfer_id) == expected


@pytest.mark.parametrize(
    "file, name, quoted",
    [
        ("sim/src/dronecan/tests.rs", "NodeStatus", "whole"),
        ("sim/src/dronecan/tests.rs", "ArrayCommand of one", "whole"),
        ("sim/src/dronecan/tests.rs", "ArrayCommand of three", "whole"),
        ("src/dronecan/node_status.rs", "NodeStatus", "payload"),
        ("src/dronecan/temperature.rs", "Temperature", "payload"),
        ("tests/servo.rs", "ArrayCommand of one", "data"),
        ("tests/bad_input.rs", "ArrayCommand of three", "data"),
    ],
)
def test_the_rust_tests_quote_these_bytes(file, name, quoted):
    identifier, data = CASES[name][-1].split(" ", 1)
    text = (ROOT / file).read_text()
    if quoted == "whole":
        assert f'"{identifier} {data}"' in text
        return
    numbers = [bytes(int(n, 16) for n in re.findall(r"0x([0-9A-F]{2})\b", found)) for found in re.findall(r"\[([^\]]*)\]", text)]
    for frame in data.split(" | "):
        wanted = bytes.fromhex(frame)
        assert (wanted[:-1] if quoted == "payload" else wanted) in numbers
