mod rig;
use rig::load::{Kind, Load, Pace, run_all};
#[test]
fn probe() {
    let ms = std::env::var("MS").map_or(1500, |s| s.parse().unwrap());
    let kinds = std::env::var("K")
        .map_or(Kind::MATCHING.to_vec(), |_| {
            vec![Kind::Command(1), Kind::Command(5), Kind::Thesis, Kind::LongCommand, Kind::Status(8), Kind::Mixed]
        })
        .into_iter()
        .flat_map(|kind| [(kind, 31), (kind, 0)]);
    let loads: Vec<_> = kinds
        .flat_map(|(kind, priority)| [Pace::Full, Pace::Bursts].map(|pace| (Load { kind, priority, pace }, ms)))
        .filter(|(l, _)| l.priority == 31 || l.pace == Pace::Full)
        .collect();
    for (load, _, f) in run_all(&loads, |_, _, _| ()) {
        let m = &f.meter;
        println!(
            "{:?} {} {:?}: {} frames lost {} ooo {} garbled {}{} service {}/{} release {}/{} servo {}/{} us own {} ans {}",
            load.kind,
            load.priority,
            load.pace,
            m.frames,
            m.lost,
            m.out_of_order,
            m.garbled,
            if f.stuck { " STUCK" } else { "" },
            m.service.median(),
            m.service.max(),
            m.latency.median(),
            m.latency.max(),
            f.command_to_servo.median() / 16,
            f.command_to_servo.max() / 16,
            f.own_frames,
            f.answers
        );
    }
}
#[test]
fn prof() {
    use rig::load::{Client, Loaded};
    use rig::profile::{Names, Profile};
    let names = Names::of_node();
    for kind in [Kind::Command(5), Kind::Thesis] {
    let mut loaded = Loaded::new(Some(Load { kind, priority: 31, pace: Pace::Full }), Client::None);
    let profile = Profile::begin(loaded.rig.board().avr_mut());
    loaded.run_ms(300);
    for share in profile.functions(&names).iter().take(40) { println!("P {:?} {}", share.cycles, share.name); }
    }
}
