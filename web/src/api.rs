//! What JavaScript calls.

use bench::avr::{Chip, Firmware, Processor};
use bench::dronecan::Opcode;
use wasm_bindgen::prelude::*;

use crate::js::{Avr8js, JsAvr, flash_of};
use crate::page::{self, Page};
use crate::scenario::{self, Traffic};

/// A program from an ELF or Intel HEX file.
#[wasm_bindgen]
pub struct Program {
    firmware: Firmware,
    chip: Chip,
}

#[wasm_bindgen]
impl Program {
    /// Reads a file.
    ///
    /// # Errors
    /// If the file is not a program for one of the chips; the text says why.
    pub fn parse(bytes: &[u8]) -> Result<Program, String> {
        let firmware = match std::str::from_utf8(bytes) {
            Ok(text) if text.starts_with(':') => Firmware::parse_hex(text),
            _ => Firmware::parse(bytes),
        };
        let checked = firmware.and_then(|firmware| {
            let chip = firmware.chip()?.unwrap_or_default();
            firmware.check_fits(chip)?;
            Ok(Program { firmware, chip })
        });
        text(checked)
    }

    /// The flash with the program.
    pub fn flash(&self) -> Vec<u8> {
        flash_of(&self.firmware, self.chip)
    }

    /// Bytes of RAM of the chip.
    pub fn ram_bytes(&self) -> usize {
        self.chip.ram_bytes()
    }

    /// The EEPROM as the file fills it, else erased.
    pub fn eeprom(&self) -> Vec<u8> {
        let mut eeprom = vec![0xFF; self.chip.eeprom_bytes()];
        for (address, bytes) in &self.firmware.eeprom {
            eeprom[*address..address + bytes.len()].copy_from_slice(bytes);
        }
        eeprom
    }
}

/// Runs a scenario of the cross-check on `avr`, and returns the trace.
///
/// # Errors
/// If the traffic has another name than those of [`Traffic::named`], or the wiring in the program
/// is impossible.
#[wasm_bindgen]
pub fn cross_check(
    program: &Program,
    avr: JsAvr,
    traffic: &str,
    seconds: u32,
    seed: u32,
) -> Result<String, String> {
    let traffic = Traffic::named(traffic).ok_or("no such traffic")?;
    let processor = Avr8js::new(avr, program.chip);
    text(scenario::run(processor, &program.firmware, traffic, seconds.into(), seed.into()))
}

/// All faults, a JSON array.
#[wasm_bindgen]
pub fn faults() -> String {
    page::faults()
}

/// A world for the page. Times are CPU cycles of 16 MHz.
#[wasm_bindgen]
pub struct Simulation(Page<Avr8js>);

#[wasm_bindgen]
impl Simulation {
    /// A board with a program that `avr` executes, and an autopilot.
    ///
    /// # Errors
    /// If the wiring in the program is impossible, or there is no such autopilot.
    #[wasm_bindgen(constructor)]
    pub fn new(program: &Program, avr: JsAvr, autopilot: &str) -> Result<Simulation, String> {
        let processor = Avr8js::new(avr, program.chip);
        text(Page::new(processor, &program.firmware, autopilot)).map(Simulation)
    }

    /// Simulated time.
    pub fn now(&mut self) -> f64 {
        self.0.world().now() as f64
    }

    /// Simulates until `until`.
    pub fn advance(&mut self, until: f64) {
        self.0.advance(until as u64);
    }

    /// The state of the world, a JSON object.
    pub fn snapshot(&mut self) -> String {
        self.0.snapshot()
    }

    /// What happened since the last call, a JSON array.
    pub fn take_events(&mut self) -> String {
        self.0.take_events()
    }

    /// The details of a frame, a JSON object.
    ///
    /// # Errors
    /// If the frame is too old.
    pub fn frame(&self, number: f64) -> Result<String, String> {
        text(self.0.frame(number as u64))
    }

    /// Replaces the autopilot: `plain`, `ardupilot`, `ardupilot-pwm`, `px4` or `thesis`.
    ///
    /// # Errors
    /// If there is no autopilot of this name.
    pub fn set_autopilot(&mut self, name: &str) -> Result<(), String> {
        text(self.0.set_autopilot(name))
    }

    /// Begins a fault, or ends it.
    ///
    /// # Errors
    /// If there is no fault of this name.
    pub fn inject(&mut self, name: &str) -> Result<(), String> {
        text(self.0.inject(name))
    }

    /// Holds an actuator at a deflection, -1 to +1.
    pub fn hold(&mut self, actuator: u8, deflection: f64) {
        self.0.world().autopilot.hold_actuator(actuator, deflection);
    }

    /// Lets all actuators sweep.
    pub fn sweep(&mut self) {
        let now = self.0.world().now();
        self.0.world().autopilot.sweep(now);
    }

    /// Turns the autopilot's safety switch on or off.
    pub fn set_safe(&mut self, safe: bool) {
        self.0.world().autopilot.set_safe(safe);
    }

    /// Sets the temperature at the sensor in degrees Celsius.
    pub fn set_temperature(&mut self, celsius: f64) {
        self.0.world().set_temperature_c(celsius);
    }

    /// Commands the brightness of the node's light, 0 to 1.
    pub fn set_light(&mut self, brightness: f64) {
        self.0.set_light(brightness);
    }

    /// Presses or releases the button.
    pub fn press_button(&mut self, pressed: bool) {
        self.0.world().board().press_button(pressed);
    }

    /// Sends text to the serial port.
    pub fn send_serial(&mut self, text: &str) {
        self.0.world().board().avr_mut().serial_send(text.as_bytes());
    }

    /// Reads the node's information and all its parameters.
    pub fn read_parameters(&mut self) {
        self.0.world().client.read_all();
    }

    /// Sets a parameter.
    pub fn set_parameter(&mut self, name: &str, value: f64) {
        self.0.world().client.set(name, value as i64);
    }

    /// Saves the parameters.
    pub fn save_parameters(&mut self) {
        self.0.world().client.execute(Opcode::SAVE);
    }

    /// Erases the saved parameters.
    pub fn erase_parameters(&mut self) {
        self.0.world().client.execute(Opcode::ERASE);
    }

    /// Restarts the node over the bus.
    pub fn restart(&mut self) {
        self.0.world().client.restart();
    }
}

/// An error as a text with its causes.
fn text<T>(result: anyhow::Result<T>) -> Result<T, String> {
    result.map_err(|error| format!("{error:#}"))
}
