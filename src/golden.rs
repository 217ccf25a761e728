//! Reference data for the tests: [`dronecan_wire::golden`], with the frames of the driver, and
//! parameters and conditions.

#![allow(dead_code, unused_imports, reason = "a build may have no test that needs one")]

use std::string::String;
use std::vec::Vec;

use dronecan_wire::golden as wire;
// What is not defined here for frames of the driver.
pub use dronecan_wire::golden::*;
use mcp2515_ordered::Frame;

use crate::image::InMemory;
use crate::tables::condition::Conditions;
use crate::tables::parameters::{Parameter, Parameters};

/// A frame with this identifier and data.
pub fn frame(id: u32, data: &[u8]) -> Frame {
    let mut frame = Frame { id: id.to_be_bytes(), len: data.len() as u8, ..Frame::EMPTY };
    frame.data[..data.len()].copy_from_slice(data);
    frame
}

/// The identifier of a frame.
pub fn id(frame: &Frame) -> u32 {
    u32::from_be_bytes(frame.id)
}

fn of_driver(frames: Vec<wire::Frame>) -> Vec<Frame> {
    frames.iter().map(|wire| frame(wire.id, &wire.data)).collect()
}

fn of_wire<'a>(frames: impl IntoIterator<Item = &'a Frame>) -> Vec<wire::Frame> {
    frames.into_iter().map(|frame| wire::frame(id(frame), frame.data())).collect()
}

/// See [`wire::frames`].
pub fn frames(text: &str) -> Vec<Frame> {
    of_driver(wire::frames(text))
}

/// See [`wire::text`].
pub fn text<'a>(frames: impl IntoIterator<Item = &'a Frame>) -> String {
    wire::text(&of_wire(frames))
}

/// See [`wire::transfer`].
pub fn transfer(id: u32, signature: u64, transfer_id: u8, payload: &[u8]) -> Vec<Frame> {
    of_driver(wire::transfer(id, signature, transfer_id, payload))
}

/// See [`wire::payload`].
pub fn payload(signature: u64, frames: &[Frame]) -> (Vec<u8>, u8) {
    wire::payload(signature, &of_wire(frames))
}

/// The default parameters, changed by `values`.
pub fn parameters(values: &[(Parameter, i32)]) -> Parameters {
    let mut parameters = Parameters::new();
    parameters.set_defaults(InMemory);
    for &(parameter, value) in values {
        assert!(parameters.set(parameter.index(), value, InMemory), "{parameter:?} {value}");
    }
    parameters
}

/// Every condition, in the order of the bits. The first has three.
pub const CONDITIONS: [Conditions; 14] = [
    Conditions::RESET,
    Conditions::TRANSFER_ERRORS,
    Conditions::ID_CONFLICT,
    Conditions::FRAMES_LOST,
    Conditions::ERROR_PASSIVE,
    Conditions::BUS_OFF,
    Conditions::CONTROLLER,
    Conditions::TWO_COMMANDERS,
    Conditions::FAILSAFE,
    Conditions::TEMPERATURE,
    Conditions::POWER,
    Conditions::PARAMETERS_LOST,
    Conditions::DISARMED,
    Conditions::DRAFT,
];
