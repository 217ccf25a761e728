//! A wire to the MCP2515, a wire of the bus, or the crystal is wrong: a line of the serial monitor
//! names it. docs/trouble.md has the lines.

use std::cell::RefCell;
use std::rc::Rc;

use bench::board::{Wire, WrongWire};
use bench::can::{Fault, SoftNode};
use bench::mcp2515::Mcp2515;
use rig::{MS, Program, Rig};

use Wire::{Cs, Int, Sck, Si, So};
use WrongWire::{High, Low, Open, Swapped};

/// What SO reads while nothing drives it.
const UNDRIVEN: [u8; 2] = [0x00, 0xFF];

/// Each fault of one wire and of two.
fn faults() -> Vec<WrongWire> {
    let wires = [Cs, Int, Si, So, Sck];
    let of_one = wires.into_iter().flat_map(|wire| [Open(wire), Low(wire), High(wire)]);
    let pairs = wires.into_iter().enumerate();
    let of_two = pairs
        .flat_map(|(n, one)| wires.into_iter().skip(n + 1).map(move |other| Swapped(one, other)));
    of_one.chain(of_two).collect()
}

/// Only INT is wrong: the chip can be accessed.
fn is_int_only(fault: WrongWire) -> bool {
    matches!(fault, Open(Int) | Low(Int) | High(Int))
}

fn break_wire(rig: &mut Rig, fault: WrongWire, undriven: u8) {
    // The driver does not know what the chip hears.
    rig.violations_expected = true;
    rig.overflows_expected = true;
    rig.board().set_wrong_wire(Some(fault), undriven);
}

#[test]
fn a_wrong_wire_of_the_spi_is_named_from_the_start_on_and_later() {
    let cs = rig::board().cs;
    for fault in faults().into_iter().filter(|&fault| !is_int_only(fault)) {
        for undriven in UNDRIVEN {
            let mut rig = Rig::powered();
            break_wire(&mut rig, fault, undriven);
            rig.wait_for_line(&format!("CS {cs} SI SO SCK 5V? ("), 300);
            assert_eq!(rig.pulses, [], "{fault:?}");

            let mut rig = Rig::running();
            break_wire(&mut rig, fault, undriven);
            // Within a second the monitor tells one line about the controller.
            rig.wait_for_line(&format!("CS {cs} SI SO SCK 5V? ("), 500 + 1000);
            rig.board().set_wrong_wire(None, undriven);
            rig.wait_for_line("CAN: running", 300 + 1000);
        }
    }
}

/// INT on another pin is open for the program.
#[test]
fn without_int_the_node_says_so_and_follows_each_command() {
    for (program, fault) in [Program::Preset, Program::Full]
        .into_iter()
        .flat_map(|program| [Open(Int), Low(Int), High(Int)].map(|fault| (program, fault)))
    {
        let mut rig = program.powered();
        break_wire(&mut rig, fault, 0xFF);
        rig.run_ms(500);
        rig.send_command(1, 0, 0.0);
        rig.run_ms(50);
        assert!(rig.serial.contains("INT open or shorted"), "{fault:?}\n{}", rig.serial);
        rig.forget();
        let lost = rig.board().chip().borrow().rx_overflows();
        for n in 0..60u16 {
            let value = if n % 2 == 0 { 0.5 } else { -0.5 };
            rig.send_command(1, 0, value);
            let end = rig.now() + 45 * MS;
            while rig.now() < end {
                rig.send_status_from(10);
                rig.run_ms(5);
            }
            let width = rig.pulses.last().map(|pulse| pulse.width_us());
            assert_eq!(width, Some(1500.0 + 500.0 * f64::from(value)), "{fault:?}, command {n}");
        }
        assert_eq!(rig.board().chip().borrow().rx_overflows(), lost, "{fault:?}");
        assert!(rig.statuses().len() >= 2, "{fault:?}");
        assert!(!rig.serial.contains("CAN: running"), "{fault:?}\n{}", rig.serial);
        assert_eq!(rig.board().avr().resets().len(), 1, "only the power-on");
    }
}

/// Open, or shorted to ground: the module has no supply.
#[test]
fn a_missing_supply_of_the_module_is_named_from_the_start_on_and_later() {
    let cs = rig::board().cs;
    for undriven in UNDRIVEN {
        for mut rig in [Rig::powered(), Rig::running()] {
            rig.violations_expected = true;
            rig.overflows_expected = true;
            rig.board().chip_power_off(undriven);
            rig.wait_for_line(&format!("CS {cs} SI SO SCK 5V? ("), 500 + 1000);
        }
    }
}

#[test]
fn a_supply_of_the_module_that_dips_is_named() {
    let mut rig = Rig::running();
    rig.violations_expected = true;
    rig.overflows_expected = true;
    rig.board().chip_brown_out(1);
    rig.wait_for_line("5V? MCP2515 settings lost", 50);
    rig.wait_for_line("CAN: running", 200 + 1000);
}

/// One of the two is open, or they are exchanged: neither side hears the other. A transceiver whose
/// high and low are exchanged drives the bus the wrong way round, which the others take for
/// recessive.
#[test]
fn an_open_or_exchanged_wire_of_the_bus_is_named_from_the_start_on_and_later() {
    for (mut rig, line) in
        [(Rig::powered(), "CAN H/L: not sent (1)"), (Rig::running(), "CAN H/L: error-passive")]
    {
        let port = rig.bench.port(0);
        rig.bench.bus().connect(port, false);
        rig.wait_for_line(line, 1500);
    }
}

/// High is at 5 V: the bus is always dominant.
#[test]
fn a_short_that_makes_the_bus_dominant_is_named_from_the_start_on_and_later() {
    for (mut rig, before_ms, line) in [
        (Rig::powered(), 0, "CAN H/L: never idle (128)"),
        (Rig::running(), 0, "CAN H/L: never idle (128)"),
        (Rig::running(), 1500, "CAN H/L: error-passive"),
    ] {
        rig.run_ms(before_ms);
        rig.bench.bus().inject(Fault::StuckDominant(true));
        rig.wait_for_line(line, 1000);
    }
}

/// High and low are shorted, high is at ground, or low at 5 V: the bus is always recessive.
#[test]
fn a_short_that_makes_the_bus_recessive_is_named_from_the_start_on_and_later() {
    for mut rig in [Rig::powered(), Rig::running()] {
        rig.bench.bus().inject(Fault::StuckRecessive(true));
        rig.wait_for_line("CAN H/L: bus-off", 4000);
        rig.run_ms(100);
        assert!(rig.serial.contains("CAN H/L: error-passive"), "{}", rig.serial);
    }
}

/// A node with a crystal of half the frequency that its program is for, or of twice: 8 MHz for 16,
/// or 16 for 8. Its parameter says `fastest` or half of that, so that the chip stays within its
/// limits. Returns the bit rate of the bus, too, which is the parameter.
fn with_wrong_crystal(is_half: bool) -> (u32, Rig) {
    let fastest = rig::board().fastest_bit_rate();
    let mut rig = Rig::running();
    let bit_rate = if is_half { fastest } else { fastest / 2 };
    rig.set("CAN_BAUDRATE", i64::from(bit_rate));
    rig.save();
    let eeprom = rig.board().avr().eeprom();
    let mut rig = Rig::on_bus_of(bit_rate, &Program::Preset.elf(), &[&eeprom]);
    let right = rig.board().wiring().crystal_hz();
    let crystal = if is_half { right / 2 } else { right * 2 };
    *rig.board().chip().borrow_mut() = Mcp2515::new(crystal);
    (bit_rate, rig)
}

/// The others send ten frames a second.
#[test]
fn a_wrong_crystal_is_named_beside_other_nodes() {
    for is_half in [true, false] {
        let (bit_rate, mut rig) = with_wrong_crystal(is_half);
        rig.bench.attach("other", Rc::new(RefCell::new(SoftNode::new(bit_rate))));
        for _ in 0..20 {
            rig.send_status_from(10);
            rig.run_ms(100);
        }
        let line = "another bit rate or crystal";
        assert!(rig.serial.contains(line), "half: {is_half}\n{}", rig.serial);
    }
}

/// Without another node a wrong crystal looks like a right one.
#[test]
fn alone_on_the_bus_a_node_with_a_wrong_crystal_says_what_one_with_the_right_says() {
    for is_half in [true, false] {
        let (_, mut rig) = with_wrong_crystal(is_half);
        let peer = rig.peer_port;
        rig.bench.bus().connect(peer, false);
        rig.wait_for_line("CAN: running", 100);
        rig.wait_for_line("CAN H/L: not sent (", 2600);
        assert!(!rig.serial.contains("crystal"), "half: {is_half}\n{}", rig.serial);
    }
}
