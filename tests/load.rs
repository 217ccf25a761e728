//! The node on a full bus: no frame lost, none stuck, none out of order, and the servo as steady as in silence. Everything is on
//! meanwhile: telemetry at its highest rates, a client that walks, sets and saves the parameters, the light, the serial monitor.
//!
//! `make bench` measures the same for longer, and writes the figures down.

mod rig;

use std::sync::LazyLock;

use rig::ARRAY_COMMAND;
use rig::load::{Client, Figures, Kind, Load, Loaded, Pace, long_command, run_all};
use rig::profile::{Names, Profile};

/// Simulated time of each load.
const LOAD_MS: u64 = 2000;
const BURSTS_MS: u64 = 2500;

/// Every kind of frame at a priority above and below all of the node's own, back to back and in bursts.
static RUNS: LazyLock<Vec<(Load, u64, Figures)>> = LazyLock::new(|| {
    let kinds = Kind::MATCHING.into_iter().flat_map(|kind| [(kind, 0), (kind, 31)]);
    let paces = [(Pace::Full, LOAD_MS), (Pace::Bursts, BURSTS_MS)];
    let loads = kinds.flat_map(|(kind, priority)| paces.map(|(pace, ms)| (Load { kind, priority, pace }, ms)));
    run_all(&loads.collect::<Vec<_>>(), |_, _, _| ())
});

/// Fails with all runs for which `wrong` has something to say.
#[track_caller]
fn all(select: impl Fn(Load) -> bool, wrong: impl Fn(&Figures) -> Option<String>) {
    let selected: Vec<_> = RUNS.iter().filter(|(load, ..)| select(*load)).collect();
    assert!(!selected.is_empty());
    let mut wrong: Vec<String> =
        selected.iter().filter_map(|(load, _, figures)| Some(format!("{load:?}: {}", wrong(figures)?))).collect();
    wrong.sort();
    assert!(wrong.is_empty(), "{} of {} loads\n{}", wrong.len(), selected.len(), wrong.join("\n"));
}

/// Every frame read as it was sent, in the order of the bus, and none left behind.
fn incomplete(figures: &Figures) -> Option<String> {
    let meter = &figures.meter;
    let wrong = meter.lost + meter.out_of_order + meter.garbled > 0 || figures.stuck || meter.frames < 1000;
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

#[test]
fn commands_of_every_length_back_to_back_are_all_read_in_order() {
    all(|load| matches!(load.kind, Kind::Command(_)) && load.pace == Pace::Full, incomplete);
}

#[test]
fn commands_of_nine_frames_back_to_back_are_all_read_in_order() {
    all(|load| matches!(load.kind, Kind::LongCommand | Kind::Beginning) && load.pace == Pace::Full, incomplete);
}

/// They have one buffer only, and each must be out of it before the next one ends.
#[test]
fn statuses_and_the_thesis_s_commands_back_to_back_are_all_read_in_order() {
    all(|load| matches!(load.kind, Kind::Status(_) | Kind::Thesis) && load.pace == Pace::Full, incomplete);
}

/// More than can be answered: those are read and refused.
#[test]
fn requests_back_to_back_are_all_read_in_order() {
    all(|load| load.kind.is_request() && load.pace == Pace::Full, incomplete);
}

#[test]
fn bursts_of_frames_after_silence_are_all_read_in_order() {
    all(|load| load.pace == Pace::Bursts, incomplete);
}

/// From the chip select of the look that finds the frame to the end of the instruction that releases its buffer.
#[test]
fn half_of_the_frames_are_out_of_the_controller_within_450_cycles_of_the_chip_select() {
    all(
        |_| true,
        |figures| {
            let (median, max) = (figures.meter.service.median(), figures.meter.service.max());
            (median == 0 || median > 450).then(|| format!("median {median}, max {max} cycles"))
        },
    );
}

#[test]
fn all_frames_are_out_of_the_controller_within_1250_cycles_of_their_end() {
    all(
        |_| true,
        |figures| {
            let latency = &figures.meter.latency;
            (latency.max() > 1250).then(|| format!("median {}, max {} cycles", latency.median(), latency.max()))
        },
    );
}

#[test]
fn no_frame_takes_more_than_two_chip_selects_and_nine_bytes_besides_its_data() {
    all(
        |_| true,
        |figures| {
            let (selects, overhead) = (figures.meter.selects.max(), figures.meter.overhead.max());
            (selects > 2 || overhead > 9).then(|| format!("{selects} chip selects, {overhead} bytes besides the data"))
        },
    );
}

/// Fails unless the middle one of the commands, and the slowest, are in the servo's register within so many microseconds.
#[track_caller]
fn in_the_register(select: impl Fn(Load) -> bool, median_us: u32, max_us: u32) {
    all(select, |figures| {
        let to_servo = &figures.command_to_servo;
        let (moves, median, max) = (to_servo.values().len(), to_servo.median() / 16, to_servo.max() / 16);
        (moves < 100 || median > median_us || max > max_us)
            .then(|| format!("{moves} commands, the middle one after {median} us, the slowest after {max} us"))
    });
}

#[test]
fn every_command_of_a_single_frame_is_in_the_servo_s_register_within_100_us_of_its_end() {
    in_the_register(|load| load.kind.moves() && load.kind != Kind::LongCommand, 70, 100);
}

/// What can be in the way is a request to set a parameter, between its last two frames.
#[test]
fn every_command_of_nine_frames_is_in_the_servo_s_register_within_130_us_of_its_end_and_half_within_95() {
    in_the_register(|load| load.kind == Kind::LongCommand && load.pace == Pace::Full, 95, 130);
}

/// A silence in its middle is waited for no longer than 0.2 ms; then a step of something else can be in the way.
#[test]
fn every_command_of_nine_frames_with_silences_in_it_is_in_the_servo_s_register_within_170_us_of_its_end() {
    in_the_register(|load| load.kind == Kind::LongCommand && load.pace == Pace::Bursts, 95, 170);
}

#[test]
fn the_pulses_of_the_servo_have_no_jitter_under_any_load() {
    const PERIOD: u64 = 320_000;
    all(
        |_| true,
        |figures| {
            let (periods, unasked) = (&figures.periods, figures.unasked_moves);
            (periods.len() != 1 || !periods.contains_key(&PERIOD) || unasked > 0)
                .then(|| format!("periods {periods:?}, {unasked} moves that nobody asked for"))
        },
    );
    let steady = |figures: &Figures| (figures.widths.len() != 1).then(|| format!("widths {:?}", figures.widths));
    all(|load| !load.kind.moves(), steady);
}

#[test]
fn the_node_s_own_messages_go_out_when_arbitration_lets_them() {
    // A load that loses every arbitration: telemetry, and answers to the client.
    all(
        |load| load.priority == 31 && load.kind != Kind::Thesis,
        |figures| {
            let (frames, answers) = (figures.own_frames, figures.answers);
            (frames < 200 || answers < 20).then(|| format!("{frames} frames, {answers} answers"))
        },
    );
    // The thesis's commands leave the least time: each is a whole command, in the shortest frame that can be one.
    all(
        |load| load.priority == 31 && load.kind == Kind::Thesis,
        |figures| (figures.own_frames < 100).then(|| format!("{} frames", figures.own_frames)),
    );
    // One that wins every arbitration: what waited goes out after it.
    all(
        |load| load.priority == 0 && load.pace == Pace::Full,
        |figures| (figures.own_frames == 0).then(|| "nothing".to_owned()),
    );
}

#[test]
fn its_status_goes_out_each_second_on_a_full_bus() {
    for kind in [Kind::Command(8), Kind::Status(8), Kind::Foreign] {
        let mut loaded = Loaded::new(Some(Load { kind, priority: 31, pace: Pace::Full }), Client::Walking);
        loaded.run_ms(5200);
        // To an autopilot's statuses it answers with its own, so there may be more.
        assert!((5..=11).contains(&loaded.figures.own_statuses), "{kind:?}: {} in 5.2 s", loaded.figures.own_statuses);
    }
}

/// While a command of several frames is coming, the node leaves other things for later, but not for ever.
#[test]
fn commands_that_never_end_do_not_keep_it_from_its_other_work() {
    for period in [2500, 4000, 6000, 10_000] {
        let load = Load { kind: Kind::Beginning, priority: 31, pace: Pace::Every(period) };
        let mut loaded = Loaded::new(Some(load), Client::Walking);
        loaded.run_ms(3200);
        let Figures { own_frames, own_statuses, answers, .. } = loaded.finish();
        assert!(
            own_statuses >= 3 && own_frames > 450 && answers > 40,
            "a beginning each {period} cycles: {own_statuses} statuses, {own_frames} frames, {answers} answers in 3.2 s"
        );
    }
}

/// The half of it that came is waited upon for 0.2 ms, not whenever something else comes.
#[test]
fn a_command_that_was_given_up_half_way_slows_nothing_down() {
    let answers = |with_a_beginning: bool| {
        let load = Load { kind: Kind::Status(8), priority: 31, pace: Pace::Every(10_000) };
        let mut loaded = Loaded::new(Some(load), Client::Walking);
        if with_a_beginning {
            loaded.rig.send(ARRAY_COMMAND | 20, &long_command(1500.0, 0)[0]);
        }
        loaded.run_ms(2000);
        loaded.finish().answers
    };
    let (before, after) = (answers(false), answers(true));
    assert!(before > 100 && after * 50 >= before * 49, "{after} answers, not {before}");
}

#[test]
fn a_bus_full_of_frames_for_others_costs_nothing() {
    let run = |load| {
        let mut loaded = Loaded::new(load, Client::None);
        let profile = Profile::begin(loaded.rig.board().avr_mut());
        loaded.run_ms(1200);
        let (_, mean, _) = profile.turns();
        (loaded.finish(), mean)
    };
    let (silent, silent_mean) = run(None);
    let (full, full_mean) = run(Some(Load { kind: Kind::Foreign, priority: 31, pace: Pace::Full }));
    assert_eq!((full.meter.frames, full.meter.lost), (0, 0), "frames for others that came through the filters");
    assert_eq!(full.meter.fetched_bytes, silent.meter.fetched_bytes, "bytes on the SPI to read frames");
    assert!(full_mean.abs_diff(silent_mean) * 50 <= silent_mean, "a turn takes {full_mean} cycles, not {silent_mean}");
    assert!(full.own_frames.abs_diff(silent.own_frames) <= 3 && full.own_frames > 100);
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
        loaded.run_ms(3000);
        let (turns, _, worst) = profile.turns();
        assert!(turns > 1000);
        let tasks: Vec<String> =
            profile.tasks(&names).iter().map(|share| format!("{} {}", share.cycles, share.name)).collect();
        assert!(worst <= 4000, "{load:?}: a turn of {worst} cycles\n{}", tasks.join("\n"));
    }
}
