//! The checks in their order, and what they share. docs/hardware.md has the list.

use std::collections::BTreeMap;
use std::time::Duration;

use dronecan_host::text::hex;
use dronecan_host::{NodeInfo, ParameterResponse, Value};

use crate::check::desk::{Changed, Desk, State};
use crate::check::session::Plan;
use crate::check::{find, hands, store, update, watch};

/// Bits of the vendor-specific status code (docs/status.md).
pub mod bit {
    pub const RESET: u16 = 7;
    pub const BROKEN: u16 = 1 << 3;
    pub const SAME_ID: u16 = 1 << 4;
    pub const LOST: u16 = 1 << 5;
    pub const PASSIVE: u16 = 1 << 6;
    pub const BUS_OFF: u16 = 1 << 7;
    pub const CONTROLLER: u16 = 1 << 8;
    pub const FAILSAFE: u16 = 1 << 10;
    pub const PARAMETERS: u16 = 1 << 13;
}
pub const BUS_ADVICE: &str = "look at 120 ohms at both ends, CAN high and low, a common ground";
pub const BANNER: &str = "DroneCAN servo node ";

/// What is known of the board.
pub struct Board {
    pub info: NodeInfo,
    pub parameters: BTreeMap<String, ParameterResponse>,
    /// Median time of a request and its response.
    pub round_trip: Duration,
    pub has_port: bool,
}

impl Board {
    /// The value of a parameter, if the node has it.
    pub fn value(&self, name: &str) -> Option<i64> {
        match self.parameters.get(name)?.value {
            Value::Integer(value) => Some(value),
            _ => None,
        }
    }

    /// True if the program prints lines on the serial port: all but the preset `remote`.
    pub fn has_monitor(&self) -> bool {
        let has = |name: &str| self.parameters.contains_key(name);
        let is_remote = has("STATS_RATE") && has("SAFE_MODE") && !has("OUT_COUNT");
        !is_remote
    }
}

/// All checks.
pub async fn all(desk: Desk, plan: Plan) {
    until_silence(&desk, &plan).await;
    // The reason, if the node no longer answers.
    let is_known = desk.state().report.rows.iter().any(|row| row.what == "Bus errors");
    if !is_known && desk.adapter_errors().await == Some(true) {
        desk.check(
            "Bus errors",
            "none",
            format!("the adapter has seen errors, {BUS_ADVICE}"),
            false,
        );
    }
}

async fn until_silence(desk: &Desk, plan: &Plan) {
    let Some(mut board) = find::find(desk, plan).await else { return };
    let unique_id = hex(&board.info.unique_id);
    let has_left = !desk.state().changed.values.is_empty();
    if has_left && desk.state().changed.unique_id == unique_id {
        desk.note("puts back what an earlier run has changed");
        if let Err(why) = desk.put_back().await {
            return desk.check("Put back", "what an earlier run has changed", why, false);
        }
    }
    desk.state_mut().changed = Changed { unique_id, ..Changed::default() };
    if let Err(why) = store::read_parameters(desk, plan, &mut board).await {
        return desk.check("Parameters", "all are read", why, false);
    }
    if let Err(why) = store::round_trip(desk, &mut board).await {
        desk.check("Requests", "each is answered", why, false);
    }
    if let Err(why) = store::save_and_restart(desk, &board).await {
        desk.check("Save and restart", "the value that was set", why, false);
    }
    if let Err(why) = watch::bursts_and_watch(desk, plan, &board).await {
        desk.check("On the bus", "the node responds", why, false);
    }
    if let Err(why) = update::update(desk, plan, &board).await {
        desk.check("Update", "the same program", why, false);
    }
    hands::all(desk, plan, &board).await;
}

/// All bits of the status codes since a time.
pub fn codes(state: &State, since: Duration) -> u16 {
    let new = state.statuses.iter().filter(|status| status.at >= since);
    new.fold(0, |codes, status| codes | status.what.vendor_code)
}
