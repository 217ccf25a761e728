//! Tests of the simulated chip's TWI as a master, with a program of its own and with Arduino's
//! library Wire.

use crate::avr::{MS, assert_no_violation, byte, bytes, program, sketch, word};
use bench::avr::Avr;
use bench::i2c::{Devices, Setting};

/// Connects a device.
fn connect(avr: &mut Avr, setting: &str) -> Devices {
    let devices = Devices::default();
    devices.set(&setting.parse::<Setting>().expect("a device"));
    avr.connect_twi(Box::new(devices.clone()));
    devices
}

/// Tables 22-2 and 22-3.
#[test]
fn each_step_of_a_master_has_the_status_and_the_time_of_the_datasheet() {
    let mut avr = program("twi", &[]);
    let devices = connect(&mut avr, "0x48");
    avr.run_until(10 * MS);
    assert_eq!(byte(&avr, "done"), 1);
    assert_eq!(
        bytes(&avr, "status"),
        [
            0x08, 0x18, 0x28, 0x28, 0x28, // two registers are written
            0x10, 0x18, 0x28, 0x10, 0x40, 0x50, 0x58, // and read
            0x08, 0x20, // another device is not there
        ]
    );
    assert_eq!(bytes(&avr, "received"), [0xA5, 0x5A]);
    assert_eq!([0x10, 0x11].map(|at| devices.register(0x48, at)), [Some(0xA5), Some(0x5A)]);
    // Nine bits of 160 cycles, and the loop that waits for TWINT.
    let ticks = word(&avr, "ticks");
    assert!((180..=188).contains(&ticks), "{ticks}");
    assert_no_violation(&mut avr);
}

#[test]
fn on_an_empty_bus_nothing_acknowledges() {
    let mut avr = program("twi", &[]);
    avr.run_until(10 * MS);
    let status = bytes(&avr, "status");
    assert_eq!(status[..5], [0x08, 0x20, 0x30, 0x30, 0x30]);
    assert_eq!(status[9..11], [0x48, 0], "no byte follows an address that is refused");
}

#[test]
fn a_sketch_with_arduino_s_library_wire_reads_a_sensor_and_finds_another_missing() {
    let mut avr = sketch("wire");
    let devices = connect(&mut avr, "0x48:0x00=0x19,0x80");
    avr.run_until(20 * MS);
    assert_eq!(word(&avr, "temperature"), 0x1980);
    // Wire's "received NACK on transmit of address".
    assert_eq!(byte(&avr, "missing"), 2);
    devices.set(&"0x48:0x00=0xFF,0x80".parse().expect("a device"));
    avr.run_until(40 * MS);
    assert_eq!(word(&avr, "temperature"), 0xFF80);
    assert!(byte(&avr, "rounds") > 10, "{}", byte(&avr, "rounds"));
    assert_no_violation(&mut avr);
    assert_eq!(avr.unmodelled_after(0), []);
}
