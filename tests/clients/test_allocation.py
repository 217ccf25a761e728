"""Dynamic node IDs from pydronecan's allocator, for one board and for five that start at the same
moment.
"""

import re

import pytest
from dronecan import uavcan
from dronecan.app.dynamic_node_id import CentralizedServer
from dronecan.app.node_monitor import NodeMonitor
from dronecan.transport import Transfer

from conftest import NODE, node_elf, run_sim

protocol = uavcan.protocol


def request_line(time_s, request, transfer_id):
    """The frames of a request from node 127, as lines of a script for the simulator."""
    transfer = Transfer(
        payload=request,
        source_node_id=127,
        dest_node_id=NODE,
        transfer_id=transfer_id,
        transfer_priority=30,
        service_not_message=True,
        request_not_response=True,
    )
    return "".join(
        f"({time_s}) can0 {f.message_id:08X}#{bytes(f.bytes).hex().upper()}\n"
        for f in transfer.to_frames()
    )


@pytest.fixture(scope="session")
def boards_without_id(tmp_path_factory):
    """EEPROMs of five boards with CAN_NODE 0. Their unique IDs differ, because one simulation
    generated them.
    """
    directory = tmp_path_factory.mktemp("boards_without_id")
    get_set = protocol.param.GetSet.Request(name="CAN_NODE")
    get_set.value = protocol.param.Value(integer_value=0)
    save = protocol.param.ExecuteOpcode.Request(opcode=0)
    # All boards are node 120 at first and answer at once, which can destroy frames. So the script
    # repeats the requests.
    lines = "".join(
        request_line(1.8 + 0.5 * n, get_set, n) + request_line(2.0 + 0.5 * n, save, n)
        for n in range(3)
    )
    (directory / "script").write_text(lines)
    options = ["--nodes", "4", "--no-autopilot", "--for", "4s", "--script", directory / "script"]
    run_sim(
        directory, *options, "--eeprom", directory / "eeprom", elf=node_elf("full", board="uno")
    )
    names = ["eeprom", *(f"eeprom.{n}" for n in range(1, 5))]
    return [(directory / name).read_bytes() for name in names]


class Allocator:
    """pydronecan's allocator on a bench."""

    def __init__(self, used):
        self.client = used.dronecan(node_id=126)
        self.monitor = NodeMonitor(self.client.node)
        self.server = CentralizedServer(self.client.node, self.monitor)

    def allocated(self):
        """Node IDs by unique ID, only of nodes that are online. The allocator's own entry has no
        unique ID.
        """
        entries = [
            (bytes(unique_id), node_id)
            for unique_id, node_id in self.server.get_allocation_table()
            if unique_id
        ]
        return {
            unique_id: node_id for unique_id, node_id in entries if self.monitor.exists(node_id)
        }


def test_one_board_is_allocated_an_id_and_works(bench, boards_without_id):
    used = bench(eeproms=boards_without_id[:1], elf=node_elf("full", board="uno"))
    allocator = Allocator(used)
    client = allocator.client
    entries = client.spin_until(allocator.allocated, "allocation")
    ((unique_id, node_id),) = entries.items()
    client.spin_until(lambda: allocator.monitor.get(node_id).info, "information")
    assert bytes(allocator.monitor.get(node_id).info.hardware_version.unique_id) == unique_id
    assert client.get("CAN_NODE", node=node_id) == 0, "the allocated ID must not become a parameter"
    client.command((1, 0, 0.5))
    client.spin_until(lambda: used.pulse_us() == 1750, "pulse of 1750 us")


def test_it_gets_the_same_id_after_a_restart(bench, boards_without_id):
    used = bench(eeproms=boards_without_id[:1], elf=node_elf("full", board="uno"))
    allocator = Allocator(used)
    client = allocator.client
    entries = client.spin_until(allocator.allocated, "allocation")
    (node_id,) = entries.values()
    client.spin_until(lambda: allocator.monitor.get(node_id).info, "information")
    request = protocol.RestartNode.Request()
    request.magic_number = request.MAGIC_NUMBER
    assert client.ask(request, node_id).ok
    client.spin(4)
    assert len(re.findall(r", reset: ", used.text())) == 2
    assert allocator.allocated() == entries
    assert client.get("CAN_NODE", node=node_id) == 0


@pytest.mark.timeout(120)
def test_five_boards_that_start_together_are_allocated_five_ids(bench, boards_without_id):
    used = bench("--nodes", "4", eeproms=boards_without_id, elf=node_elf("full", board="uno"))
    allocator = Allocator(used)
    client = allocator.client
    client.spin_until(lambda: len(allocator.allocated()) == 5, "five allocations", timeout=60)
    entries = allocator.allocated()
    assert len(set(entries.values())) == 5
    client.spin_until(
        lambda: all(allocator.monitor.get(n).info for n in entries.values()),
        "information of all",
        timeout=30,
    )
    for unique_id, node_id in entries.items():
        assert bytes(allocator.monitor.get(node_id).info.hardware_version.unique_id) == unique_id
    # Each node keeps its ID and answers under it.
    client.spin(3)
    assert allocator.allocated() == entries
    for node_id in entries.values():
        assert client.get("OUT1_ID", node=node_id) == 1


def test_the_simulated_autopilot_allocates_ids(bench, boards_without_id):
    options = ["--allocate", "--autopilot", "ardupilot", "--nodes", "1"]
    used = bench(
        *options,
        autopilot=True,
        eeproms=boards_without_id[:2],
        slcan=0,
        elf=node_elf("full", board="uno"),
    )
    used.wait_for_text(r" node +125 is allocated to unique ID [0-9A-F]{32}$")
    used.wait_for_text(r" node +124 is allocated to unique ID [0-9A-F]{32}$")
    used.wait_for_text(r" node +125 is org\.\S+ software ")
    ids = re.findall(r"is allocated to unique ID ([0-9A-F]{32})$", used.text(), re.M)
    assert len(set(ids)) == 2


def test_boards_of_one_simulation_generate_different_unique_ids(boards_without_id):
    """The simulator models the jitter of the watchdog's oscillator, from a seed for each board."""
    assert len(set(boards_without_id)) == 5
