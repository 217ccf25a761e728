"""The installed pydronecan produces the bytes that the Rust tests quote."""

import math
import re

import dronecan
import pytest
from dronecan import thirdparty, uavcan
from dronecan.transport import Transfer

from conftest import ROOT

TESTS, GOLDEN = "host/dronecan/src/tests.rs", "host/dronecan/src/golden.txt"


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
    message = uavcan.protocol.NodeStatus(
        uptime_sec=0x12345678, health=1, mode=0, vendor_specific_status_code=0xBEEF
    )
    return message


protocol = uavcan.protocol
EMPTY = protocol.param.Empty()


def get_set(name="", index=0, **value):
    request = protocol.param.GetSet.Request(index=index, name=name)
    request.value = protocol.param.Value(**(value or {"empty": EMPTY}))
    return request


def parameter(name="", *numbers):
    """A GetSet response: value, default, maximum, minimum."""
    value, default, highest, lowest = [{"integer_value": number} for number in numbers] or [
        {"empty": EMPTY}
    ] * 4
    response = protocol.param.GetSet.Response(name=name)
    response.value, response.default_value = (
        protocol.param.Value(**value),
        protocol.param.Value(**default),
    )
    response.max_value = protocol.param.NumericValue(**highest)
    response.min_value = protocol.param.NumericValue(**lowest)
    return response


def rpm(sensor_id, speed, flags=0):
    return dronecan.dronecan.sensors.rpm.RPM(sensor_id=sensor_id, flags=flags, rpm=speed)


def lights(*all_lights):
    message = uavcan.equipment.indication.LightsCommand()
    for light_id, red, green, blue in all_lights:
        color = uavcan.equipment.indication.RGB565(red=red, green=green, blue=blue)
        message.commands.append(
            uavcan.equipment.indication.SingleLightCommand(light_id=light_id, color=color)
        )
    return message


def raw_command(*throttles):
    message = uavcan.equipment.esc.RawCommand()
    for each in throttles:
        message.cmd.append(each)
    return message


def transport_stats():
    stats = protocol.GetTransportStats.Response(
        transfers_tx=1, transfers_rx=0x123456789ABC, transfer_errors=3
    )
    stats.can_iface_stats.append(protocol.CANIfaceStats(frames_tx=4, frames_rx=5, errors=6))
    return stats


def can_stats():
    return dronecan.dronecan.protocol.CanStats(
        interface=0,
        tx_requests=0x01020304,
        tx_rejected=1,
        tx_overflow=2,
        tx_success=3,
        tx_timedout=4,
        tx_abort=5,
        rx_received=0x0A0B0C0D,
        rx_overflow=6,
        rx_errors=7,
        busoff_errors=8,
    )


def battery_info(**known):
    """As the node at 12.5 V and 10 A sends it: what is not `known` is NaN, or 127."""
    unknown = {
        "temperature": math.nan,
        "remaining_capacity_wh": math.nan,
        "full_charge_capacity_wh": math.nan,
        "status_flags": 1,
        "state_of_charge_pct": 127,
        "battery_id": 0,
    }
    return uavcan.equipment.power.BatteryInfo(
        voltage=12.5,
        current=10.0,
        average_power_10sec=math.nan,
        hours_to_full_charge=0.0,
        state_of_health_pct=127,
        state_of_charge_pct_stdev=127,
        **{**unknown, **known},
    )


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
    "ArrayCommand of fifteen": (
        lambda: commands(*[(n, 0, (n - 8) / 8) for n in range(1, 16)]),
        10,
        8,
        0,
        "0803F20A C8 B8 01 00 00 BB 02 80 | 00 00 BA 03 00 00 B9 20 | 04 00 00 B8 05 00 00 00 | "
        "B6 06 00 00 B4 07 00 20 | 00 B0 08 00 00 00 09 00 | 00 00 30 0A 00 00 34 20 | "
        "0B 00 00 36 0C 00 00 00 | 38 0D 00 00 39 0E 00 20 | 00 3A 0F 00 00 3B 40",
    ),
    "ArrayCommand of eight": (
        lambda: commands(*[(n, 0, (n - 4) / 4) for n in range(8)]),
        1,
        6,
        0,
        "0603F201 0E 49 00 00 00 BC 01 80 | 00 00 BA 02 00 00 B8 20 | 03 00 00 B4 04 00 00 00 | "
        "00 05 00 00 34 06 00 20 | 00 38 07 00 00 3A 40",
    ),
    "ArrayCommand with one ID twice": (
        lambda: commands((1, 0, -1.0), (2, 0, 0.25), (1, 0, 0.5)),
        10,
        16,
        4,
        "1003F20A 08 1A 01 00 00 BC 02 84 | 00 00 34 01 00 00 38 64",
    ),
    "LightsCommand of three": (
        lambda: lights((5, 31, 21, 9), (6, 1, 63, 30), (7, 1, 63, 30)),
        10,
        24,
        1,
        "1804390A BA 95 05 FA A9 06 0F 81 | FE 07 0F FE 61",
    ),
    "CanStats": (
        can_stats,
        120,
        24,
        3,
        "18015778 63 D2 00 04 03 02 01 83 | 01 00 02 00 03 00 04 23 | 00 05 00 0D 0C 0B 0A 03 | 06 "
        "00 07 00 08 00 63",
    ),
    "KeyValue": (
        lambda: protocol.debug.KeyValue(value=3.0, key="btn"),
        120,
        24,
        1,
        "183FF278 00 00 40 40 62 74 6E C1",
    ),
    "LogMessage": (
        lambda: protocol.debug.LogMessage(
            level=protocol.debug.LogLevel(value=2), source="", text="FAILSAFE of output 1"
        ),
        120,
        24,
        0,
        "183FFF78 7B AB 40 46 41 49 4C 80 | 53 41 46 45 20 6F 66 20 | 20 6F 75 74 70 75 74 00 | "
        "20 31 60",
    ),
    "Button": (
        lambda: dronecan.ardupilot.indication.Button(button=1, press_time=10),
        120,
        24,
        9,
        "184E2178 01 0A C9",
    ),
    "NotifyState": (
        lambda: dronecan.ardupilot.indication.NotifyState(
            aux_data_type=0, aux_data=[0xA0, 0x8C], vehicle_state=0b11010
        ),
        10,
        24,
        1,
        "184E270A 46 6F 00 02 A0 8C 1A 81 | 00 00 00 00 00 00 00 61",
    ),
    "CircuitStatus": (
        lambda: uavcan.equipment.power.CircuitStatus(
            circuit_id=0x1234, voltage=12.6, current=-3.2, error_flags=6
        ),
        120,
        24,
        5,
        "18044378 34 12 4D 4A 66 C2 06 C5",
    ),
    "BatteryInfo": (
        lambda: uavcan.equipment.power.BatteryInfo(
            temperature=310.5,
            voltage=25.2,
            current=-3.2,
            average_power_10sec=80.0,
            remaining_capacity_wh=40.0,
            full_charge_capacity_wh=50.0,
            hours_to_full_charge=1.5,
            status_flags=0x10B,
            state_of_health_pct=93,
            state_of_charge_pct=80,
            state_of_charge_pct_stdev=5,
            battery_id=3,
            model_instance_id=0x12345678,
            model_name="LiPo 6S",
        ),
        120,
        24,
        9,
        "18044478 AA 24 DA 5C 4D 4E 66 89 | C2 00 55 00 51 40 52 29 | 00 3E 0B 37 68 05 03 09 | "
        "78 56 34 12 4C 69 50 29 | 6F 20 36 53 49",
    ),
    "BatteryInfo of nothing known": (
        lambda: battery_info(),
        120,
        24,
        0,
        "18044478 E8 B5 FF 7F 40 4A 00 80 | 49 FF 7F FF 7F FF 7F 20 | 00 00 01 1F FF FF 00 00 | "
        "00 00 00 00 60",
    ),
    "hardpoint.Command": (
        lambda: uavcan.equipment.hardpoint.Command(hardpoint_id=1, command=1),
        10,
        24,
        0,
        "18042E0A 01 01 00 C0",
    ),
    "hardpoint.Command of a mask": (
        lambda: uavcan.equipment.hardpoint.Command(hardpoint_id=5, command=0x1234),
        10,
        16,
        3,
        "10042E0A 05 34 12 C3",
    ),
    "hardpoint.Status": (
        lambda: uavcan.equipment.hardpoint.Status(
            hardpoint_id=5, payload_weight=9.5, payload_weight_variance=0.25, status=0
        ),
        120,
        24,
        2,
        "18042F78 05 C0 48 00 34 00 00 C2",
    ),
    "RPM of 6,000": (lambda: rpm(3, 6000), 120, 24, 2, "18041578 03 00 00 00 80 BB 45 C2"),
    "RPM of 60,000": (lambda: rpm(255, 60_000), 120, 24, 0, "18041578 FF 00 00 00 60 6A 47 C0"),
    "RPM of 61.75": (lambda: rpm(0, 61.75), 120, 24, 5, "18041578 00 00 00 00 00 77 42 C5"),
    "RPM that is unhealthy": (
        lambda: rpm(0, 0, dronecan.dronecan.sensors.rpm.RPM().FLAGS_UNHEALTHY),
        120,
        24,
        5,
        "18041578 00 01 00 00 00 00 00 C5",
    ),
    "RawCommand of none": (raw_command, 1, 0, 4, "00040601 C4"),
    "RawCommand of four": (
        lambda: raw_command(8191, -8192, 0, -1),
        10,
        7,
        1,
        "0704060A FF 7C 02 00 00 3F FF C1",
    ),
    "RawCommand of eight": (
        lambda: raw_command(8191, -8192, 0, -1, 4096, 1, 100, 4660),
        10,
        7,
        2,
        "0704060A 1C 29 FF 7C 02 00 00 82 | 3F FF 00 40 04 06 40 22 | 0D 12 42",
    ),
    "RawCommand of twenty": (
        lambda: raw_command(*range(400, 8001, 400)),
        10,
        7,
        3,
        "0704060A 0D 57 90 04 80 3B 01 83 | 10 06 D0 1D 80 9F 02 23 | A0 0C 10 3A 80 F3 04 03 | 70 "
        "12 50 53 81 57 05 23 | "
        "C0 19 90 68 81 CB 07 03 | 50 1F 63",
    ),
    "SafetyState": (
        lambda: dronecan.ardupilot.indication.SafetyState(status=255),
        10,
        24,
        2,
        "184E200A FF C2",
    ),
    "thesis.ServoCommand": (
        lambda: thirdparty.thesis.ServoCommand(position=90),
        1,
        16,
        3,
        "10045701 5A C3",
    ),
}


# Requests from node 127 to node 120 and the responses, as quoted in tests/boards/services.rs and in
# the tests of the simulator's decoder.
SERVICES = [
    (protocol.GetNodeInfo.Request, True, 3, "1E01F8FF C3"),
    (get_set, True, 0, "1E0BF8FF 00 00 C0"),
    (lambda: get_set(index=300), True, 2, "1E0BF8FF 2C 08 C2"),
    (lambda: get_set("CAN_NODE"), True, 2, "1E0BF8FF AC 76 00 00 43 41 4E 82 | 5F 4E 4F 44 45 62"),
    (
        lambda: get_set("OUT1_MIN", integer_value=1100),
        True,
        4,
        "1E0BF8FF 4C EE 00 01 4C 04 00 84 | 00 00 00 00 00 4F 55 24 | 54 31 5F 4D 49 4E 44",
    ),
    (
        lambda: get_set("OUT1_MIN", real_value=1100.0),
        True,
        5,
        "1E0BF8FF 3A DA 00 02 00 80 89 85 | 44 4F 55 54 31 5F 4D 25 | 49 4E 45",
    ),
    (
        lambda: get_set("ARM_REQ", boolean_value=1),
        True,
        6,
        "1E0BF8FF 85 7E 00 03 01 41 52 86 | 4D 5F 52 45 51 66",
    ),
    (
        lambda: get_set("OUT1_MIN", string_value="abc"),
        True,
        7,
        "1E0BF8FF 72 AD 00 04 03 61 62 87 | 63 4F 55 54 31 5F 4D 27 | 49 4E 47",
    ),
    (
        lambda: parameter("CAN_NODE", 120, 120, 125, 0),
        False,
        0,
        "1E0B7FF8 CE 06 01 78 00 00 00 80 | 00 00 00 00 01 78 00 20 | 00 00 00 00 00 00 01 00 | "
        "7D 00 00 00 00 00 00 20 | 00 01 00 00 00 00 00 00 | 00 00 00 43 41 4E 5F 20 | 4E 4F 44 45 "
        "40",
    ),
    (
        lambda: parameter("OUT1_MIN", 1100, 1000, 2500, 500),
        False,
        4,
        "1E0B7FF8 00 32 01 4C 04 00 00 84 | 00 00 00 00 01 E8 03 24 | 00 00 00 00 00 00 01 04 | "
        "C4 09 00 00 00 00 00 24 | 00 01 F4 01 00 00 00 04 | 00 00 00 4F 55 54 31 24 | 5F 4D 49 4E "
        "44",
    ),
    (
        lambda: parameter("OUT1_MIN", 1000, 1000, 2500, 500),
        False,
        5,
        "1E0B7FF8 69 5B 01 E8 03 00 00 85 | 00 00 00 00 01 E8 03 25 | 00 00 00 00 00 00 01 05 | "
        "C4 09 00 00 00 00 00 25 | 00 01 F4 01 00 00 00 05 | 00 00 00 4F 55 54 31 25 | 5F 4D 49 4E "
        "45",
    ),
    (
        lambda: parameter("TEMP_MIN", -40, -40, 150, -55),
        False,
        9,
        "1E0B7FF8 7E 1C 01 D8 FF FF FF 89 | FF FF FF FF 01 D8 FF 29 | FF FF FF FF FF FF 01 09 | "
        "96 00 00 00 00 00 00 29 | 00 01 C9 FF FF FF FF 09 | FF FF FF 54 45 4D 50 29 | 5F 4D 49 4E "
        "49",
    ),
    (parameter, False, 2, "1E0B7FF8 00 00 00 00 C2"),
    (
        lambda: protocol.param.ExecuteOpcode.Request(opcode=0),
        True,
        4,
        "1E0AF8FF 00 00 00 00 00 00 00 C4",
    ),
    (
        lambda: protocol.param.ExecuteOpcode.Request(opcode=1),
        True,
        5,
        "1E0AF8FF 01 00 00 00 00 00 00 C5",
    ),
    (
        lambda: protocol.param.ExecuteOpcode.Response(ok=True),
        False,
        4,
        "1E0A7FF8 00 00 00 00 00 00 80 C4",
    ),
    (
        lambda: protocol.RestartNode.Request(magic_number=0xACCE551B1E),
        True,
        6,
        "1E05F8FF 1E 1B 55 CE AC C6",
    ),
    (lambda: protocol.RestartNode.Response(ok=True), False, 6, "1E057FF8 80 C6"),
    (lambda: protocol.RestartNode.Response(ok=False), False, 7, "1E057FF8 00 C7"),
    (
        lambda: protocol.file.BeginFirmwareUpdate.Request(
            source_node_id=127, image_file_remote_path=protocol.file.Path(path="fw.bin")
        ),
        True,
        9,
        "1E28F8FF 7F 66 77 2E 62 69 6E C9",
    ),
    (
        transport_stats,
        False,
        10,
        "1E047FF8 F9 20 01 00 00 00 00 8A | 00 BC 9A 78 56 34 12 2A | 03 00 00 00 00 00 04 0A | "
        "00 00 00 00 00 05 00 2A | 00 00 00 00 06 00 00 0A | 00 00 00 6A",
    ),
]


def vector(message, source, priority, transfer_id):
    transfer = Transfer(
        payload=message,
        source_node_id=source,
        transfer_id=transfer_id,
        transfer_priority=priority,
        service_not_message=False,
    )
    frames = transfer.to_frames()
    (identifier,) = {frame.message_id for frame in frames}
    return f"{identifier:08X} " + " | ".join(
        bytes(frame.bytes).hex(" ").upper() for frame in frames
    )


def with_joined_strings(path):
    """The text of a Rust test, with its multi-line strings joined, or each line as a string."""
    text = (ROOT / path).read_text()
    if path.endswith(".txt"):
        return "\n".join(f'"{line}"' for line in text.splitlines())
    return re.sub(r"\\\n\s*", "", text)


@pytest.mark.parametrize("make, is_request, transfer_id, expected", SERVICES)
def test_pydronecan_produces_the_quoted_requests_and_responses(
    make, is_request, transfer_id, expected
):
    transfer = Transfer(
        payload=make(),
        source_node_id=127 if is_request else 120,
        dest_node_id=120 if is_request else 127,
        transfer_id=transfer_id,
        transfer_priority=30,
        service_not_message=True,
        request_not_response=is_request,
    )
    frames = transfer.to_frames()
    assert (
        f"{frames[0].message_id:08X} " + " | ".join(bytes(f.bytes).hex(" ").upper() for f in frames)
        == expected
    )
    data = expected.split(" ", 1)[1]
    assert any(
        f" {data}" in with_joined_strings(path)
        for path in ("tests/boards/services.rs", TESTS, GOLDEN)
    )


@pytest.mark.parametrize("name", CASES)
def test_pydronecan_produces_the_quoted_messages(name):
    make, source, priority, transfer_id, expected = CASES[name]
    assert vector(make(), source, priority, transfer_id) == expected


@pytest.mark.parametrize(
    "file, name, quoted",
    [
        (GOLDEN, "NodeStatus", "whole"),
        (GOLDEN, "ArrayCommand of one", "whole"),
        (GOLDEN, "ArrayCommand of three", "whole"),
        ("tests/boards/servo.rs", "ArrayCommand of one", "data"),
        (GOLDEN, "LightsCommand of three", "whole"),
        (GOLDEN, "CanStats", "whole"),
        (GOLDEN, "KeyValue", "whole"),
        (GOLDEN, "SafetyState", "whole"),
        (GOLDEN, "Button", "whole"),
        (GOLDEN, "LogMessage", "whole"),
        (GOLDEN, "CircuitStatus", "whole"),
        (TESTS, "BatteryInfo", "whole"),
        (GOLDEN, "BatteryInfo of nothing known", "whole"),
        (GOLDEN, "hardpoint.Command", "whole"),
        (GOLDEN, "hardpoint.Command of a mask", "whole"),
        (GOLDEN, "hardpoint.Status", "whole"),
        (GOLDEN, "RPM of 6,000", "whole"),
        (GOLDEN, "RPM of 60,000", "whole"),
        (GOLDEN, "RPM of 61.75", "whole"),
        (GOLDEN, "RPM that is unhealthy", "whole"),
        (GOLDEN, "RawCommand of none", "whole"),
        (GOLDEN, "RawCommand of four", "whole"),
        (GOLDEN, "RawCommand of eight", "whole"),
        (GOLDEN, "RawCommand of twenty", "whole"),
        ("tests/boards/long_commands.rs", "ArrayCommand of fifteen", "whole"),
        ("tests/boards/long_commands.rs", "ArrayCommand of eight", "whole"),
        ("tests/boards/long_commands.rs", "ArrayCommand with one ID twice", "whole"),
    ],
)
def test_the_rust_tests_quote_these_messages(file, name, quoted):
    identifier, data = CASES[name][-1].split(" ", 1)
    text = with_joined_strings(file)
    if quoted == "whole":
        assert f'"{identifier} {data}"' in text
        return
    numbers = [
        bytes(int(n, 16) for n in re.findall(r"0x([0-9A-F]{2})\b", found))
        for found in re.findall(r"\[([^\]]*)\]", text)
    ]
    for frame in data.split(" | "):
        wanted = bytes.fromhex(frame)
        assert (wanted[:-1] if quoted == "payload" else wanted) in numbers
