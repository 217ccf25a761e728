use super::*;
use crate::golden;

/// Microseconds of a slot.
const SLOT_US: f64 = 248.0;

/// A shaft at the input of a board, which counts as the real one does.
struct Turning {
    shaft: Shaft,
    parameters: Parameters,
    monitor: Monitor,
    now_us: f64,
    /// Time of the next pulse, and the time between two pulses.
    next_us: f64,
    pulse_us: f64,
    is_counting: bool,
    /// The end of the slot in which a pulse was counted.
    slot_end_us: f64,
    latest_us: f64,
    seed: u32,
    /// The greatest delay of an interrupt.
    delay_us: f64,
}

impl Turning {
    fn new(values: &[(Parameter, i32)]) -> Self {
        let values = [&[(Parameter::RpmRate, 10)], values].concat();
        Self {
            shaft: Shaft::new(),
            parameters: golden::parameters(&values),
            monitor: Monitor::new(),
            // The clock wraps after 65 s, and the byte of the milliseconds each 256.
            now_us: 65_000_000.0,
            next_us: 65_000_000.0,
            pulse_us: f64::INFINITY,
            is_counting: false,
            slot_end_us: 0.0,
            latest_us: 0.0,
            seed: 1,
            delay_us: 0.0,
        }
    }

    fn random(&mut self) -> f64 {
        self.seed = self.seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.seed >> 16) / 65_536.0
    }

    /// Turns at a speed, whose pulses go on from the last one.
    fn at(&mut self, rpm: f64) -> &mut Self {
        let in_turn = f64::from(self.parameters.get(Parameter::RpmPulses));
        let last_us = self.next_us - self.pulse_us;
        self.pulse_us = 60e6 / (rpm * in_turn);
        self.next_us = last_us.max(self.now_us - self.pulse_us) + self.pulse_us;
        self
    }

    /// Lets a tick pass, after which the main loop asks for the pulses.
    fn tick(&mut self, passed_ms: u8) {
        self.now_us += f64::from(passed_ms) * 1000.0;
        // The main loop comes a little later.
        let asked_us = self.now_us + 300.0 * self.random();
        let mut count = 0;
        while self.next_us <= asked_us {
            let seen_us = (self.next_us + self.delay_us * self.random()).min(asked_us);
            if self.is_counting && seen_us >= self.slot_end_us {
                count += 1;
                self.latest_us = seen_us;
                self.slot_end_us = ((seen_us / SLOT_US).floor() + 1.0) * SLOT_US;
            }
            self.next_us += self.pulse_us;
        }
        let ms = (self.latest_us / 1000.0).floor();
        let pulses = ShaftPulses {
            count,
            ms: (ms % 256.0) as u8,
            ticks: ((self.latest_us - ms * 1000.0) / 4.0) as u8,
        };
        let now_ms = self.now_ms();
        self.is_counting = self.parameters.is_on(Parameter::RpmRate);
        self.shaft.tick(pulses, now_ms, &self.parameters, &mut self.monitor);
    }

    fn run(&mut self, ms: u32) -> &mut Self {
        for _ in 0..ms {
            self.tick(1);
        }
        self
    }

    fn now_ms(&self) -> u16 {
        (self.now_us / 1000.0) as u64 as u16
    }

    /// Flags and speed of the message.
    fn message(&self) -> (u16, f64) {
        let mut words = vec![];
        let in_turn = self.parameters.get(Parameter::RpmPulses) as u8;
        self.shaft.put(in_turn, self.now_ms(), |word| words.push(word));
        let &[flags, low, high] = &words[..] else { panic!("{words:?}") };
        (flags, f32::from_bits(u32::from(high) << 16 | u32::from(low)).into())
    }

    fn rpm(&self) -> f64 {
        let (flags, rpm) = self.message();
        assert_eq!(flags, 0);
        rpm
    }

    #[track_caller]
    fn is_within(&self, rpm: f64, percent: f64) {
        let error = (self.rpm() / rpm - 1.0) * 100.0;
        assert!(error.abs() <= percent, "{} for {rpm}: {error:.3} %", self.rpm());
    }

    #[cfg(feature = "monitor")]
    fn log(&mut self) -> String {
        (0..200)
            .map(|_| self.monitor.next_byte(crate::image::InMemory))
            .filter(|&byte| byte != 0)
            .map(char::from)
            .collect()
    }
}

/// The greatest error, in percent, of a speed that does not change, in 3 s.
fn greatest_error(turning: &mut Turning, rpm: f64) -> f64 {
    turning.at(rpm).run(4000);
    let errors = (0..3000).map(|n| {
        // A tick that the main loop took late, now and then.
        turning.tick(if n % 7 == 0 { 2 } else { 1 });
        ((turning.rpm() / rpm - 1.0) * 100.0).abs()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_steady_speed_is_within_a_tenth_of_a_percent() {
    for rpm in [31.0, 60.0, 61.7, 600.0, 1_199.0, 6_000.0, 33_333.0, 60_000.0, 61_234.0, 234_000.0]
    {
        let error = greatest_error(&mut Turning::new(&[]), rpm);
        assert!(error < 0.1, "{rpm}: {error:.3} %");
    }
}

/// 40 us is more than the longest time that an interrupt waits.
#[test]
fn the_delay_of_the_interrupt_makes_an_error_below_a_fifth_of_a_percent() {
    for rpm in [60.0, 600.0, 6_000.0, 60_000.0] {
        let mut turning = Turning::new(&[]);
        turning.delay_us = 40.0;
        let error = greatest_error(&mut turning, rpm);
        assert!(error < 0.2, "{rpm}: {error:.3} %");
    }
}

#[test]
fn a_shaft_that_stops_slows_down_with_the_time_since_its_last_pulse_and_is_0_after_two_seconds() {
    let mut turning = Turning::new(&[]);
    turning.at(60_000.0).run(500);
    turning.is_within(60_000.0, 0.2);
    turning.next_us = f64::INFINITY;
    let mut before = turning.rpm();
    for ms in 1..=1998 {
        turning.run(1);
        let rpm = turning.rpm();
        assert!(rpm <= before && rpm > 0.0, "{rpm} after {ms} ms");
        // A turn in this time is the most that is possible.
        assert!(ms < 60 || rpm <= 60_000.0 / (f64::from(ms) - 3.0), "{rpm} after {ms} ms");
        before = rpm;
    }
    turning.run(4);
    assert_eq!(turning.rpm(), 0.0);
    turning.run(70_000);
    assert_eq!(turning.rpm(), 0.0, "also when the clock has wrapped");
}

#[test]
fn after_a_stop_the_first_speed_is_that_of_the_first_window() {
    let mut turning = Turning::new(&[]);
    turning.at(6_000.0).run(500);
    turning.next_us = f64::INFINITY;
    turning.run(5_000);
    turning.next_us = turning.now_us + 500.0;
    turning.pulse_us = 100_000.0;
    turning.run(99);
    assert_eq!(turning.rpm(), 0.0, "one pulse has no speed");
    turning.run(10);
    turning.is_within(600.0, 0.1);
}

#[test]
fn an_input_with_a_pulse_in_each_slot_is_noisy_until_it_has_fewer() {
    for noise_hz in [4_100.0, 5_500.0, 10_000.0, 100_000.0, 1e6] {
        let mut turning = Turning::new(&[]);
        turning.at(600.0).run(500);
        turning.is_within(600.0, 0.1);
        turning.at(60.0 * noise_hz).run(200);
        for _ in 0..1000 {
            turning.run(1);
            assert_eq!(turning.message(), (UNHEALTHY, 0.0), "{noise_hz} Hz");
        }
        // A window that begins in the noise, and another one.
        turning.at(600.0).run(350);
        turning.is_within(600.0, 0.1);
        turning.at(60.0 * noise_hz).run(200);
        assert_eq!(turning.message().0, UNHEALTHY);
        turning.next_us = f64::INFINITY;
        turning.run(1999);
        assert_eq!(turning.message().0, UNHEALTHY, "not before two seconds without a pulse");
        turning.run(3);
        assert_eq!(turning.message(), (0, 0.0));
        #[cfg(feature = "monitor")]
        assert_eq!(
            turning.log(),
            "rpm: too many pulses\r\nrpm: pulses counted again\r\n".repeat(2)
        );
    }
}

#[test]
fn quotients_are_cut_to_16_bits() {
    let quotient = |dividend, divisor| {
        let [high, low] = super::quotient(dividend, divisor);
        f64::from(f32::from_bits(u32::from(high) << 16 | u32::from(low)))
    };
    for (dividend, divisor, expected) in [
        (1, 1, 1.0),
        (15_000_000, 250_000, 60.0),
        (15_000_000, 250, 60_000.0),
        (143 * 15_000_000, 1, 2_144_993_280.0),
        (1, 0x7FFF_FFFF, 4.656_612_873_077_393e-10),
    ] {
        assert_eq!(quotient(dividend, divisor), expected);
    }
    let mut seed = 1u32;
    for _ in 0..100_000 {
        let [dividend, divisor] = [(); 2].map(|()| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Numbers of all lengths.
            (seed >> 1 >> (seed % 24)).max(1)
        });
        let exact = f64::from(dividend) / f64::from(divisor);
        let error = 1.0 - quotient(dividend, divisor) / exact;
        assert!((0.0..=1.0 / 32_768.0).contains(&error), "{dividend} / {divisor}: {error}");
    }
}
