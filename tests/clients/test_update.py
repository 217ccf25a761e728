"""Updates through our bootloader: over the bus by pydronecan's file server, through the serial port by avrdude."""

import contextlib
import importlib
import re

import dronecan.app.file_server
import pytest
from conftest import TARGET, node_elf
from dronecan import uavcan

# It may hold the types from before conftest.py has loaded them anew.
importlib.reload(dronecan.app.file_server)

NodeStatus = uavcan.protocol.NodeStatus


@pytest.fixture
def empty_board(bench):
    """A board with nothing but our bootloader."""
    loader = TARGET / "firmware" / "boot-diecimila-seeed.hex"
    assert loader.exists(), f'{loader} is missing: run "make boot"'
    return bench("--bootloader", loader, serial=True)


def update(client, file):
    """Serves the file, and asks the node to take it. Waits until its program runs."""
    with contextlib.closing(dronecan.app.file_server.FileServer(client.node, [str(file.parent)])):
        request = uavcan.protocol.file.BeginFirmwareUpdate.Request(source_node_id=client.node.node_id)
        request.image_file_remote_path.path = file.name
        response = client.ask(request)
        assert response.error == response.ERROR_OK
        client.spin_until(lambda: client.wait_for(NodeStatus).mode == NodeStatus().MODE_OPERATIONAL, "program", timeout=60)


def test_pydronecan_s_file_server_updates_a_node_whose_loader_waits(empty_board):
    client = empty_board.dronecan()
    assert client.wait_for(NodeStatus).mode == NodeStatus().MODE_MAINTENANCE
    information = client.ask(uavcan.protocol.GetNodeInfo.Request())
    assert (str(information.name), information.hardware_version.major) == ("", 1)
    update(client, node_elf().with_suffix(".bin"))
    information = client.ask(uavcan.protocol.GetNodeInfo.Request())
    assert str(information.name) == "org.dronecan.servo168"


def test_avrdude_uploads_through_our_loader_and_the_bus_still_works(empty_board):
    used = empty_board
    line = ["-c", "arduino", "-p", "m168", "-P", used.serial, "-b", "19200", "-D", "-U", f"flash:w:{node_elf()}:e"]
    text = used.run("avrdude", *line)
    assert re.search(r"bytes of flash verified", text), text
    client = used.dronecan()
    client.spin_until(lambda: client.wait_for(NodeStatus).mode == NodeStatus().MODE_OPERATIONAL, "program", timeout=20)
