//! What the bridge says if it rejects a signature: to the station, once, and to the user.
//!
//! These are the only messages to a station that has not signed. A STATUSTEXT says what to do; it
//! has no signature, so that a station without a key, or with another one, can show it. A station
//! whose key is right, but whose time is late, gets a signed heartbeat: from it the station takes
//! the time, as MAVLink demands (<https://mavlink.io/en/guide/message_signing.html>, "Timestamp
//! Handling"). Without it a bridge that had once been started with its clock in the future would
//! never hear again a station to which it does not send.

use super::peer::{Peer, write};
use super::{Channel, Transport};
use crate::core::Bridge;
use crate::message::{Out, Writer};
use crate::signing::Rejection;
use std::collections::BTreeSet;
use std::time::Duration;

/// Stations that are remembered. What comes from others is only counted.
const REMEMBERED: usize = 64;
/// Time between two heartbeats to stations whose time is late.
const HEARTBEAT_AFTER: Duration = Duration::from_secs(1);

/// The rejected messages of a channel.
#[derive(Default)]
pub struct Rejected {
    /// Messages without a signature, and with one of another key.
    pub unsigned: u64,
    pub other_key: u64,
    /// Messages that came again, or whose time is late or far ahead.
    pub old: u64,
    /// The stations that were told.
    stations: Told,
    /// The addresses of which the user was told.
    hosts: Told,
    heartbeat_at: Option<Duration>,
}

/// Who was told, and why.
#[derive(Default)]
struct Told(BTreeSet<(String, Rejection)>);

impl Told {
    /// True once for a name and a reason, if there is room.
    fn is_new(&mut self, name: &str, why: Rejection) -> bool {
        self.0.len() < REMEMBERED && self.0.insert((name.to_owned(), why))
    }
}

/// The words for the station (a STATUSTEXT has 50 characters), and those for the user.
fn advice(why: Rejection) -> (&'static str, &'static str) {
    match why {
        Rejection::Unsigned => (
            "Not signed: sign with the bridge's --signing-key",
            "does not sign: set the key of --signing-key there (MAVProxy: signing key PASSPHRASE)",
        ),
        Rejection::OtherKey => (
            "Wrong key: sign with the bridge's --signing-key",
            "signs with another key: set that of --signing-key there (MAVProxy: signing key \
             PASSPHRASE)",
        ),
        Rejection::Future => (
            "Signed in the future: set your clock",
            "signs with a time that is more than a day ahead of this computer's clock: set the \
             clock that is wrong",
        ),
        Rejection::Old => (
            "",
            "signs with a time that is over, or repeats a message: the bridge sends it a \
             heartbeat, from which it takes the time. Are the clocks right?",
        ),
    }
}

impl Channel {
    /// Counts a message whose signature is rejected, and says so to its sender and to the user.
    pub(super) fn reject(
        &mut self,
        now: Duration,
        bridge: &Bridge,
        peer: &mut Peer,
        why: Rejection,
    ) {
        let rejected = &mut self.rejected;
        match why {
            Rejection::Unsigned => rejected.unsigned += 1,
            Rejection::OtherKey => rejected.other_key += 1,
            Rejection::Old | Rejection::Future => rejected.old += 1,
        }
        let (to_station, to_user) = advice(why);
        // The port of a station may be another one each time that it connects.
        let host = peer.name.rsplit_once(':').map_or(&*peer.name, |(host, _)| host);
        if rejected.hosts.is_new(host, why) {
            self.log.push(format!("{}: {} {to_user}", self.spec, peer.name));
        }
        let out = match why {
            Rejection::Unsigned | Rejection::OtherKey | Rejection::Future => {
                if !rejected.stations.is_new(&peer.name, why) {
                    return;
                }
                bridge.warning(to_station)
            }
            Rejection::Old => {
                if rejected.heartbeat_at.is_some_and(|at| now < at + HEARTBEAT_AFTER) {
                    return;
                }
                rejected.heartbeat_at = Some(now);
                bridge.heartbeat()
            }
        };
        let signed = why == Rejection::Old;
        let signer = if signed { self.signer.clone() } else { None };
        let writer = Writer::new(self.options.system, self.options.versions, signer);
        send_at_once(&self.transport, peer, writer, &out);
    }
}

/// Sends a message outside of the peer's queue, unless the rest of another one waits.
fn send_at_once(transport: &Transport, peer: &mut Peer, mut writer: Writer, out: &Out) {
    if !peer.unsent.is_empty() {
        return;
    }
    if let Some(bytes) = writer.bytes(out, None, peer.encoding) {
        peer.unsent = bytes;
        write(transport, peer);
    }
}
