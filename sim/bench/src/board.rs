//! The node's board: an Arduino wired to an MCP2515 with its own crystal, a servo, an LM35, a light
//! and a button.
//!
//! [`Wiring`] defines the Arduino, the pins and the crystal. The pins of the default board:
//!
//! | Signal      | Arduino  | chip         | in the model                                       |
//! | ----------- | -------- | ------------ | -------------------------------------------------- |
//! | CS          | D9       | PB1          | with a pull-up: high while the AVR is in reset     |
//! | INT         | D2       | PD2 (INT0)   | follows the chip's pin; high while it has no power |
//! | SPI         | D11..D13 | PB3..PB5     | modes 0 and 3 only; SCK at most 8 MHz, 10 allowed  |
//! | servo       | D10      | PB2 (OC1B)   | pulses measured to the cycle                       |
//! | temperature | A0       | PC0 (ADC0)   | LM35: 10 mV per degree, nothing below 0 °C         |
//! | circuit     | A4, A5   | PC4, PC5     | voltage and current; 0 V until they are set        |
//! | light       | D3       | PD3 (OC2B)   |                                                    |
//! | button      | D4       | PD4          | closes to ground                                   |
//! | shaft       | D3       | PD3 (INT1)   | in place of the light; stands still until it is set |
//! | serial      | D0, D1   | PD0, PD1     | through [`Avr`]                                    |
//!
//! The MCP2515's RESET pin is not wired: a reset of the AVR does not reset the MCP2515. At power-on
//! both chips start at the same time. A real AVR with the Diecimila's fuses starts about 65 ms
//! later, which gives the MCP2515 more time to start.

mod load;
mod wires;

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use anyhow::{Context, Result};

use crate::avr::{Avr, Oc, Pulse, PulseMeter, ResetCause, State};
use crate::corner::Corner;
use crate::lm35 as sensor;
use crate::mcp2515::Mcp2515;
use crate::shaft::Shaft;
use crate::wiring::{Pin, Wiring};
use crate::{Cycles, F_CPU_HZ};
pub use wires::{PinUse, SpiUse, Violation, Wire, WireEvent, WrongWire};
use wires::{SpiEnd, Wires};

/// D3 is the output OC2B of Timer2, which can dim a light.
const OC2B: (char, u8) = ('D', 3);

/// A PWM output without a pulse for this long is off. Usual servo periods are 20 ms or less.
pub const PULSE_TIMEOUT: Cycles = F_CPU_HZ / 10;

/// A board with its two chips and its outputs.
pub struct Board {
    wiring: Wiring,
    avr: Avr,
    /// Output of Timer1 to which the servo is wired.
    servo_output: Oc,
    sensor_channel: u8,
    /// Channels of the ADC for the voltage and the current of the circuit, if the board has them.
    circuit_channels: Option<[u8; 2]>,
    wires: Rc<Wires>,
    servo: PulseMeter,
    servo_pulses: Vec<Pulse>,
    servo_level: bool,
    outputs: Vec<SwitchedOutput>,
    shaft: Shaft,
    corner: Corner,
    /// True if the widths and periods of pulses are counted in cycles of the chip.
    counts_own_cycles: bool,
}

/// A servo on a pin that the program switches in software.
struct SwitchedOutput {
    /// In cycles of the chip.
    edges: Rc<RefCell<Vec<(Cycles, bool)>>>,
    meter: PulseMeter,
    pulses: Vec<Pulse>,
    level: bool,
}

impl SwitchedOutput {
    fn attach(avr: &mut Avr, pin: Pin) -> SwitchedOutput {
        let edges = Rc::new(RefCell::new(Vec::new()));
        let seen = Rc::clone(&edges);
        avr.watch_pin_in_cycles(
            pin.port(),
            pin.bit(),
            Box::new(move |level, at| seen.borrow_mut().push((at, level))),
        );
        SwitchedOutput { edges, meter: PulseMeter::new(), pulses: Vec::new(), level: false }
    }
}

impl Board {
    /// A board with the given AVR and wiring.
    ///
    /// # Errors
    /// If the wiring is impossible.
    pub fn wired(mut avr: Avr, wiring: &Wiring) -> Result<Board> {
        wiring.check()?;
        let servo_output =
            wiring.servo.timer1_output().context("the servo needs an output of Timer1")?;
        let sensor_channel =
            wiring.sensor.adc_channel().context("the sensor needs an input of the ADC")?;
        let channel = |pin: Pin| pin.adc_channel().context("the circuit needs inputs of the ADC");
        let circuit_channels = wiring
            .power
            .map(|pins| anyhow::Ok([channel(pins.voltage)?, channel(pins.current)?]))
            .transpose()?;
        let wiring = Wiring { chip: avr.chip(), ..wiring.clone() };
        let chip = Rc::new(RefCell::new(Mcp2515::new(wiring.crystal_hz())));
        let int = avr.input_pin(wiring.int.port(), wiring.int.bit());
        let wires = Rc::new(Wires::new(chip, int));
        avr.drive_pin(wiring.cs.port(), wiring.cs.bit(), true);
        let cs = Rc::clone(&wires);
        avr.watch_pin(
            wiring.cs.port(),
            wiring.cs.bit(),
            Box::new(move |level, at| cs.chip_select(level, at)),
        );
        let spi = Rc::clone(&wires);
        avr.connect_spi(Box::new(SpiEnd(spi)));
        let outputs =
            wiring.outputs.iter().map(|&pin| SwitchedOutput::attach(&mut avr, pin)).collect();
        let mut board = Board {
            wiring,
            avr,
            servo_output,
            sensor_channel,
            circuit_channels,
            wires,
            servo: PulseMeter::new(),
            servo_pulses: Vec::new(),
            servo_level: false,
            outputs,
            shaft: Shaft::default(),
            corner: Corner::default(),
            counts_own_cycles: false,
        };
        board.set_temperature_c(20.0);
        board.set_circuit_millivolts(0, 0);
        Ok(board)
    }

    /// The wiring of the board.
    pub fn wiring(&self) -> &Wiring {
        &self.wiring
    }

    /// True if the level of a pin is high.
    pub fn pin(&self, pin: Pin) -> bool {
        self.avr.pin(pin.port(), pin.bit())
    }

    /// The microcontroller.
    pub fn avr(&self) -> &Avr {
        &self.avr
    }

    /// The microcontroller, to drive its pins and serial port.
    pub fn avr_mut(&mut self) -> &mut Avr {
        &mut self.avr
    }

    /// The MCP2515. It must not be borrowed while the board runs.
    pub fn chip(&self) -> Rc<RefCell<Mcp2515>> {
        Rc::clone(&self.wires.chip)
    }

    /// Simulated time of the AVR.
    pub fn now(&self) -> Cycles {
        self.avr.now()
    }

    /// Runs the firmware until `t`.
    pub fn run_until(&mut self, t: Cycles) -> State {
        while let Some(at) = self.shaft.next_edge().filter(|&at| at < t) {
            self.avr.run_until(at);
            if self.avr.is_halted() {
                break;
            }
            let level = self.shaft.pass_edge();
            if let Some(pin) = self.wiring.rpm {
                self.avr.drive_pin(pin.port(), pin.bit(), level);
            }
        }
        self.avr.run_until(t)
    }

    /// Gives the chips the values of a corner, before the board runs. A new board has the typical
    /// ones.
    ///
    /// # Panics
    /// If the board has run already, and has other values.
    pub fn set_corner(&mut self, corner: &Corner) {
        if *corner == self.corner {
            return;
        }
        self.corner = *corner;
        self.avr.set_silicon(corner.silicon());
        let (ppm, settling) = corner.can_oscillator();
        self.wires.chip.borrow_mut().set_oscillator(ppm, settling);
    }

    /// The values of the chips.
    pub fn corner(&self) -> Corner {
        self.corner
    }

    /// Counts the widths and the periods of the pulses from now on in cycles of the chip: for a
    /// test that expects them without the deviation of its clock.
    pub fn count_own_cycles(&mut self) {
        self.counts_own_cycles = true;
    }

    /// Copies the level of the MCP2515's INT to the AVR's pin. The bench calls it after each step
    /// of the bus.
    pub fn update_int(&self) {
        self.wires.update_int(self.now());
    }

    /// Resets the AVR. A power-on resets the MCP2515, too.
    pub fn reset(&mut self, cause: ResetCause) {
        // First, so that an instruction which the power cut ended is not taken for a mistake.
        if cause == ResetCause::PowerOn && self.wires.has_power() {
            self.disturb_chip(Mcp2515::power_up);
        }
        if cause == ResetCause::BrownOut && self.corner.browns_out_late() && self.wires.has_power()
        {
            self.chip_brown_out(self.avr.now());
        }
        self.avr.reset(cause);
    }

    /// Pulses the MCP2515's RESET pin. The firmware does not notice it.
    pub fn chip_reset(&mut self) {
        self.disturb_chip(Mcp2515::hardware_reset);
    }

    /// Dips the MCP2515's supply: it goes on with random values in its registers.
    pub fn chip_brown_out(&mut self, seed: u64) {
        self.disturb_chip(|chip, at| chip.brown_out(seed, at));
    }

    /// Flips bits of a register of the MCP2515.
    pub fn chip_flip_bits(&mut self, address: u8, mask: u8) {
        self.disturb_chip(|chip, at| chip.flip_bits(address, mask, at));
    }

    /// Puts the MCP2515 into sleep mode.
    pub fn chip_fall_asleep(&mut self) {
        self.disturb_chip(Mcp2515::fall_asleep);
    }

    /// Keeps the MCP2515 in configuration mode while `held` is true.
    pub fn chip_hold_in_configuration(&mut self, held: bool) {
        self.disturb_chip(|chip, _| chip.hold_in_configuration(held));
    }

    fn disturb_chip(&mut self, change: impl FnOnce(&mut Mcp2515, Cycles)) {
        change(&mut self.wires.chip.borrow_mut(), self.avr.now());
        self.update_int();
    }

    /// Removes the MCP2515's power: it sends nothing, INT is high, and MISO reads `miso` (0x00 or
    /// 0xFF).
    pub fn chip_power_off(&mut self, miso: u8) {
        self.chip_reset();
        self.wires.dead_miso.set(Some(miso));
        self.update_int();
    }

    /// Restores the MCP2515's power.
    pub fn chip_power_on(&mut self) {
        self.wires.dead_miso.set(None);
        self.disturb_chip(Mcp2515::power_up);
        if self.wires.selected.get() {
            self.wires.chip.borrow_mut().select(self.avr.now());
        }
    }

    /// Shorts MISO, so that the AVR reads this byte (0x00 or 0xFF) instead of the answer; `None`
    /// ends the short.
    pub fn set_stuck_miso(&mut self, miso: Option<u8>) {
        self.wires.stuck_miso.set(miso);
    }

    /// Shorts the AVR's INT pin to this level; `None` ends the short.
    pub fn set_stuck_int(&mut self, level: Option<bool>) {
        self.wires.stuck_int.set(level);
        self.update_int();
    }

    /// Makes a wire to the MCP2515 wrong; `None` ends that. The processor reads `undriven` (0x00 or
    /// 0xFF) from SO while nothing drives it.
    pub fn set_wrong_wire(&mut self, wrong: Option<WrongWire>, undriven: u8) {
        let at = self.now();
        self.wires.wrong.set(wrong.map(|wrong| (wrong, undriven)));
        self.wires.select(!self.wires.selected.get(), at);
        self.update_int();
    }

    /// Flips each bit on MOSI and on MISO with this probability; 0 ends the noise. Equal seeds give
    /// equal noise.
    pub fn set_spi_noise(&mut self, per_million: u32, seed: u64) {
        self.wires.set_noise(per_million, seed);
    }

    /// Sets the temperature at the sensor in degrees Celsius.
    pub fn set_temperature_c(&mut self, celsius: f64) {
        self.avr.set_analog_uv(self.sensor_channel, sensor::microvolts(celsius));
    }

    /// Sets the voltage at the sensor's pin, for a broken sensor or one of another type.
    pub fn set_sensor_millivolts(&mut self, millivolts: u32) {
        self.avr.set_analog_uv(self.sensor_channel, millivolts * 1000);
    }

    /// Sets the voltages at the ADC inputs for the voltage and the current of the circuit, in
    /// millivolts, if the board has these inputs. The model has no voltage divider and no
    /// current sensor.
    pub fn set_circuit_millivolts(&mut self, voltage: u32, current: u32) {
        let Some(channels) = self.circuit_channels else { return };
        for (channel, millivolts) in channels.into_iter().zip([voltage, current]) {
            self.avr.set_analog_uv(channel, millivolts * 1000);
        }
    }

    /// Adds noise of up to plus or minus `amplitude` millivolts at the sensor's pin; 0 ends the
    /// noise. Equal seeds give equal noise.
    pub fn set_sensor_noise_millivolts(&mut self, amplitude: u32, seed: u64) {
        self.avr.set_analog_noise_uv(amplitude * 1000, seed);
    }

    /// Sets the speed of the shaft in revolutions a minute. Has no effect on a board whose program
    /// counts no pulses.
    pub fn set_shaft_rpm(&mut self, rpm: u32) {
        // A period of 0 stops it.
        let period = (60 * F_CPU_HZ).checked_div(rpm.into()).unwrap_or(0);
        self.shaft.set_period(period, self.avr.now());
    }

    /// Presses or releases the button, if the board has one.
    pub fn press_button(&mut self, pressed: bool) {
        let Some(pin) = self.wiring.button else { return };
        if pressed {
            self.avr.drive_pin(pin.port(), pin.bit(), false);
        } else {
            self.avr.release_pin(pin.port(), pin.bit());
        }
    }

    /// Removes and returns the servo pulses that ended since the last call.
    pub fn take_servo_pulses(&mut self) -> Vec<Pulse> {
        self.collect_servo_edges();
        std::mem::take(&mut self.servo_pulses)
    }

    /// Removes and returns, for output 2 and each further output, the pulses that ended since the
    /// last call.
    pub fn take_output_pulses(&mut self) -> Vec<Vec<Pulse>> {
        self.collect_output_edges();
        self.outputs.iter_mut().map(|output| std::mem::take(&mut output.pulses)).collect()
    }

    /// Attaches a probe to the wires. Returns their present levels as events.
    pub fn attach_probe(&mut self) -> Vec<(Cycles, WireEvent)> {
        self.collect_servo_edges();
        self.collect_output_edges();
        self.avr.serial_trace();
        self.wires.probe.replace(Some(Vec::new()));
        let outputs = self.outputs.iter().enumerate();
        let outputs =
            outputs.map(|(index, output)| WireEvent::Output { index, high: output.level });
        let levels = [
            WireEvent::Cs(!self.wires.selected.get()),
            WireEvent::Int(self.wires.int_level.get()),
            WireEvent::Servo(self.servo_level),
        ];
        levels.into_iter().chain(outputs).map(|level| (self.now(), level)).collect()
    }

    /// Removes and returns the events of the probe since the last call, in order of time for each
    /// wire, one wire after the other. A byte on the SPI is an event at its end, so its start
    /// can be up to 1024 cycles before the last call.
    pub fn take_wire_events(&mut self) -> Vec<(Cycles, WireEvent)> {
        self.collect_servo_edges();
        self.collect_output_edges();
        let serial = self.avr.serial_trace();
        let mut events =
            self.wires.probe.borrow_mut().as_mut().map(std::mem::take).unwrap_or_default();
        events.extend(
            serial.into_iter().map(|character| (character.start, WireEvent::Serial(character))),
        );
        events
    }

    fn collect_servo_edges(&mut self) {
        let edges = self.avr.take_edges_in_cycles(self.servo_output);
        for &(at, level) in &edges {
            self.servo_level = level;
            self.wires.record(self.avr.time_of(at), WireEvent::Servo(level));
        }
        let pulses = self.servo.feed(edges).into_iter();
        let (avr, is_own) = (&self.avr, self.counts_own_cycles);
        self.servo_pulses.extend(pulses.map(|pulse| measured(avr, is_own, pulse)));
    }

    fn collect_output_edges(&mut self) {
        for (index, output) in self.outputs.iter_mut().enumerate() {
            let edges = output.edges.take();
            for &(at, high) in &edges {
                output.level = high;
                self.wires.record(self.avr.time_of(at), WireEvent::Output { index, high });
            }
            let pulses = output.meter.feed(edges).into_iter();
            let (avr, is_own) = (&self.avr, self.counts_own_cycles);
            output.pulses.extend(pulses.map(|pulse| measured(avr, is_own, pulse)));
        }
    }

    /// Brightness of the light, 0 to 1; 0 if the board has no light.
    pub fn light(&self) -> f64 {
        let Some(pin) = self.wiring.light else { return 0.0 };
        let duty = self.avr.oc2b_duty().filter(|_| (pin.port(), pin.bit()) == OC2B);
        duty.unwrap_or(if self.pin(pin) { 1.0 } else { 0.0 })
    }

    /// Counts from now on how the program uses a pin together with the SPI: with the bytes that are
    /// not for the MCP2515, or the pulses of a servo between two frames would look like a select.
    pub fn watch_use(&mut self, pin: Pin) -> Rc<Cell<PinUse>> {
        let used = Rc::new(Cell::new(PinUse::default()));
        let (seen, wires) = (Rc::clone(&used), Rc::clone(&self.wires));
        let watcher = move |level, _| {
            let mut now = seen.get();
            now.edge(level, wires.spi_use.get().bytes_elsewhere);
            seen.set(now);
        };
        self.avr.watch_pin(pin.port(), pin.bit(), Box::new(watcher));
        used
    }

    /// Counters of the SPI since power-on.
    pub fn spi_use(&self) -> SpiUse {
        self.wires.spi_use.get()
    }

    /// Removes and returns the firmware's mistakes since the last call, in order of time.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        let mut all = self.wires.violations.take();
        let avr = self.avr.take_violations().into_iter();
        all.extend(avr.map(|violation| Violation {
            at: violation.at,
            source: "AVR",
            text: violation.text,
        }));
        let chip = self.wires.chip.borrow_mut().take_violations().into_iter();
        all.extend(chip.map(|violation| Violation {
            at: violation.at,
            source: "MCP2515",
            text: violation.text,
        }));
        all.sort_by_key(|violation| violation.at);
        all
    }
}

/// A pulse in cycles of a chip, as it is measured outside.
fn measured(avr: &Avr, counts_own_cycles: bool, pulse: Pulse) -> Pulse {
    let start = avr.time_of(pulse.start);
    if counts_own_cycles {
        return Pulse { start, ..pulse };
    }
    let end = avr.time_of(pulse.start + pulse.width_cycles);
    let earlier = pulse.period_cycles.map(|period| avr.time_of(pulse.start - period));
    let period_cycles = earlier.map(|earlier| start - earlier);
    Pulse { start, width_cycles: end - start, period_cycles }
}
