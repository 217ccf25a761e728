//! No light.

use dronecan_wire::Slot;

use crate::tables::parameters::Parameters;

absent! {
    Lights;
    fn update(&mut self, _parameters: &Parameters);
    fn slot_of(&self, _id: u8) -> Option<Slot> = None;
    fn brightness(&self) -> u8 = 0;
    fn act_on_command(&mut self, _entry: &[u8]);
}
