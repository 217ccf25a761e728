//! Faults of the CAN controller and its wires: the node detects and logs each within 100 ms and
//! restarts the controller. The servo holds its position or moves to its failsafe. The cases are in
//! `faults/chip.rs`, what they measure in docs/reliability.md.

use rig::Rig;

rig::check_each! {
    chip:
    a_reset_controller_is_restarted_before_the_failsafe: RESET;
    a_controller_with_garbage_in_its_registers_is_restarted: BROWN_OUT;
    #[ignore = "takes long: make test-all"]
    a_controller_without_power_is_restarted_until_it_answers: NO_POWER;
    a_controller_stuck_in_configuration_mode_is_restarted_until_it_leaves_it: HELD;
    a_sleeping_controller_is_restarted: ASLEEP;
    #[ignore = "takes long: make test-all"]
    an_spi_that_reads_all_zeros_or_all_ones_is_logged: MISO_LOW, MISO_HIGH;
    an_spi_that_flips_bits_is_logged_and_the_servo_stays_in_its_travel: FLIPPING;
    #[ignore = "takes long: make test-all"]
    a_flipped_bit_in_a_register_is_detected: REGISTER;
    a_flipped_bit_in_a_filter_is_corrected_by_the_failsafe: FILTER;
    an_int_line_stuck_high_is_detected: INT_HIGH;
    an_int_line_stuck_low_is_detected: INT_LOW;
}

/// RXB1CTRL, TXRTSCTRL and BFPCTRL, on a full bus of frames that the filters reject: with RXM = 11
/// buffer 1 takes them.
#[test]
fn a_flipped_bit_in_a_register_that_is_not_checked_loses_no_command() {
    const UNWANTED: u32 = 0x104E_2032;
    let flips = [(0x70, 0x20), (0x70, 0x40), (0x70, 0x60), (0x0D, 1), (0x0D, 2), (0x0D, 4)];
    for (address, bits) in flips.into_iter().chain((0..6).map(|bit| (0x0C, 1 << bit))) {
        let mut rig = Rig::running();
        rig.board().chip_flip_bits(address, bits);
        for n in 0..10u16 {
            let value = if n % 2 == 0 { 0.5 } else { -0.5 };
            rig.send_command(1, 0, value);
            // Frames of 130 us or more for 40 ms, at 1 Mbit/s, and time to follow the command.
            for m in 0..300u16 {
                rig.send(UNWANTED, &[n as u8, 4, 0, 0x66, m as u8, 0, 0, 0xC0 | m as u8 & 0x1F]);
            }
            rig.run_ms(40_000_000 / u64::from(rig::board().fastest_bit_rate()) + 10);
            let expected = if n % 2 == 0 { 1750.0 } else { 1250.0 };
            let last = rig.pulses.last().map(|pulse| pulse.width_us());
            assert_eq!(last, Some(expected), "register {address:#04X}, bits {bits:#04X}");
        }
        assert_eq!(rig.board().chip().borrow().rx_overflows(), 0, "register {address:#04X}");
        let code = rig.information().status.vendor_code;
        assert_eq!(code, 0, "register {address:#04X}, bits {bits:#04X}");
    }
}
