//! Saves and loads, with power cuts and worn cells.

use super::*;
use crate::image::InMemory;
use crate::tables::parameters::COUNT;

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

/// Saves, and then copies. Cuts the supply during the write after the first `writes`. Returns false
/// if all ended before.
fn save_and_cut(
    store: &mut Store,
    parameters: &mut Parameters,
    eeprom: &mut Model,
    writes: u32,
) -> bool {
    eeprom.writes = 0;
    store.save();
    go_on_and_cut(store, parameters, eeprom, writes)
}

/// Does what is left, up to the write after the first `writes`.
fn go_on_and_cut(
    store: &mut Store,
    parameters: &mut Parameters,
    eeprom: &mut Model,
    writes: u32,
) -> bool {
    while store.state & (SAVES | COPIES) != 0 {
        store.step_once(parameters, eeprom, InMemory);
        if eeprom.writes > writes {
            return true;
        }
    }
    false
}

/// Saves, and leaves the copy for later.
fn save_only(store: &mut Store, parameters: &mut Parameters, eeprom: &mut Model) -> bool {
    eeprom.writes = 0;
    store.save();
    while store.is_saving() {
        store.step_once(parameters, eeprom, InMemory);
    }
    eeprom.settle();
    store.is_saved()
}

fn save(store: &mut Store, parameters: &mut Parameters, eeprom: &mut Model) -> bool {
    let is_saved = save_only(store, parameters, eeprom);
    go_on_and_cut(store, parameters, eeprom, u32::MAX);
    eeprom.settle();
    is_saved
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

/// The address of a byte of a copy: copy, byte.
fn byte(copy: usize, byte: usize) -> usize {
    usize::from(PARAMETERS[copy]) + byte
}

/// The copy that the selector means, if it means one.
fn selected(cells: &[u8]) -> Option<usize> {
    cells[usize::from(SELECTOR)..][..2].iter().find_map(|cell| match *cell {
        FIRST => Some(0),
        SECOND => Some(1),
        _ => None,
    })
}

/// The copy in force.
fn in_force(eeprom: &Model) -> usize {
    selected(&eeprom.cells).expect("a selector")
}

/// Verifies the layout: cuts a save, and the copy after it, at every byte, with every value in the
/// byte that was being written, for both copies, and for an EEPROM without a save.
#[test]
fn a_power_cut_at_any_byte_of_a_save_leaves_the_old_or_the_new_parameters() {
    let mut cuts = 0;
    for saves in 0..6 {
        let (start, old) = after_saves(saves);
        let new = set(200);
        let (mut kept_old, mut kept_new, mut commits) = (0, 0, 0);
        for writes in 0.. {
            let (mut store, _, _) = loaded(&start);
            let mut eeprom = start.clone();
            if !save_and_cut(&mut store, &mut new.clone(), &mut eeprom, writes) {
                break;
            }
            let (at, _) = eeprom.writing.unwrap();
            // Once the selector is written, only the new ones may be there.
            let is_answered = store.state & COPIES != 0;
            commits += u32::from(at == SELECTOR);
            for garbage in (0..=255).step_by(if saves < 2 { 1 } else { 15 }) {
                let mut cells = eeprom.cells;
                cells[usize::from(at)] = garbage;
                let mut after = Model::with(cells);
                let (mut store, mut parameters, is_lost) = loaded(&after);
                cuts += 1;
                // Without a valid copy before, the CRC of an incomplete one may be right by chance:
                // one of 65,536. Then it is reported.
                assert!(
                    parameters == new || parameters == old && !is_answered || saves == 0 && is_lost,
                    "{saves} saves, {writes} writes, {garbage:#x}"
                );
                kept_old += u32::from(parameters == old);
                kept_new += u32::from(parameters == new);
                // A cut of the very first save loses parameters, unless it is cut before the
                // first byte of the record or at its end.
                let has_begun = after.cells[usize::from(PARAMETERS[0])] != 0xFF;
                let is_expected = saves == 0 && has_begun && selected(&after.cells) != Some(0);
                assert_eq!(is_lost, is_expected, "{saves} {writes} writes, {garbage:#x}");
                // A cut of the copy that the start begins leaves the same.
                if garbage % 51 == 0 && !is_lost {
                    for more in 0.. {
                        let mut eeprom = after.clone();
                        let (mut store, mut found, _) = loaded(&eeprom);
                        if !go_on_and_cut(&mut store, &mut found, &mut eeprom, more) {
                            break;
                        }
                        let (at, _) = eeprom.writing.take().unwrap();
                        eeprom.cells[usize::from(at)] = garbage.rotate_left(3) ^ 0x5A;
                        eeprom.busy.set(0);
                        let (_, again, is_lost) = loaded(&eeprom);
                        assert_eq!((again, is_lost), (parameters, false));
                        cuts += 1;
                    }
                }
                // The next save succeeds, also before the copy is complete.
                if garbage % 51 == 0 {
                    after.settle();
                    parameters = set(300);
                    assert!(save_only(&mut store, &mut parameters, &mut after));
                    assert_eq!(loaded(&after).1, parameters);
                }
            }
        }
        assert!(
            kept_old > 300 && kept_new > 300 && commits == 1,
            "{kept_old} {kept_new} {commits}"
        );
    }
    assert!(cuts > 20_000, "{cuts}");
}

/// A save while the copy after the save before is being written.
#[test]
fn a_save_at_any_moment_of_the_copy_is_in_force_once_it_is_answered() {
    for saves in 1..4 {
        let (start, old) = after_saves(saves);
        let first = set(200);
        // The same as before, or others.
        for second in [old, set(300)] {
            for cut in 0.. {
                let mut eeprom = start.clone();
                let (mut store, _, _) = loaded(&eeprom);
                let is_cut = save_and_cut(&mut store, &mut first.clone(), &mut eeprom, cut);
                eeprom.settle();
                if store.is_saving() {
                    continue;
                }
                assert_eq!(loaded(&eeprom).1, first);
                assert!(save_only(&mut store, &mut second.clone(), &mut eeprom));
                assert_eq!((loaded(&eeprom).1, loaded(&eeprom).2), (second, false), "{cut}");
                if !is_cut {
                    break;
                }
            }
        }
    }
}

/// Unsaved values do not get into the copy.
#[test]
fn a_parameter_set_during_the_copy_is_not_saved() {
    let (start, _) = after_saves(2);
    for steps in 0..1000 {
        let mut eeprom = start.clone();
        let (mut store, _, _) = loaded(&eeprom);
        let mut parameters = set(200);
        assert!(save_only(&mut store, &mut parameters, &mut eeprom));
        let saved = parameters;
        for _ in 0..steps {
            store.step_once(&mut parameters, &mut eeprom, InMemory);
            eeprom.busy.set(0);
        }
        parameters = set(300);
        store.save_again();
        go_on_and_cut(&mut store, &mut parameters, &mut eeprom, u32::MAX);
        eeprom.settle();
        for copy in 0..2 {
            let mut broken = eeprom.clone();
            broken.cells[byte(copy, 3)] ^= 1;
            assert_eq!(loaded(&broken).1, saved);
        }
    }
}

/// All cells of the parameters: copies and selector.
fn cells() -> impl Iterator<Item = usize> {
    (0..2)
        .flat_map(|copy| (0..LEN).map(move |place| byte(copy, place)))
        .chain([0, 1].map(|cell| usize::from(SELECTOR) + cell))
}

#[test]
fn at_rest_no_broken_bit_of_any_cell_loses_a_value() {
    for saves in 1..4 {
        let (eeprom, saved) = after_saves(saves);
        let older = byte(1 - in_force(&eeprom), 0);
        for at in cells() {
            for bit in 0..8 {
                let mut broken = eeprom.clone();
                broken.cells[at] ^= 1 << bit;
                let (_, parameters, is_lost) = loaded(&broken);
                assert_eq!(parameters, saved);
                // The node cannot know that the other copy is equal, so this is reported.
                let is_in_force =
                    !(older..older + LEN).contains(&at) && at >= usize::from(PARAMETERS[0]);
                assert_eq!(is_lost, is_in_force, "{saves} {at:#x} {bit}");
            }
        }
    }
}

/// Breaks a bit of a cell at a moment of a save, or of the copy after it, which then go on to their
/// end.
#[test]
fn a_bit_that_breaks_during_a_save_leaves_the_new_values_or_reports_the_older_ones() {
    let (start, old) = after_saves(3);
    let new = set(200);
    let (mut kept, mut reported) = (0, 0);
    let places = cells().enumerate();
    for (n, at) in places.filter(|(n, at)| n % 9 < 2 || *at < usize::from(PARAMETERS[0])) {
        for moment in (0..2 * LEN as u32).step_by(1 + LEN / 40) {
            let mut eeprom = start.clone();
            let (mut store, ..) = loaded(&eeprom);
            let mut parameters = new;
            save_and_cut(&mut store, &mut parameters, &mut eeprom, moment);
            eeprom.settle();
            eeprom.cells[at] ^= 1 << ((n as u32 + moment) % 8);
            // A restart before the end is a second fault: it may find no good copy, and says so.
            let (_, found, is_lost) = loaded(&eeprom);
            assert!(found == new || is_lost || found == old && store.is_saving());
            go_on_and_cut(&mut store, &mut parameters, &mut eeprom, u32::MAX);
            eeprom.settle();
            let is_saved = store.is_saved();
            let (_, found, is_lost) = loaded(&eeprom);
            assert!(
                found == new || found == old && (is_lost || !is_saved),
                "{at:#x} after {moment} writes"
            );
            kept += u32::from(found == new);
            reported += u32::from(is_lost);
        }
    }
    assert!(kept > 500 && reported > 100, "{kept} {reported}");
}

/// In turns that have nothing else to do there are more.
#[test]
fn at_each_tick_a_save_does_a_step_and_with_several_outputs_two() {
    let calls = |step: fn(&mut Store, &mut Parameters, &mut Model)| {
        let (mut eeprom, mut parameters) = (Model::blank(), set(7));
        let mut store = loaded(&eeprom).0;
        store.save();
        let mut calls = 0u32;
        while store.is_saving() {
            step(&mut store, &mut parameters, &mut eeprom);
            calls += 1;
        }
        calls
    };
    let steps = calls(|store, parameters, eeprom| store.step_once(parameters, eeprom, InMemory));
    let ticks = calls(|store, parameters, eeprom| store.step(parameters, eeprom, InMemory));
    assert_eq!(ticks, steps.div_ceil(if OUTPUTS == 1 { 1 } else { 2 }), "{steps} steps");
}

/// At 3.4 ms a byte: clients wait for a second, and an EEPROM may take longer.
#[test]
fn a_save_writes_what_has_changed_once_before_its_response_and_the_rest_after_it() {
    let (start, _) = after_saves(3);
    let last = COUNT as u8 - 1;
    let all: Vec<u8> = (0..=last).collect();
    for (changed, most) in [(&[][..], 0), (&[last], 2), (&[2, 4, last], 6), (&all, CELLS as u32)] {
        let mut eeprom = start.clone();
        let (mut store, mut parameters, _) = loaded(&eeprom);
        go_on_and_cut(&mut store, &mut parameters, &mut eeprom, u32::MAX);
        for &index in changed {
            let value = &mut parameters.bytes()[2 * usize::from(index)..][..2];
            value[0] ^= 0x55;
            if !(IS_PACKED && parameters::is_byte(index, InMemory)) {
                value[1] ^= 0x55;
            }
        }
        assert!(save_only(&mut store, &mut parameters, &mut eeprom));
        let before = eeprom.writes;
        // With the CRC and the selector.
        let most = if most == 0 { 0 } else { most + 4 };
        assert!(before <= most, "{before} of {most} writes: {} values", changed.len());
        go_on_and_cut(&mut store, &mut parameters, &mut eeprom, u32::MAX);
        assert_eq!(eeprom.writes - before, before.saturating_sub(2), "all but the selector");
    }
}

#[test]
fn a_cell_that_does_not_keep_its_value_fails_the_save_and_the_old_parameters_stay() {
    let (start, old) = after_saves(4);
    let mut failed = 0;
    for stuck in PARAMETERS[0]..=PARAMETERS[1] + LEN as Address {
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

/// Whatever is in the EEPROM.
#[test]
fn after_a_save_nothing_is_lost_any_more() {
    for selector in 0..=255 {
        for fill in 0..=254 {
            let mut eeprom = Model::with([fill; EEPROM_LEN]);
            eeprom.cells[usize::from(SELECTOR)] = selector;
            let (mut store, mut parameters, is_lost) = loaded(&eeprom);
            assert!(is_lost);
            assert!(save_only(&mut store, &mut parameters, &mut eeprom));
            assert!(!loaded(&eeprom).2, "{selector:#04x} {fill:#04x}");
        }
    }
}

/// The next start would find the broken copy again.
#[test]
fn a_save_of_the_same_values_replaces_a_broken_copy() {
    let (mut eeprom, mut saved) = after_saves(3);
    let place = byte(in_force(&eeprom), 3);
    eeprom.cells[place] ^= 0x80;
    for _ in 0..2 {
        let (mut store, mut parameters, is_lost) = loaded(&eeprom);
        assert!(is_lost);
        // Without a save it stays broken, and is told at each start.
        go_on_and_cut(&mut store, &mut parameters, &mut eeprom, u32::MAX);
        eeprom.settle();
    }
    let (mut store, ..) = loaded(&eeprom);
    assert!(save_only(&mut store, &mut saved, &mut eeprom));
    assert_eq!((loaded(&eeprom).1, loaded(&eeprom).2), (saved, false));
}

/// The start repairs the copy that is not in force.
#[test]
fn a_broken_copy_that_is_not_in_force_is_repaired() {
    let (mut eeprom, saved) = after_saves(3);
    let cells = eeprom.cells;
    let place = byte(1 - in_force(&eeprom), 3);
    eeprom.cells[place] ^= 0x80;
    let (mut store, mut parameters, is_lost) = loaded(&eeprom);
    assert_eq!((parameters, is_lost), (saved, false));
    go_on_and_cut(&mut store, &mut parameters, &mut eeprom, u32::MAX);
    eeprom.settle();
    assert_eq!(eeprom.cells, cells);
}

/// Changes the copy to that of a build whose table of parameters has this digest.
fn of_another_table(eeprom: &mut Model, copy: usize, start: u16) {
    let values = &eeprom.cells[byte(copy, 0)..][..CELLS];
    let sum = values.iter().fold(start, |sum, &byte| crc::add(sum, byte));
    eeprom.cells[byte(copy, CELLS)..][..2].copy_from_slice(&sum.to_be_bytes());
}

#[test]
fn parameters_of_another_table_are_lost_and_the_unique_id_is_not() {
    for saves in 1..4 {
        for bit in 0..16 {
            let (mut eeprom, saved) = after_saves(saves);
            let id = identified(&mut eeprom, noise(1));
            for copy in 0..2 {
                of_another_table(&mut eeprom, copy, CRC_OF_PARAMETERS);
            }
            assert_eq!(loaded(&eeprom).1, saved, "of this table");
            for copy in 0..2 {
                of_another_table(&mut eeprom, copy, CRC_OF_PARAMETERS ^ 1 << bit);
            }
            let (mut store, mut parameters, is_lost) = loaded(&eeprom);
            assert_eq!((parameters, is_lost), (defaults(), true), "{saves} saves, bit {bit}");
            assert_eq!(identified(&mut eeprom, || unreachable!()), id);
            // The next save clears the loss.
            assert!(save_only(&mut store, &mut parameters, &mut eeprom));
            assert!(!loaded(&eeprom).2);
        }
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
    Store::new().identify(&mut id, eeprom, InMemory, noise);
    eeprom.settle();
    id
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
    Store::new().identify(&mut id, &mut Dead, InMemory, noise(1));
    assert_ne!(id, [0; 16]);
}
