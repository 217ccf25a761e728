"""Which stations may do what through the bridge."""

import contextlib
import hashlib
import socket
import struct
import time

import pytest
from pymavlink import mavutil

from conftest import TIMEOUT_S, free_port, wait_until
from ground import ACCEPTED, BRIDGE, DENIED, SYSTEM, as_float, mavlink, value_of
from many_nodes import Node, integers

NODE = 42
CAN_FORWARD, SAVE, RESTART = (
    mavlink.MAV_CMD_CAN_FORWARD,
    mavlink.MAV_CMD_PREFLIGHT_STORAGE,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
)
PLACES = 16


@pytest.fixture
def node(many_nodes):
    used = many_nodes([Node(NODE, integers(3))])
    used.node = used.nodes[NODE]
    return used


def requests(node):
    """The services that changed the node."""
    return {name.split(".")[-1] for name in node.requests} & {"ExecuteOpcode", "RestartNode"}


def test_a_read_only_bridge_changes_nothing(node, bridge, station):
    bridge(node.bus, "--read-only", "--allow-can")
    ground = station()
    ground.wait_for("UAVCAN_NODE_INFO", NODE)
    assert len(ground.parameters(NODE)) == 3
    assert value_of(ground.set("PARAMETER_01", as_float(77), component=NODE)) == 1
    for component in (NODE, 0):
        assert ground.command(SAVE, 1, component=component).result == DENIED
    assert ground.command(RESTART, 1, component=NODE).result == DENIED
    assert ground.command(CAN_FORWARD, 1, component=0).result == ACCEPTED, (
        "reading the bus changes nothing"
    )
    send_frame(ground)
    ground.gather(0.5)
    assert node.node.parameters["PARAMETER_01"] == ("integer_value", 1) and not requests(node.node)
    assert 30 not in sources(node)


def test_frames_are_forwarded_only_with_allow_can(node, bridge, station):
    bridge(node.bus)
    ground = station()
    ground.wait_for("UAVCAN_NODE_INFO", NODE)
    assert ground.command(CAN_FORWARD, 1, component=0).result == DENIED
    assert "--allow-can" in ground.wait_for("STATUSTEXT").text
    send_frame(ground)
    assert not ground.gather(1.5, "CAN_FRAME") and 30 not in sources(node)


def send_frame(ground):
    """A NodeStatus of node 30, sent by a ground station."""
    ground.mav.can_frame_send(
        SYSTEM, BRIDGE, 0, 8, 0x9801551E, list(struct.pack("<IBHB", 1, 0, 0, 0xC0))
    )


def sources(used):
    """The nodes for which the bridge has sent frames."""
    return used.heard_from


def quiet_station(port, address="127.0.0.1"):
    """A station that has sent one heartbeat."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind((address, 0))
    link.connect(("127.0.0.1", port))
    mav = mavutil.mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    link.send(mav.heartbeat_encode(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4).pack(mav))
    return link


def receives(link, timeout_s=TIMEOUT_S):
    link.settimeout(timeout_s)
    try:
        return bool(link.recv(2048))
    except TimeoutError:
        return False


def drain(link):
    """Discards the received data."""
    link.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while link.recv(2048):
            pass


def test_new_stations_do_not_replace_a_quiet_station(node, bridge):
    started = bridge(node.bus)
    started.wait_for_text(f"node {NODE} is org.")
    quiet = quiet_station(bridge.port)
    assert receives(quiet)
    new_stations = [quiet_station(bridge.port) for _ in range(PLACES + 4)]
    assert all(receives(new_station) for new_station in new_stations[: PLACES - 1])
    assert not any(receives(new_station, 3) for new_station in new_stations[-2:])
    drain(quiet)
    assert receives(quiet), "the quiet station must still receive messages"
    started.wait_for_text("no place for")
    assert started.text().count("no place for") == 1
    for link in (quiet, *new_stations):
        link.close()


def test_with_a_key_unsigned_stations_take_no_place(node, bridge, station, tmp_path):
    (tmp_path / "key").write_text("correct horse\n")
    bridge(node.bus, "--signing-key", tmp_path / "key").wait_for_text(f"node {NODE} is org.")
    new_stations = [quiet_station(bridge.port) for _ in range(PLACES + 4)]
    ground = station()
    ground.link.setup_signing(hashlib.sha256(b"correct horse").digest(), link_id=1)
    ground.wait_for("UAVCAN_NODE_INFO", NODE)
    for new_station in new_stations[:2]:
        # Each is told why, once.
        assert b"Not signed" in new_station.recv(2048)
        assert not receives(new_station, 3)
    for link in new_stations:
        link.close()


def test_after_a_start_with_the_clock_in_the_future_stations_are_heard(
    node, bridge, station, tmp_path
):
    """A bridge does not send to a station on udpin: before it has heard it."""
    (tmp_path / "key").write_text("correct horse\n")
    # What a bridge leaves that ran ten years from now.
    future = int((time.time() + 10 * 365 * 86400 - 1420070400) * 100_000)
    title = "# Times of MAVLink signatures that this bridge has accepted; see docs/bridge.md."
    (tmp_path / "key.times").write_text(f"{title}\nnewest {future}\n")
    started = bridge(node.bus, "--signing-key", tmp_path / "key")
    for _ in range(2):
        ground = station()
        ground.link.setup_signing(hashlib.sha256(b"correct horse").digest(), link_id=1)
        ground.wait_for("UAVCAN_NODE_INFO", NODE)
        ground.close()
    started.wait_for_text("signs with a time that is over")


def test_a_captured_message_is_executed_once(node, bridge, tmp_path):
    """Not on another channel, and not after a restart: a signed command that restarts the node."""
    (tmp_path / "key").write_text("correct horse\n")
    other = free_port()
    channels = [f"udpin:{bridge.port}", f"udpin:{other}"]
    captured = []
    for attempt in range(2):
        started = bridge(node.bus, "--signing-key", tmp_path / "key", channels=channels)
        started.wait_for_text(f"node {NODE} is org.")
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if not captured:
            captured.append(signed_restart())
            sender.sendto(captured[0], ("127.0.0.1", bridge.port))
            wait_until(lambda: node.node.requests["uavcan.protocol.RestartNode"], "restart")
        for port in (bridge.port, other):
            sender.sendto(captured[0], ("127.0.0.1", port))
        time.sleep(0.5)
        sender.close()
        assert node.node.requests["uavcan.protocol.RestartNode"] == 1, f"attempt {attempt}"
        assert started.end() == 0
        assert "signed too late or repeated" in started.text()


def signed_restart():
    """The bytes of a signed command that restarts the node."""
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    mav.signing.secret_key = hashlib.sha256(b"correct horse").digest()
    mav.signing.link_id = 3
    # 10 us since 2015-01-01.
    mav.signing.timestamp = int((time.time() - 1420070400) * 100_000)
    mav.signing.sign_outgoing = True
    restart = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    return mav.command_long_encode(1, NODE, restart, 0, 1, 0, 0, 0, 0, 0, 0).pack(mav)


def test_a_connection_that_does_not_sign_receives_nothing_and_is_closed(
    node, bridge, station, tmp_path
):
    (tmp_path / "key").write_text("correct horse\n")
    port = free_port()
    bridge(node.bus, "--signing-key", tmp_path / "key", channels=[f"tcpin:{port}"]).wait_for_text(
        "node 42 is org."
    )
    new_station = socket.create_connection(("127.0.0.1", port))
    new_station.settimeout(TIMEOUT_S)
    before = time.monotonic()
    assert new_station.recv(2048) == b""
    assert time.monotonic() > before + 5
    new_station.close()
    # Connections that do not sign must not use up the bridge's places.
    new_stations = [socket.create_connection(("127.0.0.1", port)) for _ in range(2 * PLACES)]
    ground = station(f"tcp:127.0.0.1:{port}", retries=20)
    ground.link.setup_signing(hashlib.sha256(b"correct horse").digest(), link_id=1)
    ground.wait_for("UAVCAN_NODE_INFO", NODE)
    for link in new_stations:
        link.close()


def test_only_the_listed_addresses_are_accepted(node, bridge):
    started = bridge(node.bus, "--peer", "127.0.0.2", "--peer", "127.0.0.3")
    started.wait_for_text(f"node {NODE} is org.")
    named, other = quiet_station(bridge.port, "127.0.0.2"), quiet_station(bridge.port)
    assert receives(named) and not receives(other, 3)
    for link in (named, other):
        link.close()
    assert started.end() == 0
    assert "1 refused" in started.text()


def test_a_port_beyond_loopback_without_a_key_causes_a_warning(node, bridge, tmp_path):
    (tmp_path / "key").write_text("correct horse\n")
    for options, channel, is_warned in [
        ((), "udpin:0.0.0.0:0", True),
        (("--signing-key", tmp_path / "key"), "udpin:0.0.0.0:0", False),
        ((), "udpin:0", False),
    ]:
        started = bridge(node.bus, *options, channels=[channel])
        started.wait_for_text("is open: the system chose the port")
        assert ("has no key" in started.text()) == is_warned
        assert started.end() == 0


def test_port_0_chooses_a_free_port_and_prints_it(node, bridge, station):
    started = bridge(node.bus, channels=["udpin:0"])
    started.wait_for_text("is open: the system chose the port")
    port = started.text().split(" is open: the system chose the port")[0].rsplit(":", 1)[1]
    station(f"udpout:127.0.0.1:{port}").wait_for("UAVCAN_NODE_INFO", NODE)


def test_an_unknown_host_does_not_delay_other_channels(node, bridge, station):
    started = bridge(
        node.bus, "--wait", channels=["udpout:no.such.host.invalid:1", f"udpin:{bridge.port}"]
    )
    ground = station()
    ground.wait_for("UAVCAN_NODE_INFO", NODE)
    assert len(ground.parameters(NODE)) == 3
    started.wait_for_text("there is no host")
    wait_until(lambda: len(ground.gather(2.5, "UAVCAN_NODE_STATUS")) >= 2, "statuses")
