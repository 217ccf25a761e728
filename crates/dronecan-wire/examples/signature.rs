//! Prints the signature of a data type of your own, and the seed of its CRC:
//! `signature com.example.Beacon < Beacon.uavcan`. Behind the name are the signatures of the types
//! that it has as fields, in the order of the fields.

use std::error::Error;
use std::io;

use dronecan_wire::{crc, signature};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().ok_or("usage: signature NAME [SIGNATURE...] < DEFINITION")?;
    let nested = arguments.map(|text| u64::from_str_radix(text.trim_start_matches("0x"), 16));
    let nested = nested.collect::<Result<Vec<u64>, _>>()?;
    let signature = signature::of(&name, &io::read_to_string(io::stdin())?, &nested);
    println!("{name} {signature:#018X} {:#06X}", crc::seed(signature));
    Ok(())
}
