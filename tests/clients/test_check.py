"""node-check, which checks a real board, against simulated ones: healthy ones, and some with a
defect that its report must name.
"""

import contextlib
import json
import os
import pathlib
import pty
import re
import signal
import threading
import time
import tty

import pytest
from conftest import NODE, TARGET, TIMEOUT_S, Client, node_elf, project_program, wait_until
from dronecan import uavcan

FIRMWARE = TARGET / "firmware"
UNO = {"elf": node_elf("full", board="uno")}
LOADER = ["--bootloader", FIRMWARE / "boot-uno-seeed.hex"]


def start_check(used, *words, bus=None, answers=b"", **options):
    """Starts node-check. It gets the answers, and then the end of its input, unless there is a
    `stdin`.
    """
    line = [project_program("node-check"), "--bus", f"slcan:{bus or used.slcan[0]}"]
    line += ["--node", NODE, "--watch", 20, *words]
    if used.serial:
        line += ["--port", used.serial]
    if "stdin" not in options:
        options["stdin"], writing = os.pipe()
        os.write(writing, answers)
        os.close(writing)
    process = used.start(*line, **options)
    os.close(options["stdin"])
    return process


def end_check(used, process, code):
    """Waits for the end. Returns the rows of the report by their names: the verdict and what was
    seen, the worst one of a name.
    """
    text = process.communicate(timeout=240)[0].decode(errors="replace")
    assert process.returncode == code, text
    report = json.loads((used.directory / "node-check/report.json").read_text())
    rows = {}
    for row in report["rows"]:
        if rows.get(row["what"], ("",))[0] != "failed":
            rows[row["what"]] = (row["verdict"], row["seen"])
    # The table for an issue has the same rows.
    table = (used.directory / "node-check/report.md").read_text()
    assert len(re.findall(r"^\| ", table, re.M)) == len(report["rows"]) + 2, table
    return rows


def check(used, *words, code=0, answers=b"", **options):
    return end_check(used, start_check(used, *words, answers=answers, **options), code)


def failed(rows):
    return {what: seen for what, (verdict, seen) in rows.items() if verdict == "failed"}


def wait_for_output(process, text):
    """Waits until a line of the program contains a text. Returns the lines until then."""
    lines = b""
    for line in iter(process.stdout.readline, b""):
        lines += line
        if text in line:
            return lines.decode()
    raise AssertionError(lines)


def sent(used, path="node-check/bus.log"):
    """The identifiers of the frames that node-check has sent: those of its own node ID."""
    text = (used.directory / path).read_text()
    identifiers = [int(digits, 16) for digits in re.findall(r" ([0-9A-F]{8})#", text)]
    return [identifier for identifier in identifiers if identifier & 0x7F in (126, 127)]


def parameters(used):
    """All parameters of the node, by another adapter."""
    with contextlib.closing(Client(f"slcan:{used.slcan[1]}")) as client:
        client.wait_for(uavcan.protocol.NodeStatus)
        values = {}
        while name := str((response := client.parameter(index=len(values))).name):
            values[name] = response.value.integer_value
        return values


def test_a_healthy_board_passes_and_its_servo_has_not_moved(bench):
    used = bench(*LOADER, slcan=2, serial=True, **UNO)
    before = parameters(used)
    rows = check(used, "--firmware", FIRMWARE / "uno-seeed.bin", answers=b"y")
    assert not failed(rows), rows
    assert rows["Update"][0] == rows["EEPROM byte"][0] == "passed", rows
    assert rows["Servo, failsafe, plug and supply"] == ("skipped", "not wanted")
    assert used.pulse_us() is None
    assert parameters(used) == before


@pytest.mark.long
@pytest.mark.parametrize("corner", ["slow", "fast", "worst", "random:7"])
@pytest.mark.parametrize(
    "elf, options, serial",
    [
        (node_elf("full", board="uno"), LOADER, True),
        (node_elf(), [], True),
        (node_elf("remote"), ["--bootloader", FIRMWARE / "boot-diecimila-seeed.hex"], False),
    ],
    ids=["uno", "diecimila", "remote"],
)
def test_a_healthy_board_passes_at_each_corner(bench, elf, options, serial, corner):
    used = bench(*options, "--corner", corner, serial=serial, elf=elf)
    assert not failed(check(used, "--firmware", elf.with_suffix(".bin"), answers=b"y"))


def old_program(directory):
    """The program with version 2.0: the byte at address 0x72 of the flash (src/handover.rs)."""
    elf, image = UNO["elf"].read_bytes(), UNO["elf"].with_suffix(".bin").read_bytes()
    at = elf.index(image[0x60:0x80]) + 0x72 - 0x60
    old = directory / "old.elf"
    old.write_bytes(elf[:at] + b"\0" + elf[at + 1 :])
    return old


CHIP_RESETS = [word for n in range(1, 90) for word in ("--inject", f"chip-reset@{n}s")]


# The rows that name the defect, and what the first one says.
@pytest.mark.long
@pytest.mark.parametrize(
    "options, row, seen",
    [
        (["--crystal", "8", "--bit-rate", "1000000"], "Crystal of the MCP2515", "another crystal"),
        (["--clock", "+2%"], "Processor clock", r"\+[12]\.\d+ %"),
        (["--eeprom-ms", "5"], "EEPROM byte", r"^[5-6]\.\d ms"),
        (["--inject", "int-high@0s"], "INT", "INT open or shorted"),
        (["--inject", "error-rate@0s"], "Bus errors", "120 ohms"),
        (CHIP_RESETS, "MCP2515", "settings lost"),
        (["--inject", "sensor-noise@0s"], "Noise of the ADC", "degrees"),
    ],
    ids=["crystal", "resonator", "eeprom", "int", "termination", "chip-resets", "adc"],
)
@pytest.mark.parametrize("board", ["uno", "diecimila"])
def test_a_defect_is_named_in_its_row(bench, board, options, row, seen):
    elf, loader = (UNO["elf"], LOADER) if board == "uno" else (node_elf(), [])
    used = bench(*loader, *options, serial=True, elf=elf)
    found = failed(check(used, code=1))
    assert re.search(seen, found.get(row, "")), found


def test_a_wrong_crystal_is_named_without_the_serial_port(bench):
    used = bench("--crystal", "8", "--bit-rate", "1000000")
    found = failed(check(used, code=1))
    assert "half the rate" in found["Crystal of the MCP2515"], found
    assert sent(used), "the node hears nobody"


@pytest.mark.long
def test_an_old_program_fails_and_a_foreign_bootloader_does_not(bench, tmp_path):
    used = bench(serial=True, elf=old_program(tmp_path))
    rows = check(used, code=1)
    found = failed(rows)
    assert set(found) == {"Program"} and "software 2.0" in found["Program"], found
    verdict, text = rows["Update"][:2]
    assert verdict == "skipped" and "make bootloader" in text, rows["Update"]


@pytest.mark.long
def test_a_servo_that_follows_passes_after_the_question(bench):
    used = bench()
    reading, writing = os.pipe()
    process = start_check(used, stdin=reading)
    wait_for_output(process, b"Go on?")
    assert used.pulse_us() is None
    os.write(writing, b"y")
    for width in (1000, 1500, 2000):
        wait_for_output(process, b"Is the servo where %d us" % width)
        os.write(writing, b"y" if abs(used.pulse_us() - width) < 5 else b"n")
    os.close(writing)
    rows = end_check(used, process, 0)
    assert all(rows[what][0] == "passed" for what in ("Servo", "Failsafe", "Two nodes with one ID"))
    # There is no pulse, as before.
    used.wait_for_text(r"servo +no pulse\Z|servo +no pulse\n(?!.*servo +pulse)")


# A logic analyser at the pins of the simulated board: the next second of the recording of sim.
ANALYSER = """#!/usr/bin/env python3
import re, sys, time
if "--scan" in sys.argv:
    sys.exit(print("fx2lafw - Saleae Logic with 8 channels: D0 D1 D2 D3 D4 D5 D6 D7"))
def recorded():
    head, changes = open("pins.vcd").read().split("$enddefinitions $end")
    return head, re.findall(r"^#(\\d+)\\n((?:[^#].*\\n)*)", changes, re.M)
def end():
    return int(recorded()[1][-1][0])
begin = end()
while end() < begin + 10_000_000_000:
    time.sleep(0.1)
head, steps = recorded()
# As sigrok-cli 0.7.2 does.
print("META samplerate: 16000000")
print(head.replace(" OUT2 ", " SERVO ") + "$enddefinitions $end")
for at, levels in steps:
    if int(at) > begin:
        print(f"#{at}\\n{levels}", end="")
"""


@pytest.mark.long
@pytest.mark.parametrize("signal", ["SERVO", "OUT2"])
def test_a_logic_analyser_measures_the_pulses_or_names_a_wrong_pin(bench, signal):
    signals = ["--vcd", "pins.vcd", "--vcd-signals", f"{signal},INT,CS"]
    used = bench(*LOADER, *signals, "--clock", "+0.4%", **UNO)
    program = used.directory / "sigrok-cli"
    program.write_text(ANALYSER)
    program.chmod(0o755)
    path = f"{used.directory}:{os.environ['PATH']}"
    rows = check(used, answers=b"y", code=signal != "SERVO", env={**os.environ, "PATH": path})
    assert 0 < float(rows["INT to CS"][1].split()[0]) < 50, rows
    if signal == "SERVO":
        found = re.match(r"([\d.]+) us each ([\d.]+) ms", rows["Servo"][1])
        width, period = map(float, found.groups())
        assert abs(width - 2000 / 1.004) < 1 and abs(period - 20 / 1.004) < 0.01, rows
    else:
        assert failed(rows) == {"Servo": "no pulse at D0 of the analyser: the pin of output 1?"}


@pytest.mark.long
@pytest.mark.timeout(300)
def test_what_hands_do_is_noticed(bench):
    faults = ["cable@80s", "cable@89s", "brown-out@110s", "chip-power@135s", "chip-power@136s"]
    used = bench(*[word for fault in faults for word in ("--inject", fault)])
    reading, writing = os.pipe()
    os.write(writing, b"yyyy")
    process = start_check(used, stdin=reading)
    rows = end_check(used, process, 0)
    for what in ("Bus plug", "Supply cut in a SAVE", "Supply of the MCP2515"):
        assert rows[what][0] == "passed", rows
    os.close(writing)


def test_an_armed_vehicle_gets_nothing(bench):
    used = bench(slcan=2, serial=True)
    client = used.dronecan(adapter=1)
    message = uavcan.equipment.safety.ArmingStatus(status=255)
    client.node.periodic(0.2, lambda: client.node.broadcast(message))
    process = start_check(used)
    client.spin_until(lambda: process.poll() is not None, "end of the program")
    rows = end_check(used, process, 1)
    assert failed(rows) == {"Vehicle": "armed, says node 10: disarm it before the checks"}
    assert not sent(used)
    # The serial port was not opened, which would have reset the board.
    assert "the AVR was reset" not in used.text()


@pytest.mark.long
def test_a_vehicle_that_is_armed_meanwhile_ends_the_checks_and_they_put_back(bench):
    used = bench(slcan=2)
    process = start_check(used)
    wait_for_output(process, b"sets OUT1_FS_PWM from 1500")
    client = used.dronecan(adapter=1)
    message = uavcan.equipment.safety.ArmingStatus(status=255)
    client.node.periodic(0.2, lambda: client.node.broadcast(message))
    client.spin_until(lambda: process.poll() is not None, "end of the program")
    rows = end_check(used, process, 1)
    assert (rows["Vehicle"][0], rows["Put back"][0]) == ("failed", "passed"), rows
    assert client.get("OUT1_FS_PWM") == 1500


@pytest.mark.long
def test_other_nodes_get_no_request_and_keep_their_parameters(bench):
    single = bench()
    client = single.dronecan()
    client.wait_for(uavcan.protocol.NodeStatus)
    client.set("CAN_NODE", 121)
    client.save()
    single.end()
    other = single.eeprom(0).read_bytes()
    used = bench("--nodes", "1", eeproms=[bytes([255]) * 512, other])
    rows = check(used)
    assert not failed(rows), rows
    for identifier in sent(used):
        is_service = identifier >> 7 & 1
        assert not is_service or identifier >> 8 & 0x7F == NODE, hex(identifier)
        # Of messages it sends NodeStatus only.
        assert is_service or identifier >> 8 & 0xFFFF == 341, hex(identifier)
    used.end()
    assert used.eeprom(1).read_bytes() == other


def test_ctrl_c_puts_the_parameters_back(bench):
    used = bench(slcan=2)
    process = start_check(used)
    wait_for_output(process, b"sets OUT1_FS_PWM from 1500")
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    rows = end_check(used, process, 5)
    assert rows["Put back"][0] == "passed", rows
    client = used.dronecan(adapter=1)
    assert client.get("OUT1_FS_PWM") == 1500
    # Not only until the next restart.
    client.restart()
    assert client.get("OUT1_FS_PWM") == 1500


def test_after_a_kill_the_next_run_puts_the_parameters_back(bench):
    used = bench(slcan=2)
    process = start_check(used)
    wait_for_output(process, b"sets OUT1_FS_PWM from 1500")
    left = used.directory / f"node-check/put-back-{NODE}.json"
    wait_until(left.exists, "note of what is changed")
    time.sleep(0.5)
    process.kill()
    process.wait(TIMEOUT_S)
    client = used.dronecan(adapter=1)
    assert client.get("OUT1_FS_PWM") != 1500
    process = start_check(used)
    wait_for_output(process, b"puts back what an earlier run has changed")
    wait_for_output(process, b"passed  Parameters")
    assert not left.exists()
    process.send_signal(signal.SIGINT)
    end_check(used, process, 5)
    assert client.get("OUT1_FS_PWM") == 1500


class Adapter:
    """A port at a path that passes all bytes to a port of the bench, and that can be pulled."""

    def __init__(self, path, behind):
        self.path, self.behind = pathlib.Path(path), behind
        self.plug()

    def plug(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.is_in = True
        self.path.symlink_to(os.ttyname(self.slave))
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        os.set_blocking(self.master, False)
        while self.is_in:
            try:
                self.behind.write_all(os.read(self.master, 4096))
            except (BlockingIOError, OSError):
                pass
            if data := self.behind.read():
                os.write(self.master, data)
            time.sleep(0.001)

    def pull(self):
        self.is_in = False
        self.thread.join()
        self.path.unlink()
        os.close(self.slave)
        os.close(self.master)


@pytest.mark.parametrize("comes_back", [True, False])
def test_an_adapter_that_is_pulled_ends_the_checks_and_when_it_is_back_puts_back(bench, comes_back):
    used = bench(slcan=2)
    adapter = Adapter(used.directory / "pulled", used.raw())
    process = start_check(used, bus=adapter.path)
    wait_for_output(process, b"sets OUT1_FS_PWM from 1500" if comes_back else b"sends nothing")
    time.sleep(1)
    adapter.pull()
    if comes_back:
        wait_for_output(process, b"plug it in again")
        time.sleep(2)
        adapter.plug()
    rows = end_check(used, process, 3)
    assert (rows.get("Put back", ("",))[0] == "passed") == comes_back, rows
    assert used.dronecan(adapter=1).get("OUT1_FS_PWM") == 1500
    if comes_back:
        adapter.pull()


@pytest.mark.parametrize(
    "words, code, text",
    [
        (["--node", "0"], 2, "not a node ID"),
        (["--bus", "slcan:/dev/null/none"], 3, "cannot open|there is no"),
        (["--port", "none"], 3, "is the Arduino plugged in"),
        (["--firmware", "/dev/null"], 2, "is not a firmware file"),
    ],
)
def test_a_wrong_command_line_and_missing_ports_have_codes_of_their_own(bench, words, code, text):
    used = bench()
    given = {"--bus": f"slcan:{used.slcan[0]}", "--node": NODE}
    given.update([words])
    line = [word for option in given.items() for word in option]
    process = used.start(project_program("node-check"), *line)
    output = process.communicate(timeout=TIMEOUT_S)[0].decode()
    assert process.returncode == code and re.search(text, output), output
