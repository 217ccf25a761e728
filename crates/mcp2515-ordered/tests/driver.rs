//! Tests the driver with the simulator's model of the chip, on a simulated bus.

use std::cell::{RefCell, RefMut};
use std::rc::Rc;

use crate::wire::{CRYSTAL_HZ, MS, World};
use can_model::{Fault, Frame, Id, RecordKind, SoftNode};
use embedded_hal::digital::OutputPin;
use embedded_hal::spi::SpiBus;
use mcp2515_ordered::Counter::{
    BusOffs, RxOverflow, RxReceived, TxRequests, TxSuccess, TxTimedOut,
};
use mcp2515_ordered::Frame as DriverFrame;
use mcp2515_ordered::{
    Acceptance, Attempts, BitTiming, Configuration, Counter, ErrorFlags, Event, Mcp2515, Notice,
    Pattern,
};

/// Register addresses and instructions (DS20001801J tables 11-1 and 12-1).
const CANCTRL: u8 = 0x0F;
const CNF1: u8 = 0x2A;
const CNF2: u8 = 0x29;
const CNF3: u8 = 0x28;
const CANINTE: u8 = 0x2B;
const EFLG: u8 = 0x2D;
const REC: u8 = 0x1D;
const TXB2CTRL: u8 = 0x50;
const RXB0CTRL: u8 = 0x60;
const READ: u8 = 0x03;
const WRITE: u8 = 0x02;

const OSM: u8 = 0x08;
const MLOA: u8 = 0x20;

/// Accepts, in buffer 0, all extended frames that agree with `id` in the bits of `mask`.
#[derive(Clone, Copy)]
struct Accept {
    id: u32,
    mask: u32,
}

const EVERYTHING: Accept = Accept { id: 0, mask: 0 };

impl Acceptance for Accept {
    fn register(&self, n: u8) -> u8 {
        let pattern = match n / 4 {
            0 | 1 => Pattern::filter(self.id.to_be_bytes()),
            6 => Pattern::mask(self.mask.to_be_bytes()),
            7 => Pattern::mask([0x1F, 0xFF, 0xFF, 0xFF]),
            // No test sends this identifier.
            _ => Pattern::filter([0x1F, 0xFF, 0xFF, 0xFF]),
        };
        pattern.registers()[usize::from(n % 4)]
    }
}

type Wire = crate::wire::Wire<World>;

struct Rig {
    wire: Wire,
    driver: Mcp2515<Wire, Wire, Wire, Accept>,
    peer: Rc<RefCell<SoftNode>>,
    notices: Vec<Notice>,
    received: Vec<DriverFrame>,
}

impl Rig {
    fn at_rate(rate: u8, acceptance: Accept, attempts: Attempts) -> Rig {
        let bit_rate = u32::from(rate) * 125_000;
        let wire = World::new(bit_rate);
        let peer = wire.0.borrow().peer.clone();
        let configuration =
            Configuration { timing: BitTiming::new(CRYSTAL_HZ, bit_rate), acceptance, attempts };
        let driver = Mcp2515::new(wire.clone(), wire.clone(), wire.clone(), configuration);
        Rig { wire, driver, peer, notices: vec![], received: vec![] }
    }

    /// A rig whose chip is on the bus, and has received a frame.
    fn running(acceptance: Accept, attempts: Attempts) -> Rig {
        let mut rig = Rig::at_rate(8, acceptance, attempts);
        rig.run_ms(20);
        assert_eq!(rig.take_events(), [Event::Running]);
        rig.peer_sends(Frame::extended(acceptance.id, &[]));
        rig.run_ms(20);
        assert_eq!((rig.world().take_traffic().1, rig.received.len()), (0, 1));
        rig.received.clear();
        rig
    }

    fn world(&self) -> RefMut<'_, World> {
        self.wire.0.borrow_mut()
    }

    fn now_ms(&self) -> u16 {
        (self.world().now / MS) as u16
    }

    /// Runs the bus without calls of the driver.
    fn idle_us(&mut self, us: u64) {
        self.world().run(us * MS / 1000);
    }

    fn idle_ms(&mut self, ms: u64) {
        self.idle_us(1000 * ms);
    }

    /// Returns the next frame that the driver reads from the chip.
    fn receive(&mut self) -> Option<DriverFrame> {
        let mut frame = DriverFrame::EMPTY;
        self.driver.receive(&mut frame).then_some(frame)
    }

    /// Passes the frame to the chip. Returns true if there was room.
    fn transmit(&mut self, frame: &DriverFrame) -> bool {
        self.driver.find_room();
        let now_ms = self.now_ms();
        let has_room = self.driver.state(now_ms).has_room;
        if has_room {
            self.driver.transmit(frame);
            assert!(!self.driver.state(now_ms).has_room, "to be found anew for each frame");
        }
        has_room
    }

    /// Does a turn of a main loop: receives all frames, then polls if that is due.
    fn turn(&mut self) {
        // A chip that does not answer seems to have frames for ever.
        for _ in 0..16 {
            if !self.driver.has_frame() {
                break;
            }
            let Some(frame) = self.receive() else { break };
            self.received.push(frame);
        }
        if self.driver.state(self.now_ms()).is_due {
            self.notices.extend(self.driver.poll(self.now_ms()));
        }
    }

    fn run_ms(&mut self, ms: u64) {
        let end = self.world().now + ms * MS;
        while self.world().now < end {
            self.turn();
            self.idle_us(50);
        }
    }

    fn peer_sends(&mut self, frame: Frame) {
        self.peer.borrow_mut().send(frame);
    }

    /// Passes a frame to the chip, which loses against the second one of the peer: both begin after
    /// the first one.
    fn lose_arbitration(&mut self, frame: &DriverFrame) {
        for n in 0..2 {
            self.peer_sends(Frame::extended(1, &[n; 8]));
        }
        self.idle_us(50);
        assert!(self.transmit(frame));
    }

    fn take_events(&mut self) -> Vec<Event> {
        self.notices.drain(..).map(|notice| notice.event).collect()
    }

    fn counter(&self, counter: Counter) -> u32 {
        self.driver.counters().get(counter)
    }

    /// Asserts these counts. Without the feature `counters` all are zero.
    #[track_caller]
    fn assert_counts(&self, expected: &[(Counter, u32)]) {
        for &(counter, count) in expected {
            let count = if cfg!(feature = "counters") { count } else { 0 };
            assert_eq!(self.counter(counter), count, "{counter:?}");
        }
    }

    /// Asserts the counts of frames requested, successful and given up.
    #[track_caller]
    fn assert_sent(&self, requests: u32, success: u32, timed_out: u32) {
        self.assert_counts(&[
            (TxRequests, requests),
            (TxSuccess, success),
            (TxTimedOut, timed_out),
        ]);
    }

    fn register(&self, address: u8) -> u8 {
        self.world().chip.borrow().register(address)
    }

    /// Does one SPI instruction without the driver.
    fn direct_spi(&mut self, bytes: &[u8]) -> u8 {
        let mut bytes = bytes.to_vec();
        _ = self.wire.set_low();
        _ = self.wire.transfer_in_place(&mut bytes);
        _ = self.wire.set_high();
        *bytes.last().unwrap()
    }
}

fn frame(id: u32, data: &[u8]) -> DriverFrame {
    let mut padded = [0xA5; 8];
    padded[..data.len()].copy_from_slice(data);
    DriverFrame { id: id.to_be_bytes(), len: data.len() as u8, data: padded }
}

/// On the bus, the chip receives a frame every 130 us, and has room for two.
#[test]
fn frames_that_arrive_as_soon_as_the_chip_is_on_the_bus_are_not_lost() {
    let mut rig = Rig::at_rate(8, EVERYTHING, Attempts::UntilSent);
    for n in 0..40 {
        rig.peer_sends(Frame::extended(0x1234_5600 + n, &[n as u8; 8]));
    }
    for _ in 0..1000 {
        rig.turn();
        rig.idle_us(20);
    }
    let numbers: Vec<u8> = rig.received.iter().map(|frame| frame.data[0]).collect();
    assert_eq!(numbers, (0..40).collect::<Vec<u8>>());
    assert_eq!(rig.world().chip.borrow().rx_overflows(), 0);
}

#[test]
fn frames_pass_both_ways_at_each_bit_rate_with_the_latest_sample_point() {
    for (rate, registers, permille) in [
        (8, [0x00, 0x91, 0x01], 750),
        (4, [0x00, 0xBC, 0x01], 875),
        (2, [0x01, 0xBC, 0x01], 875),
        (1, [0x03, 0xBC, 0x01], 875),
    ] {
        let mut rig = Rig::at_rate(rate, EVERYTHING, Attempts::UntilSent);
        rig.run_ms(20);
        assert_eq!(rig.take_events(), [Event::Running], "rate {rate}");
        assert_eq!([rig.register(CNF1), rig.register(CNF2), rig.register(CNF3)], registers);
        assert_eq!(rig.world().chip.borrow().sample_point_permille(), permille);
        rig.peer_sends(Frame::extended(0x1234_5678, &[1, 2, 3]));
        assert!(rig.transmit(&frame(0x0FED_CBA9, &[4, 5])));
        rig.run_ms(5);
        let [received] = rig.received[..] else { panic!("{:?}", rig.received) };
        assert_eq!((received.id, received.data()), ([0x12, 0x34, 0x56, 0x78], &[1, 2, 3][..]));
        assert_eq!(rig.world().take_traffic(), (vec![Frame::extended(0x0FED_CBA9, &[4, 5])], 0));
    }
}

#[test]
fn every_identifier_and_length_is_transferred_unchanged() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    for n in 0..29 {
        let (id, len) = (1u32 << n, n as usize % 9);
        let data = &[n as u8, 0xFF, 0, 0x55, 0xAA, 1, 2, 3][..len];
        rig.peer_sends(Frame::extended(id, data));
        assert!(rig.transmit(&frame(id ^ 0x1FFF_FFFF, data)));
        rig.run_ms(1);
        let received = rig.received.pop().unwrap();
        assert_eq!((received.id, received.data()), (id.to_be_bytes(), data));
        assert_eq!(rig.world().take_traffic().0, [Frame::extended(id ^ 0x1FFF_FFFF, data)]);
    }
    rig.assert_counts(&[(RxReceived, 1 + 29), (TxRequests, 29)]);
}

#[test]
fn a_remote_frame_is_marked_as_foreign_and_a_length_code_above_8_means_8() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    rig.peer_sends(Frame::remote(Id::Extended(0x1003_F20A), 5));
    rig.peer_sends(Frame::with_dlc(Id::Extended(0x1003_F20A), 15, [7; 8]));
    rig.peer_sends(Frame::standard(0x123, &[1]));
    rig.run_ms(2);
    let [remote, long] = rig.received[..] else { panic!("{:?}", rig.received) };
    assert_eq!(remote.id[0], 0x10 | DriverFrame::FOREIGN);
    assert_eq!((long.id, long.data()), ([0x10, 0x03, 0xF2, 0x0A], &[7; 8][..]));
}

#[test]
fn a_frame_costs_two_chip_selects_and_8_bytes_besides_its_data() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    for len in 0..=8 {
        rig.peer_sends(Frame::extended(0x1003_F20A, &[0x55; 8][..len]));
        rig.idle_ms(1);
        rig.world().take_cost();
        assert!(rig.driver.has_frame() && rig.receive().is_some() && !rig.driver.has_frame());
        assert_eq!(rig.world().take_cost(), (2, 8 + len as u32));
    }
}

#[test]
fn frames_back_to_back_stay_in_order_at_no_more_than_two_chip_selects_each() {
    // Some of these times fill both buffers, and some roll a frame over while the driver reads
    // RXB0.
    for service_us in [20, 60, 90, 100, 105, 110, 120, 130, 180, 250] {
        let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
        for n in 0..60 {
            rig.peer_sends(Frame::extended(0x1003_F20A, &[n; 8]));
        }
        rig.world().take_cost();
        while rig.peer.borrow().queued() > 0 || rig.driver.has_frame() {
            if rig.driver.has_frame() {
                let received = rig.receive().unwrap();
                rig.received.push(received);
            }
            rig.idle_us(service_us);
        }
        let numbers: Vec<u8> = rig.received.iter().map(|frame| frame.data[0]).collect();
        assert!(numbers.is_sorted_by(|a, b| a < b), "served after {service_us} us: {numbers:?}");
        assert!(
            service_us > 105 || numbers.len() == 60,
            "served after {service_us} us: {numbers:?}"
        );
        let (selects, _) = rig.world().take_cost();
        assert!(
            selects <= 2 * numbers.len() as u32,
            "served after {service_us} us: {selects} chip selects"
        );
    }
}

#[test]
fn a_long_transfer_is_sent_in_order_with_at_most_one_gap_in_twelve_frames() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    let mut sent = 0;
    while sent < 60 {
        if rig.transmit(&frame(0x1E01_7FAA, &[sent; 8])) {
            sent += 1;
        }
        rig.idle_us(15);
    }
    rig.idle_ms(1);
    let records = rig.world().bus.take_records();
    let numbers: Vec<u8> = records
        .iter()
        .filter_map(|record| match record.kind {
            RecordKind::Frame { frame, .. } => Some(frame.data()[0]),
            RecordKind::ErrorFrame { .. } => None,
        })
        .collect();
    assert_eq!(numbers, (0..60).collect::<Vec<u8>>());
    // The intermission is three bits; one more bit is tolerance.
    let gaps = records.windows(2).filter(|pair| pair[1].start - pair[0].end > 4 * 16).count();
    assert!(gaps <= 60 / 12, "{gaps} gaps");
    rig.run_ms(20);
    rig.assert_counts(&[(TxSuccess, 60)]);
}

#[test]
fn in_one_shot_mode_a_frame_without_acknowledgement_is_sent_once_and_blocks_nothing() {
    let mut rig = Rig::running(EVERYTHING, Attempts::Once);
    rig.world().connect_peer(false);
    for n in 0..10 {
        assert!(rig.transmit(&frame(0x1E97_4D00, &[n])), "frame {n}");
        rig.run_ms(250);
        assert_eq!(rig.world().take_traffic(), (vec![], 1), "one attempt");
        assert!(rig.driver.state(0).is_empty);
    }
    rig.world().connect_peer(true);
    rig.run_ms(5);
    assert!(rig.transmit(&frame(0x1E97_4D00, &[10])));
    rig.run_ms(5);
    assert_eq!(rig.world().take_traffic().0, [Frame::extended(0x1E97_4D00, &[10])]);
    assert!(!rig.take_events().contains(&Event::GaveUpSending));
    rig.assert_sent(11, 0, 0);
}

#[test]
fn in_one_shot_mode_a_frame_that_is_destroyed_or_loses_arbitration_is_not_sent_again() {
    let mut rig = Rig::running(EVERYTHING, Attempts::Once);
    for bit in [1, 20, 40, 50, 60] {
        rig.world().bus.inject(Fault::FlipBit { bit });
        assert!(rig.transmit(&frame(0x1E97_4D00, &[1, 2])));
        rig.run_ms(30);
        assert_eq!(rig.world().take_traffic(), (vec![], 1), "bit {bit}");
    }
    rig.lose_arbitration(&frame(0x1E97_4D00, &[1, 2]));
    rig.run_ms(30);
    assert_eq!(rig.world().take_traffic(), (vec![], 0));
}

/// They may begin to wait at any time between two supervisions.
#[test]
fn frames_are_given_up_when_they_have_waited_for_1050_ms_and_not_before() {
    for begin_ms in 0..12 {
        let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
        rig.world().connect_peer(false);
        rig.run_ms(20 + begin_ms);
        let begin = rig.world().now;
        assert!(rig.transmit(&frame(0x1801_552A, &[1])));
        while !rig.take_events().contains(&Event::GaveUpSending) {
            rig.run_ms(1);
        }
        let waited_ms = (rig.world().now - begin) / MS;
        assert!((1050..1100).contains(&waited_ms), "{waited_ms} ms, from {begin_ms} ms");
    }
}

/// If nobody acknowledges it, the chip is soon error-passive. Then the bus may have another bit
/// rate: the chip tries each frame once, and after one that failed only in a part of each 1050 ms.
#[test]
fn without_one_shot_mode_a_frame_is_repeated_until_it_is_acknowledged_or_dropped() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    rig.world().bus.inject(Fault::FlipBit { bit: 40 });
    assert!(rig.transmit(&frame(0x1E97_4D2A, &[1, 2])));
    rig.run_ms(30);
    assert_eq!(rig.world().take_traffic(), (vec![Frame::extended(0x1E97_4D2A, &[1, 2])], 1));
    rig.assert_sent(1, 1, 0);

    rig.world().connect_peer(false);
    for n in 0..3 {
        assert!(rig.transmit(&frame(0x1801_552A, &[n])));
    }
    rig.run_ms(1000);
    assert!(!rig.take_events().contains(&Event::GaveUpSending));
    assert!(!rig.transmit(&frame(0x1801_552A, &[3])), "no room");
    rig.run_ms(100);
    assert!(rig.take_events().contains(&Event::GaveUpSending));
    rig.world().connect_peer(true);
    rig.run_ms(50);
    rig.assert_sent(4, 1, 3);
    let mut waited_ms = 0;
    while !rig.transmit(&frame(0x1801_552A, &[4])) {
        rig.run_ms(1);
        waited_ms += 1;
        assert!(waited_ms <= 1050, "a try in each 1050 ms");
    }
    rig.run_ms(50);
    assert_eq!(rig.world().take_traffic().0.last(), Some(&Frame::extended(0x1801_552A, &[4])));
    rig.assert_sent(5, 2, 3);
    assert!(rig.transmit(&frame(0x1801_552A, &[5])), "at any time");
}

/// The filters reject the frames of the peer, so nothing else shows it.
#[test]
fn a_frame_that_lost_an_arbitration_shows_that_the_bit_rate_is_right() {
    let acceptance = Accept { id: 0x1FFF_FFFF, mask: 0x1FFF_FFFF };
    let mut rig = Rig::at_rate(8, acceptance, Attempts::UntilSent);
    rig.run_ms(20);
    rig.lose_arbitration(&frame(0x1801_552A, &[0]));
    rig.run_ms(20);
    assert_eq!(rig.world().take_traffic(), (vec![], 0), "tried once");
    assert!(rig.transmit(&frame(0x1801_552A, &[1])), "not only in a part of each 1050 ms");
    rig.run_ms(5);
    assert_eq!(rig.world().take_traffic().0, [Frame::extended(0x1801_552A, &[1])]);
}

/// It fails ten times in a row, after it has lost against a frame of the peer.
#[test]
fn a_frame_that_lost_an_arbitration_and_then_failed_does_not_show_that_the_bit_rate_is_right() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    rig.lose_arbitration(&frame(0x1801_552A, &[0]));
    while rig.register(TXB2CTRL) & MLOA == 0 {
        rig.idle_us(1);
    }
    rig.world().connect_peer(false);
    rig.run_ms(200);
    for ms in 200..900 {
        assert!(!rig.transmit(&frame(0x1801_552A, &[1])), "after {ms} ms");
        rig.run_ms(1);
    }
}

/// A chip may be bus-off for only 1.4 ms.
#[test]
fn while_a_frame_waits_the_error_flags_are_read_once_in_each_millisecond() {
    for waits in [false, true] {
        let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
        rig.world().connect_peer(false);
        if waits {
            assert!(rig.transmit(&frame(0x1801_552A, &[])));
        }
        let begin_ms = rig.now_ms();
        let mut supervisions = 0;
        for now_ms in begin_ms + 1..=begin_ms + 50 {
            let mut polls = 0;
            while rig.driver.state(now_ms).is_due && polls < 10 {
                rig.driver.poll(now_ms);
                polls += 1;
            }
            let is_supervision = polls >= 4;
            supervisions += u8::from(is_supervision);
            let expected = u8::from(waits) + if is_supervision { 4 } else { 0 };
            assert_eq!(polls, expected, "{now_ms} ms, {waits}");
        }
        assert_eq!(supervisions, 5, "{waits}");
    }
}

#[test]
fn a_new_configuration_applies_within_20_ms() {
    let mut rig = Rig::running(Accept { id: 0x0000_0100, mask: 0x00FF_FF80 }, Attempts::Once);
    assert_eq!(rig.register(CANCTRL), OSM);
    let now_ms = rig.now_ms();
    rig.driver.reconfigure(now_ms, |configuration| {
        configuration.acceptance = Accept { id: 0x0001_5500, mask: 0x00FF_FF80 };
        configuration.attempts = Attempts::UntilSent;
    });
    rig.run_ms(20);
    assert_eq!(rig.take_events(), [Event::Running]);
    assert_eq!(rig.register(CANCTRL), 0);
    rig.peer_sends(Frame::extended(0x1E00_017F, &[1]));
    rig.peer_sends(Frame::extended(0x1801_5501, &[2]));
    rig.run_ms(5);
    assert_eq!(rig.received.iter().map(|frame| frame.data[0]).collect::<Vec<_>>(), [2]);
}

#[test]
fn a_changed_mode_or_register_is_detected_and_repaired_within_20_ms() {
    for (register, value) in
        [(CANCTRL, OSM), (CANCTRL, 0x60), (CANINTE, 0x01), (RXB0CTRL, 0x00), (RXB0CTRL, 0x64)]
    {
        let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
        rig.direct_spi(&[WRITE, register, value]);
        rig.run_ms(20);
        assert_eq!(rig.take_events(), [Event::Lost, Event::Running], "register {register:02X}");
        rig.peer_sends(Frame::extended(1, &[]));
        rig.run_ms(2);
        assert_eq!(rig.received.len(), 1);
    }
}

/// A frame waits to be sent when the chip stops answering: the SPI reads all ones.
#[test]
fn a_chip_that_does_not_answer_is_restarted_ten_times_a_second() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    rig.peer.borrow_mut().set_listen_only(true);
    assert!(rig.transmit(&frame(0x1003_F20A, &[1])));
    rig.run_ms(3);
    rig.world().miso_stuck = Some(0xFF);
    rig.world().int_stuck = Some(false);
    rig.world().violations_expected = true;
    rig.run_ms(50);
    rig.notices.clear();
    rig.run_ms(1000);
    let events = rig.take_events();
    assert!(events.iter().all(|event| *event == Event::NotAnswering), "{events:?}");
    assert!((9..=10).contains(&events.len()), "{} times", events.len());
}

#[test]
fn an_interrupt_pin_that_does_not_follow_the_chip_is_detected_within_20_ms() {
    for level in [false, true] {
        let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
        rig.world().int_stuck = Some(level);
        // With INT high the driver does not find the frame.
        rig.peer_sends(Frame::extended(0x1003_F20A, &[1, 2, 3]));
        rig.run_ms(20);
        assert_eq!(rig.take_events(), [Event::IntWrong], "{level}");
        // From here on the driver asks the chip.
        for n in 0..100 {
            rig.peer_sends(Frame::extended(0x1003_F20A, &[n]));
            rig.run_ms(2);
        }
        assert_eq!(rig.received.len(), 101, "{level}");
        assert_eq!(rig.take_events(), [], "{level}");
        rig.world().int_stuck = None;
        rig.run_ms(3000);
        rig.peer_sends(Frame::extended(0x1003_F20A, &[4]));
        rig.run_ms(2);
        assert_eq!((rig.take_events(), rig.received.len()), (vec![], 102), "{level}");
    }
}

#[test]
fn a_register_that_reads_back_wrong_is_reported_and_the_chip_stays_off_the_bus() {
    // RXF0SIDH, RXF5EID0, RXM1SIDL, the bit timing and the enabled interrupts.
    for register in [0x00, 0x1B, 0x25, CNF3, CNF2, CNF1, CANINTE] {
        let mut rig = Rig::at_rate(8, EVERYTHING, Attempts::UntilSent);
        rig.world().corrupted = Some(register);
        rig.run_ms(20);
        let [Notice { event: Event::NotKeeping, value }] = rig.notices[..] else {
            panic!("{:?}", rig.notices)
        };
        assert_eq!(value, register);
        assert!(!rig.driver.state(0).is_running);
        rig.notices.clear();
        rig.run_ms(150);
        assert_eq!(rig.take_events(), [Event::Running], "register {register:02X}");
    }
}

#[test]
fn without_a_configuration_the_driver_does_not_access_the_chip() {
    let mut rig = Rig::at_rate(8, EVERYTHING, Attempts::UntilSent);
    let wire = rig.wire.clone();
    rig.driver = Mcp2515::unconfigured(wire.clone(), wire.clone(), wire, EVERYTHING);
    rig.run_ms(300);
    let now_ms = rig.now_ms();
    rig.driver.reconfigure(now_ms, |configuration| configuration.attempts = Attempts::Once);
    rig.run_ms(300);
    assert_eq!(rig.world().take_cost(), (0, 0));
    assert_eq!(rig.take_events(), []);
    let (timing, acceptance) = (BitTiming::new(CRYSTAL_HZ, 1_000_000), EVERYTHING);
    rig.driver.configure(Configuration { timing, acceptance, attempts: Attempts::UntilSent });
    rig.run_ms(20);
    assert_eq!(rig.take_events(), [Event::Running]);
}

/// This is the reason why the driver does not check the filters of a running chip.
#[test]
fn the_chip_does_not_show_its_filters_outside_configuration_mode() {
    let mut rig = Rig::running(Accept { id: 0x1FFF_FFFF, mask: 0x1FFF_FFFF }, Attempts::UntilSent);
    assert_eq!(rig.direct_spi(&[READ, 0x00, 0]), 0);
    assert_eq!(rig.direct_spi(&[READ, 0x20, 0]), 0);
}

#[test]
fn each_check_that_finds_lost_frames_counts_and_reports_them() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    for count in 1..=3 {
        for n in 0..3 {
            rig.peer_sends(Frame::extended(0x1003_F20A, &[n]));
        }
        rig.idle_ms(1);
        rig.run_ms(50);
        let [notice] = rig.notices[..] else { panic!("{:?}", rig.notices) };
        assert_eq!(notice.event, Event::Flags);
        assert!(ErrorFlags(notice.value).frames_lost());
        rig.assert_counts(&[(RxOverflow, count)]);
        assert_eq!(rig.received.len(), 2);
        rig.notices.clear();
        rig.received.clear();
    }
}

/// As after noise on the SPI.
#[test]
fn flags_that_end_while_the_driver_listens_are_reported_after_it() {
    let mut rig = Rig::at_rate(8, EVERYTHING, Attempts::UntilSent);
    rig.run_ms(20);
    for misread in [(EFLG, 0x10), (REC, 1)] {
        rig.world().misread = Some(misread);
        let before = rig.notices.len();
        while rig.notices.len() == before {
            rig.turn();
            rig.idle_us(50);
        }
    }
    rig.world().misread = None;
    for _ in 0..2 {
        rig.peer_sends(Frame::extended(0x1003_F20A, &[]));
        rig.run_ms(20);
    }
    let last = *rig.notices.last().unwrap();
    assert_eq!(last, Notice { event: Event::Flags, value: 0 });
    let expected = [Event::Running, Event::Flags, Event::Running, Event::Flags];
    assert_eq!(rig.take_events(), expected);
}

#[test]
#[cfg(feature = "counters")]
fn receive_errors_are_counted_as_rec_increases() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    let mut expected = 0;
    // Destroyed frames of the peer, without good frames in between, which would decrease REC.
    for _ in 0..5 {
        let rec = rig.register(REC);
        rig.world().bus.inject(Fault::FlipBit { bit: 40 });
        rig.peer_sends(Frame::extended(0x1003_F20A, &[0x55; 8]));
        rig.idle_us(100);
        rig.peer.borrow_mut().clear_queue();
        expected += u32::from(rig.register(REC).saturating_sub(rec));
        rig.run_ms(20);
    }
    assert!(expected >= 5);
    let counted = rig.counter(Counter::RxErrors);
    // The peer may repeat a frame, which decreases REC by 1, before or after the check.
    assert!((expected - 5..=expected).contains(&counted), "{counted} of {expected}");
}

#[test]
fn a_long_bus_off_is_counted_once() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    // The chip sees another bit than it sends, until it is bus-off. Then the bus is stuck dominant,
    // so that the chip cannot recover.
    let chip_port = rig.world().chip_port;
    rig.world().bus.inject(Fault::FlipBitSeenBy { port: chip_port, bit: 45 });
    assert!(rig.transmit(&frame(0x1801_552A, &[0; 8])));
    while rig.register(EFLG) & 0x20 == 0 {
        while rig.world().take_traffic().1 == 0 {
            rig.idle_us(1);
        }
        if rig.register(EFLG) & 0x20 == 0 {
            rig.world().bus.inject(Fault::FlipBitSeenBy { port: chip_port, bit: 45 });
        }
    }
    rig.world().bus.inject(Fault::StuckDominant(true));
    rig.run_ms(300);
    let bus_offs = rig
        .notices
        .iter()
        .filter(|notice| notice.event == Event::Flags && ErrorFlags(notice.value).bus_off());
    assert_eq!(bus_offs.count(), 1, "{:?}", rig.notices);
    rig.assert_counts(&[(BusOffs, 1)]);
    rig.world().bus.inject(Fault::StuckDominant(false));
    rig.run_ms(50);
    rig.assert_counts(&[(BusOffs, 1)]);
    assert_eq!(rig.world().take_traffic().0, [Frame::extended(0x1801_552A, &[0; 8])]);
}

#[test]
fn a_restart_of_the_chip_does_not_change_the_counters() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    rig.direct_spi(&[0xC0]);
    rig.run_ms(200);
    assert_eq!(rig.take_events(), [Event::Lost, Event::Running]);
    rig.assert_counts(&[(RxReceived, 1)]);
}

#[test]
#[cfg(feature = "counters")]
fn frames_are_counted_beyond_16_bits() {
    let mut rig = Rig::running(EVERYTHING, Attempts::UntilSent);
    for _ in 0..65_540u32 {
        while !rig.transmit(&frame(1, &[])) {
            rig.idle_us(70);
        }
    }
    rig.assert_counts(&[(TxRequests, 65_540)]);
}

/// Bits of EFLG (DS20001801J, register 6-3).
#[test]
fn error_flags_have_the_meaning_of_eflg() {
    for (bit, frames_lost, bus_off, error_passive) in [
        (1 << 7, true, false, false), // RX1OVR
        (1 << 6, true, false, false), // RX0OVR
        (1 << 5, false, true, false), // TXBO
        (1 << 4, false, false, true), // TXEP
        (1 << 3, false, false, true), // RXEP
        (0b111, false, false, false), // TXWAR, RXWAR, EWARN
    ] {
        let flags = ErrorFlags(bit);
        let reported = (flags.frames_lost(), flags.bus_off(), flags.error_passive());
        assert_eq!(reported, (frames_lost, bus_off, error_passive), "{bit:#010b}");
    }
    let all = ErrorFlags(0xFF);
    assert!(all.frames_lost() && all.bus_off() && all.error_passive());
}
