//! Which of two senders gets a lane.

use super::*;

/// That of a board for 1 Mbit/s.
const HOLD_MS: u16 = 4;

const A: u32 = 10;
const B: u32 = 110;

/// A list of two frames of the sender.
fn list(source: u32) -> [Frame; 2] {
    two(source, 1, 7)
}

/// A rig in which these senders are trusted: each has completed a list.
fn rig(trusted: &[u32]) -> Rig {
    let mut rig = Rig::new();
    for &source in trusted {
        assert!(rig.all(&list(source)).is_some());
    }
    rig
}

/// `owner` begins a list, and `newcomer` another. Returns whose is completed.
fn who_completes(rig: &mut Rig, owner: u32, newcomer: u32) -> u32 {
    assert_eq!(rig.rejects(&list(owner)[0]), None);
    assert_eq!(rig.rejects(&list(newcomer)[0]), Some(Rejection::Interleaved));
    let second = rig.frame(&list(newcomer)[1]);
    assert_eq!(rig.rejection, None, "a lost transfer is reported once");
    let first = rig.frame(&list(owner)[1]);
    assert_eq!(rig.rejection, None, "a lost transfer is reported once");
    match (first, second) {
        (Some(_), None) => owner,
        (None, Some(_)) => newcomer,
        both => panic!("{both:?}"),
    }
}

impl Rig {
    /// Lets a sender complete a list in an order in which one that lost the trust is trusted again.
    fn trust(&mut self, source: u32) {
        self.now_ms = self.now_ms.next_multiple_of(4 * ORDER_MS);
        assert!(self.all(&list(source)).is_some());
    }

    /// Waits until `first` has precedence over `second` for as long as a lane is held.
    fn let_precede(&mut self, first: u32, second: u32) {
        let precedes = |now_ms| place(first as u8, now_ms) > place(second as u8, now_ms);
        let holds = |&ms: &u16| (0..=HOLD_MS).all(|more| precedes(ms + more));
        self.now_ms = (self.now_ms..).find(holds).unwrap();
    }
}

/// A name, and what makes a node lose its trust.
type Loss = (&'static str, fn(&mut Rig));

/// Each node ID has a bit of its own.
#[test]
fn no_sender_is_trusted_because_another_is() {
    for trusted in 1..=127 {
        for other in (0..7).map(|bit| trusted ^ 1 << bit) {
            if ![0, ME].contains(&(trusted as u8)) && ![0, ME].contains(&(other as u8)) {
                assert_eq!(who_completes(&mut rig(&[trusted]), other, trusted), trusted);
            }
        }
    }
}

#[test]
fn a_sender_that_loses_a_transfer_is_trusted_no_longer_until_it_completes_one() {
    let losses: [Loss; 4] = [
        ("expired", |rig| {
            rig.frame(&list(A)[0]);
            rig.now_ms += 51;
            assert!(rig.receiver.expire(rig.now_ms).is_some());
        }),
        ("begun again", |rig| {
            rig.frame(&list(A)[0]);
            assert_eq!(rig.rejects(&list(A)[0]), Some(Rejection::Broken));
            // The transfer that replaces it is not trusted, either.
            assert!(rig.all(&list(B)).is_some());
        }),
        ("wrong CRC", |rig| {
            let mut frames = list(A);
            frames[1].data[0] ^= 1;
            assert_eq!((rig.all(&frames), rig.rejection), (None, Some(Rejection::Broken)));
        }),
        ("displaced", |rig| {
            rig.frame(&list(A)[0]);
            rig.now_ms += HOLD_MS;
            assert!(rig.all(&list(B)).is_some());
        }),
    ];
    for (name, lose) in losses {
        let mut rig = rig(&[A, B]);
        lose(&mut rig);
        rig.let_precede(A, B);
        assert_eq!(who_completes(&mut rig, A, B), B, "{name}");
        rig.trust(A);
        rig.let_precede(A, B);
        assert_eq!(who_completes(&mut rig, A, B), A, "{name}, then complete");
    }
}

#[test]
fn who_lost_the_trust_is_trusted_again_in_one_order_of_four() {
    // Nodes 10 and 14 have their bits in one byte, 10 and 26 in one place.
    for (loser, other) in [(A, B), (A, 14), (A, 26)] {
        for now_ms in 0..=u16::MAX {
            let mut rig = Rig::new();
            rig.now_ms = now_ms;
            let is_trusted =
                |rig: &Rig, source: u32| rig.receiver.policy().is_trusted(source as u8);
            assert!(rig.all(&list(loser)).is_some());
            assert!(is_trusted(&rig, loser), "at first, {now_ms} ms");
            rig.frame(&list(loser)[0]);
            rig.frame(&list(loser)[0]);
            assert!(!is_trusted(&rig, loser));
            assert!(rig.frame(&list(loser)[1]).is_some());
            let again = (now_ms / ORDER_MS).is_multiple_of(4);
            assert_eq!(is_trusted(&rig, loser), again, "{now_ms} ms");
            assert!(rig.all(&list(other)).is_some());
            // Of 16 IDs in a row all wait, if one of them lost it.
            let waits = loser / 16 == other / 16 && !again;
            assert_eq!(is_trusted(&rig, other), !waits, "{other}, {now_ms} ms");
        }
    }
}
