//! Tests of the update of one node.

use super::*;
use crate::update::file::tests::{file_of, file_with_crc, id};
use dronecan_host::{CanId, TransferId};

fn seconds(seconds: f32) -> Duration {
    Duration::from_secs_f32(seconds)
}

fn session(file: &FirmwareFile) -> Session {
    Session::new(id(120), (1, 2), Rc::new(file.clone()), id(125), Duration::ZERO)
}

fn transfer(can_id: CanId, payload: Vec<u8>) -> Transfer {
    Transfer { id: can_id, transfer_id: TransferId::new(0), payload, frames: 1 }
}

/// A service transfer of node 120.
fn service(service_id: u8, request: bool, payload: Vec<u8>) -> Transfer {
    transfer(
        CanId::Service { priority: 16, service_id, request, destination: id(125), source: id(120) },
        payload,
    )
}

fn status(mode: Mode) -> Transfer {
    let payload = NodeStatus { mode, ..NodeStatus::default() }.encode();
    transfer(CanId::Message { priority: 20, type_id: 341, source: id(120) }, payload)
}

/// Gives a transfer to the session, which has heard no other node.
fn take(session: &mut Session, transfer: &Transfer, now: f32) -> Option<Vec<u8>> {
    session.take(transfer, seconds(now), &Heard::default())
}

fn read(session: &mut Session, offset: u16) -> Vec<u8> {
    read_at(session, offset, 2.0)
}

fn read_at(session: &mut Session, offset: u16, now: f32) -> Vec<u8> {
    let [low, high] = offset.to_le_bytes();
    let request = [&[low, high, 0, 0, 0][..], b"fw.bin"].concat();
    take(session, &service(48, true, request), now).unwrap()
}

fn begin(session: &mut Session, number: u8, text: &[u8]) {
    assert!(matches!(session.poll(Duration::ZERO), Some(Action::Request(Message::BeginUpdate(_)))));
    let response = NumberAndText { number, text: text.to_vec() }.encode();
    assert_eq!(take(session, &service(40, false, response), 0.1), None);
}

/// A session whose BeginFirmwareUpdate was answered with this number, and that was asked for these
/// parts.
fn begun(file: &FirmwareFile, number: u8, reads: &[u16]) -> Session {
    let mut session = session(file);
    begin(&mut session, number, b"");
    for offset in reads {
        read(&mut session, *offset);
    }
    session
}

#[track_caller]
fn updated(session: &mut Session, now: f32) {
    let end = session.poll(seconds(now));
    assert!(matches!(end, Some(Action::End(Outcome::Updated(_)))), "{end:?}");
}

#[track_caller]
fn begins_again(session: &mut Session, now: f32) {
    let next = session.poll(seconds(now));
    assert!(matches!(next, Some(Action::Request(Message::BeginUpdate(_)))), "{next:?}");
}

#[track_caller]
fn failed(session: &mut Session, now: f32, text: &str) {
    match session.poll(seconds(now)) {
        Some(Action::End(Outcome::Failed(why))) => assert!(why.contains(text), "{why}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_rejection_is_reported_with_its_reason_or_with_what_to_do() {
    let file = file_of(600);
    for (reason, text) in [
        (&b"armed, or a command in the last 2 s"[..], "refuses: armed, or a command"),
        (b"", "refuses: its program takes no update over the bus. Upload one"),
    ] {
        let mut session = session(&file);
        begin(&mut session, ERROR_INVALID_MODE, reason);
        failed(&mut session, 0.1, text);
    }
}

/// A program of another protocol, such as the thesis's, does not answer.
#[test]
fn a_node_that_is_silent_after_all_of_the_file_is_not_said_to_have_stopped_reading() {
    let mut session = begun(&file_of(200), ERROR_OK, &[0]);
    failed(&mut session, 50.0, "has read all of the file and is silent since");
}

#[test]
fn a_silent_node_gets_five_requests() {
    let file = file_of(600);
    let mut session = session(&file);
    let asked = (0..50).filter(|n| session.poll(seconds(0.1 * *n as f32)).is_some()).count();
    assert_eq!(asked, 5);
    failed(&mut session, 5.1, "does not answer BeginFirmwareUpdate");
}

#[test]
fn a_lost_response_does_not_matter_if_the_node_reads() {
    let file = file_of(600);
    let mut session = session(&file);
    assert!(session.poll(Duration::ZERO).is_some());
    read(&mut session, 0);
    assert_eq!((session.poll(seconds(3.0)), session.stage()), (None, "reading"));
}

/// Gives the response of GetNodeInfo: of this version and CRC, in this mode.
fn tell(session: &mut Session, now: f32, mode: Mode, software: (u8, u8), crc: Option<u64>) {
    assert_eq!(session.poll(seconds(now)), Some(Action::Request(Message::NodeInfoRequest)));
    let status = NodeStatus { mode, ..NodeStatus::default() };
    let info: NodeInfo = NodeInfo { status, software, image_crc: crc, ..NodeInfo::default() };
    take(session, &service(1, false, info.encode()), now);
}

/// What the node says after it has read all of the file, or has not, and how the update ends.
#[test]
fn the_mode_the_version_and_the_crc_of_the_node_decide() {
    const ALL: &[u16] = &[0, 256, 0];
    use Mode::{Maintenance, Operational};
    let (plain, with_crc) = (file_of(300), file_with_crc(300, 0x1234));
    let not_started = "its bootloader does not start it";
    for (file, reads, mode, software, crc, failure) in [
        (&plain, &[0][..], Maintenance, (0, 0), None, "it has not read all"),
        (&plain, &[0], Operational, (1, 2), None, "runs version 1.2, which is not the file"),
        (&plain, ALL, Operational, (0, 0), None, "runs version 0.0, and the file has 1.3"),
        (&with_crc, ALL, Maintenance, (1, 3), Some(0x1234), not_started),
        (&with_crc, ALL, Maintenance, (0, 0), None, "what it read is not a valid program"),
        (&with_crc, ALL, Operational, (1, 3), Some(0x1234), ""),
        (&with_crc, ALL, Operational, (1, 3), Some(1), "runs another program of version 1.3"),
        (&with_crc, ALL, Operational, (1, 3), None, "runs another program of version 1.3"),
    ] {
        let mut session = begun(file, ERROR_OK, reads);
        for now in [3.0, 4.0] {
            take(&mut session, &status(mode), now);
        }
        tell(&mut session, 4.0, mode, software, crc);
        match failure {
            "" => updated(&mut session, 4.0),
            failure => failed(&mut session, 4.0, failure),
        }
    }
}

#[test]
fn one_status_of_a_waiting_bootloader_before_the_restart_is_no_failure() {
    let mut session = begun(&file_with_crc(300, 0x1234), ERROR_OK, &[0, 256, 0]);
    take(&mut session, &status(Mode::Maintenance), 2.1);
    assert_eq!(session.poll(seconds(2.1)), None);
    take(&mut session, &status(Mode::Operational), 2.5);
    tell(&mut session, 2.5, Mode::Operational, (1, 3), Some(0x1234));
    updated(&mut session, 2.6);
}

/// The program before this one was stopped, and its node ID is taken over.
#[test]
fn an_update_that_was_broken_off_continues_and_the_node_s_crc_decides() {
    let file = file_with_crc(600, 0x1234);
    for (crc, end) in [(0x1234, updated as fn(&mut Session, f32)), (1, begins_again)] {
        let mut session = begun(&file, ERROR_IN_PROGRESS, &[512]);
        assert_eq!((session.sent(), session.stage()), (600, "restarting"));
        read(&mut session, 0);
        take(&mut session, &status(Mode::Operational), 3.0);
        tell(&mut session, 3.0, Mode::Operational, (1, 3), Some(crc));
        end(&mut session, 3.1);
    }
}

/// The parts of two files are no program: the bootloader waits, and the update begins again.
#[test]
fn a_continued_update_that_gives_no_program_begins_again() {
    let mut session = begun(&file_with_crc(600, 0x1234), ERROR_IN_PROGRESS, &[512, 0]);
    for now in [3.0, 4.0] {
        take(&mut session, &status(Mode::Maintenance), now);
    }
    tell(&mut session, 4.0, Mode::Maintenance, (0, 0), None);
    begins_again(&mut session, 4.1);
    assert_eq!(session.sent(), 0);
}

#[test]
fn a_node_that_reads_from_another_node_is_in_another_update_if_that_is_on_the_bus() {
    let file = file_of(600);
    let mut request = service(48, true, [&[0; 5][..], b"fw.bin"].concat());
    if let CanId::Service { destination, .. } = &mut request.id {
        *destination = id(126);
    }
    let mut heard = Heard::default();
    heard.note(id(126), seconds(0.5));
    for (now, is_there) in [(1.0, true), (3.0, false)] {
        let mut session = begun(&file, ERROR_IN_PROGRESS, &[]);
        assert_eq!(session.take(&request, seconds(now), &heard), None);
        if is_there {
            failed(&mut session, now, "another update is under way: node 126 sends a file");
        } else {
            assert_eq!(session.poll(seconds(now)), None);
            assert!(session.stage().contains("gives up"), "{}", session.stage());
        }
    }
}

#[test]
fn an_update_of_a_silent_node_fails_after_the_bootloader_s_timeout() {
    let mut session = begun(&file_of(600), ERROR_IN_PROGRESS, &[0]);
    take(&mut session, &status(Mode::SoftwareUpdate), 10.0);
    assert_eq!(session.poll(seconds(54.0)), None);
    failed(&mut session, 56.0, "silent");
}

#[test]
fn a_node_that_reads_the_same_part_for_ever_fails() {
    let file = file_of(600);
    for (reads, text) in [(&[0][..], "again and again"), (&[0, 256, 512, 0], "does not start it")] {
        let mut session = begun(&file, ERROR_OK, reads);
        for second in 3..62 {
            read_at(&mut session, 0, second as f32);
            assert_eq!(session.poll(seconds(second as f32)), None);
        }
        failed(&mut session, 62.1, text);
    }
}

#[test]
fn requests_of_other_nodes_or_for_other_files_are_not_answered() {
    let mut session = begun(&file_of(300), ERROR_OK, &[]);
    let request = [&[0; 5][..], b"other.bin"].concat();
    assert_eq!(take(&mut session, &service(48, true, request), 1.0), Some(vec![2, 0]));
    let mut other = service(48, true, [&[0; 5][..], b"fw.bin"].concat());
    if let CanId::Service { source, .. } = &mut other.id {
        *source = id(121);
    }
    assert_eq!(take(&mut session, &other, 1.0), None);
    assert_eq!(session.sent(), 0);
}
