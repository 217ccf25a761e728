"""The bridge besides an autopilot, with QGroundControl's rules."""

import threading

import pytest
from pymavlink import mavutil

from conftest import TIMEOUT_S, free_port
from ground import Station, mavlink
from many_nodes import Node, integers
from qgroundcontrol import Autopilot, QGroundControl

ARMED_IN_MODE_4 = (True, 4)


class Vehicle(threading.Thread):
    """An autopilot with links to the ground station and to the bridge, connected as by a router."""

    def __init__(self, bridge_port, ground_port, hears_bridge=True):
        super().__init__(daemon=True)
        self.to_bridge = Autopilot(f"udpout:127.0.0.1:{bridge_port}") if hears_bridge else None
        self.to_ground = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{ground_port}", source_system=1, source_component=1
        )
        self.autopilot = self.to_bridge or Autopilot(f"udpout:127.0.0.1:{free_port()}")
        self.ended = threading.Event()

    def run(self):
        turn = 0
        while not self.ended.wait(0.02):
            if turn % 50 == 0:
                self.autopilot.beat(self.to_ground.mav)
                if self.to_bridge:
                    self.autopilot.beat()
            turn += 1
            message = self.to_ground.recv_match()
            if (
                message
                and message.get_type() == "PARAM_REQUEST_LIST"
                and message.target_component in (0, 1)
            ):
                for index, (name, value) in enumerate(Autopilot.PARAMETERS.items()):
                    self.to_ground.mav.param_value_send(
                        name.encode(),
                        value,
                        mavlink.MAV_PARAM_TYPE_INT32,
                        len(Autopilot.PARAMETERS),
                        index,
                    )

    def close(self):
        self.ended.set()
        self.join(TIMEOUT_S)
        self.autopilot.close()
        self.to_ground.close()


@pytest.fixture
def closing():
    used = []
    yield lambda thing: used.append(thing) or thing
    for thing in reversed(used):
        thing.close()


def beside_an_autopilot(many_nodes, bridge, closing, *options, hears_bridge=True):
    """A bus with the autopilot as node 1 and two other nodes, an autopilot on MAVLink, the bridge,
    and the ground station.
    """
    used = many_nodes([Node(1, integers(3)), Node(42, integers(20)), Node(43, integers(5))])
    bridge(used.bus, "--integers", "cast", *options)
    ground_port = free_port()
    qgc = closing(
        QGroundControl(f"udpout:127.0.0.1:{bridge.port}", Station(f"udpin:127.0.0.1:{ground_port}"))
    )
    vehicle = closing(Vehicle(bridge.port, ground_port, hears_bridge))
    vehicle.start()
    return used, qgc


@pytest.mark.parametrize("how", ["heard", "hidden"])
def test_an_autopilot_that_is_node_1_keeps_its_armed_state_and_mode(
    many_nodes, bridge, closing, how
):
    options = ["--hide", "1"] if how == "hidden" else []
    _, qgc = beside_an_autopilot(many_nodes, bridge, closing, *options, hears_bridge=how == "heard")
    qgc.spin(3.5)
    qgc.states_of_vehicle.clear()
    qgc.states_of_system.clear()
    qgc.spin_until(lambda: len(qgc.states_of_vehicle) >= 3, "heartbeats of the vehicle")
    assert set(qgc.states_of_vehicle) == set(qgc.states_of_system) == {ARMED_IN_MODE_4}


def test_the_parameters_of_the_nodes_are_components_of_the_vehicle(many_nodes, bridge, closing):
    used, qgc = beside_an_autopilot(many_nodes, bridge, closing)
    qgc.spin_until(lambda: qgc.vehicle, "vehicle")
    assert qgc.vehicle == 1 and qgc.is_ardupilot
    # The vehicle is ready with the autopilot's own parameters, and accepts those that follow. It
    # requests no parameter one by one.
    qgc.load()
    qgc.spin_until(lambda: len(qgc.facts) == 3 and qgc.is_loaded(), "parameters of the nodes")
    assert not qgc.tries
    assert {component: len(facts) for component, facts in qgc.facts.items()} == {
        1: 2,
        42: 20,
        43: 5,
    }
    assert qgc.facts[42]["PARAMETER_07"] == (mavlink.MAV_PARAM_TYPE_INT32, 7)
    assert qgc.set(42, "PARAMETER_07", 1234)
    assert used.nodes[42].parameters["PARAMETER_07"] == ("integer_value", 1234)


def test_without_an_autopilot_there_is_no_vehicle(many_nodes, bridge, closing):
    used = many_nodes([Node(42, integers(5))])
    bridge(used.bus, "--component", 1, "--node-id", 126)
    qgc = closing(QGroundControl(f"udpout:127.0.0.1:{bridge.port}"))
    qgc.spin(3)
    assert qgc.vehicle is None
