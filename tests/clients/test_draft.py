"""draft.py and pydronecan produce the bytes of the draft of 2014 that the Rust tests quote, and its
signatures.
"""

import re

import pytest
from draft import (
    BROADCAST,
    REQUEST,
    RESPONSE,
    fields,
    frames,
    identifier,
    new,
    pack,
    signature,
    unpack,
)

from conftest import ROOT

TOOL, NODE, AUTOPILOT = 127, 120, 1


def status(uptime, code, vendor=None):
    """Without a vendor code, or with one of 32 bits, it is a NodeStatus as before 2015-03-19."""
    low = vendor or 0
    whole = pack(
        new(
            "NodeStatus",
            uptime_sec=uptime,
            status_code=code,
            vendor_specific_status_code=low & 0xFFFF,
        )
    )
    if vendor is None:
        return whole[:4]
    return whole if vendor <= 0xFFFF else whole + (vendor >> 16).to_bytes(2, "little")


def commands(*all_commands):
    message = new("ArrayCommand")
    for actuator, command in all_commands:
        message.commands.append(new("Command", actuator_id=actuator, command=command))
    return pack(message)


def value(**kinds):
    made = new("Value")
    for kind, content in kinds.items():
        if kind == "string":
            text = new("ValueString")
            text.value.encode(content)
            content = text
        getattr(made, f"value_{kind}").append(content)
    return made


def get_set(name="", index=0, **kinds):
    request = new("GetSet", "request", index=index)
    request.value = value(**kinds)
    request.name.encode(name)
    return pack(request)


def parameter(name="", *numbers):
    """A GetSet response: value, default, maximum, minimum."""
    response = new("GetSet", "response")
    values = [value(int=number) for number in numbers] or [value()] * 4
    response.value, response.default_value, response.max_value, response.min_value = values
    response.name.encode(name)
    return pack(response)


def node_info():
    response = new("GetNodeInfo", "response")
    response.status = new(
        "NodeStatus", uptime_sec=10, status_code=1, vendor_specific_status_code=0x1234
    )
    response.software_version = new(
        "SoftwareVersion", major=1, minor=2, optional_field_mask=1, vcs_commit=0xDEADBEEF
    )
    response.hardware_version = new("HardwareVersion", major=1, minor=0, unique_id=list(range(16)))
    response.name.encode("org.example.servo")
    return pack(response)


def restart():
    return pack(new("RestartNode", "request", magic_number=0xACCE551B1E))


def restarted(ok):
    return pack(new("RestartNode", "response", ok=ok))


FOUR = (1, 0.5), (2, -1.0), (3, 0.25), (4, 1.0)
CASES = [
    (frames(550, BROADCAST, NODE, 3, status(0xABCDEF, 2)), "1135E00B EF CD AB 02"),
    (frames(550, BROADCAST, NODE, 3, status(0xABCDEF, 2, 0xBEEF)), "1135E00B EF CD AB 02 EF BE"),
    (
        frames(550, BROADCAST, AUTOPILOT, 0, status(0xF012345, 3, 0xDEADBEEF)),
        "11340408 45 23 01 F3 EF BE AD DE",
    ),
    (frames(760, BROADCAST, AUTOPILOT, 1, [90]), "17C40409 5A"),
    (frames(761, BROADCAST, NODE, 0, [23]), "17CDE008 17"),
    (frames(265, BROADCAST, AUTOPILOT, 1, commands(*FOUR[:1])), "084C0409 01 00 38"),
    (frames(265, BROADCAST, AUTOPILOT, 2, commands(*FOUR[:2])), "084C040A 01 00 38 02 00 BC"),
    (
        frames(265, BROADCAST, AUTOPILOT, 3, commands(*FOUR), name="ArrayCommand"),
        "084C0403 BE 8D 01 00 38 02 00 BC | 084C041B 03 00 34 04 00 3C",
    ),
    (frames(551, REQUEST, TOOL, 0, b"", NODE), "113BFC08 78"),
    (
        frames(551, RESPONSE, NODE, 5, node_info(), TOOL, "GetNodeInfo"),
        "1139E005 7F 7F 9B 0A 00 00 01 34 | 1139E015 7F 12 01 02 01 EF BE AD | 1139E025 7F DE 00 "
        "00 00 00 00 00 | "
        "1139E035 7F 00 00 01 00 00 01 02 | 1139E045 7F 03 04 05 06 07 08 09 | 1139E055 7F 0A 0B "
        "0C 0D 0E 0F 00 | "
        "1139E065 7F 6F 72 67 2E 65 78 61 | 1139E075 7F 6D 70 6C 65 2E 73 65 | 1139E08D 7F 72 76 "
        "6F",
    ),
    (frames(560, REQUEST, TOOL, 6, restart(), NODE), "1183FC0E 78 1E 1B 55 CE AC"),
    (frames(560, RESPONSE, NODE, 6, restarted(True), TOOL), "1181E00E 7F 80"),
    (frames(560, RESPONSE, NODE, 7, restarted(False), TOOL), "1181E00F 7F 00"),
    (frames(599, REQUEST, TOOL, 0, get_set(index=3), NODE), "12BBFC08 78 00 30"),
    (
        frames(599, REQUEST, TOOL, 1, get_set("OUT1_MIN"), NODE, "GetSet"),
        "12BBFC01 78 88 C3 00 04 F5 55 43 | 12BBFC19 78 15 F4 D4 94 E0",
    ),
    (
        frames(599, REQUEST, TOOL, 2, get_set("OUT1_MIN", int=1100), NODE, "GetSet"),
        "12BBFC02 78 2A F5 53 01 00 00 00 | 12BBFC12 78 00 00 00 00 04 F5 55 | 12BBFC2A 78 43 15 "
        "F4 D4 94 E0",
    ),
    (
        frames(599, REQUEST, TOOL, 3, get_set("ARM_REQ", bool=True), NODE, "GetSet"),
        "12BBFC03 78 86 E9 C0 02 0A 92 6A | 12BBFC1B 78 FA 92 2A 88",
    ),
    (
        frames(599, REQUEST, TOOL, 4, get_set("X", float=1.5), NODE),
        "12BBFC0C 78 20 00 18 07 E0 05 80",
    ),
    (
        frames(599, REQUEST, TOOL, 5, get_set("X", string="abc"), NODE),
        "12BBFC0D 78 10 D8 58 98 C0 16 00",
    ),
    (
        frames(
            599, RESPONSE, NODE, 2, parameter("OUT1_MIN", 1100, 1000, 2500, -500), TOOL, "GetSet"
        ),
        "12B9E002 7F 44 B2 53 01 00 00 00 | 12B9E012 7F 00 00 00 07 A0 0C 00 | 12B9E022 7F 00 00 "
        "00 00 00 71 02 | "
        "12B9E032 7F 40 00 00 00 00 00 04 | 12B9E042 7F 33 FB FF FF FF FF FF | 12B9E052 7F FC 4F "
        "55 54 31 5F 4D | "
        "12B9E06A 7F 49 4E",
    ),
    (frames(599, RESPONSE, NODE, 2, parameter(), TOOL), "12B9E00A 7F 00 00"),
]


@pytest.mark.parametrize(
    "made, quoted", CASES, ids=[quoted.split(" ", 1)[0] for _, quoted in CASES]
)
def test_the_rust_tests_quote_these_frames_of_the_draft(made, quoted):
    assert (
        " | ".join(f"{can_id:08X} {data.hex(' ').upper()}".strip() for can_id, data in made)
        == quoted
    )
    draft = ROOT / "host/dronecan/src/draft"
    text = re.sub(r"\\\n\s*", "", (draft / "tests.rs").read_text())
    assert f'"{quoted}"' in text or quoted in (draft / "golden.txt").read_text().splitlines()


@pytest.mark.parametrize(
    "constant, name",
    [
        ("NODE_STATUS", "NodeStatus"),
        ("ARRAY_COMMAND", "ArrayCommand"),
        ("GET_NODE_INFO", "GetNodeInfo"),
        ("RESTART_NODE", "RestartNode"),
        ("GET_SET", "GetSet"),
        (None, "Status"),
    ],
)
def test_the_signatures_equal_those_of_the_definitions(constant, name):
    text = (ROOT / "host/dronecan/src/draft/table.rs").read_text()
    digits = f"{signature(name):016X}"
    number = "0x" + "_".join(digits[at : at + 4] for at in range(0, 16, 4))
    wanted = (
        rf"{constant} = \w+\(.*{number}" if constant else rf'"draft.actuator.{name}", {number}'
    )
    assert re.search(wanted, text), f"{name} {number}"


def test_the_thesis_s_identifier_has_the_fields_that_the_thesis_states():
    assert identifier(760, BROADCAST, 1, 1) == 398722057
    assert fields(398722057) == (760, BROADCAST, 1, 1, 0, 1)


def test_packed_values_can_be_unpacked():
    message = unpack("NodeStatus", status(0xF012345, 3, 0x1234))
    assert (message.uptime_sec, message.status_code, message.vendor_specific_status_code) == (
        0xF012345,
        3,
        0x1234,
    )
    response = unpack("GetSet", parameter("OUT1_MIN", 1100, 1000, 2500, -500), "response")
    assert [
        v.value_int[0]
        for v in (response.value, response.default_value, response.max_value, response.min_value)
    ] == [1100, 1000, 2500, -500]
    assert response.name.decode() == "OUT1_MIN"
