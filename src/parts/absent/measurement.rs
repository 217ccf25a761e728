//! The node does not send the thesis's measurement.

absent! {
    Measurement;
    fn note_status(&mut self) -> bool = false;
}
