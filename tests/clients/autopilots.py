"""What autopilots make of BatteryInfo and RPM: rules of their sources, replayed.

ArduPilot: libraries/AP_BattMonitor/AP_BattMonitor_DroneCAN.cpp and AP_BattMonitor_Backend.cpp,
libraries/AP_RPM/RPM_DroneCAN.cpp and AP_RPM.cpp. PX4: src/drivers/uavcan/sensors/battery.cpp and
src/lib/battery/battery.cpp. Times are those of pydronecan's events, in seconds of the monotonic
clock.
"""

import math

# A state of charge or of health that is not known (DSDL 1092.BatteryInfo.uavcan).
UNKNOWN = 127
KELVIN = 273.15


class ArduPilotBattery:
    """A battery with BATT_MONITOR 8. `ignores_soc` is bit 0 of BATT_OPTIONS."""

    TIMEOUT_S = 5
    # ArduPilot does not count the charge of a longer gap.
    LONGEST_GAP_S = 2

    def __init__(self, serial_number=-1, capacity_mah=3300, ignores_soc=False):
        self.serial_number, self.capacity_mah = serial_number, capacity_mah
        self.ignores_soc = ignores_soc
        self.node = self.last = None
        self.voltage = self.current = self.consumed_mah = 0.0
        self.soc = UNKNOWN
        self.health = None
        self.celsius, self.celsius_at = None, -math.inf

    def matches(self, message):
        return self.serial_number < 0 or self.serial_number == message.battery_id

    def hear(self, message, now):
        if not math.isnan(message.temperature) and message.temperature > 0:
            self.celsius, self.celsius_at = message.temperature - KELVIN, now
        self.voltage, self.current = message.voltage, message.current
        self.soc = message.state_of_charge_pct
        if self.last is not None and now - self.last < self.LONGEST_GAP_S:
            self.consumed_mah += self.current * (now - self.last) / 3.6
        if message.state_of_health_pct != UNKNOWN:
            self.health = message.state_of_health_pct
        self.last = now

    def is_healthy(self, now):
        return self.last is not None and now - self.last <= self.TIMEOUT_S

    def temperature(self, now):
        """Degrees Celsius, or None."""
        return self.celsius if now - self.celsius_at <= self.TIMEOUT_S else None

    def remaining_percent(self, now):
        """The node's state of charge; if that is unknown or ignored, ArduPilot's own count; None if
        the battery is not healthy.
        """
        if self.soc != UNKNOWN and not self.ignores_soc:
            return self.soc if self.is_healthy(now) else None
        return 100 * min(1, max(0, 1 - self.consumed_mah / self.capacity_mah))


class ArduPilotBatteries:
    """The batteries of one ArduPilot. The first that accepts a message takes its node for ever."""

    def __init__(self, *batteries):
        self.batteries = batteries

    def hear(self, event):
        message, source = event.message, event.transfer.source_node_id
        for node in (source, None):
            for battery in self.batteries:
                if battery.node == node and battery.matches(message):
                    battery.node = source
                    battery.hear(message, event.transfer.ts_monotonic)
                    return


class ArduPilotRpm:
    """A sensor with RPM1_TYPE of DroneCAN and this RPM1_DC_ID."""

    TIMEOUT_S = 1
    # RPM1_MIN_QUAL
    LEAST_QUALITY = 0.5

    def __init__(self, sensor_id):
        self.sensor_id = sensor_id
        self.last, self.speed, self.quality = -math.inf, 0, 0

    def hear(self, event):
        message = event.message
        if message.sensor_id == self.sensor_id:
            self.last, self.speed = event.transfer.ts_monotonic, message.rpm
            self.quality = 0 if message.flags & message.FLAGS_UNHEALTHY else 0.5

    def was_heard(self):
        return self.last > -math.inf

    def rpm(self, now):
        """The speed, or None if ArduPilot takes the sensor for unhealthy."""
        if now - self.last > self.TIMEOUT_S or self.quality < self.LEAST_QUALITY:
            return None
        return self.speed


class Px4Batteries:
    """The batteries of one PX4 with UAVCAN_SUB_BAT 1: one for each node, whatever its BATT_ID."""

    INSTANCES = 4

    def __init__(self):
        self.by_node = {}

    def hear(self, event):
        source = event.transfer.source_node_id
        if source in self.by_node or len(self.by_node) < self.INSTANCES:
            battery = self.by_node.setdefault(source, Px4Battery())
            battery.hear(event.message, event.transfer.ts_monotonic)


class Px4Battery:
    # BAT_EMERGEN_THR, BAT_CRIT_THR and BAT_LOW_THR
    WARNINGS = ((0.05, "emergency"), (0.07, "critical"), (0.15, "low"))

    def __init__(self):
        self.last = None
        self.heard = 0
        self.discharged_mah = 0.0
        # Each that came, in their order.
        self.warnings = []

    def hear(self, message, now):
        self.voltage, self.current = message.voltage, message.current
        # PX4 does not know an unknown one: it is 1.27.
        self.remaining = message.state_of_charge_pct / 100
        self.celsius = message.temperature - KELVIN
        self.remaining_wh = message.remaining_capacity_wh
        self.full_wh = message.full_charge_capacity_wh
        if self.last is not None:
            self.discharged_mah += abs(self.current) * (now - self.last) / 3.6
        self.last = now
        self.heard += 1
        warning = next((name for below, name in self.WARNINGS if self.remaining < below), "none")
        if [warning] != self.warnings[-1:]:
            self.warnings.append(warning)
