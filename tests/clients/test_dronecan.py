"""pydronecan over SLCAN: the node uses the dialect as other implementations do."""

import pytest
from dronecan import thirdparty, uavcan

from conftest import NODE

UNITLESS, POSITION, PWM = 0, 1, 4


def test_the_node_appears_in_the_node_monitor(bench):
    bench().dronecan().assert_in_node_monitor()


def test_node_status_is_the_standard_type_and_counts_the_uptime(bench):
    client = bench().dronecan()
    statuses = client.gather(uavcan.protocol.NodeStatus, 5)
    uptimes = [status.uptime_sec for status in statuses]
    # One status a second, and an answer to the client's, whose clock differs: at most two a second.
    assert uptimes == sorted(uptimes) and uptimes[0] < 5 and 2 <= uptimes[4] - uptimes[0] <= 5
    assert {status.sub_mode for status in statuses} == {0}


@pytest.mark.parametrize("celsius", [1, 25, 60.5])
def test_temperature_is_the_standard_type_in_kelvin(bench, celsius):
    client = bench("--temperature", celsius).dronecan()
    message = client.gather(uavcan.equipment.device.Temperature, 2)[-1]
    # Half a step of the ADC plus half a step of the float16.
    assert message.temperature == pytest.approx(celsius + 273.15, abs=0.4)
    assert (message.device_id, message.error_flags) == (1, 0)


@pytest.mark.parametrize(
    "command_type, value, pulse_us",
    [(UNITLESS, 0.5, 1750), (UNITLESS, -1.0, 1000), (POSITION, 0.7854, 2000), (PWM, 1234, 1234)],
)
def test_an_array_command_moves_the_servo_to_the_right_pulse(bench, command_type, value, pulse_us):
    used = bench()
    client = used.dronecan()
    client.command((7, UNITLESS, -1.0))
    client.spin(0.2)
    assert used.pulse_us() is None, "a command for another actuator must not move the servo"
    client.command((1, command_type, value))
    client.spin_until(used.pulse_us, "pulse")
    client.spin_until(lambda: used.pulse_us() == pulse_us, f"pulse of {pulse_us} us")


def test_the_node_handles_what_the_gui_tool_sends(bench):
    """Its actuator panel sends an empty array while no channel is ticked, and several frames for
    two channels.
    """
    used = bench()
    client = used.dronecan()
    for _ in range(10):
        client.command()
        client.command((1, UNITLESS, 0.1), (2, UNITLESS, 0.2), (3, UNITLESS, 0.3))
        client.spin(0.05)
    client.command((1, UNITLESS, 0.5))
    client.spin_until(lambda: used.pulse_us() == 1750, "pulse of 1750 us")


def test_the_thesis_s_command_moves_the_servo(bench):
    used = bench()
    client = used.dronecan(node_id=1)
    client.node.broadcast(thirdparty.thesis.ServoCommand(position=255))
    client.spin_until(lambda: used.pulse_us() == 2000, "pulse of 2000 us")
    client.node.broadcast(thirdparty.thesis.ServoCommand(position=0))
    client.spin_until(lambda: used.pulse_us() == 1000, "pulse of 1000 us")


def test_two_clients_and_the_node_share_the_bus(bench):
    used = bench(slcan=2)
    first, second = used.dronecan(0, 10), used.dronecan(1, 11)
    first.node.broadcast(uavcan.protocol.NodeStatus(uptime_sec=77))
    heard = []
    second.node.add_handler(
        uavcan.protocol.NodeStatus, lambda event: heard.append(event.transfer.source_node_id)
    )

    def both():
        first.spin(0.05)
        return {10, NODE} <= set(heard)

    second.spin_until(both, "status of both others")


def test_a_client_can_reopen_its_adapter(bench):
    used = bench()
    for _ in range(3):
        client = used.dronecan()
        client.wait_for(uavcan.protocol.NodeStatus)
        client.close()


def test_an_adapter_rejects_another_bit_rate(bench):
    used = bench("--bit-rate", "500000")
    assert used.raw().ask(b"S8\r") == b"\x07"
    assert used.raw().ask(b"S6\r") == b"\r"
