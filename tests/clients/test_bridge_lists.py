"""Lists of parameters on buses and channels that are slow, and from nodes that are."""

import time

from ground import SYSTEM, value_of
from many_nodes import Node, integers


def fetch_all(ground, nodes, parameters, timeout):
    """The seconds until all parameters of all nodes are here, after one PARAM_REQUEST_LIST."""
    start = time.monotonic()
    ground.mav.param_request_list_send(SYSTEM, 0)
    missing = {(node, index) for node in nodes for index in range(parameters)}
    while missing:
        assert time.monotonic() < start + timeout, f"{len(missing)} of {len(nodes) * parameters} are missing"
        message = ground.receive()
        if message and message.get_type() == "PARAM_VALUE":
            assert message.param_count == parameters
            missing.discard((message.get_srcComponent(), message.param_index))
    return time.monotonic() - start


def wait_for_infos(ground, nodes):
    told = set()
    end = time.monotonic() + 20
    while told != set(nodes):
        assert time.monotonic() < end, f"no information of {set(nodes) - told}"
        if (message := ground.receive()) and message.get_type() == "UAVCAN_NODE_INFO":
            told.add(message.get_srcComponent())


def test_thirty_nodes_tell_all_their_parameters_on_a_bus_of_900_frames_a_second(many_nodes, bridge, station):
    used = many_nodes(count=30, parameters=20, frames_per_s=900)
    bridge(used.bus)
    ground = station()
    wait_for_infos(ground, range(1, 31))
    asked_before = sum(node.requests["uavcan.protocol.param.GetSet"] for node in used.nodes.values())
    seconds = fetch_all(ground, range(1, 31), 20, 15)
    asked = sum(node.requests["uavcan.protocol.param.GetSet"] for node in used.nodes.values()) - asked_before
    print(f"30 nodes x 20 parameters at 900 frames/s: {seconds:.1f} s, {asked} requests")
    # 20 each, and up to 5 behind the end of each list; the rest was asked for twice.
    assert asked < 30 * 25 * 1.1


def test_a_node_that_takes_800_ms_for_an_answer_shows_its_parameters(many_nodes, bridge, station):
    used = many_nodes([Node(42, integers(5), delay_s=0.8)])
    bridge(used.bus)
    ground = station()
    wait_for_infos(ground, [42])
    assert fetch_all(ground, [42], 5, 10) < 6
    assert value_of(ground.read("PARAMETER_03", component=42)) == 3


def test_a_node_that_works_on_one_request_after_the_other_for_800_ms_shows_its_parameters(many_nodes, bridge, station):
    used = many_nodes([Node(42, integers(5), delay_s=0.8, one_at_a_time=True)])
    bridge(used.bus)
    ground = station()
    wait_for_infos(ground, [42])
    print(f"5 parameters of 800 ms each, one after the other: {fetch_all(ground, [42], 5, 25):.1f} s")
