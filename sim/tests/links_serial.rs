//! Tests of the Arduino's serial port with clients that open it.

use crate::avr::{MS, program};
use crate::links::{Client, Scratch};
use anyhow::Result;
use bench::Bench;
use bench::avr::{Avr, ResetCause};
use bench::board::Board;
use sim::links::Link;
use sim::links::serial::SerialPort;
use std::path::{Path, PathBuf};

/// A board with an echoing program, and its port.
struct Stand {
    bench: Bench,
    port: SerialPort,
    path: PathBuf,
    _scratch: Scratch,
}

impl Stand {
    /// A board with the program `echo`, and its port, whose baud rate does not matter.
    fn new() -> Stand {
        Stand::with_port(program("echo", &[]), |path| SerialPort::open(path, 0, None, true))
    }

    /// The same, with a client at the port 5 ms later.
    fn opened() -> (Stand, Client) {
        let mut stand = Stand::new();
        let client = Client::open(&stand.path);
        stand.run_ms(5);
        (stand, client)
    }

    /// With the port that `open` makes.
    fn with_port(avr: Avr, open: impl Fn(&Path) -> Result<SerialPort>) -> Stand {
        let scratch = Scratch::new();
        let path = scratch.path("arduino");
        let mut bench = Bench::new(1_000_000);
        bench.add_board(Board::new(avr), "node");
        let port = open(&path).unwrap();
        Stand { bench, port, path, _scratch: scratch }
    }

    fn run_ms(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.bench.run_for_ms(1);
            let avr = self.bench.board(0).avr_mut();
            let bytes = avr.serial_take();
            let rate = avr.serial_sent_rate();
            self.port.serial_output(0, &bytes, rate);
            self.port.serve(&mut self.bench).unwrap();
        }
    }

    fn resets(&mut self) -> Vec<ResetCause> {
        self.bench.board(0).avr().resets().iter().map(|reset| reset.cause).collect()
    }
}

/// Also `stty`, which opens and closes it without writing.
#[test]
fn opening_the_port_resets_the_board_each_time() {
    let mut stand = Stand::new();
    stand.run_ms(5);
    assert_eq!(stand.resets(), [ResetCause::PowerOn]);
    let client = Client::open(&stand.path);
    stand.run_ms(5);
    assert_eq!(stand.resets(), [ResetCause::PowerOn, ResetCause::External]);
    drop(client);
    stand.run_ms(5);
    drop(Client::open(&stand.path));
    stand.run_ms(5);
    assert_eq!(stand.resets().len(), 3);
}

/// ravedude's console does so after avrdude. The second program must not get bytes for the first.
#[test]
fn a_program_that_opens_the_port_at_once_after_another_resets_the_board_too() {
    let mut stand = Stand::new();
    stand.run_ms(5);
    let mut client = Client::open(&stand.path);
    stand.run_ms(5);
    client.write(b"unread");
    stand.run_ms(2);
    for resets in 3..6 {
        drop(client);
        client = Client::open(&stand.path);
        stand.run_ms(5);
        assert_eq!(stand.resets().len(), resets);
        assert_eq!(client.read(), b"ready\n");
        client.write(b"unread");
        stand.run_ms(2);
    }
    assert!(stand.port.status().contains("in use, opened 4 times"), "{}", stand.port.status());
}

/// DTR is raised already.
#[test]
fn a_second_program_at_an_open_port_does_not_reset_the_board() {
    let (mut stand, first) = Stand::opened();
    assert_eq!(stand.resets().len(), 2);
    let mut second = Client::open(&stand.path);
    drop(Client::open(&stand.path));
    stand.run_ms(5);
    drop(first);
    stand.run_ms(5);
    assert_eq!(stand.resets().len(), 2);
    second.write(b"still there");
    stand.run_ms(5);
    assert!(second.read().ends_with(b"still there"));
    drop(second);
    let _third = Client::open(&stand.path);
    stand.run_ms(5);
    assert_eq!(stand.resets().len(), 3);
}

#[test]
fn bytes_pass_at_the_baud_rate_in_both_directions() {
    let (mut stand, mut client) = Stand::opened();
    assert_eq!(client.read(), b"ready\n");
    let text: Vec<u8> = (0..100).collect();
    client.write(&text);
    // 100 characters of ten bits at 115 200 bits per second are 8.7 ms.
    stand.run_ms(7);
    let early = client.read();
    assert!((50..90).contains(&early.len()), "{} bytes", early.len());
    stand.run_ms(5);
    assert_eq!([early, client.read()].concat(), text);
}

/// `echo text > port` closes the port before the link is served.
#[test]
fn the_board_gets_the_bytes_of_a_program_that_closes_the_port_at_once() {
    let mut stand = Stand::new();
    stand.run_ms(5);
    Client::open(&stand.path).write(b"hello");
    stand.run_ms(5);
    assert_eq!(stand.resets().len(), 2);
    assert_eq!(stand.bench.board(0).avr().serial_unsent(), 0, "the board got it");
}

#[test]
fn a_program_that_never_reads_does_not_stop_the_simulation() {
    let (mut stand, mut client) = Stand::opened();
    let flood = [b'x'; 4096];
    for _ in 0..9000 {
        client.write_some(&flood);
        stand.run_ms(1);
    }
    assert!(stand.bench.now() >= 9000 * MS);
    assert!(!stand.port.status().contains(" 0 bytes lost"), "{}", stand.port.status());
}

/// A board whose receiver is off takes no bytes. They must not wait for its next program.
#[test]
fn bytes_that_the_board_does_not_take_are_dropped() {
    let mut stand =
        Stand::with_port(program("spin", &[]), |path| SerialPort::open(path, 0, None, true));
    let mut client = Client::open(&stand.path);
    stand.run_ms(5);
    client.write(b"lost");
    stand.run_ms(300);
    assert_eq!(stand.bench.board(0).avr().serial_unsent(), 0);
    assert!(stand.port.status().contains(" 4 bytes lost"), "{}", stand.port.status());
}

/// A program that reads at 115,200 baud, and echoes.
#[test]
fn both_sides_read_garbage_if_the_client_has_another_baud_rate() {
    let mut stand =
        Stand::with_port(program("echo", &[]), |path| SerialPort::open(path, 0, None, false));
    for (baud, is_read) in [(57_600, false), (115_200, true), (230_400, false), (117_000, true)] {
        let mut client = Client::open(&stand.path);
        client.set_baud(baud);
        stand.run_ms(5);
        assert_eq!(client.read() == b"ready\n", is_read, "{baud} baud to the client");
        client.write(b"echo");
        stand.run_ms(5);
        // What the board has read comes back without the mistakes of the client's receiver.
        client.set_baud(115_200);
        stand.run_ms(1);
        client.write(b"!");
        stand.run_ms(5);
        let read = client.read();
        assert_eq!(read == b"echo!", is_read, "{baud} baud to the board: {read:?}");
    }
    let hint = stand.port.take_hint().unwrap();
    assert!(hint.contains("57600 baud. The board has 117647"), "{hint}");
}

#[test]
fn a_client_that_sets_no_baud_rate_is_told_once() {
    let mut stand =
        Stand::with_port(program("echo", &[]), |path| SerialPort::open(path, 0, None, false));
    for time in 0..2 {
        let mut client = Client::open(&stand.path);
        stand.run_ms(5);
        assert_ne!(client.read(), b"ready\n");
        client.write(b"Is anybody there?");
        stand.run_ms(50);
        let hint = stand.port.take_hint();
        let is_told = hint.as_ref().is_some_and(|hint| hint.contains("stty -F"));
        assert_eq!(is_told, time == 0, "{hint:?}");
    }
}

#[test]
fn a_client_gets_time_while_a_bootloader_waits_for_its_next_byte() {
    for boot_section in [Some(0), Some(0x7C00), None] {
        let mut stand = Stand::with_port(program("echo", &[]), |path| {
            SerialPort::open(path, 0, boot_section, true)
        });
        let mut client = Client::open(&stand.path);
        stand.run_ms(5);
        assert!(!stand.port.gives_time(), "a client that only listens");
        client.write(b"x");
        stand.run_ms(5);
        let is_bootloader = boot_section == Some(0);
        assert_eq!(stand.port.gives_time(), is_bootloader, "{boot_section:?}");
        client.write(&[b'x'; 100]);
        stand.run_ms(2);
        assert!(!stand.port.gives_time(), "bytes are on their way");
        drop(client);
        stand.run_ms(20);
        assert!(!stand.port.gives_time(), "nobody is there");
    }
}
