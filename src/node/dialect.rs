//! Chooses the dialect of the node by DIALECT and the autopilot: DroneCAN v0, or with the feature
//! `draft` the UAVCAN draft of 2014 (docs/dialects.md).
//!
//! With DIALECT 0 one command or NodeStatus of v0 selects v0, at any time and from any node. The
//! node follows the draft only after [`V0_TIMEOUT_S`] without either. So no frame of the draft can
//! keep a v0 autopilot out.

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

    /// Time without a command or NodeStatus of v0 after which the node follows the draft, in
    /// seconds.
    const V0_TIMEOUT_S: u8 = 4;

    /// DIALECT: the node speaks v0 only.
    const V0: u8 = 1;
    /// DIALECT: the node speaks the draft only.
    const DRAFT: u8 = 2;

    /// The dialect that the node speaks.
    #[derive(Default)]
    pub struct Dialect {
        /// The value of DIALECT.
        wanted: u8,
        is_draft: bool,
        /// Seconds until the node may follow the draft.
        v0_s: u8,
    }

    impl Dialect {
        /// No message received yet.
        pub const fn new() -> Self {
            Self { wanted: 0, is_draft: false, v0_s: 0 }
        }

        /// Applies DIALECT.
        pub fn update(&mut self, parameters: &Parameters) {
            self.wanted = parameters.get(Parameter::Dialect) as u8;
            match self.wanted {
                V0 => self.is_draft = false,
                DRAFT => self.is_draft = true,
                _ => {}
            }
        }

        /// True if the node sends its messages in the draft.
        pub fn is_draft(&self) -> bool {
            self.is_draft
        }

        /// The set of filters for the CAN controller.
        pub fn row(&self) -> Row {
            match self.wanted {
                V0 => Row::V0,
                // A build with parameters over the bus must always receive v0, so that DIALECT can
                // be set again.
                DRAFT if cfg!(not(feature = "standard")) => Row::Thesis,
                _ => Row::Either,
            }
        }

        /// Reads a frame of either dialect. No frame is a transfer of both. v0 goes first, because
        /// its commands come more often.
        #[inline(always)]
        pub fn segment<'a>(&self, frame: &'a Frame, node: u8) -> Result<Segment<'a>, Rejection> {
            match wire::segment(frame, node) {
                Err(rejection) => match draft::segment(frame, node) {
                    Err(Rejection::Unknown) => Err(rejection),
                    result => result,
                },
                segment => segment,
            }
        }

        /// Data type ID and source of a frame of either dialect.
        #[inline(always)]
        pub fn origin(frame: &Frame) -> (u16, u8) {
            let id = Id::from_bytes(frame.id);
            draft::origin(frame).unwrap_or_else(|| (id.data_type(), id.source()))
        }

        /// Data type ID of a message, by its last frame.
        #[inline(always)]
        pub fn data_type(message: &Transfer, frame: &Frame) -> u16 {
            if Self::is_of_draft(message.priority) {
                draft::data_type(frame)
            } else {
                message.kind.id()
            }
        }

        /// True if a transfer with this priority field came in the draft.
        pub fn is_of_draft(priority: u8) -> bool {
            priority & draft::IS_DRAFT != 0
        }

        /// Takes note of a command or NodeStatus, in the draft or in v0. Returns true if the node
        /// follows it.
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

        /// Counts down the timeout. Call once a second.
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

    /// A node that speaks v0 only.
    #[derive(Default)]
    pub struct Dialect;

    impl Dialect {
        /// The only state.
        pub const fn new() -> Self {
            Self
        }

        /// Does nothing: there is no parameter DIALECT.
        pub fn update(&mut self, _parameters: &Parameters) {}

        /// False: the node sends its messages in v0.
        pub fn is_draft(&self) -> bool {
            false
        }

        /// The set of filters for the CAN controller.
        pub fn row(&self) -> Row {
            Row::V0
        }

        /// Reads a frame.
        #[inline(always)]
        pub fn segment<'a>(&self, frame: &'a Frame, node: u8) -> Result<Segment<'a>, Rejection> {
            wire::segment(frame, node)
        }

        /// Data type ID and source of a frame.
        #[inline(always)]
        pub fn origin(frame: &Frame) -> (u16, u8) {
            let id = Id::from_bytes(frame.id);
            (id.data_type(), id.source())
        }

        /// False: no transfer comes in the draft.
        pub fn is_of_draft(_priority: u8) -> bool {
            false
        }

        /// Returns true: the node follows every command and NodeStatus.
        pub fn hear(&mut self, _is_draft: bool) -> bool {
            true
        }

        /// Does nothing: there is no timeout.
        pub fn second(&mut self) {}
    }
}

#[cfg(all(test, feature = "draft"))]
mod tests {
    use super::*;
    use crate::golden;
    use crate::node::acceptance::Row;
    use crate::node::parameters::Parameter;
    use crate::node::{draft, wire};
    use dronecan_wire::Rejection;

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
            // The second message of v0 restarts the timeout.
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
                assert_eq!(
                    (dialect.hear(n % 3 == 0), dialect.is_draft()),
                    ((n % 3 == 0) == is_draft, is_draft)
                );
                dialect.second();
            }
        }
    }

    #[test]
    fn each_frame_of_the_draft_is_read_as_one_although_v0_goes_first() {
        let dialect = dialect(0);
        // No transfer has 16 frames, so the upper bits of the frame index are 0.
        for place in (0..1u32 << 17).filter(|place| place & 0x300 == 0) {
            for (upper, data) in [
                (0x084C, [1; 8]),
                (0x17C4, [2; 8]),
                (0x1134, [3; 8]),
                (0x113A, [120; 8]),
                (0x1182, [120; 8]),
            ] {
                let frame = golden::frame(upper << 16 | place, &data);
                for node in [0, 120] {
                    assert!(wire::segment(&frame, node).is_err(), "{frame:?} is one of v0, too");
                    let (either, draft) =
                        (dialect.segment(&frame, node), draft::segment(&frame, node));
                    assert!(either == draft || draft == Err(Rejection::Unknown), "{frame:?}");
                }
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
        assert_eq!(
            dialect.row(),
            if cfg!(feature = "standard") { Row::Either } else { Row::Thesis }
        );
        assert!(dialect.is_draft());
    }
}
