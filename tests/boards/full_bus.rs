//! A full bus of valid transfers with random values, for each program that ships: no frame is lost,
//! the outputs follow the newest commands, and the node's other work goes on.
//!
//! `make bench` runs the same floods for ten simulated minutes each.

use std::sync::LazyLock;

use rig::flood::{Flood, Outcome, Pace, Preset, Scenario, Setup, Source, Traffic, Unit, run};
use rig::{US, parallel};

/// Simulated time of each flood.
const FLOOD_MS: u64 = 400;

type Run = (Scenario, Outcome);

/// Floods of each kind from one sender, and of all kinds at random from two senders, at a priority
/// above the node's, and in bursts.
static FULL: LazyLock<Vec<Run>> = LazyLock::new(|| {
    let of = |setup: Setup| {
        let each = Traffic::all(setup).into_iter().map(move |kind| Scenario::full(setup, kind));
        let mixed = Scenario::full(setup, Traffic::Mixed);
        each.chain([
            Scenario { senders: 2, seed: 2, ..mixed },
            Scenario { priority: 0, seed: 3, ..mixed },
            Scenario { pace: Pace::Bursts, seed: 4, ..mixed },
        ])
    };
    run_all(setups().flat_map(of).collect(), FLOOD_MS)
});

/// The programs for the chip of the board under test.
fn setups() -> impl Iterator<Item = Setup> {
    let chip = rig::board().chip;
    Setup::ALL.into_iter().filter(move |setup| setup.chip() == chip)
}

fn run_all(scenarios: Vec<Scenario>, ms: u64) -> Vec<Run> {
    parallel::each(&scenarios, |scenario| (*scenario, run(*scenario, ms)))
}

/// Fails and lists all runs for which `wrong` returns a text.
#[track_caller]
fn assert_none(runs: &[Run], wrong: impl Fn(Scenario, &Outcome) -> Option<String>) {
    assert!(!runs.is_empty());
    let wrong: Vec<String> = runs
        .iter()
        .filter_map(|(scenario, outcome)| {
            let Scenario { setup, traffic, senders, priority, pace, .. } = scenario;
            let text = wrong(*scenario, outcome)?;
            Some(format!(
                "{setup}: {traffic:?}, senders {senders}, priority {priority}, {pace:?}: {text}"
            ))
        })
        .collect();
    assert!(wrong.is_empty(), "{} of {} floods\n{}", wrong.len(), runs.len(), wrong.join("\n"));
}

/// The controller has room for two frames, with one output of some types for one.
#[test]
fn no_frame_of_a_valid_transfer_is_lost() {
    assert_none(&FULL, |scenario, outcome| {
        let (frames, lost) = (outcome.frames(), outcome.meter.lost);
        // The longest frames last 160 us.
        let is_full = frames > FLOOD_MS * 1000 / 165 && outcome.busy_percent > 99.0;
        let is_load = is_full || scenario.pace == Pace::Bursts && frames > FLOOD_MS;
        let reports = outcome.reports_loss != Some(false) && scenario.setup.is_v0();
        (lost > 0 || reports || !is_load)
            .then(|| format!("{lost} of {frames} frames lost, the node reports a loss: {reports}"))
    });
}

/// Without INT the node asks the controller in each turn of its main loop, and a turn may take
/// longer than a frame. docs/trouble.md has the figures.
#[test]
fn without_int_a_full_bus_loses_some_frames() {
    let scenarios: Vec<Scenario> =
        setups().map(|setup| Scenario::full(setup, Traffic::Mixed)).collect();
    let outcomes = parallel::each(&scenarios, |scenario| {
        let mut rig = scenario.setup.running();
        rig.board().set_stuck_int(Some(true));
        rig.run_ms(50);
        let mut flood = Flood::with_rig(*scenario, rig);
        flood.run_ms(FLOOD_MS);
        flood.finish()
    });
    let runs: Vec<Run> = scenarios.into_iter().zip(outcomes).collect();
    assert_none(&runs, |scenario, outcome| {
        let (frames, lost) = (outcome.frames(), outcome.meter.lost);
        let percent = 100 * lost / frames;
        println!("{}: {lost} of {frames} frames lost, {percent} %", scenario.setup);
        let limit = if scenario.setup.outputs() == 1 { 15 } else { 40 };
        (percent > limit).then(|| format!("{lost} of {frames} frames lost"))
    });
}

/// A margin, which is visible before a frame is lost.
#[test]
fn the_queue_of_received_frames_never_becomes_full() {
    assert_none(&FULL, |_, Outcome { deepest, places, .. }| {
        (deepest == places || *deepest == 0).then(|| format!("{deepest} of {places} places used"))
    });
}

#[test]
fn frames_leave_the_controller_in_time_and_in_order() {
    assert_none(&FULL, |scenario, outcome| {
        // With several outputs each frame has two buffers, which the shortest two fill in 2,784.
        let limit = match scenario.setup {
            setup if setup.outputs() > 1 => 2000,
            setup if setup.preset == Preset::Full => 1600,
            _ => 1250,
        };
        let (longest, wrong) = (outcome.meter.latency.max(), outcome.meter.out_of_order);
        (longest > limit || wrong > 0)
            .then(|| format!("{longest} cycles at the longest, {wrong} out of order"))
    });
}

/// Longest time from the end of a command's last frame until the output has its value or a newer
/// one, in microseconds. With several outputs the frames leave too little time to follow each
/// command of a full bus, so the output whose pulse comes next is first (docs/decisions.md).
fn latest_us(setup: Setup) -> u64 {
    match setup {
        setup if setup.outputs() > 1 => 4000,
        setup if setup.is_v0() => 2000,
        _ => 500,
    }
}

#[test]
fn on_a_full_bus_an_output_has_the_newest_value_within_2_ms_and_with_eight_within_4_ms() {
    assert_none(&FULL, |scenario, outcome| {
        let (count, unasked) = followed(outcome);
        let late_us = u64::from(outcome.longest_to_follow()) / US;
        let is_commanded = scenario.traffic.is_commands();
        // A motor that a command leaves out stops.
        let is_unasked = unasked > 0 && scenario.setup.motors == 0;
        let is_late = late_us > latest_us(scenario.setup);
        (is_late || is_unasked || is_commanded && count < 20).then(|| {
            format!("{count} followed, the slowest after {late_us} us, {unasked} without a command")
        })
    });
}

/// Number of commands or pulses that were followed, and of those that nobody had asked for.
fn followed(outcome: &Outcome) -> (u64, u64) {
    let register = &outcome.register;
    let pulses = outcome.pulses.iter();
    pulses.fold((register.followed, register.unasked), |(seen, unasked), pulses| {
        (seen + pulses.seen, unasked + pulses.unasked)
    })
}

/// At 90 % of the bus, with random gaps between the frames. With all features a frame costs more,
/// and a list has commands for several outputs.
#[test]
#[ignore = "takes long: make test-all"]
fn at_90_percent_of_a_full_bus_a_command_is_followed_within_1500_us() {
    let commands = setups().flat_map(|setup| {
        let commands = Traffic::all(setup).into_iter().filter(|kind| kind.is_commands());
        commands
            .map(move |kind| Scenario { pace: Pace::Percent(90), ..Scenario::full(setup, kind) })
    });
    let runs = run_all(commands.collect(), FLOOD_MS);
    assert_none(&runs, |scenario, outcome| {
        let late_us = u64::from(outcome.longest_to_follow()) / US;
        let (frames, lost) = (outcome.frames(), outcome.meter.lost);
        // The node and the client send, too.
        let is_load = (85.0..97.0).contains(&outcome.busy_percent);
        let most_us = match scenario.setup {
            setup if setup.outputs() > 1 => 1500,
            setup if setup.preset == Preset::Full => 900,
            _ => 500,
        };
        (late_us > most_us || lost > 0 || !is_load).then(|| {
            let busy = outcome.busy_percent;
            format!("{late_us} us, {lost} of {frames} frames lost at {busy:.0} %")
        })
    });
}

#[test]
fn no_output_starves_while_another_is_flooded() {
    if !rig::has_all_features() {
        return; // It has one output.
    }
    let of = |setup: Setup| Scenario::full(setup, Traffic::OneServo);
    let runs = run_all(setups().filter(|setup| setup.servos > 1).map(of).collect(), 1500);
    assert_none(&runs, |scenario, outcome| {
        let servos = &outcome.pulses[..scenario.setup.servos];
        let late = |pulses: &rig::flood::Pulses| {
            u64::from(pulses.stale.max()) > latest_us(scenario.setup) * US
        };
        let starves = servos.iter().any(|pulses| pulses.seen < 50 || late(pulses));
        let each: Vec<_> =
            servos.iter().map(|pulses| (pulses.seen, pulses.stale.max() / 16)).collect();
        starves.then(|| format!("pulses, and the slowest in us: {each:?}"))
    });
}

/// Status, telemetry, answers to a client, the serial monitor, and the period of the pulses.
#[test]
fn the_other_work_of_the_node_goes_on() {
    assert_none(&FULL, |Scenario { setup, priority, .. }, outcome| {
        let is_silent = outcome.own_frames == 0;
        let has_monitor = matches!(setup.preset, Preset::Default | Preset::Thesis);
        let is_stuck = has_monitor && outcome.characters == 0 && priority == 31;
        let has_pulses = outcome.periods > 15 && outcome.jitter == 0;
        (is_silent || is_stuck || outcome.periods > 0 && !has_pulses).then(|| {
            format!(
                "{} frames, {} characters, {} periods, {} of them with jitter",
                outcome.own_frames, outcome.characters, outcome.periods, outcome.jitter
            )
        })
    });
}

/// Runs a flood without commands for the servo, after a command, and returns the width of the
/// servo's last pulse in microseconds.
fn width_after_silence(setup: Setup, traffic: Traffic) -> u64 {
    let mut rig = setup.running();
    rig.set_all(&[("OUT1_TIMEOUT", 500), ("OUT1_FS", 2), ("OUT1_FS_PWM", 1200)]);
    rig.send_command(1, 4, 1800.0);
    assert_eq!(rig.settled_pulse_us(), 1800.0);
    let mut flood = Flood::with_rig(Scenario::full(setup, traffic), rig);
    flood.run_ms(300);
    assert_eq!(flood.outcome.last_width.map(|cycles| cycles / US), Some(1800), "{traffic:?}");
    flood.run_ms(500);
    flood.finish().last_width.expect("a pulse") / US
}

#[test]
fn the_failsafe_begins_on_a_bus_full_of_other_frames() {
    for setup in setups().filter(|setup| setup.is_v0() && setup.outputs() == 1) {
        for traffic in [Traffic::Elsewhere, Traffic::Status] {
            assert_eq!(width_after_silence(setup, traffic), 1200, "{setup}, {traffic:?}");
        }
    }
}

/// Values of the whole travel, each different from those before it, so that a pulse tells which
/// command the output follows.
#[test]
fn the_values_of_a_flood_change_with_each_frame_over_the_whole_travel() {
    let setup = Setup::of(Preset::Default, 1, 0);
    for unit in Unit::ALL {
        let mut source = Source::new(setup, Traffic::Command(unit), 1, 31, 1);
        let mut sent = (0..2000).flat_map(|_| source.next(0));
        let pulses: Vec<i32> = sent.by_ref().map(|(_, commands)| commands[0].pulse).collect();
        let (min, max) = (pulses.iter().min().unwrap(), pulses.iter().max().unwrap());
        assert_eq!((*min, *max), (2000, 4000), "{unit:?}, in ticks of half a microsecond");
        for near in pulses.windows(20) {
            assert!(near[1..].iter().all(|other| *other != near[0]), "{unit:?}: {near:?}");
        }
    }
}
