//! This program as a node on the bus.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Error, Result, ensure};
use can_link::Bus;
use dronecan_host::{
    Assembler, CanId, Id, Message, NodeId, NodeStatus, Outcome as Assembled, Transfer, TransferId,
    frames, types,
};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::args::Args;

/// Time in which a bus must answer after it was opened.
const OPENS_WITHIN: Duration = Duration::from_secs(3);
/// The longest wait for frames, so that a signal takes effect.
const TURN: Duration = Duration::from_millis(50);
/// The period of NodeStatus (protocol.NodeStatus).
const STATUS_PERIOD: Duration = Duration::from_secs(1);

/// Priorities of services and of NodeStatus, as in DroneCAN's own tools.
const SERVICE_PRIORITY: u8 = 16;
const STATUS_PRIORITY: u8 = 20;

/// The IDs that this program takes, best first. 126 and 127 are for tools, and an allocator gives
/// away the others from 125 down.
const IDS: [u8; 2] = [126, 127];

/// A node that sends requests, answers file.Read, and sends NodeStatus. It sends nothing before it
/// has a node ID.
pub struct Client {
    bus: Bus,
    id: Option<NodeId>,
    /// The other nodes that have sent a frame.
    heard: BTreeSet<NodeId>,
    start: Instant,
    interrupted: Arc<AtomicBool>,
    assembler: Assembler,
    /// Transfer IDs of requests, by service and destination.
    transfer_ids: HashMap<(u16, NodeId), TransferId>,
    status_transfer_id: TransferId,
    status_at: Duration,
}

impl Client {
    /// Opens the bus.
    ///
    /// # Errors
    /// If the bus cannot be opened; the message says what to do.
    pub fn open(args: &Args, interrupted: Arc<AtomicBool>) -> Result<Client> {
        let mut client = Client {
            bus: Bus::new(args.bus.clone(), args.bitrate, args.mcast_interface),
            id: None,
            heard: BTreeSet::new(),
            start: Instant::now(),
            interrupted,
            assembler: Assembler::new(),
            transfer_ids: HashMap::new(),
            status_transfer_id: TransferId::default(),
            status_at: Duration::ZERO,
        };
        client.bus.open(client.now())?;
        while !client.bus.is_up() {
            ensure!(client.now() < OPENS_WITHIN, "{} does not answer", args.bus);
            ensure!(!client.is_interrupted(), "ended by a signal");
            client.receive()?;
        }
        Ok(client)
    }

    /// Time since the start of the program.
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// True if a signal asked the program to end.
    pub fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    /// Takes a node ID that no node has that was heard, `wanted` or the best one. Call it after
    /// listening. Returns the ID.
    ///
    /// # Errors
    /// If another node has the ID, or there is none.
    pub fn take_id(&mut self, wanted: Option<NodeId>) -> Result<NodeId> {
        let id = match wanted {
            Some(id) => {
                ensure!(
                    !self.heard.contains(&id),
                    "another node has the ID {id}; without --own-id the program takes a free one"
                );
                id
            }
            None => free_id(&self.heard).context("all node IDs are in use")?,
        };
        self.id = Some(id);
        Ok(id)
    }

    /// Sends a request.
    pub fn request(&mut self, message: &Message, destination: NodeId) {
        let (Some(id), Some((data_type, payload))) = (self.id, message.encode()) else { return };
        let transfer_id =
            self.transfer_ids.entry((data_type.id, destination)).or_default().advance();
        let id = service(id, data_type.id as u8, true, destination);
        self.transmit(id, &payload, transfer_id);
    }

    /// Answers a request.
    pub fn answer(&mut self, request: &Transfer, payload: &[u8]) {
        if let (Some(id), CanId::Service { service_id, source, .. }) = (self.id, request.id) {
            let id = service(id, service_id, false, source);
            self.transmit(id, payload, request.transfer_id);
        }
    }

    fn transmit(&mut self, id: CanId, payload: &[u8], transfer_id: TransferId) {
        let now = self.now();
        for frame in frames(id, payload, transfer_id) {
            self.bus.send(now, frame);
        }
    }

    /// Waits for frames, at most [`TURN`]. Returns the completed transfers, without those for other
    /// nodes.
    ///
    /// # Errors
    /// If the bus was lost.
    pub fn receive(&mut self) -> Result<Vec<Transfer>> {
        let wait = Timespec { tv_sec: 0, tv_nsec: TURN.subsec_nanos().into() };
        if let Some((fd, wants_to_write)) = self.bus.poll_fd() {
            let flags = if wants_to_write { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
            // A signal causes an error here; the flag handles it.
            let _ = poll(&mut [PollFd::from_borrowed_fd(fd, flags)], Some(&wait));
        }
        let now = self.now();
        if let Some(id) = self.id
            && self.bus.is_up()
            && now >= self.status_at
        {
            self.status_at = now + STATUS_PERIOD;
            let status = NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() };
            let transfer_id = self.status_transfer_id.advance();
            self.transmit(
                types::NODE_STATUS.message_id(STATUS_PRIORITY, id),
                &status.encode(),
                transfer_id,
            );
        }
        let mut transfers = Vec::new();
        for frame in self.bus.serve(now) {
            let Id::Extended(id) = frame.id else { continue };
            self.heard.extend(CanId::parse(id).and_then(CanId::source));
            if let Assembled::Complete(transfer) = self.assembler.push(id, frame.data(), now) {
                match transfer.id {
                    CanId::Service { destination, .. } if Some(destination) != self.id => {}
                    _ => transfers.push(transfer),
                }
            }
        }
        match self.bus.trouble() {
            Some(trouble) => Err(Error::msg(format!("the bus is not available: {trouble}"))),
            None => Ok(transfers),
        }
    }

    /// Closes the bus.
    pub fn close(&mut self) {
        self.bus.close();
    }
}

/// The identifier of a service frame.
fn service(source: NodeId, service_id: u8, request: bool, destination: NodeId) -> CanId {
    CanId::Service { priority: SERVICE_PRIORITY, service_id, request, destination, source }
}

/// Returns the best ID that no node has. `None` if all are in use.
fn free_id(used: &BTreeSet<NodeId>) -> Option<NodeId> {
    let ids = IDS.into_iter().chain((1..IDS[0]).rev());
    ids.filter_map(NodeId::new).find(|id| !used.contains(id))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_that_another_node_has_is_not_taken() {
        let used = |ids: &[u8]| ids.iter().copied().filter_map(NodeId::new).collect();
        assert_eq!(free_id(&used(&[1, 125])).map(NodeId::get), Some(126));
        assert_eq!(free_id(&used(&[126])).map(NodeId::get), Some(127));
        assert_eq!(free_id(&used(&[125, 126, 127])).map(NodeId::get), Some(124));
        assert_eq!(free_id(&used(&(2..=127).collect::<Vec<_>>())).map(NodeId::get), Some(1));
        assert_eq!(free_id(&used(&(1..=127).collect::<Vec<_>>())), None);
    }
}
