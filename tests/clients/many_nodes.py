"""Many nodes on a slow bus, behind an SLCAN adapter, which one simulated board cannot show.

    def test_all_nodes_are_seen(many_nodes, bridge, station):
        used = many_nodes(count=30, parameters=20, frames_per_s=900)
        bridge(used.bus)

The nodes are made with pydronecan. The adapter is a pseudo-terminal. The bus carries `frames_per_s`
frames a second in each direction, for all nodes together, in order of arrival; but statuses go
first because of their priority.
"""

import collections
import dataclasses
import os
import threading
import time
import tty

import dronecan
import pytest
from dronecan import uavcan
from dronecan.transport import Frame, Transfer, TransferManager

GET_NODE_INFO, GET_SET, EXECUTE_OPCODE, RESTART_NODE = (
    uavcan.protocol.GetNodeInfo,
    uavcan.protocol.param.GetSet,
    uavcan.protocol.param.ExecuteOpcode,
    uavcan.protocol.RestartNode,
)
# The bus releases its capacity in steps of this length.
STEP_S = 0.002


@dataclasses.dataclass
class Node:
    node_id: int
    parameters: dict
    # Seconds from a request to its answer. With `one_at_a_time` the node starts with the next
    # request after that.
    delay_s: float = 0.0
    one_at_a_time: bool = False
    refuses: bool = False
    is_silent: bool = False
    started: float = dataclasses.field(default_factory=time.monotonic)
    busy_until: float = 0.0
    status_id: int = 0
    requests: collections.Counter = dataclasses.field(default_factory=collections.Counter)

    def status(self):
        return uavcan.protocol.NodeStatus(uptime_sec=int(time.monotonic() - self.started))

    def hear(self, message, source):
        """The messages that the node broadcasts when it receives `message`."""
        return []

    def respond(self, request):
        kind = dronecan.get_dronecan_data_type(request)
        self.requests[kind.full_name] += 1
        if kind == GET_NODE_INFO:
            response = GET_NODE_INFO.Response(name=f"org.example.node{self.node_id}")
            response.status = self.status()
            response.hardware_version.unique_id = [self.node_id] * 16
            return response
        if kind == GET_SET:
            return self.get_set(request)
        if kind == RESTART_NODE:
            self.started = time.monotonic()
        return {EXECUTE_OPCODE: EXECUTE_OPCODE, RESTART_NODE: RESTART_NODE}[kind].Response(
            ok=not self.refuses
        )

    def get_set(self, request):
        response = GET_SET.Response()
        name, names = str(request.name), list(self.parameters)
        if not name and request.index < len(names):
            name = names[request.index]
        if name not in self.parameters:
            return response
        field, value = self.parameters[name]
        if dronecan.get_active_union_field(request.value) == field:
            value = getattr(request.value, field)
            self.parameters[name] = (field, value)
        response.name = name
        response.value = uavcan.protocol.param.Value(**{field: value})
        return response


class ManyNodes(threading.Thread):
    def __init__(self, nodes, frames_per_s, status_hz, link):
        super().__init__(daemon=True)
        self.nodes = {node.node_id: node for node in nodes}
        self.frames_per_s, self.status_hz = frames_per_s, status_hz
        self.ours, self.theirs = os.openpty()
        tty.setraw(self.theirs)
        os.set_blocking(self.ours, False)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self.theirs))
        self.bus = f"slcan:{link}"
        self.ended = threading.Event()
        self.is_open = False
        # Frames that wait for the bus: of the nodes, and of the bridge.
        self.urgent, self.ordinary = collections.deque(), collections.deque()
        # Answers in preparation, by the time at which they are due.
        self.later = []
        self.transfers = TransferManager()
        self.line = b""
        # The nodes for which the bridge has sent frames.
        self.heard_from = set()

    def close(self):
        self.ended.set()
        self.join(10)
        os.close(self.ours)
        os.close(self.theirs)

    def run(self):
        credit, before = 0.0, time.monotonic()
        next_status = before
        while not self.ended.wait(STEP_S):
            now = time.monotonic()
            credit = min(credit + (now - before) * self.frames_per_s, 20)
            before = now
            self.take_lines()
            if now >= next_status:
                next_status += 1 / self.status_hz
                for node in list(self.nodes.values()):
                    if not node.is_silent:
                        self.urgent.extend(self.frames_of(node, node.status()))
            due = [entry for entry in self.later if entry[0] <= now]
            self.later = [entry for entry in self.later if entry[0] > now]
            for _, node, request in due:
                self.ordinary.extend(self.answer(node, request))
            out = b""
            while credit >= 1 and (waiting := self.urgent or self.ordinary):
                credit -= 1
                source, frame = waiting.popleft()
                if source is None:
                    self.hear(frame, now)
                else:
                    data = bytes(frame.bytes)
                    line = f"T{frame.message_id:08X}{len(data)}{data.hex().upper()}\r"
                    out += line.encode()
            if self.is_open and out:
                try:
                    os.write(self.ours, out)
                except BlockingIOError:
                    pass

    def take_lines(self):
        try:
            self.line += os.read(self.ours, 65536)
        except BlockingIOError:
            return
        *lines, self.line = self.line.split(b"\r")
        for line in lines:
            if line.startswith(b"T"):
                data = bytes.fromhex(line[10:].decode())
                self.ordinary.append((None, Frame(int(line[1:9], 16), data)))
                self.heard_from.add(int(line[7:9], 16) & 0x7F)
                os.write(self.ours, b"Z\r")
            else:
                self.is_open = line == b"O" or (self.is_open and line != b"C")
                os.write(self.ours, b"\r")

    def frames_of(self, node, message):
        node.status_id = (node.status_id + 1) % 32
        transfer = Transfer(
            payload=message,
            source_node_id=node.node_id,
            transfer_id=node.status_id,
            transfer_priority=24,
        )
        return [(node, frame) for frame in transfer.to_frames()]

    def hear(self, frame, now):
        frames = self.transfers.receive_frame(frame)
        if not frames:
            return
        request = Transfer()
        request.from_frames(frames)
        if not request.service_not_message:
            for node in self.nodes.values():
                for message in node.hear(request.payload, request.source_node_id):
                    self.ordinary.extend(self.frames_of(node, message))
            return
        node = self.nodes.get(request.dest_node_id)
        if node is None or node.is_silent:
            return
        begins = max(now, node.busy_until) if node.one_at_a_time else now
        node.busy_until = begins + node.delay_s
        self.later.append((begins + node.delay_s, node, request))

    @staticmethod
    def answer(node, request):
        transfer = Transfer(
            payload=node.respond(request.payload),
            source_node_id=node.node_id,
            dest_node_id=request.source_node_id,
            transfer_id=request.transfer_id,
            transfer_priority=request.transfer_priority,
            request_not_response=False,
            service_not_message=True,
        )
        return [(node, frame) for frame in transfer.to_frames()]


def integers(count):
    return {f"PARAMETER_{index:02}": ("integer_value", index) for index in range(count)}


@pytest.fixture
def many_nodes(tmp_path):
    """Starts such a bus with `count` nodes of `parameters` parameters each, or with these `nodes`.
    """
    started = []

    def start(nodes=None, count=1, parameters=20, frames_per_s=9000, status_hz=1, first=1):
        nodes = nodes or [Node(first + index, integers(parameters)) for index in range(count)]
        new = ManyNodes(nodes, frames_per_s, status_hz, tmp_path / f"many{len(started)}")
        started.append(new)
        new.start()
        return new

    yield start
    for used in started:
        used.close()
