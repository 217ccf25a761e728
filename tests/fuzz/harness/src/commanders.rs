//! Target `commanders`: eight outputs, of which two are motors, three commanders whose frames
//! interleave in any order, a stranger, and a client that changes types and IDs, asks for restarts
//! and for updates.
//!
//! | kind | then |
//! | --- | --- |
//! | 0, 1, 2 begin an ArrayCommand | sender, number of entries, for each an ID and a value |
//! | 3 begin an esc.RawCommand | sender, number of commands, for each a value |
//! | 4, 5, 6, 7, 8, 9 send the next frame | sender |
//! | 10 leave the rest of a transfer out | sender |
//! | 11 ArmingStatus | sender, status |
//! | 12 SafetyState | sender, status |
//! | 13 set a type or an ID | output, value |
//! | 14 wait | milliseconds |
//! | 15 RestartNode or BeginFirmwareUpdate | which |
//!
//! What must hold:
//!
//! * An output has no pulse, or one that a complete command asked for since its type or its ID
//!   changed last, or what its failsafe asks for after such a command.
//! * A command of one frame for a servo is followed at once while no safety switch is on. So is one
//!   of several frames if no other sender has begun one within 50 ms, nor, on a chip with one lane,
//!   its own sender one of the other type, and no type or ID has changed since its first frame.
//! * A type or an ID changes only while nobody is armed, and that ends the pulse.
//! * The SafetyState of a node that commands no output changes no pulse.
//! * The bootloader gets no update while the vehicle is armed, nor within two seconds of a command
//!   unless it was said to be disarmed.

use std::collections::VecDeque;

use dronecan_host::{Message, TransferId, split, types};
use firmware::desk::{Desk, Memory};
use firmware::hardware::LANES;
use firmware::tables::condition::ResetCause;
use firmware::tables::parameters::OutputParameter;
use half::f16;
use mcp2515_ordered::Frame;

const OUTPUTS: usize = 8;
/// Outputs 1 and 2 are motors with the indices 0 and 1; the ID of the others is their number.
const MOTORS: u16 = 2;

/// Node IDs: three commanders, and a node whose ArrayCommands are rejected.
const SENDERS: [u8; 4] = [10, 11, 12, 14];
const STRANGER: usize = 3;

/// Identifiers without the sender. Requests are from node 127 to 120.
const ARRAY_COMMAND: u32 = 0x1003_F200;
const RAW_COMMAND: u32 = 0x0704_0600;
const ARMING_STATUS: u32 = 0x1804_4C00;
const SAFETY_STATE: u32 = 0x104E_2000;
const GET_SET: u32 = 0x1E0B_F8FF;
const EXECUTE_OPCODE: u32 = 0x1E0A_F8FF;
const RESTART_NODE: u32 = 0x1E05_F8FF;
const UPDATE: u32 = 0x1E28_F8FF;

const PWM: u8 = 4;
const ARMED: u8 = 255;
const SAFE: u8 = 0;

/// Ticks of half a microsecond: the travel, the pulse of the failsafe, and the tolerance.
const LOW: i32 = 2000;
const HIGH: i32 = 4000;
const FAILSAFE_US: i64 = 1300;
const TOLERANCE: i32 = 1;

/// A status of ArmingStatus or SafetyState counts for four to five seconds.
const STATUS_MS: u64 = 5100;
/// An open list may keep another sender's list out for this time.
const LIST_MS: u64 = 50;
/// Longest simulated time of an input, in milliseconds.
const LIFE_MS: u64 = 30_000;

/// What a transfer asks for when it is complete.
#[derive(Clone)]
enum Order {
    /// IDs and values, in ticks or `None` for NaN.
    Positions(Vec<(u8, Option<i32>)>),
    /// Throttles in ticks.
    Throttles(Vec<i32>),
}

/// The transfer that a sender is sending.
struct Sending {
    id: u32,
    frames: VecDeque<Vec<u8>>,
    order: Order,
    is_single: bool,
    /// No other sender had an open list when it began, or has begun one since, and no output has
    /// got another type or ID: an entry is for those that had its ID when its frame came.
    is_certain: bool,
    last_ms: u64,
}

#[derive(Default)]
struct Sender {
    number: u8,
    sending: Option<Sending>,
    /// When its last list was begun, and its identifier.
    begun_ms: Option<u64>,
    begun_id: u32,
    armed_ms: Option<u64>,
}

/// What an output was asked for since its type or its ID changed last.
#[derive(Clone, Default)]
struct Asked {
    ticks: Vec<i32>,
}

struct Hub {
    desk: Desk,
    senders: [Sender; SENDERS.len()],
    asked: [Asked; OUTPUTS],
    number: u8,
    /// When a SafetyState last said safe, a status last said disarmed, and a command last was
    /// certain to be followed.
    safe_ms: Option<u64>,
    disarmed_ms: Option<u64>,
    followed_ms: Option<u64>,
    /// A restart or an update was asked for.
    is_ending: bool,
}

/// Runs the steps of an input.
pub fn run(mut input: &[u8]) {
    let mut hub = Hub::new();
    while hub.step(&mut input).is_some() && !hub.desk.is_to_restart && hub.now_ms() < LIFE_MS {}
}

fn byte(input: &mut &[u8]) -> Option<u8> {
    let (byte, rest) = input.split_first()?;
    *input = rest;
    Some(*byte)
}

impl Hub {
    fn new() -> Hub {
        let mut hub = Hub::with(Memory::blank());
        hub.set("OUT_COUNT", OUTPUTS as i64);
        for output in 1..=OUTPUTS {
            hub.set(&format!("OUT{output}_FS"), 2);
            hub.set(&format!("OUT{output}_FS_PWM"), FAILSAFE_US);
            hub.set(&format!("OUT{output}_TYPE"), (output <= usize::from(MOTORS)).into());
            let id = if output <= usize::from(MOTORS) { output - 1 } else { output };
            hub.set(&format!("OUT{output}_ID"), id as i64);
        }
        hub.request(EXECUTE_OPCODE, &[0; 7], 0);
        (0..1000).for_each(|_| hub.desk.pass(1));
        Hub::with(std::mem::replace(&mut hub.desk.memory, Memory::blank()))
    }

    fn with(memory: Memory) -> Hub {
        Hub {
            desk: Desk::start_with_loader(memory, ResetCause::POWER_ON, true),
            senders: Default::default(),
            asked: Default::default(),
            number: 0,
            safe_ms: None,
            disarmed_ms: None,
            followed_ms: None,
            is_ending: false,
        }
    }

    fn now_ms(&self) -> u64 {
        self.desk.ms.into()
    }

    fn is_within(&self, since: Option<u64>, ms: u64) -> bool {
        since.is_some_and(|since| self.now_ms() - since < ms)
    }

    fn hear(&mut self, id: u32, data: &[u8]) {
        let mut frame = Frame { id: id.to_be_bytes(), len: data.len() as u8, ..Frame::EMPTY };
        frame.data[..data.len()].copy_from_slice(data);
        self.desk.hear(&frame);
    }

    fn request(&mut self, id: u32, payload: &[u8], seed: u16) {
        self.number = (self.number + 1) % 32;
        for data in split(payload, TransferId::new(self.number), seed) {
            self.hear(id, &data);
        }
    }

    fn set(&mut self, name: &str, value: i64) {
        let request = dronecan_host::ParameterRequest {
            index: 0,
            value: dronecan_host::Value::Integer(value),
            name: name.into(),
        };
        let (data_type, payload) = Message::ParameterRequest(request).encode().expect("a request");
        self.request(GET_SET, &payload, data_type.seed.expect("known"));
        self.desk.pass(1);
        self.desk.can.sent.clear();
    }

    fn pulses(&self) -> [i32; OUTPUTS] {
        std::array::from_fn(|output| self.desk.program.node.pulse(output).into())
    }

    fn of(&self, output: usize, parameter: OutputParameter) -> u16 {
        self.desk.program.node.parameters.of(output, parameter)
    }

    fn is_motor(&self, output: usize) -> bool {
        self.of(output, OutputParameter::Type) == 1
    }

    fn step(&mut self, input: &mut &[u8]) -> Option<()> {
        let kind = byte(input)? % 16;
        match kind {
            0..=2 => {
                let (sender, count) = (byte(input)?, 1 + byte(input)? % 15);
                let entries = (0..count)
                    .map(|_| Some((byte(input)? % 12, byte(input)?)))
                    .collect::<Option<Vec<_>>>()?;
                self.begin_positions(usize::from(sender) % SENDERS.len(), &entries);
            }
            3 => {
                let (sender, count) = (byte(input)?, 1 + byte(input)? % 9);
                let values = (0..count).map(|_| byte(input)).collect::<Option<Vec<_>>>()?;
                self.begin_throttles(usize::from(sender) % STRANGER, &values);
            }
            4..=9 => self.send_next(usize::from(byte(input)?) % SENDERS.len()),
            10 => self.senders[usize::from(byte(input)?) % SENDERS.len()].sending = None,
            11 => {
                let (sender, status) = (byte(input)?, [0, ARMED][usize::from(byte(input)? % 2)]);
                self.arm(usize::from(sender) % SENDERS.len(), status);
            }
            12 => {
                let (sender, status) = (byte(input)?, [SAFE, 255][usize::from(byte(input)? % 2)]);
                self.safety(usize::from(sender) % SENDERS.len(), status);
            }
            13 => {
                let (output, value) = (byte(input)?, byte(input)?);
                self.change(usize::from(output) % OUTPUTS, value);
            }
            14 => (0..=u16::from(byte(input)?)).for_each(|_| self.tick()),
            _ => self.end(byte(input)?),
        }
        self.check();
        Some(())
    }

    // ---- commands ----

    fn begin_positions(&mut self, sender: usize, entries: &[(u8, u8)]) {
        let (mut payload, mut positions) = (vec![], vec![]);
        for &(id, value) in entries {
            let us = 990 + 4 * i32::from(value);
            let bits = if sender == STRANGER { f16::NAN } else { f16::from_f64(us.into()) };
            payload.extend([id, PWM]);
            payload.extend(bits.to_le_bytes());
            let ticks = (2 * us).clamp(LOW, HIGH);
            positions.push((id, (sender != STRANGER).then_some(ticks)));
        }
        let seed = types::ARRAY_COMMAND.seed.expect("known");
        self.begin(sender, ARRAY_COMMAND, &payload, seed, Order::Positions(positions));
    }

    fn begin_throttles(&mut self, sender: usize, values: &[u8]) {
        let throttles: Vec<i16> = values.iter().map(|value| i16::from(*value) * 32).collect();
        let ticks = |throttle: &i16| LOW + i32::from(*throttle) * (HIGH - LOW) / 8191;
        let order = Order::Throttles(throttles.iter().map(ticks).collect());
        let (_, payload) = Message::RawCommand(throttles).encode().expect("a command");
        let seed = types::RAW_COMMAND.seed.expect("known");
        self.begin(sender, RAW_COMMAND, &payload, seed, order);
    }

    fn begin(&mut self, sender: usize, id: u32, payload: &[u8], seed: u16, order: Order) {
        let number = &mut self.senders[sender].number;
        *number = (*number + 1) % 32;
        let frames: VecDeque<_> =
            split(payload, TransferId::new(*number), seed).into_iter().collect();
        let is_single = frames.len() == 1;
        let id = id | u32::from(SENDERS[sender]);
        let last_ms = self.now_ms();
        self.senders[sender].sending =
            Some(Sending { id, frames, order, is_single, is_certain: true, last_ms });
    }

    fn send_next(&mut self, sender: usize) {
        let now_ms = self.now_ms();
        let Some(mut sending) = self.senders[sender].sending.take() else { return };
        let Some(data) = sending.frames.pop_front() else { return };
        let is_start = data.last().is_some_and(|tail| tail & 0x80 != 0);
        if is_start && !sending.is_single {
            // With one lane a list of another type waits as another sender's.
            let is_other = |&(n, other): &(usize, &Sender)| {
                n != sender || LANES == 1 && other.begun_id != sending.id
            };
            let begun = self.senders.iter().enumerate().filter(is_other);
            let begun: Vec<_> = begun.filter_map(|(_, other)| other.begun_ms).collect();
            sending.is_certain = begun.iter().all(|begun_ms| now_ms - begun_ms > 2 * LIST_MS);
            self.disturb();
        }
        if !sending.is_single {
            self.senders[sender].begun_ms = Some(now_ms);
            self.senders[sender].begun_id = sending.id;
            sending.is_certain &= now_ms - sending.last_ms < LIST_MS;
        }
        sending.last_ms = now_ms;
        if sending.frames.is_empty() {
            self.note(&sending.order);
        }
        self.hear(sending.id, &data);
        if !sending.frames.is_empty() {
            self.senders[sender].sending = Some(sending);
        } else if sending.is_single || sending.is_certain {
            self.assert_followed(&sending.order);
        }
    }

    /// What is being sent need not be followed.
    fn disturb(&mut self) {
        for sending in self.senders.iter_mut().filter_map(|sender| sender.sending.as_mut()) {
            sending.is_certain = false;
        }
    }

    /// Notes what the outputs may do for a complete command.
    fn note(&mut self, order: &Order) {
        for output in 0..OUTPUTS {
            let id = self.of(output, OutputParameter::Id);
            let is_motor = self.is_motor(output);
            let asked = &mut self.asked[output].ticks;
            match order {
                Order::Positions(positions) if !is_motor => asked.extend(
                    positions.iter().filter(|of| u16::from(of.0) == id).filter_map(|of| of.1),
                ),
                Order::Throttles(throttles) if is_motor => {
                    if let Some(ticks) = throttles.get(usize::from(id)) {
                        asked.extend([*ticks, LOW]);
                    }
                }
                _ => {}
            }
        }
    }

    /// Each servo has the width of its last entry, unless a safety switch may be on.
    fn assert_followed(&mut self, order: &Order) {
        let Order::Positions(positions) = order else { return };
        if self.is_within(self.safe_ms, STATUS_MS) {
            return;
        }
        for output in 0..OUTPUTS {
            if self.is_motor(output) {
                continue;
            }
            let id = self.of(output, OutputParameter::Id);
            let last = positions.iter().rfind(|of| u16::from(of.0) == id).and_then(|of| of.1);
            if let Some(ticks) = last {
                let pulse = self.pulses()[output];
                assert!((pulse - ticks).abs() <= TOLERANCE, "{pulse} of {ticks} on {output}");
                self.followed_ms = Some(self.now_ms());
            }
        }
    }

    // ---- statuses, changes, ends ----

    fn send_status(&mut self, id: u32, sender: usize, status: u8) {
        self.number = (self.number + 1) % 32;
        self.hear(id | u32::from(SENDERS[sender]), &[status, 0xC0 | self.number]);
    }

    fn arm(&mut self, sender: usize, status: u8) {
        self.send_status(ARMING_STATUS, sender, status);
        let now_ms = self.now_ms();
        if status == ARMED {
            self.senders[sender].armed_ms = Some(now_ms);
        } else {
            self.disarmed_ms = Some(now_ms);
        }
    }

    fn safety(&mut self, sender: usize, status: u8) {
        let before = self.pulses();
        // Whoever has commanded nothing may turn the switch on only if nobody else commands.
        let is_commanded = self.asked.iter().any(|asked| !asked.ticks.is_empty());
        self.send_status(SAFETY_STATE, sender, status);
        if sender == STRANGER && is_commanded && self.is_within(self.followed_ms, 2000) {
            assert_eq!(self.pulses(), before, "a stranger's SafetyState");
        } else if status == SAFE {
            self.safe_ms = Some(self.now_ms());
        }
    }

    /// A client sets the type of an output, or its ID.
    fn change(&mut self, output: usize, value: u8) {
        let parameters = [OutputParameter::Type, OutputParameter::Id];
        let before = parameters.map(|parameter| self.of(output, parameter));
        match value % 3 {
            0 => self.set(&format!("OUT{}_TYPE", output + 1), i64::from(value / 3 % 2)),
            _ => self.set(&format!("OUT{}_ID", output + 1), i64::from(value / 3 % 12)),
        }
        let after = parameters.map(|parameter| self.of(output, parameter));
        if before != after {
            self.disturb();
            self.asked[output] = Asked::default();
            assert_eq!(self.pulses()[output], 0, "the pulse of the old type or ID");
        }
    }

    fn end(&mut self, which: u8) {
        self.is_ending = true;
        if which.is_multiple_of(4) {
            self.request(RESTART_NODE, &[0x1E, 0x1B, 0x55, 0xCE, 0xAC], 0);
        } else {
            self.request(UPDATE, b"\0fw.bin", types::BEGIN_FIRMWARE_UPDATE.seed.expect("known"));
        }
    }

    fn tick(&mut self) {
        if self.desk.is_to_restart {
            return;
        }
        self.desk.pass(1);
        self.desk.can.sent.clear();
        self.desk.log.clear();
        self.check();
        if self.desk.is_to_restart {
            assert!(self.is_ending, "nobody asked for a restart");
            let is_update = self.desk.request.is_some();
            let is_in_use = self.is_within(self.followed_ms, 1900);
            let may = !is_in_use
                || self.is_within(self.disarmed_ms, STATUS_MS)
                || self.is_within(self.safe_ms, STATUS_MS);
            assert!(!is_update || may, "the bootloader in use");
        }
    }

    /// Each pulse is one that was asked for.
    fn check(&self) {
        for (output, pulse) in self.pulses().into_iter().enumerate() {
            let asked = &self.asked[output].ticks;
            let failsafe = if self.is_motor(output) { LOW } else { 2 * FAILSAFE_US as i32 };
            let is_it = |ticks: &i32| (pulse - ticks).abs() <= TOLERANCE;
            let is_asked = asked.iter().any(is_it) || !asked.is_empty() && is_it(&failsafe);
            assert!(pulse == 0 || is_asked, "{pulse} ticks on output {output}, asked {asked:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench::Noise;

    /// Random steps reach armed motors, interleaved lists and changes.
    #[test]
    fn random_steps_of_three_commanders_move_only_what_they_command() {
        for seed in 0..300 {
            let mut random = Noise::new(seed);
            let input: Vec<u8> = (0..3000).map(|_| random.next_u64() as u8).collect();
            let outcome = std::panic::catch_unwind(|| run(&input));
            assert!(outcome.is_ok(), "seed {seed}");
        }
    }
}
