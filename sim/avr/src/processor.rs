//! [`Avr`] as the processor of a board.

use super::Avr;
use avr_chip::{
    Chip, Oc, PinDriver, PinWatcher, Processor, ResetCause, SerialCharacter, SpiDevice, State,
    Violation,
};
use sim_base::Cycles;

impl Processor for Avr {
    fn chip(&self) -> Chip {
        Avr::chip(self)
    }

    fn now(&self) -> Cycles {
        Avr::now(self)
    }

    fn run_until(&mut self, t: Cycles) -> State {
        Avr::run_until(self, t)
    }

    fn is_halted(&self) -> bool {
        Avr::is_halted(self)
    }

    fn state(&self) -> State {
        Avr::state(self)
    }

    fn reset(&mut self, cause: ResetCause) {
        Avr::reset(self, cause);
    }

    fn pin(&self, port: char, bit: u8) -> bool {
        Avr::pin(self, port, bit)
    }

    fn watch_pin(&mut self, port: char, bit: u8, watcher: PinWatcher) {
        Avr::watch_pin(self, port, bit, watcher);
    }

    fn drive_pin(&mut self, port: char, bit: u8, level: bool) {
        Avr::drive_pin(self, port, bit, level);
    }

    fn release_pin(&mut self, port: char, bit: u8) {
        Avr::release_pin(self, port, bit);
    }

    fn pin_driver(&self, port: char, bit: u8) -> PinDriver {
        let pin = self.input_pin(port, bit);
        Box::new(move |level| pin.drive(level))
    }

    fn connect_spi(&mut self, device: Box<dyn SpiDevice>) {
        Avr::connect_spi(self, device);
    }

    fn serial_send(&mut self, bytes: &[u8]) {
        Avr::serial_send(self, bytes);
    }

    fn serial_trace(&mut self) -> Vec<SerialCharacter> {
        Avr::serial_trace(self)
    }

    fn set_analog_uv(&mut self, channel: u8, microvolts: u32) {
        Avr::set_analog_uv(self, channel, microvolts);
    }

    fn set_analog_noise_uv(&mut self, amplitude_uv: u32, seed: u64) {
        Avr::set_analog_noise_uv(self, amplitude_uv, seed);
    }

    fn take_edges(&mut self, oc: Oc) -> Vec<(Cycles, bool)> {
        Avr::take_edges(self, oc)
    }

    fn oc2b_duty(&self) -> Option<f64> {
        Avr::oc2b_duty(self)
    }

    fn eeprom(&self) -> Vec<u8> {
        Avr::eeprom(self)
    }

    fn take_violations(&mut self) -> Vec<Violation> {
        Avr::take_violations(self)
    }
}
