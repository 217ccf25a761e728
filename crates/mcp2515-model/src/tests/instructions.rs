//! The SPI instruction set.

use super::support::*;
use can_model::{Frame, Id};

/// DS20001801J 12.3, 12.5: address, then data from consecutive addresses.
#[test]
fn read_and_write_increment_the_address() {
    let mut bench = Bench::new();
    let values: Vec<u8> = (1..=13).collect();
    bench.write(0x31, &values);
    assert_eq!(bench.read_many(0x31, 4), [1, 2 & 0xEB, 3, 4]);
    assert_eq!(bench.read_many(0x36, 8), values[5..]);
}

/// DS20001801J Figures 12-2 to 12-9: the chip does not drive SO during instruction and address.
#[test]
fn so_is_not_driven_during_instruction_and_address() {
    let mut bench = Bench::new();
    assert_eq!(bench.spi(&[READ, CANSTAT, 0]), [0xFF, 0xFF, 0x80]);
    assert_eq!(bench.spi(&[WRITE, BFPCTRL, 0x00]), [0xFF; 3]);
    assert_eq!(bench.spi(&[BIT_MODIFY, BFPCTRL, 0xFF, 0x00]), [0xFF; 4]);
}

/// DS20001801J Figure 12-1: where the mask is 1 the bit changes, where it is 0 the register keeps
/// its bit.
#[test]
fn bit_modify_changes_only_masked_bits() {
    let mut bench = Bench::new();
    for address in [BFPCTRL, CANINTE, CANINTF, CNF1, CNF2] {
        bench.write(address, &[0b0001_1000]);
        bench.modify(address, 0b0011_0101, 0b0010_1111);
        bench.assert_register(address, 0b0010_1101);
    }
    bench.modify(0x30, 0x02, 0xFF);
    bench.assert_register(0x30, 0x02);
    bench.modify(RXB0CTRL, 0x60, 0xFF);
    bench.assert_register(RXB0CTRL, 0x60);
    bench.modify(CANCTRL, 0x0C, 0x08);
    bench.assert_register(CANCTRL, 0x8B);
    bench.write(EFLG, &[0xC0]);
    bench.modify(EFLG, 0x40, 0x00);
    bench.assert_register(EFLG, 0x80);
    bench.modify(CNF3, 0x01, 0x01);
    bench.assert_register(CNF3, 0x01);
}

/// DS20001801J 12.10, note: on other registers the mask is forced to FFh.
#[test]
fn bit_modify_of_an_unsuitable_register_writes_all_bits_and_is_a_violation() {
    for (address, name) in [(0x36, "TXB0D0"), (0x02, "RXF0EID8"), (0x23, "RXM0EID0")] {
        let mut bench = Bench::new();
        bench.write(address, &[0x0F]);
        bench.modify(address, 0x80, 0xF0);
        bench.assert_register(address, 0xF0);
        bench.assert_violation(&[name, "12.10"]);
    }
}

/// DS20001801J 12.10: the sequence is address, mask, data. Further bytes have no effect.
#[test]
fn bytes_after_a_bit_modify_are_ignored() {
    let mut bench = Bench::new();
    bench.spi(&[BIT_MODIFY, CANINTE, 0xFF, 0x11, 0x22, 0x33]);
    bench.assert_register(CANINTE, 0x11);
    bench.assert_register(CANINTF, 0x00);
}

/// DS20001801J 12.10: without its data byte BIT MODIFY changes nothing.
#[test]
fn an_incomplete_bit_modify_is_a_violation() {
    for length in 1..=3 {
        let mut bench = Bench::new();
        bench.spi(&[BIT_MODIFY, CANINTE, 0xFF, 0x11][..length]);
        bench.assert_register(CANINTE, 0x00);
        bench.assert_violation(&["BIT MODIFY", "12.10"]);
    }
}

/// DS20001801J 12.5: a WRITE without data changes nothing. Drivers send it for empty frames.
#[test]
fn a_write_without_data_changes_nothing() {
    let mut bench = Bench::new();
    let before = bench.read(0x36);
    bench.spi(&[WRITE, 0x36]);
    bench.assert_register(0x36, before);
    bench.spi(&[READ, 0x36]);
    bench.spi(&[0x40]);
}

/// DS20001801J Figure 12-5: three buffers, from SIDH or from D0.
#[test]
fn load_tx_buffer_starts_at_one_of_six_addresses() {
    let mut bench = Bench::new();
    for (n, address) in [0x31, 0x36, 0x41, 0x46, 0x51, 0x56].into_iter().enumerate() {
        bench.spi(&[0x40 + n as u8, 0xC0 | n as u8, 0xE1]);
        assert_eq!(bench.read_many(address, 2), [0xC0 | n as u8, 0xE1], "instruction 4{n}h");
    }
}

/// DS20001801J 12.6: a buffer ends at D7.
#[test]
fn load_tx_buffer_beyond_d7_is_a_violation() {
    let mut bench = Bench::new();
    let mut bytes = vec![0x41];
    bytes.extend([0x11; 8]);
    bench.spi(&bytes);
    bytes.extend([0x80; 2]);
    bench.spi(&bytes);
    bench.assert_register(CANCTRL, 0x87);
    bench.assert_violation(&["LOAD TX BUFFER", "D7"]);
}

/// DS20001801J 12.7: bits 2..0 request the transmission of TXB2..TXB0.
#[test]
fn rts_requests_the_buffers_of_its_mask() {
    for mask in 0..8u8 {
        let mut bench = Bench::new();
        bench.rts(mask);
        for n in 0..3 {
            let expected = if mask >> n & 1 == 1 { TXREQ } else { 0 };
            bench.assert_register(0x30 + 0x10 * n, expected);
        }
    }
}

/// DS20001801J Figure 12-3: two buffers, from SIDH or from D0; 92h is RXB0's data, not RXB1.
#[test]
fn read_rx_buffer_starts_at_one_of_four_addresses() {
    for (instruction, buffer, start) in
        [(0x90, 0, 0x61), (0x92, 0, 0x66), (0x94, 1, 0x71), (0x96, 1, 0x76)]
    {
        let mut bench = Bench::normal();
        bench.write(RXB0CTRL, &[BUKT]);
        bench.peer_sends(&[
            Frame::extended(0x0123_4567, &[1, 2, 3, 4, 5, 6, 7, 8]),
            Frame::extended(0x1ABC_DEF0, &[11, 12, 13, 14, 15, 16, 17, 18]),
        ]);
        let expected = bench.read_many(start, 8);
        bench.assert_register(CANINTF, RX0IF | RX1IF);
        let answers = bench.spi(&[instruction, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(answers[1..], expected, "{instruction:02X}h");
        bench.assert_register(CANINTF, if buffer == 0 { RX1IF } else { RX0IF });
    }
}

/// DS20001801J 12.4: the flag is cleared when CS rises, not before.
#[test]
fn read_rx_buffer_clears_its_flag_when_cs_rises() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.select();
    for byte in [0x90, 0, 0, 0, 0, 0, 0] {
        bench.byte(byte);
    }
    assert_eq!(bench.chip.borrow().register(CANINTF), RX0IF);
    bench.deselect();
    assert_eq!(bench.chip.borrow().register(CANINTF), 0);
}

/// DS20001801J 12.4: reading an empty buffer returns old data, and can discard the next frame.
#[test]
fn read_rx_buffer_of_an_empty_buffer_is_a_violation() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.spi(&[0x94, 0, 0]);
    bench.assert_violation(&["94h", "RX1IF", "12.4"]);
    bench.assert_register(CANINTF, RX0IF);
}

/// DS20001801J 12.4: if it ends at once, the instruction clears the flag of a frame that was not
/// read.
#[test]
fn read_rx_buffer_without_a_data_byte_is_a_violation() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.spi(&[0x90]);
    bench.assert_violation(&["RXB0", "thrown away"]);
    bench.assert_register(CANINTF, 0);
}

/// DS20001801J Figure 12-8.
#[test]
fn read_status_maps_flags_and_requests() {
    let mut bench = Bench::new();
    for (flags, status) in
        [(0x01, 0x01), (0x02, 0x02), (0x04, 0x08), (0x08, 0x20), (0x10, 0x80), (0xE0, 0x00)]
    {
        bench.write(CANINTF, &[flags]);
        assert_eq!(bench.spi(&[READ_STATUS, 0])[1], status, "CANINTF {flags:02X}h");
    }
    bench.write(CANINTF, &[0]);
    for (n, status) in [0x04, 0x10, 0x40].into_iter().enumerate() {
        let control = 0x30 + 0x10 * n as u8;
        bench.write(control, &[TXREQ]);
        assert_eq!(bench.spi(&[READ_STATUS, 0])[1], status, "TXB{n}");
        bench.write(control, &[0]);
    }
}

/// DS20001801J 12.8: the status is repeated and updated as long as clocks come.
#[test]
fn read_status_repeats() {
    let mut bench = Bench::normal();
    bench.select();
    bench.byte(READ_STATUS);
    assert_eq!([bench.byte(0), bench.byte(0)], [0, 0]);
    bench.peer_sends(&[Frame::standard(0x123, &[])]);
    assert_eq!(bench.byte(0), 0x01);
    bench.deselect();
}

/// DS20001801J Figure 12-9: bits 4 and 3 are the type of the message.
#[test]
fn rx_status_has_the_type_of_the_message() {
    for (frame, kind) in [
        (Frame::standard(0x123, &[1]), 0b00),
        (Frame::remote(Id::Standard(0x123), 1), 0b01),
        (Frame::extended(0x123, &[1]), 0b10),
        (Frame::remote(Id::Extended(0x123), 1), 0b11),
    ] {
        let mut bench = Bench::normal();
        bench.peer_sends(&[frame]);
        let status = bench.spi(&[RX_STATUS, 0, 0]);
        assert_eq!(status[1] >> 3 & 0b11, kind, "{frame}");
        assert_eq!(status[1] & 0xC0, 0x40);
        assert_eq!(status[1], status[2], "the status is repeated");
    }
}

/// DS20001801J Figure 12-9: bits 2 to 0 are the matching filter; codes 6 and 7 mean a rollover into
/// RXB1.
#[test]
fn rx_status_has_the_filter() {
    let mut bench = Bench::new();
    bench.write(CNF3, &CNF_1M);
    bench.write(RXM0, &[0xFF, 0xE0, 0, 0, 0xFF, 0xE0, 0, 0]);
    for (n, address) in RXF.into_iter().enumerate() {
        bench.write(address, &[0x10 + n as u8, 0, 0, 0]);
    }
    bench.write(RXB0CTRL, &[BUKT]);
    bench.enter(NORMAL);
    let frame = |n: u16| Frame::standard((0x10 + n) << 3, &[]);
    assert_eq!(bench.spi(&[RX_STATUS, 0])[1], 0x00, "no message");
    for n in 0..6 {
        bench.peer_sends(&[frame(n)]);
        let full = if n < 2 { 0x40 } else { 0x80 };
        assert_eq!(bench.spi(&[RX_STATUS, 0])[1], full | n as u8, "RXF{n}");
        bench.modify(CANINTF, RX0IF | RX1IF, 0);
    }
    for n in 0..2 {
        bench.peer_sends(&[frame(1 - n), frame(n)]);
        assert_eq!(bench.spi(&[RX_STATUS, 0])[1], 0xC0 | (1 - n) as u8, "RXB0 goes first");
        bench.modify(CANINTF, RX0IF, 0);
        assert_eq!(bench.spi(&[RX_STATUS, 0])[1], 0x86 + n as u8, "RXF{n} rolled over");
        bench.modify(CANINTF, RX1IF, 0);
    }
}

/// DS20001801J 12.1: bytes while CS is high are for another device.
#[test]
fn bytes_while_cs_is_high_are_for_another_device() {
    let mut bench = Bench::normal();
    assert_eq!(bench.byte(RESET), 0xFF);
    bench.assert_opmod(NORMAL);
}

/// DS20001801J 12.8: a status byte was latched when it began.
#[test]
fn a_status_byte_does_not_show_what_happens_while_it_is_shifted_out() {
    const BEFORE_THE_END: u64 = 10;
    let sent_at = {
        let mut bench = sending();
        while bench.chip.borrow().register(CANINTF) & TX0IF == 0 {
            bench.run_to(bench.now + 1);
        }
        bench.now
    };
    let mut bench = sending();
    bench.run_to(sent_at - BEFORE_THE_END - SPI_BYTE - 4);
    bench.select();
    bench.byte(READ_STATUS);
    assert!(bench.now < sent_at);
    // First TXREQ of TXB0 and no TX0IF, then the opposite.
    assert_eq!(bench.byte(0) & 0x0C, 0x04);
    assert!(bench.now > sent_at);
    assert_eq!(bench.byte(0) & 0x0C, 0x08);
    bench.deselect();
}

/// A chip that has just got a request to send a frame.
fn sending() -> Bench {
    let mut bench = Bench::normal();
    bench.send(0x123, &[]);
    bench
}

/// DS20001801J Table 12-1: other bytes are not instructions.
#[test]
fn an_unknown_instruction_is_ignored_and_a_violation() {
    for instruction in [0x00, 0x01, 0x04, 0x46, 0x47, 0x88, 0x91, 0x98, 0xA1, 0xB1, 0xC1, 0xFF] {
        let mut bench = Bench::new();
        bench.spi(&[instruction, CANINTE, 0xFF, 0xFF]);
        bench.assert_violation(&[&format!("{instruction:02X}h"), "Table 12-1"]);
        bench.assert_register(CANINTE, 0);
    }
}

/// DS20001801J 12.1: an instruction ends when CS rises, and the next begins when CS falls.
#[test]
fn each_fall_of_cs_begins_a_new_instruction() {
    let mut bench = Bench::new();
    bench.spi(&[]);
    bench.spi(&[WRITE]);
    bench.spi(&[READ, CANSTAT]);
    assert_eq!(bench.read(CANSTAT), 0x80);
}

/// DS20001801J 12.2, 9.0: RESET leads to configuration mode from any mode.
#[test]
fn reset_leads_to_configuration_mode() {
    for mode in [NORMAL, LISTEN_ONLY, LOOPBACK] {
        let mut bench = Bench::in_mode(mode);
        bench.reset();
        bench.assert_opmod(CONFIGURATION);
    }
}
