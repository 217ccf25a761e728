//! The save file of GTKWave beside a VCD file, so that it opens with the signals.

use std::fs;
use std::io;
use std::path::Path;

/// The first line of the files that this program writes. It does not replace one that the user has
/// saved.
const TITLE: &str = "[*] GTKWave save file of sim; sim replaces it, GTKWave's own it keeps";
/// GTKWave shows 2 to the power of this units of 100 ps in a pixel: 3 ms in 1000 pixels, which are
/// some frames of a bus of 1 Mbit/s.
const ZOOM: u32 = 15;
/// Named markers of GTKWave, none of which is set.
const MARKERS: usize = 26;
/// Format of a signal: binary, aligned to the right.
const BINARY: &str = "@28";

/// Writes the file beside `vcd`, with the ending `.gtkw`. Does nothing if there is one of the user,
/// or if `vcd` is no file.
///
/// # Errors
/// If it cannot be written.
pub fn write<'a>(vcd: &Path, signals: impl Iterator<Item = &'a str>) -> io::Result<()> {
    if !fs::metadata(vcd)?.is_file() {
        return Ok(());
    }
    let path = vcd.with_extension("gtkw");
    let is_of_user = fs::read(&path).is_ok_and(|text| !text.starts_with(TITLE.as_bytes()));
    if is_of_user || path == vcd {
        return Ok(());
    }
    let dump = fs::canonicalize(vcd)?;
    let markers = " -1".repeat(MARKERS);
    let mut text = format!(
        "{TITLE}\n[dumpfile] \"{}\"\n[timestart] 0\n[size] 1400 700\n[pos] -1 -1\n\
         *-{ZOOM}.000000 0{markers}\n",
        dump.display(),
    );
    for signal in signals {
        text += &format!("{BINARY}\nnode.{signal}\n");
    }
    fs::write(path, text)
}
