"""The Arduino's serial port: uploads through its genuine boot loader, and the serial monitor."""

import os
import pathlib
import re
import signal

import pytest
import serial
from dronecan import uavcan

from conftest import ROOT, node_elf, program, wait_until

# Debian's arduino-core-avr.
BOOTLOADER = pathlib.Path(
    "/usr/share/arduino/hardware/arduino/avr/bootloaders/atmega/ATmegaBOOT_168_diecimila.hex"
)
MONITOR_BAUD = 57600


@pytest.fixture
def empty_board(bench):
    """A board with nothing but its boot loader."""
    assert BOOTLOADER.exists(), 'there is no boot loader: "make test" installs arduino-core-avr'
    return bench("--bootloader", BOOTLOADER, serial=True)


def test_the_monitor_tells_how_the_node_does(bench):
    used = bench("--temperature", "40", serial=True)
    with serial.Serial(str(used.serial), MONITOR_BAUD, timeout=5) as port:
        text = port.read_until(b"temperature")
        assert b"temperature" in text, text
        port.write(b"?")
        assert port.read(20)


def test_opening_the_port_resets_the_board(bench):
    used = bench(serial=True)
    used.goes_on()
    used.raw(used.serial)
    used.wait_for_text(r" reset ")


def test_avrdude_uploads_through_the_boot_loader(empty_board):
    used = empty_board
    line = ["-c", "arduino", "-p", "m168", "-P", used.serial, "-b", "19200", "-D", "-U", f"flash:w:{node_elf()}:e"]
    text = used.run("avrdude", *line)
    assert re.search(r"bytes of flash verified", text), text
    # The node runs: it says so on the bus.
    used.dronecan().wait_for(uavcan.protocol.NodeStatus)


@pytest.mark.timeout(120)
def test_cargo_run_uploads_with_ravedude_and_shows_the_monitor(empty_board):
    used = empty_board
    ravedude = pathlib.Path(program("ravedude"))
    environment = dict(os.environ, RAVEDUDE_PORT=str(used.serial))
    environment["PATH"] = os.pathsep.join([str(ravedude.parent), environment["PATH"]])
    output = used.directory / "ravedude.txt"
    with open(output, "wb") as file:
        cargo = used.start("cargo", "upload", cwd=ROOT, env=environment, stdout=file)
        wait_until(
            lambda: b"temperature" in output.read_bytes() or cargo.poll() is not None, "line of the monitor", timeout=60
        )
        os.killpg(cargo.pid, signal.SIGINT)
        cargo.wait(10)
    text = output.read_text(errors="replace")
    assert "bytes of flash verified" in text and "temperature" in text, text
