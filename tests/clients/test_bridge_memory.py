"""The bridge frees the memory of stations and nodes that leave.

`CHURN_S=3600` makes the test last an hour.
"""

import os
import random
import re
import socket
import time

import pytest

from conftest import free_port
from ground import SYSTEM, Station, as_float, mavlink
from many_nodes import Node, integers

CHURN_S = float(os.environ.get("CHURN_S", 60))
# Time until each kind of object has existed once: the bridge forgets nodes after 5 s, and a
# connection lasts for less than 2 s.
WARM_UP_S = min(CHURN_S / 3, 300)
NODES = 20
# Memory that the allocator keeps after it was freed.
GROWTH_MAX_KB = 1024


def resident_kb(process):
    return int(re.search(r"VmRSS:\s+(\d+)", open(f"/proc/{process.pid}/status").read())[1])


@pytest.mark.long
@pytest.mark.timeout(CHURN_S + 120)
def test_the_memory_of_stations_and_nodes_that_leave_is_freed(many_nodes, bridge, station):
    choices = random.Random(1)
    used = many_nodes([Node(node, integers(15)) for node in range(1, NODES + 1)])
    port = free_port()
    started = bridge(used.bus, "--allow-can", channels=[f"udpin:{bridge.port}", f"tcpin:{port}"])
    ground = station()
    ground.wait_for("UAVCAN_NODE_INFO")
    start, guests, sizes, came = time.monotonic(), [], [], 0
    while time.monotonic() < start + CHURN_S:
        node = choices.choice(list(used.nodes.values()))
        node.is_silent = choices.random() < 0.3
        if choices.random() < 0.1:
            node.started = time.monotonic()
        if len(guests) < 8:
            guests.append(
                (time.monotonic() + choices.random() * 2, Station(f"tcp:127.0.0.1:{port}"))
            )
            came += 1
        for guest in [guest for guest in guests if guest[0] < time.monotonic()]:
            guests.remove(guest)
            guest[1].close()
        for _, guest in guests:
            guest.receive()
            choices.choice(
                [
                    lambda g: g.mav.param_request_list_send(SYSTEM, choices.randrange(NODES + 2)),
                    lambda g: g.mav.param_set_send(
                        SYSTEM,
                        node.node_id,
                        b"PARAMETER_03",
                        as_float(came),
                        mavlink.MAV_PARAM_TYPE_INT32,
                    ),
                    lambda g: g.mav.command_long_send(
                        SYSTEM, 0, mavlink.MAV_CMD_CAN_FORWARD, 0, 1, 0, 0, 0, 0, 0, 0
                    ),
                    lambda g: g.mav.command_long_send(
                        SYSTEM,
                        node.node_id,
                        mavlink.MAV_CMD_PREFLIGHT_STORAGE,
                        0,
                        1,
                        0,
                        0,
                        0,
                        0,
                        0,
                        0,
                    ),
                    lambda g: g.mav.file.write(os.urandom(40)),
                ]
            )(guest)
        # A station on UDP that sends only one message.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stray:
            stray.sendto(
                ground.mav.heartbeat_encode(6, 8, 0, 0, 4).pack(ground.mav),
                ("127.0.0.1", bridge.port),
            )
        ground.gather(0.1)
        if time.monotonic() > start + WARM_UP_S:
            sizes.append(resident_kb(started.process))
    for _, guest in guests:
        guest.close()
    tenth = len(sizes) // 10 or 1
    first, last = max(sizes[:tenth]), max(sizes[-tenth:])
    print(f"{CHURN_S:.0f} s, {came} connections: {first} KB, then {last} KB")
    assert last - first <= GROWTH_MAX_KB
