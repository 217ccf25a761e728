//! What JavaScript calls.

use std::collections::HashMap;
use std::time::Duration;

use anyhow::{Error, Result as AnyResult, bail};
use bench::avr::{Avr, Chip, Firmware, ResetCause};
use bench::boards;
use bench::bus_log::Format;
use bench::corner::Corner;
use bench::dronecan::{NodeId, Opcode, Value};
use bench::wires;
use bench::wiring::{BIT_RATES, Wiring, crystal_mhz};
use serde_json::json;
use wasm_bindgen::prelude::*;

use crate::bus;
use crate::page::{self, Page};
use crate::program_file;
use crate::scenario::{self, Traffic};
use crate::stk500::{Failure, Flash, Phase, Session};

/// A program from an ELF or Intel HEX file, and its board.
#[wasm_bindgen]
pub struct Program {
    firmware: Firmware,
    wiring: Wiring,
    bit_rate: u32,
    names_chip: bool,
}

/// Crystals of CAN boards, in MHz.
const CRYSTALS: [u32; 2] = [8, 16];

/// What can be chosen for the board of a program, with titles, a JSON object.
#[wasm_bindgen]
pub fn choices() -> String {
    let named = |kind: &str| -> Vec<[String; 2]> {
        boards::names(kind)
            .map(|name| [name, boards::text(boards::entry(kind, name), "title")].map(String::from))
            .collect()
    };
    let pins = |digital: std::ops::RangeInclusive<u8>| -> Vec<[String; 2]> {
        digital.map(|pin| [format!("D{pin}"), format!("D{pin}")]).collect()
    };
    let mut selects = pins(2..=10);
    selects.extend((0..=5).map(|pin| [format!("A{pin}"), format!("A{pin}")]));
    let crystals = CRYSTALS.map(|mhz| [mhz.to_string(), format!("{mhz} MHz")]);
    let rates = BIT_RATES.map(|rate| [rate.to_string(), format!("{} kbit/s", rate / 1000)]);
    json!({
        "mcu": named("chips"),
        "board": named("boards"),
        "shield": named("shields"),
        "cs": selects,
        "int": pins(2..=10),
        "crystal": crystals,
        "bit_rate": rates,
    })
    .to_string()
}

/// Reads the choices of a user, a JSON object of texts with keys of [`choices`]: the wiring, and
/// the bit rate.
fn chosen(options: &str) -> AnyResult<(wires::Args, Option<u32>)> {
    let options: HashMap<String, String> = serde_json::from_str(options)?;
    let (mut args, mut bit_rate) = (wires::Args::default(), None);
    for (name, value) in options {
        match name.as_str() {
            "mcu" => args.mcu = Some(value.parse().map_err(Error::msg)?),
            "board" => args.board = Some(value),
            "shield" => args.shield = Some(value),
            "cs" => args.cs = Some(value.parse().map_err(Error::msg)?),
            "int" => args.int = Some(value.parse().map_err(Error::msg)?),
            "crystal" => args.crystal = Some(crystal_mhz(&value).map_err(Error::msg)?),
            "bit_rate" => bit_rate = Some(value.parse()?),
            _ => bail!("nobody can choose \"{name}\""),
        }
    }
    Ok((args, bit_rate))
}

/// Reads an ELF or Intel HEX file.
fn firmware(bytes: &[u8]) -> AnyResult<Firmware> {
    match std::str::from_utf8(bytes) {
        Ok(text) if text.starts_with(':') => Firmware::parse_hex(text),
        _ => Firmware::parse(bytes),
    }
}

#[wasm_bindgen]
impl Program {
    /// Reads a file. `options` is a JSON object with what the user has chosen of [`choices`].
    ///
    /// # Errors
    /// If the file is not a program for the chip, or the wiring is impossible; the text says why.
    pub fn parse(bytes: &[u8], options: &str) -> Result<Program, String> {
        text(Program::read(bytes, options))
    }

    fn read(bytes: &[u8], options: &str) -> AnyResult<Program> {
        let firmware = firmware(bytes)?;
        let (args, bit_rate) = chosen(options)?;
        let wiring = args.apply(Wiring::of_program(&firmware)?)?;
        let bit_rate = bit_rate.unwrap_or(wiring.fastest_bit_rate());
        wiring.check_bit_rate(bit_rate)?;
        let names_chip = firmware.chip()?.is_some() || args.mcu.is_some() || args.board.is_some();
        firmware.check_fits(wiring.chip)?;
        Ok(Program { firmware, wiring, bit_rate, names_chip })
    }

    /// False if neither the file nor the user says for which chip the program is.
    pub fn names_chip(&self) -> bool {
        self.names_chip
    }

    fn chip(&self) -> Chip {
        self.wiring.chip
    }

    /// The EEPROM as the file fills it, else erased.
    pub fn eeprom(&self) -> Vec<u8> {
        let mut eeprom = vec![0xFF; self.chip().eeprom_bytes()];
        for (address, bytes) in &self.firmware.eeprom {
            eeprom[*address..address + bytes.len()].copy_from_slice(bytes);
        }
        eeprom
    }
}

/// Runs a scenario of the cross-check, and returns the trace.
///
/// # Errors
/// If the traffic has another name than those of [`Traffic::named`], or the wiring in the program
/// is impossible.
#[wasm_bindgen]
pub fn cross_check(
    program: &Program,
    traffic: &str,
    seconds: u32,
    seed: u32,
) -> Result<String, String> {
    let traffic = Traffic::named(traffic).ok_or("no such traffic")?;
    let Program { firmware, wiring, .. } = program;
    let avr = text(Avr::programmed(wiring.chip, firmware))?;
    text(scenario::run(avr, firmware, traffic, seconds.into(), seed.into()))
}

/// All faults, a JSON array.
#[wasm_bindgen]
pub fn faults() -> String {
    page::faults()
}

/// Names and values of the parameters of a quadcopter's motors, a JSON array.
#[wasm_bindgen]
pub fn four_motors() -> String {
    page::four_motors()
}

/// A world for the page. Times are CPU cycles of 16 MHz.
#[wasm_bindgen]
pub struct Simulation(Page);

#[wasm_bindgen]
impl Simulation {
    /// A board with a program, a bootloader if that file is not empty, this EEPROM, and chips with
    /// the values of a corner: `typical`, `slow`, `fast`, `worst` or `random:SEED`; and an
    /// autopilot.
    ///
    /// # Errors
    /// If the wiring in the program is impossible, or there is no such autopilot or corner.
    #[wasm_bindgen(constructor)]
    pub fn new(
        program: &Program,
        loader: &[u8],
        eeprom: &[u8],
        autopilot: &str,
        corner: &str,
    ) -> Result<Simulation, String> {
        text(Simulation::begin(program, loader, eeprom, autopilot, corner))
    }

    fn begin(
        program: &Program,
        loader: &[u8],
        eeprom: &[u8],
        autopilot: &str,
        corner: &str,
    ) -> AnyResult<Simulation> {
        let corner: Corner = corner.parse().map_err(Error::msg)?;
        let Program { firmware: ours, wiring, bit_rate, .. } = program;
        let mut avr = Avr::programmed(wiring.chip, ours)?;
        if !loader.is_empty() {
            avr.install_bootloader(&firmware(loader)?)?;
            avr.reset(ResetCause::PowerOn);
        }
        avr.set_eeprom(eeprom);
        let knows_vendor_code = ours.board.is_some();
        let mut page = Page::new(avr, wiring, *bit_rate, knows_vendor_code, autopilot)?;
        page.world().board().set_corner(&corner);
        Ok(Simulation(page))
    }

    /// Adds a second board with a program, whose outputs are four motors.
    ///
    /// # Errors
    /// If the program has no motors, or its bus another bit rate.
    pub fn add_second(&mut self, program: &Program) -> Result<(), String> {
        text(self.0.add_second(&program.firmware, &program.wiring))
    }

    /// The EEPROM of the board.
    pub fn eeprom(&mut self) -> Vec<u8> {
        self.0.world().board().avr().eeprom()
    }

    /// Simulated time.
    pub fn now(&mut self) -> f64 {
        self.0.world().now() as f64
    }

    /// Frames on the bus since the start.
    pub fn frames(&mut self) -> f64 {
        self.0.world().bench.bus().stats().frames as f64
    }

    /// Simulates until `until`.
    pub fn advance(&mut self, until: f64) {
        self.0.advance(until as u64);
    }

    /// Gives bytes to an SLCAN adapter on the simulated bus.
    pub fn write_adapter(&mut self, bytes: &[u8]) {
        self.0.world().adapter().input.extend(bytes);
    }

    /// Removes and returns the bytes of that adapter.
    pub fn read_adapter(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0.world().adapter().output)
    }

    /// The bits per second of the simulated bus.
    pub fn bit_rate(&mut self) -> u32 {
        self.0.world().bench.bus().bit_rate()
    }

    /// The state of the world, a JSON object.
    pub fn snapshot(&mut self) -> String {
        self.0.snapshot()
    }

    /// What is wired to what, a JSON object.
    pub fn wiring(&mut self) -> String {
        self.0.wiring()
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

    /// Plays a script of `sim`, or a recording of a bus. Returns in words what it has.
    ///
    /// # Errors
    /// If a line is invalid: its number, and the reason.
    pub fn play(&mut self, script: &[u8]) -> Result<String, String> {
        text(self.0.play(script))
    }

    /// The bus since power-on, as candump text.
    pub fn candump(&self) -> Vec<u8> {
        self.0.bus_log(Format::Candump)
    }

    /// The bus since power-on, as pcap.
    pub fn pcap(&self) -> Vec<u8> {
        self.0.bus_log(Format::Pcap)
    }

    /// Begins to record the wires of the board and the bus.
    pub fn record_wires(&mut self) {
        self.0.world().record_wires();
    }

    /// Ends the recording. Returns the VCD file.
    pub fn take_wires(&mut self) -> Vec<u8> {
        self.0.world().take_wires()
    }

    /// Holds an actuator at a deflection, -1 to +1.
    pub fn hold(&mut self, actuator: u8, deflection: f64) {
        self.0.world().autopilot.hold_actuator(actuator, deflection);
    }

    /// Holds a motor at a power, 0 to 1.
    pub fn hold_motor(&mut self, index: u8, power: f64) {
        self.0.world().autopilot.hold_motor(index, power);
    }

    /// Lets all actuators and motors sweep.
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
        self.0.world().client.dialogue.read_all();
    }

    /// Sets a parameter that was read to what the user wrote.
    ///
    /// # Errors
    /// If that is no value of the parameter.
    pub fn write_parameter(&mut self, name: &str, text: &str) -> Result<(), String> {
        self.0.world().client.dialogue.set_written(name, text)
    }

    /// Sets a parameter that has whole numbers.
    pub fn set_parameter(&mut self, name: &str, value: f64) {
        self.0.world().client.dialogue.set(name, Value::Integer(value as i64));
    }

    /// Sets the parameters that differ in a file.
    ///
    /// # Errors
    /// If the file has no parameters, or the node has not answered yet.
    pub fn load_parameters(&mut self, file: &str) -> Result<(), String> {
        self.0.world().client.dialogue.load(file, Vec::new())
    }

    /// A file with the parameters that were read.
    pub fn parameter_file(&mut self) -> String {
        self.0.world().client.dialogue.file("Parameters of the simulated node")
    }

    /// Saves the parameters.
    pub fn save_parameters(&mut self) {
        self.0.world().client.dialogue.execute(Opcode::SAVE);
    }

    /// Erases the saved parameters.
    pub fn erase_parameters(&mut self) {
        self.0.world().client.dialogue.execute(Opcode::ERASE);
    }

    /// Restarts the node over the bus.
    pub fn restart(&mut self) {
        self.0.world().client.dialogue.restart();
    }
}

/// A real bus on an SLCAN adapter. Times are milliseconds since its connection.
#[wasm_bindgen]
#[derive(Default)]
pub struct RealBus(bus::RealBus);

#[wasm_bindgen]
impl RealBus {
    /// No bus.
    #[wasm_bindgen(constructor)]
    pub fn new() -> RealBus {
        RealBus::default()
    }

    /// Forgets the bus before, and begins to open the adapter on its port.
    pub fn connect(&mut self, bit_rate: u32) {
        self.0.connect(bit_rate, Duration::ZERO);
    }

    /// True from `connect` until the session ends.
    pub fn is_connected(&self) -> bool {
        self.0.is_connected()
    }

    /// Handles bytes of the port.
    pub fn receive(&mut self, bytes: &[u8], now: f64) {
        self.0.receive(bytes, time(now));
    }

    /// Does what is due.
    pub fn poll(&mut self, now: f64) {
        self.0.poll(time(now));
    }

    /// Removes and returns bytes for the port.
    pub fn take_output(&mut self) -> Vec<u8> {
        self.0.take_output()
    }

    /// Ends the session. Returns the bytes that close the adapter's channel.
    pub fn disconnect(&mut self) -> Vec<u8> {
        self.0.disconnect()
    }

    /// Ends the session, because the port does not work.
    pub fn close(&mut self, why: &str) {
        self.0.close(why);
    }

    /// The state of the bus, a JSON object.
    pub fn snapshot(&self, now: f64) -> String {
        self.0.snapshot(time(now)).to_string()
    }

    /// The frames since the last call, a JSON array.
    pub fn take_events(&mut self) -> String {
        self.0.take_events().to_string()
    }

    /// The details of a frame, a JSON object.
    ///
    /// # Errors
    /// If the frame is too old.
    pub fn frame(&self, number: f64) -> Result<String, String> {
        text(self.0.frame(number as u64).map(|details| details.to_string()))
    }

    /// The log of the bus as candump text.
    pub fn candump(&self) -> Vec<u8> {
        self.0.log(Format::Candump)
    }

    /// The log of the bus as pcap.
    pub fn pcap(&self) -> Vec<u8> {
        self.0.log(Format::Pcap)
    }

    /// Opens an adapter that cannot listen only.
    pub fn allow_sending(&mut self, now: f64) {
        self.0.allow_sending(time(now));
    }

    /// Asks the nodes for their names.
    pub fn ask_names(&mut self) {
        self.0.ask_names();
    }

    /// Chooses the node whose parameters are shown.
    pub fn choose(&mut self, node: u8) {
        if let Some(node) = NodeId::new(node) {
            self.0.choose(node);
        }
    }

    /// Reads all parameters of the chosen node.
    pub fn read_parameters(&mut self) {
        self.0.read_parameters();
    }

    /// Sets a parameter of the chosen node.
    ///
    /// # Errors
    /// If the text is no value of the parameter.
    pub fn write_parameter(&mut self, name: &str, text: &str) -> Result<(), String> {
        self.0.set_parameter(name, text)
    }

    /// Sets the parameters of the chosen node that differ in a file.
    ///
    /// # Errors
    /// If the file has no parameters, or the node has not answered yet.
    pub fn load_parameters(&mut self, file: &str) -> Result<(), String> {
        self.0.load_parameters(file)
    }

    /// A file with the parameters of the chosen node that were read.
    pub fn parameter_file(&self) -> String {
        self.0.parameter_file()
    }

    /// Saves the parameters of the chosen node.
    pub fn save_parameters(&mut self) {
        self.0.save_parameters();
    }

    /// Erases the saved parameters of the chosen node.
    pub fn erase_parameters(&mut self) {
        self.0.erase_parameters();
    }

    /// Restarts the chosen node.
    pub fn restart(&mut self) {
        self.0.restart();
    }

    /// Updates a node with a file.
    ///
    /// # Errors
    /// If the file is not a firmware, or the node is in an update.
    pub fn update(&mut self, node: u8, file: &[u8], now: f64) -> Result<(), String> {
        let node = NodeId::new(node).ok_or("no node is chosen")?;
        self.0.update(node, file.to_vec(), time(now))
    }

    /// True if a file is a firmware for the hardware of a node, as far as the node has told it.
    pub fn suits(&self, node: u8, file: &[u8]) -> bool {
        NodeId::new(node).is_some_and(|node| self.0.suits(node, file.to_vec()))
    }

    /// Stops the update of a node.
    pub fn stop_update(&mut self, node: u8, now: f64) {
        if let Some(node) = NodeId::new(node) {
            self.0.stop_update(node, time(now));
        }
    }

    /// Begins to check a node. `left` is what earlier checks of it have not put back.
    pub fn begin_check(&mut self, node: u8, left: &str, now: f64) {
        if let Some(node) = NodeId::new(node) {
            self.0.begin_check(node, left, time(now));
        }
    }

    /// Answers the question of the checks: "yes", "no" or "skip".
    pub fn answer_check(&mut self, answer: &str) {
        if let Some(check) = self.0.check() {
            check.answer(answer);
        }
    }

    /// Ends the checks, and puts back what they have changed.
    pub fn stop_check(&mut self) {
        if let Some(check) = self.0.check() {
            check.stop();
        }
    }

    /// The report of the checks as Markdown.
    pub fn check_report(&self) -> String {
        self.0.check_report()
    }
}

fn time(milliseconds: f64) -> Duration {
    Duration::try_from_secs_f64(milliseconds / 1000.0).unwrap_or_default()
}

/// Reads a file with a program for a real board: its bytes from address 0.
///
/// # Errors
/// If the file is no program, or not one for this board with this CAN board; the text says why.
#[wasm_bindgen]
pub fn read_program(file: &[u8], board: &str, shield: &str) -> Result<Vec<u8>, String> {
    text(program_file::read(file, board, shield))
}

/// A session with the bootloader of a real board. Times are milliseconds.
#[wasm_bindgen]
pub struct Upload(Session);

#[wasm_bindgen]
impl Upload {
    /// Begins to upload what [`read_program`] has read to a board that was reset now.
    ///
    /// # Errors
    /// If there is no such chip.
    #[wasm_bindgen(constructor)]
    pub fn new(chip: &str, program: &[u8], now: f64) -> Result<Upload, String> {
        let chip = chip.parse()?;
        Ok(Upload(Session::upload(chip, program, now as u64)))
    }

    /// Asks a board that was reset now for its chip.
    pub fn identify(now: f64) -> Upload {
        Upload(Session::identify(now as u64))
    }

    /// Bytes to send now.
    pub fn take_output(&mut self) -> Vec<u8> {
        self.0.take_output()
    }

    /// Time until the next call of `receive` at the latest.
    pub fn wait_ms(&self, now: f64) -> f64 {
        self.0.wait_ms(now as u64) as f64
    }

    /// Takes bytes that have arrived, or none.
    pub fn receive(&mut self, bytes: &[u8], now: f64) {
        self.0.receive(bytes, now as u64);
    }

    /// Ends the session as soon as the present command is answered.
    pub fn cancel(&mut self, now: f64) {
        self.0.cancel(now as u64);
    }

    /// How far the session is, a JSON object.
    pub fn state(&self) -> String {
        let (done, all) = self.0.progress();
        json!({
            "phase": match self.0.phase() {
                Phase::Connecting => "connecting",
                Phase::Writing => "writing",
                Phase::Comparing => "comparing",
                Phase::Ended => "ended",
            },
            "done": done,
            "all": all,
            "failure": self.0.failure().map(ToString::to_string),
            "is_silent": matches!(
                self.0.failure(),
                Some(Failure::Silence | Failure::NoBootloader)
            ),
            "is_cancelled": self.0.failure() == Some(&Failure::Cancelled),
            "is_new": self.0.flash() == Flash::New,
            "flash": self.0.flash().to_string(),
            "chip": self.0.chip_found().map(|chip| chip.name()),
        })
        .to_string()
    }
}

/// An error as a text with its causes.
fn text<T>(result: anyhow::Result<T>) -> Result<T, String> {
    result.map_err(|error| format!("{error:#}"))
}
