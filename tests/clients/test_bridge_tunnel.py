"""Serial ports of nodes over the bus: `bridge --tunnel`."""

import dataclasses
import os
import re
import termios
import time

import dronecan
import pytest
import serial
from dronecan import uavcan
from dronecan.utility import DroneCANSerial

from conftest import NODE, TIMEOUT_S, Client, free_port, node_elf, wait_until
from ground import BRIDGE
from many_nodes import Node

TARGETTED, BROADCAST = uavcan.tunnel.Targetted, uavcan.tunnel.Broadcast
VERTIQ = 0x55


@dataclasses.dataclass
class ArduPilotNode(Node):
    """A node with AP_Periph's rules for tunnel.Targetted. The device on its port answers in upper
    case.
    """

    told_s: float = 3.0
    # The port that was requested last. The default port is number 3.
    port: int = 3
    asked_by: int = 0
    asked_at: float = -1e9
    serial_ids: set = dataclasses.field(default_factory=set)
    baud_rates: set = dataclasses.field(default_factory=set)
    options: set = dataclasses.field(default_factory=set)
    written: bytearray = dataclasses.field(default_factory=bytearray)

    def hear(self, message, source):
        if (
            dronecan.get_dronecan_data_type(message) != TARGETTED
            or message.target_node != self.node_id
        ):
            return []
        self.asked_by, self.asked_at = source, time.monotonic()
        self.port = 3 if message.serial_id == -1 else message.serial_id
        self.serial_ids.add(message.serial_id)
        self.baud_rates.add(message.baudrate)
        self.options.add(message.options)
        self.written += bytes(message.buffer)
        return self.say(bytes(message.buffer).upper(), message.protocol.protocol)

    def say(self, text, protocol=2):
        """Messages with what its device sends, to the node that sent a request in the last three
        seconds.
        """
        if not text or time.monotonic() > self.asked_at + self.told_s:
            return []
        reply = TARGETTED(target_node=self.asked_by, serial_id=self.port, baudrate=115200)
        reply.protocol.protocol = protocol
        reply.buffer = bytearray(text)
        return [reply]


@dataclasses.dataclass
class VertiqNode(Node):
    """A module that answers bytes of its protocol with tunnel.Broadcast."""

    def hear(self, message, source):
        if (
            dronecan.get_dronecan_data_type(message) != BROADCAST
            or message.protocol.protocol != VERTIQ
        ):
            return []
        reply = BROADCAST(channel_id=message.channel_id)
        reply.protocol.protocol = VERTIQ
        reply.buffer = bytearray(bytes(message.buffer)[::-1])
        return [reply]


@pytest.fixture
def port(tmp_path):
    """Opens a tunnel's pseudo-terminal as a terminal program does."""
    opened = []

    def start(name="port", baud=115200):
        wait_until(lambda: os.path.exists(tmp_path / name), name)
        new = serial.Serial(str(tmp_path / name), baud, timeout=TIMEOUT_S)
        opened.append(new)
        return new

    yield start
    for used in opened:
        used.close()


def test_a_terminal_program_reaches_the_device_on_a_node_s_port(many_nodes, bridge, port):
    node = ArduPilotNode(42, {})
    bridge(many_nodes([node]).bus, "--tunnel", "42:port", channels=[])
    line = port()
    line.write(b"version?\r\n")
    assert line.readline() == b"VERSION?\r\n"
    assert (node.asked_by, node.serial_ids, node.options) == (BRIDGE, {-1}, {0})
    assert 115200 in node.baud_rates
    # More bytes than a transfer holds must arrive in order.
    text = bytes(range(48, 123)) * 40
    line.write(text)
    assert line.read(len(text)) == text.upper()


def test_the_bridge_keeps_the_node_s_tunnel_open(many_nodes, bridge, port):
    node = ArduPilotNode(42, {})
    used = many_nodes([node])
    bridge(used.bus, "--tunnel", "42:port,port=1,lock", channels=[])
    line = port(baud=57600)
    line.write(b"x")
    assert line.read(1) == b"X"
    before = time.monotonic()
    wait_until(lambda: time.monotonic() > before + 4, "time")
    for message in node.say(b"late news"):
        used.ordinary.extend(used.frames_of(node, message))
    assert line.read(9) == b"late news"
    node.port = 2
    for message in node.say(b"of another port"):
        used.ordinary.extend(used.frames_of(node, message))
    line.timeout = 3
    assert line.read(1) == b""
    assert (node.serial_ids, node.options) == ({1}, {1}) and 57600 in node.baud_rates


def test_bytes_from_or_to_other_nodes_do_not_come_out(many_nodes, bridge, port):
    node, other = ArduPilotNode(42, {}), ArduPilotNode(43, {})
    used = many_nodes([node, other])
    bridge(used.bus, "--tunnel", "42:port", channels=[])
    line = port()
    line.write(b"a")
    assert line.read(1) == b"A"
    for source, target in ((other, BRIDGE), (node, 7)):
        source.asked_by, source.asked_at = target, time.monotonic()
        for message in source.say(b"wrong"):
            used.ordinary.extend(used.frames_of(source, message))
    time.sleep(0.3)
    line.write(b"b")
    assert line.read(1) == b"B"


def test_two_tunnels_work_one_of_them_by_broadcast(many_nodes, bridge, port):
    nodes = [ArduPilotNode(42, {}), VertiqNode(43, {})]
    started = bridge(
        many_nodes(nodes).bus,
        "--tunnel",
        "42:port",
        "--tunnel",
        "43:motor,broadcast=0x55",
        channels=[],
    )
    started.wait_for_text("motor is the serial port of node 43")
    line, motor = port(), port("motor")
    text = bytes(range(150))
    motor.write(text)
    line.write(b"hello")
    assert line.read(5) == b"HELLO"
    # Sixty bytes at a time, each part reversed.
    assert motor.read(150) == text[:60][::-1] + text[60:120][::-1] + text[120:][::-1]


def test_an_existing_file_is_kept_and_a_stale_link_is_replaced(many_nodes, bridge, tmp_path):
    used = many_nodes([Node(42, {})])
    (tmp_path / "file").write_text("precious")
    refused = bridge(used.bus, "--tunnel", "42:file", channels=[])
    assert refused.wait() == 4 and "exists already" in refused.text()
    assert (tmp_path / "file").read_text() == "precious"
    # A link that a killed bridge left.
    (tmp_path / "port").symlink_to("/dev/pts/no-such")
    started = bridge(used.bus, "--tunnel", "42:port", channels=[])
    started.wait_for_text("is the serial port of node 42")
    assert (
        termios.tcgetattr(os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY))[3] & termios.ECHO
        == 0
    )
    assert started.end() == 0
    assert not os.path.lexists(tmp_path / "port")


def test_the_gui_tool_s_serial_port_works_through_the_bridge(many_nodes, bridge):
    """Its panel "Serial Forwarding" uses pydronecan's DroneCANSerial. With `mavcan:` it reaches a
    bus through MAVLink.
    """
    node = ArduPilotNode(42, {})
    port = free_port()
    bridge(many_nodes([node]).bus, "--allow-can", channels=[f"udpout:127.0.0.1:{port}"])
    client = Client(f"mavcan:udpin:127.0.0.1:{port}", 127)
    client.spin_until(
        lambda: client.wait_for(uavcan.protocol.NodeStatus, source=42), "status of node 42"
    )
    line = DroneCANSerial(None, 42, -1, node=client.node, baudrate=115200)
    line.write(b"hello from the tool")
    received = bytearray()

    def answer():
        client.spin(0.02)
        received.extend(line.read(100))
        return received == b"HELLO FROM THE TOOL"

    wait_until(answer, "answer of the device")
    assert node.asked_by == 127
    # DroneCANSerial closes itself, and can be closed only once.
    line = None
    client.close()


def test_a_node_s_serial_monitor_is_read_over_the_bus(bench, bridge, port):
    """For example a node in a wing, whose USB port cannot be reached."""
    used = bench(elf=node_elf("tunnel", board="uno"))
    bridge(used, "--tunnel", f"{NODE}:port", channels=[])
    line = port()
    lines = [line.readline() for _ in range(20)]
    assert any(re.fullmatch(rb"temperature \+2\d\.\d C\r\n", text) for text in lines), lines
    line.write(b"?")
    end = time.monotonic() + TIMEOUT_S
    while not (counters := line.readline()).startswith(b"commands followed"):
        assert time.monotonic() < end, "no counters"
    assert b"refused" in counters


def test_the_gui_tool_s_serial_port_shows_the_node_s_serial_monitor(bench):
    used = bench(elf=node_elf("tunnel", board="uno"))
    client = used.dronecan(node_id=127)
    line = DroneCANSerial(None, NODE, -1, node=client.node, baudrate=115200)
    line.send_bytes(b"")
    received = bytearray()

    def answer():
        client.spin(0.05)
        received.extend(line.read(100))
        return re.search(rb"temperature \+2\d\.\d C", received)

    wait_until(answer, "temperature on the serial monitor")
    line = None
