//! Calls the method that the row of a table names: the action on a received transfer, the beginning
//! of a response, and the payload of a message.
//!
//! `group.method` in a row is a method of a group of [`Node`]'s fields, `method` one of `Node`.

use super::Node;
use super::control::Context;
use super::payloads::Filling;
use super::services::{Pending, Reply, Response};
use crate::hardware::CanCounters;
use crate::monitor::{Line, Monitor};
use crate::tables::Constants;
use crate::tables::kind::{Kind, for_received};
use crate::tables::publication::{Publication, for_published};
use crate::tables::wire::Transfer;

/// The calls for the rows of [`for_received`].
macro_rules! act {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $kind:ident = $space:ident $type:path, $form:ident $(($entry_len:literal, $most:literal))?,
            $behind:ident => $action:ident $(. $method:ident)? $(, $response:ident)?;)*
    })*) => {
        impl Node {
            /// Acts on a complete message. Returns the line to log, which is the reason of a
            /// refusal if it is refused.
            #[allow(unused_variables, reason = "only the tunnel needs the monitor")]
            #[inline(always)]
            pub(super) fn act(
                &mut self,
                message: &Transfer,
                now_ms: u16,
                monitor: &mut Monitor,
            ) -> Line {
                // Two searches: commands must not wait for those of the other messages.
                $($(#[cfg($if)] if Kind::$kind.is_command()
                    && message.kind as u8 == Kind::$kind as u8
                {
                    return act!(@$space (self, message, now_ms, monitor) $action $($method)?);
                })*)*
                $($(#[cfg($if)] if !Kind::$kind.is_request()
                    && !Kind::$kind.is_command()
                    && message.kind as u8 == Kind::$kind as u8
                {
                    return act!(@$space (self, message, now_ms, monitor) $action $($method)?);
                })*)*
                Line::NONE
            }

            /// Acts on a complete request. Returns the line to log, and what its response needs.
            #[allow(unused_variables, reason = "a build may have no request")]
            pub(super) fn act_on_request(
                &mut self,
                request: &Transfer,
                flash: impl Constants,
            ) -> Reply {
                $($($(#[cfg($if)] if request.kind as u8 == Kind::$kind as u8 {
                    const _: &str = stringify!($response);
                    return self.$action(request, flash);
                })?)*)*
                Reply::of(Line::NONE)
            }

            /// Begins the response to a request of this kind. Returns false if it has to wait.
            #[allow(unused_variables, reason = "a build may have no request")]
            pub(super) fn respond<C: CanCounters, P: Constants>(
                &mut self,
                request: &Pending,
                context: &mut Response<C, P>,
            ) -> bool {
                $($($(#[cfg($if)] if request.kind as u8 == Kind::$kind as u8 {
                    return self.$response(request, context);
                })?)*)*
                true
            }
        }
    };
    (@message ($node:ident, $message:ident, $now_ms:ident, $monitor:ident)
        $group:ident $method:ident) => {
        $node.$group.$method($message, &mut Context {
            now_ms: $now_ms,
            parameters: &$node.parameters,
            record: &mut $node.record,
            publisher: &mut $node.transmission.publisher,
            filters: &mut $node.filters,
        })
    };
    (@message ($node:ident, $message:ident, $now_ms:ident, $monitor:ident) $method:ident) => {
        $node.$method($message, $now_ms, $monitor)
    };
    (@request $values:tt $($method:ident)+) => { Line::NONE };
}

for_received!(act);

/// The calls for the rows of [`for_published`].
macro_rules! put {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $name:ident = $type:path, $form:ident, $len:expr, $when:expr $(, $needs:ident)?
            => $put:ident $(. $method:ident)?;)*
    })*) => {
        impl Node {
            /// Puts the payload of a message. Returns false if there is none to send now.
            #[inline(always)]
            pub(super) fn put<C: CanCounters>(
                &mut self,
                publication: Publication,
                counters: &C,
                now_ms: u16,
            ) -> bool {
                let mut filling = Filling {
                    outgoing: &mut self.transmission.outgoing,
                    parameters: &self.parameters,
                    counters,
                    now_ms,
                };
                $($(#[cfg($if)] if publication.place() == Publication::$name.place() {
                    return put!(@(self, filling, now_ms) $put $($method)?);
                })*)*
                false
            }
        }
    };
    (@($node:ident, $filling:ident, $now_ms:ident) $group:ident $method:ident) => {
        $node.$group.$method(&mut $filling)
    };
    (@($node:ident, $filling:ident, $now_ms:ident) $method:ident) => {
        $node.$method($now_ms)
    };
}

for_published!(put);
