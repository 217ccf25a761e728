"""python-can's own programs over SLCAN: a recording equals what was played, byte for byte."""

import os
import random
import re
import signal
import time

import pytest

from conftest import TIMEOUT_S, wait_until

ADAPTER = ["-i", "slcan", "-b", "1000000", "-c"]


def write_log(path, frames, gap_s=0.001):
    path.write_text(
        "".join(f"({index * gap_s:.6f}) can0 {frame}\n" for index, frame in enumerate(frames))
    )


def frames(path):
    """The frames of a candump log without those of the node."""
    found = re.findall(r"^\([\d.]+\) \S+ (\S+)", path.read_text(), re.M)
    return [frame for frame in found if not re.match(r"[0-9A-F]{6}78#", frame)]


def start_logger(used, file):
    """Starts a can_logger on the first adapter. It prints its output only when it ends."""
    logger = used.start(
        "can_logger",
        *ADAPTER,
        used.slcan[0],
        "-f",
        file,
        env=dict(os.environ, PYTHONUNBUFFERED="1"),
    )
    for line in logger.stdout:
        if line.startswith(b"Can Logger"):
            break
    # can_logger does not wait for the adapter's answers.
    time.sleep(0.3)
    return logger


def random_frames(count, seed):
    rng = random.Random(seed)
    made = []
    for index in range(count):
        # Bit 7 is set, so the frame is a service for another node, which the node under test
        # ignores.
        identifier = (
            f"{rng.getrandbits(21) << 8 | 0xA5:08X}" if index % 3 else f"{rng.getrandbits(11):03X}"
        )
        made.append(f"{identifier}#{rng.randbytes(rng.randrange(9)).hex().upper()}")
    return made


def test_can_logger_records_what_can_player_plays(bench):
    used = bench("--log", "sim.log", slcan=2)
    played = random_frames(400, seed=1)
    write_log(used.directory / "in.log", played)
    logger = start_logger(used, "out.log")
    # What a logger that is behind has not read when it ends is not recorded. So there is more.
    for _ in range(2):
        used.run("can_player", *ADAPTER, used.slcan[1], "in.log")
    out = used.directory / "out.log"
    wait_until(lambda: len(frames(out)) > len(played), "more frames than were played first")
    logger.send_signal(signal.SIGINT)
    logger.wait(TIMEOUT_S)
    assert frames(out)[: len(played)] == played
    used.end()
    assert frames(used.directory / "sim.log") == played * 2


def test_a_recording_of_the_simulator_can_be_played(bench):
    first = bench("--log", "sim.log", autopilot=True)
    first.wait_for_text(r"^ +2\.0\d+ ")
    first.end()
    played = frames(first.directory / "sim.log")
    assert len(played) > 50
    second = bench("--log", "sim.log")
    second.run("can_player", *ADAPTER, second.slcan[0], first.directory / "sim.log")
    second.end()
    # When the player closes its port, the last frames may still be on their way.
    again = frames(second.directory / "sim.log")
    assert again == played
    assert second.pulse_us() is not None


def test_python_can_reads_timestamps_and_remote_frames(bench):
    import can

    used = bench(slcan=2)
    buses = [
        can.Bus(interface="slcan", channel=str(path), bitrate=1_000_000, sleep_after_open=0.1)
        for path in used.slcan
    ]
    try:
        # python-can does not wait for the answers when it opens a channel. This waits.
        assert {bus.get_version(2) for bus in buses} == {(10, 13)}
        for message in [
            can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=3),
            can.Message(arbitration_id=0x1ABCDEA5, data=bytes(range(8))),
            can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b""),
        ]:
            buses[0].send(message)
            end = time.monotonic() + TIMEOUT_S
            heard = None
            while not (heard and heard.arbitration_id == message.arbitration_id):
                assert time.monotonic() < end
                heard = buses[1].recv(0.5)
            assert heard.equals(
                message, timestamp_delta=None, check_channel=False, check_direction=False
            )
        assert buses[0].get_serial_number(2) == "A123"
    finally:
        for bus in buses:
            bus.shutdown()


@pytest.mark.timeout(90)
def test_on_a_full_bus_no_frame_is_lost(bench):
    """As many frames as 1 Mbit/s can carry, from one client to another."""
    used = bench(slcan=2)
    source, sink = (used.raw(path) for path in used.slcan)
    for port in (source, sink):
        port.ask(b"C\r")
        assert port.ask(b"S8\r") == port.ask(b"O\r") == b"\r"
    count = 10_000
    lines = [b"T%08X8%016X\r" % (0x1FFFFFA5, index) for index in range(count)]
    to_send, heard = b"".join(lines), b""
    end = time.monotonic() + 60
    while heard.count(b"T1FFFFFA5") < count and time.monotonic() < end:
        to_send = to_send[source.write(to_send[:4096]) :] if to_send else b""
        heard += sink.read()
        source.read()
    numbers = [int(number, 16) for number in re.findall(rb"T1FFFFFA58([0-9A-F]{16})", heard)]
    assert numbers == list(range(count))
