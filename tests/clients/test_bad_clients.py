"""Clients that hang, flood or die. The simulation must continue, and the next client must work."""

import os
import re
import signal
import time

import pytest
from dronecan import uavcan

from conftest import TIMEOUT_S, node_elf, project_program
from test_python_can import start_logger


def opened(used):
    port = used.raw()
    port.ask(b"C\r")
    assert port.ask(b"S8\r") == port.ask(b"O\r") == b"\r"
    return port


def assert_works(used):
    assert used.still_runs()
    used.dronecan().wait_for(uavcan.protocol.NodeStatus)


def test_a_client_that_never_reads_does_not_stop_the_simulation(bench):
    used = bench(autopilot=True)
    port = opened(used)
    used.still_runs()
    used.still_runs()
    port.close()
    used.clients.pop_all()
    assert_works(used)


def test_a_client_that_floods_does_not_stop_the_simulation(bench):
    used = bench(slcan=2)
    port = opened(used)
    end = time.monotonic() + 3
    while time.monotonic() < end:
        port.write(b"T1FFFFFA58FFFFFFFFFFFFFFFF\r" * 100)
    assert used.still_runs()
    used.dronecan(1).wait_for(uavcan.protocol.NodeStatus)


def test_a_client_that_dies_during_a_frame_does_not_stop_the_simulation(bench):
    used = bench()
    port = opened(used)
    port.write_all(b"T1404562A60100")
    used.clients.close()
    assert_works(used)


def test_invalid_input_is_answered_with_errors(bench):
    used = bench()
    port = opened(used)
    for rubbish in [
        b"T\r",
        b"T1404562AF00\r",
        b"t8001\r",
        b"x" * 10_000 + b"\r",
        b"\x00\xff\xfe\r",
        b"TXYZ\r",
        b"S9\r",
    ]:
        assert port.ask(rubbish) == b"\x07", rubbish[:20]
        port.read()
    port.write_all(os.urandom(20_000))
    port.read(0.5)
    port.write_all(b"\rC\r")
    used.clients.close()
    assert_works(used)


def test_after_a_client_is_killed_the_next_one_can_connect(bench):
    used = bench()
    logger = start_logger(used, "out.log")
    os.killpg(logger.pid, signal.SIGKILL)
    logger.wait()
    assert_works(used)


def test_the_error_for_a_path_in_use_has_the_path(bench):
    used = bench()
    other = used.directory / "file"
    other.write_text("precious")
    line = [
        project_program("sim"),
        "--plain",
        "--no-autopilot",
        "--for",
        "1s",
        "--elf",
        node_elf(),
        "--slcan",
    ]
    for path in (used.slcan[0], other):
        text = used.run(*line, path, check=False)
        assert str(path) in text and text.startswith("sim: "), text
    assert other.read_text() == "precious"
    assert used.still_runs()


@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_each_signal_removes_the_links(bench, signal_number):
    used = bench(slcan=2, serial=True)
    used.process.send_signal(signal_number)
    assert used.process.wait(TIMEOUT_S) == 0
    assert not any(os.path.lexists(path) for path in used.links)


def test_a_repeated_signal_ends_the_simulation_normally(bench):
    """`timeout` sends the second signal, or make passes it on."""
    used = bench(slcan=1, serial=True)
    for signal_number in (signal.SIGTERM, signal.SIGINT, signal.SIGTERM):
        used.process.send_signal(signal_number)
    assert used.process.wait(TIMEOUT_S) == 0
    assert re.search(r"^simulated ", used.text(), re.M)
    assert not any(os.path.lexists(path) for path in used.links)
