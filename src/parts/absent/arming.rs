//! Without ArmingStatus: nobody is disarmed.

use dronecan_wire::NodeId;

use crate::tables::parameters::Parameters;

/// False.
pub const IS_BY_SOURCE: bool = false;

absent! {
    Arming;
    fn act_on_status(&mut self, _id: u8, _status: u8) -> bool = true;
    fn expect(&mut self, _source: NodeId);
    fn expects(&self, _id: u8) -> bool = false;
    fn is_armed(&self) -> bool = false;
    fn is_disarmed(&self, _parameters: &Parameters) -> bool = false;
    fn is_only_armed_by_others(&self, _id: u8) -> bool = false;
    fn is_armed_by(&self, _id: u8) -> bool = false;
    fn is_disarmed_by(&self, _id: u8, _parameters: &Parameters) -> bool = false;
    fn is_said_disarmed(&self) -> bool = false;
    fn second(&mut self);
}
