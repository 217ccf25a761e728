//! The driver in a queue that an interrupt fills, with the simulator's model of the chip on a
//! simulated bus. The interrupt of INT comes at the falling edge: while the main loop works, or at
//! the end of the critical section in which the edge was.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use crate::wire::{CRYSTAL_HZ, MS, US, Wire, World};
use can_model::{Frame as BusFrame, RecordKind};
use critical_section::RawRestoreState;
use embedded_can::nb::Can;
use embedded_can::{Error as _, ErrorKind, ExtendedId, Frame as _, Id};
use mcp2515_ordered::{
    Attempts, BitTiming, CanError, Configuration, Event, Exclusive, Filters, Frame, Mcp2515, Queue,
};
use sim_base::Cycles;

const BIT_RATE: u32 = 1_000_000;
const PLACES: usize = 8;

type Handler = Rc<dyn Fn()>;
type OnWire = Wire<World>;
type TestQueue = Queue<Exclusive<OnWire, OnWire>, OnWire, Filters, PLACES>;

thread_local! {
    /// Critical sections are not nested, because the handler takes one.
    static IS_CRITICAL: Cell<bool> = const { Cell::new(false) };
    /// INT has fallen since the handler ran.
    static IS_PENDING: Cell<bool> = const { Cell::new(false) };
    static HANDLER: RefCell<Option<Handler>> = const { RefCell::new(None) };
}

struct Interrupts;
critical_section::set_impl!(Interrupts);

// SAFETY: each test has one thread, and the handler runs outside of critical sections only.
unsafe impl critical_section::Impl for Interrupts {
    unsafe fn acquire() -> RawRestoreState {
        assert!(!IS_CRITICAL.replace(true), "a critical section in another one");
    }

    unsafe fn release((): RawRestoreState) {
        IS_CRITICAL.set(false);
        interrupt();
    }
}

/// Runs the handler if the interrupt is pending and enabled.
fn interrupt() {
    let handler = HANDLER.with_borrow(Clone::clone);
    if let Some(handler) = handler
        && !IS_CRITICAL.get()
        && IS_PENDING.replace(false)
    {
        handler();
    }
}

struct Rig {
    wire: OnWire,
    queue: Rc<TestQueue>,
}

impl Rig {
    fn new() -> Self {
        let wire = World::new(BIT_RATE);
        wire.0.borrow_mut().int_falls = || IS_PENDING.set(true);
        Self { wire, queue: Rc::new(Queue::new()) }
    }

    fn install(&self, acceptance: Filters, attempts: Attempts) {
        let [spi, cs, int] = [(); 3].map(|()| self.wire.clone());
        let timing = BitTiming::new(CRYSTAL_HZ, BIT_RATE);
        self.queue.install(Mcp2515::new(
            spi,
            cs,
            int,
            Configuration { timing, acceptance, attempts },
        ));
        let queue = self.queue.clone();
        HANDLER.set(Some(Rc::new(move || queue.receive())));
    }

    fn clock(&self) -> impl FnMut() -> u16 + use<> {
        let wire = self.wire.clone();
        move || (wire.0.borrow().now / MS) as u16
    }

    /// The main loop does something else.
    fn work(&self, time: Cycles) {
        let end = self.wire.0.borrow().now + time;
        while self.wire.0.borrow().now < end {
            let rest = end - self.wire.0.borrow().now;
            self.wire.0.borrow_mut().run(rest.min(US));
            interrupt();
        }
    }

    fn send(&self, number: u8) {
        let frame = BusFrame::extended(0x1000_0000, &[number]);
        self.wire.0.borrow().peer.borrow_mut().send(frame);
    }

    /// The data of the frames that passed since the last call.
    fn take_passed(&self) -> Vec<BusFrame> {
        let records = self.wire.0.borrow_mut().bus.take_records();
        let passed = records.into_iter().map(|record| match record.kind {
            RecordKind::Frame { frame, .. } => frame,
            RecordKind::ErrorFrame { .. } => panic!("{record:?}"),
        });
        passed.collect()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        HANDLER.set(None);
    }
}

/// The first byte of the frames that there are.
fn numbers<C: Can<Error = CanError>>(can: &mut C) -> Vec<u8> {
    std::iter::from_fn(|| can.receive().ok()).map(|frame| frame.data()[0]).collect()
}

/// The next error.
fn error<C: Can<Error = CanError>>(rig: &Rig, can: &mut C) -> CanError {
    let error = (0..10_000).find_map(|_| {
        rig.work(20 * US);
        match can.receive() {
            Err(nb::Error::Other(error)) => Some(error),
            _ => None,
        }
    });
    error.expect("an error within 200 ms")
}

/// Starts the chip, and lets a frame pass, so that it no longer tries each frame once.
fn start<C: Can<Error = CanError>>(rig: &Rig, can: &mut C) {
    for _ in 0..20 * MS / (20 * US) {
        assert_eq!(numbers(can), []);
        rig.work(20 * US);
    }
    rig.send(0);
    rig.work(MS);
    assert_eq!(numbers(can), [0]);
    rig.take_passed();
}

#[test]
fn the_interrupt_keeps_eight_frames_and_the_chip_two_until_the_main_loop_comes() {
    let rig = Rig::new();
    rig.install(Filters::ALL_EXTENDED, Attempts::UntilSent);
    let mut can = rig.queue.with_clock(rig.clock());
    start(&rig, &mut can);
    (1..=10).for_each(|number| rig.send(number));
    rig.work(2 * MS);
    // INT stayed low after the ninth frame, so there was no edge for the tenth.
    assert_eq!(numbers(&mut can), [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
    (1..=11).for_each(|number| rig.send(number));
    rig.work(3 * MS);
    assert_eq!(numbers(&mut can), [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
    assert_eq!(error(&rig, &mut can).kind(), ErrorKind::Overrun);
}

#[test]
fn without_an_interrupt_the_main_loop_receives() {
    let rig = Rig::new();
    rig.install(Filters::ALL_EXTENDED, Attempts::UntilSent);
    HANDLER.set(None);
    let mut can = rig.queue.with_clock(rig.clock());
    start(&rig, &mut can);
    for number in 1..=20 {
        rig.send(number);
        rig.work(MS / 2);
        assert_eq!(numbers(&mut can), [number]);
    }
}

/// The main loop answers each frame. The burst begins a cycle later each time, so the handler comes
/// at the end of each critical section, and between any two of them.
#[test]
fn whenever_frames_arrive_they_are_received_and_answered_in_order() {
    let rig = Rig::new();
    rig.install(Filters::ALL_EXTENDED, Attempts::UntilSent);
    let mut can = rig.queue.with_clock(rig.clock());
    start(&rig, &mut can);
    for offset in 0..400 {
        rig.work(offset);
        (1..=3).for_each(|number| rig.send(number));
        let mut waiting = VecDeque::new();
        for _ in 0..60 {
            waiting.extend(can.receive().ok());
            if let Some(&Frame { id: [_, rest @ ..], data, .. }) = waiting.front() {
                let reply = Frame { id: [0x11, rest[0], rest[1], rest[2]], len: 1, data };
                if can.transmit(&reply).is_ok() {
                    waiting.pop_front();
                }
            }
            rig.work(10 * US);
        }
        assert!(waiting.is_empty());
        let (mut sent, mut answered) = (vec![], vec![]);
        for frame in rig.take_passed() {
            let is_reply = frame.id == can_model::Id::Extended(0x1100_0000);
            if is_reply { &mut answered } else { &mut sent }.push(frame.data()[0]);
        }
        assert_eq!((sent, answered), (vec![1, 2, 3], vec![1, 2, 3]), "offset {offset}");
    }
}

#[test]
fn frames_of_other_kinds_take_no_place() {
    let rig = Rig::new();
    rig.install(Filters::ALL, Attempts::UntilSent);
    let mut can = rig.queue.with_clock(rig.clock());
    start(&rig, &mut can);
    for _ in 0..2 * PLACES {
        rig.wire.0.borrow().peer.borrow_mut().send(BusFrame::standard(1, &[]));
    }
    rig.send(5);
    rig.work(3 * MS);
    assert_eq!(numbers(&mut can), [5]);
}

#[test]
fn errors_are_those_of_the_driver_and_a_queue_without_one_has_nothing() {
    let rig = Rig::new();
    let id: Id = ExtendedId::new(1).unwrap().into();
    let frame = Frame::new(id, &[]).unwrap();
    let mut can = rig.queue.with_clock(rig.clock());
    assert_eq!(can.receive(), Err(nb::Error::WouldBlock));
    assert_eq!(can.transmit(&frame), Err(nb::Error::WouldBlock));
    rig.install(Filters::ALL, Attempts::Never);
    assert_eq!(can.transmit(&frame), Err(nb::Error::Other(CanError::ListensOnly)));
    assert_eq!(rig.queue.with_driver(|driver| driver.is_running()), Some(false));
    rig.wire.0.borrow().chip.borrow_mut().hold_in_configuration(true);
    let event = Event::NotStarting;
    let error = error(&rig, &mut can);
    assert!(matches!(error, CanError::Notice(notice) if notice.event == event), "{error:?}");
}
