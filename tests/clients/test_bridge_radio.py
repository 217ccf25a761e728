"""The bridge at a radio that sends less than its serial port carries."""

import collections
import os
import threading
import time
import tty

import pytest
from pymavlink.dialects.v10 import ardupilotmega as mavlink1

from conftest import TIMEOUT_S
from ground import PtyStation
from many_nodes import Node, integers

PARAMETERS = 111
STEP_S = 0.002


class Radio(threading.Thread):
    """Takes what the bridge sends into a buffer of `size` bytes, drops what does not fit, and sends
    `air` bytes a second.

    Once a second it tells the bridge the free part of the buffer by RADIO_STATUS, as SiK radios do.
    """

    def __init__(self, size, air):
        super().__init__(daemon=True)
        self.size, self.air = size, air
        self.bridge_end, self.port = os.openpty()
        self.far_end, self.station = os.openpty()
        for fd in (self.port, self.station):
            tty.setraw(fd)
        os.set_blocking(self.bridge_end, False)
        os.set_blocking(self.far_end, False)
        self.waiting = collections.deque()
        self.lost = self.sent = 0
        self.mav = mavlink1.MAVLink(None, srcSystem=51, srcComponent=68)
        self.ended = threading.Event()

    def run(self):
        credit, last, next_status = 0.0, time.monotonic(), time.monotonic() + 1
        while not self.ended.is_set():
            time.sleep(STEP_S)
            now = time.monotonic()
            # What waits is sent before more is taken, also if this thread was late.
            credit, last = min(credit + (now - last) * self.air, self.size), now
            count = min(int(credit), len(self.waiting))
            credit = credit - count if self.waiting else 0.0
            os.write(self.far_end, bytes(self.waiting.popleft() for _ in range(count)))
            self.sent += count
            for byte in self.read(self.bridge_end):
                if len(self.waiting) < self.size:
                    self.waiting.append(byte)
                else:
                    self.lost += 1
            if command := self.read(self.far_end):
                os.write(self.bridge_end, command)
            if now >= next_status:
                next_status += 1
                free = 100 * (self.size - len(self.waiting)) // self.size
                status = self.mav.radio_status_encode(180, 180, free, 40, 40, 0, 0)
                os.write(self.bridge_end, status.pack(self.mav))

    @staticmethod
    def read(fd):
        try:
            return os.read(fd, 65536)
        except (BlockingIOError, OSError):
            return b""

    def close(self):
        self.ended.set()
        self.join(10)
        for fd in (self.bridge_end, self.port, self.far_end):
            os.close(fd)


@pytest.fixture
def radio():
    started = []

    def start(size, air):
        started.append(Radio(size, air))
        started[-1].start()
        return started[-1]

    yield start
    for used in started:
        used.close()


def test_all_parameters_arrive_at_once_over_a_radio(many_nodes, bridge, station, radio):
    """57,600 baud to a radio that sends 1,600 bytes a second: none of 111 parameters has to be
    asked for again."""
    used, link = many_nodes([Node(42, integers(PARAMETERS))]), radio(2048, 1600)
    bridge(used.bus, channels=[f"serial:{os.ttyname(link.port)}:57600"])
    ground = station(link.station, kind=PtyStation)
    ground.wait_for("UAVCAN_NODE_INFO", 42)
    start = time.monotonic()
    ground.mav.param_request_list_send(1, 42)
    missing = set(range(PARAMETERS))
    while missing and time.monotonic() < start + TIMEOUT_S:
        if (message := ground.receive()) and message.get_type() == "PARAM_VALUE":
            missing.discard(message.param_index)
    print(f"{PARAMETERS} parameters in {time.monotonic() - start:.1f} s, {link.lost} bytes lost")
    assert (sorted(missing), link.lost) == ([], 0)


def test_the_rate_of_a_radio_is_used(many_nodes, bridge, station, radio):
    """Thirty nodes with five statuses a second each are more than the radio sends: it loses
    nothing, and is busy most of the time."""
    used, link = many_nodes(count=30, parameters=1, status_hz=5), radio(1024, 1600)
    bridge(used.bus, channels=[f"serial:{os.ttyname(link.port)}:57600"])
    ground = station(link.station, kind=PtyStation)
    ground.gather(5)
    # The best of some times: other programs may take this machine's processor for seconds.
    most = 0
    for _ in range(10):
        before = link.sent
        ground.gather(4)
        most = max(most, link.sent - before)
        if most > 4 * 1600 * 0.6:
            break
    print(f"{most / 4:.0f} bytes a second, {link.lost} lost")
    assert link.lost == 0
    assert most > 4 * 1600 * 0.6
