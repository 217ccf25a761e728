//! Saves and loads, with power cuts and worn cells.

use super::*;
use crate::image::InMemory;
use crate::tables::parameters::{COUNT, Parameter};

/// An EEPROM whose supply can be cut.
#[derive(Clone)]
struct Model {
    cells: [u8; EEPROM_LEN],
    writing: Option<(Address, u8)>,
    /// Calls of `is_busy` until the byte is written.
    busy: std::cell::Cell<u8>,
    writes: u32,
    /// Address of a worn-out cell, which keeps its value.
    stuck: Option<Address>,
}

impl Model {
    fn with(cells: [u8; EEPROM_LEN]) -> Self {
        Self { cells, writing: None, busy: 0.into(), writes: 0, stuck: None }
    }

    fn blank() -> Self {
        Self::with([0xFF; EEPROM_LEN])
    }

    fn settle(&mut self) {
        if let Some((at, byte)) = self.writing.take()
            && self.stuck != Some(at)
        {
            self.cells[usize::from(at)] = byte;
        }
        self.busy.set(0);
    }
}

impl Eeprom for Model {
    fn read(&self, at: Address) -> u8 {
        assert_eq!(self.busy.get(), 0, "read while a byte is being written");
        match self.writing {
            Some((writing, byte)) if writing == at && self.stuck != Some(at) => byte,
            _ => self.cells[usize::from(at)],
        }
    }

    fn is_busy(&self) -> bool {
        self.busy.set(self.busy.get().saturating_sub(1));
        self.busy.get() != 0
    }

    fn begin_write(&mut self, at: Address, byte: u8) {
        assert_eq!(self.busy.get(), 0, "write while a byte is being written");
        self.settle();
        self.writing = Some((at, byte));
        self.busy.set(3);
        self.writes += 1;
    }
}

/// The store and the parameters after a start with this EEPROM, and true if parameters were
/// lost.
fn loaded(eeprom: &Model) -> (Store, Parameters, bool) {
    let (mut store, mut parameters) = (Store::new(), Parameters::new());
    let is_lost = store.load(&mut parameters, eeprom, InMemory);
    (store, parameters, is_lost)
}

fn defaults() -> Parameters {
    loaded(&Model::blank()).1
}

/// A set of parameters that depends on `number` in every value whose range allows it.
fn set(number: u16) -> Parameters {
    let mut parameters = defaults();
    for index in 0..COUNT as u8 {
        for value in [number, number + 1000] {
            parameters.set(index, value.into(), InMemory);
        }
    }
    parameters
}

/// Saves, and cuts the supply during the write after the first `writes`. Returns false if the
/// save ended before.
fn save_and_cut(
    store: &mut Store,
    parameters: &mut Parameters,
    eeprom: &mut Model,
    writes: u32,
) -> bool {
    eeprom.writes = 0;
    store.save();
    while store.is_saving() {
        store.step(parameters, eeprom);
        if eeprom.writes > writes {
            return true;
        }
    }
    false
}

fn save(store: &mut Store, parameters: &mut Parameters, eeprom: &mut Model) -> bool {
    save_and_cut(store, parameters, eeprom, u32::MAX);
    eeprom.settle();
    store.is_saved()
}

/// An EEPROM after this many saves, and the parameters saved last.
fn after_saves(saves: u16) -> (Model, Parameters) {
    let mut eeprom = Model::blank();
    let (mut store, mut parameters, _) = loaded(&eeprom);
    for number in 0..saves {
        parameters = set(number);
        assert!(save(&mut store, &mut parameters, &mut eeprom));
    }
    (eeprom, parameters)
}

#[test]
fn the_last_save_is_loaded_after_any_number_of_saves() {
    for saves in 1..20 {
        let (eeprom, saved) = after_saves(saves);
        let (_, parameters, is_lost) = loaded(&eeprom);
        assert_eq!((parameters, is_lost), (saved, false), "{saves} saves");
    }
}

/// Verifies the layout: cuts a save at every byte, with every value in the byte that was being
/// written, for both copies and all markers, and for an EEPROM without a save.
#[test]
fn a_power_cut_at_any_byte_of_a_save_leaves_the_old_or_the_new_parameters() {
    let mut cuts = 0;
    for saves in 0..10 {
        let (start, old) = after_saves(saves);
        let new = set(200);
        let (mut kept_old, mut kept_new) = (0, 0);
        for writes in 0.. {
            let (mut store, _, _) = loaded(&start);
            let mut eeprom = start.clone();
            if !save_and_cut(&mut store, &mut new.clone(), &mut eeprom, writes) {
                break;
            }
            let (at, _) = eeprom.writing.unwrap();
            for garbage in 0..=255 {
                let mut cells = eeprom.cells;
                cells[usize::from(at)] = garbage;
                let after = Model::with(cells);
                let (mut store, mut parameters, is_lost) = loaded(&after);
                cuts += 1;
                assert!(
                    parameters == old || parameters == new,
                    "{saves} saves, {writes} writes, {garbage:#x}"
                );
                kept_old += u32::from(parameters == old);
                kept_new += u32::from(parameters == new);
                // A cut of the very first save loses parameters, unless it is cut before the
                // first byte of the record or at its end.
                let has_begun = after.cells[usize::from(PARAMETERS[0])] != 0xFF;
                // Garbage in the marker looks like a copy that was complete.
                let is_marker =
                    PARAMETERS.contains(&at.wrapping_sub(MARKER.into())) && garbage != NO_RECORD;
                if !is_marker {
                    let is_first = saves == 0 && parameters == old && has_begun;
                    assert_eq!(is_lost, is_first, "{writes} writes, {garbage:#x}");
                }
                // The next save succeeds.
                if garbage % 51 == 0 {
                    let mut eeprom = after;
                    parameters = set(300);
                    assert!(save(&mut store, &mut parameters, &mut eeprom));
                    assert_eq!(loaded(&eeprom).1, parameters);
                }
            }
        }
        assert!(
            kept_old > 5_000 && kept_new == 1,
            "only the last byte makes it new: {kept_old} {kept_new}"
        );
    }
    assert!(cuts > 50_000, "{cuts}");
}

#[test]
fn a_second_power_cut_while_saving_again_does_no_harm_either() {
    for saves in 1..6 {
        let (start, old) = after_saves(saves);
        let (first, second) = (set(200), set(300));
        for cut in 0..57 {
            for again in 0..57 {
                let mut eeprom = start.clone();
                let (mut store, _, _) = loaded(&eeprom);
                save_and_cut(&mut store, &mut first.clone(), &mut eeprom, cut);
                let garbage = (cut * 31 + again * 17 + u32::from(saves)) as u8;
                if let Some((at, _)) = eeprom.writing.take() {
                    eeprom.cells[usize::from(at)] = garbage;
                }
                eeprom.busy.set(0);
                let (mut store, between, _) = loaded(&eeprom);
                save_and_cut(&mut store, &mut second.clone(), &mut eeprom, again);
                if let Some((at, _)) = eeprom.writing.take() {
                    eeprom.cells[usize::from(at)] = garbage.rotate_left(3);
                }
                eeprom.busy.set(0);
                let (_, after, _) = loaded(&eeprom);
                assert!([old, first].contains(&between), "{saves} {cut} {again}");
                assert!(after == between || after == second, "{saves} {cut} {again}");
            }
        }
    }
}

#[test]
fn a_parameter_changed_during_a_save_is_saved_and_never_mixed_in() {
    const VALUE: u16 = 0xABCD;
    let (start, old) = after_saves(3);
    let before = set(200);
    let mut after = before;
    assert!(after.set(Parameter::TempId.index(), VALUE.into(), InMemory));
    for changed_at in 0..120 {
        for cut in 0..130 {
            let mut eeprom = start.clone();
            eeprom.writes = 0;
            let (mut store, _, _) = loaded(&eeprom);
            let mut parameters = before;
            let mut steps = 0;
            store.save();
            while store.is_saving() && eeprom.writes <= cut {
                if steps == changed_at {
                    parameters.set(Parameter::TempId.index(), VALUE.into(), InMemory);
                    store.save_again();
                }
                store.step(&mut parameters, &mut eeprom);
                eeprom.busy.set(0);
                steps += 1;
            }
            if eeprom.writes > cut {
                let (at, byte) = eeprom.writing.take().unwrap();
                eeprom.cells[usize::from(at)] = byte ^ 0x5A;
            }
            eeprom.settle();
            let (_, found, _) = loaded(&eeprom);
            assert!([old, before, after].contains(&found), "changed at {changed_at}, cut at {cut}");
            if !store.is_saving() {
                assert!(store.is_saved());
                assert_eq!(
                    found,
                    if steps > changed_at { after } else { before },
                    "changed at {changed_at}"
                );
                break;
            }
        }
    }
}

#[test]
fn a_cell_that_does_not_keep_its_value_fails_the_save_and_the_old_parameters_stay() {
    let (start, old) = after_saves(4);
    let mut failed = 0;
    for stuck in PARAMETERS[0]..=PARAMETERS[1] + MARKER as Address {
        let mut eeprom = start.clone();
        eeprom.stuck = Some(stuck);
        let (mut store, _, _) = loaded(&eeprom);
        let mut parameters = set(200);
        let is_saved = save(&mut store, &mut parameters, &mut eeprom);
        let (_, found, is_lost) = loaded(&eeprom);
        assert_eq!(found, if is_saved { parameters } else { old }, "{stuck:#x}");
        assert!(!is_lost);
        failed += u32::from(!is_saved);
    }
    assert!(failed > 20, "{failed}");
}

#[test]
fn a_new_eeprom_gives_the_defaults_and_nothing_is_lost() {
    let (_, parameters, is_lost) = loaded(&Model::blank());
    assert_eq!((parameters.get(Parameter::CanNode), is_lost), (120, false));
}

#[test]
fn invalid_copies_give_the_defaults_and_are_reported() {
    for saves in 1..6 {
        let (start, _) = after_saves(saves);
        let mut eeprom = start.clone();
        eeprom.cells[usize::from(PARAMETERS[0]) + 7] ^= 0x10;
        eeprom.cells[usize::from(PARAMETERS[1]) + 9] ^= 0x01;
        let (_, parameters, is_lost) = loaded(&eeprom);
        assert_eq!((parameters, is_lost), (defaults(), true));
    }
    for byte in [0x00, 0x01, 0xA5, 0xFE] {
        let (_, parameters, is_lost) = loaded(&Model::with([byte; EEPROM_LEN]));
        assert_eq!((parameters, is_lost), (defaults(), true), "{byte:#x}");
    }
}

/// Loads after 2 to 7 saves, with a broken bit in the copy of the save that is `saves_ago`
/// back.
#[track_caller]
fn assert_loaded_with_a_broken_copy(
    saves_ago: u16,
    expected_saves_ago: u16,
    expected_is_lost: bool,
) {
    for saves in 2..8 {
        let (mut eeprom, _) = after_saves(saves);
        let broken = PARAMETERS[usize::from((saves - saves_ago).is_multiple_of(2))];
        eeprom.cells[usize::from(broken) + 3] ^= 0x80;
        let (_, parameters, is_lost) = loaded(&eeprom);
        assert_eq!((parameters, is_lost), (set(saves - 1 - expected_saves_ago), expected_is_lost));
    }
}

#[test]
fn with_the_newer_copy_broken_the_older_one_is_loaded_and_that_is_told() {
    assert_loaded_with_a_broken_copy(0, 1, true);
}

#[test]
fn with_the_older_copy_broken_nothing_is_lost() {
    assert_loaded_with_a_broken_copy(1, 0, false);
}

/// Whatever the markers of the copies that it finds, such as those of another build.
#[test]
fn after_a_save_nothing_is_lost_any_more() {
    for first in 0..=255 {
        for second in 0..=255 {
            let mut eeprom = Model::with([0; EEPROM_LEN]);
            eeprom.cells[usize::from(PARAMETERS[0] + MARKER as Address)] = first;
            eeprom.cells[usize::from(PARAMETERS[1] + MARKER as Address)] = second;
            let (mut store, mut parameters, is_lost) = loaded(&eeprom);
            assert!(is_lost);
            assert!(save(&mut store, &mut parameters, &mut eeprom));
            assert!(!loaded(&eeprom).2, "{first:#04x} {second:#04x}");
        }
    }
}

#[test]
fn only_bytes_that_differ_are_written() {
    let (mut eeprom, mut parameters) = after_saves(2);
    let (mut store, _, _) = loaded(&eeprom);
    assert!(save(&mut store, &mut parameters, &mut eeprom));
    // After two saves of the same values both copies have them. So only the markers and the
    // CRCs change.
    assert!(save(&mut store, &mut parameters, &mut eeprom));
    assert!(eeprom.writes <= 4, "{}", eeprom.writes);
}

#[test]
fn nothing_outside_of_the_copies_is_touched() {
    let mut eeprom = Model::blank();
    let (mut store, _, _) = loaded(&eeprom);
    for number in 0..4 {
        assert!(save(&mut store, &mut set(number), &mut eeprom));
    }
    for (at, &byte) in eeprom.cells.iter().enumerate() {
        let is_inside = PARAMETERS
            .iter()
            .any(|&base| (base..=base + MARKER as Address).contains(&(at as Address)));
        assert!(is_inside || byte == 0xFF, "{at:#x}");
    }
}

#[test]
fn without_a_save_a_change_is_not_written() {
    let mut eeprom = Model::blank();
    let (mut store, mut parameters, _) = loaded(&eeprom);
    parameters.set(Parameter::CanNode.index(), 7, InMemory);
    for _ in 0..100 {
        store.step(&mut parameters, &mut eeprom);
    }
    assert_eq!(eeprom.writes, 0);
}

/// For example, thesis builds have fewer parameters, and another build may have more.
#[test]
fn parameters_of_a_longer_or_a_shorter_table_are_lost() {
    for saves in 1..4 {
        for len in (2..2 * (COUNT + 8)).filter(|&len| len != 2 * COUNT && len <= 0x70 - 3) {
            let mut eeprom = Model::blank();
            for (save, &base) in PARAMETERS.iter().enumerate().take(saves) {
                let marker = LAYOUT | save as u8;
                let values: Vec<u8> = (0..len)
                    .map(|n| if n % 2 == 0 { 120 } else { 0xFF * (n % 4 / 3) as u8 })
                    .collect();
                let sum = values
                    .iter()
                    .fold(0x1234 ^ u16::from(marker), |sum, &byte| crc::add(sum, byte));
                let record = [&values, &sum.to_be_bytes()[..], &[marker]].concat();
                eeprom.cells[usize::from(base)..][..record.len()].copy_from_slice(&record);
            }
            let (_, parameters, is_lost) = loaded(&eeprom);
            assert_eq!((parameters, is_lost), (defaults(), true), "{len} bytes, {saves} saves");
        }
    }
}

/// Changes the record at `base` to that of a build whose table of parameters has this digest.
fn of_another_table(eeprom: &mut Model, base: Address, digest: u16) {
    let base = usize::from(base);
    let marker = eeprom.cells[base + usize::from(MARKER)];
    let values = &eeprom.cells[base..base + usize::from(VALUES_LEN)];
    let sum = values.iter().fold(digest ^ u16::from(marker), |sum, &byte| crc::add(sum, byte));
    eeprom.cells[base + usize::from(VALUES_LEN)..][..2].copy_from_slice(&sum.to_be_bytes());
}

#[test]
fn parameters_of_another_table_are_lost_and_the_unique_id_is_not() {
    for saves in 1..4 {
        for bit in 0..16 {
            let (mut eeprom, saved) = after_saves(saves);
            let id = identified(&mut eeprom, noise(1));
            for base in PARAMETERS {
                of_another_table(&mut eeprom, base, parameters::DIGEST);
            }
            assert_eq!(loaded(&eeprom).1, saved, "of this table");
            for base in PARAMETERS {
                of_another_table(&mut eeprom, base, parameters::DIGEST ^ 1 << bit);
            }
            let (mut store, mut parameters, is_lost) = loaded(&eeprom);
            assert_eq!((parameters, is_lost), (defaults(), true), "{saves} saves, bit {bit}");
            assert_eq!(identified(&mut eeprom, || unreachable!()), id);
            // The next save clears the loss.
            assert!(save(&mut store, &mut parameters, &mut eeprom));
            assert!(!loaded(&eeprom).2);
        }
    }
}

#[test]
fn parameters_of_another_layout_are_lost_and_the_unique_id_is_not() {
    let mut eeprom = Model::blank();
    let id = identified(&mut eeprom, noise(1));
    for version in (0..=62u8).filter(|version| version << 2 != LAYOUT) {
        let (mut store, _, _) = loaded(&eeprom);
        store.next_marker = version << 2;
        assert!(save(&mut store, &mut set(1), &mut eeprom));
        assert_eq!(
            eeprom.cells[usize::from(PARAMETERS[0] + MARKER as Address)],
            version << 2,
            "a whole record"
        );
        let (mut store, mut parameters, is_lost) = loaded(&eeprom);
        assert_eq!((parameters, is_lost), (defaults(), true), "{version}");
        assert_eq!(identified(&mut eeprom, || unreachable!()), id);
        // The next save clears the loss.
        assert!(save(&mut store, &mut parameters, &mut eeprom));
        assert!(!loaded(&eeprom).2);
        eeprom.cells[0x20..].fill(0xFF);
    }
}

/// Poor noise: only two bits change.
fn noise(mut seed: u32) -> impl FnMut() -> u8 {
    move || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        200 + (seed >> 30) as u8
    }
}

fn identified(eeprom: &mut Model, noise: impl FnMut() -> u8) -> [u8; 16] {
    let mut id = [0; 16];
    Store::new().identify(&mut id, eeprom, noise);
    eeprom.settle();
    id
}

#[test]
fn a_unique_id_is_made_once_and_kept() {
    let mut eeprom = Model::blank();
    let id = identified(&mut eeprom, noise(1));
    assert_ne!(id, [0; 16]);
    assert_eq!(identified(&mut eeprom, || unreachable!()), id);
}

#[test]
fn a_unique_id_with_one_wrong_byte_in_its_crc_is_made_again() {
    for byte in 0..CRC_LEN {
        let mut eeprom = Model::blank();
        identified(&mut eeprom, noise(1));
        eeprom.cells[usize::from(UNIQUE_ID + Address::from(UNIQUE_ID_LEN + byte))] ^= 1;
        let mut is_made = false;
        identified(&mut eeprom, || {
            is_made = true;
            7
        });
        assert!(is_made, "{byte}");
    }
}

#[test]
fn a_unique_id_survives_that_parameters_are_saved() {
    let mut eeprom = Model::blank();
    let (mut store, mut id) = (Store::new(), [0; 16]);
    store.identify(&mut id, &mut eeprom, noise(1));
    eeprom.settle();
    let mut parameters = Parameters::new();
    assert!(!store.load(&mut parameters, &eeprom, InMemory));
    for number in 0..5 {
        assert!(save(&mut store, &mut set(number), &mut eeprom));
    }
    assert_eq!(identified(&mut eeprom, || unreachable!()), id);
    assert_eq!(loaded(&eeprom).1, set(4));
}

#[test]
fn a_unique_id_that_was_cut_short_is_made_again() {
    for writes in 0..19u32 {
        for garbage in 0..=255 {
            let mut eeprom = Model::blank();
            let (mut store, mut id) = (Store::new(), [0; 16]);
            store.identify(&mut id, &mut eeprom, noise(1));
            // The state while the next byte was being written. The bytes are written in order,
            // the marker last.
            let mut cells = [0xFF; EEPROM_LEN];
            let written = usize::from(UNIQUE_ID) + writes as usize;
            cells[..written].copy_from_slice(&eeprom.cells[..written]);
            cells[written] = garbage;
            let mut again = Model::with(cells);
            let mut is_made = false;
            let mut noise = noise(2);
            let second = identified(&mut again, || {
                is_made = true;
                noise()
            });
            if is_made {
                assert_eq!(identified(&mut again, || unreachable!()), second);
            } else {
                assert_eq!((second, writes), (id, 18), "only if all of it was there");
            }
        }
    }
}

#[test]
fn a_thousand_boards_with_poor_noise_have_a_thousand_ids() {
    let ids: std::collections::HashSet<_> =
        (0..1000).map(|seed| identified(&mut Model::blank(), noise(seed))).collect();
    assert_eq!(ids.len(), 1000);
}

#[test]
fn no_noise_makes_an_id_of_zeros() {
    for constant in 0..=255 {
        for cells in [[0xFF; EEPROM_LEN], [0; EEPROM_LEN]] {
            assert_ne!(identified(&mut Model::with(cells), || constant), [0; 16]);
        }
    }
}

#[test]
fn an_eeprom_that_never_ends_a_write_is_given_up() {
    struct Dead;
    impl Eeprom for Dead {
        fn read(&self, _: Address) -> u8 {
            0xFF
        }
        fn is_busy(&self) -> bool {
            true
        }
        fn begin_write(&mut self, _: Address, _: u8) {}
    }
    let mut id = [0; 16];
    Store::new().identify(&mut id, &mut Dead, noise(1));
    assert_ne!(id, [0; 16]);
}
