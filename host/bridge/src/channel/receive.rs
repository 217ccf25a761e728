//! What a channel receives, and the end of its peers.

use super::radio::Radio;
use super::{Channel, Integers, MAVPROXY, PEERS_MAX, Peer, READS_AT_ONCE, RETRY, Transport};
use crate::core::Bridge;
use crate::message::{In, Received, Refused, Request};
use crate::number::IntegerEncoding;
use crate::post::{Asker, PeerId};
use std::io::{self, ErrorKind, Read as _};
use std::time::Duration;

impl Channel {
    pub(super) fn receive_streams(&mut self, now: Duration, bridge: &mut Bridge) {
        let ids: Vec<PeerId> = self.peers.keys().copied().collect();
        let mut buffer = [0; 2048];
        for id in ids {
            for _ in 0..READS_AT_ONCE {
                let read = match (
                    &self.transport,
                    self.peers.get_mut(&id).and_then(|peer| peer.stream.as_mut()),
                ) {
                    (Transport::Serial(port), _) => {
                        rustix::io::read(port, &mut buffer).map_err(io::Error::from)
                    }
                    (_, Some(stream)) => stream.read(&mut buffer),
                    _ => break,
                };
                match read {
                    Ok(0) => {
                        self.lose(now, bridge, id, "closed");
                        break;
                    }
                    Ok(length) => self.take(now, bridge, id, &buffer[..length]),
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => {
                        self.lose(now, bridge, id, &error.to_string());
                        break;
                    }
                }
            }
        }
    }

    /// Handles the end of a stream.
    pub(super) fn lose(&mut self, now: Duration, bridge: &mut Bridge, id: PeerId, why: &str) {
        self.remove(bridge, id, why);
        if matches!(self.transport, Transport::Stream | Transport::Serial(_)) {
            self.is_loss_logged = true;
            self.transport = Transport::Away(now + RETRY);
        }
    }

    pub(super) fn remove(&mut self, bridge: &mut Bridge, id: PeerId, why: &str) {
        if let Some(peer) = self.peers.remove(&id) {
            self.dropped += peer.queue.dropped().values().sum::<u64>();
            self.log.push(format!("{}: {} has left: {why}", self.spec, peer.name));
            bridge.left(id);
        }
    }

    pub(super) fn remove_those(
        &mut self,
        bridge: &mut Bridge,
        which: impl Fn(&Peer) -> bool,
        why: &str,
    ) {
        let those = self.peers.iter().filter(|(_, peer)| which(peer));
        for id in those.map(|(id, _)| *id).collect::<Vec<_>>() {
            self.remove(bridge, id, why);
        }
    }

    pub(super) fn take(&mut self, now: Duration, bridge: &mut Bridge, id: PeerId, bytes: &[u8]) {
        let Some(peer) = self.peers.get_mut(&id) else { return };
        peer.parser.feed(bytes);
        let messages: Vec<_> = std::iter::from_fn(|| peer.parser.message()).collect();
        self.take_messages(now, bridge, id, messages);
    }

    pub(super) fn take_messages(
        &mut self,
        now: Duration,
        bridge: &mut Bridge,
        id: PeerId,
        messages: Vec<Received>,
    ) {
        let stations = self.peers.values().filter(|peer| peer.is_trusted).count();
        let Some(peer) = self.peers.get_mut(&id) else { return };
        let mut rejected = Vec::new();
        for message in messages {
            match message {
                // Shows neither that the station is there nor which version it speaks.
                Ok((_, In { request: Request::Radio { free_percent }, .. })) => {
                    peer.radio.get_or_insert_with(|| Radio::presumed(now)).report(now, free_percent)
                }
                Ok(_) if !peer.is_trusted && stations >= PEERS_MAX => {
                    self.refused += 1;
                    return self.lose(now, bridge, id, "no place for another station");
                }
                Ok((version, message)) => {
                    if !std::mem::replace(&mut peer.is_trusted, true) {
                        bridge.joined(now, id);
                    }
                    peer.heard = Some(version);
                    peer.heard_at = now;
                    peer.received += 1;
                    let of_parameters = matches!(
                        message.request,
                        Request::ParameterList
                            | Request::ParameterRead { .. }
                            | Request::ParameterSet { .. }
                    );
                    if self.options.integers == Integers::Auto && of_parameters {
                        peer.encoding = if message.from.1 == MAVPROXY {
                            IntegerEncoding::Cast
                        } else {
                            IntegerEncoding::Bytewise
                        };
                    }
                    bridge.message(
                        now,
                        Asker { peer: id, from: message.from, encoding: peer.encoding },
                        message,
                    );
                }
                Err(Refused::Malformed) => self.malformed += 1,
                Err(Refused::Signature(why)) => rejected.push(why),
            }
        }
        if !rejected.is_empty()
            && let Some(mut peer) = self.peers.remove(&id)
        {
            for why in rejected {
                self.reject(now, bridge, &mut peer, why);
            }
            self.peers.insert(id, peer);
        }
    }
}
