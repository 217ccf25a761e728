//! Measures every fault of `tests/rig/faults`, prints docs/reliability.md and writes it. `make
//! reliability`.

fn main() {
    // Cargo also asks bench targets to list their tests.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let page = rig::faults::page::page(|case| case.check());
    println!("\n{page}");
    std::fs::write(bench::root().join("docs/reliability.md"), page)
        .expect("docs/reliability.md can be written");
}
