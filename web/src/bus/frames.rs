//! The frames of the real bus: the list and the time line, the log, and the load.

use std::collections::VecDeque;
use std::time::Duration;

use anyhow::{Context, Result};
use bench::bus_log::{BusLog, Format};
use bench::can::{Frame, OnWire, Record, RecordKind};
use bench::dronecan::{CanId, Decoded, Dialect, Id, Observer};
use bench::{Cycles, F_CPU_HZ, elapsed};
use serde_json::{Value as Json, json};

use crate::bits::Ack;
use crate::traffic::{Described, describe, seconds, wire};

/// Frames whose details the page can ask for, and that it can be told of at once.
const KEPT: usize = 4096;
/// Frames of the log: at least 20 seconds of a full bus.
const LOGGED: usize = 200_000;
/// The load is measured over at least this time: frames come from the USB in bursts.
const LOAD_WINDOW: Duration = Duration::from_secs(1);

/// A frame that the page has been told of.
struct Shown {
    number: u64,
    record: Record,
    from: String,
    text: String,
    dialect: Dialect,
}

/// The frames of a bus.
pub struct Frames {
    bit_rate: u32,
    observer: Observer,
    kept: VecDeque<Shown>,
    logged: VecDeque<Record>,
    events: VecDeque<Json>,
    count: u64,
    /// End of the last frame.
    end: Cycles,
    /// Load of the bus, 0 to 1.
    load: f64,
    window: Window,
}

/// The time over which the load is measured.
#[derive(Default)]
struct Window {
    start: Duration,
    /// The same by the time stamps of the adapter, if it adds them.
    start_us: Option<u64>,
    bits: u64,
}

impl Frames {
    /// No frames.
    pub fn new(bit_rate: u32) -> Frames {
        Frames {
            bit_rate,
            observer: Observer::new(),
            kept: VecDeque::new(),
            logged: VecDeque::new(),
            events: VecDeque::new(),
            count: 0,
            end: 0,
            load: 0.0,
            window: Window::default(),
        }
    }

    /// Adds frames that arrived together, one after the other up to `at`. `own` sent them; without,
    /// their identifiers say who. Returns the transfers that they complete.
    pub fn add(&mut self, frames: &[Frame], own: Option<&str>, at: Duration) -> Vec<Decoded> {
        if frames.is_empty() {
            return Vec::new();
        }
        let bits: Vec<u64> = frames.iter().map(|frame| frame.bit_count().into()).collect();
        let total: u64 = bits.iter().sum();
        self.window.bits += total;
        let cycles = |bits: u64| bits * F_CPU_HZ / u64::from(self.bit_rate);
        // An adapter can tell more frames than the bus carries; time goes on nevertheless.
        let at = cycles_at(at).max(self.end);
        let room = at - self.end;
        let needed = cycles(total).max(1);
        let scaled = |bits: u64| cycles(bits) * room.min(needed) / needed;
        let mut start = at - scaled(total);
        let mut completed = Vec::new();
        let lengths: Vec<Cycles> = bits.iter().map(|bits| scaled(*bits)).collect();
        for ((frame, bits), length) in frames.iter().zip(bits).zip(lengths) {
            let end = (start + length).min(at);
            let kind = RecordKind::Frame { frame: *frame, from: None, acked: true };
            let record = Record { start, end, bits: bits as u32, kind };
            completed.extend(self.push(frame, record, own));
            start = end;
        }
        self.end = at;
        completed
    }

    fn push(&mut self, frame: &Frame, record: Record, own: Option<&str>) -> Option<Decoded> {
        let number = self.count;
        self.count += 1;
        let described = describe(&mut self.observer, frame, elapsed(record.end));
        let from = own.map_or_else(|| sender(frame, described.decoded.as_ref()), String::from);
        self.events.push_back(described.event(number, &from, &record));
        let Described { text, decoded, .. } = described;
        let dialect = decoded.as_ref().map(Decoded::dialect).unwrap_or_default();
        self.kept.push_back(Shown { number, record, from, text, dialect });
        self.logged.push_back(record);
        limit(&mut self.events, KEPT);
        limit(&mut self.kept, KEPT);
        limit(&mut self.logged, LOGGED);
        decoded
    }

    /// Measures the load up to a frame that arrived now, with the time stamp that the adapter has
    /// added to it. No command switches the time stamps on: adapters keep that for their next
    /// client, in an EEPROM.
    pub fn measure(&mut self, stamp_us: Option<u64>, now: Duration) {
        // A stamp that is less than the first one begins at 0 again.
        let by_stamps = stamp_us
            .zip(self.window.start_us)
            .and_then(|(end, start)| end.checked_sub(start))
            .map(Duration::from_micros);
        match by_stamps {
            Some(time) if time < LOAD_WINDOW => {}
            Some(time) => self.end_window(time, stamp_us, now),
            None if stamp_us.is_some() => {
                self.window = Window { start: now, start_us: stamp_us, bits: 0 };
            }
            None => self.poll(now),
        }
    }

    /// Measures the load of frames without time stamps, and that of a bus that is silent.
    pub fn poll(&mut self, now: Duration) {
        let time = now.saturating_sub(self.window.start);
        let has_stamps = self.window.start_us.is_some();
        if time >= LOAD_WINDOW * if has_stamps { 2 } else { 1 } {
            self.end_window(time, None, now);
        }
    }

    fn end_window(&mut self, time: Duration, stamp_us: Option<u64>, now: Duration) {
        let load = self.window.bits as f64 / (time.as_secs_f64() * f64::from(self.bit_rate));
        // A burst at the end of the time can have frames from before it.
        self.load = load.min(1.0);
        self.window = Window { start: now, start_us: stamp_us, bits: 0 };
    }

    /// Load of the bus, 0 to 1.
    pub fn load(&self) -> f64 {
        self.load
    }

    /// Number of frames in the log.
    pub fn logged(&self) -> usize {
        self.logged.len()
    }

    /// The log.
    pub fn log(&self, format: Format) -> Vec<u8> {
        let (mut log, mut bytes) = BusLog::new(format);
        for record in &self.logged {
            log.add(record, &mut bytes);
        }
        bytes
    }

    /// Removes and returns the events since the last call, at most the last [`KEPT`].
    pub fn take_events(&mut self) -> Json {
        self.events.drain(..).collect()
    }

    /// The details of a frame, a JSON object.
    ///
    /// # Errors
    /// If the frame is too old.
    pub fn details(&self, number: u64) -> Result<Json> {
        let shown = self
            .kept
            .iter()
            .find(|shown| shown.number == number)
            .context("the frame is too old")?;
        let wire = match &shown.record.kind {
            // The log has a place for the acknowledgement; SLCAN tells none.
            RecordKind::Frame { frame, .. } => wire(frame, Ack::Unknown, shown.dialect),
            RecordKind::ErrorFrame { .. } => Json::Null,
        };
        Ok(json!({
            "number": number,
            "from": shown.from,
            "text": shown.text,
            "time": format!("{:.3} s", seconds(shown.record.end)),
            "count": shown.record.bits,
            "length_us": f64::from(shown.record.bits) * 1e6 / f64::from(self.bit_rate),
            "wire": wire,
        }))
    }
}

/// Who sent a frame, in words.
fn sender(frame: &Frame, decoded: Option<&Decoded>) -> String {
    let source = match (decoded, frame.id) {
        (Some(decoded), _) => decoded.source(),
        (None, Id::Extended(id)) => CanId::parse(id).and_then(|id| id.source()),
        (None, Id::Standard(_)) => None,
    };
    source.map_or_else(|| String::from("-"), |node| format!("node {node}"))
}

/// Removes the oldest beyond `max`.
fn limit<T>(queue: &mut VecDeque<T>, max: usize) {
    if queue.len() > max {
        queue.pop_front();
    }
}

fn cycles_at(time: Duration) -> Cycles {
    (time.as_nanos() * u128::from(F_CPU_HZ) / 1_000_000_000) as Cycles
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    fn status(node: u32) -> Frame {
        Frame::extended(20 << 24 | 341 << 8 | node, &[0, 0, 0, 0, 0, 0, 0, 0xC0])
    }

    #[test]
    fn frames_that_arrive_together_follow_each_other_up_to_their_arrival() {
        let mut frames = Frames::new(1_000_000);
        assert_eq!(frames.add(&[status(1), status(2)], None, ms(10)).len(), 2);
        let events = frames.take_events();
        let time = |index: usize, what: &str| events[index][what].as_f64().unwrap();
        assert_eq!(time(1, "end"), 0.01);
        assert_eq!(time(0, "end"), time(1, "start"));
        assert!(time(0, "start") > 0.0096, "{events}");
        assert_eq!(
            (&events[0]["from"], &events[0]["frame"]),
            (&json!("node 1"), &json!("transfer"))
        );
        assert_eq!(frames.take_events(), json!([]));
    }

    #[test]
    fn the_load_is_that_of_the_bits_and_ends_with_the_frames() {
        let mut frames = Frames::new(1_000_000);
        for millisecond in 0..1000 {
            frames.add(&[status(1)], None, ms(millisecond));
            frames.measure(None, ms(millisecond));
        }
        frames.poll(ms(1000));
        assert!((0.12..0.16).contains(&frames.load()), "{}", frames.load());
        frames.poll(ms(2000));
        assert_eq!(frames.load(), 0.0);
    }

    /// A full bus whose frames arrive in bursts of 90 ms, once after a stall of half a second.
    #[test]
    fn the_load_of_bursts_is_that_of_the_bus() {
        for has_stamps in [false, true] {
            let mut frames = Frames::new(1_000_000);
            let per_burst = 90_000 / u64::from(status(1).bit_count());
            let mut loads = Vec::new();
            for burst in 1..=100 {
                // The stamps begin at 0 each minute.
                let stamp_us = has_stamps.then_some((burst * 90_000 + 55_000_000) % 60_000_000);
                let at = if (50..55).contains(&burst) { 55 * 90 } else { burst * 90 };
                let all = vec![status(1); per_burst as usize];
                frames.add(&all, None, ms(at));
                frames.measure(stamp_us, ms(at));
                loads.push(frames.load());
            }
            let measured = &loads[15..];
            let (least, most) = if has_stamps { (0.97, 1.0) } else { (0.5, 1.0) };
            assert!(measured.iter().all(|load| (least..=most).contains(load)), "{measured:?}");
        }
    }

    #[test]
    fn a_bus_that_falls_silent_has_no_load_by_stamps_either() {
        let mut frames = Frames::new(1_000_000);
        for millisecond in 0..1500 {
            frames.add(&[status(1)], None, ms(millisecond));
            frames.measure(Some(1000 * millisecond), ms(millisecond));
            frames.poll(ms(millisecond));
        }
        assert!((0.12..0.16).contains(&frames.load()), "{}", frames.load());
        for second in 3..7 {
            frames.poll(ms(1000 * second));
        }
        assert_eq!(frames.load(), 0.0);
    }

    /// Ten thousand frames a second for 21 seconds, more than a bus carries, told in bursts.
    #[test]
    fn a_flood_uses_limited_memory_and_the_times_stay_in_order() {
        let mut frames = Frames::new(1_000_000);
        let burst = vec![Frame::extended(1, &[0xFF; 8]); 100];
        for burst_number in 1..=2100 {
            frames.add(&burst, None, ms(10 * burst_number));
        }
        assert_eq!((frames.kept.len(), frames.events.len()), (KEPT, KEPT));
        assert_eq!(frames.logged(), LOGGED);
        let times: Vec<_> = frames.logged.iter().map(|frame| (frame.start, frame.end)).collect();
        assert!(times.is_sorted() && times.iter().all(|(start, end)| start <= end));
        assert_eq!(frames.end, cycles_at(ms(21_000)));
        assert!(frames.details(0).is_err());
        assert!(frames.details(209_999).is_ok());
    }

    /// SLCAN tells neither the ACK slot nor when a frame was on the bus: the page shows the time of
    /// arrival, and the length of the bits, also of frames that arrive faster than a bus can.
    #[test]
    fn the_details_have_no_acknowledgement_and_no_time_that_the_adapter_has_not_told() {
        let mut frames = Frames::new(500_000);
        frames.add(&[status(1); 20], None, ms(1));
        let details = frames.details(19).unwrap();
        assert_eq!(details["time"], "0.001 s");
        let bits = details["count"].as_f64().unwrap();
        assert_eq!(details["length_us"].as_f64(), Some(2.0 * bits));
        let fields = details["wire"]["fields"].as_array().unwrap();
        let ack = fields.iter().position(|field| field == &json!(["ACK", "not known"])).unwrap();
        let bits = details["wire"]["bits"].as_array().unwrap();
        let unknown: Vec<_> = bits.iter().filter(|bit| bit[0].is_null()).collect();
        assert_eq!(unknown, [&json!([null, 0, ack])]);
    }
}
