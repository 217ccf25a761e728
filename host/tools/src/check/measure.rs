//! Numbers from times and values.

use std::time::Duration;

/// The time that this part of the times is below, of 1; zero without a time.
pub fn quantile(times: &[Duration], part: f64) -> Duration {
    let mut sorted = times.to_vec();
    sorted.sort();
    sorted.get((sorted.len() as f64 * part) as usize).copied().unwrap_or_default()
}

/// The median; zero without a time.
pub fn median(times: &[Duration]) -> Duration {
    quantile(times, 0.5)
}

/// The standard deviation.
pub fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// The error in per cent of the clock that sent messages with this period. Positive if it is fast.
/// Messages may be missing. `None` if there are too few for a result.
///
/// The median over two seconds each, so that some that come late, or a pause of the computer,
/// count little.
pub fn clock_error_percent(times: &[Duration], period: f64) -> Option<f64> {
    let lag = (2.0 / period).round() as usize;
    let mut errors: Vec<f64> = times
        .windows(lag + 1)
        .map(|window| (window[lag] - window[0]).as_secs_f64() / period)
        .map(|periods| (periods.round() / periods - 1.0) * 100.0)
        .collect();
    errors.sort_by(f64::total_cmp);
    (errors.len() >= 8).then(|| errors[errors.len() / 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_of_a_clock_is_found_beside_delays_and_missing_messages() {
        let times: Vec<Duration> = (0..20)
            .filter(|n| *n != 7)
            .map(|n| f64::from(n) * 1.02 + f64::from(n % 3) * 0.002 + f64::from(n / 15) * 0.1)
            .map(Duration::from_secs_f64)
            .collect();
        let error = clock_error_percent(&times, 1.0).unwrap();
        assert!((error + 1.96).abs() < 0.2, "{error}");
        assert_eq!(clock_error_percent(&times[..5], 1.0), None);
    }

    #[test]
    fn median_and_deviation() {
        let times = [3, 1, 2].map(Duration::from_secs);
        assert_eq!(median(&times), Duration::from_secs(2));
        assert_eq!(median(&[]), Duration::ZERO);
        assert_eq!(deviation(&[1.0, 3.0]), 1.0);
    }
}
