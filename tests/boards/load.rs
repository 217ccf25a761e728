//! The node on a full bus: it loses no frame, reads all in order and leaves none in the controller,
//! and the servo is as steady as on an idle bus. All functions are active: telemetry at its highest
//! rates, a client that reads, sets and saves all parameters, and the serial monitor.
//!
//! The bus is full of frames that the filters accept: each kind alone, and all kinds at random. See
//! [`Kind::MATCHING`].
//!
//! `make bench` measures the same for longer, and writes docs/benchmarks.md.

use std::sync::LazyLock;

use rig::load::{Client, Figures, Kind, Load, Loaded, Pace, may_lose_commands, run, run_all};
use rig::profile::{Names, Profile};

/// Simulated time of each load.
const LOAD_MS: u64 = 350;
const BURSTS_MS: u64 = 400;

/// Every kind of frame back to back, at a priority above and below all of the node's frames, and in
/// bursts.
static RUNS: LazyLock<Vec<(Load, u64, Figures)>> = LazyLock::new(|| {
    let paces =
        [(0, Pace::Full, LOAD_MS), (31, Pace::Full, LOAD_MS), (31, Pace::Bursts, BURSTS_MS)];
    let loads = Kind::MATCHING
        .into_iter()
        .filter(|&kind| !may_lose_commands(kind))
        .flat_map(|kind| paces.map(|(priority, pace, ms)| (Load { kind, priority, pace }, ms)));
    run_all(&loads.collect::<Vec<_>>(), |_, _, _| ())
});

/// Fails and lists all runs for which `wrong` returns a text.
#[track_caller]
fn all(select: impl Fn(Load) -> bool, wrong: impl Fn(&Figures) -> Option<String>) {
    let selected: Vec<_> = RUNS.iter().filter(|(load, ..)| select(*load)).collect();
    assert!(!selected.is_empty());
    let mut wrong: Vec<String> = selected
        .iter()
        .filter_map(|(load, _, figures)| Some(format!("{load:?}: {}", wrong(figures)?)))
        .collect();
    wrong.sort();
    assert!(wrong.is_empty(), "{} of {} loads\n{}", wrong.len(), selected.len(), wrong.join("\n"));
}

/// Describes how the node failed to read every frame unchanged, in order, and leave none in the
/// controller. `None` if it did not fail.
fn reading_errors(figures: &Figures) -> Option<String> {
    let meter = &figures.meter;
    let least = u64::from(rig::board().fastest_bit_rate()) * 6 / 10_000;
    let wrong = meter.lost + meter.out_of_order + meter.garbled > 0
        || figures.stuck
        || meter.frames < least;
    wrong.then(|| {
        format!(
            "{} frames, {} lost, {} out of order, {} garbled{}",
            meter.frames,
            meter.lost,
            meter.out_of_order,
            meter.garbled,
            if figures.stuck { ", one stuck" } else { "" }
        )
    })
}

/// Statuses and the thesis's commands have one receive buffer only: the node must read each before
/// the next one ends. Of requests there are more than it can answer, and it rejects the rest.
#[test]
fn all_frames_back_to_back_and_in_bursts_are_read_in_order() {
    all(|_| true, reading_errors);
}

/// A margin, which is visible before a frame is lost.
#[test]
fn the_queue_of_received_frames_never_becomes_full() {
    all(
        |_| true,
        |&Figures { deepest, places, .. }| {
            (deepest == places).then(|| format!("all of its {places} places used"))
        },
    );
}

/// Cycles from the chip select of the status read that finds the frame to the end of the
/// instruction that releases its buffer.
#[test]
fn half_of_the_frames_are_read_within_450_cycles_of_the_chip_select() {
    all(
        |_| true,
        |figures| {
            let (median, max) = (figures.meter.service.median(), figures.meter.service.max());
            (median == 0 || median > 450).then(|| format!("median {median}, max {max} cycles"))
        },
    );
}

#[test]
fn all_frames_are_read_within_1250_cycles_of_their_end() {
    all(
        // With all features the queue can be full for a moment, because some of these are
        // one-frame commands. No frame is lost.
        |load| !(load.kind == Kind::Mixed && rig::has_all_features()),
        |figures| {
            let latency = &figures.meter.latency;
            (latency.max() > 1250)
                .then(|| format!("median {}, max {} cycles", latency.median(), latency.max()))
        },
    );
}

#[test]
fn no_frame_takes_more_than_two_chip_selects_and_nine_bytes_besides_its_data() {
    all(
        |_| true,
        |figures| {
            let (selects, overhead) = (figures.meter.selects.max(), figures.meter.overhead.max());
            (selects > 2 || overhead > 9)
                .then(|| format!("{selects} chip selects, {overhead} bytes besides the data"))
        },
    );
}

/// Measured from the end of the command's last frame. With all features a frame costs more, so on
/// a full bus the outputs wait for a gap between frames, for up to 2 ms.
#[test]
fn every_command_of_one_frame_or_nine_is_in_the_servo_s_register_soon_after_its_end() {
    let is_slower_than = |max_us: u32| {
        move |figures: &Figures| {
            let to_servo = &figures.command_to_servo;
            let (moves, max) = (to_servo.values().len(), to_servo.max() / 16);
            (moves < 40 || max > max_us)
                .then(|| format!("{moves} commands, the slowest after {max} us"))
        }
    };
    // These loads fill the bus for a while.
    let most_us = if rig::has_all_features() { 2000 } else { 500 };
    all(|load| load.kind.moves_servo(), is_slower_than(most_us));
}

/// On a bus full of commands of one frame (8,700 a second, 1,840 cycles each) the node reads all,
/// and follows the newest (docs/decisions.md). Up to three quarters of that rate it follows all.
#[test]
fn commands_of_one_frame_are_all_read_and_up_to_three_quarters_of_a_full_bus_followed() {
    for kind in [Kind::Position, Kind::Command(5), Kind::Thesis] {
        let load = |pace| Load { kind, priority: 31, pace };
        // Frames a second; the thesis's commands are shorter.
        let cycles = match kind {
            Kind::Thesis => 1800,
            // With all features a conversion from radians takes 70 cycles too long for three
            // quarters of the rate.
            Kind::Position if rig::has_all_features() => 2600,
            _ => 2400,
        };
        let figures = run(load(Pace::Every(cycles)), LOAD_MS);
        assert_eq!(reading_errors(&figures), None, "{kind:?}");
        assert!(
            figures.command_to_servo.max() <= 500 * 16,
            "{kind:?}: {} cycles",
            figures.command_to_servo.max()
        );
        let full = run(load(Pace::Full), LOAD_MS);
        assert_eq!(reading_errors(&full), None, "{kind:?}");
    }
}

#[test]
fn the_pulses_of_the_servo_have_no_jitter_under_any_load() {
    const PERIOD: u64 = 320_000;
    all(
        |_| true,
        |figures| {
            let (periods, unasked) = (&figures.periods, figures.unasked_moves);
            (periods.len() != 1 || !periods.contains_key(&PERIOD) || unasked > 0)
                .then(|| format!("periods {periods:?}, {unasked} pulse widths without a command"))
        },
    );
    let steady = |figures: &Figures| {
        (figures.widths.len() != 1).then(|| format!("widths {:?}", figures.widths))
    };
    all(|load| !load.kind.moves_servo(), steady);
}

fn own(figures: &Figures) -> String {
    format!("{} frames, {} answers", figures.own_frames, figures.answers)
}

#[test]
fn the_node_s_messages_go_out_when_they_win_arbitration() {
    // The load loses every arbitration, so telemetry and answers to the client go out. A client
    // that saves gets few answers.
    all(
        |load| load.priority == 31 && !matches!(load.kind, Kind::Command(5) | Kind::Thesis),
        |figures| (figures.own_frames < 40).then(|| own(figures)),
    );
    all(
        |load| {
            // With all features a frame takes longer to handle, which leaves less time for answers.
            // A save of all its parameters takes longer than these loads.
            let is_slow = rig::has_all_features()
                && (load.pace == Pace::Full || load.kind == Kind::OpcodeRequest);
            load.priority == 31 && !is_slow && !matches!(load.kind, Kind::Command(5) | Kind::Thesis)
        },
        |figures| (figures.answers == 0).then(|| own(figures)),
    );
    // Commands leave the least time, because each frame is a whole command.
    all(|load| load.priority == 31, |figures| (figures.own_frames < 5).then(|| own(figures)));
    // A load that wins every arbitration: the node's frames go out after it.
    all(
        |load| load.priority == 0 && load.pace == Pace::Full,
        |figures| (figures.own_frames == 0).then(|| own(figures)),
    );
}

#[test]
#[ignore = "takes long: make test-all"]
fn its_status_goes_out_each_second_on_a_full_bus() {
    for kind in [Kind::Command(5), Kind::Status(8)] {
        let mut loaded =
            Loaded::new(Some(Load { kind, priority: 31, pace: Pace::Full }), Client::Walking);
        loaded.run_ms(2200);
        // The node answers an autopilot's statuses with its own, so there may be more than two.
        assert!(
            (2..=5).contains(&loaded.figures.own_statuses),
            "{kind:?}: {} in 2.2 s",
            loaded.figures.own_statuses
        );
    }
}

/// Runs a load of one frame every `period` cycles, which must leave time for all other work.
fn assert_other_work_is_done(kind: Kind, period: u64) -> Figures {
    let mut loaded =
        Loaded::new(Some(Load { kind, priority: 31, pace: Pace::Every(period) }), Client::Walking);
    loaded.run_ms(2200);
    let figures = loaded.finish();
    let Figures { own_frames, own_statuses, answers, .. } = figures;
    assert!(
        own_statuses >= 2 && own_frames > 300 && answers > 25,
        "a frame each {period} cycles: {own_statuses} statuses, {own_frames} frames, {answers} \
         answers in 2.2 s"
    );
    figures
}

#[test]
#[ignore = "takes long: make test-all"]
fn incomplete_commands_leave_time_for_its_other_work() {
    for period in [2500, 10_000] {
        assert_other_work_is_done(Kind::Beginning, period);
    }
}

/// At 125 kbit/s a frame takes a millisecond, through an adapter on a serial port at 115,200 baud
/// 2.3 ms.
#[test]
#[ignore = "takes long: make test-all"]
fn slow_commands_leave_time_for_its_other_work() {
    for period in [16_000, 36_800] {
        let max = assert_other_work_is_done(Kind::LongCommand, period).command_to_servo.max() / 16;
        assert!(
            max <= 500,
            "a frame each {period} cycles: {max} us from the end of a command to the servo's \
             register"
        );
    }
}

#[test]
#[ignore = "takes long: make test-all"]
fn a_bus_full_of_frames_for_other_nodes_costs_no_time() {
    let run = |load| {
        let mut loaded = Loaded::new(load, Client::None);
        let profile = Profile::begin(loaded.rig.board().avr_mut());
        loaded.run_ms(700);
        let (_, mean, _) = profile.turns();
        (loaded.finish(), mean)
    };
    let (silent, silent_mean) = run(None);
    let (full, full_mean) = run(Some(Load { kind: Kind::Foreign, priority: 31, pace: Pace::Full }));
    assert_eq!(
        (full.meter.frames, full.meter.lost),
        (0, 0),
        "no frame for another node may pass the filters"
    );
    assert_eq!(
        full.meter.fetched_bytes, silent.meter.fetched_bytes,
        "bytes on the SPI to read frames"
    );
    assert!(
        full_mean.abs_diff(silent_mean) * 50 <= silent_mean,
        "a turn takes {full_mean} cycles, not {silent_mean}"
    );
    assert!(full.own_frames.abs_diff(silent.own_frames) <= 3 && full.own_frames > 60);
}

#[test]
fn no_turn_of_the_main_loop_takes_longer_than_250_us_with_everything_at_once() {
    let names = Names::of_node();
    for load in [
        Load { kind: Kind::LongCommand, priority: 31, pace: Pace::Bursts },
        Load { kind: Kind::Command(5), priority: 31, pace: Pace::Full },
    ] {
        let mut loaded = Loaded::new(Some(load), Client::Saving);
        let profile = Profile::begin(loaded.rig.board().avr_mut());
        loaded.run_ms(1200);
        let (turns, _, worst) = profile.turns();
        assert!(turns > 1000);
        let tasks: Vec<String> = profile
            .tasks(&names)
            .iter()
            .map(|share| format!("{} {}", share.cycles, share.name))
            .collect();
        assert!(worst <= 4000, "{load:?}: a turn of {worst} cycles\n{}", tasks.join("\n"));
    }
}
