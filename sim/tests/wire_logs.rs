//! Tests of the logs of the bus: Wireshark reads them, and the bench plays them again.

use crate::links::Scratch;
use crate::wire::{BIT_RATE, Rig, frames, lines, peer_frames, text};
use bench::can::{Frame, Id, Record};
use sim::links::Link;
use sim::links::log::Log;
use sim::links::script::Script;
use std::path::Path;

const RUN_MS: u64 = 60;

/// Logs a run of the node into a file. Returns the records of the bus.
fn logged(path: &Path) -> Vec<Record> {
    let mut rig = Rig::new();
    let mut log = Log::create(path, BIT_RATE).unwrap();
    let mut all = Vec::new();
    rig.run(RUN_MS, |bench, records| {
        for record in records {
            log.record(record, None).unwrap();
        }
        log.serve(bench).unwrap();
        all.extend_from_slice(records);
    });
    all
}

/// A frame in the form of tshark's fields.
fn as_fields(start_us: u64, frame: &Frame) -> String {
    let (id, extended) = match frame.id {
        Id::Standard(id) => (u32::from(id), 0),
        Id::Extended(id) => (id, 1),
    };
    let data: String = frame.data().iter().map(|byte| format!("{byte:02x}")).collect();
    let remote = u8::from(frame.remote);
    format!(
        "{}.{:06}000\t{id}\t{extended}\t{remote}\t{}\t{data}",
        start_us / 1_000_000,
        start_us % 1_000_000,
        frame.dlc
    )
}

fn assert_tshark_reads_all_frames(name: &str) {
    let scratch = Scratch::new();
    let path = scratch.path(name);
    let passed = frames(&logged(&path));
    assert!(passed.len() > peer_frames().len());
    let mut arguments = vec!["-r", text(&path), "-T", "fields"];
    for field in
        ["frame.time_epoch", "can.id", "can.flags.xtd", "can.flags.rtr", "can.len", "data.data"]
    {
        arguments.extend(["-e", field]);
    }
    let expected: Vec<_> =
        passed.iter().map(|(start, frame)| as_fields(start / 16, frame)).collect();
    // For a remote frame in a candump log, tshark shows as many zeros as its DLC says. They were
    // not on the bus.
    let without_data = |line: String| match line.rsplit_once('\t') {
        Some((fields, _)) if line.split('\t').nth(3) == Some("1") => format!("{fields}\t"),
        _ => line,
    };
    let found: Vec<_> = lines("tshark", &arguments).into_iter().map(without_data).collect();
    assert_eq!(found, expected);
}

#[test]
fn wireshark_reads_every_frame_of_a_candump_log() {
    assert_tshark_reads_all_frames("run.log");
}

#[test]
fn wireshark_reads_every_frame_of_a_pcap() {
    assert_tshark_reads_all_frames("run.pcap");
}

/// The bus has no other nodes, because they would send their frames a second time.
#[test]
fn the_log_of_a_run_with_the_node_plays_again_on_an_empty_bus() {
    let scratch = Scratch::new();
    let path = scratch.path("run.log");
    let passed = frames(&logged(&path));
    let mut bench = bench::Bench::new(BIT_RATE);
    let listener = std::rc::Rc::new(std::cell::RefCell::new(bench::can::SoftNode::new(BIT_RATE)));
    bench.attach("listener", listener);
    let mut script = Script::open(&path, &mut bench).unwrap();
    bench.run_for_ms(RUN_MS);
    script.serve(&mut bench).unwrap();
    assert_eq!(frames(&bench.bus().take_records()), passed);
}

#[test]
fn wireshark_reads_the_error_frames_of_a_pcap() {
    use bench::can::Fault;
    let scratch = Scratch::new();
    let path = scratch.path("errors.pcap");
    let mut rig = Rig::new();
    let mut log = Log::create(&path, BIT_RATE).unwrap();
    rig.run(11, |_, _| ());
    rig.bench.bus().inject(Fault::FlipBit { bit: 30 });
    rig.run(2, |bench, records| {
        for record in records {
            log.record(record, None).unwrap();
        }
        log.serve(bench).unwrap();
    });
    drop(log);
    let errors = lines(
        "tshark",
        &["-r", text(&path), "-Y", "can.flags.err == 1", "-T", "fields", "-e", "can.err.prot"],
    );
    assert_eq!(errors.len(), 1, "{errors:?}");
}
