//! Forms of a log of the bus: candump text, pcap, decoded transfers.
//!
//! ```text
//! (2.512352) can0 1404562A#0100A95C00C0
//! ```
//!
//! The time is that of the frame's SOF, in simulated seconds since power-on. So `--script` plays
//! each frame of a log at its time. python-can, can-utils and Wireshark read it as seconds since
//! 1970.
//!
//! A pcap has link type CAN_SOCKETCAN, with error frames. Text has no error frames, because a
//! program that plays the log would send them as frames; the status line has their number. In text
//! a DLC above 8 becomes 8, because python-can and Wireshark reject it; a pcap keeps it.
//!
//! The log of decoded transfers has a line for each transfer: the time of its end, its sender, and
//! its content:
//!
//! ```text
//!      2.514901   127>120 param.GetSet request OUT1_MIN = 1100
//! ```
//!
//! [`dialect`](crate::dronecan::dialect) says how it finds the dialect of a transfer. Transfers of
//! the draft are marked `draft`.
//!
//! Sources: can-utils, log file format (candump.c, lib.h); tcpdump.org, "LINKTYPE_CAN_SOCKETCAN";
//! Linux, can/error.h.

use crate::can::{ErrorKind, Frame, Id, Record, RecordKind};
use crate::dronecan::text::visible;
use crate::dronecan::{Observation, Observer};
use crate::{Cycles, F_CPU_HZ};

const CYCLES_PER_US: u64 = F_CPU_HZ / 1_000_000;
/// First word of a pcap file with times in microseconds. A pcap file has the byte order of the
/// computer that writes it.
const PCAP_MAGIC: u32 = 0xA1B2_C3D4;
const PCAP_VERSION: [u16; 2] = [2, 4];
const PCAP_SNAPSHOT_LENGTH: u32 = 65_535;
const LINKTYPE_CAN_SOCKETCAN: u32 = 227;

const CAN_EFF_FLAG: u32 = 1 << 31;
const CAN_RTR_FLAG: u32 = 1 << 30;
const CAN_ERR_FLAG: u32 = 1 << 29;
/// Class of an error frame: protocol violation; data\[2\] and data\[3\] have its kind and its
/// place.
const CAN_ERR_PROT: u32 = 0x008;
/// Class of an error frame: no ACK.
const CAN_ERR_ACK: u32 = 0x020;
const CAN_ERR_PROT_BIT: u8 = 0x01;
const CAN_ERR_PROT_FORM: u8 = 0x02;
const CAN_ERR_PROT_STUFF: u8 = 0x04;
const CAN_ERR_PROT_LOC_CRC_SEQ: u8 = 0x08;
const CAN_ERR_DLC: u8 = 8;

/// Form of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Candump,
    Pcap,
    Transfers,
}

/// Writes the records of a bus in one of the forms.
pub struct BusLog {
    format: Format,
    observer: Observer,
}

impl BusLog {
    /// A log, and the bytes with which it begins.
    pub fn new(format: Format) -> (BusLog, Vec<u8>) {
        let begin = match format {
            Format::Candump | Format::Transfers => Vec::new(),
            Format::Pcap => pcap_header(),
        };
        (BusLog { format, observer: Observer::new() }, begin)
    }

    /// Adds a frame or an error frame to `out`.
    pub fn add(&mut self, record: &Record, out: &mut Vec<u8>) {
        let us = record.start / CYCLES_PER_US;
        match (self.format, record.kind) {
            (Format::Candump, RecordKind::Frame { mut frame, .. }) => {
                frame.dlc = frame.dlc.min(8);
                let (seconds, us) = (us / 1_000_000, us % 1_000_000);
                out.extend(format!("({seconds}.{us:06}) can0 {frame}\n").into_bytes());
            }
            (Format::Candump, RecordKind::ErrorFrame { .. }) => {}
            (Format::Transfers, RecordKind::Frame { frame, .. }) => {
                self.add_transfer(record.end, &frame, out);
            }
            (Format::Transfers, RecordKind::ErrorFrame { kind, .. }) => {
                let kind = kind.map_or(String::new(), |kind| format!(": {kind:?}").to_lowercase());
                add_line(record.end, "-", &format!("error frame{kind}"), out);
            }
            (Format::Pcap, RecordKind::Frame { frame, .. }) => {
                pcap_packet(out, us, &socketcan_frame(&frame));
            }
            (Format::Pcap, RecordKind::ErrorFrame { kind, .. }) => {
                pcap_packet(out, us, &socketcan_error(kind));
            }
        }
    }

    fn add_transfer(&mut self, at: Cycles, frame: &Frame, out: &mut Vec<u8>) {
        let id = match frame.id {
            Id::Extended(id) if !frame.remote => id,
            _ => return add_line(at, "-", &format!("CAN frame {frame}"), out),
        };
        match self.observer.push(id, frame.data(), crate::elapsed(at)) {
            Observation::Partial => {}
            Observation::Invalid(why) => {
                add_line(at, "-", &format!("invalid frame {frame} {why}"), out);
            }
            Observation::Complete(transfer) => {
                add_line(at, &transfer.endpoints(), &transfer.to_string(), out);
            }
        }
    }
}

fn add_line(at: Cycles, who: &str, text: &str, out: &mut Vec<u8>) {
    let us = at / CYCLES_PER_US;
    let (seconds, us, text) = (us / 1_000_000, us % 1_000_000, visible(text));
    out.extend(format!("{seconds:6}.{us:06} {who:>9} {text}\n").into_bytes());
}

fn pcap_header() -> Vec<u8> {
    let mut header = PCAP_MAGIC.to_ne_bytes().to_vec();
    header.extend(PCAP_VERSION.iter().flat_map(|part| part.to_ne_bytes()));
    // Time zone and accuracy of the timestamps: always 0.
    header.extend([0; 8]);
    header.extend(PCAP_SNAPSHOT_LENGTH.to_ne_bytes());
    header.extend(LINKTYPE_CAN_SOCKETCAN.to_ne_bytes());
    header
}

fn pcap_packet(out: &mut Vec<u8>, us: u64, packet: &[u8]) {
    // 32 bits of seconds are enough for a hundred years.
    let fields = [
        (us / 1_000_000) as u32,
        (us % 1_000_000) as u32,
        packet.len() as u32,
        packet.len() as u32,
    ];
    out.extend(fields.iter().flat_map(|field| field.to_ne_bytes()));
    out.extend(packet);
}

/// A frame as struct can_frame: identifier with flags in network byte order, length, two zeros, DLC
/// if above 8 else 0, data.
fn socketcan_frame(frame: &Frame) -> Vec<u8> {
    let id = match frame.id {
        Id::Standard(id) => u32::from(id),
        Id::Extended(id) => id | CAN_EFF_FLAG,
    };
    let remote = if frame.remote { CAN_RTR_FLAG } else { 0 };
    let length = frame.dlc.min(8);
    let long_dlc = if frame.dlc > 8 { frame.dlc } else { 0 };
    socketcan(id | remote, length, long_dlc, frame.data())
}

fn socketcan_error(kind: Option<ErrorKind>) -> Vec<u8> {
    let mut data = [0; 8];
    let class = match kind {
        Some(ErrorKind::Ack) => CAN_ERR_ACK,
        _ => CAN_ERR_PROT,
    };
    match kind {
        Some(ErrorKind::Bit) => data[2] = CAN_ERR_PROT_BIT,
        Some(ErrorKind::Form) => data[2] = CAN_ERR_PROT_FORM,
        Some(ErrorKind::Stuff) => data[2] = CAN_ERR_PROT_STUFF,
        Some(ErrorKind::Crc) => data[3] = CAN_ERR_PROT_LOC_CRC_SEQ,
        Some(ErrorKind::Ack) | None => {}
    }
    socketcan(CAN_ERR_FLAG | class, CAN_ERR_DLC, 0, &data)
}

fn socketcan(id: u32, length: u8, long_dlc: u8, data: &[u8]) -> Vec<u8> {
    let mut packet = id.to_be_bytes().to_vec();
    packet.extend([length, 0, 0, long_dlc]);
    packet.extend(data);
    packet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_have_flags_for_remote_frames_long_dlcs_and_errors() {
        let packet = |text: &str| socketcan_frame(&text.parse().unwrap());
        assert_eq!(packet("123#R4"), [0x40, 0, 1, 0x23, 4, 0, 0, 0]);
        assert_eq!(packet("7FF#1122334455667788_C")[..8], [0, 0, 7, 0xFF, 8, 0, 0, 12]);
        assert_eq!(
            socketcan_error(Some(ErrorKind::Stuff))[..12],
            [0x20, 0, 0, 8, 8, 0, 0, 0, 0, 0, 4, 0]
        );
        assert_eq!(socketcan_error(Some(ErrorKind::Crc))[8..12], [0, 0, 0, 8]);
        assert_eq!(socketcan_error(Some(ErrorKind::Ack))[..4], [0x20, 0, 0, 0x20]);
    }
}
