//! The client that keeps the node busy.

use bench::Cycles;
use bench::dronecan::{Message, Opcode, ParameterRequest, Value};

use super::super::{MS, Rig};
use super::SENDER;

/// LightsCommand.
const LIGHTS_COMMAND: u32 = 0x1804_3900;
/// Time after which a client gives up an answer.
const CLIENT_TIMEOUT_MS: u64 = 300;

/// Other work of the node during a load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Client {
    /// Nothing.
    None,
    /// A client reads the parameters, lights change, and a user types `?` on the serial monitor.
    Walking,
    /// Like `Walking`; the client also changes and saves parameters.
    Saving,
}

/// A [`Client`] at work. It sends through the rig's peer.
pub struct BusyClient {
    client: Client,
    ms: u64,
    asked_at: Cycles,
    asked: u16,
    /// Number of answers that it received.
    pub answers: u64,
}

impl BusyClient {
    /// A client that begins now.
    pub fn new(client: Client, now: Cycles) -> BusyClient {
        BusyClient { client, ms: 0, asked_at: now, asked: 0, answers: 0 }
    }

    /// What it does.
    pub fn client(&self) -> Client {
        self.client
    }

    /// Ends its work.
    pub fn stop(&mut self) {
        self.client = Client::None;
    }

    /// Does the work of the next millisecond.
    pub fn millisecond(&mut self, rig: &mut Rig) {
        self.ms += 1;
        if self.client == Client::None {
            return;
        }
        self.ask(rig);
        if self.ms % 50 == 25 {
            let tail = 0xC0 | (self.ms / 50 % 32) as u8;
            rig.send(LIGHTS_COMMAND | SENDER, &[0, 0xFF, self.ms as u8, tail]);
        }
        if self.ms % 500 == 250 {
            rig.board().avr_mut().serial_send(b"?");
        }
        if self.ms % 1000 == 500 {
            rig.send_status_from(1);
        }
    }

    /// Sends the next request after the whole answer, or the timeout.
    fn ask(&mut self, rig: &mut Rig) {
        let answered = !rig.answers().is_empty();
        if !answered && rig.now() - self.asked_at <= CLIENT_TIMEOUT_MS * MS {
            return;
        }
        self.answers += u64::from(answered);
        self.asked = self.asked.wrapping_add(1);
        self.asked_at = rig.now();
        rig.transfers.clear();
        let saving = self.client == Client::Saving;
        let request = match self.asked % 32 {
            31 => Message::NodeInfoRequest,
            30 if saving => Message::ExecuteOpcode(Opcode::SAVE),
            29 if saving => Message::ParameterRequest(ParameterRequest {
                index: 0,
                value: Value::Integer(i64::from(self.asked)),
                name: "TEMP_ID".into(),
            }),
            // The node answers requests beyond the last parameter, too.
            index => {
                Message::ParameterRequest(ParameterRequest { index, ..ParameterRequest::default() })
            }
        };
        rig.request(&request);
    }
}
