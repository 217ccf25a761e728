//! A board with the bootloader, on a bus with a file server.
//!
//! This file states addresses, layouts and the CRC itself, and imports none of them from the
//! bootloader.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use bench::avr::{Avr, Firmware, ResetCause};
use bench::board::Board;
use bench::can::{Event, Frame, Id, SoftNode};
use bench::dronecan::{Assembler, CanId, NodeId, Outcome, Transfer, TransferId, crc, split};
use bench::{Bench, bootloader, eeprom_after_first_start};
use rig::MS;

pub use super::update_files::*;

/// Node IDs: of a node without a record in EEPROM, and of the server.
pub const NODE: u8 = 120;
pub const SERVER: u8 = 127;

pub const NODE_STATUS: u16 = 341;
pub const GET_NODE_INFO: u8 = 1;
pub const RESTART_NODE: u8 = 5;
pub const BEGIN_FIRMWARE_UPDATE: u8 = 40;
pub const FILE_READ: u8 = 48;

pub const MAINTENANCE: u8 = 2;
pub const SOFTWARE_UPDATE: u8 = 3;
/// Errors in the response of BeginFirmwareUpdate.
pub const OK: u8 = 0;
pub const INVALID_MODE: u8 = 1;
pub const IN_PROGRESS: u8 = 2;
pub const UNKNOWN: u8 = 255;
pub const MAGIC: [u8; 5] = [0x1E, 0x1B, 0x55, 0xCE, 0xAC];

/// The bootloader needs so many milliseconds to make a unique ID.
pub const FIRST_START_MS: u64 = 1500;

fn seed(service: u8) -> u16 {
    crc::seed(match service {
        GET_NODE_INFO => 0xEE46_8A81_21C4_6A9E,
        BEGIN_FIRMWARE_UPDATE => 0xB7D7_25DF_7272_4126,
        FILE_READ => 0x8DCD_CA93_9F33_F678,
        _ => 0,
    })
}

/// A file server: answers file.Read.
#[derive(Default)]
pub struct Server {
    pub files: BTreeMap<String, Vec<u8>>,
    pub is_silent: bool,
    /// Time from a request to the answer.
    pub delay_ms: u64,
    /// Maximum data length of an answer; zero means 256.
    pub limit: usize,
    /// The server omits a frame of each `drop`th answer; zero means none.
    pub drop: usize,
    /// The server sends the previous answer, then the answer twice.
    pub is_repeating: bool,
    /// The frames of the last answer.
    last: Vec<Vec<u8>>,
    /// Number of requests so far.
    pub requests: usize,
}

impl Server {
    /// The answer to a request. `None` if the server does not answer.
    fn answer(&mut self, payload: &[u8]) -> Option<Vec<u8>> {
        self.requests += 1;
        if self.is_silent {
            return None;
        }
        let offset = usize::from(u16::from_le_bytes([payload[0], payload[1]]));
        assert_eq!(payload[2..5], [0; 3], "an offset in the first 64 KB");
        let path = String::from_utf8_lossy(&payload[5..]);
        // The error NOT_FOUND.
        let Some(file) = self.files.get(&*path) else { return Some(vec![2, 0]) };
        let limit = if self.limit == 0 { 256 } else { self.limit };
        let data = file.get(offset..).unwrap_or_default();
        Some([&[0, 0], &data[..data.len().min(limit)]].concat())
    }
}

/// Layout of a bench.
pub struct Options<'a> {
    /// Pieces of flash: address and bytes.
    pub flash: &'a [(usize, Vec<u8>)],
    pub eeprom: &'a [u8],
    pub bit_rate: u32,
    /// The server sends NodeStatus each second, from the start on.
    pub server_sends_status: bool,
}

impl Default for Options<'_> {
    fn default() -> Self {
        let bit_rate = board().fastest_bit_rate();
        Options { flash: &[], eeprom: &[], bit_rate, server_sends_status: true }
    }
}

/// Time until the bootloader is on the bus, with this EEPROM.
fn start_ms(eeprom: &[u8]) -> u64 {
    let has_unique_id = eeprom.get(UNIQUE_ID.start).is_some_and(|&byte| byte != 0xFF);
    if has_unique_id { 20 } else { FIRST_START_MS }
}

pub struct UpdateBench {
    pub bench: Bench,
    peer: Rc<RefCell<SoftNode>>,
    pub server: Server,
    assembler: Assembler,
    /// Transfers of the node, oldest first, with the time of their end in milliseconds.
    pub transfers: Vec<(u64, Transfer)>,
    transfer_id: TransferId,
    pub node: u8,
    /// Share of the bus that other nodes' messages take, in percent.
    pub fill_bus_percent: u64,
    other: Rc<RefCell<SoftNode>>,
    /// Time of the server's next NodeStatus.
    status_at: u64,
    status_transfer_id: TransferId,
}

impl UpdateBench {
    /// A board that has only the bootloader, powered up now.
    pub fn empty() -> UpdateBench {
        UpdateBench::with(&[], &[], board().fastest_bit_rate())
    }

    /// A board with the bootloader and the firmware, as after an upload by a programmer.
    pub fn with_program() -> UpdateBench {
        let elf = elf();
        let firmware = Firmware::read(&elf).unwrap_or_else(|error| panic!("{error:#}"));
        let eeprom = eeprom_after_first_start(&elf).unwrap_or_else(|error| panic!("{error:#}"));
        UpdateBench::with(&firmware.flash, &eeprom, board().fastest_bit_rate())
    }

    /// A board with the bootloader, these pieces of flash (address, bytes), and this EEPROM, on a
    /// bus of this bit rate.
    pub fn with(flash: &[(usize, Vec<u8>)], eeprom: &[u8], bit_rate: u32) -> UpdateBench {
        UpdateBench::with_options(Options { flash, eeprom, bit_rate, ..Options::default() })
    }

    /// A board with the firmware, which has never started.
    pub fn with_new_program() -> UpdateBench {
        let firmware = Firmware::read(&elf()).unwrap_or_else(|error| panic!("{error:#}"));
        UpdateBench::with(&firmware.flash, &[], board().fastest_bit_rate())
    }

    /// A board with another bootloader and this firmware, which has never started.
    pub fn without_loader(firmware: &Firmware) -> UpdateBench {
        let mut avr =
            Avr::programmed(board().chip, firmware).unwrap_or_else(|error| panic!("{error:#}"));
        avr.reset(ResetCause::PowerOn);
        let mut bench = UpdateBench::of(avr, Options::default());
        bench.run_ms(FIRST_START_MS);
        bench
    }

    /// A board with the bootloader, which is on the bus.
    pub fn with_options(options: Options) -> UpdateBench {
        let start_ms = start_ms(options.eeprom);
        let mut bench = UpdateBench::powered_up(options);
        bench.run_ms(start_ms);
        bench
    }

    /// A board with the bootloader, powered up now.
    pub fn powered_up(options: Options) -> UpdateBench {
        let loader = bootloader(&board())
            .and_then(|hex| Firmware::read_hex(&hex))
            .unwrap_or_else(|error| panic!("{error:#}"));
        let wiring = board();
        let mut avr =
            Avr::programmed(wiring.chip, &loader).unwrap_or_else(|error| panic!("{error:#}"));
        for (address, bytes) in options.flash {
            avr.load_flash(*address, bytes);
        }
        avr.set_eeprom(options.eeprom);
        avr.set_reset_vector(loader.flash[0].0 as u32);
        avr.reset(ResetCause::PowerOn);
        UpdateBench::of(avr, options)
    }

    /// A bench with this board.
    fn of(avr: Avr, options: Options) -> UpdateBench {
        let Options { eeprom, bit_rate, server_sends_status, .. } = options;
        let mut bench = Bench::new(bit_rate);
        bench.add_board(
            Board::in_corner(avr, &board()).unwrap_or_else(|error| panic!("{error:#}")),
            "node",
        );
        let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        bench.attach("server", peer.clone());
        let other = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        bench.attach("other", other.clone());
        let server =
            Server { files: BTreeMap::from([("fw.bin".to_owned(), file())]), ..Server::default() };
        UpdateBench {
            bench,
            peer,
            server,
            assembler: Assembler::new(),
            transfers: Vec::new(),
            transfer_id: TransferId::default(),
            node: NODE,
            fill_bus_percent: 0,
            other,
            status_at: if server_sends_status { (start_ms(eeprom) - 10) * MS } else { u64::MAX },
            status_transfer_id: TransferId::default(),
        }
    }

    /// A board with the bootloader, whose EEPROM has node ID 42 and 125 kbit/s.
    pub fn with_bus_record() -> UpdateBench {
        let mut bench = UpdateBench::with(&[], &eeprom_with_bus_record(), 125_000);
        bench.node = 42;
        bench
    }

    /// Starts the bootloader as a program does after BeginFirmwareUpdate: with a request in the
    /// last bytes of the RAM and a watchdog reset.
    pub fn start_bootloader_with_update(&mut self, path: &str) {
        let mut request = [0; 26];
        request[..path.len()].copy_from_slice(path.as_bytes());
        request[24] = path.len() as u8;
        request[25] = SERVER;
        let record = [&request[..], &crc(&request).to_be_bytes()].concat();
        let wiring = board();
        let begin = wiring.chip.ram_end() + 1 - 32;
        let avr = self.bench.board(0).avr_mut();
        for (byte, address) in record.iter().zip(begin..) {
            avr.poke_sram(address, *byte);
        }
        self.bench.board(0).reset(ResetCause::Watchdog);
        self.assembler = Assembler::new();
    }

    /// Starts the bootloader by three watchdog resets; it waits for a request.
    #[track_caller]
    pub fn wait_in_the_bootloader(&mut self) {
        for _ in 0..3 {
            self.bench.board(0).reset(ResetCause::Watchdog);
            self.run_ms(200);
        }
        assert_eq!(self.next_mode(), MAINTENANCE);
    }

    /// The server sends NodeStatus each second, from now on.
    pub fn server_begins_to_send_status(&mut self) {
        self.status_at = self.bench.now();
    }

    pub fn now_ms(&self) -> u64 {
        self.bench.now() / MS
    }

    #[track_caller]
    pub fn run_ms(&mut self, ms: u64) {
        let end = self.bench.now() + ms * MS;
        while self.bench.now() < end {
            self.step();
        }
    }

    #[track_caller]
    pub fn step(&mut self) {
        if self.fill_bus_percent != 0 && self.other.borrow().queued() == 0 {
            // An actuator.Status of node 50 is about 140 bits.
            let bit = 16_000_000 / u64::from(board().fastest_bit_rate());
            let due = self.bench.now()
                + 140 * bit * (100 - self.fill_bus_percent) / self.fill_bus_percent;
            self.other
                .borrow_mut()
                .send_at(due, Frame::extended(0x1003_F332, &[0x55, 2, 3, 4, 5, 6, 7, 0xC1]));
        }
        if self.bench.now() >= self.status_at {
            self.status_at += 1000 * MS;
            let tail = 0xC0 | self.status_transfer_id.advance().get();
            let id = rig::NODE_STATUS | u32::from(SERVER);
            self.peer.borrow_mut().send(Frame::extended(id, &[0, 0, 0, 0, 0, 0, 0, tail]));
        }
        self.bench.run_until(self.bench.now() + MS / 10);
        let received = self.peer.borrow_mut().take_received();
        for (at, frame) in received {
            let Id::Extended(id) = frame.id else { panic!("{frame:?}") };
            match self.assembler.push(id, frame.data(), bench::elapsed(at)) {
                Outcome::Partial => {}
                Outcome::Invalid(why) => panic!("{why}: {frame:?}"),
                Outcome::Complete(transfer) => {
                    self.serve(at, &transfer);
                    self.transfers.push((at / MS, transfer));
                }
            }
        }
        let violations = self.bench.board(0).take_violations();
        assert!(violations.is_empty(), "driver mistakes: {violations:#?}");
    }

    fn serve(&mut self, at: u64, transfer: &Transfer) {
        let CanId::Service { service_id: FILE_READ, request: true, source, destination, .. } =
            transfer.id
        else {
            return;
        };
        assert_eq!((source.get(), destination.get()), (self.node, SERVER));
        let Some(answer) = self.server.answer(&transfer.payload) else { return };
        let mut frames = split(&answer, transfer.transfer_id, seed(FILE_READ));
        if self.server.drop != 0 && self.server.requests.is_multiple_of(self.server.drop) {
            frames.remove(frames.len() / 2);
        }
        let id = self.service(FILE_READ, false);
        let due = at + self.server.delay_ms * MS;
        let stale = std::mem::replace(&mut self.server.last, frames.clone());
        if self.server.is_repeating {
            frames = [stale, frames.clone(), frames].concat();
        }
        for data in frames {
            self.peer.borrow_mut().send_at(due, Frame::extended(id, &data));
        }
    }

    fn service(&self, service_id: u8, request: bool) -> u32 {
        let node = |id| NodeId::new(id).expect("a node ID");
        CanId::Service {
            priority: 30,
            service_id,
            request,
            destination: node(self.node),
            source: node(SERVER),
        }
        .build()
    }

    /// Sends a request to the node. Returns its transfer ID.
    pub fn request(&mut self, service: u8, payload: &[u8]) -> TransferId {
        let transfer_id = self.transfer_id.advance();
        let id = self.service(service, true);
        for data in split(payload, transfer_id, seed(service)) {
            self.peer.borrow_mut().send(Frame::extended(id, &data));
        }
        transfer_id
    }

    /// Queues a frame of another node.
    pub fn send(&mut self, id: u32, data: &[u8]) {
        self.peer.borrow_mut().send(Frame::extended(id, data));
    }

    /// Sends a request to the node, and waits for the response.
    #[track_caller]
    pub fn call(&mut self, service: u8, payload: &[u8]) -> Vec<u8> {
        let known = self.transfers.len();
        let transfer_id = self.request(service, payload);
        let is_response = |transfer: &Transfer| {
            matches!(
                transfer.id,
                CanId::Service { service_id, request: false, .. } if service_id == service
            ) && transfer.transfer_id == transfer_id
        };
        for _ in 0..10_000 {
            self.step();
            if let Some((_, transfer)) =
                self.transfers[known..].iter().find(|(_, transfer)| is_response(transfer))
            {
                return transfer.payload.clone();
            }
        }
        panic!("no response of service {service} in a second");
    }

    /// Sends BeginFirmwareUpdate with `path`. Returns the error in the response.
    #[track_caller]
    pub fn begin_update(&mut self, path: &str) -> u8 {
        self.call(BEGIN_FIRMWARE_UPDATE, &[&[0], path.as_bytes()].concat())[0]
    }

    /// The node's NodeStatus messages, oldest first: time in milliseconds and payload.
    pub fn statuses(&self) -> Vec<(u64, &[u8])> {
        let is_status = |transfer: &Transfer| {
            matches!(
                transfer.id,
                CanId::Message { type_id: NODE_STATUS, source, .. } if source.get() == self.node
            )
        };
        self.transfers
            .iter()
            .filter(|(_, transfer)| is_status(transfer))
            .map(|(at, transfer)| (*at, &transfer.payload[..]))
            .collect()
    }

    /// Waits for the next NodeStatus and returns its mode. After a reset the bootloader waits for a
    /// frame of the server first.
    #[track_caller]
    pub fn next_mode(&mut self) -> u8 {
        let known = self.statuses().len();
        self.wait_for("a NodeStatus", 2500, |bench| bench.statuses().len() > known);
        self.statuses()[known].1[4] >> 3 & 7
    }

    /// Runs until `condition` holds. Panics after `timeout_ms` of simulated time. Returns the
    /// elapsed milliseconds.
    #[track_caller]
    pub fn wait_for(
        &mut self,
        what: &str,
        timeout_ms: u64,
        condition: impl Fn(&UpdateBench) -> bool,
    ) -> u64 {
        let begin = self.now_ms();
        while !condition(self) {
            assert!(self.now_ms() < begin + timeout_ms, "no {what} within {timeout_ms} ms");
            self.step();
        }
        self.now_ms() - begin
    }

    /// Waits until the program runs: only the program has the mode OPERATIONAL.
    #[track_caller]
    pub fn wait_for_program(&mut self, timeout_ms: u64) -> u64 {
        let known = self.statuses().len();
        self.wait_for("program", timeout_ms, |bench| {
            bench.statuses()[known..].iter().any(|(_, status)| status[4] >> 3 & 7 < MAINTENANCE)
        })
    }

    /// Switches the power off and on.
    pub fn cut_power(&mut self) {
        self.bench.board(0).reset(ResetCause::PowerOn);
        self.assembler = Assembler::new();
        // The SPI instruction in progress ends.
        self.bench.board(0).take_violations();
        // The other nodes see an error in the frame that the node was sending.
        self.bench.run_for_ms(1);
        self.peer.borrow_mut().take_received();
        self.peer.borrow_mut().clear_queue();
        self.bench.run_for_ms(20);
        self.peer.borrow_mut().take_received();
    }

    /// Number of errors that the server has seen on the bus.
    pub fn errors(&mut self) -> usize {
        let events = self.peer.borrow_mut().take_events();
        events.iter().filter(|(_, event)| matches!(event, Event::Error { .. })).count()
    }

    /// The first `len` bytes of the flash.
    pub fn flash(&mut self, len: usize) -> Vec<u8> {
        self.bench.board(0).avr().flash()[..len].to_vec()
    }
}
