//! Tests of channels on sockets of the loopback interface.

use super::*;
use crate::state::{Rights, Settings};
use dronecan_host::NodeId;
use mavlink::dialects::common::{HEARTBEAT_DATA, MavMessage};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

const KEY: [u8; 32] = [7; 32];

fn options() -> Options {
    Options {
        system: 1,
        versions: Versions::Two,
        integers: Integers::Auto,
        status_interval: Duration::ZERO,
        byte_rate: None,
        signing: None,
        allowed: Vec::new(),
    }
}

fn bridge() -> Bridge {
    Bridge::new(Settings {
        system: 1,
        component: 126,
        node: NodeId::new(126).unwrap(),
        unique_id: [1; 16],
        info_interval: Duration::from_secs(60),
        autosave: None,
        rights: Rights { change: true, can: false },
        tunnels: Vec::new(),
        hidden: Default::default(),
        epoch_us: 0,
    })
}

/// Channels that listen on UDP, and a station that sends to them.
struct Listeners {
    bridge: Bridge,
    channels: Vec<Channel>,
    ids: PeerId,
    station: UdpSocket,
}

impl Listeners {
    fn new(count: usize, signing: Option<Rc<RefCell<Signing>>>) -> Listeners {
        let (bridge, mut ids) = (bridge(), 0);
        let options = Options { signing, ..options() };
        let open = |number| {
            let spec = "udpin:0".parse().unwrap();
            Channel::open(spec, number, options.clone(), &mut ids, Duration::ZERO, false).unwrap()
        };
        let channels = (0..count).map(open).collect();
        let station = UdpSocket::bind("127.0.0.1:0").unwrap();
        Listeners { bridge, channels, ids, station }
    }

    /// Sends `bytes` to a channel. Returns the number of messages that its stations have sent.
    fn send(&mut self, to: usize, bytes: &[u8]) -> u64 {
        let channel = &mut self.channels[to];
        let Spec::UdpIn(address) = channel.spec else { panic!("{}", channel.spec) };
        self.station.send_to(bytes, address).unwrap();
        channel.serve(Duration::from_secs(1), &mut self.bridge, &mut self.ids);
        channel.peers.values().map(|peer| peer.received).sum()
    }
}

fn header() -> MavHeader {
    MavHeader { system_id: 255, component_id: 190, sequence: 0 }
}

fn heartbeat(signer: &Signer) -> Vec<u8> {
    let mut raw = MAVLinkV2MessageRaw::new();
    let message = MavMessage::HEARTBEAT(HEARTBEAT_DATA::default());
    raw.serialize_message_for_signing(header(), &message);
    signer.sign(&mut raw);
    raw.raw_bytes().to_vec()
}

#[test]
fn a_signed_message_is_executed_on_one_of_all_channels() {
    let signing = Rc::new(RefCell::new(Signing::new(KEY)));
    let mut listeners = Listeners::new(2, Some(signing));
    let station = Signer::new(Rc::new(RefCell::new(Signing::new(KEY))), 3);
    let captured = heartbeat(&station);
    assert_eq!(listeners.send(0, &captured), 1);
    assert_eq!(listeners.send(0, &captured), 1, "again on the same channel");
    assert_eq!(listeners.send(1, &captured), 0, "on another channel");
    assert!(listeners.channels[1].peers.is_empty(), "it gets no place there");
    assert_eq!(listeners.send(1, &heartbeat(&station)), 1, "the next one");
}
