//! Runs a node with random faults for a simulated minute. `make soak HOURS=4` runs it for longer.

use rig::MS;
use rig::soak::Soak;

#[test]
fn in_a_life_full_of_faults_nothing_is_lost_between_them_and_each_is_over_within_a_second() {
    let mut soak = Soak::new(1);
    soak.run_until(60_000 * MS, &|| false);
    println!("{}", soak.report);
    assert!(soak.report.commands > 2000 && soak.report.faults.len() > 1);
}
