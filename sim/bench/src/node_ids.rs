//! Node IDs, and other parameters, of further boards. Each board with this project's firmware gets
//! an ID of its own before the run, over a bus of its own: it is written and saved as a tool would
//! do it.

use crate::avr::Avr;
use crate::board::Board;
use crate::can::{Frame, Id, SoftNode};
use crate::dronecan::{
    CanId, Decoded, Message, NodeId, Observation, Observer, Opcode, ParameterRequest, TransferId,
    Value, frames,
};
use crate::wiring::Wiring;
use crate::{Bench, Cycles, F_CPU_HZ, elapsed};
use anyhow::Result;
use std::cell::RefCell;
use std::rc::Rc;

/// The node ID of a board whose EEPROM is empty.
const DEFAULT: u8 = 120;
/// IDs of the further boards, in their order: after the default up to the largest that `CAN_NODE`
/// can have, then down. IDs below 11 are free for autopilots.
const LARGEST: u8 = 125;
const SMALLEST: u8 = 11;
/// Node ID of the tool: the last two are for debuggers and the like.
const TOOL: u8 = 127;
/// The parameter with the node ID.
pub const CAN_NODE: &str = "CAN_NODE";
const PRIORITY: u8 = 30;
/// Longest start of a node, with an allowance. A first start makes the unique ID.
const START_MAX: Cycles = 4 * F_CPU_HZ;
/// Longest time until a node answers. A save takes 3.4 ms a byte.
const ANSWER_MAX: Cycles = F_CPU_HZ;
/// Simulated time between two looks at the answers.
const PERIOD: Cycles = F_CPU_HZ / 1000;

/// The node ID of the further board with this number, from 0. `None` if there are more boards than
/// IDs.
pub fn id_of(number: usize) -> Option<u8> {
    (DEFAULT + 1..=LARGEST).chain((SMALLEST..DEFAULT).rev()).nth(number)
}

/// Starts the node and saves parameters: names and values. Returns the content of its EEPROM;
/// `None` if the program does not know a parameter or accept its value, or does not answer.
///
/// # Errors
/// If the wiring is impossible.
pub fn saved(
    avr: Avr,
    wiring: &Wiring,
    bit_rate: u32,
    parameters: &[(&str, i64)],
) -> Result<Option<Vec<u8>>> {
    let mut tool = Tool::new(Board::wired(avr, wiring)?, bit_rate);
    let has_saved = |answer: &Message| *answer == Message::OpcodeExecuted(true);
    let works = tool.receive(START_MAX, |message| matches!(message, Message::NodeStatus(_)))
        && parameters.iter().all(|(name, value)| tool.set(name, *value))
        && tool.ask(&Message::ExecuteOpcode(Opcode::SAVE), has_saved);
    Ok(works.then(|| tool.bench.board(0).avr().eeprom()))
}

/// A bus with the node and a tool.
struct Tool {
    bench: Bench,
    station: Rc<RefCell<SoftNode>>,
    observer: Observer,
    transfer_id: TransferId,
}

impl Tool {
    fn new(board: Board, bit_rate: u32) -> Tool {
        let mut bench = Bench::new(bit_rate);
        bench.add_board(board, "node");
        let station = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        bench.attach("tool", station.clone());
        Tool { bench, station, observer: Observer::new(), transfer_id: TransferId::default() }
    }

    /// Runs until the node sends a message that satisfies `is_wanted`, at most for `timeout`.
    fn receive(&mut self, timeout: Cycles, is_wanted: impl Fn(&Message) -> bool) -> bool {
        let end = self.bench.now() + timeout;
        while self.bench.now() < end {
            self.bench.run_until(self.bench.now() + PERIOD);
            let received = self.station.borrow_mut().take_received();
            let observer = &mut self.observer;
            if received.iter().any(|(at, frame)| {
                message(observer, *at, frame).is_some_and(|message| is_wanted(&message))
            }) {
                return true;
            }
        }
        false
    }

    /// Sets a parameter of the node. True if the node answers with this value.
    fn set(&mut self, name: &str, value: i64) -> bool {
        let value = Value::Integer(value);
        let set = ParameterRequest {
            value: value.clone(),
            name: name.into(),
            ..ParameterRequest::default()
        };
        self.ask(&Message::ParameterRequest(set), |answer| match answer {
            Message::ParameterResponse(response) => response.value == value,
            _ => false,
        })
    }

    /// Sends a request to the node. True if its answer satisfies `is_wanted`.
    fn ask(&mut self, request: &Message, is_wanted: impl Fn(&Message) -> bool) -> bool {
        let Some((data_type, payload)) = request.encode() else { return false };
        let ids = NodeId::new(DEFAULT).zip(NodeId::new(TOOL));
        let Some((destination, source)) = ids else { return false };
        let service_id = data_type.id as u8;
        let id =
            CanId::Service { priority: PRIORITY, service_id, request: true, destination, source };
        for frame in frames(id, &payload, self.transfer_id.advance()) {
            self.station.borrow_mut().send(frame);
        }
        self.receive(ANSWER_MAX, is_wanted)
    }
}

/// The message that the frame completes.
fn message(observer: &mut Observer, at: Cycles, frame: &Frame) -> Option<Message> {
    let Id::Extended(id) = frame.id else { return None };
    match observer.push(id, frame.data(), elapsed(at)) {
        Observation::Complete(Decoded::V0(_, message)) => Some(message),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ids_of_further_boards_differ_and_are_none_of_an_autopilot() {
        let ids: Vec<u8> = (0..).map_while(id_of).collect();
        assert_eq!(ids[..7], [121, 122, 123, 124, 125, 119, 118]);
        assert_eq!(ids.iter().collect::<std::collections::BTreeSet<_>>().len(), ids.len());
        assert!(!ids.contains(&DEFAULT) && *ids.iter().min().unwrap() == SMALLEST);
    }
}
