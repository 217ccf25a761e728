"""The cases of test_mcast.py, which runs each in its own network namespace."""

import re
import subprocess

import pytest
from dronecan import uavcan

from conftest import NODE, TARGET, Client
from test_management import PARAMETERS

BUS = 7


@pytest.fixture
def joined(bench):
    """A bench on the multicast bus, and a pydronecan node on it."""

    def start(*options, **more):
        used = bench("--mcast", BUS, *options, slcan=0, **more)
        used.wait_for_text(r" link +mcast:7 at 239\.65\.82\.7:57732 on 127\.0\.0\.1: 0 in, 0 out$")
        return used, used.dronecan(device=f"mcast:{BUS}")

    return start


def test_the_node_appears_in_the_node_monitor(joined):
    _, client = joined()
    client.assert_in_node_monitor()


def test_a_command_moves_the_servo_and_the_temperature_arrives(joined):
    used, client = joined("--temperature", "40")
    for value, pulse_us in [(0.5, 1750), (-1.0, 1000)]:
        client.command((1, 0, value))
        client.spin_until(lambda: used.pulse_us() == pulse_us, f"pulse of {pulse_us} us")
    assert client.wait_for(uavcan.equipment.device.Temperature).temperature == pytest.approx(
        313.15, abs=0.4
    )


def test_no_frame_is_lost_or_repeated_in_either_direction(joined):
    used, client = joined("--log", "sim.log", autopilot=True)
    seen = {"rx": [], "tx": []}
    client.node.can_driver.add_io_hook(
        lambda direction, frame: seen[direction].append(
            f"{frame.id:08X}#{bytes(frame.data).hex().upper()}"
        )
    )

    def logged(ours):
        """The frames on the bus that this client sent, or those of the others."""
        frames = re.findall(
            r"^\([\d.]+\) \S+ (\S+)$", (used.directory / "sim.log").read_text(), re.M
        )
        return [
            frame for frame in frames if (re.match("[0-9A-F]{6}0A#", frame) is not None) == ours
        ]

    # The first status that the client receives. The uptime makes it unique.
    mark = client.spin_until(
        lambda: next((f for f in seen["rx"] if f.startswith("18015578#")), None), "status"
    )
    for number in range(200):
        for part in range(5):
            client.command((1, 4, 1000 + number + part))
        client.spin(0.01)
    client.spin_until(
        lambda: len(logged(ours=True)) == len(seen["tx"]), "last of the frames on the bus"
    )
    assert logged(ours=True) == seen["tx"]
    sent = logged(ours=False)
    sent = sent[sent.index(mark) :]
    start = seen["rx"].index(mark)
    client.spin_until(lambda: len(seen["rx"]) >= start + len(sent), "last of the others' frames")
    assert seen["rx"][start : start + len(sent)] == sent
    assert len(seen["tx"]) >= 1000 and len(sent) >= 100


def test_a_ground_station_sees_the_node_through_the_bridge(bench, bridge, station):
    bench("--mcast", BUS, slcan=0)
    bridge(f"mcast:{BUS}")
    ground = station()
    ground.wait_for("UAVCAN_NODE_INFO", NODE)
    assert len(ground.parameters()) == len(PARAMETERS)


def board_of_own_node_is_a_node(board):
    """The node of a board of crates/own-node, on a model of its CAN controller."""
    line = [TARGET / "debug/examples/board", board, f"mcast:{BUS}"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout.readline() == f"{board} on mcast:{BUS}\n"
            client = Client(f"mcast:{BUS}")
            node = 42
            info = client.ask(uavcan.protocol.GetNodeInfo.Request(), node)
            assert str(info.name) == "org.example.own-node"
            client.set("ACTUATOR_ID", 3, node)
            client.save(node)
            client.command((1, 0, 1.0), (2, 0, 0.25), (3, 0, -0.5))
            assert program.stdout.readline() == "move to -500 thousandths\n"
            temperature = client.wait_for(uavcan.equipment.device.Temperature, source=node)
            assert temperature.temperature == 300
            client.close()
        finally:
            program.terminate()


def test_the_rp2040_of_own_node_is_a_node():
    board_of_own_node_is_a_node("rp2040")


def test_the_stm32f103_of_own_node_is_a_node():
    board_of_own_node_is_a_node("stm32f103")
