//! A real bus on an SLCAN adapter, without I/O: the bytes of its port and the time in, bytes for
//! the port and what the page shows out.
//!
//! The adapter only listens until the user asks for something that has to be sent: so a wrong bit
//! rate disturbs nobody. One that cannot only listen is opened when the user allows it. Then the
//! adapter is opened to send, and the page takes a node ID that no node has, sends NodeStatus as
//! each node does, and asks. If another node sends with that ID, the page sends nothing more until
//! the user asks again. It commands an output only in a check.
//!
//! Memory is bounded: 127 nodes, one node's parameters, the last frames.

mod check;
mod frames;
mod nodes;
mod updates;

use std::collections::VecDeque;
use std::time::Duration;

use bench::bus_log::Format;
use bench::can::Frame;
use bench::dronecan::slcan::adapter::{Adapter, Channel, Refusal};
use bench::dronecan::{Message, NodeId, NodeInfo, NodeStatus, Opcode, Transfer};
use node_tools::update::file::FirmwareFile;
use node_tools::update::search::{self, Search};
use node_tools::update::tool::Tool;
use serde_json::{Value as Json, json};

use crate::dialogue::Dialogue;
use crate::traffic::shown;
use check::Check;
use frames::Frames;
use nodes::Nodes;
use updates::Updates;

/// Frames that wait for the adapter: half a second of a bus with a few requests.
const QUEUE_MAX: usize = 1000;
/// Longest message of a node that the page shows.
const MESSAGE_MAX: usize = 300;
/// The name of this page among the senders of frames.
const OWN_NAME: &str = "this page";
/// The name of this page for other nodes (GetNodeInfo). No update is for a node of this name.
const NODE_NAME: &str = "org.dronecan.page";

/// Numbers of frames, and of lines of the adapter.
#[derive(Default)]
struct Counters {
    received: u64,
    sent: u64,
    /// Frames for which the queue had no room.
    dropped: u64,
}

/// The bus.
pub struct RealBus {
    adapter: Option<Adapter>,
    /// True if the channel was open when the page looked last.
    was_open: bool,
    /// True if the adapter cannot listen only, and waits until the user allows it to send.
    asks_to_send: bool,
    /// Why there is no bus, or why the page stopped sending.
    trouble: Option<String>,
    bit_rate: u32,
    tool: Tool,
    /// True if the user has asked for something that has to be sent.
    wants_id: bool,
    search: Search,
    updates: Updates,
    check: Option<Check>,
    /// The node whose parameters are shown.
    dialogue: Option<(NodeId, Dialogue)>,
    nodes: Nodes,
    frames: Frames,
    queue: VecDeque<Frame>,
    counters: Counters,
}

impl Default for RealBus {
    fn default() -> RealBus {
        RealBus {
            adapter: None,
            was_open: false,
            asks_to_send: false,
            trouble: None,
            bit_rate: 1_000_000,
            tool: Tool::default(),
            wants_id: false,
            search: Search::new(search::Nodes::All, Duration::ZERO),
            updates: Updates::default(),
            check: None,
            dialogue: None,
            nodes: Nodes::default(),
            frames: Frames::new(1_000_000),
            queue: VecDeque::new(),
            counters: Counters::default(),
        }
    }
}

impl RealBus {
    // ---- the adapter ----

    /// Forgets the bus before, and begins to open the adapter.
    pub fn connect(&mut self, bit_rate: u32, now: Duration) {
        *self = RealBus {
            adapter: Some(Adapter::new(bit_rate, Channel::ListenOnly, now)),
            bit_rate,
            frames: Frames::new(bit_rate),
            ..RealBus::default()
        };
    }

    /// True while there is an adapter.
    pub fn is_connected(&self) -> bool {
        self.adapter.is_some()
    }

    /// Handles bytes of the port.
    pub fn receive(&mut self, bytes: &[u8], now: Duration) {
        let Some(adapter) = &mut self.adapter else { return };
        let mut frames = Vec::new();
        let mut stamps = Vec::new();
        // The adapter keeps the stamp of the last frame only.
        let result = bytes.iter().try_for_each(|byte| {
            let result = adapter.receive(&[*byte], now, &mut frames);
            stamps.resize(frames.len(), adapter.stamp_us());
            result
        });
        self.counters.received += frames.len() as u64;
        let stamp_us = adapter.stamp_us();
        for decoded in self.frames.add(&frames, None, now) {
            self.nodes.take(&decoded, now);
        }
        if !frames.is_empty() {
            self.frames.measure(stamp_us, now);
        }
        for (frame, stamp_us) in frames.iter().zip(stamps) {
            if let Some(check) = self.check.as_mut().filter(|check| check.is_running()) {
                check.take(frame, now, stamp_us);
            } else if let Some(transfer) = self.tool.receive(frame, now) {
                self.take(&transfer, now);
            }
        }
        if let Err(refusal) = result {
            self.take_refusal(refusal);
        }
        self.poll(now);
    }

    /// An adapter that cannot listen only stays closed until the user allows it to send.
    fn take_refusal(&mut self, refusal: Refusal) {
        match refusal {
            Refusal::CannotListen => self.asks_to_send = true,
            _ => self.close(&refusal.to_string()),
        }
    }

    /// Opens an adapter that cannot listen only.
    pub fn allow_sending(&mut self, now: Duration) {
        if self.asks_to_send {
            self.asks_to_send = false;
            self.open_to_send(now);
        }
    }

    fn open_to_send(&mut self, now: Duration) {
        let mut adapter = Adapter::new(self.bit_rate, Channel::Normal, now);
        if self.check.is_some() {
            adapter.request_stamps();
        }
        adapter.invalid = self.adapter.as_ref().map_or(0, |before| before.invalid);
        self.adapter = Some(adapter);
    }

    /// Does what is due. Call it some times a second, and after [`RealBus::take_output`].
    pub fn poll(&mut self, now: Duration) {
        self.frames.poll(now);
        let Some(adapter) = self.adapter.as_mut().filter(|_| !self.asks_to_send) else { return };
        if let Err(refusal) = adapter.poll(now) {
            self.take_refusal(refusal);
            return;
        }
        if !adapter.is_open() {
            return;
        }
        if self.wants_id && adapter.channel() == Channel::ListenOnly {
            self.open_to_send(now);
            return;
        }
        if !self.was_open {
            self.was_open = true;
            self.search = Search::new(search::Nodes::All, now);
        }
        if let Some(check) = self.check.as_mut().filter(|check| check.is_running()) {
            self.queue.extend(check.poll(now, self.queue.len(), adapter));
            self.send(now);
            return;
        }
        if self.tool.has_conflict() {
            self.leave();
        }
        if self.wants_id && self.tool.id().is_none() {
            self.take_id(now);
        }
        self.tool.poll(now);
        self.ask(now);
        for node in self.updates.poll(&mut self.tool, &self.search, now) {
            self.nodes.ask_again(node, now);
        }
        self.send(now);
    }

    /// Removes and returns the bytes for the port. Call it again when they are written.
    pub fn take_output(&mut self) -> Vec<u8> {
        let Some(adapter) = &mut self.adapter else { return Vec::new() };
        let bytes = adapter.output().to_vec();
        adapter.written(bytes.len());
        bytes
    }

    /// Ends the session. Returns the bytes that close the adapter's channel.
    pub fn disconnect(&mut self) -> Vec<u8> {
        let was_open = self.adapter.is_some();
        self.end();
        if was_open { b"\rC\r".to_vec() } else { Vec::new() }
    }

    /// Ends the session, because the port or the adapter does not work; `why` in words.
    pub fn close(&mut self, why: &str) {
        self.end();
        self.trouble = Some(why.into());
    }

    fn end(&mut self) {
        self.updates.stop_all();
        if let Some(check) = &mut self.check {
            check.lose("the adapter is gone");
        }
        self.adapter = None;
        self.was_open = false;
        self.asks_to_send = false;
        self.wants_id = false;
        self.tool = Tool::default();
        self.queue.clear();
        self.trouble = None;
        self.let_go();
    }

    fn send(&mut self, now: Duration) {
        for frame in self.tool.take_frames() {
            if self.queue.len() < QUEUE_MAX {
                self.queue.push_back(frame);
            } else {
                self.counters.dropped += 1;
            }
        }
        let Some(adapter) = &mut self.adapter else { return };
        let mut sent = Vec::new();
        while let Some(frame) = self.queue.front()
            && adapter.send(frame, now)
        {
            sent.extend(self.queue.pop_front());
        }
        self.counters.sent += sent.len() as u64;
        self.frames.add(&sent, Some(OWN_NAME), now);
    }

    // ---- the node ID ----

    /// Takes a node ID after listening: that of a page or program that was stopped in an update, or
    /// a free one.
    fn take_id(&mut self, now: Duration) {
        if self.search.is_listening(now) {
            return;
        }
        let left = self.search.left_server(self.tool.heard(), now);
        match self.tool.take_id(None, left) {
            Ok(id) => {
                self.trouble = None;
                self.updates.join(id);
            }
            Err(error) => {
                self.wants_id = false;
                self.trouble = Some(error.to_string());
            }
        }
    }

    /// Gives the node ID up, because another node sends with it.
    fn leave(&mut self) {
        let id = self.tool.id().map_or_else(String::new, |id| id.to_string());
        self.updates.stop_all();
        self.tool.leave();
        self.queue.clear();
        self.wants_id = false;
        self.trouble = Some(format!(
            "another node sends with node ID {id}, which this page had taken: the page sends \
             nothing more. The next request takes another ID"
        ));
        self.let_go();
    }

    /// Ends the requests to the node whose parameters are shown, and keeps what it told.
    fn let_go(&mut self) {
        if let Some((_, dialogue)) = &mut self.dialogue {
            dialogue.cancel();
        }
    }

    // ---- what the user asks for ----

    /// Asks the nodes for their names.
    pub fn ask_names(&mut self) {
        self.wants_id = true;
    }

    /// Chooses the node whose parameters are shown. Sends nothing.
    pub fn choose(&mut self, node: NodeId) {
        if self.dialogue.as_ref().is_none_or(|(chosen, _)| *chosen != node) {
            self.dialogue = Some((node, Dialogue::default()));
        }
    }

    /// Reads all parameters of the chosen node.
    pub fn read_parameters(&mut self) {
        self.ask_chosen(Dialogue::read_all);
    }

    /// Sets a parameter of the chosen node to what the user wrote.
    ///
    /// # Errors
    /// If that is no value of the parameter.
    pub fn set_parameter(&mut self, name: &str, text: &str) -> Result<(), String> {
        let Some((_, dialogue)) = &mut self.dialogue else {
            return Err(String::from("no node is chosen"));
        };
        dialogue.set_written(name, text)?;
        self.wants_id = true;
        Ok(())
    }

    /// Sets the parameters of the chosen node that differ in a file.
    ///
    /// # Errors
    /// If the file has no parameters, or the node has not answered yet.
    pub fn load_parameters(&mut self, file: &str) -> Result<(), String> {
        let Some((node, dialogue)) = &mut self.dialogue else {
            return Err(String::from("no node is chosen"));
        };
        let others = self.nodes.ids().chain(self.tool.id()).filter(|id| id != node);
        dialogue.load(file, others.map(NodeId::get).collect())?;
        self.wants_id = true;
        Ok(())
    }

    /// A file with the parameters of the chosen node that were read.
    pub fn parameter_file(&self) -> String {
        let Some((node, dialogue)) = &self.dialogue else { return String::new() };
        let name = self.nodes.info(*node).map(|info| shown(&info.name(), MESSAGE_MAX));
        let name = name.filter(|name| !name.is_empty());
        let title = name.map_or_else(String::new, |name| format!(", {name}"));
        dialogue.file(&format!("Parameters of node {node}{title}"))
    }

    /// Saves the parameters of the chosen node.
    pub fn save_parameters(&mut self) {
        self.ask_chosen(|dialogue| dialogue.execute(Opcode::SAVE));
    }

    /// Erases the saved parameters of the chosen node.
    pub fn erase_parameters(&mut self) {
        self.ask_chosen(|dialogue| dialogue.execute(Opcode::ERASE));
    }

    /// Restarts the chosen node.
    pub fn restart(&mut self) {
        self.ask_chosen(Dialogue::restart);
    }

    fn ask_chosen(&mut self, ask: impl FnOnce(&mut Dialogue)) {
        if let Some((_, dialogue)) = &mut self.dialogue {
            ask(dialogue);
            self.wants_id = true;
        }
    }

    /// Updates a node with a file.
    ///
    /// # Errors
    /// If the file is not a firmware that takes updates, too, or the node is in an update.
    pub fn update(&mut self, node: NodeId, file: Vec<u8>, now: Duration) -> Result<(), String> {
        let file = FirmwareFile::parse(file).map_err(|error| error.to_string())?;
        if !file.takes_updates() {
            return Err("this program takes no further update over the bus: build one with the \
                        feature \"update\", or flash it through USB"
                .to_owned());
        }
        self.updates.ask(node, file)?;
        self.nodes.ask_again(node, now);
        self.wants_id = true;
        Ok(())
    }

    /// True if a file is a firmware for the hardware of a node, as far as the node has told it.
    pub fn suits(&self, node: NodeId, file: Vec<u8>) -> bool {
        let info = self.nodes.info(node);
        info.zip(FirmwareFile::parse(file).ok())
            .is_some_and(|(info, file)| search::why_unsuitable(info, &file).is_none())
    }

    /// Stops the update of a node.
    pub fn stop_update(&mut self, node: NodeId, now: Duration) {
        self.updates.stop(node, now);
    }

    /// Begins to check a node. `left` is what earlier checks of it have not put back.
    pub fn begin_check(&mut self, node: NodeId, left: &str, now: Duration) {
        if self.adapter.is_some() && self.check.as_ref().is_none_or(|check| !check.is_running()) {
            self.updates.stop_all();
            self.let_go();
            self.tool.leave();
            self.queue.clear();
            self.check = Some(Check::new(node, self.bit_rate, left));
            self.open_to_send(now);
        }
    }

    /// The checks.
    pub fn check(&mut self) -> Option<&mut Check> {
        self.check.as_mut()
    }

    /// The report of the checks.
    pub fn check_report(&self) -> String {
        self.check.as_ref().map_or_else(String::new, |check| check.report(self.bit_rate))
    }

    // ---- requests and answers ----

    fn take(&mut self, transfer: &Transfer, now: Duration) {
        self.search.take(transfer);
        if Message::decode(transfer) == Message::NodeInfoRequest {
            self.tool.answer(transfer, &own_info(now).encode());
        }
        if let Some((node, dialogue)) = &mut self.dialogue
            && transfer.id.source() == Some(*node)
        {
            dialogue.take(transfer);
        }
        if let Some(answer) = self.updates.take(transfer, now, self.tool.heard()) {
            self.tool.answer(transfer, &answer);
        }
    }

    fn ask(&mut self, now: Duration) {
        if self.tool.id().is_none() {
            return;
        }
        for node in self.nodes.take_due(now) {
            self.tool.request(&Message::NodeInfoRequest, node);
        }
        if let Some((node, dialogue)) = &mut self.dialogue
            && let Some(message) = dialogue.poll(now)
        {
            dialogue.sent(self.tool.request(&message, *node));
        }
    }

    // ---- what the page shows ----

    /// The state of the bus, a JSON object.
    pub fn snapshot(&self, now: Duration) -> Json {
        let state = match &self.adapter {
            None => "closed",
            Some(_) if self.asks_to_send => "asks",
            Some(adapter) if adapter.is_open() => "open",
            Some(_) => "opening",
        };
        let counter = |count: fn(&Adapter) -> u64| self.adapter.as_ref().map_or(0, count);
        json!({
            "state": state,
            "trouble": self.trouble.as_ref().map(|why| shown(why, MESSAGE_MAX)),
            "now": now.as_secs_f64(),
            "bit_rate": self.bit_rate,
            "only_listens": self.adapter.as_ref().is_some_and(|adapter| {
                adapter.channel() == Channel::ListenOnly
            }),
            "load": self.frames.load(),
            "own_id": self.tool.id().map(NodeId::get),
            "listens_first": self.wants_id && self.tool.id().is_none(),
            "received": self.counters.received,
            "sent": self.counters.sent,
            "dropped": self.counters.dropped,
            "echoed": counter(|adapter| adapter.echoed),
            "invalid": counter(|adapter| adapter.invalid),
            "logged": self.frames.logged(),
            "nodes": self.nodes.json(now),
            "chosen": self.dialogue.as_ref().map(|(node, _)| node.get()),
            "client": self.dialogue.as_ref().map(|(_, dialogue)| dialogue.json()),
            "updates": self.updates.json(),
            "check": self.check.as_ref().map(|check| check.json(now)),
        })
    }

    /// Removes and returns the frames since the last call, a JSON array of events.
    pub fn take_events(&mut self) -> Json {
        self.frames.take_events()
    }

    /// The details of a frame, a JSON object.
    ///
    /// # Errors
    /// If the frame is too old.
    pub fn frame(&self, number: u64) -> anyhow::Result<Json> {
        self.frames.details(number)
    }

    /// The log of the bus.
    pub fn log(&self, format: Format) -> Vec<u8> {
        self.frames.log(format)
    }
}

/// What this page answers to GetNodeInfo, as each node has to.
fn own_info(now: Duration) -> NodeInfo {
    let status = NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() };
    NodeInfo { status, name: NODE_NAME.into(), ..NodeInfo::default() }
}

#[cfg(test)]
mod tests;
