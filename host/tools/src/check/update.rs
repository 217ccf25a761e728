//! An update with the program that the node has.

use std::rc::Rc;
use std::time::Duration;

use crate::update::file::FirmwareFile;
use crate::update::search::TAKES_NO_UPDATES;
use crate::update::session::{Outcome, Session as Update};

use crate::check::board::{Board, Plan};
use crate::check::desk::Desk;
use crate::check::measure::quantile;

/// Pages of the flash are erased and written in 3.7 to 4.5 ms each (DS40002061B 31.8).
const PAGE_LIMIT_MS: f64 = 12.0;

/// Updates the node with the program that it has.
pub async fn update(desk: &Desk, plan: &Plan, board: &Board) -> Result<(), String> {
    let info = &board.info;
    let Some(crc) = info.image_crc else {
        desk.skip("Update", "the program has no feature \"update\"");
        return Ok(());
    };
    if info.hardware.0 & TAKES_NO_UPDATES != 0 {
        // No failure: "make flash" leaves the Arduino's own bootloader on the board.
        desk.skip(
            "Update",
            "the bootloader takes none over the bus: \"make bootloader\" writes one that does",
        );
        return Ok(());
    }
    let Some(file) = plan.files.iter().find(|file| file.image_crc == Some(crc)) else {
        desk.skip(
            "Update",
            format!("no file has the node's program, image CRC {crc:#X}: --firmware"),
        );
        return Ok(());
    };
    if desk.state().commander.is_some() {
        desk.skip("Update", "another node commands outputs, so the node refuses");
        return Ok(());
    }
    let question = format!(
        "Update node {} with the program that it has ({file})? Outputs have no pulse meanwhile.",
        plan.node
    );
    if !desk.is_allowed(question).await {
        desk.skip("Update", "not wanted");
        return Ok(());
    }
    update_with(desk, plan, board, file).await
}

async fn update_with(
    desk: &Desk,
    plan: &Plan,
    board: &Board,
    file: &FirmwareFile,
) -> Result<(), String> {
    {
        let mut state = desk.state_mut();
        let own = state.tool.id().ok_or("no node ID")?;
        let (node, now) = (state.node, state.now);
        state.reads.clear();
        state.update =
            Some(Update::new(node, board.info.software, Rc::new(file.clone()), own, now));
    }
    let outcome = desk.run_update().await;
    let gaps: Vec<Duration> = {
        let reads = &desk.state().reads;
        reads.windows(2).map(|pair| pair[1] - pair[0]).collect()
    };
    // A part of 256 bytes has 38 frames of 131 bits. It is two pages.
    let bus_ms = 38.0 * 131.0 * 1e3 / f64::from(plan.bit_rate);
    // This computer can only make them longer.
    let page_ms = (quantile(&gaps, 0.25).as_secs_f64() * 1e3 - bus_ms) / 2.0;
    let (text, is_updated) = match outcome {
        Outcome::Updated(text) => (text, true),
        Outcome::Failed(text) => (text, false),
    };
    desk.check("Update", "the same program", text, is_updated);
    if is_updated {
        let adapter = board.round_trip.as_secs_f64() * 1e3 / 2.0;
        desk.check(
            "Page of flash",
            "7.4 to 9 ms to erase and write it",
            format!("{page_ms:.1} ms, with up to {adapter:.1} ms of the adapter"),
            page_ms - adapter < PAGE_LIMIT_MS,
        );
    }
    Ok(())
}
