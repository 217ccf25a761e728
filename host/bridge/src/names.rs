//! Parameter names for MAVLink, which has 16 characters where DroneCAN has 92.
//!
//! A name that fits is not changed. A longer one becomes `HEAD~XXX~TAIL`: its first five
//! characters, three characters of a hash of the whole name, and its last six. So people recognise
//! it, and all short names differ. The short name depends on the name alone, so it is the same in
//! every session and on every computer. Only if the short names of two parameters of a node are
//! equal does the second in alphabetical order get another hash.
//!
//! Short names differ in more than upper and lower case, because some ground stations send all
//! names in upper case.

use std::collections::HashSet;

/// Characters of a MAVLink parameter's name.
pub const SHORT_LEN: usize = 16;

const HEAD_LEN: usize = 5;
const TAIL_LEN: usize = 6;
const MIDDLE_LEN: usize = 3;
const _: () = assert!(HEAD_LEN + 1 + MIDDLE_LEN + 1 + TAIL_LEN == SHORT_LEN);

/// 32 characters that are not easily confused.
const ALPHABET: &[u8; 32] = b"0123456789ABCDEFGHJKMNPQRSTVWXYZ";

/// The short name of each name of a node, in the same order.
pub fn shorten(names: &[Vec<u8>]) -> Vec<String> {
    let mut short = vec![String::new(); names.len()];
    let mut taken = HashSet::new();
    let mut rest = Vec::new();
    for (at, name) in names.iter().enumerate() {
        match fits(name) {
            Some(name) if taken.insert(name.to_ascii_uppercase()) => short[at] = name.to_owned(),
            _ => rest.push(at),
        }
    }
    // In alphabetical order, so that the order of the parameters does not matter.
    rest.sort_by_key(|at| &names[*at]);
    for at in rest {
        let mut candidates = (0..=u32::MAX).map(|attempt| candidate(&names[at], attempt));
        short[at] = candidates
            .find(|name| taken.insert(name.to_ascii_uppercase()))
            .expect("enough candidates");
    }
    short
}

/// The name as text if it can be used without a change.
fn fits(name: &[u8]) -> Option<&str> {
    let usable = (1..=SHORT_LEN).contains(&name.len()) && name.iter().all(u8::is_ascii_graphic);
    usable.then_some(name).and_then(|name| std::str::from_utf8(name).ok())
}

fn candidate(name: &[u8], attempt: u32) -> String {
    let printable = |byte: &u8| if byte.is_ascii_graphic() { char::from(*byte) } else { '_' };
    let head = name.iter().take(HEAD_LEN).map(printable);
    let tail = name.iter().skip(name.len().saturating_sub(TAIL_LEN)).map(printable);
    let mut hash = fnv1a(name, attempt);
    let middle = (0..MIDDLE_LEN).map(|_| {
        let digit = ALPHABET[(hash % 32) as usize];
        hash /= 32;
        char::from(digit)
    });
    head.chain(['~']).chain(middle).chain(['~']).chain(tail).collect()
}

/// FNV-1a, folded to the number of bits that the characters need.
fn fnv1a(name: &[u8], attempt: u32) -> u32 {
    let bytes = name.iter().copied().chain(attempt.to_le_bytes());
    let hash = bytes
        .fold(0x811C_9DC5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    hash >> 16 ^ hash
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;

    fn shortened(names: &[&str]) -> Vec<String> {
        shorten(&names.iter().map(|name| name.as_bytes().to_vec()).collect::<Vec<_>>())
    }

    #[test]
    fn names_that_fit_are_not_changed() {
        assert_eq!(
            shortened(&["OUT1_MIN", "a", "ABCDEFGHIJKLMNOP"]),
            ["OUT1_MIN", "a", "ABCDEFGHIJKLMNOP"]
        );
    }

    #[test]
    fn a_long_name_keeps_its_ends_and_always_has_the_same_short_name() {
        let alone = shortened(&["uavcan.equipment.esc.current_limit_max"]);
        assert_eq!(alone, ["uavca~KW5~it_max"]);
        let among = shortened(&[
            "OUT1_MIN",
            "uavcan.equipment.esc.current_limit_min",
            "uavcan.equipment.esc.current_limit_max",
        ]);
        assert_eq!(among[2], alone[0]);
        assert_ne!(among[1], alone[0]);
    }

    #[test]
    fn the_order_of_the_parameters_does_not_matter() {
        let names: Vec<String> =
            (0..3000).map(|n| format!("motor_controller_{n:04}_limit")).collect();
        let forward: Vec<Vec<u8>> = names.iter().map(|name| name.clone().into_bytes()).collect();
        let backward: Vec<Vec<u8>> = forward.iter().rev().cloned().collect();
        let mut turned = shorten(&backward);
        turned.reverse();
        assert_eq!(shorten(&forward), turned);
    }

    #[test]
    fn a_name_equal_to_a_shortened_one_is_kept_and_the_long_name_changes() {
        let long = "uavcan.equipment.esc.current_limit_max";
        let names = shortened(&[long, "uavca~KW5~it_max"]);
        assert_eq!(names[1], "uavca~KW5~it_max");
        assert_ne!(names[0], names[1]);
    }

    #[test]
    fn names_that_differ_only_in_case_get_different_short_names() {
        let names = shortened(&["limit", "LIMIT"]);
        assert_eq!(names[0], "limit");
        assert!(!names[1].eq_ignore_ascii_case("limit"), "{names:?}");
    }

    proptest! {
        #[test]
        fn any_names_get_different_short_names_that_fit(
            names in vec(vec(any::<u8>(), 1..92), 0..60),
        ) {
            let short = shorten(&names);
            let different: HashSet<String> =
                short.iter().map(|name| name.to_ascii_uppercase()).collect();
            prop_assert_eq!(different.len(), names.len());
            for name in short {
                prop_assert!((1..=SHORT_LEN).contains(&name.len()));
                prop_assert!(name.bytes().all(|b| b.is_ascii_graphic()));
            }
        }
    }
}
