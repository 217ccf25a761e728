//! Tests of channels on sockets of the loopback interface and on a pseudo-terminal.

use super::*;
use crate::message::{Content, Out};
use crate::queue::Class;
use crate::state::Settings;
use mavlink::dialects::common::{HEARTBEAT_DATA, MavMessage, RADIO_STATUS_DATA};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::os::fd::OwnedFd;

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
    Bridge::new(Settings::of_tests())
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

fn radio_status(free_percent: u8) -> Vec<u8> {
    let mut raw = MAVLinkV2MessageRaw::new();
    let data = RADIO_STATUS_DATA { txbuf: free_percent, ..RADIO_STATUS_DATA::default() };
    raw.serialize_message(header(), &MavMessage::RADIO_STATUS(data));
    raw.raw_bytes().to_vec()
}

#[test]
fn the_status_of_a_radio_needs_no_key_and_gives_no_rights() {
    let signing = Rc::new(RefCell::new(Signing::new(KEY)));
    let mut listeners = Listeners::new(1, Some(signing));
    let station = Signer::new(Rc::new(RefCell::new(Signing::new(KEY))), 3);
    listeners.send(0, &radio_status(40));
    assert!(listeners.channels[0].peers.is_empty());
    assert_eq!(listeners.send(0, &heartbeat(&station)), 1);
    assert_eq!(listeners.send(0, &radio_status(40)), 1);
    let peer = listeners.channels[0].peers.values().next().unwrap();
    assert!(peer.radio.is_some());
    assert!(
        listeners.channels[0].report()[1].contains("radio "),
        "{:?}",
        listeners.channels[0].report()
    );
}

/// A serial channel, and the other end of its line.
fn serial(options: Options) -> (Channel, OwnedFd) {
    let far = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    rustix::fs::fcntl_setfl(&far, rustix::fs::OFlags::NONBLOCK).unwrap();
    grantpt(&far).unwrap();
    unlockpt(&far).unwrap();
    let path = ptsname(&far, Vec::new()).unwrap().into_string().unwrap();
    let spec = format!("serial:{path}:57600").parse().unwrap();
    let mut ids = 0;
    (Channel::open(spec, 0, options, &mut ids, Duration::ZERO, false).unwrap(), far)
}

/// Bytes of a channel with very much to send in three seconds.
fn sent_in_3_seconds(channel: &mut Channel, far: &OwnedFd) -> usize {
    let content = Content::from(MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
    let out = Out { component: 42, content };
    let mut buffer = [0; 4096];
    let in_millisecond = |ms| {
        let post = Post::Message { to: To::All, class: Class::Answer, out: out.clone() };
        (0..10).for_each(|_| channel.post(Duration::from_millis(ms), &post));
        channel.flush(Duration::from_millis(ms));
        rustix::io::read(far, &mut buffer).unwrap_or(0)
    };
    (1..=3000).map(in_millisecond).sum()
}

#[test]
fn a_serial_port_begins_slowly_because_it_may_lead_to_a_radio() {
    let (mut channel, far) = serial(options());
    let (mut bridge, mut ids) = (bridge(), 1);
    let early = sent_in_3_seconds(&mut channel, &far);
    assert!((500..3300).contains(&early), "{early} bytes");
    // No radio has reported for five seconds.
    channel.serve(Duration::from_secs(6), &mut bridge, &mut ids);
    let peer = channel.peers.values_mut().next().unwrap();
    assert!(peer.radio.is_none());
}

#[test]
fn a_port_in_use_is_answered_with_the_channel_that_reaches_its_owner() {
    let open = |spec: String| {
        let spec = spec.parse().unwrap();
        let error = Channel::open(spec, 0, options(), &mut 0, Duration::ZERO, false).err();
        error.expect("the port is in use").to_string()
    };
    let (tcp, udp) = (TcpListener::bind("127.0.0.1:0"), UdpSocket::bind("127.0.0.1:0"));
    let (tcp, udp) = (tcp.unwrap(), udp.unwrap());
    let (at_tcp, at_udp) = (tcp.local_addr().unwrap(), udp.local_addr().unwrap());
    let error = open(format!("tcpin:{at_tcp}"));
    assert!(error.ends_with(&format!("Then use tcp:{at_tcp}")), "{error}");
    let error = open(format!("udpin:{at_udp}"));
    assert!(error.ends_with(&format!("Then use udpout:{at_udp}")), "{error}");
}
