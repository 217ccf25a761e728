"""A simulated bench for each test, and client programs of other projects.

A case takes three lines:

    def test_the_node_is_warm(bench):
        client = bench("--temperature", "40").dronecan()
        assert client.wait_for(dronecan.uavcan.equipment.device.Temperature).temperature > 310

`bench(...)` starts `sim` with these options and `slcan=N` SLCAN adapters, in real time and in a
process group of its own. When the test is over its clients are closed, the simulator gets Ctrl-C,
and must then end with exit code 0 and leave no link behind. It does not exit with 0 if the node
crashed or its program misused the chip. No process outlives a test.

Boards have started before, so that none spends time on generating a unique ID; `fresh=True` starts
new boards. Their firmware has the default preset, or is `elf=node_elf("thesis")`.

The programs are $SIM_BIN and $BRIDGE_BIN, or the newer of cargo's debug and release builds.
ground.py has the fixtures for tests of the bridge, many_nodes.py those for buses with many nodes.
"""

import contextlib
import functools
import importlib
import os
import pathlib
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import termios
import time
import tomllib
import tty

# pymavlink, which pydronecan also uses, reads this when it is imported.
os.environ["MAVLINK20"] = "1"

import dronecan
import dronecan.app.dynamic_node_id
import dronecan.app.node_monitor
import pytest

pytest_plugins = ["ground", "many_nodes"]

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGE = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]
# Major and minor version of the project and of the node.
VERSION = tuple(int(number) for number in PACKAGE["version"].split(".")[:2])
TARGET = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
NODE = 120
# The node sends a status each second. A busy machine needs more time.
TIMEOUT_S = 30

# In a script's background process SIGINT is ignored, and the programs that start from here would
# inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Our own types, loaded as a user loads them: the directory is the namespace. Loading creates all
# types again, also the standard ones, so it must come before any use. The applications of
# pydronecan hold the old types, so they are loaded again.
dronecan.load_dsdl(str(ROOT / "tests" / "clients" / "dsdl" / "thesis"))
importlib.reload(dronecan.app.node_monitor)
importlib.reload(dronecan.app.dynamic_node_id)


def project_program(name):
    """The path of a program of the project: "sim", "bridge" or "node-update"."""
    if path := os.environ.get(f"{name.upper()}_BIN"):
        return pathlib.Path(path)
    built = [
        path
        for path in (TARGET / profile / name for profile in ("debug", "release"))
        if path.exists()
    ]
    if not built:
        pytest.exit(f'there is no {name}: run "cargo build --bin {name}" first', 2)
    return max(built, key=lambda path: path.stat().st_mtime)


# The preset that the name of a board's ELF does not contain.
PRESETS = {"diecimila": "default", "uno": "full"}


def node_elf(features="default", gdb=False, board="diecimila"):
    """The path of the firmware with a preset or a list of features such as "lights,stats"; with
    `gdb` the one for avr-gdb.
    """
    if (
        features == "default"
        and board == "diecimila"
        and not gdb
        and (path := os.environ.get("NODE_ELF"))
    ):
        return pathlib.Path(path)
    name = [f"{board}-seeed"]
    if features != PRESETS[board]:
        name.append("+".join(sorted(features.split(","))))
    if gdb:
        name.append("gdb")
    path = TARGET / "firmware" / ("-".join(name) + ".elf")
    option = "--gdb " if gdb else ""
    assert path.exists(), (
        f"{path} is missing: run scripts/firmware {option}--board {board} {features}"
    )
    return path


def program(name):
    """The path of a program that the Makefile installs: in the Python environment, by cargo, or by
    the system.
    """
    path = os.pathsep.join(
        [os.path.dirname(sys.executable), str(TARGET / "tools/bin"), os.environ["PATH"]]
    )
    found = shutil.which(name, path=path)
    assert found, f'there is no {name}: "make test" installs it'
    return found


def wait_until(condition, what, timeout=TIMEOUT_S):
    end = time.monotonic() + timeout
    while not (result := condition()):
        assert time.monotonic() < end, f"no {what} within {timeout} s"
        time.sleep(0.02)
    return result


GIVEN_PORTS = set()


def free_port():
    """A port of the loopback interface that is free for TCP and for UDP. Each call returns another
    one.

    It is below the range from which the kernel chooses ports itself (Linux: from 32768 on). The
    kernel could give a port of that range to a client of another test before the program under test
    opens it.
    """
    choices = random.SystemRandom()
    while True:
        port = choices.randrange(10_000, 32_768)
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
            try:
                tcp.bind(("127.0.0.1", port))
                udp.bind(("127.0.0.1", port))
            except OSError:
                continue
        if port not in GIVEN_PORTS:
            GIVEN_PORTS.add(port)
            return port


# A process that is started in the namespace dies with the namespace's first process.
UNSHARE = ["unshare", "--net", "--pid", "--fork", "--kill-child"]


@functools.cache
def namespace(setup):
    """The beginning of a command line that runs in its own network namespace after `setup` as root.
    Tries root, a user namespace and sudo.
    """
    back = ["setpriv", f"--reuid={os.getuid()}", f"--regid={os.getgid()}", "--clear-groups"]
    ways = [
        (UNSHARE, []),
        ([*UNSHARE, "--map-root-user"], []),
        (["sudo", "-n", "--preserve-env", *UNSHARE], back),
    ]
    for way, user in ways:
        line = [*way, "sh", "-c", f'set -e\n{setup}\nexec "$@"', "sh", *user]
        if (
            shutil.which(way[0])
            and subprocess.run([*line, "true"], capture_output=True).returncode == 0
        ):
            return line
    pytest.fail("cannot create a network namespace: be root, or let sudo work without a password")


class Client:
    """A pydronecan node on one of the bench's SLCAN adapters, or on its multicast bus."""

    def __init__(self, device, node_id=10):
        info = dronecan.uavcan.protocol.GetNodeInfo.Response()
        info.name = "org.example.client"
        self.node = dronecan.make_node(device, node_id=node_id, bitrate=1_000_000, node_info=info)

    def close(self):
        self.node.close()
        # The multicast driver does not end its own process.
        if process := getattr(self.node.can_driver, "proc", None):
            process.terminate()
            process.join(TIMEOUT_S)

    def spin(self, seconds):
        self.node.spin(seconds)

    def gather(self, data_type, count, timeout=TIMEOUT_S, source=NODE):
        """The next `count` messages of this type from node `source`."""
        messages = []

        def heard(event):
            if event.transfer.source_node_id == source:
                messages.append(event.message)

        handle = self.node.add_handler(data_type, heard)
        end = time.monotonic() + timeout
        try:
            while len(messages) < count:
                assert time.monotonic() < end, (
                    f"{len(messages)} of {count} {data_type} within {timeout} s"
                )
                self.node.spin(0.05)
        finally:
            handle.remove()
        return messages[:count]

    def wait_for(self, data_type, timeout=TIMEOUT_S, source=NODE):
        return self.gather(data_type, 1, timeout, source)[0]

    def spin_until(self, condition, what, timeout=TIMEOUT_S):
        end = time.monotonic() + timeout
        while not (result := condition()):
            assert time.monotonic() < end, f"no {what} within {timeout} s"
            self.node.spin(0.05)
        return result

    def assert_in_node_monitor(self):
        """Checks that pydronecan's node monitor lists the node as healthy, and continues to."""
        monitor = dronecan.app.node_monitor.NodeMonitor(self.node)
        self.spin_until(lambda: monitor.exists(NODE), "node 120 in the monitor")
        status = monitor.get(NODE).status
        assert (status.health, status.mode) == (status.HEALTH_OK, status.MODE_OPERATIONAL)
        # The monitor removes a node after three seconds of silence.
        self.spin(4)
        assert monitor.exists(NODE)

    def ask(self, request, node=NODE, timeout=TIMEOUT_S, response_timeout=None):
        """The response to a request; `None` if none arrives within `response_timeout`, for which
        pydronecan takes a second.
        """
        events = []
        self.node.request(request, node, events.append, timeout=response_timeout)
        event = self.spin_until(lambda: events, f"response to {request}", timeout)[0]
        return event and event.response

    def parameter(self, name="", index=0, node=NODE, **value):
        """Sets a parameter if there is a value, such as `integer_value=1100`, and returns it."""
        request = dronecan.uavcan.protocol.param.GetSet.Request(index=index, name=name)
        request.value = dronecan.uavcan.protocol.param.Value(
            **(value or {"empty": dronecan.uavcan.protocol.param.Empty()})
        )
        response = self.ask(request, node)
        assert response is not None, f"no answer for parameter {name or index}"
        return response

    def get(self, name, node=NODE):
        return self.parameter(name, node=node).value.integer_value

    def set(self, name, value, node=NODE):
        response = self.parameter(name, node=node, integer_value=value)
        assert (str(response.name), response.value.integer_value) == (name, value)

    def execute(self, opcode, node=NODE):
        """True if the node reports that it executed the opcode."""
        request = dronecan.uavcan.protocol.param.ExecuteOpcode.Request(opcode=opcode)
        # A save takes up to 0.94 s of the simulation, which a busy computer delays.
        response = self.ask(request, node, response_timeout=5)
        assert response is not None, f"no answer for opcode {opcode}"
        return response.ok

    def save(self, node=NODE):
        assert self.execute(
            dronecan.uavcan.protocol.param.ExecuteOpcode.Request().OPCODE_SAVE, node
        )

    def restart(self, node=NODE):
        """Restarts the node and waits for the status in which its mode shows the start."""
        request = dronecan.uavcan.protocol.RestartNode.Request()
        request.magic_number = request.MAGIC_NUMBER
        answers, statuses = [], []

        def heard(event):
            if answers and event.transfer.source_node_id == node:
                statuses.append(event.message)

        # From the answer on: the status of the start follows it closely.
        handle = self.node.add_handler(dronecan.uavcan.protocol.NodeStatus, heard)
        try:
            self.node.request(request, node, answers.append)
            answer = self.spin_until(lambda: answers, f"answer of node {node}")[0]
            assert answer is not None and answer.response.ok
            self.spin_until(
                lambda: any(status.mode == status.MODE_INITIALIZATION for status in statuses),
                f"start of node {node}",
            )
        finally:
            handle.remove()

    def command(self, *commands):
        """Broadcasts an ArrayCommand of (actuator, type, value)."""
        message = dronecan.uavcan.equipment.actuator.ArrayCommand()
        for actuator_id, command_type, value in commands:
            message.commands.append(
                dronecan.uavcan.equipment.actuator.Command(
                    actuator_id=actuator_id, command_type=command_type, command_value=value
                )
            )
        self.node.broadcast(message)


class Raw:
    """An SLCAN adapter or serial port without a client library, for input that well-behaved clients
    do not send.
    """

    def __init__(self, path):
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.fd, termios.TCSANOW)

    def write(self, data):
        """Writes as many bytes as fit."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0

    def write_all(self, data, timeout=TIMEOUT_S):
        end = time.monotonic() + timeout
        while data:
            data = data[self.write(data) :]
            assert time.monotonic() < end, f"{len(data)} bytes not taken within {timeout} s"
            time.sleep(0 if not data else 0.001)

    def read(self, timeout=0.0):
        """All bytes that arrive within `timeout` seconds."""
        end = time.monotonic() + timeout
        data = b""
        while True:
            try:
                data += os.read(self.fd, 65536)
            except BlockingIOError:
                if time.monotonic() >= end:
                    return data
                time.sleep(0.005)

    def ask(self, command, timeout=TIMEOUT_S):
        """The answer to a command, up to its CR or BEL. Other lines are skipped."""
        self.write_all(command)
        data = b""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            data += self.read(0.01)
            for line in re.findall(rb"[^\r\x07]*[\r\x07]", data):
                if not line.startswith((b"T", b"t", b"R", b"r")):
                    return line
        raise AssertionError(f"no answer to {command}, only {data}")

    def close(self):
        os.close(self.fd)


class Bench:
    def __init__(self, directory, elf, options, slcan, serial, eeproms):
        self.directory = directory
        for number, eeprom in enumerate(eeproms):
            self.eeprom(number).write_bytes(eeprom)
        self.slcan = [directory / f"can{index}" for index in range(slcan)]
        self.serial = directory / "serial" if serial else None
        self.links = self.slcan + ([self.serial] if serial else [])
        self.output = directory / "sim.txt"
        self.clients = contextlib.ExitStack()
        self.exit_code = None
        line = [project_program("sim"), "--plain", "--elf", elf]
        for path in self.slcan:
            line += ["--slcan", path]
        if serial:
            line += ["--serial", self.serial]
        line += options
        if "--eeprom" not in options:
            line += ["--eeprom", self.eeprom(0)]
        with open(self.output, "wb") as output:
            self.process = subprocess.Popen(
                [str(word) for word in line],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=directory,
                start_new_session=True,
            )

    def eeprom(self, board):
        """The path of a board's EEPROM file."""
        return self.directory / ("eeprom" if board == 0 else f"eeprom.{board}")

    def wait_for_links(self):
        wait_until(lambda: self.is_over() or all(path.exists() for path in self.links), "links")
        assert not self.is_over(), f"sim has ended:\n{self.text()}"

    def text(self):
        """The simulator's output so far."""
        return self.output.read_text(errors="replace")

    def is_over(self):
        return self.process.poll() is not None

    def time_s(self):
        """Simulated time of the last line of the output."""
        times = re.findall(r"^ *(\d+\.\d+) ", self.text(), re.M)
        return float(times[-1]) if times else 0.0

    def wait_for_text(self, pattern, timeout=TIMEOUT_S):
        return wait_until(
            lambda: re.search(pattern, self.text(), re.M), f"line with {pattern!r}", timeout
        )

    def pulse_us(self):
        """Width of the servo's last pulse, as the simulator measured it."""
        pulses = re.findall(r" servo +pulse ([\d.]+) us", self.text())
        return float(pulses[-1]) if pulses else None

    def light_percent(self):
        """Brightness of the light, as the simulator measured it."""
        percents = re.findall(r" light +(\d+) %", self.text())
        return int(percents[-1]) if percents else 0

    def still_runs(self):
        """True if simulated time passes and the program runs."""
        start = self.time_s()
        wait_until(
            lambda: not self.is_over() and self.time_s() > start + 1, "progress of the simulation"
        )
        return True

    def dronecan(self, adapter=0, node_id=10, device=None):
        client = Client(device or f"slcan:{self.slcan[adapter]}", node_id)
        self.clients.callback(client.close)
        return client

    def raw(self, path=None):
        return self.clients.enter_context(contextlib.closing(Raw(path or self.slcan[0])))

    def start(self, *line, **options):
        """Starts a client program in its own process group, which is killed at the end of the test
        if it still runs.
        """
        process = subprocess.Popen(
            [program(str(line[0])), *map(str, line[1:])],
            stdin=options.pop("stdin", subprocess.DEVNULL),
            stdout=options.pop("stdout", subprocess.PIPE),
            stderr=options.pop("stderr", subprocess.STDOUT),
            cwd=options.pop("cwd", self.directory),
            start_new_session=True,
            **options,
        )
        self.clients.callback(end_group, process)
        return process

    def run(self, *line, timeout=30, check=True, **options):
        """Runs a client program to its end. Returns its output."""
        process = self.start(*line, **options)
        text = process.communicate(timeout=timeout)[0].decode(errors="replace")
        assert not check or process.returncode == 0, (
            f"{line}: exit code {process.returncode}\n{text}"
        )
        return text

    def upload_line(self, elf):
        port = ["-c", "arduino", "-p", "m168", "-P", self.serial, "-b", "19200"]
        return ["avrdude", *port, "-D", "-U", f"flash:w:{elf}:e"]

    def upload(self):
        """Uploads the firmware through the serial port, as Arduino's IDE does."""
        text = self.run(*self.upload_line(node_elf()), timeout=60)
        assert re.search(r"bytes of flash verified", text), text

    def end(self):
        """Ends the simulation with Ctrl-C. Returns its exit code."""
        if self.exit_code is None:
            self.clients.close()
            if not self.is_over():
                self.process.send_signal(signal.SIGINT)
            try:
                self.exit_code = self.process.wait(TIMEOUT_S)
            finally:
                end_group(self.process)
        return self.exit_code


def end_group(process):
    """Kills what remains of a process group that was started here."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdout:
        process.stdout.close()


def run_sim(directory, *options, elf=None):
    """Runs the simulator without clients, as fast as possible."""
    line = [
        project_program("sim"),
        "--plain",
        "--speed",
        "max",
        "--elf",
        elf or node_elf(),
        *options,
    ]
    done = subprocess.run(
        [str(word) for word in line],
        cwd=directory,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=60,
    )
    text = done.stdout.decode(errors="replace")
    assert done.returncode == 0, text
    return text


@pytest.fixture(scope="session")
def started_eeprom(tmp_path_factory):
    """The EEPROM of a board that has started before with an ELF, so that it has a unique ID."""

    @functools.cache
    def started(elf):
        path = tmp_path_factory.mktemp("started") / "eeprom"
        run_sim(path.parent, "--no-autopilot", "--for", "1500ms", "--eeprom", path, elf=elf)
        return path.read_bytes() if path.exists() else None

    return started


@pytest.fixture
def bench(tmp_path, started_eeprom):
    """Starts a bench with options of `sim`, `slcan` SLCAN adapters, and a serial port if `serial`.
    """
    benches = []

    def start(
        *options,
        slcan=1,
        serial=False,
        autopilot=False,
        exit_code=0,
        fresh=False,
        eeproms=None,
        elf=None,
    ):
        directory = tmp_path / f"bench{len(benches)}"
        directory.mkdir()
        elf = elf or node_elf()
        if eeproms is None:
            eeprom = None if fresh else started_eeprom(elf)
            eeproms = [] if eeprom is None else [eeprom]
        new = Bench(
            directory,
            elf,
            [*options, *([] if autopilot else ["--no-autopilot"])],
            slcan,
            serial,
            eeproms,
        )
        new.expected_exit_code = exit_code
        benches.append(new)
        new.wait_for_links()
        return new

    yield start
    faults = []
    for used in benches:
        try:
            if used.end() != used.expected_exit_code:
                faults.append(f"sim: exit code {used.exit_code}\n{used.text()[-3000:]}")
            faults += [f"{path} still exists" for path in used.links if os.path.lexists(path)]
        except subprocess.TimeoutExpired:
            faults.append(f"sim did not end at Ctrl-C\n{used.text()[-3000:]}")
    assert not faults, "\n".join(faults)
