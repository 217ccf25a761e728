//! No button.

absent! {
    Button;
    fn tick(&mut self, _is_pressed: bool, _passed_ms: u8) -> bool = false;
    fn counts_tenth(&mut self, _passed_ms: u8) -> bool = false;
    fn press_time_ds(&self) -> u8 = 0;
    fn count(&self) -> u16 = 0;
}
