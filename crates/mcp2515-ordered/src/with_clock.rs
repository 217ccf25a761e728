//! The driver with a clock, for the blocking and the non-blocking trait of `embedded-can`.

use embedded_can::{ErrorKind, blocking};
use embedded_hal::digital::InputPin;

use crate::any_frame::AnyFrame;
use crate::chip::Instructions;
use crate::configuration::Attempts;
use crate::driver::{Driver, ErrorFlags, Event, Notice};
use crate::filters::Acceptance;

/// A driver with a clock, from [`Driver::with_clock`]. It implements [`embedded_can::nb::Can`] and
/// [`embedded_can::blocking::Can`], and polls the chip in each call.
///
/// * Call it at least every 100 ms, or [`poll`](Self::poll), so that the chip is supervised.
/// * Frames are sent in the order of the calls. [`transmit`](embedded_can::nb::Can::transmit)
///   never returns a frame that it replaced.
/// * A call that cannot do its work returns what has gone wrong since the last error. The driver
///   recovers by itself, so the caller may try again.
///
/// ```
/// use embedded_can::{Frame, StandardId, blocking::Can};
///
/// fn send_twice<C: Can>(can: &mut C) -> Result<(), C::Error> {
///     let frame = C::Frame::new(StandardId::MAX, &[1, 2, 3]).unwrap();
///     can.transmit(&frame)?;
///     can.transmit(&frame)
/// }
/// # use embedded_hal::{digital::InputPin, spi::SpiDevice};
/// # use mcp2515_ordered::{Attempts, BitTiming, CanError, Configuration, Filters, SharedMcp2515};
/// # fn main_loop(
/// #     device: impl SpiDevice,
/// #     int: impl InputPin,
/// #     now_ms: fn() -> u16,
/// # ) -> Result<(), CanError> {
///
/// let mut can = SharedMcp2515::new(device, int, Configuration {
///     timing: const { BitTiming::new(16_000_000, 500_000) },
///     acceptance: Filters::ALL,
///     attempts: Attempts::UntilSent,
/// })
/// .with_clock(now_ms);
/// send_twice(&mut can)
/// # }
/// ```
pub struct WithClock<C, INT, A, T> {
    driver: Driver<C, INT, A>,
    now_ms: T,
    /// What has gone wrong, and was not returned yet.
    error: Option<CanError>,
}

/// Why a frame could not be sent, or none received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CanError {
    /// The driver reported this.
    Notice(Notice),
    /// The chip only listens: see [`Attempts::Never`].
    ListensOnly,
}

impl CanError {
    /// Returns the error, if the notice is of one. `is_empty`: no frame waited to be sent.
    pub(crate) fn of(notice: Notice, is_empty: bool) -> Option<Self> {
        let is_error = match notice.event {
            Event::Running => false,
            Event::Flags => {
                let flags = ErrorFlags(notice.value);
                flags.frames_lost() || flags.bus_off()
            }
            // Without a frame that waits, the bus is silent.
            Event::GaveUpSending => !is_empty,
            _ => true,
        };
        is_error.then_some(Self::Notice(notice))
    }
}

impl embedded_can::Error for CanError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Notice(Notice { event: Event::Flags, value })
                if ErrorFlags(*value).frames_lost() =>
            {
                ErrorKind::Overrun
            }
            Self::Notice(Notice { event: Event::GaveUpSending, .. }) => ErrorKind::Acknowledge,
            Self::Notice(_) | Self::ListensOnly => ErrorKind::Other,
        }
    }
}

impl<C: Instructions, INT: InputPin, A: Acceptance> Driver<C, INT, A> {
    /// Adds a clock, for the traits of [`embedded_can`]. `now_ms` returns the time in milliseconds,
    /// which wraps around.
    pub const fn with_clock<T: FnMut() -> u16>(self, now_ms: T) -> WithClock<C, INT, A, T> {
        WithClock { driver: self, now_ms, error: None }
    }
}

impl<C, INT, A, T> WithClock<C, INT, A, T> {
    /// The driver.
    pub fn driver(&mut self) -> &mut Driver<C, INT, A> {
        &mut self.driver
    }
}

impl<C: Instructions, INT: InputPin, A: Acceptance, T: FnMut() -> u16> WithClock<C, INT, A, T> {
    /// Does the next step of start-up or supervision, if it is due.
    pub fn poll(&mut self) -> Option<Notice> {
        let now_ms = (self.now_ms)();
        let state = self.driver.state(now_ms);
        let notice = state.is_due.then(|| self.driver.poll(now_ms))??;
        self.error = CanError::of(notice, state.is_empty).or(self.error);
        Some(notice)
    }

    /// The result of a call that cannot do its work.
    fn not_now<R>(&mut self) -> nb::Result<R, CanError> {
        Err(self.error.take().map_or(nb::Error::WouldBlock, nb::Error::Other))
    }
}

impl<C: Instructions, INT: InputPin, A: Acceptance, T: FnMut() -> u16> embedded_can::nb::Can
    for WithClock<C, INT, A, T>
{
    type Frame = AnyFrame;
    type Error = CanError;

    fn transmit(&mut self, frame: &AnyFrame) -> nb::Result<Option<AnyFrame>, CanError> {
        self.poll();
        if self.driver.configuration().attempts == Attempts::Never {
            return Err(nb::Error::Other(CanError::ListensOnly));
        }
        self.driver.find_room();
        if !self.driver.has_room() {
            return self.not_now();
        }
        self.driver.transmit_any(frame);
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<AnyFrame, CanError> {
        self.poll();
        let received = self.driver.has_frame().then(|| self.driver.receive_any()).flatten();
        received.map_or_else(|| self.not_now(), Ok)
    }
}

impl<C: Instructions, INT: InputPin, A: Acceptance, T: FnMut() -> u16> blocking::Can
    for WithClock<C, INT, A, T>
{
    type Frame = AnyFrame;
    type Error = CanError;

    /// Waits until the chip has room for the frame.
    fn transmit(&mut self, frame: &AnyFrame) -> Result<(), CanError> {
        nb::block!(embedded_can::nb::Can::transmit(self, frame)).map(drop)
    }

    /// Waits for a frame.
    fn receive(&mut self) -> Result<AnyFrame, CanError> {
        nb::block!(embedded_can::nb::Can::receive(self))
    }
}
