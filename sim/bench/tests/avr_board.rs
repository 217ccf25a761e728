//! Tests of the board's wiring and of the bench's run loop, with a small program that uses the
//! MCP2515.

use std::cell::RefCell;
use std::rc::Rc;

use crate::avr::{MS, US, byte, program, program_for, word};
use bench::Bench;
use bench::avr::{Chip, ResetCause, State};
use bench::board::Board;
use bench::can::{Frame, SoftNode};
use bench::wiring::Wiring;

const BIT_RATE: u32 = 1_000_000;

struct Setup {
    bench: Bench,
    peer: Rc<RefCell<SoftNode>>,
}

impl Setup {
    /// A board with the program mcp2515.c, which is on the bus, and a peer.
    fn new() -> Setup {
        let mut bench = Bench::new(BIT_RATE);
        bench.add_board(Board::new(program("mcp2515", &[])), "board");
        let peer = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
        bench.attach("peer", peer.clone());
        bench.run_for_ms(2);
        Setup { bench, peer }
    }

    fn send(&mut self, first: u8) {
        self.peer.borrow_mut().send(Frame::extended(0x1234_5678, &[first, 2, 3]));
    }

    /// Answers since the last call.
    fn answers(&mut self) -> Vec<Frame> {
        self.peer.borrow_mut().take_received().into_iter().map(|(_, frame)| frame).collect()
    }

    #[track_caller]
    fn assert_no_violation(&mut self) {
        assert_eq!(self.bench.board(0).take_violations(), []);
    }
}

#[test]
fn the_answer_starts_when_the_program_requests_it() {
    let mut setup = Setup::new();
    setup.bench.bus().take_records();
    setup.send(1);
    setup.bench.run_for_ms(1);
    let records = setup.bench.bus().take_records();
    assert_eq!(records.len(), 2);
    // The program needs about 14 SPI bytes of 2 us and some instructions in between.
    let pause = records[1].start - records[0].end;
    assert!((20 * US..100 * US).contains(&pause), "{} us", pause / US);
}

#[test]
fn a_reset_of_the_avr_keeps_the_time_and_the_chip() {
    let mut setup = Setup::new();
    let before = setup.bench.now();
    setup.bench.board(0).reset(ResetCause::External);
    assert_eq!(setup.bench.board(0).chip().borrow().mode(), bench::mcp2515::Mode::Normal);
    setup.bench.run_for_ms(2);
    assert_eq!(setup.bench.now(), before + 2 * MS);
    let board_time = setup.bench.board(0).now();
    assert!((before + 2 * MS..before + 2 * MS + 8).contains(&board_time));
    setup.send(5);
    setup.bench.run_for_ms(1);
    assert_eq!(setup.answers(), [Frame::standard(0x123, &[6])]);
    setup.assert_no_violation();
}

#[test]
fn waiting_ends_when_the_condition_holds_or_at_the_time_out() {
    let mut setup = Setup::new();
    setup.send(5);
    let start = setup.bench.now();
    let frames = |bench: &mut Bench| byte(bench.board(0).avr(), "frames");
    assert!(setup.bench.run_until_or(|bench| frames(bench) == 1, MS));
    assert!(setup.bench.now() < start + 200 * US);
    assert!(!setup.bench.run_until_or(|bench| frames(bench) == 2, MS));
    assert!(setup.bench.now() < start + 1300 * US);
}

#[test]
fn a_chip_without_power_gives_the_level_of_miso_and_works_with_power_again() {
    for miso in [0x00, 0xFF] {
        let mut bench = Bench::new(BIT_RATE);
        let mut board = Board::new(program("mcp2515", &[]));
        board.chip_power_off(miso);
        bench.add_board(board, "board");
        bench.run_for_ms(2);
        assert_eq!(byte(bench.board(0).avr(), "canstat"), miso);
        assert!(bench.board(0).avr().pin('D', 2), "INT");
        bench.board(0).chip_power_on();
        bench.board(0).reset(ResetCause::External);
        bench.run_for_ms(2);
        assert_eq!(byte(bench.board(0).avr(), "canstat"), 0x80);
    }
}

#[test]
fn in_a_wrong_spi_mode_or_with_noise_the_chip_does_not_answer_and_the_mode_is_a_violation() {
    let run = |defines: &[&str], noise| {
        let mut board = Board::new(program("mcp2515", defines));
        board.set_spi_noise(noise, 1);
        board.run_until(MS);
        let violations = board.take_violations();
        let texts: Vec<String> = violations.into_iter().map(|one| one.text).collect();
        (byte(board.avr(), "canstat"), texts)
    };
    let (canstat, texts) = run(&["SPI_MODE_BITS=_BV(CPHA)"], 0);
    assert_eq!(canstat, 0xFF);
    assert!(texts.iter().any(|text| text.contains("SPI mode 1")), "{texts:?}");
    assert_eq!(run(&["SPI_MODE_BITS=(_BV(CPOL)|_BV(CPHA))"], 0).0, 0x80);
    assert_ne!(run(&[], 300_000).0, 0x80);
}

#[test]
fn the_sensor_reads_ten_millivolts_per_degree() {
    let mut board = Board::new(program("adc", &[]));
    for (celsius, expected) in [(0.0, 0), (25.0, 51), (100.0, 205), (-5.0, 0)] {
        board.set_temperature_c(celsius);
        board.run_until(board.now() + MS);
        assert_eq!(word(board.avr(), "result"), expected, "{celsius} degrees");
    }
}

#[test]
fn the_button_closes_to_ground() {
    let mut board = Board::new(program("pins", &[]));
    let mut reads_low = |pressed| {
        board.press_button(pressed);
        board.run_until(board.now() + MS);
        byte(board.avr(), "pind") & 1 << 4 == 0
    };
    assert!(!reads_low(false));
    assert!(reads_low(true));
    assert!(!reads_low(false));
}

#[test]
fn the_servo_s_pulses_are_measured_on_either_output_of_timer1() {
    let pulses = |define: &[&str], servo: &str| {
        let mut wiring = Wiring::default();
        wiring.set_cs("D8".parse().unwrap());
        wiring.servo = servo.parse().unwrap();
        let mut board = Board::wired(program("servo", define), &wiring).unwrap();
        assert_eq!(board.run_until(22 * MS), State::Running);
        board.take_servo_pulses()
    };
    let on_d10 = pulses(&[], "D10");
    assert!(on_d10.len() >= 3, "{on_d10:?}");
    assert!(on_d10.iter().all(|pulse| pulse.width_us() >= 500.0), "{on_d10:?}");
    assert_eq!(pulses(&["ON_OC1A"], "D9"), on_d10);
    assert_eq!(pulses(&["ON_OC1A"], "D10"), []);
}

#[test]
fn the_wiring_of_a_board_sets_its_pins_and_its_crystal() {
    let d8 = ["CS_PORT=PORTB", "CS_DDR=DDRB", "CS_BIT=PB0", "INT_BIT=PD3"];
    let d10 = ["CS_PORT=PORTB", "CS_DDR=DDRB", "CS_BIT=PB2"];
    let a1 = ["CS_PORT=PORTC", "CS_DDR=DDRC", "CS_BIT=PC1"];
    for chip in Chip::ALL {
        for (cs, int, crystal_mhz, defines) in [
            ("D8", "D3", 16, d8.as_slice()),
            ("D10", "D2", 8, &d10),
            ("A1", "D2", 8, &a1),
            ("D9", "D2", 8, &[]),
        ] {
            let mut wiring = Wiring { chip, crystal_mhz, ..Wiring::default() };
            wiring.set_cs(cs.parse().unwrap());
            wiring.set_int(int.parse().unwrap());
            let bit_rate = if crystal_mhz == 8 { 500_000 } else { 1_000_000 };
            let mut bench = Bench::new(bit_rate);
            let avr = program_for(chip, "mcp2515", defines);
            bench.add_board(Board::wired(avr, &wiring).unwrap(), "board");
            let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
            bench.attach("peer", peer.clone());
            bench.run_for_ms(2);
            peer.borrow_mut().send(Frame::standard(0x7, &[4]));
            bench.run_for_ms(1);
            let answers: Vec<Frame> =
                peer.borrow_mut().take_received().into_iter().map(|(_, frame)| frame).collect();
            assert_eq!(answers, [Frame::standard(0x123, &[5])], "{wiring}");
            assert_eq!(bench.board(0).take_violations(), [], "{wiring}");
        }
    }
}

#[test]
fn a_program_for_another_cs_selects_nothing() {
    let mut wiring = Wiring::default();
    wiring.set_cs("D8".parse().unwrap());
    let mut board = Board::wired(program("mcp2515", &[]), &wiring).unwrap();
    board.run_until(MS);
    assert_ne!(byte(board.avr(), "canstat"), 0x80);
    let spi = board.spi_use();
    assert_eq!((spi.selects, spi.bytes), (0, 0));
    assert!(spi.bytes_elsewhere > 0);
    // The bytes could be for another device on the same SPI, so they are not a mistake.
    assert_eq!(board.take_violations(), []);
}

#[test]
fn an_impossible_wiring_is_rejected() {
    let mut wiring = Wiring::default();
    wiring.servo = wiring.cs;
    let error = Board::wired(program("servo", &[]), &wiring).err().unwrap().to_string();
    assert_eq!(error, "the servo is on D9, which is CS's");
}

/// A panic in a callback of simavr must fail the test, not abort the process.
#[test]
#[should_panic = "on purpose"]
fn a_panic_in_a_watcher_reaches_the_test() {
    let mut avr = program("pins", &[]);
    avr.watch_pin('B', 1, Box::new(|_, _| panic!("on purpose")));
    avr.run_until(MS);
}

/// The program answers when INT is low.
#[test]
fn a_shorted_int_line_keeps_its_level_until_the_short_ends() {
    let mut setup = Setup::new();
    setup.bench.board(0).set_stuck_int(Some(true));
    setup.send(1);
    setup.bench.run_for_ms(1);
    assert_eq!(setup.answers(), [], "the program gets no interrupt");
    setup.bench.board(0).set_stuck_int(None);
    setup.bench.run_for_ms(1);
    assert_eq!(setup.answers(), [Frame::standard(0x123, &[2])]);
    setup.assert_no_violation();
}

#[test]
fn a_shorted_miso_reads_its_level_whatever_the_chip_answers() {
    let mut setup = Setup::new();
    for (miso, canstat) in [(Some(0xFF), 0xFF), (Some(0x00), 0x00), (None, 0x80)] {
        setup.bench.board(0).set_stuck_miso(miso);
        setup.bench.board(0).reset(ResetCause::PowerOn);
        setup.bench.run_for_ms(2);
        assert_eq!(byte(setup.bench.board(0).avr(), "canstat"), canstat);
    }
}

#[test]
fn the_circuit_s_inputs_are_at_0_v_until_they_are_set() {
    let board = |channel: &str, pins: &str| {
        let wiring = format!(
            "board=uno\nshield=seeed\nmcu=atmega328p\ncs=D9\nint=D2\ncrystal_mhz=16\nservo=D10\n\
             sensor=A0\n{pins}"
        );
        let avr = program_for(Chip::Atmega328p, "adc", &[channel]);
        Board::wired(avr, &Wiring::parse(wiring.as_bytes()).unwrap()).unwrap()
    };
    let measured = |board: &mut Board| {
        board.run_until(board.now() + MS);
        word(board.avr(), "result")
    };
    for (channel, expected) in [("CHANNEL=4", 256), ("CHANNEL=5", 512)] {
        let mut with = board(channel, "power=A4,A5\n");
        assert_eq!(measured(&mut with), 0, "{channel}");
        with.set_circuit_millivolts(1250, 2500);
        assert_eq!(measured(&mut with), expected, "{channel}");
        let mut without = board(channel, "");
        without.set_circuit_millivolts(1250, 2500);
        assert_eq!(measured(&mut without), 0, "{channel}");
    }
}
