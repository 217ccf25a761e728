//! The driver on both kinds of SPI and through the traits of `embedded-can`, in each mode, with the
//! simulator's model of the chip on a simulated bus.

use std::cell::{RefCell, RefMut};
use std::rc::Rc;

use crate::wire::{CRYSTAL_HZ, Device, MS, US, World};
use can_model::{Frame as BusFrame, Id as BusId, SoftNode};
use embedded_can::{Error as _, ErrorKind, ExtendedId, Frame as _, Id, StandardId, blocking, nb};
use mcp2515_ordered::{
    AnyFrame, Attempts, BitTiming, CanError, Configuration, Driver, Event, Filters, Instructions,
    Mcp2515, Notice, SharedMcp2515, WithClock,
};
use sim_base::Cycles;

const BIT_RATE: u32 = 500_000;
/// Time that passes between two calls of a driver.
const CALL: Cycles = 20 * US;

type Wire = crate::wire::Wire<World>;

/// The wires to a chip on a bus with a station that acknowledges.
struct Rig(Wire);

impl Rig {
    fn new() -> Rig {
        Rig(World::new(BIT_RATE))
    }

    fn configuration(acceptance: Filters, attempts: Attempts) -> Configuration<Filters> {
        Configuration { timing: BitTiming::new(CRYSTAL_HZ, BIT_RATE), acceptance, attempts }
    }

    /// A clock that also lets time pass for the bus.
    fn clock(&self) -> impl FnMut() -> u16 + use<> {
        let wire = self.0.clone();
        move || {
            let mut world = wire.0.borrow_mut();
            world.run(CALL);
            (world.now / MS) as u16
        }
    }

    fn exclusive(&self, attempts: Attempts) -> Mcp2515<Wire, Wire, Wire, Filters> {
        let [spi, cs, int] = [(); 3].map(|()| self.0.clone());
        Mcp2515::new(spi, cs, int, Self::configuration(Filters::ALL, attempts))
    }

    fn shared(&self, attempts: Attempts) -> SharedMcp2515<Device<World>, Wire, Filters> {
        let (device, int) = (Device(self.0.clone()), self.0.clone());
        SharedMcp2515::new(device, int, Self::configuration(Filters::ALL, attempts))
    }

    fn world(&self) -> RefMut<'_, World> {
        self.0.0.borrow_mut()
    }

    fn peer_sends(&self, frame: BusFrame) {
        self.world().peer.borrow_mut().send(frame);
    }
}

type Clocked<C, T> = WithClock<C, Wire, Filters, T>;

/// Polls for some time, and returns the events.
fn poll<C: Instructions, T: FnMut() -> u16>(can: &mut Clocked<C, T>, ms: u64) -> Vec<Event> {
    (0..ms * MS / CALL).filter_map(|_| can.poll()).map(|notice| notice.event).collect()
}

/// Polls until the chip is on the bus.
fn start<C: Instructions, T: FnMut() -> u16>(can: &mut Clocked<C, T>) {
    assert_eq!(poll(can, 20), [Event::Running]);
}

/// Starts the chip, and lets a frame pass, so that the chip no longer tries each frame once.
fn start_and_hear<C: Instructions, T: FnMut() -> u16>(rig: &Rig, can: &mut Clocked<C, T>) {
    start(can);
    rig.peer_sends(BusFrame::standard(1, &[]));
    assert!(receive(can, 5).is_some());
    assert_eq!(poll(can, 20), []);
    rig.world().take_traffic();
}

/// Calls until there is a frame, for `ms` at most.
fn receive<C: nb::Can>(can: &mut C, ms: u64) -> Option<C::Frame> {
    (0..ms * MS / CALL).find_map(|_| can.receive().ok())
}

/// A program that knows only the blocking trait: sends back `frames` frames with other data.
fn echo<C: blocking::Can>(can: &mut C, frames: usize) -> Result<(), C::Error> {
    for _ in 0..frames {
        let frame = can.receive()?;
        let data: Vec<u8> = frame.data().iter().map(|byte| !byte).collect();
        let reply = if frame.is_remote_frame() {
            C::Frame::new_remote(frame.id(), frame.dlc())
        } else {
            C::Frame::new(frame.id(), &data)
        };
        can.transmit(&reply.expect("of the same length"))?;
    }
    Ok(())
}

fn check_echo<C: Instructions>(rig: &Rig, driver: Driver<C, Wire, Filters>) {
    let standard = BusId::Standard(0x123);
    let frames = [
        (BusFrame::standard(0x7FF, &[1, 2]), BusFrame::standard(0x7FF, &[0xFE, 0xFD])),
        (BusFrame::extended(0x1555_AAAA, &[0; 8]), BusFrame::extended(0x1555_AAAA, &[0xFF; 8])),
        (BusFrame::standard(0, &[]), BusFrame::standard(0, &[])),
        (BusFrame::remote(standard, 3), BusFrame::remote(standard, 3)),
        (
            BusFrame::remote(BusId::Extended(0x0AAA_5555), 8),
            BusFrame::remote(BusId::Extended(0x0AAA_5555), 8),
        ),
        (BusFrame::standard(0x2AA, &[5; 7]), BusFrame::standard(0x2AA, &[0xFA; 7])),
    ];
    let mut can = driver.with_clock(rig.clock());
    start_and_hear(rig, &mut can);
    frames.iter().for_each(|(frame, _)| rig.peer_sends(*frame));
    assert_eq!(echo(&mut can, frames.len()), Ok(()));
    poll(&mut can, 1);
    let replies: Vec<BusFrame> = frames.iter().map(|(_, reply)| *reply).collect();
    assert_eq!(rig.world().take_traffic(), (replies, 0));
}

#[test]
fn a_program_of_the_blocking_trait_gets_and_sends_frames_of_each_kind_in_order() {
    let rig = Rig::new();
    check_echo(&rig, rig.exclusive(Attempts::UntilSent));
    let rig = Rig::new();
    check_echo(&rig, rig.shared(Attempts::UntilSent));
}

/// The numbers of the frames that passed each way.
fn check_order<C: Instructions>(rig: &Rig, driver: Driver<C, Wire, Filters>) {
    let mut can = driver.with_clock(rig.clock());
    start_and_hear(rig, &mut can);
    let id: Id = ExtendedId::new(0x0123_4567).unwrap().into();
    (0..60).for_each(|n| rig.peer_sends(BusFrame::standard(0x400, &[n; 8])));
    let (mut sent, mut received) = (0, vec![]);
    for _ in 0..60 * MS / CALL {
        let frame = AnyFrame::new(id, &[sent; 8]).unwrap();
        if sent < 60 && nb::Can::transmit(&mut can, &frame).is_ok() {
            sent += 1;
        }
        received.extend(nb::Can::receive(&mut can).map(|frame| frame.data()[0]));
    }
    let numbers: Vec<u8> = (0..60).collect();
    assert_eq!(received, numbers);
    let (frames, errors) = rig.world().take_traffic();
    let frames: Vec<u8> = frames.iter().map(|frame| frame.data()[0]).collect();
    assert_eq!((frames, errors), (numbers, 0));
}

#[test]
fn frames_of_the_nonblocking_trait_stay_in_order_both_ways() {
    let rig = Rig::new();
    check_order(&rig, rig.exclusive(Attempts::UntilSent));
    let rig = Rig::new();
    check_order(&rig, rig.shared(Attempts::UntilSent));
}

#[test]
fn on_a_shared_bus_a_frame_costs_two_transactions_to_receive_and_three_to_send() {
    let rig = Rig::new();
    let mut can = rig.shared(Attempts::UntilSent).with_clock(rig.clock());
    start(&mut can);
    rig.peer_sends(BusFrame::standard(1, &[1]));
    rig.world().run(MS);
    rig.world().take_cost();
    assert!(can.driver().has_frame() && can.driver().receive_any().is_some());
    assert_eq!(rig.world().take_cost(), (2, 2 + 14));
    can.driver().find_room();
    can.driver().transmit_any(&AnyFrame::new(StandardId::ZERO, &[]).unwrap());
    assert_eq!(rig.world().take_cost(), (3, 2 + 16 + 1));
}

fn check_halves<C: Instructions>(rig: &Rig, driver: Driver<C, Wire, Filters>) {
    let mut can = driver.with_clock(rig.clock());
    start(&mut can);
    let frame = |n| mcp2515_ordered::Frame { id: [0x1F, 0xFF, 1, n], len: 2, data: [n; 8] };
    let driver = can.driver();
    driver.find_room();
    driver.begin_transmit(&frame(0));
    driver.finish_transmit(&frame(0));
    poll(&mut can, 1);
    let driver = can.driver();
    driver.find_room();
    driver.transmit(&frame(1));
    poll(&mut can, 1);
    let expected = [0, 1].map(|n| BusFrame::extended(0x1FFF_0100 + u32::from(n), &[n; 2]));
    assert_eq!(rig.world().take_traffic(), (expected.to_vec(), 0));
    rig.peer_sends(BusFrame::extended(0x1ABC_DEF0, &[7, 8]));
    rig.world().run(MS);
    let mut received = mcp2515_ordered::Frame::EMPTY;
    assert!(can.driver().receive(&mut received));
    assert_eq!((received.id, received.data()), ([0x1A, 0xBC, 0xDE, 0xF0], &[7, 8][..]));
}

/// The halves are for a program whose interrupt handler receives frames in between.
#[test]
fn a_frame_is_sent_in_two_halves_or_in_one() {
    let rig = Rig::new();
    check_halves(&rig, rig.exclusive(Attempts::UntilSent));
    let rig = Rig::new();
    check_halves(&rig, rig.shared(Attempts::UntilSent));
}

/// Runs a driver whose bit rate is not that of the bus, on which a frame is sent every 10 ms.
fn check_another_rate<C: Instructions>(rig: &Rig, mut driver: Driver<C, Wire, Filters>) {
    let mut configuration = Rig::configuration(Filters::ALL, Attempts::UntilSent);
    configuration.timing = BitTiming::new(CRYSTAL_HZ, BIT_RATE / 2);
    driver.configure(configuration);
    let other = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
    rig.world().bus.attach("other", other);
    let mut can = driver.with_clock(rig.clock());
    let mut events = vec![];
    for second in 0..5 {
        for n in 0..100 {
            rig.peer_sends(BusFrame::standard(n, &[0x55; 8]));
            events.extend(poll(&mut can, 10));
        }
        let (_, errors) = rig.world().take_traffic();
        assert!(errors == 0 || second == 0, "{errors} in second {second}");
    }
    assert_eq!(events, [Event::Running, Event::AnotherRate]);
}

#[test]
fn at_another_bit_rate_than_that_of_the_bus_the_chip_listens_and_disturbs_nobody() {
    let rig = Rig::new();
    check_another_rate(&rig, rig.exclusive(Attempts::UntilSent));
    let rig = Rig::new();
    check_another_rate(&rig, rig.shared(Attempts::UntilSent));
}

#[test]
fn in_listen_only_mode_the_chip_receives_and_neither_acknowledges_nor_sends() {
    let rig = Rig::new();
    let other = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
    let other_port = rig.world().bus.attach("other", other);
    let mut can = rig.shared(Attempts::Never).with_clock(rig.clock());
    start(&mut can);
    rig.peer_sends(BusFrame::standard(0x321, &[1, 2, 3]));
    let frame = receive(&mut can, 5).expect("the other station acknowledges");
    assert_eq!(
        (frame.id(), frame.data()),
        (StandardId::new(0x321).unwrap().into(), &[1, 2, 3][..])
    );
    assert_eq!(nb::Can::transmit(&mut can, &frame), Err(::nb::Error::Other(CanError::ListensOnly)));
    assert_eq!(blocking::Can::transmit(&mut can, &frame), Err(CanError::ListensOnly));
    // Nobody is left to acknowledge.
    rig.world().bus.connect(other_port, false);
    rig.world().take_traffic();
    rig.peer_sends(BusFrame::standard(0x322, &[]));
    poll(&mut can, 5);
    let (frames, errors) = rig.world().take_traffic();
    assert!(frames.is_empty() && errors > 3, "{frames:?} {errors}");
}

#[test]
fn in_loopback_mode_the_chip_receives_its_own_frames_and_the_bus_gets_none() {
    let rig = Rig::new();
    let mut can = rig.shared(Attempts::ToItself).with_clock(rig.clock());
    start(&mut can);
    rig.peer_sends(BusFrame::standard(0x100, &[9]));
    for n in 0..20 {
        let frame = AnyFrame::new(StandardId::new(n).unwrap(), &[n as u8]).unwrap();
        assert_eq!(blocking::Can::transmit(&mut can, &frame), Ok(()));
        assert_eq!(receive(&mut can, 5), Some(frame));
    }
    let (frames, _) = rig.world().take_traffic();
    assert!(frames.is_empty(), "{frames:?}");
}

#[test]
fn a_blocking_call_returns_an_error_if_nobody_acknowledges_or_no_chip_answers() {
    let frame = AnyFrame::new(StandardId::ZERO, &[]).unwrap();
    let rig = Rig::new();
    rig.world().connect_peer(false);
    let mut can = rig.shared(Attempts::UntilSent).with_clock(rig.clock());
    let error = (0..10_000).find_map(|_| blocking::Can::transmit(&mut can, &frame).err());
    let error = error.expect("the frames that wait are given up");
    assert_eq!(error.kind(), ErrorKind::Acknowledge, "{error:?}");

    let rig = Rig::new();
    (rig.world().miso_stuck, rig.world().int_stuck) = (Some(0xFF), Some(true));
    let mut can = rig.shared(Attempts::UntilSent).with_clock(rig.clock());
    let error = blocking::Can::transmit(&mut can, &frame).unwrap_err();
    let notice = Notice { event: Event::NotAnswering, value: 0xFF };
    assert_eq!((error, error.kind()), (CanError::Notice(notice), ErrorKind::Other));
}

#[test]
fn lost_frames_are_an_overrun_after_the_frames_that_were_kept() {
    let rig = Rig::new();
    let mut can = rig.shared(Attempts::UntilSent).with_clock(rig.clock());
    start(&mut can);
    (0..5).for_each(|n| rig.peer_sends(BusFrame::standard(n, &[])));
    rig.world().run(5 * MS);
    let mut calls = vec![];
    for _ in 0..20 * MS / CALL {
        match nb::Can::receive(&mut can) {
            Ok(frame) => calls.push(Ok(frame.id())),
            Err(::nb::Error::Other(error)) => calls.push(Err(error.kind())),
            Err(::nb::Error::WouldBlock) => {}
        }
    }
    let id = |raw| Ok(StandardId::new(raw).unwrap().into());
    assert_eq!(calls, [id(0), id(1), Err(ErrorKind::Overrun)]);
}
