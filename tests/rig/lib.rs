//! The rig of the black-box tests: the shipped ELF on one or more simulated boards, and a second
//! node, the peer, on the same bus.
//!
//! Tests write out the protocol's numbers or take them from the simulator or from a page of docs,
//! never from the firmware. [`documented`] has its parameters, [`manage`] is its client, [`status`]
//! has the numbers in its status, [`load`] and [`flood`] load its bus, and [`profile`] and
//! [`queue`] look into the running program.

pub mod documented;
pub mod faults;
pub mod flood;
pub mod load;
pub mod loader;
pub mod manage;
pub mod observed;
pub mod page;
pub mod parallel;
pub mod profile;
pub mod program;
pub mod queue;
pub mod reception;
pub mod soak;
pub mod status;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::{Mutex, PoisonError};

use bench::Cycles;
use bench::autopilot::{Autopilot, Settings};
use bench::avr::{Pulse, ResetCause};
use bench::board::Board;
use bench::can::{Frame, Id, PortId, RecordKind, SoftNode};
use bench::corner::Corner;
use bench::dronecan::esc::encode_commands;
use bench::dronecan::{
    ActuatorCommand, CommandUnit, Decoded, Observation, Observer, Transfer, TransferId, draft,
    split, types,
};
use bench::wiring::Wiring;
use bench::{Bench, chosen_board, eeprom_after_first_start, firmware};
pub use program::{Program, has_all_features};

/// CPU cycles in a millisecond.
pub const MS: Cycles = 16_000;
/// CPU cycles in a microsecond.
pub const US: Cycles = 16;
/// CPU cycles from one pulse of an output to the next with the default of OUT_RATE.
pub const SERVO_PERIOD: Cycles = 20 * MS;

/// Node ID of the node under test.
pub const NODE: u32 = 120;

/// CAN identifiers of the messages that the node sends.
pub const STATUS_OF_NODE: u32 = 0x1801_5500 | NODE;
pub const TEMPERATURE_OF_NODE: u32 = 0x1804_5600 | NODE;
pub const DEGREES_OF_NODE: u32 = 0x1804_5800 | NODE;
/// Identifier of a NodeStatus of the UAVCAN draft of 2014 with transfer ID 0. The draft has 3 bits
/// of transfer ID, in the identifier.
pub const DRAFT_STATUS_OF_NODE: u32 = 0x1134_0008 | NODE << 10;
/// Mask of the transfer ID in an identifier of the draft.
pub const TRANSFER_ID_OF_DRAFT: u32 = 7;

/// CAN identifiers, without the sender's node ID, of messages that the node receives.
pub const NODE_STATUS: u32 = 0x1801_5500;
pub const ARRAY_COMMAND: u32 = 0x1003_F200;
pub const RAW_COMMAND: u32 = 0x0704_0600;
pub const ARMING_STATUS: u32 = 0x1804_4C00;
pub const SAFETY_STATE: u32 = 0x104E_2000;
pub const SERVO_COMMAND: u32 = 0x1004_5700;

/// Types of a command in an ArrayCommand: a share of the travel from -1 to 1, an angle in radians,
/// and a pulse width in microseconds.
pub const UNITLESS: u8 = 0;
pub const POSITION: u8 = 1;
pub const PWM: u8 = 4;

/// Values of ArmingStatus.
pub const ARMED: u8 = 255;
pub const NOT_ARMED: u8 = 0;
/// Values of SafetyState: the safety switch is on, and off.
pub const SAFE: u8 = 0;
pub const NOT_SAFE: u8 = 255;

/// The board under test: `NODE_BOARD` and `NODE_SHIELD` name it; else it is the default of
/// avr-specs/boards.toml.
pub fn board() -> Wiring {
    chosen_board().unwrap_or_else(|error| panic!("{error:#}"))
}

/// The values of the boards under test: `NODE_CORNER` names them.
pub fn corner() -> Corner {
    let corner = bench::firmware::corner().unwrap_or_else(|error| panic!("{error:#}"));
    corner.unwrap_or_default()
}

/// A time or duration by the clock of the node, which counts its own cycles.
pub fn by_node_clock(cycles: Cycles) -> Cycles {
    (cycles as f64 * corner().clock_rate()).round() as Cycles
}

/// The time in which the node counts so many milliseconds.
pub fn node_ms(milliseconds: u64) -> Cycles {
    ((milliseconds * MS) as f64 / corner().clock_rate()).round() as Cycles
}

/// True if the firmware under test has the preset "remote", by the name of its ELF.
pub fn has_preset_remote() -> bool {
    Program::Preset
        .elf()
        .file_stem()
        .is_some_and(|name| name.to_string_lossy().ends_with("-remote"))
}

/// EEPROM of a board that has started before with the preset of its chip.
pub fn started() -> &'static [u8] {
    Program::Preset.started()
}

/// Like [`started`] for another firmware.
pub fn started_with(elf: &Path) -> &'static [u8] {
    static EEPROMS: Mutex<BTreeMap<PathBuf, &[u8]>> = Mutex::new(BTreeMap::new());
    // A thread that panicked here has not changed the map.
    let mut eeproms = EEPROMS.lock().unwrap_or_else(PoisonError::into_inner);
    eeproms.entry(elf.to_owned()).or_insert_with(|| {
        let eeprom = eeprom_after_first_start(elf).unwrap_or_else(|error| panic!("{error:#}"));
        eeprom.leak()
    })
}

/// True if the node sent the frame.
pub fn is_from_node(frame: &Frame) -> bool {
    matches!(frame.id, Id::Extended(id) if id & 0x7F == NODE)
}

/// The boards, the bus, and a peer that acknowledges and sends frames.
pub struct Rig {
    pub bench: Bench,
    elf: PathBuf,
    /// Bit rate of the bus in bits per second: the highest that the board supports.
    bit_rate: u32,
    boards: usize,
    pub peer: Rc<RefCell<SoftNode>>,
    pub peer_port: PortId,
    /// Frames on the bus, each with the time of its end.
    pub traffic: Vec<(Cycles, Frame)>,
    pub error_frames: usize,
    /// Transfers on the bus, each with the end of its last frame.
    pub transfers: Vec<(Cycles, Transfer)>,
    /// Decoded transfers of the draft of 2014, each with the end of its last frame.
    pub drafts: Vec<(Cycles, draft::Transfer, draft::Message)>,
    /// Frames that belong to no valid transfer, each with the reason.
    pub broken: Vec<(Cycles, Frame, &'static str)>,
    observer: Observer,
    autopilot: Option<(Autopilot, PortId)>,
    /// Output of the first board's serial monitor.
    pub pulses: Vec<Pulse>,
    pub serial: String,
    other_serials: Vec<String>,
    /// True if the test expects driver mistakes, or lost frames.
    pub violations_expected: bool,
    pub overflows_expected: bool,
    status_transfer_id: u8,
    command_transfer_id: u8,
    request_transfer_id: u8,
}

impl Rig {
    /// See [`Program::powered`]: with the preset of the board's chip, as the four below.
    pub fn powered() -> Rig {
        Program::Preset.powered()
    }

    /// See [`Program::new_board`].
    pub fn new_board() -> Rig {
        Program::Preset.new_board()
    }

    /// See [`Program::running`].
    #[track_caller]
    pub fn running() -> Rig {
        Program::Preset.running()
    }

    /// See [`Program::running_with`].
    #[track_caller]
    pub fn running_with(eeprom: &[u8]) -> Rig {
        Program::Preset.running_with(eeprom)
    }

    /// See [`Program::positioned`].
    #[track_caller]
    pub fn positioned() -> Rig {
        Program::Preset.positioned()
    }

    /// Like [`Rig::powered`] with the firmware of a preset or of a list of features, such as
    /// "thesis" or "allocation".
    pub fn with_features(features: &str) -> Rig {
        Rig::with_firmware(&firmware(features).unwrap_or_else(|error| panic!("{error:#}")))
    }

    /// Like [`Rig::powered`] with this ELF.
    pub fn with_firmware(elf: &Path) -> Rig {
        Rig::with_boards_of(elf, &[started_with(elf)])
    }

    /// Boards with this ELF and these EEPROMs, powered up now. Each has its own seed, so that
    /// clocks and noise differ.
    pub fn with_boards_of(elf: &Path, eeproms: &[&[u8]]) -> Rig {
        let board = Board::load(elf).unwrap_or_else(|error| panic!("{error:#}"));
        Rig::on_bus_of(board.wiring().fastest_bit_rate(), elf, eeproms)
    }

    /// Like [`Rig::with_boards_of`] on a bus of this bit rate.
    pub fn on_bus_of(bit_rate: u32, elf: &Path, eeproms: &[&[u8]]) -> Rig {
        let load = || Board::load(elf).unwrap_or_else(|error| panic!("{error:#}"));
        let mut bench = Bench::new(bit_rate);
        for (eeprom, number) in eeproms.iter().zip(0..) {
            let mut board = load();
            board.avr_mut().set_eeprom(eeprom);
            if number > 0 {
                board.avr_mut().seed(number);
                board.reset(ResetCause::PowerOn);
            }
            bench.add_board(board, &format!("node{number}"));
        }
        let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        let peer_port = bench.attach("peer", peer.clone());
        Rig {
            bench,
            elf: elf.to_owned(),
            bit_rate,
            boards: eeproms.len(),
            peer,
            peer_port,
            traffic: Vec::new(),
            error_frames: 0,
            transfers: Vec::new(),
            drafts: Vec::new(),
            broken: Vec::new(),
            observer: Observer::new(),
            autopilot: None,
            pulses: Vec::new(),
            serial: String::new(),
            other_serials: Vec::new(),
            violations_expected: false,
            overflows_expected: false,
            status_transfer_id: 0,
            command_transfer_id: 0,
            request_transfer_id: 0,
        }
    }

    /// Attaches another board to the bus and powers it up. `seed` makes it differ from the others.
    pub fn add_board(&mut self, eeprom: &[u8], seed: u64) {
        let mut board = Board::load(&self.elf).unwrap_or_else(|error| panic!("{error:#}"));
        board.avr_mut().set_eeprom(eeprom);
        board.avr_mut().seed(seed);
        board.run_until(self.now());
        board.reset(ResetCause::PowerOn);
        self.boards += 1;
        self.bench.add_board(board, &format!("node{}", self.boards));
    }

    /// Output of the serial monitor of this board since the last call.
    pub fn serial_of(&mut self, board: usize) -> String {
        self.other_serials.get_mut(board - 1).map(std::mem::take).unwrap_or_default()
    }

    /// Attaches an autopilot to the bus.
    pub fn attach_autopilot(&mut self, settings: Settings) {
        self.join(Autopilot::new(settings, self.bit_rate));
    }

    /// Replaces the autopilot with one that is powered up now.
    pub fn replace_autopilot(&mut self, settings: Settings) {
        self.detach_autopilot();
        self.join(Autopilot::powered(settings, self.bit_rate, self.now()));
    }

    /// Detaches the autopilot from the bus, if there is one.
    pub fn detach_autopilot(&mut self) {
        if let Some((autopilot, port)) = self.autopilot.take() {
            autopilot.switch_off();
            self.bench.detach(port);
        }
    }

    fn join(&mut self, autopilot: Autopilot) {
        let port = self.bench.attach("autopilot", autopilot.station());
        self.autopilot = Some((autopilot, port));
    }

    /// The autopilot. Panics if none is attached.
    #[track_caller]
    pub fn autopilot(&mut self) -> &mut Autopilot {
        self.autopilot.as_mut().map(|(autopilot, _)| autopilot).expect("an autopilot")
    }

    /// Like [`Rig::running`] with this ELF and this EEPROM.
    #[track_caller]
    pub fn running_elf(elf: &Path, eeprom: &[u8]) -> Rig {
        let mut rig = Rig::with_boards_of(elf, &[eeprom]);
        rig.wait_until_up();
        rig
    }

    /// Waits for the first status after a start, in either dialect, and clears the record.
    #[track_caller]
    pub fn wait_until_up(&mut self) {
        let is_of_draft = |frame: &Frame| {
            matches!(
                frame.id,
                Id::Extended(id) if id & !TRANSFER_ID_OF_DRAFT == DRAFT_STATUS_OF_NODE
            )
        };
        self.wait_for("the first NodeStatus", 100, |rig| {
            !rig.statuses().is_empty() || rig.traffic.iter().any(|(_, frame)| is_of_draft(frame))
        });
        self.run_ms(150);
        self.forget();
    }

    /// Switches the first board's power off and on.
    pub fn cut_power(&mut self) {
        self.board().reset(ResetCause::PowerOn);
        // The other nodes see an error in the frame that the node was sending.
        self.run_ms(1);
        self.forget();
    }

    /// Connects the node to the bus, or disconnects it.
    pub fn connect_node(&mut self, is_connected: bool) {
        let port = self.bench.port(0);
        self.bench.bus().connect(port, is_connected);
    }

    pub fn board(&mut self) -> &mut Board {
        self.bench.board(0)
    }

    pub fn now(&self) -> Cycles {
        self.bench.now()
    }

    /// Clears the record of frames, transfers, pulses and serial output.
    pub fn forget(&mut self) {
        self.traffic.clear();
        self.pulses.clear();
        self.serial.clear();
        self.error_frames = 0;
        self.transfers.clear();
        self.drafts.clear();
        self.broken.clear();
    }

    pub fn run_ms(&mut self, ms: u64) {
        self.run_until(self.now() + ms * MS);
    }

    pub fn run_until(&mut self, t: Cycles) {
        while self.now() < t {
            // Short steps keep the record short and let the autopilot run.
            let step = if self.autopilot.is_some() { MS } else { 10 * MS };
            self.step(t.min(self.now() + step));
        }
    }

    fn step(&mut self, until: Cycles) {
        if let Some((autopilot, _)) = &mut self.autopilot {
            autopilot.advance(until);
        }
        self.bench.run_until(until);
        self.collect();
    }

    /// Runs until `condition` holds. Panics after `timeout_ms` of simulated time.
    #[track_caller]
    pub fn wait_for(
        &mut self,
        what: &str,
        timeout_ms: u64,
        mut condition: impl FnMut(&Rig) -> bool,
    ) {
        let end = self.now() + timeout_ms * MS;
        while !condition(self) {
            assert!(
                self.now() < end,
                "no {what} within {timeout_ms} ms\nserial monitor:\n{}",
                self.serial
            );
            self.step(self.now() + MS / 10);
        }
    }

    fn collect(&mut self) {
        for record in self.bench.bus().take_records() {
            match record.kind {
                RecordKind::Frame { frame, .. } => {
                    self.traffic.push((record.end, frame));
                    self.assemble(record.end, frame);
                }
                RecordKind::ErrorFrame { .. } => self.error_frames += 1,
            }
        }
        for (board, number) in self.bench.boards().iter_mut().zip(0..) {
            let (pulses, serial) = (board.take_servo_pulses(), board.avr_mut().serial_take());
            let text = serial.into_iter().map(|(_, byte)| char::from(byte));
            if number == 0 {
                self.pulses.extend(pulses);
                self.serial.extend(text);
            } else {
                self.other_serials.resize(self.other_serials.len().max(number), String::new());
                self.other_serials[number - 1].extend(text);
            }
            let violations = board.take_violations();
            assert!(
                self.violations_expected || violations.is_empty(),
                "driver mistakes: {violations:#?}"
            );
        }
        self.peer.borrow_mut().take_received();
    }

    fn assemble(&mut self, at: Cycles, frame: Frame) {
        let Id::Extended(id) = frame.id else { return };
        if frame.remote {
            return;
        }
        match self.observer.push(id, frame.data(), bench::elapsed(at)) {
            Observation::Complete(Decoded::V0(transfer, _)) => self.transfers.push((at, transfer)),
            Observation::Complete(Decoded::Draft(transfer, message)) => {
                self.drafts.push((at, transfer, message))
            }
            Observation::Invalid(why) => self.broken.push((at, frame, why)),
            Observation::Partial => {}
        }
    }

    /// Queues a frame of the peer with this identifier.
    pub fn send(&mut self, id: u32, data: &[u8]) {
        self.peer.borrow_mut().send(Frame::extended(id, data));
    }

    pub fn send_frame(&mut self, frame: Frame) {
        self.peer.borrow_mut().send(frame);
    }

    /// The peer sends a NodeStatus as node `source`.
    pub fn send_status_from(&mut self, source: u8) {
        let transfer_id = Self::next_transfer_id(&mut self.status_transfer_id);
        self.send(NODE_STATUS | u32::from(source), &[10, 0, 0, 0, 0, 0, 0, 0xC0 | transfer_id]);
    }

    /// The peer sends an ArrayCommand with one command, as node 10.
    pub fn send_command(&mut self, actuator_id: u8, command_type: u8, value: f32) {
        let transfer_id = Self::next_transfer_id(&mut self.command_transfer_id);
        let [low, high] = half::f16::from_f32(value).to_le_bytes();
        self.send(ARRAY_COMMAND | 10, &[actuator_id, command_type, low, high, 0xC0 | transfer_id]);
    }

    /// The peer sends an ArrayCommand of several (actuator, type, value), as node 10. Queues all
    /// frames at once.
    pub fn send_commands(&mut self, commands: &[(u8, u8, f32)]) {
        let transfer_id = Self::next_transfer_id(&mut self.command_transfer_id);
        for data in array_command(commands, transfer_id) {
            self.send(ARRAY_COMMAND | 10, &data);
        }
    }

    /// The peer sends an esc.RawCommand as node `source`. Queues all frames at once.
    pub fn send_raw_command(&mut self, source: u32, throttles: &[i16]) {
        let transfer_id = TransferId::new(Self::next_transfer_id(&mut self.command_transfer_id));
        let seed = types::RAW_COMMAND.seed.expect("known");
        for data in split(&encode_commands(throttles), transfer_id, seed) {
            self.send(RAW_COMMAND | source, &data);
        }
    }

    /// The autopilot, node 10, sends its status and this ArmingStatus.
    pub fn arm(&mut self, status: u8) {
        self.send_status_from(10);
        self.send(ARMING_STATUS | 10, &[status, 0xC0]);
        self.run_ms(5);
    }

    /// The peer sends the thesis's command, as node 1.
    pub fn send_servo_command(&mut self, position: u8) {
        let transfer_id = Self::next_transfer_id(&mut self.command_transfer_id);
        self.send(SERVO_COMMAND | 1, &[position, 0xC0 | transfer_id]);
    }

    fn next_transfer_id(transfer_id: &mut u8) -> u8 {
        let current = *transfer_id;
        *transfer_id = (current + 1) % 32;
        current
    }

    /// Gives INT a bad contact for 2 ms and sends more statuses in that time than the controller
    /// has room for. Returns the number of lost frames. The program checks every 10 ms whether
    /// INT is stuck; the 2 ms lie between two checks.
    #[track_caller]
    pub fn lose_frames(&mut self) -> u32 {
        let before = self.board().chip().borrow().rx_overflows();
        self.wait_for_supervision();
        for _ in 0..12 {
            self.send_status_from(10);
        }
        self.board().set_stuck_int(Some(true));
        self.run_ms(2);
        self.board().set_stuck_int(None);
        self.board().chip().borrow().rx_overflows() - before
    }

    /// Waits until the program has checked the controller, which it does again 10 ms later.
    #[track_caller]
    pub fn wait_for_supervision(&mut self) {
        let end = self.now() + 20 * MS;
        let cs = self.board().wiring().cs;
        while self.board().pin(cs) {
            assert!(self.now() < end, "CS stays high");
            self.run_until(self.now() + US);
        }
        self.run_ms(1);
    }

    /// Data of the frames with this identifier, oldest first, each with the end of the frame.
    pub fn frames(&self, id: u32) -> Vec<(Cycles, Vec<u8>)> {
        let same = |frame: &Frame| matches!(frame.id, Id::Extended(other) if other == id);
        self.traffic
            .iter()
            .filter(|(_, frame)| same(frame))
            .map(|(at, frame)| (*at, frame.data().to_vec()))
            .collect()
    }

    pub fn statuses(&self) -> Vec<(Cycles, Vec<u8>)> {
        self.frames(STATUS_OF_NODE)
    }

    /// Runs for two servo periods and returns the width of the last pulse in microseconds.
    #[track_caller]
    pub fn settled_pulse_us(&mut self) -> f64 {
        self.run_ms(45);
        self.pulses.last().expect("a pulse").width_us()
    }

    /// Takes the pulses of each output so far.
    pub fn take_pulses(&mut self) -> Vec<Vec<Pulse>> {
        self.collect();
        let mut all = vec![std::mem::take(&mut self.pulses)];
        all.extend(self.board().take_output_pulses());
        all
    }

    /// Width of each output's last pulse in microseconds, rounded because an edge may be off by
    /// half a microsecond. `None` without a pulse.
    pub fn widths_us(&mut self) -> Vec<Option<f64>> {
        self.run_ms(25);
        self.take_pulses();
        self.run_ms(45);
        let width = |pulses: &Vec<Pulse>| pulses.last().map(|pulse| pulse.width_us().round());
        self.take_pulses().iter().map(width).collect()
    }

    /// Runs until the serial monitor's output contains `text`.
    #[track_caller]
    pub fn wait_for_line(&mut self, text: &str, timeout_ms: u64) {
        self.wait_for(&format!("line {text:?}"), timeout_ms, |rig| {
            rig.serial.lines().any(|line| line.contains(text)) && rig.serial.ends_with('\n')
        });
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        self.collect();
        for board in self.bench.boards() {
            let lost = board.chip().borrow().rx_overflows();
            assert!(
                self.overflows_expected || lost == 0,
                "{lost} frames were lost in the controller"
            );
        }
    }
}

/// The data of the frames of an ArrayCommand with these (actuator, type, value).
pub fn array_command(commands: &[(u8, u8, f32)], transfer_id: u8) -> Vec<Vec<u8>> {
    let command = |&(actuator, unit, value)| ActuatorCommand {
        actuator,
        unit: CommandUnit::Unknown(unit),
        value: half::f16::from_f32(value),
    };
    let payload = ActuatorCommand::encode_array(&commands.iter().map(command).collect::<Vec<_>>());
    split(&payload, TransferId::new(transfer_id), types::ARRAY_COMMAND.seed.expect("known"))
}

/// Parses frames such as "1003F20A 01 00 00 38 C7". `|` separates the data of several frames with
/// the same identifier.
#[track_caller]
pub fn parse_frames(text: &str) -> Vec<Frame> {
    let (id, data) = text.split_once(' ').unwrap_or((text, ""));
    let id = u32::from_str_radix(id, 16).expect("an identifier");
    let bytes = |part: &str| -> Vec<u8> {
        part.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).expect("a byte")).collect()
    };
    data.split('|').map(|part| Frame::extended(id, &bytes(part))).collect()
}

/// The uptime (s), health, mode and vendor-specific status code in a NodeStatus.
pub fn status_fields(data: &[u8]) -> (u32, u8, u8, u16) {
    assert_eq!(data.len(), 8, "a NodeStatus and its tail byte");
    let uptime = u32::from_le_bytes(data[..4].try_into().unwrap());
    (uptime, data[4] >> 6, data[4] >> 3 & 7, u16::from_le_bytes(data[5..7].try_into().unwrap()))
}
