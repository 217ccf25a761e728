//! Parameters: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET on the channels, param.GetSet
//! on the bus.
//!
//! MAVLink needs the number of parameters, and its names are shorter. So the first request for a
//! node's parameters makes the bridge fetch all of them by index, several at a time, into a
//! [`Table`](crate::node::Table). Requests wait until the table is complete. A list is always
//! fetched again. A single parameter is read and set by its full name. The station receives
//! the node's answer: after a PARAM_SET the current value, even if the node rejected the new one.
//!
//! PARAM_ERROR answers a request that cannot be executed.

use crate::message::{Content, chars};
use crate::node::{Listing, Table};
use crate::number::{self, Number, Unfit};
use crate::post::{Asker, To};
use crate::queue::Class;
use crate::state::State;
use crate::task::{Op, Purpose};
use dronecan_host::{Message, NodeId, Opcode, ParameterRequest, ParameterResponse, Value};
use mavlink::dialects::common::{MavMessage, MavParamError, PARAM_ERROR_DATA};
use std::time::Duration;

/// The highest index that GetSet can encode.
const INDEX_MAX: u16 = (1 << 13) - 1;
/// Number of parameters fetched at once.
const AT_ONCE: usize = 5;
/// Maximum number of requests that wait for a node's table.
const WAITING_MAX: usize = 64;

impl State {
    /// Executes `op` for the node with component ID `component`, or for all nodes.
    pub(crate) fn parameter_ops(&mut self, component: u8, op: impl Fn() -> Op) {
        let all: Vec<NodeId> = match NodeId::new(component) {
            None if component == 0 => self.online_nodes().collect(),
            None => Vec::new(),
            Some(id) => self.nodes.contains_key(&id).then_some(id).into_iter().collect(),
        };
        for id in all {
            if !self.is_other_component(id.get()) {
                self.parameter_op(id, op());
            }
        }
    }

    fn parameter_op(&mut self, id: NodeId, op: Op) {
        let Some(node) = self.nodes.get_mut(&id) else { return };
        let must_list = matches!(op, Op::List(_) | Op::Print) || node.table.is_none();
        if !must_list && node.listing.is_none() {
            return self.run(id, op);
        }
        // The same request is waiting already.
        if node.waiting.len() < WAITING_MAX && !node.waiting.contains(&op) {
            node.waiting.push_back(op);
        }
        if node.listing.is_none() {
            self.list(id);
        }
    }

    /// Starts to fetch a node's parameters.
    pub(crate) fn list(&mut self, id: NodeId) {
        if let Some(node) = self.nodes.get_mut(&id) {
            node.listing = Some(Listing::default());
            self.continue_listing(id);
        }
    }

    fn continue_listing(&mut self, id: NodeId) {
        let Some(node) = self.nodes.get_mut(&id) else { return };
        let Some(listing) = &mut node.listing else { return };
        while listing.end.is_none() && listing.on_their_way < AT_ONCE && listing.next <= INDEX_MAX {
            let request = ParameterRequest { index: listing.next, ..ParameterRequest::default() };
            let purpose = Purpose::Item(listing.next);
            self.calls.ask(id, &Message::ParameterRequest(request), purpose);
            listing.next += 1;
            listing.on_their_way += 1;
        }
        let end = listing.end.unwrap_or(INDEX_MAX + 1);
        if (0..end).all(|index| listing.got.contains_key(&index)) {
            let got = std::mem::take(&mut listing.got);
            node.listing = None;
            self.calls.remove_requests(id, |purpose| matches!(purpose, Purpose::Item(_)));
            let all = got.into_iter().take_while(|(index, _)| *index < end);
            self.finish_listing(id, Table::new(all.map(|(_, parameter)| parameter)));
        }
    }

    /// Forgets a node's parameters and information, which may change with a restart: it may run
    /// another firmware.
    pub(crate) fn forget_parameters(&mut self, id: NodeId) {
        let failed = self
            .calls
            .remove_requests(id, |purpose| matches!(purpose, Purpose::Item(_) | Purpose::Info));
        let Some(node) = self.nodes.get_mut(&id) else { return };
        node.table = None;
        node.save_at = None;
        node.info.known = None;
        node.info.failures = 0;
        for purpose in failed {
            match purpose {
                Purpose::Info => node.info.is_requested = false,
                _ => node.listing = None,
            }
        }
        // The requests that waited for the parameters continue to wait.
        if !node.waiting.is_empty() && node.listing.is_none() {
            self.list(id);
        }
    }

    fn finish_listing(&mut self, id: NodeId, table: Table) {
        let Some(node) = self.nodes.get_mut(&id) else { return };
        if node.table.is_none() {
            let (count, left_out) = (table.entries.len(), table.left_out.len());
            self.log.push(format!("node {id} has {} parameters", count + left_out));
            for entry in table.entries.iter().filter(|entry| entry.short.as_bytes() != entry.full) {
                let name = entry.last.name();
                self.log.push(format!("node {id}: {name} is {} in MAVLink", entry.short));
            }
            for parameter in table.left_out.iter().map(|entry| &entry.last) {
                let name = parameter.name();
                self.log.push(format!("node {id}: {name} is text, which MAVLink cannot carry"));
            }
        }
        node.table = Some(table);
        let waiting = std::mem::take(&mut node.waiting);
        for op in waiting {
            self.run(id, op);
        }
    }

    fn fail_listing(&mut self, id: NodeId) {
        self.calls.remove_requests(id, |purpose| matches!(purpose, Purpose::Item(_)));
        let Some(node) = self.nodes.get_mut(&id) else { return };
        node.listing = None;
        let waiting = std::mem::take(&mut node.waiting);
        self.log.push(format!("node {id} does not send its parameters"));
        for op in waiting {
            match op {
                Op::List(asker) => {
                    let words = format!("Node {id} does not send its parameters");
                    self.say(To::One(asker.peer), id.get(), &words);
                }
                Op::ReadIndex(asker, index) => self.refuse(id, asker, Some(index), "", READ_FAIL),
                Op::ReadName(asker, name) | Op::Set { asker, name, .. } => {
                    self.refuse(id, asker, None, &name, READ_FAIL);
                }
                Op::Print => {}
            }
        }
    }

    /// Executes an operation with the complete table.
    fn run(&mut self, id: NodeId, op: Op) {
        let Some(table) = self.table(id) else { return };
        match op {
            Op::List(asker) if table.entries.is_empty() => {
                let words = match table.left_out.len() {
                    0 => format!("Node {id} has no parameters"),
                    _ => format!("Node {id} has parameters of text only"),
                };
                self.say(To::One(asker.peer), id.get(), &words);
            }
            Op::List(asker) => {
                for at in 0..table.entries.len() {
                    self.post_parameter(id, at, To::One(asker.peer), Class::Parameter);
                }
            }
            Op::ReadIndex(asker, index) => match usize::from(index) {
                at if at < table.entries.len() => self.read(id, asker, at, None),
                _ => self.refuse(id, asker, Some(index), "", DOES_NOT_EXIST),
            },
            Op::ReadName(asker, name) => match table.find(&name) {
                Some(at) => self.read(id, asker, at, None),
                None => self.refuse(id, asker, None, &name, why_not_found(table, &name)),
            },
            Op::Set { asker, name, value, kind } => match table.find(&name) {
                Some(at) => self.set(id, asker, at, value, kind),
                None => self.refuse(id, asker, None, &name, why_not_found(table, &name)),
            },
            Op::Print => {}
        }
    }

    fn read(&mut self, id: NodeId, asker: Asker, at: usize, error: Option<MavParamError>) {
        self.get_set(id, at, Value::Empty, Purpose::Read { asker, at, error });
    }

    fn set(&mut self, id: NodeId, asker: Asker, at: usize, value: f32, kind: u8) {
        let Some(table) = self.table(id) else { return };
        let decoded = number::decode(kind, value, asker.encoding, &table.entries[at].last);
        let error = match decoded {
            _ if !self.settings.rights.change => {
                Some(MavParamError::MAV_PARAM_ERROR_PERMISSION_DENIED)
            }
            Ok(Some(wanted)) => {
                let purpose = Purpose::Set { asker, at, wanted: wanted.clone() };
                return self.get_set(id, at, wanted, purpose);
            }
            // The parameter does not change, but the station gets an answer.
            Ok(None) => None,
            Err(Unfit::Kind) => Some(MavParamError::MAV_PARAM_ERROR_TYPE_UNSUPPORTED),
            Err(Unfit::Value) => Some(MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH),
        };
        self.read(id, asker, at, error);
    }

    fn get_set(&mut self, id: NodeId, at: usize, value: Value, purpose: Purpose) {
        let Some(table) = self.table(id) else { return };
        let request = ParameterRequest { index: 0, value, name: table.entries[at].full.clone() };
        self.calls.ask(id, &Message::ParameterRequest(request), purpose);
    }

    /// The parameters of a node, if they were fetched.
    fn table(&self, id: NodeId) -> Option<&Table> {
        self.nodes.get(&id)?.table.as_ref()
    }

    /// Handles the answer to a GetSet; `None` if there was none.
    pub(crate) fn parameter_answer(
        &mut self,
        now: Duration,
        id: NodeId,
        purpose: Purpose,
        payload: Option<&[u8]>,
    ) {
        let response = payload.and_then(ParameterResponse::decode);
        match purpose {
            Purpose::Item(index) => self.item(id, index, response),
            Purpose::Read { asker, at, error } => {
                if self.store_answer(id, asker, at, response) {
                    self.post_parameter(id, at, To::One(asker.peer), Class::Answer);
                    if let Some(error) = error {
                        self.reject_entry(id, asker, at, error);
                    }
                }
            }
            Purpose::Set { asker, at, wanted } => {
                let in_force = response.as_ref().map(|response| response.value.clone());
                if self.store_answer(id, asker, at, response) {
                    // All stations must see the new value.
                    self.post_parameter(id, at, To::All, Class::Answer);
                    if in_force != Some(wanted) {
                        let error = MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE;
                        self.reject_entry(id, asker, at, error);
                    } else if let (Some(after), Some(node)) =
                        (self.settings.autosave, self.nodes.get_mut(&id))
                    {
                        node.save_at = Some(now + after);
                    }
                }
            }
            _ => {}
        }
    }

    fn item(&mut self, id: NodeId, index: u16, response: Option<ParameterResponse>) {
        let Some(listing) = self.nodes.get_mut(&id).and_then(|node| node.listing.as_mut()) else {
            return;
        };
        listing.on_their_way = listing.on_their_way.saturating_sub(1);
        match response {
            None => return self.fail_listing(id),
            Some(response) if response.name.is_empty() => {
                listing.end = Some(listing.end.map_or(index, |end| end.min(index)));
            }
            Some(response) => {
                listing.got.insert(index, response);
            }
        }
        self.continue_listing(id);
    }

    /// Stores the node's answer about a parameter. If the answer is invalid, reports an error to
    /// the sender and returns `false`.
    fn store_answer(
        &mut self,
        id: NodeId,
        asker: Asker,
        at: usize,
        response: Option<ParameterResponse>,
    ) -> bool {
        let Some(node) = self.nodes.get_mut(&id) else { return false };
        let Some(entry) = node.table.as_mut().and_then(|table| table.entries.get_mut(at)) else {
            // The node has restarted in between.
            self.refuse(id, asker, u16::try_from(at).ok(), "", READ_FAIL);
            return false;
        };
        let (error, name) = match response {
            Some(response) if response.name == entry.full && Number::of(&response).is_some() => {
                entry.last = response;
                return true;
            }
            Some(_) => (DOES_NOT_EXIST, entry.short.clone()),
            None => (READ_FAIL, entry.short.clone()),
        };
        if error == DOES_NOT_EXIST {
            // The node has other parameters now.
            node.table = None;
        }
        self.refuse(id, asker, None, &name, error);
        false
    }

    fn post_parameter(&mut self, id: NodeId, at: usize, to: To, class: Class) {
        let Some(table) = self.table(id) else { return };
        let Some(number) = table.entries.get(at).and_then(|entry| Number::of(&entry.last)) else {
            return;
        };
        let content = Content::Parameter {
            name: table.entries[at].short.clone(),
            number,
            count: table.entries.len() as u16,
            index: at as u16,
        };
        self.post(to, class, id.get(), content);
    }

    fn reject_entry(&mut self, id: NodeId, asker: Asker, at: usize, error: MavParamError) {
        let entry = self.table(id).and_then(|table| table.entries.get(at));
        let name = entry.map(|entry| entry.short.clone()).unwrap_or_default();
        self.refuse(id, asker, None, &name, error);
    }

    /// Tells the sender of a request with PARAM_ERROR why there is no value.
    fn refuse(
        &mut self,
        id: NodeId,
        asker: Asker,
        index: Option<u16>,
        name: &str,
        error: MavParamError,
    ) {
        let data = PARAM_ERROR_DATA {
            param_index: index.and_then(|index| i16::try_from(index).ok()).unwrap_or(-1),
            target_system: asker.from.0,
            target_component: asker.from.1,
            param_id: chars(name.as_bytes()),
            error,
        };
        self.answer(asker, id.get(), MavMessage::PARAM_ERROR(data));
    }

    /// Saves parameters some time after the last PARAM_SET.
    pub(crate) fn autosave(&mut self, now: Duration) {
        for (id, node) in &mut self.nodes {
            if node.save_at.is_some_and(|at| now >= at) {
                node.save_at = None;
                self.calls.ask(*id, &Message::ExecuteOpcode(Opcode::SAVE), Purpose::Autosave);
            }
        }
    }
}

const READ_FAIL: MavParamError = MavParamError::MAV_PARAM_ERROR_READ_FAIL;
const DOES_NOT_EXIST: MavParamError = MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST;

/// Why the table has no parameter with this name.
fn why_not_found(table: &Table, name: &str) -> MavParamError {
    if table.is_left_out(name) {
        MavParamError::MAV_PARAM_ERROR_TYPE_UNSUPPORTED
    } else {
        DOES_NOT_EXIST
    }
}
