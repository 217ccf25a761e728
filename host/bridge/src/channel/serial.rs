//! Serial ports, for example with a radio.

use super::radio::Radio;
use super::{Channel, Peer, Transport};
use crate::post::PeerId;
use anyhow::{Result, anyhow};
use rustix::io::Errno;
use serial2::SerialPort;
use std::io::ErrorKind;
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
        let port = SerialPort::open(path, baud).map_err(|error| match error.kind() {
            ErrorKind::NotFound => {
                anyhow!("there is no {}; is the radio plugged in?", path.display())
            }
            _ if error.raw_os_error() == Some(Errno::NOTTY.raw_os_error()) => {
                anyhow!(
                    "{} is not a serial port; those of radios are /dev/ttyUSB0, /dev/ttyACM0, ..",
                    path.display()
                )
            }
            _ => anyhow!(error).context(format!("cannot open {}", path.display())),
        })?;
        self.transport = Transport::Serial(port);
        self.mark_available();
        let peer = self.peer(path.display().to_string(), now);
        self.add(ids, Peer { radio: Some(Radio::presumed(now)), ..peer });
        Ok(())
    }
}
