//! Tests of the link for debuggers: avr-gdb attached to a board on the bench.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::avr::{MS, compile_to};
use crate::links::Scratch;
use bench::Bench;
use bench::avr::Avr;
use bench::board::Board;
use sim::links::Link;
use sim::links::gdb::Gdb;

/// Longest real time of a test; a longer one fails.
const LIMIT: Duration = Duration::from_secs(30);

struct Setup {
    bench: Bench,
    gdb: Gdb,
    elf: PathBuf,
    scratch: Scratch,
}

impl Setup {
    /// Two boards with the program debug.c. avr-gdb can attach to the first.
    fn new() -> Setup {
        let scratch = Scratch::new();
        let elf = scratch.path("debug.elf");
        compile_to(&elf, "atmega168", "debug", &[], &["-g", "-Og"]);
        let mut bench = Bench::new(1_000_000);
        for name in ["debugged", "other"] {
            bench.add_board(Board::new(Avr::load(&elf).expect("a program that loads")), name);
        }
        let gdb = Gdb::open(0, &mut bench, 0).expect("a free port");
        Setup { bench, gdb, elf, scratch }
    }

    /// Starts avr-gdb, which attaches and executes the commands, with semicolons between them.
    fn avr_gdb(&self, commands: &str) -> Child {
        let attach = format!("target remote localhost:{}", self.gdb.port());
        let mut command = Command::new("avr-gdb");
        command.args(["-nx", "-batch", "-ex", "set tcp connect-timeout 10", "-ex", &attach]);
        for line in commands.split("; ") {
            command.args(["-ex", line]);
        }
        command.arg(&self.elf).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command.spawn().expect("avr-gdb, which the Makefile installs")
    }

    /// Runs the bench until avr-gdb ends. Returns the text that avr-gdb printed.
    fn until_end(&mut self, mut child: Child) -> String {
        let start = Instant::now();
        while child.try_wait().expect("avr-gdb's state").is_none() {
            if start.elapsed() > LIMIT {
                child.kill().expect("avr-gdb ended");
            }
            self.turn();
        }
        let output = child.wait_with_output().expect("avr-gdb's output");
        let text = [output.stdout, output.stderr].concat();
        let text = String::from_utf8_lossy(&text).into_owned();
        assert!(start.elapsed() < LIMIT, "{text}");
        text
    }

    fn debug(&mut self, commands: &str) -> String {
        self.until_end(self.avr_gdb(commands))
    }

    fn turn(&mut self) {
        self.bench.run_until(self.bench.now() + MS / 10);
        self.gdb.serve(&mut self.bench).expect("the link is served");
    }

    fn turns(&mut self, count: usize) {
        (0..count).for_each(|_| self.turn());
    }

    fn turn_until(&mut self, condition: impl Fn(&Setup) -> bool) {
        let start = Instant::now();
        while !condition(self) {
            assert!(start.elapsed() < LIMIT, "{}", self.gdb.status());
            self.turn();
        }
    }

    /// Waits until no debugger is attached, and checks that the bench runs.
    fn assert_running(&mut self) {
        self.turn_until(|setup| setup.gdb.status().ends_with(": waits for avr-gdb"));
        let before = self.bench.now();
        self.bench.run_for_ms(5);
        assert_eq!(self.bench.now(), before + 5 * MS);
    }
}

#[track_caller]
fn assert_in_order(text: &str, parts: &str) {
    let mut rest = text;
    for part in parts.split(" | ") {
        let Some(at) = rest.find(part) else {
            panic!("{part:?} is missing or out of order in:\n{text}");
        };
        rest = &rest[at + part.len()..];
    }
}

/// The first instructions of a program can be debugged, whenever avr-gdb comes.
#[test]
fn the_board_is_halted_at_its_reset_until_a_debugger_comes() {
    let mut setup = Setup::new();
    setup.turns(20);
    assert_eq!(setup.bench.now(), 0);
    assert!(setup.gdb.status().contains("halted at reset, waits"), "{}", setup.gdb.status());
    let text = setup.debug("print $pc; stepi; detach");
    assert_in_order(&text, "(void (*)()) 0x0 | detached");
    setup.assert_running();
}

#[test]
fn a_breakpoint_shows_arguments_variables_and_callers() {
    let mut setup = Setup::new();
    let text = setup.debug(
        "break inner; continue; backtrace; print rounds; continue; print rounds; finish; \
         info breakpoints; delete; detach",
    );
    assert_in_order(
        &text,
        "Breakpoint 1, inner (depth=7 | #0  inner (depth=7 | #1 | in outer (depth=6 | #2 | \
         in main () | $1 = 0 | Breakpoint 1, inner | $2 = 1 | outer (depth=6 | PORTC = depth | \
         already hit 2 times | detached",
    );
    setup.assert_running();
}

#[test]
fn avr_gdb_steps_by_instruction_and_by_line() {
    let mut setup = Setup::new();
    let text = setup.debug(
        "hbreak outer; continue; print/x $pc; stepi; print $pc != &outer; step; step; step; \
         print rounds; kill",
    );
    assert_in_order(
        &text,
        "Hardware assisted breakpoint 1 | Breakpoint 1, outer | inner (depth= | rounds++",
    );
    setup.assert_running();
}

#[test]
fn registers_and_all_memories_are_read_and_written() {
    let mut setup = Setup::new();
    let text = setup.debug(
        "break inner; continue; set $r5 = 0xA5; set $SREG = 0xC3; info registers r5 SREG SP pc; \
         set var rounds = 4660; print/x rounds; set {unsigned char}0x810007 = 0x5A; \
         x/2xb 0x810007; set {unsigned char}0x800028 = 0x05; x/xb 0x800028; x/i $pc; x/2xh 0; \
         set {unsigned char}0x3000 = 0x42; x/xb 0x3000; x/xb 0x3fff; x/xb 0x900000",
    );
    assert_in_order(
        &text,
        "0xa5 | 0xc3 | SP | <inner | $1 = 0x1234 | 0x5a\t0xff | 0x05 | => 0x | out\t0x05, r24 | \
         0x42 | 0xff | Cannot access memory",
    );
    let avr = setup.bench.board(0).avr();
    assert_eq!(avr.eeprom()[7], 0x5A);
    assert_eq!(avr.flash()[0x3000], 0x42);
}

/// GDB uses the binary packet if the stub supports it, else the hexadecimal one.
#[test]
fn both_packets_write_all_byte_values_to_memory() {
    let mut setup = Setup::new();
    let every_byte: Vec<u8> = (0..=255).collect();
    let file = setup.scratch.path("bytes");
    std::fs::write(&file, &every_byte).expect("a file");
    for (packet, value) in [("off", 0x11), ("on", 0x22)] {
        let file = file.display();
        // Sets other bytes first, so that the test sees what each packet writes.
        setup.bench.board(0).avr_mut().set_eeprom(&[0; 512]);
        setup.bench.board(0).avr_mut().load_flash(0x2000, &[0; 256]);
        let text = setup.debug(&format!(
            "break inner; continue; set remote binary-download-packet {packet}; \
             set {{char}}0x810004 = {value}; set {{char}}0x800304 = {value}; \
             set {{char}}0x003004 = {value}; restore {file} binary 0x810100; \
             restore {file} binary 0x800310; restore {file} binary 0x002000; \
             set {{long}}0x8101fe = 0; delete; detach"
        ));
        assert!(text.contains("Cannot access memory at address 0x8101fe"), "{text}");
        let avr = setup.bench.board(0).avr_mut();
        let eeprom = avr.eeprom();
        assert_eq!((eeprom[4], avr.flash()[0x3004]), (value, value), "{text}");
        assert_eq!(eeprom[0x100..], every_byte, "bytes beyond the end are not written");
        assert_eq!(avr.flash()[0x2000..0x2100], every_byte);
        let debugger = avr.debugger();
        assert_eq!(debugger.data(0x304), Some(value));
        let data: Vec<u8> = (0x310..0x410).map(|address| debugger.data(address).unwrap()).collect();
        assert_eq!(data, every_byte);
    }
}

#[test]
fn an_interrupt_from_the_keyboard_halts_a_running_program() {
    let mut setup = Setup::new();
    let commands =
        "continue; print rounds > 0; print ticks > 0; print/x $pc; break inner; continue";
    let child = setup.avr_gdb(commands);
    setup.turn_until(|setup| setup.gdb.status().contains("attached"));
    setup.turns(50);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill");
    assert!(sent.success());
    let text = setup.until_end(child);
    // Does not use a backtrace: in the last instructions of a function avr-gdb may not find the
    // caller.
    assert_in_order(
        &text,
        "Program received signal SIGINT | $1 = 1 | $2 = 1 | $3 = 0x | Breakpoint 1, inner",
    );
    setup.assert_running();
}

#[test]
fn the_whole_bench_stops_while_the_chip_is_halted() {
    let mut setup = Setup::new();
    let stream = TcpStream::connect(("localhost", setup.gdb.port())).expect("the port");
    setup.turn_until(|setup| setup.gdb.status().contains("halted by avr-gdb"));
    let (before, others) = (setup.bench.now(), setup.bench.board(1).now());
    setup.bench.run_for_ms(100);
    assert_eq!((setup.bench.now(), setup.bench.board(1).now()), (before, others));
    // The program runs again when the debugger ends without detaching.
    drop(stream);
    setup.assert_running();
    assert!(setup.bench.board(1).now() > before);
}

#[test]
fn invalid_packets_do_no_harm() {
    let mut setup = Setup::new();
    let mut stream = TcpStream::connect(("localhost", setup.gdb.port())).expect("the port");
    stream
        .write_all(b"$m0,ffffffff#00$\xff\x00}}#zz$Z0,ffffffff,2#2b$G00#d7$m3fff,100#5b+")
        .expect("sent");
    setup.turn_until(|setup| !setup.gdb.status().contains("waits"));
    setup.turns(20);
    drop(stream);
    setup.assert_running();
    assert!(setup.debug("break inner; continue").contains("Breakpoint 1, inner"));
}

#[test]
fn a_second_debugger_waits_until_the_first_ends() {
    let mut setup = Setup::new();
    let first = TcpStream::connect(("localhost", setup.gdb.port())).expect("the port");
    setup.turn_until(|setup| setup.gdb.status().contains("halted"));
    let second = setup.avr_gdb("print rounds");
    drop(first);
    assert!(setup.until_end(second).contains("$1 = "));
}

#[test]
fn the_error_of_a_port_in_use_names_it() {
    let mut setup = Setup::new();
    let port = setup.gdb.port();
    let error = Gdb::open(port, &mut setup.bench, 0).err().expect("an error");
    let text = format!("{error:#}");
    assert!(text.contains(&port.to_string()) && text.contains("in use"), "{text}");
}

#[test]
fn breakpoints_of_one_board_do_not_stop_the_other() {
    let mut setup = Setup::new();
    let text = setup.debug("break inner; continue; ignore 1 98; continue; print rounds");
    assert_in_order(&text, "Breakpoint 1, inner | $1 = 99");
    let mut answer = Vec::new();
    let mut stream = TcpStream::connect(("localhost", setup.gdb.port())).expect("the port");
    stream.set_nonblocking(true).expect("a socket");
    stream.write_all(b"$?#3f").expect("sent");
    setup.turn_until(|setup| setup.gdb.status().contains("halted"));
    for _ in 0..20 {
        setup.turn();
        let _ = stream.read_to_end(&mut answer);
    }
    assert!(
        answer.starts_with(b"+$S05#b8") || answer.starts_with(b"+$T05"),
        "{}",
        String::from_utf8_lossy(&answer)
    );
}
