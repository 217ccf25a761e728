"""The Arduino's serial port: uploads through the original bootloader, and the serial monitor."""

import fcntl
import os
import pathlib
import re
import shlex
import signal
import subprocess
import termios
import time
import tomllib

import pytest
import serial
from dronecan import uavcan

from conftest import ROOT, TARGET, TIMEOUT_S, node_elf, program, wait_until

pytestmark = pytest.mark.at_corners

# Debian's arduino-core-avr.
BOOTLOADERS = pathlib.Path("/usr/share/arduino/hardware/arduino/avr/bootloaders")
BOOTLOADER = BOOTLOADERS / "atmega/ATmegaBOOT_168_diecimila.hex"
MONITOR_BAUD = 115200
# The ioctl of Linux that tells if a terminal is locked. Python has no name for it.
TIOCGEXCL = 0x80045440
# What a user types; .cargo/config.toml has the runner. RAVEDUDE_PORT is the board's port.
CARGO_RUN = (
    "cargo run --config avr-specs/firmware.toml --profile firmware -p servo-node"
    " --target avr-specs/avr-atmega168.json"
)


@pytest.fixture
def empty_board(bench):
    """A board that has only its bootloader."""
    assert BOOTLOADER.exists(), 'there is no bootloader: "make test" installs arduino-core-avr'
    return bench("--bootloader", BOOTLOADER, "--no-program", serial=True)


def test_the_serial_monitor_prints_lines(bench):
    used = bench("--temperature", "40", serial=True)
    with serial.Serial(str(used.serial), MONITOR_BAUD, timeout=TIMEOUT_S) as port:
        text = port.read_until(b"temperature")
        assert b"temperature" in text, text
        port.write(b"?")
        assert port.read(20)


def test_opening_the_port_resets_the_board(bench):
    used = bench(serial=True)
    used.still_runs()
    used.raw(used.serial)
    used.wait_for_text(r" reset ")


def test_a_program_that_locks_a_port_locks_it_only_while_it_runs(bench):
    """ravedude locks its port, and does not unlock it when Ctrl-C ends it."""
    used = bench(serial=True)

    def is_locked(path):
        port = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            return any(fcntl.ioctl(port, TIOCGEXCL, bytes(4)))
        finally:
            os.close(port)

    for path in used.links:
        port = os.open(path, os.O_RDWR | os.O_NOCTTY)
        fcntl.ioctl(port, termios.TIOCEXCL)
        assert is_locked(path), f"{path} is not locked by a program that has locked it"
        os.close(port)
        wait_until(lambda path=path: not is_locked(path), f"unlocked {path}")


def test_avrdude_uploads_through_the_original_bootloader(empty_board):
    used = empty_board
    used.upload()
    # The node runs if it sends on the bus.
    used.dronecan().wait_for(uavcan.protocol.NodeStatus)


@pytest.mark.long
def test_a_client_that_gets_no_processor_for_seconds_completes_its_upload(empty_board):
    used = empty_board
    upload = used.start(*used.upload_line(node_elf()))
    for _ in range(3):
        time.sleep(2)
        os.killpg(upload.pid, signal.SIGSTOP)
        # The bootloader waits for a second of simulated time.
        time.sleep(4)
        os.killpg(upload.pid, signal.SIGCONT)
    text = upload.communicate(timeout=120)[0].decode(errors="replace")
    assert upload.returncode == 0 and re.search(r"bytes of flash verified", text), text


@pytest.mark.long
def test_avrdude_finds_no_bootloader_at_another_baud_rate(bench):
    image = BOOTLOADERS / "atmega/ATmegaBOOT_168_atmega328.hex"
    options = ["--bootloader", image, "--no-program", "--board", "nano", "--shield", "seeed"]
    line = ["avrdude", "-c", "arduino", "-p", "m328p", "-b", "115200"]
    # Without the second option it finds the bootloader for 57,600 baud.
    for more in [[], ["--serial-any-baud"]]:
        used = bench(*options, *more, serial=True, fresh=True)
        text = used.run(*line, "-P", used.serial, timeout=120, check=False)
        assert ("not in sync" not in text and "0x1e950f" in text) == bool(more), text
        # 58,823 baud at 16 MHz, within 1 %.
        hint = re.search(r"115200 baud\. The board has 5[89]\d{3}", used.text())
        assert (hint is None) == bool(more), used.text()


# cargo waits while other parts of "make test" compile.
@pytest.mark.timeout(900)
def test_cargo_run_uploads_with_ravedude_and_shows_the_serial_monitor(empty_board):
    used = empty_board
    ravedude = pathlib.Path(program("ravedude"))
    environment = dict(os.environ, RAVEDUDE_PORT=str(used.serial))
    environment["PATH"] = os.pathsep.join([str(ravedude.parent), environment["PATH"]])
    output = used.directory / "ravedude.txt"

    def shown():
        """The output of ravedude's console. avrdude has closed the port before the console opens
        it.
        """
        return output.read_text(errors="replace").partition(f"Console {used.serial}")[2]

    def upload():
        with open(output, "wb") as file, open(TARGET / "firmware/lock", "w") as lock:
            # The same lock as in scripts/firmware: no other build may start before avrdude has read
            # the ELF.
            fcntl.flock(lock, fcntl.LOCK_EX)
            cargo = used.start(
                *shlex.split(CARGO_RUN),
                cwd=ROOT,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=file,
            )
            wait_until(
                lambda: b"flash written" in output.read_bytes() or cargo.poll() is not None,
                "written flash",
                timeout=400,
            )
        return cargo

    cargo, uploads = upload(), 1
    if b"protocol expects" in output.read_bytes():
        # On a machine without a free processor the board may answer after the quarter of a second
        # that avrdude waits. A person tries again.
        cargo, uploads = upload(), 2
    wait_until(
        lambda: "temperature +" in shown() or cargo.poll() is not None,
        "line of the monitor",
        timeout=400,
    )
    assert cargo.poll() is None, output.read_text(errors="replace")
    # Like a terminal at Ctrl-C.
    os.killpg(cargo.pid, signal.SIGINT)
    exit_code = cargo.wait(TIMEOUT_S)
    text = output.read_text(errors="replace")
    assert exit_code == 0 and "bytes of flash verified" in text, text
    # The board starts when the console opens the port, so the console shows the banner, once.
    assert re.search(r"at 115200 baud\s+CTRL\+C to exit\.\s+DroneCAN servo node", shown()), text
    assert shown().count("reset:") == 1, text
    used.end()
    assert len(re.findall(r" reset +the AVR was reset: External", used.text())) == uploads + 1
    size = re.search(r"(\d+) bytes of flash verified", text)[1]
    assert f"\nflash           {size} of " in used.text()


def test_cargo_upload_is_short_for_cargo_run():
    alias = tomllib.loads((ROOT / ".cargo/config.toml").read_text())["alias"]["upload"]
    assert ["cargo", *alias] == shlex.split(CARGO_RUN)


# First address of its section.
OPTIBOOT = 0x7C00


def optiboot():
    """The bootloader of the Uno."""
    line = [ROOT / "scripts/optiboot"]
    return subprocess.run(line, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


# Half of the bytes where half of the baud rate makes them slow.
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("board", "shield", "preset"),
    [("uno", "module", "full"), ("nano", "seeed", "default"), ("duemilanove", "seeed", "default")],
)
def test_make_flash_uploads_to_boards_with_an_atmega328p(bench, board, shield, preset):
    bootloader = (
        optiboot()
        if board == "uno"
        else BOOTLOADERS / "atmega/ATmegaBOOT_168_atmega328.hex"
    )
    used = bench(
        "--bootloader",
        bootloader,
        "--no-program",
        "--board",
        board,
        "--shield",
        shield,
        # Until the port is opened, Optiboot calls the program that is not there, and erased flash
        # leads back to it. After 1.07 s its stack has reached the I/O registers, as on a real chip.
        *(["--allow", "mistakes"] if board == "uno" else []),
        serial=True,
        fresh=True,
    )
    # All boards with this chip run the same program.
    name = f"{shield}.elf" if preset == "full" else f"{shield}-{preset}.elf"
    built = TARGET / "firmware" / f"uno-{name}"
    mine = built.with_name(f"{board}-{name}")
    if mine != built:
        mine.write_bytes(built.read_bytes())
    output = used.directory / "ravedude.txt"
    with open(output, "wb") as file:
        flash = used.start(
            ROOT / "scripts/flash",
            "--board",
            board,
            "--shield",
            shield,
            "--port",
            str(used.serial),
            preset,
            stdin=subprocess.PIPE,
            stdout=file,
            cwd=ROOT,
        )
        wait_until(
            lambda: b"temperature +" in output.read_bytes() or flash.poll() is not None,
            "line of the monitor",
            timeout=800,
        )
        assert flash.poll() is None, output.read_text(errors="replace")
        os.killpg(flash.pid, signal.SIGINT)
        exit_code = flash.wait(TIMEOUT_S)
    text = output.read_text(errors="replace")
    assert exit_code == 0 and "bytes of flash verified" in text and "DroneCAN servo node" in text, (
        text
    )
    used.end()
    of_mistakes = re.findall(r"^mistake .*\(PC (0x[0-9a-f]+)\)$", used.text(), re.MULTILINE)
    assert all(int(address, 16) >= OPTIBOOT for address in of_mistakes), used.text()
