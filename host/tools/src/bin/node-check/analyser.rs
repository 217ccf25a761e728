//! A logic analyser of the kind fx2lafw, through sigrok-cli: D0 is the servo, D1 INT, D2 CS.

use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;

const DEVICE: [&str; 2] = ["--driver", "fx2lafw"];
const RECORD: [&str; 8] = [
    "--config",
    "samplerate=4M",
    "--channels",
    "D0=SERVO,D1=INT,D2=CS",
    "--time",
    "1000",
    "--output-format",
    "vcd",
];

/// The analyser, if there is one.
pub struct Analyser {
    is_there: bool,
    recording: Option<Receiver<Result<String, String>>>,
}

impl Analyser {
    /// Looks for one.
    pub fn find() -> Analyser {
        let scan =
            Command::new("sigrok-cli").args(DEVICE).arg("--scan").stderr(Stdio::null()).output();
        let is_there = scan.is_ok_and(|scan| scan.stdout.windows(7).any(|word| word == b"fx2lafw"));
        Analyser { is_there, recording: None }
    }

    /// True if there is one.
    pub fn is_there(&self) -> bool {
        self.is_there
    }

    /// Begins to record.
    pub fn record(&mut self) {
        let (done, recording) = channel();
        self.recording = Some(recording);
        thread::spawn(move || {
            let output = Command::new("sigrok-cli").args(DEVICE).args(RECORD).output();
            let text = match output {
                Ok(output) if output.status.success() => {
                    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
                }
                Ok(output) => Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()),
                Err(error) => Err(error.to_string()),
            };
            let _ = done.send(text.map_err(|why| format!("sigrok-cli does not record: {why}")));
        });
    }

    /// The recording, once it is complete.
    pub fn recording(&mut self) -> Option<Result<String, String>> {
        self.recording.as_ref()?.try_recv().ok()
    }
}
