//! Which method of [`Node`] acts on a received transfer, and which begins the response: as the rows
//! of the table of [`kind`](crate::tables::kind) say.

use super::Node;
use super::receive::Context;
use super::services::{Pending, Reply, Response};
use crate::hardware::CanCounters;
use crate::monitor::Line;
use crate::tables::Constants;
use crate::tables::kind::{Kind, for_received};
use crate::tables::publication::{Publication, for_published};
use crate::tables::wire::Transfer;

macro_rules! dispatch {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $kind:ident = $space:ident $type:path, $form:ident $(($entry_len:literal, $most:literal))?,
            $behind:ident => $($action:ident),+;)*
    })*) => {
        impl Node {
            /// Acts on a complete transfer of this node. Returns the line to log, which is the
            /// reason of a refusal if it is refused.
            #[inline(always)]
            pub(super) fn act<P: Constants>(
                &mut self,
                transfer: &Transfer,
                context: &mut Context<P>,
            ) -> Line {
                // Two searches: commands must not wait for those of the other messages.
                $($(#[cfg($if)] if Kind::$kind.is_command()
                    && transfer.kind as u8 == Kind::$kind as u8
                {
                    return dispatch!(@message $space ($($action),+)(self, transfer, context));
                })*)*
                $($(#[cfg($if)] if !Kind::$kind.is_request()
                    && !Kind::$kind.is_command()
                    && transfer.kind as u8 == Kind::$kind as u8
                {
                    return dispatch!(@message $space ($($action),+)(self, transfer, context));
                })*)*
                Line::NONE
            }

            /// Acts on a complete request. Returns the line to log, and what its response needs.
            #[inline(always)]
            #[allow(unused_variables, reason = "a build may have no request")]
            pub(super) fn act_on_request<P: Constants>(
                &mut self,
                transfer: &Transfer,
                context: &mut Context<P>,
            ) -> Reply {
                $($(#[cfg($if)] if Kind::$kind.is_request()
                    && transfer.kind as u8 == Kind::$kind as u8
                {
                    return dispatch!(@request $space ($($action),+)(self, transfer, context));
                })*)*
                Reply::of(Line::NONE)
            }

            /// Begins the response to a request of this kind. Returns false if it has to wait.
            #[inline(always)]
            #[allow(unused_variables, reason = "a build may have no request")]
            pub(super) fn respond<C: CanCounters, P: Constants>(
                &mut self,
                request: &Pending,
                context: &mut Response<C, P>,
            ) -> bool {
                $($(#[cfg($if)] if Kind::$kind.is_request()
                    && request.kind as u8 == Kind::$kind as u8
                {
                    return dispatch!(@last ($($action),+)(self, request, context));
                })*)*
                true
            }
        }
    };
    (@message message ($method:ident)($($value:ident),*)) => { Node::$method($($value),*) };
    (@message request $methods:tt $values:tt) => { Line::NONE };
    (@request request ($method:ident, $other:ident)($($value:ident),*)) => {
        Node::$method($($value),*)
    };
    (@request message $methods:tt $values:tt) => { Reply::of(Line::NONE) };
    (@last ($method:ident)($($value:ident),*)) => { true };
    (@last ($other:ident, $method:ident)($($value:ident),*)) => { Node::$method($($value),*) };
}

for_received!(dispatch);

macro_rules! payloads {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $name:ident = $type:path, $form:ident, $len:expr, $when:expr $(, $needs:ident)?
            => $put:ident;)*
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
                $($(#[cfg($if)] if publication.place() == Publication::$name.place() {
                    return self.$put(counters, now_ms);
                })*)*
                false
            }
        }
    };
}

for_published!(payloads);
