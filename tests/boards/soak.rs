//! Runs a node with random faults for a simulated minute. `make soak HOURS=4` runs it for longer.

use rig::MS;
use rig::soak::Soak;

#[test]
#[ignore = "takes long: make test-all"]
fn the_node_recovers_from_random_faults_within_a_second() {
    let mut soak = Soak::new(1);
    soak.run_until(60_000 * MS, &|| false);
    println!("{}", soak.report);
    assert!(soak.report.commands > 2000 && soak.report.faults.len() > 1);
    assert!(soak.report.halves > 1000);
}
