//! A driver that an interrupt and the main loop share, with the frames that wait for the main loop.

use core::cell::RefCell;

use critical_section::Mutex;
use embedded_hal::digital::InputPin;

use crate::chip::Instructions;
use crate::configuration::Attempts;
use crate::driver::{Driver, Notice};
use crate::filters::Acceptance;
use crate::frame::Frame;
use crate::with_clock::CanError;

/// A driver and up to `N` received frames, for a `static`: the interrupt of INT calls
/// [`receive`](Self::receive), and the main loop has the trait [`embedded_can::nb::Can`] through
/// [`with_clock`](Self::with_clock).
///
/// Without it the main loop must come round within two frame times, or the chip loses frames. With
/// it in `N + 2`.
///
/// * Each access is a critical section of the crate [`critical_section`], so the program needs an
///   implementation of it, as most HALs have. The longest passes a frame to the chip.
/// * Let the interrupt come at the falling edge of INT. [`Queued`] receives, too: so it finds the
///   frames for which there was no edge, because there was no room for the one before.
/// * Frames are extended data frames. Others are received and dropped.
///
/// ```
/// use embedded_can::nb::Can;
/// use embedded_hal::{digital::InputPin, spi::SpiDevice};
/// use mcp2515_ordered::{CanError, Filters, Queue, Shared, SharedMcp2515};
///
/// /// The SPI device and the INT pin of your HAL.
/// type Bus<D, INT> = Queue<Shared<D>, INT, Filters, 8>;
///
/// /// With `static CAN: Bus<...> = Queue::new();`, this is the handler.
/// fn on_falling_int<D: SpiDevice, INT: InputPin>(can: &'static Bus<D, INT>) {
///     can.receive();
/// }
///
/// fn main_loop<D: SpiDevice, INT: InputPin>(
///     queue: &'static Bus<D, INT>,
///     driver: SharedMcp2515<D, INT, Filters>,
///     now_ms: fn() -> u16,
/// ) -> Result<(), CanError> {
///     queue.install(driver);
///     let mut can = queue.with_clock(now_ms);
///     loop {
///         match can.receive() {
///             Ok(frame) => { /* use it */ }
///             Err(nb::Error::WouldBlock) => { /* other work */ }
///             Err(nb::Error::Other(error)) => return Err(error),
///         }
///     }
/// }
/// ```
pub struct Queue<C, INT, A, const N: usize>(Mutex<RefCell<Contents<C, INT, A, N>>>);

struct Contents<C, INT, A, const N: usize> {
    driver: Option<Driver<C, INT, A>>,
    frames: [Frame; N],
    /// The number of frames received and taken so far, modulo 256.
    received: u8,
    taken: u8,
}

impl<C: Instructions, INT: InputPin, A: Acceptance, const N: usize> Queue<C, INT, A, N> {
    /// A queue without a driver. `N` is a power of two, and at most 128.
    pub const fn new() -> Self {
        const { assert!(N.is_power_of_two() && N <= 128, "N is 1, 2, 4, 8, 16, 32, 64 or 128") }
        Self(Mutex::new(RefCell::new(Contents {
            driver: None,
            frames: [Frame::EMPTY; N],
            received: 0,
            taken: 0,
        })))
    }

    /// Puts a driver in the queue, and discards the one before with its frames.
    pub fn install(&self, driver: Driver<C, INT, A>) {
        self.access(|contents| {
            contents.driver = Some(driver);
            contents.taken = contents.received;
        });
    }

    fn access<R>(&self, access: impl FnOnce(&mut Contents<C, INT, A, N>) -> R) -> R {
        critical_section::with(|cs| access(&mut self.0.borrow_ref_mut(cs)))
    }

    /// Receives the frames that wait in the chip, as far as there is room. For the interrupt.
    pub fn receive(&self) {
        self.access(Contents::receive);
    }

    /// Accesses the driver, in a critical section. `None` if there is none.
    pub fn with_driver<R>(&self, access: impl FnOnce(&mut Driver<C, INT, A>) -> R) -> Option<R> {
        self.access(|contents| contents.driver.as_mut().map(access))
    }

    /// Adds a clock, for the main loop. `now_ms` returns the time in milliseconds, which wraps
    /// around.
    pub const fn with_clock<T: FnMut() -> u16>(&self, now_ms: T) -> Queued<'_, C, INT, A, T, N> {
        Queued { queue: self, now_ms, error: None }
    }
}

impl<C: Instructions, INT: InputPin, A: Acceptance, const N: usize> Default
    for Queue<C, INT, A, N>
{
    fn default() -> Self {
        Self::new()
    }
}

impl<C: Instructions, INT: InputPin, A: Acceptance, const N: usize> Contents<C, INT, A, N> {
    /// Receives into the places of the queue, because a copy of a frame takes as long as the rest.
    #[inline(never)]
    fn receive(&mut self) {
        let Some(driver) = &mut self.driver else { return };
        while usize::from(self.received.wrapping_sub(self.taken)) < N && driver.has_frame() {
            let place = &mut self.frames[usize::from(self.received) % N];
            if !driver.receive(place) {
                return;
            }
            if !place.is_foreign() {
                self.received = self.received.wrapping_add(1);
            }
        }
    }

    fn take(&mut self) -> Option<Frame> {
        if self.received == self.taken {
            return None;
        }
        let place = usize::from(self.taken) % N;
        self.taken = self.taken.wrapping_add(1);
        Some(self.frames[place])
    }
}

/// A [`Queue`] with a clock, from [`Queue::with_clock`]: what the main loop sees of it. It polls
/// the chip in each call, as [`WithClock`](crate::WithClock) does, and its errors are the same.
pub struct Queued<'q, C, INT, A, T, const N: usize> {
    queue: &'q Queue<C, INT, A, N>,
    now_ms: T,
    /// What has gone wrong, and was not returned yet.
    error: Option<CanError>,
}

impl<C: Instructions, INT: InputPin, A: Acceptance, T: FnMut() -> u16, const N: usize>
    Queued<'_, C, INT, A, T, N>
{
    /// Does the next step of start-up or supervision, if it is due.
    pub fn poll(&mut self) -> Option<Notice> {
        let now_ms = (self.now_ms)();
        let (notice, is_empty) = self.queue.with_driver(|driver| {
            let state = driver.state(now_ms);
            (state.is_due.then(|| driver.poll(now_ms)).flatten(), state.is_empty)
        })?;
        let notice = notice?;
        self.error = CanError::of(notice, is_empty).or(self.error);
        Some(notice)
    }

    /// The result of a call that cannot do its work.
    fn not_now<R>(&mut self) -> nb::Result<R, CanError> {
        Err(self.error.take().map_or(nb::Error::WouldBlock, nb::Error::Other))
    }
}

impl<C: Instructions, INT: InputPin, A: Acceptance, T: FnMut() -> u16, const N: usize>
    embedded_can::nb::Can for Queued<'_, C, INT, A, T, N>
{
    type Frame = Frame;
    type Error = CanError;

    fn transmit(&mut self, frame: &Frame) -> nb::Result<Option<Frame>, CanError> {
        self.poll();
        let is_accepted = self.queue.with_driver(|driver| {
            if driver.configuration().attempts == Attempts::Never {
                return Err(nb::Error::Other(CanError::ListensOnly));
            }
            driver.find_room();
            let has_room = driver.has_room();
            driver.transmit(frame);
            Ok(has_room)
        });
        if is_accepted.unwrap_or(Ok(false))? { Ok(None) } else { self.not_now() }
    }

    fn receive(&mut self) -> nb::Result<Frame, CanError> {
        self.poll();
        let taken = self.queue.access(|contents| {
            let oldest = contents.take();
            contents.receive();
            oldest.or_else(|| contents.take())
        });
        taken.map_or_else(|| self.not_now(), Ok)
    }
}
