"""pydronecan does what a GUI tool does with a node: information, parameters, save, restart, update,
counters.
"""

import re
import tomllib

import pytest
from dronecan import uavcan
from dronecan.app.node_monitor import NodeMonitor

from conftest import NODE, ROOT, VERSION, node_elf

protocol = uavcan.protocol
UNITLESS, PWM = 0, 4


def documented_parameters(preset):
    """The names of a preset's parameters in the order of docs/parameters.md, which is written by
    hand.
    """
    features = tomllib.loads((ROOT / "Cargo.toml").read_text())["features"][preset]
    page = (ROOT / "docs/parameters.md").read_text()
    rows = re.findall(r"^\|[^|]*\| `(\w+)`(?: \[`([\w-]+)`\])? \|", page, re.M)
    names = [name for name, feature in rows if not feature or feature in features]
    of_output = [name.removeprefix("OUT1_") for name in names if name.startswith("OUT1_")]
    outputs = range(1, 9 if "outputs" in features else 2)
    return [name for name in names if not name.startswith("OUT1_")] + [
        f"OUT{output}_{name}" for output in outputs for name in of_output
    ]


PARAMETERS = documented_parameters("default")


def read_all_parameters(client):
    """Reads all parameters by index, until one has no name."""
    found = {}
    while name := str((response := client.parameter(index=len(found))).name):
        assert name not in found
        found[name] = response
    return found


def test_the_node_monitor_receives_the_node_s_information(bench):
    client = bench().dronecan()
    monitor = NodeMonitor(client.node)
    client.spin_until(
        lambda: monitor.exists(NODE) and monitor.get(NODE).info, "information of node 120"
    )
    info = monitor.get(NODE).info
    name = str(info.name)
    assert re.fullmatch(r"org\.[a-z0-9._-]+", name) and len(name) <= 80
    assert (info.software_version.major, info.software_version.minor) == VERSION
    version = info.software_version
    assert version.optional_field_flags == (
        version.OPTIONAL_FIELD_FLAG_VCS_COMMIT if version.vcs_commit else 0
    )
    unique_id = bytes(info.hardware_version.unique_id)
    assert len(unique_id) == 16 and len(set(unique_id)) > 4
    assert len(info.hardware_version.certificate_of_authenticity) == 0


def test_parameters_are_read_until_the_empty_name(bench):
    client = bench().dronecan()
    found = read_all_parameters(client)
    assert list(found) == PARAMETERS
    for name, response in found.items():
        assert len(name) <= 16
        low, high = response.min_value.integer_value, response.max_value.integer_value
        assert low <= response.default_value.integer_value <= high and low < high
        assert response.value.integer_value == response.default_value.integer_value, name
        by_name = client.parameter(name)
        assert (by_name.name, by_name.value.integer_value) == (
            response.name,
            response.value.integer_value,
        )


def test_the_parameters_of_features_precede_those_of_the_outputs(bench):
    found = read_all_parameters(bench(elf=node_elf("full", board="uno")).dronecan())
    assert list(found) == documented_parameters("full")
    # Between two pulses there has to be a pause.
    widths = [f"OUT{output}_{name}" for output in (1, 8) for name in ("MIN", "TRIM", "MAX")]
    assert {found[name].max_value.integer_value for name in widths} == {2400}


def test_saved_parameters_survive_a_restart(bench):
    used = bench()
    client = used.dronecan()
    client.set("OUT1_MIN", 1200)
    client.set("TEMP_MIN", -12)
    client.save()
    client.set("OUT1_MAX", 1800)
    client.restart()
    assert (client.get("OUT1_MIN"), client.get("TEMP_MIN")) == (1200, -12)
    assert client.get("OUT1_MAX") == 2000, "the value was not saved"
    client.command((1, UNITLESS, -1.0))
    client.spin_until(lambda: used.pulse_us() == 1200, "pulse of 1200 us")


def test_saved_parameters_survive_the_end_of_the_simulation(bench):
    first = bench()
    client = first.dronecan()
    client.set("TEMP_ID", 513)
    client.save()
    first.end()
    second = bench(eeproms=[first.eeprom(0).read_bytes()])
    assert second.dronecan().get("TEMP_ID") == 513


def test_erasing_restores_the_defaults(bench):
    client = bench().dronecan()
    client.set("OUT1_MIN", 1200)
    client.save()
    assert client.execute(protocol.param.ExecuteOpcode.Request().OPCODE_ERASE)
    assert client.get("OUT1_MIN") == 1000
    client.restart()
    assert client.get("OUT1_MIN") == 1000


@pytest.mark.parametrize(
    "name, value, in_force",
    [
        ("OUT1_MIN", {"integer_value": 2501}, 1000),
        ("OUT1_MIN", {"integer_value": -1}, 1000),
        ("OUT1_MIN", {"real_value": 1100.0}, 1000),
        ("ARM_REQ", {"boolean_value": 1}, 0),
        ("OUT1_MIN", {"string_value": "1100"}, 1000),
        ("CAN_BAUDRATE", {"integer_value": 800_000}, 1_000_000),
    ],
)
def test_an_invalid_value_is_answered_with_the_current_one(bench, name, value, in_force):
    response = bench().dronecan().parameter(name, **value)
    assert (str(response.name), response.value.integer_value) == (name, in_force)


def test_an_unknown_parameter_gets_an_empty_answer(bench):
    client = bench().dronecan()
    for response in (
        client.parameter("NO_SUCH_THING"),
        client.parameter(index=len(PARAMETERS)),
        client.parameter(index=8191),
    ):
        assert len(response.name) == 0
        assert dronecan_field(response.value) == "empty"


def dronecan_field(union):
    from dronecan import get_active_union_field

    return get_active_union_field(union)


def test_five_requests_at_once_are_answered_in_order(bench):
    """Like a GUI tool that fetches parameters, while an autopilot sends commands."""
    used = bench(slcan=2)
    client, autopilot = used.dronecan(0, node_id=127), used.dronecan(1, node_id=10)
    autopilot.node.periodic(0.02, lambda: autopilot.command((1, PWM, 1600)))
    for first in range(0, len(PARAMETERS), 5):
        answers = []
        for index in range(first, first + 5):
            request = protocol.param.GetSet.Request(index=index)
            client.node.request(
                request,
                NODE,
                lambda event, index=index: answers.append((index, event)),
                priority=30,
            )
        client.spin_until(lambda: len(answers) == 5 or autopilot.spin(0.01), "five answers")
        assert [index for index, _ in answers] == list(range(first, first + 5))
        assert all(event is not None for _, event in answers), "an answer is missing"
        # Beyond the last parameter the name is empty.
        expected = [*PARAMETERS, *[""] * 5][first : first + 5]
        assert [str(event.response.name) for _, event in answers] == expected
    assert used.pulse_us() == 1600


@pytest.mark.parametrize(
    "features, board, text",
    [("default", "diecimila", ""), ("full", "uno", "update over USB serial")],
)
def test_without_a_loader_a_firmware_update_is_rejected(bench, features, board, text):
    client = bench(elf=node_elf(features, board=board)).dronecan()
    request = protocol.file.BeginFirmwareUpdate.Request(source_node_id=0)
    request.image_file_remote_path.path = "firmware.bin"
    response = client.ask(request)
    assert response.error == response.ERROR_INVALID_MODE
    assert str(response.optional_error_message) == text


def test_transport_stats_count_transfers_and_frames(bench):
    client = bench(elf=node_elf("full", board="uno")).dronecan()
    first = client.ask(protocol.GetTransportStats.Request())
    for _ in range(20):
        client.command((1, UNITLESS, 0.0))
        client.spin(0.01)
    second = client.ask(protocol.GetTransportStats.Request())
    assert len(first.can_iface_stats) == len(second.can_iface_stats) == 1
    assert second.transfers_rx - first.transfers_rx >= 21
    assert second.transfers_tx > first.transfers_tx
    assert second.can_iface_stats[0].frames_rx > first.can_iface_stats[0].frames_rx
    assert second.can_iface_stats[0].frames_tx > first.can_iface_stats[0].frames_tx
    assert second.transfer_errors == first.transfer_errors == 0


def test_a_restart_needs_its_magic_number(bench):
    used = bench()
    client = used.dronecan()
    request = protocol.RestartNode.Request()
    request.magic_number = 0xBEEFCAFE
    assert not client.ask(request).ok
    used.still_runs()
    assert len(re.findall(r"reset: ", used.text())) == 1
    client.restart()
    used.wait_for_text(r"reset: (.|\n)*reset: ")


def test_the_simulator_prints_requests_and_responses(bench):
    major, minor = VERSION
    used = bench("--traffic", "--log", "said.txt")
    client = used.dronecan()
    client.set("OUT1_MIN", 1100)
    client.ask(protocol.GetNodeInfo.Request())
    client.save()
    used.still_runs()
    for text in (used.text(), (used.directory / "said.txt").read_text()):
        for line in [
            r"10>120 param\.GetSet request OUT1_MIN = 1100$",
            r"120>10 param\.GetSet response OUT1_MIN = 1100 \(500 to 2500, default 1000\)$",
            rf"120>10 GetNodeInfo response org\.\S+ software {major}\.{minor} .*unique ID "
            rf"[0-9A-F]{{32}}$",
            r"10>120 param\.ExecuteOpcode request SAVE$",
            r"120>10 param\.ExecuteOpcode response ok$",
            r"120 actuator\.Status id 1 ",
        ]:
            assert re.search(line, text, re.M), line
