"""ArduPilot and PX4 read batteries and the speed of a shaft, by the rules of their sources."""

import contextlib
import math
import time

import dronecan
import pytest
from dronecan import uavcan

from autopilots import (
    UNKNOWN,
    ArduPilotBatteries,
    ArduPilotBattery,
    ArduPilotRpm,
    Px4Batteries,
)
from conftest import NODE, node_elf

BATTERY_INFO = uavcan.equipment.power.BatteryInfo
RPM = dronecan.dronecan.sensors.rpm.RPM
# 12.6 V with a divider of 10 and 1 kOhm, and 18 A, 5 mAh a second, with 0.2 V for an ampere.
CIRCUIT = ["--pwr-voltage", "1145", "--pwr-current", "3600"]
SCALES = {"PWR1_VOLT_MULT": 11000, "PWR1_AMP_PERVLT": 500}


def set_all(client, parameters, node=NODE):
    for name, value in parameters.items():
        client.set(name, value, node)


@contextlib.contextmanager
def hearing(client, data_type, *listeners):
    handles = [client.node.add_handler(data_type, listener.hear) for listener in listeners]
    yield
    for handle in handles:
        handle.remove()


def assert_has_18_a(battery):
    assert battery.voltage == pytest.approx(12.6, abs=0.08)
    assert battery.current == pytest.approx(18.0, abs=0.08)


def test_ardupilot_s_battery_monitor_reads_voltage_current_and_charge(bench):
    client = bench(*CIRCUIT, elf=node_elf("full", board="uno")).dronecan()
    set_all(client, {**SCALES, "BATT_ID": 5, "BATT_RATE": 10})
    any_battery, fifth, sixth = ArduPilotBattery(), ArduPilotBattery(5), ArduPilotBattery(6)
    counting = ArduPilotBattery(ignores_soc=True)
    autopilots = [ArduPilotBatteries(one) for one in (any_battery, fifth, sixth, counting)]
    with hearing(client, BATTERY_INFO, *autopilots):
        client.spin(2)
        assert sixth.node is None, "BATT_SERIAL_NUM 6 is another battery"
        assert sixth.remaining_percent(time.monotonic()) == 100
        for battery in (any_battery, fifth):
            now = battery.last
            assert battery.node == NODE and battery.is_healthy(now)
            assert_has_18_a(battery)
            assert battery.temperature(now) is None and battery.health is None
            # The node knows no capacity, so ArduPilot counts: about 10 mAh of 3300.
            assert battery.soc == UNKNOWN and 99 < battery.remaining_percent(now) < 100
        set_all(client, {"BATT_TEMP": 1, "BATT_CAPACITY": 200})
        client.spin(0.5)
        before = fifth.remaining_percent(fifth.last)
        assert 30 < before < 95 and before == fifth.soc
        client.spin_until(lambda: fifth.soc <= before - 5, "10 mAh less")
        assert fifth.temperature(fifth.last) == pytest.approx(25, abs=1)
        assert counting.soc == fifth.soc and counting.remaining_percent(counting.last) > 98


def test_ardupilot_s_battery_is_unhealthy_after_five_seconds_of_silence(bench):
    client = bench(*CIRCUIT, elf=node_elf("full", board="uno")).dronecan()
    set_all(client, {**SCALES, "BATT_CAPACITY": 1000, "BATT_TEMP": 1, "BATT_RATE": 1})
    battery = ArduPilotBattery()
    with hearing(client, BATTERY_INFO, ArduPilotBatteries(battery)):
        # The slowest rate: no gap is too long for ArduPilot's own count.
        client.spin_until(lambda: battery.consumed_mah > 9, "two gaps that count")
        assert battery.is_healthy(time.monotonic())
        # The last gap was of two seconds at most: 14 mAh.
        assert battery.consumed_mah < 9 + 14
        client.set("BATT_RATE", 0)
        last = battery.last
        client.spin(5.2)
        assert battery.last - last < 0.2, "the node must be silent"
        now = time.monotonic()
        assert not battery.is_healthy(now)
        assert battery.remaining_percent(now) is None and battery.temperature(now) is None
        client.set("BATT_RATE", 10)
        client.spin(0.5)
        assert battery.is_healthy(time.monotonic())
        assert battery.remaining_percent(time.monotonic()) == battery.soc < 99


def test_batteries_of_two_nodes_are_two_of_ardupilot_and_of_px4(bench):
    elf = node_elf("full", board="uno")
    eeproms = []
    for node, battery_id in ((NODE, 5), (NODE + 1, 6)):
        single = bench(elf=elf)
        client = single.dronecan()
        set_all(client, {**SCALES, "BATT_ID": battery_id, "BATT_RATE": 5, "CAN_NODE": node})
        client.save()
        single.end()
        eeproms.append(single.eeprom(0).read_bytes())
    # Only the first board has a circuit.
    client = bench(*CIRCUIT, "--nodes", "1", elf=elf, eeproms=eeproms).dronecan()
    sixth, fifth = ArduPilotBattery(6), ArduPilotBattery(5)
    px4 = Px4Batteries()
    with hearing(client, BATTERY_INFO, ArduPilotBatteries(sixth, fifth), px4):
        client.spin_until(lambda: sixth.node and fifth.node, "both batteries")
        client.spin(1)
    assert (fifth.node, sixth.node) == (NODE, NODE + 1)
    assert sorted(px4.by_node) == [NODE, NODE + 1]
    for full, empty in ((fifth, sixth), (px4.by_node[NODE], px4.by_node[NODE + 1])):
        assert_has_18_a(full)
        assert (empty.voltage, empty.current) == (0, 0)


def test_px4_reads_the_battery_and_warns(bench):
    client = bench(*CIRCUIT, elf=node_elf("full", board="uno")).dronecan()
    set_all(client, {**SCALES, "BATT_RATE": 10})
    px4 = Px4Batteries()
    with hearing(client, BATTERY_INFO, px4):
        client.spin(1)
        battery = px4.by_node[NODE]
        assert_has_18_a(battery)
        assert math.isnan(battery.celsius) and math.isnan(battery.remaining_wh)
        assert battery.remaining == 1.27, "without a capacity"
        set_all(client, {"BATT_TEMP": 1, "BATT_CAPACITY": 40})
        client.spin(0.3)
        before, discharged = battery.remaining, battery.discharged_mah
        since, heard = battery.last, battery.heard
        assert 0.1 < before < 0.9
        assert battery.celsius == pytest.approx(25, abs=1)
        client.spin_until(lambda: battery.remaining == 0, "empty battery")
        assert battery.warnings == ["none", "low", "critical", "emergency"]
        # What the node has counted since, and what PX4 has: percents are whole. PX4 counts by its
        # own clock, behind which a simulator beside other loads can fall.
        late_s = battery.last - since - (battery.heard - heard) / 10
        counted = battery.discharged_mah - discharged - battery.current * late_s / 3.6
        assert counted == pytest.approx(40 * before, abs=1.5)
        assert battery.remaining_wh == 0
        assert battery.full_wh == pytest.approx(0.04 * 12.6, abs=0.07)


def heard_of(client, *sensor_ids):
    """What ArduPilot has of these sensors after a second."""
    sensors = [ArduPilotRpm(sensor_id) for sensor_id in sensor_ids]
    with hearing(client, RPM, *sensors):
        client.spin(1)
    return sensors


@pytest.mark.parametrize("speed", [60, 6017, 60_000])
def test_ardupilot_reads_the_revolutions_of_a_shaft(bench, speed):
    client = bench("--rpm", str(speed), elf=node_elf("rpm", board="uno")).dronecan()
    assert not heard_of(client, 3)[0].was_heard(), "RPM_RATE is 0"
    set_all(client, {"RPM_ID": 3, "RPM_RATE": 5})
    client.spin(2.2)
    sensor, other = heard_of(client, 3, 0)
    assert sensor.rpm(time.monotonic()) == pytest.approx(speed, rel=0.002)
    assert not other.was_heard() and other.rpm(time.monotonic()) is None
    client.set("RPM_PULSES", 4)
    client.spin(0.5)
    (sensor,) = heard_of(client, 3)
    assert sensor.rpm(time.monotonic()) == pytest.approx(speed / 4, rel=0.002)


def test_ardupilot_has_no_speed_after_a_second_of_silence(bench):
    client = bench("--rpm", "6000", elf=node_elf("rpm", board="uno")).dronecan()
    # Twice a second is the slowest rate that the documents advise.
    client.set("RPM_RATE", 2)
    sensor = ArduPilotRpm(0)
    with hearing(client, RPM, sensor):
        client.spin(1.5)
        assert sensor.rpm(time.monotonic()) == pytest.approx(6000, rel=0.002)
        client.set("RPM_RATE", 0)
        client.spin(1.2)
        assert sensor.was_heard() and sensor.rpm(time.monotonic()) is None


def test_ardupilot_reads_that_a_noisy_shaft_has_no_speed(bench):
    client = bench("--rpm", "6000000", elf=node_elf("rpm", board="uno")).dronecan()
    client.set("RPM_RATE", 10)
    client.spin(0.3)
    (sensor,) = heard_of(client, 0)
    assert sensor.was_heard() and (sensor.speed, sensor.quality) == (0, 0)
    assert sensor.rpm(time.monotonic()) is None
