//! The command line of `sim`.

use super::pace::Speed;
use super::report::{Finding, Judgement};
use crate::fault::Injection;
use crate::links::{self, script::millivolts, script::rpm};
use crate::time::{parse_duration, seconds};
use crate::usage::within;
use crate::utilisation;
use anyhow::{Result, bail, ensure};
use bench::autopilot::{CommandType, Moves, Only, Profile, Settings};
use bench::avr::Engine;
use bench::dronecan::{Dialect, NodeId};
use bench::i2c;
use bench::pins::Setting;
use bench::wires;
use bench::wiring::{BIT_RATES, Pin, Wiring};
use bench::{Cycles, F_CPU_HZ};
use clap::Parser;
use std::path::PathBuf;

/// What executes the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Processor {
    /// The core of this project
    Own,
    /// simavr, an independent simulator; in builds with the feature "simavr" only
    Simavr,
}

impl From<Processor> for Engine {
    fn from(processor: Processor) -> Engine {
        match processor {
            Processor::Own => Engine::Own,
            Processor::Simavr => Engine::Simavr,
        }
    }
}

/// Options of `sim`.
#[derive(Clone, Debug, Parser)]
#[command(args_conflicts_with_subcommands = true)]
#[command(name = "sim", version, about = "The node on a simulated bench", max_term_width = 120)]
pub struct Args {
    /// Another task than the bench
    #[command(subcommand)]
    pub command: Option<Command>,

    /// Not there: a program without its option.
    #[arg(hide = true, value_parser = without_option)]
    pub program: Option<PathBuf>,

    /// Firmware to boot, an ELF file for an ATmega168 or ATmega328P [default: the one that "make
    /// firmware" has built]
    #[arg(long, value_name = "PATH")]
    pub elf: Option<PathBuf>,

    /// What executes the firmware
    #[arg(long, value_name = "ENGINE", value_enum, default_value_t = Processor::Own)]
    pub processor: Processor,

    /// End after this simulated time: 500ms, 5s, 2m, 1h [default: run until the user quits]
    #[arg(
        long = "for",
        value_name = "TIME",
        value_parser = parse_duration,
        allow_hyphen_values = true,
    )]
    pub duration: Option<Cycles>,

    /// Simulated seconds for each real second, such as 0.1; max: as fast as this computer can
    #[arg(long, value_name = "FACTOR", default_value = "1", allow_hyphen_values = true)]
    pub speed: Speed,

    /// Bits per second on the bus; a node with another rate gets only errors [default: 500000 if
    /// the crystal of the MCP2515 has 8 MHz, else 1000000]
    #[arg(long, value_name = "BIT/S", value_parser = bit_rate, allow_hyphen_values = true)]
    pub bit_rate: Option<u32>,

    /// Print one line for each event, even on a terminal
    #[arg(long)]
    pub plain: bool,

    /// Write the result of the run to FILE at its end: pulses, frames, losses, mistakes, restarts,
    /// memory
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,

    /// Fail, with the exit code 1, also if anything else was wrong with the program, except what
    /// --allow names
    #[arg(long)]
    pub strict: bool,

    /// Findings that are no failure, with commas
    #[arg(long, value_name = "FINDINGS", value_enum, value_delimiter = ',')]
    pub allow: Vec<Finding>,

    /// Exit code, 0 to 255, if the program used something of the processor that is not modelled
    /// exactly [default: 0]
    #[arg(long, value_name = "CODE", value_parser = within(0..=255u8), allow_hyphen_values = true)]
    pub unmodelled_exit: Option<u8>,

    /// Print each message on the bus as a plain line, not only a count each second
    #[arg(long)]
    pub traffic: bool,

    /// Flight controller that the simulated autopilot imitates
    #[arg(long, value_name = "KIND", value_enum, default_value_t = Profile::Plain)]
    pub autopilot: Profile,

    /// Dialect of the autopilot: v0, which is DroneCAN, or draft, the UAVCAN of 2014; draft needs
    /// --autopilot plain or thesis
    #[arg(long, value_name = "DIALECT", default_value_t = Dialect::V0, value_parser = dialect)]
    pub dialect: Dialect,

    /// Send only the autopilot's status or only its commands [default: all messages of that flight
    /// controller]
    #[arg(long, value_name = "WHAT", value_enum)]
    pub only: Option<Only>,

    /// Node ID of the simulated autopilot, 1 to 127 [default: 10 for ardupilot and ardupilot-pwm,
    /// else 1]
    #[arg(long, value_name = "ID", value_parser = node_id, allow_hyphen_values = true)]
    pub autopilot_id: Option<NodeId>,

    /// Actuator ID that the autopilot moves, 0 to 255; for ardupilot 1 to 15, for px4 0 to 14; all:
    /// each with its own phase
    #[arg(
        long,
        value_name = "ID|all",
        default_value = "1",
        value_parser = actuator,
        allow_hyphen_values = true,
    )]
    pub actuator: Actuator,

    /// Number of actuators in each command, from the first ID on; 0 for no ArrayCommand [default:
    /// 15 for ardupilot, ardupilot-pwm and px4, which had 8 before June 2026]
    #[arg(long, value_name = "NUMBER", value_parser = within(0..=15u8), allow_hyphen_values = true)]
    pub servos: Option<u8>,

    /// While disarmed leave the actuators that move out of the commands, and send none for motors,
    /// as ArduPilot leaves out the throttle with ARMING_REQUIRE 2
    #[arg(long)]
    pub omit_disarmed: bool,

    /// Number of motors that the autopilot commands, from index 0 on; they sweep while armed; for
    /// ardupilot up to 20, for px4 up to 12 [default: none, and no esc.RawCommand]
    #[arg(long, value_name = "NUMBER", value_parser = within(1..=20u8), allow_hyphen_values = true)]
    pub motors: Option<u8>,

    /// Commands for motors a second, 1 to 400
    #[arg(
        long,
        value_name = "HZ",
        default_value_t = 50,
        value_parser = within(1..=400u32),
        allow_hyphen_values = true,
    )]
    pub motor_rate: u32,

    /// Read this parameter of each new node by its name, and print it, as ArduPilot does for its
    /// scripts; for ardupilot and ardupilot-pwm
    #[arg(long, value_name = "NAME", value_parser = parameter_name)]
    pub get_parameter: Option<String>,

    /// Unit of the commands, for --autopilot plain; in the draft only unitless and thesis
    /// [default: unitless]
    #[arg(long, value_name = "TYPE", value_enum)]
    pub command_type: Option<CommandType>,

    /// Let the autopilot allocate node IDs, from 125 downwards, to boards that request one
    /// (CAN_NODE 0)
    #[arg(long)]
    pub allocate: bool,

    /// Hold the servo at this deflection, -1 to 1, instead of sweeping it
    #[arg(
        long,
        value_name = "DEFLECTION",
        allow_hyphen_values = true,
        value_parser = within(-1.0..=1.0),
    )]
    pub hold: Option<f64>,

    /// Time of one sweep of the servo, there and back, 100ms to 1h
    #[arg(
        long,
        value_name = "TIME",
        default_value = "4s",
        value_parser = sweep_period,
        allow_hyphen_values = true,
    )]
    pub sweep_period: Cycles,

    /// Temperature at the sensor, in degrees Celsius, -55 to 150
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 25.0,
        value_parser = within(-55.0..=150.0),
        allow_hyphen_values = true,
    )]
    pub temperature: f64,

    /// Voltage at the input that measures the circuit's voltage, in millivolts, 0 to 5000
    /// [default: 0]
    #[arg(long, value_name = "MV", value_parser = millivolts, allow_hyphen_values = true)]
    pub pwr_voltage: Option<u32>,

    /// Voltage at the input that measures the circuit's current, in millivolts, 0 to 5000
    /// [default: 0]
    #[arg(long, value_name = "MV", value_parser = millivolts, allow_hyphen_values = true)]
    pub pwr_current: Option<u32>,

    /// Let the voltage of --pwr-voltage fall like that of a lithium battery which is empty after
    /// this many minutes
    #[arg(
        long,
        value_name = "MINUTES",
        value_parser = within(0.0..=10_000.0),
        requires = "pwr_voltage",
    )]
    pub pwr_discharge: Option<f64>,

    /// Speed of the shaft whose sensor gives a pulse a turn, in revolutions a minute, 0 to 10000000
    /// (6000000 is noise of 100 kHz); keys u and U change it
    /// [default: 0]
    #[arg(long, value_name = "RPM", value_parser = rpm, allow_hyphen_values = true)]
    pub rpm: Option<u32>,

    /// Cause a fault at a simulated time, for example chip-reset@2s (repeatable; --help
    /// faults lists the names)
    #[arg(long, value_name = "NAME@TIME")]
    pub inject: Vec<Injection>,

    /// Leave out the autopilot, like --autopilot none
    #[arg(
        long,
        conflicts_with_all = [
            "autopilot", "hold", "autopilot_id", "actuator", "motors", "command_type",
            "sweep_period", "allocate", "dialect", "only",
        ],
    )]
    pub no_autopilot: bool,

    /// Show the levels of these pins, with commas: D8,A1
    ///
    /// A signal faster than 20 Hz is shown with its frequency, and the share of the time in which
    /// it is high. --vcd has each edge.
    #[arg(long, value_name = "PINS", value_delimiter = ',')]
    pub watch: Vec<Pin>,

    /// Outputs with an ESC and its motor in place of a servo, with commas: 1,2,3,4
    ///
    /// The views show the throttle. Of outputs with OneShot125, or with pulses more often than
    /// OUT_RATE allows, they do so without this option.
    #[arg(long, value_name = "OUTPUTS", value_delimiter = ',', value_parser = within(1..=8u8))]
    pub escs: Vec<u8>,

    /// Apply a level or a voltage to a pin: D7=low, D7=high, D7=open, A1=2.5V
    ///
    /// Repeatable. In a script it is "(2.0) set D7 low".
    #[arg(long, value_name = "PIN=LEVEL")]
    pub set: Vec<Setting>,

    /// Put a device with this address on the two-wire bus (Wire, I2C): 0x48, or with values of its
    /// registers 0x48:0x00=0x19,0x80
    ///
    /// It has 256 registers of a byte; the first byte that is written selects one. Repeatable. In a
    /// script it is "(2.0) i2c 0x48:0x00=0x19". Without a device nothing acknowledges.
    #[arg(long, value_name = "ADDRESS")]
    pub i2c: Vec<i2c::Setting>,

    /// Options for the board.
    #[command(flatten)]
    pub wires: wires::Args,

    /// Options for other programs that join the bench.
    #[command(flatten)]
    pub links: links::Args,
}

/// The actuators that the autopilot moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actuator {
    Id(u8),
    All,
}

/// A task of `sim` without the bench.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Command {
    /// Plan the load of a bus: calculate it from message types and rates, in per cent
    Utilisation(utilisation::Args),
    /// Prove from the machine code of a program how much stack and how many cycles it needs
    #[command(after_help = bounds::command::HELP)]
    Bounds(bounds::command::Options),
}

impl Args {
    /// Checks options that exclude each other.
    ///
    /// # Errors
    /// If a fault is due after the end of the run.
    pub fn check(&self) -> Result<()> {
        let Some(end) = self.duration else { return Ok(()) };
        let late = self.inject.iter().find(|injection| injection.at > end);
        if let Some(injection) = late {
            bail!("--inject {injection}: the run ends before, at {} s (--for)", seconds(end));
        }
        Ok(())
    }

    /// What counts as a failure of the run.
    pub fn judgement(&self) -> Judgement {
        Judgement {
            is_strict: self.strict,
            allowed: self.allow.clone(),
            unmodelled_exit: self.unmodelled_exit,
        }
    }

    /// Bits per second on the bus of a board. The board may be too slow for it.
    pub fn bit_rate(&self, wiring: &Wiring) -> u32 {
        self.bit_rate.unwrap_or(wiring.fastest_bit_rate())
    }

    /// Millivolts at the inputs for the voltage and the current of a circuit.
    ///
    /// # Errors
    /// If there is such an option, but the program of this board measures no circuit.
    pub fn circuit_millivolts(&self, wiring: &Wiring) -> Result<[u32; 2]> {
        let options = [("--pwr-voltage", self.pwr_voltage), ("--pwr-current", self.pwr_current)];
        for (name, option) in options {
            ensure!(
                option.is_none() || wiring.power.is_some(),
                "{name}: this program has no inputs for a circuit"
            );
        }
        Ok(options.map(|(_, option)| option.unwrap_or(0)))
    }

    /// Revolutions a minute of the shaft.
    ///
    /// # Errors
    /// If there is such an option, but the program of this board counts no pulses.
    pub fn shaft_rpm(&self, wiring: &Wiring) -> Result<u32> {
        ensure!(
            self.rpm.is_none() || wiring.rpm.is_some(),
            "--rpm: this program has no input for a shaft: build it with FEATURES=rpm"
        );
        Ok(self.rpm.unwrap_or(0))
    }

    /// Settings of the autopilot; `None` for a bench without one.
    ///
    /// # Errors
    /// If options contradict each other; the message says which.
    pub fn autopilot(&self) -> Result<Option<Settings>> {
        if self.no_autopilot || self.autopilot == Profile::None {
            return Ok(None);
        }
        let types = self.autopilot.command_types(self.dialect);
        ensure!(
            !types.is_empty(),
            "--dialect {} is not for {}: use --autopilot plain or thesis",
            self.dialect,
            self.autopilot
        );
        let usual = Settings::of(self.autopilot).in_dialect(self.dialect);
        let command_type = self.command_type.unwrap_or(usual.command_type);
        ensure!(
            types.contains(&command_type),
            "--command-type {command_type} is not for {}: use --autopilot plain{}",
            self.autopilot,
            if self.dialect == Dialect::Draft { " --dialect v0" } else { "" }
        );
        ensure!(
            !self.allocate || self.dialect == Dialect::V0,
            "--allocate: the draft has no allocation, use --dialect v0"
        );
        let ids = self.autopilot.actuators();
        let (actuator, moves) = match self.actuator {
            Actuator::Id(id) => (id, Moves::One),
            Actuator::All => (*ids.start(), Moves::All),
        };
        ensure!(
            moves == Moves::One || self.autopilot.commands_several(),
            "--actuator all: {} commands one actuator, use --autopilot ardupilot or px4",
            self.autopilot
        );
        ensure!(
            ids.contains(&actuator),
            "--actuator {actuator}: {} commands {} to {}",
            self.autopilot,
            ids.start(),
            ids.end()
        );
        let (motors, motors_max) = (self.motors.unwrap_or(0), self.autopilot.motors_max());
        ensure!(
            motors == 0 || motors_max > 0,
            "--motors: {} does not send ArmingStatus, use --autopilot ardupilot or px4",
            self.autopilot
        );
        ensure!(
            motors <= motors_max,
            "--motors {motors}: {} commands at most {motors_max}",
            self.autopilot
        );
        ensure!(
            (self.servos.is_none() && !self.omit_disarmed) || self.autopilot.commands_several(),
            "--servos and --omit-disarmed: {} commands one actuator, use --autopilot ardupilot or \
             px4",
            self.autopilot
        );
        ensure!(
            self.get_parameter.is_none() || self.autopilot.reads_parameters(),
            "--get-parameter: {} reads none, use --autopilot ardupilot",
            self.autopilot
        );
        Ok(Some(Settings {
            parameter: self.get_parameter.clone(),
            servos: self.servos.unwrap_or(usual.servos),
            motor_rate_hz: self.motor_rate,
            omits_disarmed: self.omit_disarmed,
            node_id: self.autopilot_id.unwrap_or(usual.node_id),
            actuator,
            moves,
            motors,
            command_type,
            sweep_period: self.sweep_period,
            allocates: self.allocate,
            only: self.only,
            ..usual
        }))
    }
}

fn bit_rate(text: &str) -> Result<u32, String> {
    let rate = text.parse().ok().filter(|rate| BIT_RATES.contains(rate));
    rate.ok_or_else(|| String::from("use 1000000, 500000, 250000 or 125000"))
}

/// Refuses a program that stands where a task could be.
fn without_option(text: &str) -> Result<PathBuf, String> {
    Err(format!("write sim --elf {text}; the tasks are utilisation and bounds"))
}

fn dialect(text: &str) -> Result<Dialect, String> {
    let named = |dialect: &Dialect| dialect.to_string() == text;
    [Dialect::V0, Dialect::Draft]
        .into_iter()
        .find(named)
        .ok_or_else(|| String::from("use v0 or draft"))
}

fn node_id(text: &str) -> Result<NodeId, String> {
    let id = text.parse().ok().and_then(NodeId::new);
    id.ok_or_else(|| String::from("use a number from 1 to 127"))
}

fn actuator(text: &str) -> Result<Actuator, String> {
    match text {
        "all" => Ok(Actuator::All),
        id => id
            .parse()
            .map(Actuator::Id)
            .map_err(|_| String::from("use a number from 0 to 255, or all")),
    }
}

/// Reads a name of a parameter. DroneCAN's are at most 92 bytes long.
fn parameter_name(text: &str) -> Result<String, String> {
    let is_name = (1..=92).contains(&text.len());
    is_name.then(|| text.to_owned()).ok_or_else(|| String::from("use a name of 1 to 92 bytes"))
}

/// Reads the period of the sweep. A shorter one than 100 ms is too fast to see; 1 h is an arbitrary
/// limit.
fn sweep_period(text: &str) -> Result<Cycles, String> {
    let period = parse_duration(text)?;
    match (F_CPU_HZ / 10..=3600 * F_CPU_HZ).contains(&period) {
        true => Ok(period),
        false => Err(String::from("use a time from 100ms to 1h")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn parse(line: &str) -> Result<Args, clap::Error> {
        Args::try_parse_from(line.split(' '))
    }

    #[test]
    fn a_fault_after_the_end_of_the_run_is_refused() {
        let check = |line| parse(line).unwrap().check().map_err(|error| error.to_string());
        let error = check("sim --for 5s --inject cable@2s --inject cable@10s").unwrap_err();
        assert_eq!(error, "--inject cable@10s: the run ends before, at 5 s (--for)");
        assert_eq!(check("sim --for 5s --inject cable@5s"), Ok(()));
        assert_eq!(check("sim --inject cable@10s"), Ok(()));
    }

    #[test]
    fn the_command_line_is_consistent() {
        Args::command().debug_assert();
    }

    #[test]
    fn without_options_sim_shows_the_live_view_in_real_time() {
        let args = parse("sim").unwrap();
        assert_eq!(args.bit_rate(&args.wires.apply(Wiring::default()).unwrap()), 1_000_000);
        assert_eq!(args.speed, Speed::Factor(1.0));
        assert_eq!(args.duration, None);
        assert_eq!(args.autopilot().unwrap().unwrap().node_id.get(), 1);
        assert!(!args.plain && !args.no_autopilot);
        assert!(args.links.slcan.is_empty() && args.links.serial.is_none());
    }

    #[test]
    fn wrong_values_are_rejected_with_advice() {
        for (line, advice) in [
            ("sim --for 5", "5s"),
            ("sim --unmodelled-exit 256", "0 to 255"),
            ("sim --for -5s", "is negative"),
            ("sim --nodes -1", "0 to 126"),
            ("sim --nodes 99999999", "0 to 126"),
            ("sim --bit-rate -5", "500000"),
            ("sim --temperature nan", "-55 to 150"),
            ("sim --temperature -300", "-55 to 150"),
            ("sim --sweep-period 1us", "100ms to 1h"),
            ("sim --pwr-voltage 12.6", "0 to 5000"),
            ("sim --pwr-current 5001", "0 to 5000"),
            ("sim --pwr-current -1", "0 to 5000"),
            ("sim --pwr-voltage 1000 --pwr-discharge x", "0 to 10000"),
            ("sim --pwr-discharge 5", "--pwr-voltage <MV>"),
            ("sim --rpm -1", "0 to 10000000"),
            ("sim --rpm 10000001", "0 to 10000000"),
            ("sim --rpm 60.5", "0 to 10000000"),
            ("sim --actuator -1", "0 to 255"),
            ("sim --actuator every", "or all"),
            ("sim --motors 0", "1 to 20"),
            ("sim --motors 21", "1 to 20"),
            ("sim --escs 1,9", "1 to 8"),
            ("sim --motor-rate 0", "use a number from 1 to 400"),
            ("sim --servos 16", "use a number from 0 to 15"),
            ("sim --get-parameter=", "a name of 1 to 92 bytes"),
            ("sim sketch.elf", "sim --elf sketch.elf"),
            ("sim --plain sketch.elf", "sim --elf sketch.elf"),
            ("sim --no-autopilot --motors 4", "--no-autopilot"),
            ("sim --mcast -1", "0 to 255"),
            ("sim --gdb 0", "1 to 65535"),
            ("sim --crystal -8", "use MHz, 8 or 16"),
            ("sim --bit-rate 800000", "500000"),
            ("sim --autopilot-id 0", "1 to 127"),
            ("sim --hold 2", "-1 to 1"),
            ("sim --mcu attiny85", "atmega168 or atmega328p"),
            ("sim --cs 10", "D0 to D13 or A0 to A5"),
            ("sim --crystal 8000000", "use MHz, 8 or 16"),
            ("sim --dialect v1", "v0 or draft"),
            ("sim --no-autopilot --dialect draft", "--no-autopilot"),
            ("sim --speed 0", "max"),
            ("sim --inject gremlins@1s", "stuck-dominant"),
            ("sim --no-program", "--bootloader"),
            ("sim --no-autopilot --hold 0", "--no-autopilot"),
        ] {
            let error = parse(line).unwrap_err().to_string();
            assert!(error.contains(advice), "{error}");
        }
    }

    #[test]
    fn the_options_set_the_wiring_of_the_board_and_its_bit_rate() {
        let wiring = |line| parse(line).unwrap().wires.apply(Wiring::default());
        let by_name = wiring("sim --board uno --shield module").unwrap();
        assert_eq!(by_name, Wiring::of("uno", "module").unwrap());
        let by_wire = wiring("sim --mcu atmega328p --cs D10 --int D2 --crystal 8").unwrap();
        assert_eq!(
            by_wire,
            Wiring {
                board: String::from("diecimila"),
                shield: String::from("seeed"),
                ..by_name.clone()
            }
        );
        let servo = wiring("sim --cs D8 --servo D9").unwrap();
        assert_eq!((servo.servo.to_string().as_str(), servo.cs.to_string().as_str()), ("D9", "D8"));
        for (line, advice) in
            [("sim --servo D9", "D9, which is CS's"), ("sim --servo D6", "only D9 and D10")]
        {
            let error = wiring(line).unwrap_err().to_string();
            assert!(error.contains(advice), "{error}");
        }
        let bit_rate = |line, wiring: &Wiring| parse(line).unwrap().bit_rate(wiring);
        assert_eq!(bit_rate("sim", &by_name), 500_000);
        assert_eq!(bit_rate("sim --bit-rate 250000", &by_name), 250_000);
        assert_eq!(bit_rate("sim --bit-rate 125000", &Wiring::default()), 125_000);
        // The commonest mistake can be shown.
        assert_eq!(bit_rate("sim --bit-rate 1000000", &by_name), 1_000_000);
    }

    #[test]
    fn the_shaft_turns_if_the_program_counts_its_pulses() {
        let mut wiring = Wiring::default();
        let rpm = |line, wiring: &Wiring| parse(line).unwrap().shaft_rpm(wiring);
        assert_eq!(rpm("sim", &wiring).unwrap(), 0);
        let error = rpm("sim --rpm 0", &wiring).unwrap_err().to_string();
        assert!(error.ends_with("build it with FEATURES=rpm"), "{error}");
        wiring.rpm = wiring.light.take();
        assert_eq!(rpm("sim", &wiring).unwrap(), 0);
        assert_eq!(rpm("sim --rpm 10000000", &wiring).unwrap(), 10_000_000);
    }

    #[test]
    fn the_inputs_of_a_circuit_get_their_millivolts_if_the_board_has_them() {
        let mut wiring = Wiring::default();
        let millivolts = |line, wiring: &Wiring| parse(line).unwrap().circuit_millivolts(wiring);
        assert_eq!(
            millivolts("sim --pwr-voltage 1260 --pwr-current 5000", &wiring).unwrap(),
            [1260, 5000]
        );
        assert_eq!(millivolts("sim --pwr-current 330", &wiring).unwrap(), [0, 330]);
        wiring.power = None;
        assert_eq!(millivolts("sim", &wiring).unwrap(), [0, 0]);
        let error = millivolts("sim --pwr-current 330", &wiring).unwrap_err().to_string();
        assert_eq!(error, "--pwr-current: this program has no inputs for a circuit");
    }

    #[test]
    fn the_options_choose_the_autopilot_and_its_settings() {
        use CommandType::{Pwm, Thesis, Unitless};
        let settings = |line: &str| parse(line).unwrap().autopilot().unwrap();
        for (line, id, actuator, command_type) in [
            ("sim --autopilot ardupilot", 10, 1, Unitless),
            ("sim --autopilot ardupilot-pwm --autopilot-id 3", 3, 1, Pwm),
            ("sim --autopilot px4 --actuator 0", 1, 0, Unitless),
            ("sim --autopilot px4 --actuator 7", 1, 7, Unitless),
            ("sim --autopilot thesis", 1, 1, Thesis),
        ] {
            let found = settings(line).unwrap();
            let found = (found.node_id.get(), found.actuator, found.command_type, found.moves);
            assert_eq!(found, (id, actuator, command_type, Moves::One), "{line}");
        }
        for (line, dialect, command_type, only) in [
            ("sim", Dialect::V0, Unitless, None),
            ("sim --dialect draft --only status", Dialect::Draft, Unitless, Some(Only::Status)),
            (
                "sim --dialect draft --autopilot thesis --only commands",
                Dialect::Draft,
                Thesis,
                Some(Only::Commands),
            ),
        ] {
            let found = settings(line).unwrap();
            let found = (found.dialect, found.command_type, found.only);
            assert_eq!(found, (dialect, command_type, only), "{line}");
        }
        for (line, actuator, motors) in [
            ("sim --autopilot ardupilot --actuator all --motors 20", 1, 20),
            ("sim --autopilot px4 --actuator all --motors 12", 0, 12),
        ] {
            let found = settings(line).unwrap();
            let found = (found.actuator, found.moves, found.motors);
            assert_eq!(found, (actuator, Moves::All, motors), "{line}");
        }
        let allocates = |line| settings(line).unwrap().allocates;
        assert!(allocates("sim --allocate") && !allocates("sim"));
        let without = ["sim --autopilot none", "sim --no-autopilot"].map(settings);
        assert!(without.iter().all(Option::is_none));
        for (line, advice) in [
            ("sim --actuator all", "--autopilot ardupilot or px4"),
            ("sim --motors 4", "--autopilot ardupilot or px4"),
            ("sim --servos 4", "--autopilot ardupilot or px4"),
            ("sim --omit-disarmed", "--autopilot ardupilot or px4"),
            ("sim --autopilot px4 --get-parameter OUT1_MAX", "use --autopilot ardupilot"),
            ("sim --autopilot px4 --motors 13", "PX4 commands at most 12"),
            ("sim --autopilot px4 --command-type pwm", "--autopilot plain"),
            ("sim --autopilot px4 --actuator 15", "PX4 commands 0 to 14"),
            ("sim --autopilot ardupilot --actuator 0", "ArduPilot commands 1 to 15"),
            ("sim --autopilot px4 --dialect draft", "--autopilot plain or thesis"),
            ("sim --dialect draft --command-type pwm", "--dialect v0"),
            ("sim --dialect draft --allocate", "--dialect v0"),
        ] {
            let error = parse(line).unwrap().autopilot().unwrap_err().to_string();
            assert!(error.contains(advice), "{error}");
        }
    }
}
