//! The end of the program: a restart, or an update by the bootloader.

use super::Node;
use crate::eeprom::Eeprom;
use crate::handover::REQUEST_LEN;
use crate::monitor::{Line, Monitor};

impl Node {
    /// True if it is time to restart the program. `is_empty`: the controller has no frame to send.
    pub fn is_to_restart(&self, now_ms: u16, is_empty: bool) -> bool {
        self.transmission.services.is_to_restart(now_ms, is_empty)
    }

    /// Calls an accepted update off if the outputs are in use again. Returns true if it does.
    pub fn calls_off_update(&mut self, monitor: &mut Monitor) -> bool {
        let calls_off = self.update.is_accepted() && self.control.outputs.are_in_use();
        if calls_off {
            self.update.call_off();
            self.transmission.services.call_off_update();
            monitor.log_line(Line::UpdateCalledOff);
        }
        calls_off
    }

    /// The accepted request for an update, if there is one, for the bootloader. Takes up to 30 ms.
    /// The program must end then.
    pub fn hand_over(&mut self, eeprom: &mut impl Eeprom) -> Option<&[u8; REQUEST_LEN]> {
        self.update.hand_over(self.identity.id, &self.parameters, eeprom)
    }
}
