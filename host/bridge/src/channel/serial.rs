//! Serial ports, for example with a radio.

use super::radio::Radio;
use super::{Channel, Peer, Transport};
use crate::bus::open_serial;
use crate::post::PeerId;
use anyhow::Result;
use std::path::Path;
use std::time::Duration;

impl Channel {
    pub(super) fn start_serial(
        &mut self,
        ids: &mut PeerId,
        now: Duration,
        path: &Path,
        baud: u32,
    ) -> Result<()> {
        let port = open_serial(path, baud, "radio", "is the radio plugged in?")?;
        self.transport = Transport::Serial(port);
        self.mark_available();
        let peer = self.peer(path.display().to_string(), now);
        self.add(ids, Peer { radio: Some(Radio::presumed(now)), ..peer });
        Ok(())
    }
}
