"""The node and the simulated autopilot in the draft of 2014, as a client sees them that knows only draft.py."""

import re
import time

import pytest
from draft import BROADCAST, REQUEST, RESPONSE, fields, frames, new, pack, signature, unpack
from dronecan.dsdl.common import bytes_from_crc64, crc16_from_bytes

from conftest import NODE, PATIENCE_S, node_elf

AUTOPILOT, TOOL = 1, 126
LINE = re.compile(rb"T([0-9A-F]{8})([0-8])((?:[0-9A-F]{2})*)[^\r]*\r")


class Listener:
    """An SLCAN adapter that reads and writes frames of the draft."""

    def __init__(self, raw):
        self.raw = raw
        self.text = b""
        raw.write_all(b"C\rS8\rO\r")

    def hear(self, seconds):
        """(identifier, data) of what passes within that time."""
        end = time.monotonic() + seconds
        heard = []
        while time.monotonic() < end:
            self.text += self.raw.read(0.05)
            last = 0
            for line in LINE.finditer(self.text):
                heard.append((int(line[1], 16), bytes.fromhex(line[3].decode())))
                last = line.end()
            self.text = self.text[last:]
        return heard

    def ask(self, type_id, payload, name, transfer_id):
        """The payload of the node's response to a request."""
        for can_id, data in frames(type_id, REQUEST, TOOL, transfer_id, payload, NODE, name):
            self.raw.write_all(f"T{can_id:08X}{len(data)}{data.hex().upper()}\r".encode())
        end = time.monotonic() + PATIENCE_S
        parts = []
        while time.monotonic() < end:
            for can_id, data in self.hear(0.1):
                found_type, transfer_type, source, number, index, last = fields(can_id)
                if (found_type, transfer_type, source, data[:1]) != (type_id, RESPONSE, NODE, bytes([TOOL])):
                    continue
                assert (number, index) == (transfer_id, len(parts))
                parts.append(data[1:])
                if last:
                    return joined(parts, name)
        raise AssertionError(f"no response from {type_id}, only {parts}")


def joined(parts, name):
    """A payload of its parts, whose CRC must be right if there are several."""
    stream = b"".join(parts)
    if len(parts) == 1:
        return stream
    crc, payload = int.from_bytes(stream[:2], "little"), stream[2:]
    assert crc == crc16_from_bytes(payload, initial=crc16_from_bytes(bytes_from_crc64(signature(name))))
    return payload


def data_of(heard, type_id, source):
    return [data for can_id, data in heard if fields(can_id)[:3] == (type_id, BROADCAST, source)]


def on_the_bus(bench, *options):
    used = bench("--dialect", "draft", *options, autopilot=True, elf=node_elf("thesis"))
    listener = Listener(used.raw())
    used.wait_for_text(rf"status  node {NODE}: draft, OK")
    return used, listener


@pytest.mark.parametrize("options, type_id, command", [
    (["--autopilot", "thesis", "--hold", "1"], 760, b"\xff"),
    (["--hold", "0.5"], 265, b"\x01\x00\x38"),
])
def test_the_autopilot_commands_and_the_node_says_how_it_is(bench, options, type_id, command):
    used, listener = on_the_bus(bench, *options)
    heard = listener.hear(6)
    commands = data_of(heard, type_id, AUTOPILOT)
    assert len(commands) > 200 and set(commands) == {command}
    for source in (AUTOPILOT, NODE):
        statuses = [unpack("NodeStatus", data) for data in data_of(heard, 550, source)]
        assert len(statuses) >= 4 and all(status.status_code == 0 for status in statuses)
        uptimes = [status.uptime_sec for status in statuses]
        assert uptimes == list(range(uptimes[0], uptimes[0] + len(uptimes)))
    measured = data_of(heard, 761, NODE)
    assert measured and all(len(data) == 1 and abs(data[0] - 25) <= 1 for data in measured)
    assert used.pulse_us() == (2000 if type_id == 760 else 1750)


def test_the_node_says_who_it_is_and_restarts(bench):
    used, listener = on_the_bus(bench)
    info = unpack("GetNodeInfo", listener.ask(551, b"", "GetNodeInfo", 3), "response")
    assert info.status.status_code == 0
    assert info.name.decode().startswith("org.")
    assert any(info.hardware_version.unique_id)
    wrong = pack(new("RestartNode", "request", magic_number=0xACCE551B1F))
    assert listener.ask(560, wrong, "RestartNode", 4) == b"\x00"
    right = pack(new("RestartNode", "request", magic_number=0xACCE551B1E))
    assert listener.ask(560, right, "RestartNode", 5) == b"\x80"
    used.wait_for_text("reset: RestartNode")
