//! This program as a node on the bus.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Error, Result, ensure};
use can_link::Bus;
use dronecan_host::{
    Assembler, CanId, Id, Message, NodeId, NodeStatus, Outcome as Assembled, Transfer, TransferId,
    frames, types,
};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::args::Args;
use crate::session::{Action, Outcome, Session};

/// Time in which a bus must answer after it was opened.
const OPENS_WITHIN: Duration = Duration::from_secs(3);
/// The longest wait for frames, so that a signal takes effect.
const TURN: Duration = Duration::from_millis(50);
/// The period of NodeStatus (protocol.NodeStatus).
const STATUS_PERIOD: Duration = Duration::from_secs(1);

/// Priorities of services and of NodeStatus, as in DroneCAN's own tools.
const SERVICE_PRIORITY: u8 = 16;
const STATUS_PRIORITY: u8 = 20;

/// A node that sends requests, answers file.Read, and sends NodeStatus.
pub struct Client {
    bus: Bus,
    pub id: NodeId,
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
            id: args.own_id,
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

    /// Sends a request.
    pub fn request(&mut self, message: &Message, destination: NodeId) {
        if let Some((data_type, payload)) = message.encode() {
            let transfer_id =
                self.transfer_ids.entry((data_type.id, destination)).or_default().advance();
            self.transmit(
                self.service(data_type.id as u8, true, destination),
                &payload,
                transfer_id,
            );
        }
    }

    /// Answers a request.
    fn answer(&mut self, request: &Transfer, payload: &[u8]) {
        if let CanId::Service { service_id, source, .. } = request.id {
            self.transmit(self.service(service_id, false, source), payload, request.transfer_id);
        }
    }

    fn service(&self, service_id: u8, request: bool, destination: NodeId) -> CanId {
        CanId::Service {
            priority: SERVICE_PRIORITY,
            service_id,
            request,
            destination,
            source: self.id,
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
        if self.bus.is_up() && now >= self.status_at {
            self.status_at = now + STATUS_PERIOD;
            let status = NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() };
            let transfer_id = self.status_transfer_id.advance();
            self.transmit(
                types::NODE_STATUS.message_id(STATUS_PRIORITY, self.id),
                &status.encode(),
                transfer_id,
            );
        }
        let mut transfers = Vec::new();
        for frame in self.bus.serve(now) {
            let Id::Extended(id) = frame.id else { continue };
            if let Assembled::Complete(transfer) = self.assembler.push(id, frame.data(), now) {
                match transfer.id {
                    CanId::Service { destination, .. } if destination != self.id => {}
                    _ => transfers.push(transfer),
                }
            }
        }
        match self.bus.trouble() {
            Some(trouble) => Err(Error::msg(format!("the bus is not available: {trouble}"))),
            None => Ok(transfers),
        }
    }

    /// Runs an update until it ends. Returns `None` if a signal ended it.
    ///
    /// # Errors
    /// If the bus was lost.
    pub fn run(
        &mut self,
        session: &mut Session,
        mut show: impl FnMut(&Session),
    ) -> Result<Option<Outcome>> {
        while !self.is_interrupted() {
            for transfer in self.receive()? {
                if let Some(answer) = session.take(&transfer, self.now()) {
                    self.answer(&transfer, &answer);
                }
            }
            match session.poll(self.now()) {
                Some(Action::Request(message)) => self.request(&message, session.node),
                Some(Action::End(outcome)) => return Ok(Some(outcome)),
                None => {}
            }
            show(session);
        }
        Ok(None)
    }

    /// Closes the bus.
    pub fn close(&mut self) {
        self.bus.close();
    }
}
