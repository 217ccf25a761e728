//! A program as a node on the bus, without I/O: frames in, transfers and frames out. Its user owns
//! the bus and the clock.

use std::collections::HashMap;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use dronecan_host::{
    Assembler, CanId, Frame, Id, Message, NodeId, NodeStatus, Outcome, Transfer, TransferId,
    frames, types,
};

use crate::update::heard::Heard;
use crate::update::session::server_asked;

/// The period of NodeStatus (protocol.NodeStatus).
const STATUS_PERIOD: Duration = Duration::from_secs(1);

/// Priorities of services and of NodeStatus, as in DroneCAN's own tools.
const SERVICE_PRIORITY: u8 = 16;
const STATUS_PRIORITY: u8 = 20;

/// The IDs that a tool takes, best first. 126 and 127 are for tools, and an allocator gives away
/// the others from 125 down.
const IDS: [u8; 2] = [126, 127];

/// A node that sends requests, answers file.Read, and sends NodeStatus. It sends nothing before it
/// has a node ID.
#[derive(Default)]
pub struct Tool {
    id: Option<NodeId>,
    heard: Heard,
    /// True if another node sends with this program's ID.
    has_conflict: bool,
    assembler: Assembler,
    /// Transfer IDs of requests, by service and destination.
    transfer_ids: HashMap<(u16, NodeId), TransferId>,
    status_transfer_id: TransferId,
    status_at: Duration,
    /// Frames for the bus.
    out: Vec<Frame>,
}

impl Tool {
    /// The node ID of this program, if it has one.
    pub fn id(&self) -> Option<NodeId> {
        self.id
    }

    /// The other nodes.
    pub fn heard(&self) -> &Heard {
        &self.heard
    }

    /// True if another node sends with this program's ID.
    pub fn has_conflict(&self) -> bool {
        self.has_conflict
    }

    /// Takes a node ID: `wanted` by the user, or `left` by a program that is gone, or the best one
    /// that no node has that was heard. Call it after listening. Returns the ID.
    ///
    /// # Errors
    /// If another node has the wanted ID, or all are in use.
    pub fn take_id(&mut self, wanted: Option<NodeId>, left: Option<NodeId>) -> Result<NodeId> {
        let id = match (wanted, left) {
            (Some(id), left) => {
                ensure!(
                    left == Some(id) || !self.heard.contains(id),
                    "another node has the ID {id}; without --own-id the program takes a free one"
                );
                id
            }
            (None, Some(id)) => id,
            (None, None) => free_id(&self.heard).context("all node IDs are in use")?,
        };
        self.id = Some(id);
        Ok(id)
    }

    /// Gives the node ID up, and sends nothing more.
    pub fn leave(&mut self) {
        self.id = None;
        self.has_conflict = false;
        self.out.clear();
    }

    /// Sends a request. Returns its transfer ID, which its response has, too; `None` without a node
    /// ID.
    pub fn request(&mut self, message: &Message, destination: NodeId) -> Option<TransferId> {
        let (id, (data_type, payload)) = (self.id?, message.encode()?);
        let transfer_id =
            self.transfer_ids.entry((data_type.id, destination)).or_default().advance();
        let id = service(id, data_type.id as u8, true, destination);
        self.out.extend(frames(id, &payload, transfer_id));
        Some(transfer_id)
    }

    /// Answers a request.
    pub fn answer(&mut self, request: &Transfer, payload: &[u8]) {
        if let (Some(id), CanId::Service { service_id, source, .. }) = (self.id, request.id) {
            let id = service(id, service_id, false, source);
            self.out.extend(frames(id, payload, request.transfer_id));
        }
    }

    /// Sends NodeStatus if it is due. Call it while the bus is open.
    pub fn poll(&mut self, now: Duration) {
        if let Some(id) = self.id
            && now >= self.status_at
        {
            self.status_at = now + STATUS_PERIOD;
            let status = NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() };
            let id = types::NODE_STATUS.message_id(STATUS_PRIORITY, id);
            let transfer_id = self.status_transfer_id.advance();
            self.out.extend(frames(id, &status.encode(), transfer_id));
        }
    }

    /// Handles a frame of the bus. Returns the transfer that it completes, unless that is for
    /// another node. Requests of file.Read to others are returned, too.
    pub fn receive(&mut self, frame: &Frame, now: Duration) -> Option<Transfer> {
        let Id::Extended(id) = frame.id else { return None };
        if let Some(source) = CanId::parse(id).and_then(CanId::source) {
            self.heard.note(source, now);
            if Some(source) == self.id {
                self.has_conflict = true;
                return None;
            }
        }
        let Outcome::Complete(transfer) = self.assembler.push(id, frame.data(), now) else {
            return None;
        };
        match transfer.id {
            CanId::Service { destination, .. }
                if Some(destination) != self.id && server_asked(&transfer).is_none() =>
            {
                None
            }
            _ => Some(transfer),
        }
    }

    /// Removes and returns the frames for the bus.
    pub fn take_frames(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.out)
    }
}

/// The identifier of a service frame.
fn service(source: NodeId, service_id: u8, request: bool, destination: NodeId) -> CanId {
    CanId::Service { priority: SERVICE_PRIORITY, service_id, request, destination, source }
}

/// Returns the best ID that no node has. `None` if all are in use.
fn free_id(used: &Heard) -> Option<NodeId> {
    let ids = IDS.into_iter().chain((1..IDS[0]).rev());
    ids.filter_map(NodeId::new).find(|id| !used.contains(*id))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::update::file::tests::id;

    #[test]
    fn an_id_that_another_node_has_is_not_taken() {
        let used = |ids: &[u8]| {
            let mut heard = Heard::default();
            for id in ids.iter().copied().filter_map(NodeId::new) {
                heard.note(id, Duration::ZERO);
            }
            heard
        };
        assert_eq!(free_id(&used(&[1, 125])).map(NodeId::get), Some(126));
        assert_eq!(free_id(&used(&[126])).map(NodeId::get), Some(127));
        assert_eq!(free_id(&used(&[125, 126, 127])).map(NodeId::get), Some(124));
        assert_eq!(free_id(&used(&(2..=127).collect::<Vec<_>>())).map(NodeId::get), Some(1));
        assert_eq!(free_id(&used(&(1..=127).collect::<Vec<_>>())), None);
    }

    #[test]
    fn a_tool_without_a_node_id_sends_nothing() {
        let mut tool = Tool::default();
        tool.poll(Duration::ZERO);
        assert_eq!(tool.request(&Message::NodeInfoRequest, id(42)), None);
        assert_eq!(tool.take_frames(), []);
        tool.take_id(None, None).unwrap();
        tool.poll(Duration::ZERO);
        assert!(tool.request(&Message::NodeInfoRequest, id(42)).is_some());
        assert_eq!(tool.take_frames().len(), 2);
        tool.leave();
        tool.poll(Duration::from_secs(2));
        assert_eq!(tool.take_frames(), []);
    }

    #[test]
    fn a_frame_with_the_tool_s_own_id_is_a_conflict() {
        let mut tool = Tool::default();
        let own = tool.take_id(None, None).unwrap();
        let status = types::NODE_STATUS.message_id(20, own).build();
        let frame = Frame::extended(status, &[0, 0, 0, 0, 0, 0, 0, 0xC0]);
        assert_eq!(tool.receive(&frame, Duration::ZERO), None);
        assert!(tool.has_conflict());
        tool.leave();
        assert_ne!(tool.take_id(None, None).unwrap(), own);
    }
}
