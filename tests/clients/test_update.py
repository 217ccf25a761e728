"""Updates with our bootloader: over the bus by pydronecan's file server, and over the serial port
by avrdude.
"""

import binascii
import contextlib
import importlib
import re
import signal
import subprocess
import time

import dronecan.app.file_server
import pytest
from conftest import NODE, ROOT, TARGET, TIMEOUT_S, VERSION, node_elf, project_program
from dronecan import uavcan

# An earlier import may hold the types from before conftest.py loaded them again.
importlib.reload(dronecan.app.file_server)

pytestmark = pytest.mark.at_corners

NodeStatus = uavcan.protocol.NodeStatus


LOADER = TARGET / "firmware" / "boot-diecimila-seeed.hex"


@pytest.fixture
def empty_board(bench):
    """A board that has only our bootloader."""
    return bench("--bootloader", "--no-program", serial=True)


@pytest.fixture
def remote_board(bench):
    """A board with our bootloader and a program that hands updates over to it."""
    return bench("--bootloader", LOADER, elf=node_elf("remote"), slcan=2)


@pytest.mark.parametrize("features", ["default", "remote"])
def test_elf_hex_and_bin_are_the_same_bytes_with_a_length_and_a_crc(features, tmp_path):
    elf, hex_file, back = node_elf(features), tmp_path / "x.hex", tmp_path / "x.bin"
    sections = ["-j", ".text", "-j", ".data"]
    subprocess.run(["avr-objcopy", "-O", "ihex", *sections, elf, hex_file], check=True)
    subprocess.run(["avr-objcopy", "-I", "ihex", "-O", "binary", hex_file, back], check=True)
    program = elf.with_suffix(".bin").read_bytes()
    assert back.read_bytes() == program
    assert int.from_bytes(program[0x6C:0x6E], "little") == len(program)
    assert binascii.crc_hqx(program, 0xFFFF) == 0


def update(client, file):
    """Serves the file and sends BeginFirmwareUpdate. Waits until the new program runs."""
    with contextlib.closing(dronecan.app.file_server.FileServer(client.node, [str(file.parent)])):
        request = uavcan.protocol.file.BeginFirmwareUpdate.Request(
            source_node_id=client.node.node_id
        )
        request.image_file_remote_path.path = file.name
        response = client.ask(request)
        assert response.error == response.ERROR_OK
        # The old program may still send OPERATIONAL.
        for mode in (NodeStatus().MODE_SOFTWARE_UPDATE, NodeStatus().MODE_OPERATIONAL):
            client.spin_until(
                lambda mode=mode: client.wait_for(NodeStatus).mode == mode,
                f"mode {mode}",
                timeout=60,
            )


def test_pydronecan_s_file_server_updates_a_node_in_its_bootloader(empty_board):
    client = empty_board.dronecan()
    assert client.wait_for(NodeStatus).mode == NodeStatus().MODE_MAINTENANCE
    information = client.ask(uavcan.protocol.GetNodeInfo.Request())
    assert (str(information.name), information.hardware_version.major) == ("", 1)
    update(client, node_elf().with_suffix(".bin"))
    information = client.ask(uavcan.protocol.GetNodeInfo.Request())
    assert str(information.name) == "org.dronecan.servo168"


def wait_for_mode(client, mode):
    client.spin_until(lambda: client.wait_for(NodeStatus).mode == mode, f"mode {mode}")


def test_avrdude_uploads_through_our_bootloader_and_the_bus_works_then(empty_board):
    client = empty_board.dronecan()
    # An upload begins after a reset by the pin alone. One within the start after a power-on, up to
    # 73 ms at a corner, counts as that power-on.
    wait_for_mode(client, NodeStatus().MODE_MAINTENANCE)
    empty_board.upload()
    wait_for_mode(client, NodeStatus().MODE_OPERATIONAL)


@pytest.mark.long
def test_after_an_upload_by_avrdude_is_cut_the_bootloader_waits_for_the_next(bench):
    used = bench("--bootloader", LOADER, serial=True)
    client = used.dronecan()
    wait_for_mode(client, NodeStatus().MODE_OPERATIONAL)
    # Another program over this one.
    process = used.start(*used.upload_line(node_elf("remote")))
    text = b""
    while not re.search(rb"Writing \| #{20}", text):
        byte = process.stdout.read(1)
        assert byte, text
        text += byte
    process.kill()
    wait_for_mode(client, NodeStatus().MODE_MAINTENANCE)
    information = client.ask(uavcan.protocol.GetNodeInfo.Request())
    assert information.software_version.major == 0
    used.upload()
    wait_for_mode(client, NodeStatus().MODE_OPERATIONAL)


def test_pydronecan_s_file_server_updates_a_running_node_and_its_parameters_are_kept(
    remote_board, tmp_path
):
    # The path that the server gives is the file's name.
    file = tmp_path / "remote.bin"
    file.write_bytes(node_elf("remote").with_suffix(".bin").read_bytes())
    client = remote_board.dronecan()
    client.wait_for(NodeStatus)
    client.set("OUT1_MIN", 1234)
    client.save()
    update(client, file)
    remote_board.wait_for_text(r" reset +the AVR was reset: Watchdog")
    assert client.get("OUT1_MIN") == 1234


def start_node_update(used, *words, node=NODE, file=None, slcan=0):
    file = file or node_elf("remote").with_suffix(".bin")
    bus = f"slcan:{used.slcan[slcan]}"
    return used.start(project_program("node-update"), file, "--bus", bus, "--node", node, *words)


def node_update(used, *words, code=0, **options):
    """Runs node-update. Returns its output."""
    process = start_node_update(used, *words, **options)
    text = process.communicate(timeout=90)[0].decode(errors="replace")
    assert process.returncode == code, text
    return text


def wait_until_it_reads(process):
    """Waits until node-update has sent a part of the file. Returns its output until then."""
    text = b""
    for line in iter(process.stdout.readline, b""):
        text += line
        if re.match(rb"node 120: reading, [1-9]", line):
            return text
    raise AssertionError(text)


def test_node_update_updates_a_running_node_and_reports_it(remote_board):
    text = node_update(remote_board)
    assert re.search(r"^node 120: restarting, (\d+) of \1 bytes$", text, re.M), text
    version = r"\.".join(str(number) for number in VERSION)
    assert re.search(
        rf"^node 120: runs version {version}, before {version}; [0-9.]+ s$", text, re.M
    ), text
    # The next update must succeed, too.
    node_update(remote_board)


def test_node_update_prints_why_a_node_in_use_rejects_an_update(remote_board):
    client = remote_board.dronecan(adapter=1)
    client.wait_for(NodeStatus)
    message = uavcan.equipment.safety.ArmingStatus(status=255)
    handle = client.node.periodic(0.2, lambda: client.node.broadcast(message))
    client.spin(0.5)
    process = start_node_update(remote_board)
    client.spin_until(lambda: process.poll() is not None, "end of the program")
    handle.remove()
    text = process.communicate()[0].decode()
    assert process.returncode == 4, text
    assert "node 120: FAILED: refuses: armed, or a command in the last 2 s" in text


def test_wrong_nodes_and_wrong_files_are_rejected_with_a_remedy(remote_board, tmp_path):
    text = node_update(remote_board, node=42, code=4)
    assert "node 42 is not on the bus. Nodes that are: 120" in text
    text = node_update(remote_board, file=node_elf("full", board="uno").with_suffix(".bin"), code=4)
    assert "node 120 has hardware 1.0, and the file is for 2.0" in text
    assert "take the .bin" in node_update(remote_board, file=node_elf("remote"), code=2)
    cut = tmp_path / "cut.bin"
    cut.write_bytes(node_elf("remote").with_suffix(".bin").read_bytes()[:-100])
    assert "it is incomplete" in node_update(remote_board, file=cut, code=2)


def test_a_program_without_update_is_sent_only_when_it_is_asked_to_be_the_last(remote_board):
    last = node_elf().with_suffix(".bin")
    text = node_update(remote_board, file=last, code=2)
    assert "the node would take no further update over the bus" in text
    assert "node 120: runs version" in node_update(remote_board, "--last", file=last)
    text = node_update(remote_board, code=4)
    assert "node 120 takes no update over the bus" in text


@pytest.mark.long
def test_ctrl_c_ends_an_update_and_the_same_command_finishes_it(remote_board):
    process = start_node_update(remote_board)
    wait_until_it_reads(process)
    process.send_signal(signal.SIGINT)
    text = process.communicate(timeout=TIMEOUT_S)[0].decode()
    assert process.returncode == 5, text
    assert "node 120: has no program now" in text
    client = remote_board.dronecan(adapter=1)
    client.spin_until(
        lambda: client.wait_for(NodeStatus).mode == NodeStatus().MODE_MAINTENANCE,
        "waiting loader",
        timeout=60,
    )
    assert "node 120: runs version" in node_update(remote_board)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill"])
def test_an_update_that_was_stopped_continues_with_the_same_command_at_once(remote_board, how):
    process = start_node_update(remote_board)
    wait_until_it_reads(process)
    process.send_signal(how)
    process.wait(TIMEOUT_S)
    assert "node 120: runs version" in node_update(remote_board)


@pytest.mark.long
def test_a_stopped_update_with_another_node_id_continues_too(remote_board):
    process = start_node_update(remote_board, "--own-id", "100")
    wait_until_it_reads(process)
    process.send_signal(signal.SIGKILL)
    process.wait(TIMEOUT_S)
    assert "node 120: runs version" in node_update(remote_board)


def test_a_second_update_says_that_another_is_under_way(remote_board):
    first = start_node_update(remote_board)
    time.sleep(0.8)
    text = node_update(remote_board, slcan=1, code=4)
    assert "node 120: another update is under way: node 126 sends a file" in text, text
    text = first.communicate(timeout=90)[0].decode()
    assert first.returncode == 0, text


def test_a_second_program_on_the_same_adapter_is_refused(remote_board):
    first = start_node_update(remote_board)
    first.stdout.readline()
    first.stdout.readline()
    text = node_update(remote_board, code=3)
    assert re.search(r"another program uses \S+/can0", text), text
    text = first.communicate(timeout=90)[0].decode()
    assert first.returncode == 0, text


def test_several_nodes_are_updated_at_the_same_time(bench):
    eeproms = []
    for node in (120, 121, 122):
        single = bench(elf=node_elf("remote"))
        client = single.dronecan()
        client.wait_for(NodeStatus)
        client.set("CAN_NODE", node)
        client.save()
        single.end()
        eeproms.append(single.eeprom(0).read_bytes())
    used = bench("--nodes", "2", "--bootloader", LOADER, eeproms=eeproms, elf=node_elf("remote"))
    text = node_update(used, node="all")
    updated = re.findall(r"^node (\d+): runs version", text, re.M)
    assert sorted(updated) == ["120", "121", "122"], text
    # All have begun before the first has ended.
    assert text.index("node 122: reading") < text.index("runs version"), text


def test_node_update_takes_an_id_that_no_other_node_has(remote_board):
    client = remote_board.dronecan(adapter=1, node_id=126)
    others = []
    client.node.add_handler(NodeStatus, lambda event: others.append(event.transfer.source_node_id))
    process = start_node_update(remote_board)
    client.spin_until(lambda: process.poll() is not None, "end of the program", timeout=60)
    assert process.returncode == 0, process.communicate()[0]
    assert set(others) >= {NODE, 127} and 125 not in others and 126 not in others, others


@pytest.mark.parametrize(
    "shield, arguments, rates",
    [
        ("module", "", ["500000"]),
        ("seeed", "", ["1000000"]),
        ("module", "--bitrate 125000", ["125000"]),
    ],
)
def test_make_update_passes_the_bit_rate_of_the_can_board(shield, arguments, rates):
    choice = ["BUS=mcast:0", "NODE=120", f"SHIELD={shield}", f"ARGS={arguments}", "FILE=x.bin"]
    # Only prints the commands: the release build of node-update takes a minute of CPU time.
    line = ["make", "--no-print-directory", "-n", "-C", ROOT, "update", *choice]
    printed = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    call = printed[printed.index("/node-update 'x.bin' ") :]
    assert re.findall(r"--bitrate (\d+)", call) == rates, printed


def test_the_bootloader_is_written_with_the_fuses_that_it_needs(tmp_path):
    def calls(*options):
        line = [ROOT / "scripts/bootloader", "--print", "--programmer", "usbasp", *options]
        return subprocess.run(line, capture_output=True, text=True, check=True).stdout.splitlines()

    fuses, flash = calls()
    assert (
        fuses
        == (
            "avrdude -c usbasp -p atmega168 -e -U lock:w:0x3F:m -U lfuse:w:0xFF:m -U "
            "hfuse:w:0xDD:m -U efuse:w:0xF8:m"
        )
    )
    assert flash == f"avrdude -c usbasp -p atmega168 -U flash:w:{LOADER}:i -U lock:w:0xEF:m"
    stock = tmp_path / "optiboot.hex"
    stock.write_text(":00000001FF\n")
    fuses, flash = calls("--board", "uno", "--stock", stock)
    assert "hfuse:w:0xDE:m" in fuses and f"flash:w:{stock}:i -U lock:w:0x0F:m" in flash
    # The last byte of the flash, and one behind it, with and without an extended address.
    for lines, fits in [
        (":017FFF000081\n", True),
        (":018000000080\n", False),
        (":020000020800F4\n:010000000000\n", False),
    ]:
        stock.write_text(lines + ":00000001FF\n")
        if fits:
            assert len(calls("--board", "uno", "--stock", stock)) == 2
        else:
            with pytest.raises(subprocess.CalledProcessError):
                calls("--board", "uno", "--stock", stock)
