"""The MAVLink bridge, and ground stations made with pymavlink.

    def test_the_node_is_seen(bench, bridge, station):
        bridge(bench())
        assert station().wait_for("UAVCAN_NODE_STATUS", component=120).health == 0

`bridge(bench)` starts the program on the bench's first SLCAN adapter; it listens for ground
stations. `station()` is a ground station. When the test is over the stations are closed, and the
bridge gets Ctrl-C and must end with exit code 0.
"""

import os
import signal
import socket
import struct
import subprocess
import time

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v10 import ardupilotmega as mavlink1

from conftest import NODE, TIMEOUT_S, end_group, free_port, project_program, wait_until

mavlink = mavutil.mavlink
ACCEPTED, DENIED, UNSUPPORTED, FAILED = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED,
    mavlink.MAV_RESULT_FAILED,
)
BRIDGE = 126
SYSTEM = 1


def as_float(integer):
    """The bytes of an integer as a float, as PX4 sends integer parameters."""
    return struct.unpack("<f", struct.pack("<i", integer))[0]


def value_of(message):
    """The value of a PARAM_VALUE, decoded by its type."""
    if message.param_type == mavlink.MAV_PARAM_TYPE_REAL32:
        return message.param_value
    packed = struct.pack("<f", message.param_value)
    formats = {
        mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
        mavlink.MAV_PARAM_TYPE_INT32: "<i",
        mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    }
    return struct.unpack(formats[message.param_type], packed)[0]


class Bridge:
    """The program with its output."""

    def __init__(self, directory, *options):
        self.directory = directory
        self.output = directory / f"bridge{len(list(directory.glob('bridge*')))}.txt"
        with open(self.output, "wb") as output:
            self.process = subprocess.Popen(
                [str(word) for word in [project_program("bridge"), "--plain", *options]],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=directory,
                start_new_session=True,
            )

    def text(self):
        return self.output.read_text(errors="replace")

    def wait_for_text(self, text, timeout=TIMEOUT_S):
        wait_until(lambda: text in self.text(), f"line with {text!r} in\n{self.text()}", timeout)

    def wait(self, timeout=TIMEOUT_S):
        """Waits until the bridge ends by itself. Returns its exit code."""
        try:
            return self.process.wait(timeout)
        finally:
            end_group(self.process)

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.wait()


class Station:
    """A ground station made with pymavlink."""

    def __init__(self, device, component=190, **options):
        self.link = mavutil.mavlink_connection(
            device, source_system=255, source_component=component, **options
        )
        self.mav = self.link.mav
        self.next_heartbeat = 0

    def close(self):
        self.link.close()

    def receive(self):
        """The next message, or `None`."""
        if time.monotonic() >= self.next_heartbeat:
            self.next_heartbeat = time.monotonic() + 1
            self.mav.heartbeat_send(
                mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
        return self.link.recv_match(blocking=True, timeout=0.02)

    def gather(self, seconds, kind=None):
        """All messages that arrive within `seconds`."""
        end = time.monotonic() + seconds
        messages = []
        while time.monotonic() < end:
            if (message := self.receive()) and kind in (None, message.get_type()):
                messages.append(message)
        return messages

    def wait_for(self, kind, component=None, timeout=TIMEOUT_S, heard=None, **fields):
        """The next message of this kind from this component with these fields. Calls `heard` with
        all messages before it.
        """
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            message = self.receive()
            if heard and message:
                heard(message)
            if (
                message
                and message.get_type() == kind
                and component in (None, message.get_srcComponent())
                and all(getattr(message, name) == value for name, value in fields.items())
            ):
                return message
        raise AssertionError(f"no {kind} {fields} from component {component} within {timeout} s")

    def parameters(self, component=NODE):
        """All parameters, by name."""
        self.mav.param_request_list_send(SYSTEM, component)
        found = {}
        while not found or len(found) < next(iter(found.values())).param_count:
            message = self.wait_for("PARAM_VALUE", component)
            found[message.param_id] = message
        return found

    def read(self, name, component=NODE, index=-1):
        self.mav.param_request_read_send(SYSTEM, component, name.encode(), index)
        return self.wait_for("PARAM_VALUE", component)

    def set(self, name, value, kind=mavlink.MAV_PARAM_TYPE_INT32, component=NODE):
        self.mav.param_set_send(SYSTEM, component, name.encode(), value, kind)
        return self.wait_for("PARAM_VALUE", component, param_id=name)

    def command(self, number, *params, component=NODE, integer=False, heard=None):
        """Sends a command and returns its COMMAND_ACK."""
        params = [*params, *[0] * (7 - len(params))]
        if integer:
            self.mav.command_int_send(
                SYSTEM,
                component,
                0,
                number,
                0,
                0,
                *params[:4],
                int(params[4]),
                int(params[5]),
                params[6],
            )
        else:
            self.mav.command_long_send(SYSTEM, component, number, 0, *params)
        ack = self.wait_for("COMMAND_ACK", command=number, heard=heard)
        assert (ack.target_system, ack.target_component) == (255, self.mav.srcComponent)
        return ack

    def save(self, component=NODE):
        assert (
            self.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1, component=component).result
            == ACCEPTED
        )

    def restart(self, component=NODE):
        # Only an uptime that is less than the one before tells of a restart.
        while not self.wait_for("UAVCAN_NODE_STATUS", component).uptime_sec:
            pass
        assert (
            self.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1, component=component).result
            == ACCEPTED
        )
        self.wait_for("UAVCAN_NODE_INFO", component, uptime_sec=0)


class PtyStation(Station):
    """A ground station at the other end of a pseudo-terminal, which stands for a radio."""

    class File(mavutil.mavfile):
        def __init__(self, fd):
            self.far_end = fd
            super().__init__(fd, "pty", source_system=255, source_component=190)

        def recv(self, n=None):
            try:
                return os.read(self.far_end, n or self.mav.bytes_needed())
            except BlockingIOError:
                return b""

        def write(self, data):
            return os.write(self.far_end, data)

    def __init__(self, fd):
        os.set_blocking(fd, False)
        self.link = PtyStation.File(fd)
        self.mav = self.link.mav
        self.next_heartbeat = 0

    def close(self):
        os.close(self.link.far_end)


class OldStation:
    """A ground station that knows only MAVLink 1. It drops other messages, and the bridge must send
    it none.
    """

    def __init__(self, port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.05)
        self.socket.connect(("127.0.0.1", port))
        self.mav = mavlink1.MAVLink(self, srcSystem=254, srcComponent=190)
        self.mav.robust_parsing = True
        # The MAVLink version of each received datagram.
        self.magic = b""

    def write(self, data):
        self.socket.send(data)

    def close(self):
        self.socket.close()

    def wait_for(self, kind, component, timeout=TIMEOUT_S):
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            try:
                data = self.socket.recv(2048)
            except TimeoutError:
                continue
            self.magic += data[:1]
            for message in self.mav.parse_buffer(data) or []:
                if message.get_type() == kind and message.get_srcComponent() == component:
                    assert data[0] == 0xFE
                    return message
        raise AssertionError(f"no {kind} from component {component} within {timeout} s")


@pytest.fixture
def bridge(tmp_path):
    """Starts bridges on the first adapter of a bench or on a bus given as text. They listen on
    `bridge.port`, or have `channels`.
    """
    bridges = []

    def start(bus, *options, channels=None):
        if not isinstance(bus, str):
            bus = f"slcan:{bus.slcan[0]}"
        channels = [f"udpin:{start.port}"] if channels is None else channels
        new = Bridge(
            tmp_path,
            "--bus",
            bus,
            *[word for channel in channels for word in ("--mavlink", channel)],
            *options,
        )
        bridges.append(new)
        return new

    start.port = free_port()
    yield start
    faults = [
        used.text() for used in bridges if used.process.returncode is None and used.end() != 0
    ]
    assert not faults, "\n".join(faults)


@pytest.fixture
def station(bridge):
    """Ground stations; by default on UDP to the port on which the bridge listens."""
    stations = []

    def start(device=None, kind=Station, **options):
        new = (
            kind(bridge.port)
            if kind is OldStation
            else kind(device or f"udpout:127.0.0.1:{bridge.port}", **options)
        )
        stations.append(new)
        return new

    yield start
    for used in stations:
        used.close()
