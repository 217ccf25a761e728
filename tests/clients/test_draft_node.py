"""The thesis's firmware and the simulated autopilot use the draft of 2014, checked by a client that
uses only draft.py.
"""

import re
import time

from draft import BROADCAST, REQUEST, fields, frames, new, pack, unpack

from conftest import NODE, node_elf

AUTOPILOT, TOOL = 1, 126
LINE = re.compile(rb"T([0-9A-F]{8})([0-8])((?:[0-9A-F]{2})*)[^\r]*\r")


class Listener:
    """An SLCAN adapter that reads and writes frames of the draft."""

    def __init__(self, raw):
        self.raw = raw
        self.text = b""
        raw.write_all(b"C\rS8\rO\r")

    def hear(self, seconds):
        """(identifier, data) of the frames that arrive within `seconds`."""
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

    def request(self, type_id, payload, transfer_id):
        """Sends a request to the node, in a single frame."""
        for can_id, data in frames(type_id, REQUEST, TOOL, transfer_id, payload, NODE):
            self.raw.write_all(f"T{can_id:08X}{len(data)}{data.hex().upper()}\r".encode())


def data_of(heard, type_id, source):
    return [data for can_id, data in heard if fields(can_id)[:3] == (type_id, BROADCAST, source)]


def on_the_bus(bench, *options):
    used = bench("--dialect", "draft", *options, autopilot=True, elf=node_elf("thesis"))
    # A listener from the start on also hears the first status, which says INITIALIZING.
    used.wait_for_text(rf"status  node {NODE}: draft, OK")
    return used, Listener(used.raw())


def test_the_autopilot_sends_commands_and_the_node_its_status(bench):
    used, listener = on_the_bus(bench, "--autopilot", "thesis", "--hold", "1")
    heard = listener.hear(6)
    commands = data_of(heard, 760, AUTOPILOT)
    assert len(commands) > 200 and set(commands) == {b"\xff"}
    for source in (AUTOPILOT, NODE):
        statuses = [unpack("NodeStatus", data) for data in data_of(heard, 550, source)]
        assert len(statuses) >= 4 and all(status.status_code == 0 for status in statuses)
        uptimes = [status.uptime_sec for status in statuses]
        assert uptimes == list(range(uptimes[0], uptimes[0] + len(uptimes)))
    measured = data_of(heard, 761, NODE)
    assert measured and all(len(data) == 1 and abs(data[0] - 25) <= 1 for data in measured)
    assert used.pulse_us() == 2000


def test_frames_that_the_thesis_s_filters_reject_have_no_effect(bench):
    """ArrayCommand, GetNodeInfo and RestartNode. test_draft.py compares their frames with
    pydronecan.
    """
    used, listener = on_the_bus(bench, "--hold", "0.5")
    magic = pack(new("RestartNode", "request", magic_number=0xACCE551B1E))
    listener.request(551, b"", 3)
    listener.request(560, magic, 4)
    heard = listener.hear(4)
    # Checks that the frames were on the bus, and the node too.
    assert len(data_of(heard, 265, AUTOPILOT)) > 100 and len(data_of(heard, 550, NODE)) >= 2
    from_node = {fields(can_id)[:2] for can_id, _ in heard if fields(can_id)[2] == NODE}
    assert from_node <= {(550, BROADCAST), (761, BROADCAST)}
    assert used.pulse_us() is None
    assert "reset: on request" not in used.text()
