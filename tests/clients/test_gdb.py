"""avr-gdb attached to the running simulator.

It debugs a firmware that the linker has not relaxed: in the one that ships, line numbers are wrong
(docs/bench.md).
"""

import re
import signal
import subprocess
import time

import pytest
from dronecan import uavcan

from conftest import TIMEOUT_S, free_port, node_elf, project_program, wait_until


def debug(used, port, *commands, **options):
    line = [
        "avr-gdb",
        "-nx",
        "-batch",
        "-ex",
        "set tcp connect-timeout 60",
        "-ex",
        f"target remote localhost:{port}",
    ]
    for command in commands:
        line += ["-ex", command]
    return used.run(*line, node_elf(gdb=True), **options)


@pytest.fixture
def debugged(bench):
    """Starts a bench with the firmware for avr-gdb. Returns it and the port."""

    def start(*options):
        port = free_port()
        return bench("--gdb", port, *options, elf=node_elf(gdb=True)), port

    return start


def test_lines_of_the_debug_information_begin_at_instructions():
    """In the shipped ELF they do not: the linker moves code when it relaxes calls, and does not
    correct the line table.
    """

    def dump(*options):
        return subprocess.run(
            ["avr-objdump", *options, node_elf(gdb=True)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    instructions = {
        int(address, 16) for address in re.findall(r"^ *([0-9a-f]+):\t", dump("-d"), re.M)
    }
    lines = [
        int(address, 16)
        for address in re.findall(r"^\S+ +\d+ +(0x[0-9a-f]+)\b", dump("--dwarf=decodedline"), re.M)
    ]
    inside = [address for address in lines if address not in instructions]
    # Functions that the linker removed have address 0.
    assert len(lines) > 500 and len(inside) < len(lines) / 200, (
        f"{len(inside)} of {len(lines)} are inside an instruction"
    )


def test_the_node_stops_at_a_breakpoint_and_continues(debugged):
    used, port = debugged()
    text = debug(
        used,
        port,
        "break firmware::node::Node::expire<servo_node::board::flash::Image>",
        "continue",
        "backtrace 2",
        "print now_ms",
        "info registers pc",
        "stepi",
        "delete",
        "detach",
    )
    assert "Breakpoint 1" in text and "Node::expire" in text and "#1" in text and "$1 = " in text, (
        text
    )
    # The node continues as if it had not been stopped.
    client = used.dronecan()
    uptimes = [status.uptime_sec for status in client.gather(uavcan.protocol.NodeStatus, 3)]
    assert uptimes == sorted(uptimes) and uptimes[2] > uptimes[0]


def test_gdb_writes_a_byte_of_each_memory(debugged):
    """GDB uses the node's language, Rust, which does not have `{char}`."""
    used, port = debugged("--eeprom", "eeprom.bin")
    commands = []
    # Addresses that neither program nor stack use.
    for address in (0x810004, 0x8003A0, 0x3F00):
        commands += [f"with language c -- set {{char}}{address} = 5", f"x/xb {address}"]
    text = debug(used, port, *commands, "detach")
    assert len(re.findall(r"^0x(?:810004|8003a0|3f00).*:\s0x05$", text, re.M)) == 3, text
    used.end()
    assert (used.directory / "eeprom.bin").read_bytes()[:6] == b"\xff\xff\xff\xff\x05\xff"


def test_the_bus_stops_while_the_node_is_halted(debugged):
    used, port = debugged()
    attach = ["-ex", f"target remote localhost:{port}", "-ex", "shell touch attached; sleep 30"]
    used.start("avr-gdb", "-nx", "-batch", *attach, node_elf(gdb=True))
    wait_until((used.directory / "attached").exists, "debugger")
    halted_at = used.time_s()
    time.sleep(1.5)
    assert used.time_s() == halted_at
    # Ctrl-C must work while the node is halted.
    used.process.send_signal(signal.SIGINT)
    assert used.process.wait(TIMEOUT_S) == 0


def test_the_error_for_a_port_in_use_has_the_port(debugged):
    used, port = debugged()
    text = used.run(
        project_program("sim"),
        "--plain",
        "--for",
        "1s",
        "--gdb",
        port,
        "--elf",
        node_elf(),
        check=False,
    )
    assert str(port) in text and "in use" in text, text
