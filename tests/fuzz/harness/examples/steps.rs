//! Prints the steps of an input of the target `node`: `cargo run -p fuzz-harness --example steps --
//! FILE`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("which file?")?;
    for step in fuzz_harness::steps::steps(&std::fs::read(path)?) {
        println!("{step:X?}");
    }
    Ok(())
}
