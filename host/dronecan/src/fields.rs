//! Payloads whose fields follow each other, each with a number of bits: from the most significant
//! bit of a byte, and the lowest byte of a field first ([`bits`](crate::bits)).

use crate::NodeId;
use crate::bits::{Reader, Writer};
use half::f16;

/// The value of a field.
pub trait Field: Sized {
    /// Its bits, if the payload does not say another number; of a list, its elements at most.
    const BITS: u32;

    /// Reads it; `None` if the bits are not there, or are no such value.
    fn take(from: &mut Reader<'_>, bits: u32) -> Option<Self>;

    /// Writes it.
    fn put(&self, to: &mut Writer, bits: u32);
}

macro_rules! integers {
    ($($integer:ident)*) => {
        $(impl Field for $integer {
            const BITS: u32 = $integer::BITS;

            fn take(from: &mut Reader<'_>, bits: u32) -> Option<$integer> {
                // Of a signed one the highest bit is the sign.
                let unused = $integer::BITS - bits;
                Some((from.take(bits)? as $integer) << unused >> unused)
            }

            fn put(&self, to: &mut Writer, bits: u32) {
                to.put(*self as u64, bits);
            }
        })*
    };
}
integers!(u8 u16 u32 u64 i8 i16);

/// Fields that are a number on the wire, with the functions from it and to it.
macro_rules! as_number {
    ($($type:ty: $number:ty, $of:expr, $into:expr;)*) => {
        $(impl $crate::fields::Field for $type {
            const BITS: u32 = <$number>::BITS;

            fn take(from: &mut $crate::bits::Reader<'_>, bits: u32) -> Option<$type> {
                let of: fn($number) -> Option<$type> = $of;
                of($crate::fields::Field::take(from, bits)?)
            }

            fn put(&self, to: &mut $crate::bits::Writer, bits: u32) {
                let into: fn($type) -> $number = $into;
                into(*self).put(to, bits);
            }
        })*
    };
}
pub(crate) use as_number;

as_number! {
    f16: u16, |bits| Some(f16::from_bits(bits)), f16::to_bits;
    f32: u32, |bits| Some(f32::from_bits(bits)), f32::to_bits;
    bool: u8, |bit| Some(bit != 0), u8::from;
    NodeId: u8, NodeId::new, NodeId::get;
}

/// A list is the last field, and has no length then.
impl<T: Field> Field for Vec<T> {
    const BITS: u32 = u32::MAX;

    fn take(from: &mut Reader<'_>, most: u32) -> Option<Vec<T>> {
        let mut list = Vec::new();
        while !from.is_empty() {
            list.push(T::take(from, T::BITS)?);
        }
        (list.len() <= most as usize).then_some(list)
    }

    fn put(&self, to: &mut Writer, _most: u32) {
        self.iter().for_each(|element| element.put(to, T::BITS));
    }
}

/// The fields of a whole payload.
pub(crate) fn decode<T: Field>(payload: &[u8], bits: u32) -> Option<T> {
    let mut from = Reader::new(payload);
    let fields = T::take(&mut from, bits)?;
    from.is_empty().then_some(fields)
}

/// The payload of fields.
pub(crate) fn encode<T: Field>(fields: &T) -> Vec<u8> {
    let mut to = Writer::default();
    fields.put(&mut to, T::BITS);
    to.into_bytes()
}

/// A payload, as a structure. `as` gives the bits of a field, or the elements of the list at the
/// end; bits without a meaning are `void`. With `[most]` the payload is a list of such structures.
macro_rules! payload {
    ($(#[$doc:meta])* pub struct $name:ident $([$most:literal])? {
        $($(void $void:literal,)? $(#[$about:meta])* pub $field:ident: $type:ty $(as $bits:expr)?,)*
    }) => {
        $(#[$doc])*
        pub struct $name {
            $($(#[$about])* pub $field: $type,)*
        }

        impl $crate::fields::Field for $name {
            const BITS: u32 = 0;

            fn take(from: &mut $crate::bits::Reader<'_>, _: u32) -> Option<$name> {
                use $crate::fields::Field;
                $(
                    $(from.take($void)?;)?
                    let $field = <$type>::take(from, [$($bits,)? <$type as Field>::BITS][0])?;
                )*
                Some($name { $($field),* })
            }

            fn put(&self, to: &mut $crate::bits::Writer, _: u32) {
                use $crate::fields::Field;
                $(
                    $(to.put(0, $void);)?
                    self.$field.put(to, [$($bits,)? <$type as Field>::BITS][0]);
                )*
            }
        }

        $crate::fields::payload!(@functions $name $($most)?);
    };
    (@functions $name:ident) => {
        impl $name {
            /// `None` unless the payload has these fields and no more.
            pub fn decode(payload: &[u8]) -> Option<$name> {
                $crate::fields::decode(payload, 0)
            }

            /// The payload.
            pub fn encode(&self) -> Vec<u8> {
                $crate::fields::encode(self)
            }
        }
    };
    (@functions $name:ident $most:literal) => {
        impl $name {
            /// The list in a payload; `None` unless it has complete ones, and not too many.
            pub fn decode_array(payload: &[u8]) -> Option<Vec<$name>> {
                $crate::fields::decode(payload, $most)
            }

            /// The payload with a list.
            pub fn encode_array(list: &[$name]) -> Vec<u8> {
                list.iter().flat_map($crate::fields::encode).collect()
            }
        }
    };
}
pub(crate) use payload;
