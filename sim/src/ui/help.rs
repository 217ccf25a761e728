//! `--help`: what most users need in two screens, and the rest by topic.

use super::args::Args;
use super::keys;
use crate::fault;
use bench::corner;
use bench::dronecan::help::{Help, Topic};
use clap::CommandFactory as _;

/// The help of `sim`.
pub const HELP: Help = Help {
    command: Args::command,
    about: ABOUT,
    common: &[
        "elf",
        "board",
        "shield",
        "duration",
        "plain",
        "strict",
        "no_autopilot",
        "inject",
        "slcan",
        "serial",
        "vcd",
        "script",
        "watch",
        "set",
    ],
    topics: TOPICS,
    everything: "everything; docs/bench.md explains it",
    end: EXIT_CODES,
};

const ABOUT: &str = "\
Boots a program on a simulated Arduino with an MCP2515, connects it to a simulated CAN bus, and
shows what it does: the node of this project, or your own program. A simulated autopilot sends
NodeStatus and commands. On a terminal there is a live view with keys; elsewhere, or with --plain,
a line for each event, with the simulated time in seconds, and a summary at the end.

Usage: sim [OPTIONS]
       sim bounds --help         prove stack and cycles of a program from its machine code
       sim utilisation --help    plan the load of a bus
";

const EXIT_CODES: &str = "\
The exit code is 0 if the program ran without a crash and without a mistake, 1 if it crashed or
misused a chip (with --strict also if anything else was wrong with it), 2 if the command line is
wrong, and 3 after an error of this computer, such as a missing file or a busy port.
";

const TOPICS: &[Topic] = &[
    Topic {
        name: "run",
        about: "length, speed, output and result of a run",
        options: &[
            "elf",
            "processor",
            "duration",
            "speed",
            "plain",
            "json",
            "strict",
            "allow",
            "unmodelled_exit",
            "traffic",
            "only",
        ],
        text: String::new,
    },
    Topic {
        name: "autopilot",
        about: "what the autopilot sends",
        options: &[
            "autopilot",
            "no_autopilot",
            "dialect",
            "autopilot_id",
            "actuator",
            "servos",
            "omit_disarmed",
            "motors",
            "motor_rate",
            "get_parameter",
            "command_type",
            "allocate",
            "hold",
            "sweep_period",
        ],
        text: String::new,
    },
    Topic {
        name: "board",
        about: "Arduino, CAN board, wires and pins; sensors and shaft",
        options: &[
            "board",
            "shield",
            "mcu",
            "cs",
            "int",
            "crystal",
            "servo",
            "escs",
            "bit_rate",
            "temperature",
            "pwr_voltage",
            "pwr_current",
            "pwr_discharge",
            "rpm",
            "watch",
            "set",
            "i2c",
        ],
        text: String::new,
    },
    Topic {
        name: "links",
        about: "adapters, serial port, recordings, debugger, scripts, further boards",
        options: &[
            "slcan",
            "serial",
            "serial_any_baud",
            "bootloader",
            "no_program",
            "mcast",
            "mcast_interface",
            "log",
            "vcd",
            "vcd_signals",
            "gdb",
            "script",
            "nodes",
            "eeprom",
        ],
        text: String::new,
    },
    Topic {
        name: "faults",
        about: "faults for --inject NAME@TIME, and values of a real chip",
        options: &["inject", "corner", "clock", "eeprom_ms", "silicon"],
        text: faults,
    },
    Topic { name: "keys", about: "keys of the live view", options: &[], text: keys_of_live_view },
    Topic {
        name: "examples",
        about: "command lines for common tasks",
        options: &[],
        text: || EXAMPLES.into(),
    },
];

/// The topic `examples`.
const EXAMPLES: &str = "\
Examples:
  sim                                    the live bench
  sim --plain --for 5s                   five seconds as lines
  sim --for 1m --speed max | tail -9     the summary, with the speed that this computer reaches
  sim --hold 0.5 --command-type pwm      servo held at 1750 us, commanded in microseconds
  sim --plain --for 6s --inject cable@2s --inject cable@4s
                                         the cable is pulled at 2 s and plugged at 4 s
  sim --plain --traffic --for 1s         every message on the bus
  sim --autopilot ardupilot              commands for 15 servos in each message, like ArduPilot's
  sim --autopilot ardupilot --actuator all --motors 4
                                         commands for 15 servos with phases of their own, 4 motors
  sim --dialect draft --autopilot thesis
                                         the thesis's autopilot of 2014, for the preset thesis
  sim --plain --for 9s --inject other-dialect@4s
                                         an autopilot of the other dialect replaces the first at 4 s
  sim --no-autopilot --slcan ./can       a port for the DroneCAN GUI Tool: slcan: and its whole path
  sim --serial ./arduino                 a port for a terminal program; opening it resets the board
  sim --bootloader --slcan ./can         with the bootloader for updates: docs/update.md
  sim --elf sketch.elf --board uno --shield module --no-autopilot
                                         your own program for an Uno with a blue module, 8 MHz
  sim --elf sketch.elf --board uno --watch D8,A1 --set D7=low --set A0=2.5V
                                         its own pins: a LED, a button, a potentiometer
  sim --elf sketch.elf --mcu atmega328p --cs D10 --int D2 --crystal 8
                                         the same, wire by wire
";

fn faults() -> String {
    format!("Faults:\n{}\nValues of a chip for --silicon:\n{}", fault::table(), corner::table())
}

fn keys_of_live_view() -> String {
    let keys = keys::HELP.iter().map(|(keys, text)| format!("  {keys:17}{text}\n"));
    format!("Keys of the live view:\n{}", keys.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    fn help(words: &str) -> String {
        let words: Vec<String> = words.split_whitespace().map(str::to_owned).collect();
        HELP.asked(&words).unwrap().unwrap()
    }

    #[test]
    fn the_help_fits_two_screens_and_each_option_has_one_topic() {
        HELP.assert_is_whole();
    }

    #[test]
    fn a_topic_shows_its_options_and_an_unknown_one_the_topics() {
        assert!(help("--help links").contains("--slcan"));
        assert!(!help("--plain -h links").contains("--autopilot "));
        assert!(help("--help faults").contains("stuck-dominant"));
        assert!(help("--help faults").contains("eeprom-ms"));
        assert_eq!(help("--help=keys"), help("--help keys"));
        for other in [&["--plain"][..], &["bounds", "--help"], &["help", "bounds"]] {
            let words: Vec<String> = other.iter().map(|word| (*word).to_owned()).collect();
            assert_eq!(HELP.asked(&words), None);
        }
        let error = HELP.asked(&["--help".into(), "fault".into()]).unwrap().unwrap_err();
        assert!(error.contains("links, faults, keys, examples or all"), "{error}");
    }

    #[test]
    fn the_whole_help_lists_keys_and_faults() {
        let help = help("--help all");
        for expected in ["Ctrl-C", "stuck-dominant", "Examples:", "--bit-rate"] {
            assert!(help.contains(expected), "{expected} is missing");
        }
        assert!(!help.contains("\nOptions:\n"), "each heading names its topic");
    }

    #[test]
    fn every_example_is_parsed() {
        for line in EXAMPLES.lines().filter(|line| line.starts_with("  sim")) {
            let command = line.trim().split("   ").next().unwrap();
            let command = command.split(" | ").next().unwrap();
            assert!(Args::try_parse_from(command.split_whitespace()).is_ok(), "{command}");
        }
    }
}
