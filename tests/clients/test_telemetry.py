"""What the node publishes, and the messages besides commands that it follows, with pydronecan; and
the messages of ArduPilot and PX4.
"""

import math

import dronecan
import pytest
from dronecan import uavcan

from conftest import node_elf

UNITLESS, POSITION, PWM = 0, 1, 4

actuator = uavcan.equipment.actuator


def test_the_actuator_status_has_the_position(bench):
    used = bench()
    client = used.dronecan()
    status = client.wait_for(actuator.Status)
    assert status.actuator_id == 1 and math.isnan(status.position)
    client.command((1, UNITLESS, 0.5))
    client.spin_until(lambda: used.pulse_us() == 1750, "pulse of 1750 us")
    status = client.gather(actuator.Status, 3)[-1]
    assert status.position == pytest.approx(math.pi / 8, abs=0.002)
    assert math.isnan(status.force) and math.isnan(status.speed)
    assert status.power_rating_pct == status.POWER_RATING_PCT_UNKNOWN


def test_a_lights_command_dims_the_light(bench):
    used = bench(elf=node_elf("full", board="uno"))
    client = used.dronecan()
    indication = uavcan.equipment.indication

    def light(*commands):
        message = indication.LightsCommand()
        for light_id, red, green, blue in commands:
            color = indication.RGB565(red=red, green=green, blue=blue)
            message.commands.append(indication.SingleLightCommand(light_id=light_id, color=color))
        client.node.broadcast(message)
        client.spin(0.2)
        return used.light_percent()

    assert light((0, 31, 63, 31)) == 100
    half = light((7, 0, 0, 0), (0, 16, 32, 16), (8, 31, 63, 31))
    assert 40 < half < 60
    assert light((1, 31, 63, 31)) == half
    assert light((0, 0, 0, 0)) == 0


def test_the_button_publishes_its_count(bench, tmp_path):
    script = tmp_path / "script"
    script.write_text(
        "".join(f"({2 + n}.0) button press\n({2 + n}.2) button release\n" for n in range(3))
    )
    client = bench("--script", script, elf=node_elf("full", board="uno")).dronecan()
    counts = client.gather(uavcan.protocol.debug.KeyValue, 3)
    assert [(str(count.key), count.value) for count in counts] == [
        ("btn", 1.0),
        ("btn", 2.0),
        ("btn", 3.0),
    ]


def test_can_stats_count_frames(bench):
    client = bench(elf=node_elf("full", board="uno")).dronecan()
    client.set("STATS_RATE", 5)
    first = client.wait_for(dronecan.dronecan.protocol.CanStats)
    for _ in range(20):
        client.command((1, UNITLESS, 0.0))
        client.spin(0.02)
    client.spin(0.3)
    last = client.wait_for(dronecan.dronecan.protocol.CanStats)
    assert last.rx_received - first.rx_received >= 20
    assert last.tx_success > first.tx_success and last.tx_requests > first.tx_requests
    assert (last.rx_overflow, last.busoff_errors, last.tx_timedout) == (0, 0, 0)


def test_a_relay_holds_and_releases_and_says_so(bench):
    client = bench(elf=node_elf("relay", board="uno")).dronecan()
    hardpoint = uavcan.equipment.hardpoint
    for name, value in (("OUT1_ID", 5), ("OUT1_TYPE", 2), ("RELAY_RATE", 10)):
        client.set(name, value)
    for command, expected in ((1, 1), (0, 0), (7, 1)):
        client.node.broadcast(hardpoint.Command(hardpoint_id=5, command=command))
        client.node.broadcast(hardpoint.Command(hardpoint_id=6, command=1 - expected))
        client.spin(0.2)
        status = client.wait_for(hardpoint.Status)
        assert (status.hardpoint_id, status.status) == (5, expected)
        assert math.isnan(status.payload_weight) and math.isnan(status.payload_weight_variance)


def test_with_arm_req_commands_are_followed_when_the_vehicle_is_armed(bench):
    used = bench()
    client = used.dronecan()
    client.set("ARM_REQ", 1)
    status = uavcan.equipment.safety.ArmingStatus()

    def commanded(armed, value):
        for _ in range(5):
            client.node.broadcast(uavcan.equipment.safety.ArmingStatus(status=armed))
            client.command((1, PWM, value))
            client.spin(0.05)
        return used.pulse_us()

    assert commanded(status.STATUS_DISARMED, 1600) is None
    assert commanded(status.STATUS_FULLY_ARMED, 1700) == 1700
    assert commanded(status.STATUS_DISARMED, 1800) == 1700, "the servo must hold its position"


def test_a_failsafe_is_in_the_status_until_the_next_command(bench):
    used = bench()
    client = used.dronecan()
    status_type = uavcan.protocol.NodeStatus
    client.set("OUT1_FS", 1)
    client.set("OUT1_TIMEOUT", 300)
    client.command((1, PWM, 1900))
    client.spin_until(lambda: used.pulse_us() == 1900, "pulse of 1900 us")
    client.spin_until(lambda: used.pulse_us() == 1500, "trim")
    status = client.gather(status_type, 2)[-1]
    assert (status.health, status.vendor_specific_status_code) == (status.HEALTH_ERROR, 1 << 10)
    client.set("OUT1_TIMEOUT", 0)
    client.command((1, PWM, 1900))
    status = client.gather(status_type, 2)[-1]
    assert (status.health, status.vendor_specific_status_code) == (status.HEALTH_OK, 0)


def stream(client, used, make, expected_us):
    """Sends commands for a second and checks the servo's position, and that no transfer was broken.
    Beside a load one may be, as its frames are 50 ms apart; not each time.
    """
    for _ in range(3):
        status = stream_once(client, used, make, expected_us)
        if status.vendor_specific_status_code & 1 << 3 == 0:
            return
        # The node tells it for ten seconds.
        client.spin(11)
    pytest.fail("the node reported transfer errors")


def stream_once(client, used, make, expected_us):
    """One command for each status of the node's output, so that a simulator without a processor
    does not get more than its bus carries. Returns the node's status.
    """
    status_type = uavcan.equipment.actuator.Status
    handle = client.node.add_handler(status_type, lambda _: client.command(*make()))
    client.spin_until(lambda: used.pulse_us() == expected_us, f"pulse of {expected_us} us")
    client.spin(1)
    handle.remove()
    assert used.pulse_us() == expected_us
    return client.gather(uavcan.protocol.NodeStatus, 1)[0]


@pytest.mark.parametrize("servo", [1, 15])
@pytest.mark.parametrize("unit", [UNITLESS, PWM])
def test_fifteen_commands_like_ardupilot_s_are_followed(bench, servo, unit):
    used = bench()
    client = used.dronecan(node_id=10)
    client.set("OUT1_ID", servo)
    widths = {number: 1000 + 50 * number for number in range(1, 16)}
    value = (lambda us: us) if unit == PWM else (lambda us: us / 500 - 3)
    commands = [(number, unit, value(us)) for number, us in widths.items()]
    # A float16 between -1 and 1 differs from these values by up to half a microsecond of pulse
    # width.
    expected = widths[servo]
    if unit == UNITLESS:
        handle = client.node.periodic(0.02, lambda: client.command(*commands))
        client.spin_until(
            lambda: abs((used.pulse_us() or 0) - expected) <= 0.5, f"pulse of {expected} us"
        )
        handle.remove()
    else:
        stream(client, used, lambda: commands, expected)


# PX4 sends 15 commands since June 2026, and sent eight before.
@pytest.mark.parametrize(
    "count, servo, expected_us", [(8, 0, 1000), (8, 7, 1875), (15, 0, 1000), (15, 14, 1750)]
)
def test_as_many_commands_as_px4_sends_are_followed(bench, count, servo, expected_us):
    used = bench()
    client = used.dronecan(node_id=1)
    client.set("OUT1_ID", servo)
    stream(
        client,
        used,
        lambda: [(number, UNITLESS, number % 8 / 4 - 1) for number in range(count)],
        expected_us,
    )


@pytest.mark.parametrize("kind, servo", [("ardupilot", 1), ("ardupilot-pwm", 4), ("px4", 1)])
def test_the_node_follows_the_simulated_autopilots(bench, kind, servo):
    used = bench("--autopilot", kind, "--actuator", servo, "--hold", "0.5", autopilot=True)
    client = used.dronecan(node_id=127)
    client.set("OUT1_ID", servo)
    client.spin_until(lambda: used.pulse_us() == 1750, "pulse of 1750 us")
    used.wait_for_text(r" node +120 is org\.\S+ software ")
