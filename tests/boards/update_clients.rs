//! Firmware updates as the clients do them: what each sends, and by which rules it decides.

use std::collections::HashSet;

use bench::avr::Firmware;
use bench::corner::Corner;
use bench::node_elf;

use crate::support::update_bench::*;

/// Mission Planner sends BeginFirmwareUpdate, in one frame, after a GetNodeInfo response whose name
/// and hardware version fit its file, or whose name is empty. After an OK it does not send it
/// again, but continues to send GetNodeInfo to nodes that restart.
#[test]
fn an_update_by_mission_planner_succeeds() {
    let mut bench = UpdateBench::with_program();
    bench.wait_for_program(1500);
    let info = bench.call(GET_NODE_INFO, &[]);
    let (hardware, name) = (info[22..24].to_vec(), info[41..].to_vec());
    assert_eq!(hardware, file()[HEADER..HEADER + 2]);
    assert!(name.starts_with(b"org.dronecan.servo"), "{name:?}");
    assert_eq!(bench.call(BEGIN_FIRMWARE_UPDATE, &[&[SERVER], &b"fw.bin"[..]].concat())[0], OK);
    bench.wait_for("first read", 1000, |bench| bench.server.requests > 0);
    for _ in 0..2 {
        let info = bench.call(GET_NODE_INFO, &[]);
        assert_eq!(
            (&info[22..24], &info[41..]),
            (&hardware[..], &b""[..]),
            "the bootloader must report the same hardware, and no name"
        );
        bench.run_ms(200);
    }
    bench.wait_for_program(10_000);
    assert_eq!(bench.call(GET_NODE_INFO, &[])[41..], name);
}

/// PX4 takes the bootloader for a node that has restarted: it sends GetNodeInfo, and
/// BeginFirmwareUpdate again. Its files are named after the board.
#[test]
fn an_update_by_px4_succeeds() {
    let mut bench = UpdateBench::with_program();
    bench.server.files.insert("256.bin".to_owned(), file());
    bench.wait_for_program(1500);
    bench.call(GET_NODE_INFO, &[]);
    let request = [&[SERVER], &b"256.bin"[..]].concat();
    assert_eq!(bench.call(BEGIN_FIRMWARE_UPDATE, &request)[0], OK);
    bench.wait_for("first read", 1000, |bench| bench.server.requests > 0);
    bench.call(GET_NODE_INFO, &[]);
    assert_eq!(bench.call(BEGIN_FIRMWARE_UPDATE, &request)[0], IN_PROGRESS);
    bench.wait_for_program(10_000);
    // PX4 sees in the GetNodeInfo response of the new program that the update is done.
    assert_eq!(bench.call(GET_NODE_INFO, &[])[7..9], file()[HEADER + 2..HEADER + 4]);
}

/// ArduPilot does not arm with a node that is not OPERATIONAL. The uptime is the program's: the
/// loader counts anew.
#[test]
#[ignore = "takes long: make test-all"]
fn the_program_says_software_update_within_100_ms_of_its_answer() {
    for phase_ms in (0..1000).step_by(90) {
        let mut bench = UpdateBench::with_program();
        bench.wait_for_program(1500);
        bench.run_ms(1000 + phase_ms);
        assert_eq!(bench.call(BEGIN_FIRMWARE_UPDATE, b"\0fw.bin"), [OK]);
        let known = bench.statuses().len();
        bench.wait_for("a status", 100, |bench| bench.statuses().len() > known);
        let status = bench.statuses()[known].1;
        assert_eq!(status[4] >> 3 & 7, SOFTWARE_UPDATE, "{phase_ms}");
        assert!(status[0] >= 1, "{phase_ms}: {status:?}");
        bench.wait_for_program(10_000);
    }
}

/// What a file server reads of an application descriptor.
#[derive(Debug, PartialEq)]
struct Descriptor {
    image_crc: u64,
    image_size: u32,
    version: [u8; 2],
    board_id: u16,
}

/// Finds the descriptor as PX4 does: reads blocks of 512 bytes, and looks for the signature at
/// multiples of 8. The whole descriptor must be in the block.
fn find_descriptor(file: &[u8]) -> Option<Descriptor> {
    const SIGNATURE: [u8; 8] = [0x40, 0xA2, 0xE4, 0xF1, 0x64, 0x68, 0x91, 0x06];
    let mut blocks = file[..1024].chunks(512);
    blocks.find_map(|block| {
        let at = (0..=512 - 36).step_by(8).find(|&at| block[at..at + 8] == SIGNATURE)?;
        let bytes = &block[at..at + 36];
        Some(Descriptor {
            image_crc: u64::from_le_bytes(bytes[8..16].try_into().unwrap()),
            image_size: u32::from_le_bytes(bytes[16..20].try_into().unwrap()),
            version: bytes[24..26].try_into().unwrap(),
            board_id: u16::from_le_bytes(bytes[26..28].try_into().unwrap()),
        })
    })
}

/// True if PX4 offers the file with this descriptor to a node with this response of GetNodeInfo.
fn is_offered(descriptor: &Descriptor, info: &[u8]) -> bool {
    let image_crc = image_crc(info);
    image_crc == 0 || info[7..9] == [0, 0] || image_crc != descriptor.image_crc
}

/// The CRC of the image in a response of GetNodeInfo.
fn image_crc(info: &[u8]) -> u64 {
    u64::from_le_bytes(info[14..22].try_into().unwrap())
}

/// Name of the file on PX4's card: the ID of the board in decimal.
fn name_of_file(info: &[u8]) -> String {
    format!("{}.bin", u16::from_be_bytes(info[22..24].try_into().unwrap()))
}

/// Sends the file as PX4 does, and waits until it runs.
fn update_by_px4(bench: &mut UpdateBench, file: &[u8]) {
    let info = bench.call(GET_NODE_INFO, &[]);
    let name = name_of_file(&info);
    bench.server.files.insert(name.clone(), file.to_vec());
    assert_eq!(bench.begin_update(&name), OK);
    bench.run_ms(500);
    bench.wait_for_program(10_000);
}

/// The unique ID in a response of GetNodeInfo.
fn unique_id(info: &[u8]) -> [u8; 16] {
    info[24..40].try_into().unwrap()
}

/// PX4's card with a file, and the nodes that it knows by their unique IDs. It arms only while no
/// update is due, and looks at each start of a node.
struct Card {
    name: String,
    file: Vec<u8>,
    due: HashSet<[u8; 16]>,
}

impl Card {
    fn new(name: &str, file: Vec<u8>) -> Card {
        Card { name: name.to_owned(), file, due: HashSet::new() }
    }

    /// Looks at a node that has started. Returns true if it asks the node to update itself.
    fn look_at(&mut self, info: &[u8]) -> bool {
        let descriptor = find_descriptor(&self.file).expect("a descriptor");
        let is_due = name_of_file(info) == self.name && is_offered(&descriptor, info);
        if is_due {
            self.due.insert(unique_id(info));
        } else {
            self.due.remove(&unique_id(info));
        }
        is_due
    }
}

/// Updates a board whose loader waits, as PX4 does, and returns the unique ID that both told.
#[track_caller]
fn update_of_one_node(bench: &mut UpdateBench) -> [u8; 16] {
    let info = bench.call(GET_NODE_INFO, &[]);
    let mut card = Card::new(&name_of_file(&info), file());
    assert!(card.look_at(&info));
    update_by_px4(bench, &file());
    let after = bench.call(GET_NODE_INFO, &[]);
    assert_eq!(unique_id(&after), unique_id(&info), "the program and the loader are one node");
    assert!(!card.look_at(&after));
    assert!(card.due.is_empty(), "PX4 would not arm: {:02X?}", card.due);
    unique_id(&after)
}

/// A board that has nothing but the loader told FF..FF, and its program another unique ID: PX4
/// counted the update of FF..FF as due until it was restarted.
#[test]
fn a_new_board_is_one_node_before_and_after_its_first_update() {
    let mut bench = UpdateBench::empty();
    let made = update_of_one_node(&mut bench);
    assert!(made != [0xFF; 16] && made != [0; 16], "{made:02X?}");
    bench.wait_in_the_bootloader();
    assert_eq!(unique_id(&bench.call(GET_NODE_INFO, &[])), made, "it is kept");
}

/// A cut at each time of a first start: the loader makes the ID again.
#[test]
#[ignore = "takes long: make test-all"]
fn a_new_board_whose_power_is_cut_at_its_first_start_is_one_node() {
    let whole = UpdateBench::empty().bench.board(0).avr().eeprom();
    for cut_ms in [0, 30, 70, 600, 1030, 1090, 1140, 1155, FIRST_START_MS] {
        let mut bench = UpdateBench::powered_up(Options::default());
        bench.bench.run_for_ms(cut_ms);
        let cut = bench.bench.board(0).avr().eeprom();
        let is_whole = cut[..0x17] == whole[..0x17];
        // A fast EEPROM is done before the last of these times.
        if rig::corner().eeprom_ms() >= Corner::default().eeprom_ms() {
            assert_eq!(is_whole, cut_ms == FIRST_START_MS, "{cut_ms} ms");
        }
        bench.cut_power();
        bench.run_ms(FIRST_START_MS + 1000);
        update_of_one_node(&mut bench);
    }
}

/// One changed bit in the record: the loader makes an ID, which the program keeps.
#[test]
#[ignore = "takes long: make test-all"]
fn a_board_whose_unique_id_is_damaged_is_one_node() {
    let whole = UpdateBench::empty().bench.board(0).avr().eeprom();
    for (at, bit) in [(0x04, 1), (0x09, 0x80), (0x13, 0x10), (0x14, 1), (0x15, 0x80), (0x16, 1)] {
        let mut eeprom = whole.clone();
        eeprom[at] ^= bit;
        let mut bench = UpdateBench::with(&[], &eeprom, board().fastest_bit_rate());
        bench.run_ms(FIRST_START_MS + 1000);
        println!("{at:02X}");
        update_of_one_node(&mut bench);
    }
}

/// PX4 asked the preset `default` 51 times in 13 s with the file of `remote`, which has the same
/// board, and did not arm meanwhile.
#[test]
fn px4_asks_no_program_that_takes_no_updates() {
    let default = node_elf().unwrap_or_else(|error| panic!("{error:#}"));
    for (has_loader, elf) in [(true, elf()), (true, default), (false, elf())] {
        let firmware = Firmware::read(&elf).unwrap_or_else(|error| panic!("{error:#}"));
        let mut bench = if has_loader {
            UpdateBench::with(&firmware.flash, &[], board().fastest_bit_rate())
        } else {
            UpdateBench::without_loader(&firmware)
        };
        bench.wait_for_program(3000);
        let info = bench.call(GET_NODE_INFO, &[]);
        let takes_updates = has_loader && bench.begin_update("fw.bin") == OK;
        let [major, minor] = [file()[HEADER], file()[HEADER + 1]];
        // A newer build of the same board.
        let mut newer = file();
        newer[0x80] ^= 1;
        let mut card = Card::new(&format!("{}.bin", u16::from_be_bytes([major, minor])), newer);
        assert_eq!(card.look_at(&info), takes_updates, "{} {has_loader}", elf.display());
        assert_eq!(card.due.is_empty(), !takes_updates);
    }
}

/// The program makes an ID if it starts before the loader ever waits.
#[test]
fn the_loader_tells_the_unique_id_that_a_program_has_made() {
    let mut bench = UpdateBench::with_new_program();
    bench.wait_for_program(3000);
    let made = unique_id(&bench.call(GET_NODE_INFO, &[]));
    bench.wait_in_the_bootloader();
    assert_eq!(unique_id(&bench.call(GET_NODE_INFO, &[])), made);
}

/// ArduPilot's CRC-32: it begins with 0 and inverts nothing.
fn crc32(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            crc >> 1 ^ if crc & 1 != 0 { 0xEDB8_8320 } else { 0 }
        })
    })
}

#[test]
fn the_file_has_a_descriptor_that_is_true() {
    let file = file();
    let descriptor = find_descriptor(&file).expect("a descriptor in the first KiB");
    let [major, minor] = [file[HEADER], file[HEADER + 1]];
    // The CRCs are of what is before them, and of what begins with the version.
    let at = file.windows(8).position(|bytes| bytes == descriptor.image_crc.to_le_bytes()).unwrap();
    let (first, second) = (crc32(&file[..at]), crc32(&file[at + 16..]));
    let expected = Descriptor {
        image_crc: u64::from(second) << 32 | u64::from(first),
        image_size: file.len() as u32,
        version: file[HEADER + 2..HEADER + 4].try_into().unwrap(),
        board_id: u16::from_be_bytes([major, minor]),
    };
    assert_eq!(descriptor, expected);
    assert_eq!(crc(&file), 0, "the bootloader's own check");
}

#[test]
#[ignore = "takes long: make test-all"]
fn px4_offers_a_file_once_and_a_different_one_once() {
    let first = file();
    let mut second = first.clone();
    // Another image: its CRC is in the descriptor at 0x78.
    second[0x80] ^= 1;
    let second = with_crc(second);
    let descriptors = [&first, &second].map(|file| find_descriptor(file).unwrap());
    let mut bench = UpdateBench::with_program();
    bench.wait_for_program(1500);
    let info = bench.call(GET_NODE_INFO, &[]);
    assert!(!is_offered(&descriptors[0], &info), "the program that a programmer wrote");
    update_by_px4(&mut bench, &second);
    assert!(is_offered(&descriptors[0], &bench.call(GET_NODE_INFO, &[])));
    update_by_px4(&mut bench, &first);
    for start in 0..100 {
        bench.cut_power();
        bench.wait_for_program(1500);
        let info = bench.call(GET_NODE_INFO, &[]);
        assert!(!is_offered(&descriptors[0], &info), "start {start}: {info:02X?}");
        assert_eq!(info[9] & 2, 2, "the flag of the CRC");
        assert!(is_offered(&descriptors[1], &info));
    }
    update_by_px4(&mut bench, &second);
    let info = bench.call(GET_NODE_INFO, &[]);
    assert!(!is_offered(&descriptors[1], &info) && is_offered(&descriptors[0], &info));
}

#[test]
fn program_and_bootloader_tell_the_same_version_and_crc() {
    let mut bench = UpdateBench::empty();
    bench.begin_update("fw.bin");
    bench.wait_for_program(10_000);
    let program = bench.call(GET_NODE_INFO, &[]);
    assert_ne!(image_crc(&program), 0);
    bench.wait_in_the_bootloader();
    assert_eq!(bench.call(GET_NODE_INFO, &[])[7..24], program[7..24]);
}

/// A file that was changed on its way has the CRC of the right one in its descriptor.
#[test]
fn after_a_changed_file_the_right_one_is_offered() {
    let right = file();
    let mut changed = right.clone();
    changed[1000] ^= 1;
    let mut bench = UpdateBench::empty();
    bench.server.files.insert("changed".to_owned(), changed);
    bench.begin_update("changed");
    bench.run_ms(5000);
    assert_eq!(bench.next_mode(), MAINTENANCE);
    let info = bench.call(GET_NODE_INFO, &[]);
    assert!(is_offered(&find_descriptor(&right).unwrap(), &info));
    update_by_px4(&mut bench, &right);
}
