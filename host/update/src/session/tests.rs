//! Tests of the update of one node.

use super::*;
use crate::file::tests::{file_of, file_with_crc};
use dronecan_host::{CanId, TransferId};

fn id(id: u8) -> NodeId {
    NodeId::new(id).unwrap()
}

fn seconds(seconds: f32) -> Duration {
    Duration::from_secs_f32(seconds)
}

fn session(file: &FirmwareFile) -> Session<'_> {
    Session::new(id(120), (1, 2), file, id(125), Duration::ZERO)
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

fn read(session: &mut Session, offset: u16) -> Vec<u8> {
    read_at(session, offset, 2.0)
}

fn read_at(session: &mut Session, offset: u16, now: f32) -> Vec<u8> {
    let [low, high] = offset.to_le_bytes();
    let request = [&[low, high, 0, 0, 0][..], b"fw.bin"].concat();
    session.take(&service(48, true, request), seconds(now)).unwrap()
}

fn begin(session: &mut Session, number: u8, text: &[u8]) {
    assert!(matches!(session.poll(Duration::ZERO), Some(Action::Request(Message::BeginUpdate(_)))));
    let response = NumberAndText { number, text: text.to_vec() }.encode();
    assert_eq!(session.take(&service(40, false, response), seconds(0.1)), None);
}

#[track_caller]
fn failed(session: &mut Session, now: f32, text: &str) {
    match session.poll(seconds(now)) {
        Some(Action::End(Outcome::Failed(why))) => assert!(why.contains(text), "{why}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_node_that_reads_the_file_and_runs_it_is_updated() {
    let file = file_of(600);
    let mut session = session(&file);
    begin(&mut session, ERROR_OK, b"");
    session.take(&status(Mode::Operational), seconds(0.2));
    let answers: Vec<_> = [0, 256, 512].map(|offset| read(&mut session, offset)).to_vec();
    assert_eq!(answers.iter().map(Vec::len).collect::<Vec<_>>(), [258, 258, 90]);
    assert_eq!(
        answers.iter().flat_map(|answer| &answer[2..]).copied().collect::<Vec<_>>(),
        file.bytes
    );
    assert_eq!((session.sent(), session.stage()), (600, "restarting"));
    session.take(&status(Mode::SoftwareUpdate), seconds(2.5));
    assert_eq!(session.poll(seconds(2.6)), None);
    session.take(&status(Mode::Operational), seconds(3.0));
    assert_eq!(session.poll(seconds(3.0)), Some(Action::Request(Message::NodeInfoRequest)));
    let info: NodeInfo = NodeInfo { software: (1, 3), ..NodeInfo::default() };
    session.take(&service(1, false, info.encode()), seconds(3.5));
    let text = "runs version 1.3, before 1.2; 3.5 s".to_owned();
    assert_eq!(session.poll(seconds(3.5)), Some(Action::End(Outcome::Updated(text))));
}

#[test]
fn a_node_s_reason_for_a_rejection_is_reported() {
    let file = file_of(600);
    let mut session = session(&file);
    begin(&mut session, ERROR_INVALID_MODE, b"armed, or a command in the last 2 s");
    failed(&mut session, 0.1, "refuses: armed, or a command");
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

#[test]
fn a_node_in_its_bootloader_or_old_program_counts_as_not_updated() {
    let file = file_of(600);
    for (mode, text) in [
        (Mode::Maintenance, "waits in its bootloader"),
        (Mode::Operational, "runs its old program"),
    ] {
        let mut session = session(&file);
        begin(&mut session, ERROR_OK, b"");
        read(&mut session, 0);
        session.take(&status(mode), seconds(3.0));
        failed(&mut session, 3.0, text);
    }
}

#[test]
fn an_update_of_a_silent_node_fails_after_the_bootloader_s_timeout() {
    let file = file_of(600);
    let mut session = session(&file);
    begin(&mut session, ERROR_IN_PROGRESS, b"");
    read(&mut session, 0);
    session.take(&status(Mode::SoftwareUpdate), seconds(10.0));
    assert_eq!(session.poll(seconds(54.0)), None);
    failed(&mut session, 56.0, "silent");
}

#[test]
fn a_node_that_reads_the_same_part_for_ever_fails() {
    let file = file_of(600);
    for parts in [1, 3] {
        let mut session = session(&file);
        begin(&mut session, ERROR_OK, b"");
        for part in 0..parts {
            read(&mut session, part * 256);
        }
        for second in 3..62 {
            read_at(&mut session, 0, second as f32);
            assert_eq!(session.poll(seconds(second as f32)), None);
        }
        let text = if parts == 3 { "does not start it" } else { "again and again" };
        failed(&mut session, 62.1, text);
    }
}

#[test]
fn a_node_that_runs_another_image_of_the_same_version_is_not_updated() {
    let file = file_with_crc(300, 0x1234);
    for (image_crc, is_updated) in [(Some(0x1234), true), (Some(1), false), (None, false)] {
        let mut session = session(&file);
        begin(&mut session, ERROR_OK, b"");
        read(&mut session, 0);
        read(&mut session, 256);
        session.take(&status(Mode::Operational), seconds(3.0));
        let info: NodeInfo = NodeInfo { software: (1, 3), image_crc, ..NodeInfo::default() };
        session.take(&service(1, false, info.encode()), seconds(3.1));
        if is_updated {
            let end = session.poll(seconds(3.2));
            assert!(matches!(end, Some(Action::End(Outcome::Updated(_)))), "{end:?}");
        } else {
            failed(&mut session, 3.2, "runs another program of version 1.3");
        }
    }
}

#[test]
fn an_update_to_another_version_fails() {
    let file = file_of(300);
    let mut session = session(&file);
    begin(&mut session, ERROR_OK, b"");
    read(&mut session, 0);
    read(&mut session, 256);
    session.take(&status(Mode::Operational), seconds(3.0));
    session.take(&service(1, false, NodeInfo::<NodeStatus>::default().encode()), seconds(3.1));
    failed(&mut session, 3.2, "runs version 0.0, and the file has 1.3");
}

#[test]
fn requests_of_other_nodes_or_for_other_files_are_not_answered() {
    let file = file_of(300);
    let mut session = session(&file);
    begin(&mut session, ERROR_OK, b"");
    let request = [&[0; 5][..], b"other.bin"].concat();
    assert_eq!(session.take(&service(48, true, request), seconds(1.0)), Some(vec![2, 0]));
    let other = CanId::Service {
        priority: 16,
        service_id: 48,
        request: true,
        destination: id(125),
        source: id(121),
    };
    assert_eq!(
        session.take(&transfer(other, [&[0; 5][..], b"fw.bin"].concat()), seconds(1.0)),
        None
    );
    assert_eq!(session.sent(), 0);
}
