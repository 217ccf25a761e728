//! Which dialect the node speaks: DroneCAN v0, or with the feature `draft` the UAVCAN draft of 2014, as DIALECT and the autopilot have it
//! (docs/dialects.md).
//!
//! With DIALECT 0 the node speaks v0 as long as anybody does: one message of v0 is enough, at any time. It follows the draft once v0 has been
//! silent for [`V0_TIMEOUT_S`]; so no frame of the draft can keep a v0 autopilot out.

#[cfg(feature = "draft")]
pub use two::Dialect;

#[cfg(not(feature = "draft"))]
pub use one::Dialect;

#[cfg(feature = "draft")]
mod two {
    use crate::node::acceptance::Row;
    use crate::node::draft;
    use crate::node::parameters::{Parameter, Parameters};
    use crate::node::wire::{self, Segment, Transfer};
    use dronecan_wire::{Id, Rejection};
    use mcp2515_ordered::Frame;

    /// In the course of so many seconds without a message of v0 nobody speaks it.
    const V0_TIMEOUT_S: u8 = 4;

    /// DIALECT: what the node speaks.
    const V0: u8 = 1;
    /// See [`V0`].
    const DRAFT: u8 = 2;

    /// Which dialect the node speaks.
    #[derive(Default)]
    pub struct Dialect {
        /// DIALECT.
        wanted: u8,
        is_draft: bool,
        /// Seconds until nobody speaks v0.
        v0_s: u8,
    }

    impl Dialect {
        /// Nobody has spoken.
        pub const fn new() -> Self {
            Self { wanted: 0, is_draft: false, v0_s: 0 }
        }

        /// Takes over DIALECT.
        pub fn update(&mut self, parameters: &Parameters) {
            self.wanted = parameters.get(Parameter::Dialect) as u8;
            match self.wanted {
                V0 => self.is_draft = false,
                DRAFT => self.is_draft = true,
                _ => {}
            }
        }

        /// The node sends its messages in the draft.
        pub fn is_draft(&self) -> bool {
            self.is_draft
        }

        /// What the controller is to let through.
        pub fn row(&self) -> Row {
            match self.wanted {
                V0 => Row::V0,
                // Only a build whose parameters cannot be set over the bus may be deaf to v0.
                DRAFT if cfg!(not(feature = "standard")) => Row::Thesis,
                _ => Row::Either,
            }
        }

        /// Reads a frame, in whichever dialect it is.
        #[inline(always)]
        pub fn segment<'a>(&self, frame: &'a Frame, node: u8) -> Result<Segment<'a>, Rejection> {
            match draft::segment(frame, node) {
                Err(Rejection::Unknown) => wire::segment(frame, node),
                result => result,
            }
        }

        /// Data type ID and sender of a frame, in whichever dialect it is.
        #[inline(always)]
        pub fn origin(frame: &Frame) -> (u16, u8) {
            let id = Id::from_bytes(frame.id);
            draft::origin(frame).unwrap_or_else(|| (id.data_type(), id.source()))
        }

        /// Data type ID of a message whose last frame this is.
        #[inline(always)]
        pub fn data_type(message: &Transfer, frame: &Frame) -> u16 {
            if Self::is_of_draft(message.priority) { draft::data_type(frame) } else { message.kind.id() }
        }

        /// Whether a transfer came in the draft.
        pub fn is_of_draft(priority: u8) -> bool {
            priority & draft::IS_DRAFT != 0
        }

        /// An autopilot's message came, in the draft or in v0. Whether the node follows it.
        #[inline(always)]
        pub fn hear(&mut self, is_draft: bool) -> bool {
            match self.wanted {
                V0 => return !is_draft,
                DRAFT => return is_draft,
                _ => {}
            }
            if !is_draft {
                self.v0_s = V0_TIMEOUT_S;
                self.is_draft = false;
            } else if self.v0_s == 0 {
                self.is_draft = true;
            }
            is_draft == self.is_draft
        }

        /// To be called once a second.
        pub fn second(&mut self) {
            self.v0_s = self.v0_s.saturating_sub(1);
        }
    }
}

#[cfg(not(feature = "draft"))]
mod one {
    use crate::node::acceptance::Row;
    use crate::node::parameters::Parameters;
    use crate::node::wire::{self, Segment};
    use dronecan_wire::{Id, Rejection};
    use mcp2515_ordered::Frame;

    /// It is v0.
    #[derive(Default)]
    pub struct Dialect;

    impl Dialect {
        /// Always the same.
        pub const fn new() -> Self {
            Self
        }

        /// There is no choice.
        pub fn update(&mut self, _parameters: &Parameters) {}

        /// The node sends its messages in v0.
        pub fn is_draft(&self) -> bool {
            false
        }

        /// What the controller is to let through.
        pub fn row(&self) -> Row {
            Row::V0
        }

        /// Reads a frame.
        #[inline(always)]
        pub fn segment<'a>(&self, frame: &'a Frame, node: u8) -> Result<Segment<'a>, Rejection> {
            wire::segment(frame, node)
        }

        /// Data type ID and sender of a frame.
        #[inline(always)]
        pub fn origin(frame: &Frame) -> (u16, u8) {
            let id = Id::from_bytes(frame.id);
            (id.data_type(), id.source())
        }

        /// No transfer comes in the draft.
        pub fn is_of_draft(_priority: u8) -> bool {
            false
        }

        /// An autopilot's message came, and is followed.
        pub fn hear(&mut self, _is_draft: bool) -> bool {
            true
        }

        /// Nothing to do.
        pub fn second(&mut self) {}
    }
}

#[cfg(all(test, feature = "draft"))]
mod tests {
    use super::*;
    use crate::golden;
    use crate::node::acceptance::Row;
    use crate::node::parameters::Parameter;

    fn dialect(wanted: i32) -> Dialect {
        let mut dialect = Dialect::new();
        dialect.update(&golden::parameters(&[(Parameter::Dialect, wanted)]));
        dialect
    }

    #[test]
    fn with_dialect_0_v0_is_followed_at_any_time() {
        let mut dialect = dialect(0);
        for _ in 0..3 {
            assert!(dialect.hear(true) && dialect.is_draft(), "nobody speaks v0");
            assert!(dialect.hear(false) && !dialect.is_draft());
            for _ in 0..10 {
                dialect.second();
            }
        }
    }

    #[test]
    fn with_dialect_0_the_draft_is_followed_after_the_fourth_second_without_v0() {
        for seconds in 0..10 {
            let mut dialect = dialect(0);
            // What came before does not count.
            dialect.hear(false);
            dialect.second();
            dialect.hear(false);
            for _ in 0..seconds {
                assert!(!dialect.is_draft());
                dialect.second();
            }
            assert_eq!(dialect.hear(true), seconds >= 4, "{seconds}");
            assert_eq!(dialect.is_draft(), seconds >= 4, "{seconds}");
        }
    }

    #[test]
    fn with_dialect_1_or_2_it_is_that_one_whatever_is_heard() {
        for (wanted, is_draft) in [(1, false), (2, true)] {
            let mut dialect = dialect(wanted);
            for n in 0..100 {
                assert_eq!((dialect.hear(n % 3 == 0), dialect.is_draft()), ((n % 3 == 0) == is_draft, is_draft));
                dialect.second();
            }
        }
    }

    #[test]
    fn another_dialect_has_another_row() {
        let mut dialect = dialect(1);
        assert_eq!(dialect.row(), Row::V0);
        dialect.update(&golden::parameters(&[(Parameter::Dialect, 0)]));
        assert_eq!(dialect.row(), Row::Either);
        dialect.update(&golden::parameters(&[(Parameter::Dialect, 2)]));
        assert_eq!(dialect.row(), if cfg!(feature = "standard") { Row::Either } else { Row::Thesis });
        assert!(dialect.is_draft());
    }
}
