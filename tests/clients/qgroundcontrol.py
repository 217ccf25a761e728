"""QGroundControl's rules for vehicles and parameters, replayed: the program itself needs a screen.

Read in its sources (mavlink/qgroundcontrol): src/Vehicle/MultiVehicleManager.cc for `make_vehicle`,
src/Vehicle/Vehicle.cc for `heartbeat`, src/FactSystem/ParameterManager.cc for the rest. Some of its
releases take the armed state from the heartbeats of each component of the system, and later ones
from the vehicle's own; both are kept.
"""

import struct
import time

from conftest import TIMEOUT_S
from ground import Station, mavlink

AUTOPILOT_COMPONENT = 1
NO_VEHICLES = (
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    mavlink.MAV_TYPE_GIMBAL,
    mavlink.MAV_TYPE_ADSB,
)
INITIAL_REQUEST_TIMEOUT_S = 5
WAITING_PARAM_TIMEOUT_S = 3
LIST_RETRIES = 4
PARAMETER_RETRIES = 5
BATCH = 10
SET_TIMEOUT_S = 1
SET_TRIES = 3
FORMATS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
    mavlink.MAV_PARAM_TYPE_REAL32: "<f",
}


class QGroundControl:
    """One vehicle on any number of links."""

    def __init__(self, *links):
        self.links = [Station(link) if isinstance(link, str) else link for link in links]
        self.vehicle = None
        self.is_ardupilot = False
        # For the vehicle: (armed, mode) of each heartbeat, by the rule of all releases and by the
        # later one.
        self.states_of_system, self.states_of_vehicle = [], []
        self.missing, self.facts, self.tries = {}, {}, {}
        self.batch_is_active = False
        self.last_parameter = None
        self.texts = []

    def close(self):
        for link in self.links:
            link.close()

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for link in self.links:
                if message := link.receive():
                    self.take(message)

    def spin_until(self, condition, what):
        end = time.monotonic() + TIMEOUT_S
        while not condition():
            assert time.monotonic() < end, f"no {what} within {TIMEOUT_S} s"
            self.spin(0.02)

    def take(self, message):
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self.make_vehicle(message)
            self.heartbeat(message)
        elif kind == "PARAM_VALUE" and message.get_srcSystem() == self.vehicle:
            self.parameter(message)
        elif kind == "STATUSTEXT":
            self.texts.append(message.text)

    def make_vehicle(self, message):
        is_one = (
            message.get_srcComponent() == AUTOPILOT_COMPONENT and message.type not in NO_VEHICLES
        )
        if self.vehicle is None and is_one and message.get_srcSystem() != 0:
            self.vehicle = message.get_srcSystem()
            self.is_ardupilot = message.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA

    def heartbeat(self, message):
        if message.get_srcSystem() == self.vehicle:
            state = (
                bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
                message.custom_mode,
            )
            if message.get_srcComponent() == AUTOPILOT_COMPONENT:
                self.states_of_vehicle.append(state)
            if message.get_srcComponent() == AUTOPILOT_COMPONENT or message.type not in NO_VEHICLES:
                self.states_of_system.append(state)

    def value(self, message):
        if self.is_ardupilot:
            return message.param_value
        return struct.unpack(FORMATS[message.param_type], struct.pack("<f", message.param_value))[0]

    def parameter(self, message):
        component = message.get_srcComponent()
        self.last_parameter = time.monotonic()
        if component not in self.missing:
            self.missing[component] = set(range(message.param_count))
        self.missing[component].discard(message.param_index)
        self.facts.setdefault(component, {})[message.param_id] = (
            message.param_type,
            self.value(message),
        )

    def is_loaded(self):
        return not any(self.missing.values()) and AUTOPILOT_COMPONENT in self.facts

    def load(self, timeout_s=60):
        """The seconds until all parameters of all components have arrived, with QGroundControl's
        requests.
        """
        start = time.monotonic()
        lists = 0
        while not self.is_loaded():
            now = time.monotonic()
            assert now < start + timeout_s, f"missing: {self.missing}"
            if self.last_parameter is None and now >= start + lists * INITIAL_REQUEST_TIMEOUT_S:
                assert lists <= LIST_RETRIES, (
                    "the vehicle does not respond to the request for parameters"
                )
                lists += 1
                for link in self.links:
                    link.mav.param_request_list_send(self.vehicle, 0)
            elif self.last_parameter and now >= self.last_parameter + WAITING_PARAM_TIMEOUT_S:
                self.last_parameter = now
                self.ask_for_missing()
            self.spin(0.02)
        return time.monotonic() - start

    def ask_for_missing(self):
        self.batch_is_active = True
        missing = [
            (component, index)
            for component, indices in self.missing.items()
            for index in sorted(indices)
        ]
        for component, index in missing[:BATCH]:
            self.tries[component, index] = self.tries.get((component, index), 0) + 1
            assert self.tries[component, index] <= PARAMETER_RETRIES, (
                f"gives up parameter {index} of component {component}"
            )
            for link in self.links:
                link.mav.param_request_read_send(self.vehicle, component, b"", index)

    def set(self, component, name, value):
        """Sets a parameter. True if a PARAM_VALUE of the same type with this value arrives in time.
        """
        kind, _ = self.facts[component][name]
        as_sent = (
            float(value)
            if self.is_ardupilot
            else struct.unpack("<f", struct.pack(FORMATS[kind], value))[0]
        )
        for _ in range(SET_TRIES):
            self.facts[component].pop(name, None)
            for link in self.links:
                link.mav.param_set_send(self.vehicle, component, name.encode(), as_sent, kind)
            end = time.monotonic() + SET_TIMEOUT_S
            while time.monotonic() < end:
                self.spin(0.02)
                if self.facts[component].get(name) == (kind, value):
                    return True
        return False


class Autopilot(Station):
    """An ArduPilot with only its heartbeats and parameters: component 1 of the system, on a link of
    the bridge.
    """

    PARAMETERS = {"ARMING_CHECK": 1.0, "SYSID_THISMAV": 1.0}

    def __init__(self, device, system=1):
        super().__init__(device, component=AUTOPILOT_COMPONENT)
        self.mav.srcSystem = system
        self.beats = 0

    def beat(self, mav=None):
        """Sends a heartbeat of an armed copter in mode 4, to the bridge or to another link."""
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        (mav or self.mav).heartbeat_send(
            mavlink.MAV_TYPE_QUADROTOR,
            mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            armed,
            4,
            mavlink.MAV_STATE_ACTIVE,
        )
        self.beats += 1
