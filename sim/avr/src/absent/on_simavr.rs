//! A build without the feature `simavr`: no machine has this engine.

use std::rc::Rc;

use super::Machine;
use crate::simavr::Simavr;
use sim_base::Cycles;

pub(super) fn hook(_: &Rc<Machine>, simavr: &Simavr) {
    match *simavr {}
}

pub(super) fn watch(simavr: &Simavr, _: usize, _: u8) {
    match *simavr {}
}

impl Machine {
    pub(super) fn run_simavr(&self, simavr: &Simavr, _: Cycles) {
        match *simavr {}
    }
}
