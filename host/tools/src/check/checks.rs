//! The checks in their order. docs/hardware.md has the list.

use dronecan_host::text::hex;

use crate::check::board::{BUS_ADVICE, Plan};
use crate::check::desk::{Changed, Desk};
use crate::check::{find, hands, store, update, watch};

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
