use super::*;

#[test]
fn every_count_is_the_single_precision_number_that_it_is() {
    for number in 0..=u16::MAX {
        let bits = f32::from(number).to_bits();
        assert_eq!(float32(number), [(bits >> 16) as u16, bits as u16], "{number}");
    }
}

#[test]
fn messages_that_are_due_are_told_apart() {
    let all = [
        Due::NODE_STATUS,
        Due::DEGREES_CELSIUS,
        Due::ACTUATOR_STATUS,
        Due::TEMPERATURE,
        Due::CAN_STATS,
        Due::BUTTON,
        Due::ALLOCATION,
    ];
    assert_eq!(all.len(), MESSAGES);
    let mut due = Due::NONE;
    for (n, message) in all.into_iter().enumerate() {
        due.set(message);
        assert_eq!(due.0, (1 << (n + 1)) - 1);
    }
    for message in all {
        due.clear(message);
        assert_eq!(due.0 & message, 0);
    }
    assert_eq!(due, Due::NONE);
}
