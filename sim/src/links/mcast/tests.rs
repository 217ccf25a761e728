//! Tests of the link with a plain UDP peer, in a network namespace that has only loopback.
//!
//! The first test starts this program again in the namespace, where it runs the ignored tests
//! below: as root, as the root of a user namespace, or by sudo.

use super::*;
use bench::dronecan::mcast::datagram::encode;
use socket2::{Domain, Socket, Type};
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::process::Command;
use std::time::{Duration, Instant};

/// Environment variable that is set in the namespace.
const INSIDE: &str = "SIM_MCAST_NAMESPACE";
const WAIT: Duration = Duration::from_secs(30);

#[test]
fn the_tests_below_pass_in_a_namespace_with_only_loopback() {
    let ways =
        ["unshare --net", "unshare --map-root-user --net", "sudo -n --preserve-env unshare --net"];
    let command = |way: &str| {
        let (program, options) = way.split_once(' ').unwrap();
        let mut command = Command::new(program);
        command.args(options.split(' '));
        command
    };
    let works = |way: &&str| {
        command(way)
            .args(["ip", "link", "set", "lo", "up"])
            .output()
            .is_ok_and(|out| out.status.success())
    };
    let way = ways
        .into_iter()
        .find(works)
        .expect("a network namespace: be root, or let sudo work without a password");
    let script = "\"$0\" links::mcast::tests::inside_without_loopback --ignored --nocapture && ip \
                  link set lo up && exec \"$0\" links::mcast::tests::inside_with_loopback \
                  --ignored --nocapture";
    let this = std::env::current_exe().unwrap();
    let output =
        command(way).args(["sh", "-c", script]).arg(this).env(INSIDE, "1").output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
    assert_eq!(text.matches("1 passed").count(), 2, "{text}");
}

/// Panics outside of the namespace, so that no test uses the network of the computer.
fn assert_inside() {
    assert!(
        std::env::var_os(INSIDE).is_some(),
        "only the test that creates the namespace may run this test"
    );
}

/// Runs while loopback is down.
#[test]
#[ignore = "run in a namespace by another test"]
fn inside_without_loopback_the_error_says_what_to_do() {
    assert_inside();
    let error =
        Mcast::open(0, None, &mut Bench::new(1_000_000)).err().expect("there is no loopback");
    assert!(format!("{error:#}").contains("ip link set lo up"), "{error:#}");
}

/// Runs while loopback is up.
#[test]
#[ignore = "run in a namespace by another test"]
fn inside_with_loopback() {
    assert_inside();
    frames_of_the_peer_reach_the_nodes_in_their_order();
    frames_of_the_nodes_reach_the_peer_and_do_not_come_back();
    invalid_datagrams_are_dropped_and_counted();
    the_queue_is_bounded_and_dropped_frames_are_counted();
    the_status_says_how_to_add_a_route_for_other_programs();
    the_error_for_an_address_in_use_or_of_another_computer_says_what_to_do();
}

/// A bench with the link and one more node, and a UDP peer that uses no code of the simulator.
struct Stand {
    bench: Bench,
    link: Mcast,
    node: Rc<RefCell<SoftNode>>,
    peer: UdpSocket,
    group: SocketAddrV4,
}

impl Stand {
    /// Each test must use another `bus`.
    fn new(bus: u8) -> Stand {
        let mut bench = Bench::new(1_000_000);
        let link = Mcast::open(bus, None, &mut bench).unwrap();
        let node = Rc::new(RefCell::new(SoftNode::new(1_000_000)));
        bench.attach("node", node.clone());
        bench.run_for_ms(1);
        let group = SocketAddrV4::new(Ipv4Addr::new(239, 65, 82, bus), 57732);
        let peer = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
        peer.set_reuse_address(true).unwrap();
        peer.bind(&SocketAddr::from(group).into()).unwrap();
        peer.join_multicast_v4(group.ip(), &Ipv4Addr::LOCALHOST).unwrap();
        peer.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).unwrap();
        peer.set_read_timeout(Some(WAIT)).unwrap();
        Stand { bench, link, node, peer: peer.into(), group }
    }

    fn send(&self, datagram: &[u8]) {
        self.peer.send_to(datagram, self.group).unwrap();
    }

    /// Serves the link each simulated millisecond until `done`.
    #[track_caller]
    fn serve_until(&mut self, done: impl Fn(&Counters) -> bool) {
        let end = Instant::now() + WAIT;
        while !done(&self.link.counters) {
            assert!(Instant::now() < end, "{}", self.link.status());
            self.link.serve(&mut self.bench).unwrap();
            self.bench.run_for_ms(1);
        }
    }

    fn received_by_node(&mut self) -> Vec<Frame> {
        self.node.borrow_mut().take_received().into_iter().map(|(_, frame)| frame).collect()
    }
}

fn frames_of_the_peer_reach_the_nodes_in_their_order() {
    let mut stand = Stand::new(1);
    let frames: Vec<Frame> =
        (0..50).map(|n| Frame::extended(0x1000_0000 - n, &[n as u8])).collect();
    frames.iter().for_each(|frame| stand.send(&encode(frame).unwrap()));
    stand.serve_until(|counters| counters.received == 50);
    stand.bench.run_for_ms(10);
    assert_eq!(stand.received_by_node(), frames);
    // The link's own frames must not come back as datagrams.
    stand.link.serve(&mut stand.bench).unwrap();
    assert_eq!((stand.link.counters.sent, stand.link.counters.malformed), (0, 0));
}

fn frames_of_the_nodes_reach_the_peer_and_do_not_come_back() {
    let mut stand = Stand::new(2);
    let frame = Frame::extended(0x1404_562A, &[0x01, 0x00, 0xA9, 0x5C, 0x00, 0xC0]);
    stand.node.borrow_mut().send(frame);
    stand.node.borrow_mut().send(Frame::remote(frame.id, 0));
    stand.serve_until(|counters| counters.sent == 1 && counters.unsent == 1);
    let mut buffer = [0xA5; 100];
    let (length, from) = stand.peer.recv_from(&mut buffer).unwrap();
    let golden = [
        0x34, 0x29, 0xF1, 0x83, 0x00, 0x00, 0x2A, 0x56, 0x04, 0x94, 0x01, 0x00, 0xA9, 0x5C, 0x00,
        0xC0,
    ];
    assert_eq!(buffer[..length], golden);
    assert_eq!(from.ip(), Ipv4Addr::LOCALHOST);
    stand.link.serve(&mut stand.bench).unwrap();
    assert_eq!(stand.link.counters.received, 0);
    assert_eq!(stand.bench.bus().stats().frames, 2);
}

fn invalid_datagrams_are_dropped_and_counted() {
    let mut stand = Stand::new(3);
    let good = encode(&Frame::extended(1, &[1])).unwrap();
    let mut fd = vec![0x34, 0x29, 0, 0, 1, 0, 1, 0, 0, 0x80, 1];
    let crc = bench::dronecan::crc::feed(0xFFFF, &fd[4..]);
    fd[2..4].copy_from_slice(&crc.to_le_bytes());
    stand.send(&[]);
    stand.send(&good[..9]);
    stand.send(&[0xA5; 1400]);
    stand.send(&fd);
    stand.send(&good);
    stand.serve_until(|counters| counters.received == 1);
    assert_eq!((stand.link.counters.malformed, stand.link.counters.fd), (3, 1));
    assert!(stand.link.status().contains("1 CAN FD rejected"), "{}", stand.link.status());
}

/// The bus is blocked, so that no frame can leave the queue.
fn the_queue_is_bounded_and_dropped_frames_are_counted() {
    let mut stand = Stand::new(4);
    stand.bench.bus().inject(bench::can::Fault::StuckDominant(true));
    let datagram = encode(&Frame::extended(1, &[1])).unwrap();
    let end = Instant::now() + WAIT;
    while stand.link.counters.queue_full == 0 {
        assert!(Instant::now() < end, "{}", stand.link.status());
        (0..100).for_each(|_| stand.send(&datagram));
        stand.link.serve(&mut stand.bench).unwrap();
    }
    assert_eq!(stand.link.station.borrow().queued(), QUEUE_LIMIT);
}

/// The namespace has no route until this test adds one.
fn the_status_says_how_to_add_a_route_for_other_programs() {
    let stand = Stand::new(5);
    assert!(
        stand.link.status().contains("ip route add 239.65.82.0/24 dev lo src 127.0.0.1"),
        "{}",
        stand.link.status()
    );
    let added = Command::new("ip")
        .args(["route", "add", "239.65.82.0/24", "dev", "lo", "src", "127.0.0.1"])
        .status()
        .unwrap();
    assert!(added.success());
    assert!(stand.link.status().ends_with("0 in, 0 out"), "{}", stand.link.status());
}

fn the_error_for_an_address_in_use_or_of_another_computer_says_what_to_do() {
    let mut bench = Bench::new(1_000_000);
    let foreign = Some(Ipv4Addr::new(192, 0, 2, 1));
    let error =
        Mcast::open(6, foreign, &mut bench).err().expect("the address is of another computer");
    assert!(format!("{error:#}").contains("ip -4 address"), "{error:#}");
    let _other = UdpSocket::bind((Ipv4Addr::new(239, 65, 82, 7), 57732)).unwrap();
    let error = Mcast::open(7, None, &mut bench).err().expect("the port is in use");
    assert!(format!("{error:#}").contains("ss -ulpn"), "{error:#}");
}
