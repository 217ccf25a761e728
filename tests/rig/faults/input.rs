//! Faults of the sensor, and harmful frames from other nodes.

use super::{BUS_LIMIT_MS, COMMANDED_US, Case, FAILSAFE_US, Measured, Trial, assert_servo};
use crate::status::{ID_CONFLICT, TEMPERATURE};
use crate::{ARRAY_COMMAND, MS, NODE, Rig, STATUS_OF_NODE, started, status_fields};
use bench::can::Frame;
use bench::dronecan::{Message, ParameterRequest};

pub const ALL: [&Case; 8] = [
    &SENSOR_OPEN,
    &SENSOR_SHORTED,
    &SENSOR_NOISY,
    &NOT_FINITE,
    &OUT_OF_RANGE,
    &REQUESTS,
    &SAME_ID,
    &TWIN,
];

const FOLLOWS: &str = "follows";

fn broken_sensor(millivolts: u32) -> Measured {
    let mut trial = Trial::running();
    trial.begin("sensor fault", |rig| rig.board().set_sensor_millivolts(millivolts));
    trial.live(2500);
    let (_, code) = trial.rig.status_now();
    assert_eq!(code & TEMPERATURE, TEMPERATURE, "{code:#06x}");
    assert_servo(&trial.rig, &[COMMANDED_US]);
    trial.end(|rig| rig.board().set_temperature_c(25.0));
    let measured = trial.recover(BUS_LIMIT_MS, 0);
    trial.rig.wait_for_line("over: temperature", 1200);
    measured
}

pub const SENSOR_OPEN: Case = Case {
    fault: "sensor open (reads the supply)",
    noticed: "a reading at an end of the range is no temperature (bit 11)",
    reaction: "logged, and in the status; cleared a second after the sensor works again",
    servo: FOLLOWS,
    logged_limit_ms: Some(2100),
    limit_ms: BUS_LIMIT_MS,
    run: || broken_sensor(5000),
};

pub const SENSOR_SHORTED: Case =
    Case { fault: "sensor shorted to ground", run: || broken_sensor(0), ..SENSOR_OPEN };

pub const SENSOR_NOISY: Case = Case {
    fault: "sensor noisy, by plus or minus 100 mV (10 degrees)",
    noticed: "not noticed; the average stays within 2 degrees",
    reaction: "none",
    servo: FOLLOWS,
    logged_limit_ms: None,
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::running();
        trial.rig.board().set_temperature_c(25.0);
        trial.live(1100);
        trial.begin("sensor fault", |rig| rig.board().set_sensor_noise_millivolts(100, 3));
        trial.live(6000);
        let reported = trial.rig.node_messages(|message| match message {
            Message::Temperature(temperature) => Some(temperature.celsius()),
            _ => None,
        });
        assert!(reported.len() >= 5);
        for (_, celsius) in &reported {
            assert!((celsius - 25.0).abs() < 2.0, "{reported:?}");
        }
        assert_eq!(trial.rig.status_now().1, 0);
        assert_servo(&trial.rig, &[COMMANDED_US]);
        trial.end(|rig| rig.board().set_sensor_noise_millivolts(0, 0));
        Measured { logged_ms: None, ..trial.recover(BUS_LIMIT_MS, 0) }
    },
};

/// The peer sends commands 2,000 times a second in place of the autopilot's.
fn commands_at_2_khz(
    trial: &mut Trial,
    values: &[(u8, u16)],
    expected: impl Fn(f64) -> bool,
) -> Measured {
    trial.begin("refused: command", |_| {});
    trial.autopilot_sends = false;
    let mut n = 0;
    trial.live_with(2000, COMMANDED_US, |rig| {
        for _ in 0..2 {
            let (kind, value) = values[n % values.len()];
            let [low, high] = value.to_le_bytes();
            rig.send(ARRAY_COMMAND | 10, &[1, kind, low, high, 0xC0 | (n % 32) as u8]);
            n += 1;
        }
    });
    let moved = trial.rig.pulses.iter().find(|pulse| !expected(pulse.width_us()));
    assert!(moved.is_none(), "{moved:?}");
    assert_eq!(trial.rig.board().chip().borrow().rx_overflows(), 0, "no frame is lost");
    trial.autopilot_sends = true;
    trial.live(60);
    trial.end_unchecked(|_| {});
    trial.rig.pulses.clear();
    trial.recover(BUS_LIMIT_MS, 0)
}

const HALF_NAN: u16 = 0x7E00;
const HALF_INFINITY: u16 = 0x7C00;
const HALF_MINUS_INFINITY: u16 = 0xFC00;
const HALF_MAX: u16 = 0x7BFF;
const HALF_MIN: u16 = 0xFBFF;

pub const NOT_FINITE: Case = Case {
    fault: "commands that are NaN or infinite, 2,000 a second",
    noticed: "each is rejected and counted, and logged if the serial monitor has room; failsafe \
              (bit 10)",
    reaction: "the node does not follow them, and they do not prevent the failsafe",
    servo: "holds its position, then failsafe after `OUT1_TIMEOUT`",
    logged_limit_ms: Some(100),
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::running();
        let values = [0, 1, 4]
            .map(|kind| [HALF_NAN, HALF_INFINITY, HALF_MINUS_INFINITY].map(|value| (kind, value)));
        commands_at_2_khz(&mut trial, &values.concat(), |us| {
            us == COMMANDED_US || us == FAILSAFE_US
        })
    },
};

pub const OUT_OF_RANGE: Case = Case {
    fault: "commands out of range, 2,000 a second",
    noticed: "limited to the travel; the node rejects and logs microseconds that are no valid \
              pulse",
    reaction: "followed within the travel",
    servo: "never beyond `OUT1_MIN` and `OUT1_MAX`",
    logged_limit_ms: Some(1000),
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::running();
        let values = [0, 1, 4]
            .map(|kind| [HALF_MAX, HALF_MIN, HALF_MAX - 0x0400].map(|value| (kind, value)));
        commands_at_2_khz(&mut trial, &values.concat(), |us| {
            us == COMMANDED_US || us == FAILSAFE_US || us == 1000.0 || us == 2000.0
        })
    },
};

pub const REQUESTS: Case = Case {
    fault: "requests, 2,000 a second",
    noticed: "rejected if the queue of eight is full, and logged if the serial monitor has room",
    reaction: "answers the requests in the queue in order; commands and statuses continue",
    servo: FOLLOWS,
    logged_limit_ms: None,
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::running();
        trial.begin("", |_| {});
        // The closure below sends the commands between the requests.
        trial.autopilot_sends = false;
        let mut slot = 0u32;
        trial.live_with(2000, COMMANDED_US, |rig| {
            for _ in 0..2 {
                rig.request(&Message::ParameterRequest(ParameterRequest {
                    index: 3,
                    ..ParameterRequest::default()
                }));
            }
            if slot.is_multiple_of(20) {
                rig.send_command(1, 4, COMMANDED_US as f32);
            }
            slot += 1;
        });
        assert_servo(&trial.rig, &[COMMANDED_US]);
        let answers = trial.rig.answers().len();
        assert!(answers > 100, "{answers} answers in two seconds");
        assert!(
            trial.rig.statuses().len() >= 2 || trial.rig.now() < 2000 * MS,
            "the node must send statuses"
        );
        assert_eq!(trial.rig.board().chip().borrow().rx_overflows(), 0, "no frame is lost");
        trial.autopilot_sends = true;
        trial.end(|rig| rig.peer.borrow_mut().clear_queue());
        Measured { logged_ms: None, ..trial.recover(BUS_LIMIT_MS, 0) }
    },
};

pub const SAME_ID: Case = Case {
    fault: "another node has the node's ID, and sends statuses and commands",
    noticed: "frames from its own ID are rejected, counted and logged (bit 4)",
    reaction: "continues",
    servo: "does not follow them",
    logged_limit_ms: Some(50),
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::running();
        let mut ms = 0u32;
        trial.begin("refused: type 341 from 120", |_| {});
        trial.live_with(3000, COMMANDED_US, |rig| {
            if ms % 1000 == 10 {
                rig.send_frame(Frame::extended(STATUS_OF_NODE, &[1, 0, 0, 0, 0, 0, 0, 0xC0]));
                rig.send(ARRAY_COMMAND | NODE, &[1, 0, 0, 0, 0xC0]);
            }
            ms += 1;
        });
        assert_servo(&trial.rig, &[COMMANDED_US]);
        trial.end(|_| {});
        trial.recover(BUS_LIMIT_MS, ID_CONFLICT)
    },
};

/// Both boards run the shipped firmware, each with its own clock.
pub const TWIN: Case = Case {
    fault: "two boards of this firmware with the same ID",
    noticed: "by both, within two seconds (bit 4)",
    reaction: "both continue; two different frames with the same identifier destroy each other \
               until one node drops its frame",
    servo: "both follow the commands",
    logged_limit_ms: Some(2000),
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::with(Rig::running_with(started()));
        trial.rig.overflows_expected = true;
        trial.begin("refused: type 341 from 120", |rig| rig.add_board(started(), 1));
        trial.live(4000);
        assert_servo(&trial.rig, &[COMMANDED_US]);
        let codes: Vec<u16> =
            trial.rig.statuses().iter().map(|(_, data)| status_fields(data).3).collect();
        assert!(codes.iter().any(|code| code & ID_CONFLICT != 0), "{codes:x?}");
        let serial = trial.rig.serial_of(1);
        assert!(
            serial.contains("refused: type 341 from 120"),
            "the other board must log it, too: {serial}"
        );
        trial.end(|rig| {
            let port = rig.bench.port(1);
            rig.bench.bus().connect(port, false);
        });
        trial.recover(BUS_LIMIT_MS, ID_CONFLICT)
    },
};
