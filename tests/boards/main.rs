//! Tests of the shipped firmware on simulated boards, from outside: through its pins and its bus.
//!
//! A file a behaviour, and one program, because each links the simulator. `make test-firmware
//! TEST_FILES="servo parameters"` runs some of them.

mod allocation;
mod another_rate;
mod attackers;
mod autopilots;
mod bad_input;
mod battery;
mod boards;
mod bounds;
mod budget;
mod bus_faults;
mod chip_faults;
mod commanders;
mod controller;
mod escs;
mod failsafe;
mod full_bus;
mod fuzz;
mod health;
mod identity;
mod input_faults;
mod lights;
mod load;
mod loader;
mod long_commands;
mod motors;
mod neighbours;
mod outputs;
mod parameters;
mod power;
mod processor_faults;
mod relay;
mod reliability;
mod restart;
mod rpm;
mod safety;
mod saving;
mod serial_monitor;
mod services;
mod servo;
mod soak;
mod stats;
mod status;
mod support;
mod telemetry;
mod temperature;
mod thesis;
mod travel;
mod tunnel;
mod update;
mod update_clients;
mod uploads;
mod wires;
