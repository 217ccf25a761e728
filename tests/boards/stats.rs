//! The counters of CanStats and GetTransportStats, for firmwares that have them.

use bench::Cycles;
use bench::can::{ErrorState, Fault, Id};
use bench::dronecan::{CanStats, Message};
use rig::{ARRAY_COMMAND, MS, NODE, Program, Rig, US, is_from_node};

const PROGRAM: Program = Program::Full;

fn stats(rig: &Rig) -> Vec<(Cycles, CanStats)> {
    rig.node_messages(|message| match message {
        Message::CanStats(stats) => Some(stats),
        _ => None,
    })
}

#[test]
fn can_stats_are_sent_at_stats_rate_and_count_frames() {
    let mut rig = PROGRAM.running();
    rig.set("STATS_RATE", 2);
    rig.forget();
    for _ in 0..300 {
        rig.send_command(1, 0, 0.5);
        rig.run_ms(10);
    }
    let reported = stats(&rig);
    assert!((5..=7).contains(&reported.len()), "{} in 3 s", reported.len());
    let ((from, first), (to, last)) = (reported[0], reported[reported.len() - 1]);
    let within = |id: u32| {
        rig.traffic.iter().filter(move |(at, frame)| {
            (from..to).contains(at) && matches!(frame.id, Id::Extended(other) if other & 0x7F == id)
        })
    };
    let (sent, received) = (within(NODE).count() as u32, within(10).count() as u32);
    let tx = u32::from(last.tx_success.wrapping_sub(first.tx_success));
    assert!(tx.abs_diff(sent) <= 8, "{tx} of {sent} frames sent");
    assert!((last.tx_requests - first.tx_requests).abs_diff(sent) <= 8);
    assert!(
        (last.rx_received - first.rx_received).abs_diff(received) <= 2,
        "{first} {last}, {received}"
    );
    for stats in [first, last] {
        assert_eq!(
            (stats.interface, stats.tx_rejected, stats.tx_timedout, stats.rx_overflow),
            (0, 0, 0, 0)
        );
        assert_eq!((stats.rx_errors, stats.busoff_errors), (0, 0));
    }
}

#[test]
fn can_stats_count_lost_and_dropped_frames() {
    let mut rig = PROGRAM.running();
    rig.overflows_expected = true;
    rig.set("STATS_RATE", 5);
    rig.run_ms(300);
    assert_eq!(stats(&rig).last().unwrap().1.rx_overflow, 0);
    assert!(rig.lose_frames() > 5);
    rig.run_ms(300);
    assert!(stats(&rig).last().unwrap().1.rx_overflow > 0);
    rig.connect_node(false);
    rig.run_ms(3000);
    rig.connect_node(true);
    rig.forget();
    rig.run_ms(1500);
    let (_, last) = *stats(&rig).last().expect("statistics again");
    assert!(last.tx_timedout + last.tx_abort > 0, "{last}");
}

/// Also those of 1.4 ms, the shortest time.
#[test]
fn every_bus_off_is_counted_and_logged() {
    let mut rig = PROGRAM.running();
    rig.set("STATS_RATE", 10);
    rig.set("TELEM_RATE", 50);
    let mut bus_offs = 0;
    // As long as it takes at 1 Mbit/s.
    let slower = 1_000_000 / u64::from(rig::board().fastest_bit_rate());
    for lasts_ms in [2, 4, 9, 31, 110, 1300].map(|ms| ms * slower) {
        rig.serial.clear();
        rig.bench.bus().inject(Fault::DestroyFrames(true));
        let (mut was_off, before, end) = (false, bus_offs, rig.now() + lasts_ms * MS);
        // The last one may begin with the frame that is on the bus at the end.
        while rig.now() < end + 2 * MS {
            if rig.now() >= end {
                rig.bench.bus().inject(Fault::DestroyFrames(false));
            }
            rig.run_until(rig.now() + 50 * US);
            let is_off = rig.board().chip().borrow().error_state() == ErrorState::BusOff;
            bus_offs += u16::from(is_off && !was_off);
            was_off = is_off;
        }
        // Nobody else sends, so that the node tries its frames in a part of each second only.
        rig.run_ms(1500);
        let (_, last) = *stats(&rig).last().expect("statistics again");
        assert_eq!(last.busoff_errors, bus_offs, "after {lasts_ms} ms of destroyed frames");
        assert_eq!(rig.serial.contains("CAN H/L: bus-off"), bus_offs > before, "{}", rig.serial);
    }
    // Few: after the first of each time the controller tries one to three frames a second, once.
    assert!(bus_offs > 4, "{bus_offs}");
}

#[test]
fn transport_stats_count_transfers_and_frames() {
    let mut rig = PROGRAM.running();
    let stats = |rig: &mut Rig| match rig.ask(&Message::TransportStatsRequest) {
        Message::TransportStats(stats) => stats,
        other => panic!("{other}"),
    };
    let before = stats(&mut rig);
    assert_eq!(before.interfaces.len(), 1);
    rig.forget();
    for _ in 0..20 {
        rig.send_command(1, 0, 0.5);
        rig.run_ms(10);
    }
    rig.send_commands(&[(2, 0, 0.5), (3, 0, 0.5), (4, 0, 0.0)]);
    rig.run_ms(1000);
    // A transfer that is not completed, and a new one from the same sender.
    rig.send(ARRAY_COMMAND | 10, &[1, 0, 0, 0, 1, 0, 0, 0x80]);
    rig.send(ARRAY_COMMAND | 10, &[1, 0, 0, 0, 1, 0, 0, 0x81]);
    rig.run_ms(20);
    let sent_frames = rig.traffic.iter().filter(|(_, frame)| is_from_node(frame)).count() as u64;
    let after = stats(&mut rig);
    let [tx, rx, errors] = after.interfaces[0];
    let [tx_before, rx_before, errors_before] = before.interfaces[0];
    assert_eq!(
        after.transfers_rx - before.transfers_rx,
        22,
        "20 one-frame commands, a long one, and this request"
    );
    assert!(after.transfers_tx > before.transfers_tx);
    assert!(after.transfer_errors > before.transfer_errors);
    // The previous answer was still being sent when the node counted.
    assert!((tx - tx_before).abs_diff(sent_frames) <= 12, "{} of {sent_frames}", tx - tx_before);
    assert_eq!(rx - rx_before, 20 + 2 + 2 + 1);
    assert_eq!(errors, errors_before);
}
