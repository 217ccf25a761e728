//! Tests of the Arduino's serial port with clients that open it.

use crate::avr::program;
use crate::links::{Client, MS, Scratch};
use bench::Bench;
use bench::avr::{Avr, ResetCause};
use bench::board::Board;
use sim::links::Link;
use sim::links::serial::SerialPort;
use std::path::PathBuf;

/// A board with an echoing program, and its port.
struct Stand {
    bench: Bench,
    port: SerialPort,
    path: PathBuf,
    _scratch: Scratch,
}

impl Stand {
    fn new(avr: Avr) -> Stand {
        let scratch = Scratch::new();
        let path = scratch.path("arduino");
        let mut bench = Bench::new(1_000_000);
        bench.add_board(Board::new(avr), "node");
        let port = SerialPort::open(&path, 0).unwrap();
        Stand { bench, port, path, _scratch: scratch }
    }

    fn run_ms(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.bench.run_for_ms(1);
            let bytes = self.bench.board(0).avr_mut().serial_take();
            self.port.serial_output(0, &bytes);
            self.port.serve(&mut self.bench).unwrap();
        }
    }

    fn resets(&mut self) -> Vec<ResetCause> {
        self.bench.board(0).avr().resets().iter().map(|reset| reset.cause).collect()
    }
}

#[test]
fn opening_the_port_resets_the_board_each_time() {
    let mut stand = Stand::new(program("echo", &[]));
    stand.run_ms(5);
    assert_eq!(stand.resets(), [ResetCause::PowerOn]);
    let client = Client::open(&stand.path);
    stand.run_ms(5);
    assert_eq!(stand.resets(), [ResetCause::PowerOn, ResetCause::External]);
    drop(client);
    stand.run_ms(5);
    let _client = Client::open(&stand.path);
    stand.run_ms(5);
    assert_eq!(stand.resets().len(), 3);
}

/// ravedude's console does so after avrdude. The second program must not get bytes for the first.
#[test]
fn a_program_that_opens_the_port_at_once_after_another_resets_the_board_too() {
    let mut stand = Stand::new(program("echo", &[]));
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
    let mut stand = Stand::new(program("echo", &[]));
    let first = Client::open(&stand.path);
    stand.run_ms(5);
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

/// `stty` does so.
#[test]
fn a_program_that_opens_and_closes_the_port_without_writing_resets_the_board() {
    let mut stand = Stand::new(program("echo", &[]));
    stand.run_ms(5);
    drop(Client::open(&stand.path));
    stand.run_ms(5);
    assert_eq!(stand.resets(), [ResetCause::PowerOn, ResetCause::External]);
}

#[test]
fn bytes_pass_at_the_baud_rate_in_both_directions() {
    let mut stand = Stand::new(program("echo", &[]));
    let mut client = Client::open(&stand.path);
    stand.run_ms(5);
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
    let mut stand = Stand::new(program("echo", &[]));
    stand.run_ms(5);
    Client::open(&stand.path).write(b"hello");
    stand.run_ms(5);
    assert_eq!(stand.resets().len(), 2);
    assert_eq!(stand.bench.board(0).avr().serial_unsent(), 0, "the board got it");
}

#[test]
fn a_program_that_never_reads_does_not_stop_the_simulation() {
    let mut stand = Stand::new(program("echo", &[]));
    let mut client = Client::open(&stand.path);
    stand.run_ms(5);
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
    let mut stand = Stand::new(program("spin", &[]));
    let mut client = Client::open(&stand.path);
    stand.run_ms(5);
    client.write(b"lost");
    stand.run_ms(300);
    assert_eq!(stand.bench.board(0).avr().serial_unsent(), 0);
    assert!(stand.port.status().contains(" 4 bytes lost"), "{}", stand.port.status());
}
