//! The wiring of a board: its chip, the pins of its signals, and the crystal of the MCP2515.
//!
//! An ELF file of this project has a section `.board`, which is not loaded, with lines `key=value`.
//! For other programs, options on the command line set the wiring. `avr-specs/boards.toml` has the
//! names of boards and CAN boards.

use crate::avr::{Chip, Firmware, Oc, value_of};
use crate::boards;
pub use crate::boards::BIT_RATES;
use crate::dronecan::text::visible;
use anyhow::{Context, Result, bail, ensure};
use std::fmt;
use std::str::FromStr;
use toml::Value;

/// Oscillator frequencies that the MCP2515 allows, in MHz (DS20001801J section 13).
const CRYSTALS_MHZ: std::ops::RangeInclusive<u32> = 1..=40;
/// Pins of the serial port and of the SPI, and their signals.
const TAKEN: [(&str, &str); 5] = [
    ("D0", "the serial port"),
    ("D1", "the serial port"),
    ("D11", "MOSI"),
    ("D12", "MISO"),
    ("D13", "SCK"),
];

/// A pin of the Arduino: D0 to D13 or A0 to A5.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pin {
    port: char,
    bit: u8,
}

impl Pin {
    /// Letter of the chip's port.
    pub fn port(self) -> char {
        self.port
    }

    /// Bit in the port.
    pub fn bit(self) -> u8 {
        self.bit
    }

    /// The output of Timer1 on this pin, if it has one.
    pub fn timer1_output(self) -> Option<Oc> {
        match (self.port, self.bit) {
            ('B', 1) => Some(Oc::A),
            ('B', 2) => Some(Oc::B),
            _ => None,
        }
    }

    /// The ADC channel of this pin, if it has one.
    pub fn adc_channel(self) -> Option<u8> {
        (self.port == 'C').then_some(self.bit)
    }
}

impl FromStr for Pin {
    type Err = String;

    fn from_str(text: &str) -> Result<Pin, String> {
        let number = || text.get(1..).filter(|digits| !digits.starts_with('+'))?.parse::<u8>().ok();
        match (text.chars().next(), number()) {
            (Some('D'), Some(number @ 0..=7)) => Ok(Pin { port: 'D', bit: number }),
            (Some('D'), Some(number @ 8..=13)) => Ok(Pin { port: 'B', bit: number - 8 }),
            (Some('A'), Some(number @ 0..=5)) => Ok(Pin { port: 'C', bit: number }),
            _ => Err(format!("there is no pin \"{text}\": use D0 to D13 or A0 to A5")),
        }
    }
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.port {
            'D' => write!(f, "D{}", self.bit),
            'B' => write!(f, "D{}", self.bit + 8),
            _ => write!(f, "A{}", self.bit),
        }
    }
}

/// ADC inputs for the voltage and the current of the circuit that the node measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PowerPins {
    pub voltage: Pin,
    pub current: Pin,
}

/// The wiring of a board.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wiring {
    /// Name of the board in the table, such as "uno".
    pub board: String,
    /// Name of the CAN board in the table, such as "module".
    pub shield: String,
    pub chip: Chip,
    /// Chip select of the MCP2515.
    pub cs: Pin,
    /// Interrupt output of the MCP2515.
    pub int: Pin,
    /// Frequency of the MCP2515's crystal.
    pub crystal_mhz: u32,
    pub servo: Pin,
    /// Output 2 and the further outputs; empty if the program has one output.
    pub outputs: Vec<Pin>,
    pub light: Option<Pin>,
    pub button: Option<Pin>,
    pub sensor: Pin,
    /// `None` if the program does not measure a circuit.
    pub power: Option<PowerPins>,
    /// Pulses of a shaft; `None` if the program does not count them.
    pub rpm: Option<Pin>,
}

/// The table's default board with the default CAN board.
impl Default for Wiring {
    fn default() -> Wiring {
        Wiring::of(boards::default_board(), boards::default_shield())
            .expect("the table has its defaults")
    }
}

impl Wiring {
    /// The wiring of a board with a CAN board.
    ///
    /// # Errors
    /// If the table does not have both; the message lists the right names.
    pub fn of(board: &str, shield: &str) -> Result<Wiring> {
        let chip = boards::text(entry("boards", board)?, "chip");
        let pin = |signal: &str| of_table(boards::pin(signal));
        let mut wiring = Wiring {
            board: board.to_owned(),
            shield: String::new(),
            chip: chip.parse().map_err(anyhow::Error::msg)?,
            // `set_shield` below sets these four.
            cs: pin("button"),
            int: pin("button"),
            crystal_mhz: 0,
            servo: pin("button"),
            outputs: Vec::new(),
            light: Some(pin("light")),
            button: Some(pin("button")),
            sensor: pin("sensor"),
            power: None,
            rpm: None,
        };
        wiring.set_shield(shield)?;
        wiring.power = Some(wiring.free_power_pins());
        Ok(wiring)
    }

    /// The wiring for a program: that of its section `.board`, else the default wiring with the
    /// chip of the program.
    ///
    /// # Errors
    /// If the section is invalid, or the simulator does not know the chip.
    pub fn of_program(firmware: &Firmware) -> Result<Wiring> {
        let mut wiring = Wiring::of_section(firmware.board.as_deref())?;
        wiring.chip = firmware.chip()?.unwrap_or(wiring.chip);
        Ok(wiring)
    }

    /// The wiring in a section `.board`; the default wiring without a section.
    ///
    /// # Errors
    /// Those of [`Wiring::parse`].
    pub fn of_section(section: Option<&[u8]>) -> Result<Wiring> {
        section.map_or_else(|| Ok(Wiring::default()), Wiring::parse)
    }

    /// Reads the section `.board` of an ELF file.
    ///
    /// # Errors
    /// If a value is missing or invalid; the message names it.
    pub fn parse(section: &[u8]) -> Result<Wiring> {
        std::str::from_utf8(section).context("the section .board is not text")?;
        let value = |key: &str| value_of(section, key);
        let needed =
            |key: &str| value(key).with_context(|| format!("the section .board has no {key}"));
        let wrong = |key: &str, error: String| {
            anyhow::Error::msg(format!("the section .board: {key}: {error}"))
        };
        let pin = |key: &str, text: &str| text.parse::<Pin>().map_err(|error| wrong(key, error));
        let optional = |key: &str| value(key).map(|text| pin(key, text)).transpose();
        let wiring = Wiring {
            board: visible(needed("board")?).into_owned(),
            shield: visible(needed("shield")?).into_owned(),
            chip: needed("mcu")?.parse().map_err(|error| wrong("mcu", error))?,
            cs: pin("cs", needed("cs")?)?,
            int: pin("int", needed("int")?)?,
            crystal_mhz: crystal_mhz(needed("crystal_mhz")?)
                .map_err(|error| wrong("crystal_mhz", error))?,
            servo: pin("servo", needed("servo")?)?,
            outputs: value("outputs")
                .into_iter()
                .flat_map(|pins| pins.split(','))
                .map(|text| pin("outputs", text))
                .collect::<Result<_>>()?,
            light: optional("light")?,
            button: optional("button")?,
            sensor: pin("sensor", needed("sensor")?)?,
            power: value("power")
                .map(|text| power_pins(text).map_err(|error| wrong("power", error)))
                .transpose()?,
            rpm: optional("rpm")?,
        };
        wiring.check().context("the section .board")?;
        Ok(wiring)
    }

    /// Checks that each signal is on a pin with the function that it needs, and that no two signals
    /// share a pin.
    ///
    /// # Errors
    /// If a signal fails the check; the message names it.
    pub fn check(&self) -> Result<()> {
        ensure!(
            self.servo.timer1_output().is_some(),
            "the servo is on {}: only D9 and D10 are outputs of Timer1",
            self.servo
        );
        ensure!(
            self.sensor.adc_channel().is_some(),
            "the sensor is on {}: use A0 to A5",
            self.sensor
        );
        let taken = TAKEN.map(|(pin, signal)| (pin.parse::<Pin>().expect("a pin"), signal));
        let optional =
            [(self.light, "the light"), (self.button, "the button"), (self.rpm, "the shaft")];
        let signals = [
            (self.cs, "CS"),
            (self.int, "INT"),
            (self.servo, "the servo"),
            (self.sensor, "the sensor"),
        ];
        let optional = optional.into_iter().filter_map(|(pin, signal)| Some((pin?, signal)));
        let mut seen: Vec<(Pin, &str)> = taken.into();
        let outputs = self.outputs.iter().map(|&pin| (pin, "an output"));
        let power = self
            .power
            .map(|power| [(power.voltage, "the voltage"), (power.current, "the current")]);
        for (pin, signal) in power.into_iter().flatten() {
            ensure!(pin.adc_channel().is_some(), "{signal} is on {pin}: use A0 to A5");
        }
        let power = power.into_iter().flatten();
        for (pin, signal) in signals.into_iter().chain(optional).chain(outputs).chain(power) {
            if let Some((_, other)) = seen.iter().find(|(other, _)| *other == pin) {
                bail!("{signal} is on {pin}, which is {other}'s");
            }
            seen.push((pin, signal));
        }
        Ok(())
    }

    /// Changes the board, and with it the chip.
    ///
    /// # Errors
    /// If the table has no board of this name; the message lists the right names.
    pub fn set_board(&mut self, name: &str) -> Result<()> {
        let other = Wiring::of(name, boards::default_shield())?;
        (self.board, self.chip) = (other.board, other.chip);
        Ok(())
    }

    /// Changes the CAN board, and moves the other signals to pins that it leaves free.
    ///
    /// # Errors
    /// If the table has no CAN board of this name; the message lists the right names.
    pub fn set_shield(&mut self, name: &str) -> Result<()> {
        let shield = entry("shields", name)?;
        let pin = |key: &str| of_table(boards::text(shield, key));
        self.shield = name.to_owned();
        self.crystal_mhz = boards::number(shield, "crystal_mhz");
        self.set_cs(pin("cs"));
        self.set_int(pin("int"));
        Ok(())
    }

    /// Moves CS to another pin. The servo gets the first free output of Timer1; a light, a button
    /// or an input on the pin gives way.
    pub fn set_cs(&mut self, cs: Pin) {
        self.cs = cs;
        self.servo = of_table(boards::servo(&cs.to_string()));
        self.make_free(cs);
    }

    /// Moves INT to another pin. A light, a button or an input on the pin gives way.
    pub fn set_int(&mut self, int: Pin) {
        self.int = int;
        self.make_free(int);
    }

    fn make_free(&mut self, pin: Pin) {
        self.light = self.light.filter(|light| *light != pin);
        self.button = self.button.filter(|button| *button != pin);
        self.rpm = self.rpm.filter(|shaft| *shaft != pin);
        self.power = self.power.map(|_| self.free_power_pins());
    }

    /// The first two pins of the table's list `power` that CS and INT leave free.
    fn free_power_pins(&self) -> PowerPins {
        let [voltage, current] = boards::power(&[&self.cs.to_string(), &self.int.to_string()]);
        PowerPins { voltage: of_table(voltage), current: of_table(current) }
    }

    /// Frequency of the MCP2515's crystal in Hz.
    pub fn crystal_hz(&self) -> u32 {
        self.crystal_mhz * 1_000_000
    }

    /// The highest bit rate of [`BIT_RATES`] that the MCP2515 reaches with its crystal: the default
    /// of a node.
    pub fn fastest_bit_rate(&self) -> u32 {
        boards::fastest_bit_rate(self.crystal_mhz)
    }

    /// Checks that the MCP2515 reaches a bit rate with its crystal.
    ///
    /// # Errors
    /// If it does not; the message has the highest bit rate.
    pub fn check_bit_rate(&self, bit_rate: u32) -> Result<()> {
        let (crystal, fastest) = (self.crystal_mhz, self.fastest_bit_rate());
        ensure!(
            bit_rate <= fastest,
            "an MCP2515 with a crystal of {crystal} MHz does at most {fastest} bit/s"
        );
        Ok(())
    }

    /// Short name of the board.
    pub fn board_name(&self) -> &str {
        if self.board_entry().is_some() { &self.board } else { "Arduino" }
    }

    /// Full name of the board.
    pub fn board_title(&self) -> String {
        self.board_entry().map_or("Arduino", |entry| boards::text(entry, "title")).to_owned()
    }

    /// Short name of the CAN board.
    pub fn shield_name(&self) -> &str {
        if self.shield_entry().is_some() { &self.shield } else { "MCP2515 board" }
    }

    /// Full name of the CAN board.
    pub fn shield_title(&self) -> String {
        self.shield_entry().map_or("MCP2515 board", |entry| boards::text(entry, "title")).to_owned()
    }

    /// The board's entry in the table; `None` if the chip differs.
    fn board_entry(&self) -> Option<&'static Value> {
        let entry = boards::find("boards", &self.board)?;
        (boards::text(entry, "chip") == self.chip.name()).then_some(entry)
    }

    /// The CAN board's entry in the table; `None` if a pin or the crystal differs.
    fn shield_entry(&self) -> Option<&'static Value> {
        let entry = boards::find("shields", &self.shield)?;
        let is = |key: &str, pin: Pin| boards::text(entry, key) == pin.to_string();
        let alike = is("cs", self.cs)
            && is("int", self.int)
            && boards::number(entry, "crystal_mhz") == self.crystal_mhz;
        alike.then_some(entry)
    }
}

/// The whole wiring in one line: "Arduino Uno (ATmega328P), SparkFun CAN-Bus shield: CS D10, INT
/// D2, crystal 16 MHz, servo D9, ...".
impl fmt::Display for Wiring {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}), {}: ", self.board_title(), self.chip, self.shield_title())?;
        write!(f, "CS {}, INT {}, crystal {} MHz; ", self.cs, self.int, self.crystal_mhz)?;
        write!(f, "servo {}", self.servo)?;
        self.outputs.iter().try_for_each(|output| write!(f, " {output}"))?;
        write!(f, ", sensor {}", self.sensor)?;
        let optional = [("light", self.light), ("button", self.button), ("rpm", self.rpm)];
        optional
            .into_iter()
            .filter_map(|(signal, pin)| Some((signal, pin?)))
            .try_for_each(|(signal, pin)| write!(f, ", {signal} {pin}"))?;
        match self.power {
            Some(PowerPins { voltage, current }) => {
                write!(f, ", voltage {voltage}, current {current}")
            }
            None => Ok(()),
        }
    }
}

/// Reads the frequency of a crystal in MHz.
///
/// # Errors
/// If the MCP2515 does not allow the frequency.
pub fn crystal_mhz(text: &str) -> Result<u32, String> {
    let number = text.parse().ok().filter(|mhz| CRYSTALS_MHZ.contains(mhz));
    number.ok_or_else(|| format!("\"{text}\" is not a crystal for an MCP2515: use MHz, 8 or 16"))
}

/// Reads two pins with a comma between them: voltage and current.
fn power_pins(text: &str) -> Result<PowerPins, String> {
    let (voltage, current) =
        text.split_once(',').ok_or_else(|| format!("\"{text}\" is not two pins: use A4,A5"))?;
    Ok(PowerPins { voltage: voltage.parse()?, current: current.parse()? })
}

/// Name of the default preset of features for a chip.
pub fn preset(chip: Chip) -> String {
    boards::text(boards::entry("chips", chip.name()), "preset").to_owned()
}

/// An entry of the table that a user named.
fn entry(kind: &str, name: &str) -> Result<&'static Value> {
    boards::find(kind, name).with_context(|| {
        let what = if kind == "boards" { "board" } else { "CAN board" };
        let names: Vec<&str> = boards::names(kind).collect();
        format!("no {what} is called \"{name}\": use {}", names.join(", "))
    })
}

/// A pin of the table.
fn of_table(name: &str) -> Pin {
    name.parse().unwrap_or_else(|error| panic!("avr-specs/boards.toml: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pin(text: &str) -> Pin {
        text.parse().unwrap()
    }

    /// The section `.board` of the firmware for an Uno with a module.
    const UNO: &str = "board=uno\nshield=module\nmcu=atmega328p\ncs=D10\nint=D2\ncrystal_mhz=8\n\
                       servo=D9\nlight=D3\nbutton=D4\nsensor=A0\npower=A4,A5\n";

    #[test]
    fn pins_have_the_names_of_the_arduino() {
        for (name, port, bit) in
            [("D0", 'D', 0), ("D7", 'D', 7), ("D8", 'B', 0), ("D13", 'B', 5), ("A5", 'C', 5)]
        {
            let pin = pin(name);
            assert_eq!((pin.port(), pin.bit(), &pin.to_string()[..]), (port, bit, name));
        }
        for wrong in ["D14", "A6", "D", "B1", "", "10", "d2", "D+2", "D-1", "DÄ"] {
            let error = wrong.parse::<Pin>().unwrap_err();
            assert!(error.contains("D0 to D13 or A0 to A5"), "{error}");
        }
    }

    #[test]
    fn the_section_and_the_table_agree() {
        let wiring = Wiring::parse(UNO.as_bytes()).unwrap();
        assert_eq!(wiring, Wiring::of("uno", "module").unwrap());
        let of = |wiring: &Wiring| (wiring.chip, wiring.cs, wiring.servo);
        assert_eq!(of(&wiring), (Chip::Atmega328p, pin("D10"), pin("D9")));
        assert_eq!((wiring.crystal_hz(), wiring.fastest_bit_rate()), (8_000_000, 500_000));
        let default = Wiring::default();
        assert_eq!(of(&default), (Chip::Atmega168, pin("D9"), pin("D10")));
        assert_eq!((default.light, default.fastest_bit_rate()), (Some(pin("D3")), 1_000_000));
        let text = "Arduino Uno (ATmega328P), blue MCP2515 module with TJA1050, crystal marked \
                    8.000: CS D10, INT D2, crystal 8 MHz; servo D9, sensor A0, light D3, button \
                    D4, voltage A4, current A5";
        assert_eq!(wiring.to_string(), text);
    }

    #[test]
    fn every_board_can_be_combined_with_every_can_board() {
        for board in boards::names("boards") {
            for shield in boards::names("shields") {
                let wiring = Wiring::of(board, shield).unwrap();
                wiring.check().unwrap();
                assert_eq!((wiring.board_name(), wiring.shield_name()), (board, shield));
            }
        }
        for chip in Chip::ALL {
            assert!(!preset(chip).is_empty());
        }
    }

    #[test]
    fn a_light_and_unknown_keys_are_optional_in_the_section() {
        for light in ["light=\n", "", "colour=blue\n"] {
            let text = UNO.replace("light=D3\n", light);
            assert_eq!(Wiring::parse(text.as_bytes()).unwrap().light, None);
        }
    }

    #[test]
    fn a_program_that_measures_no_circuit_has_no_pins_for_it() {
        let mut wiring = Wiring::parse(UNO.replace("power=A4,A5\n", "").as_bytes()).unwrap();
        assert_eq!(wiring.power, None);
        wiring.set_cs(pin("A4"));
        assert_eq!(wiring.power, None);
    }

    #[test]
    fn a_shaft_takes_the_pin_of_the_light_and_gives_way_to_int() {
        let text = UNO.replace("light=D3\n", "rpm=D3\n");
        let mut wiring = Wiring::parse(text.as_bytes()).unwrap();
        assert_eq!((wiring.light, wiring.rpm), (None, Some(pin("D3"))));
        assert!(wiring.to_string().contains(", rpm D3"), "{wiring}");
        wiring.set_int(pin("D3"));
        assert_eq!(wiring.rpm, None);
        assert_eq!(Wiring::of("uno", "seeed").unwrap().rpm, None);
    }

    #[test]
    fn the_circuit_gets_the_first_two_of_its_pins_that_cs_and_int_leave_free() {
        let mut wiring = Wiring::of("uno", "seeed").unwrap();
        for (cs, int, voltage, current) in [
            ("D9", "D2", "A4", "A5"),
            ("A4", "D2", "A5", "A3"),
            ("A5", "D2", "A4", "A3"),
            ("A3", "D2", "A4", "A5"),
            ("D9", "A4", "A5", "A3"),
        ] {
            wiring.set_cs(pin(cs));
            wiring.set_int(pin(int));
            let expected = PowerPins { voltage: pin(voltage), current: pin(current) };
            assert_eq!(wiring.power, Some(expected), "CS on {cs}, INT on {int}");
            wiring.check().unwrap();
        }
    }

    #[test]
    fn the_error_of_an_invalid_section_names_the_value() {
        for (line, other, expected) in [
            ("cs=D10", "cs=D99", "cs: there is no pin \"D99\""),
            ("mcu=atmega328p", "mcu=8051", "use atmega168 or atmega328p"),
            ("crystal_mhz=8", "crystal_mhz=0", "\"0\" is not a crystal"),
            ("int=D2", "", "has no int"),
            ("int=D2", "int=D10", "INT is on D10, which is CS's"),
            ("int=D2", "int=D13", "INT is on D13, which is SCK's"),
            ("servo=D9", "servo=D6", "only D9 and D10"),
            ("sensor=A0", "sensor=D5", "use A0 to A5"),
            ("power=A4,A5", "power=A4", "use A4,A5"),
            ("power=A4,A5", "power=A4,A9", "power: there is no pin \"A9\""),
            ("power=A4,A5", "power=D5,A5", "the voltage is on D5: use A0 to A5"),
            ("power=A4,A5", "power=A5,A0", "the current is on A0, which is the sensor's"),
            ("power=A4,A5", "rpm=D3", "the shaft is on D3, which is the light's"),
            ("power=A4,A5", "rpm=X3", "rpm: there is no pin \"X3\""),
            (
                "power=A4,A5",
                "outputs=A4\npower=A4,A5",
                "the voltage is on A4, which is an output's",
            ),
        ] {
            let error =
                format!("{:#}", Wiring::parse(UNO.replace(line, other).as_bytes()).unwrap_err());
            assert!(error.contains("section .board") && error.contains(expected), "{error}");
        }
        assert!(Wiring::parse(&[0xFF]).is_err());
    }

    #[test]
    fn other_signals_give_way_to_cs_and_int() {
        let mut wiring = Wiring::of("uno", "seeed").unwrap();
        wiring.set_cs(pin("D10"));
        assert_eq!(wiring.servo, pin("D9"));
        wiring.set_cs(pin("D8"));
        wiring.set_int(pin("D3"));
        assert_eq!((wiring.servo, wiring.light), (pin("D10"), None));
        assert_eq!((wiring.board_name(), wiring.shield_name()), ("uno", "MCP2515 board"));
        wiring.check().unwrap();
        wiring.chip = Chip::Atmega168;
        assert_eq!(wiring.board_title(), "Arduino");
    }
}
