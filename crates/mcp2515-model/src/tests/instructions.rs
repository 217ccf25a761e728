//! The SPI instruction set.

use super::script::run_all;
use super::support::*;
use can_model::Frame;

#[test]
fn registers() {
    run_all(
        "
12.3, 12.5: address, then data from consecutive addresses
    31 <- 1 2 3 4 5 6 7 8 9 A B C D; 31 = 1 2 3 4; 36 = 6 7 8 9 A B C D; 31 = 1
Figures 12-2 to 12-9: the chip does not drive SO during instruction and address
    spi READ CANSTAT 0 -> FF FF 80; spi WRITE BFPCTRL 0 -> FF FF FF
    spi BIT_MODIFY BFPCTRL FF 0 -> FF FF FF FF
Figure 12-1: where the mask of BIT MODIFY is 0 the register keeps its bit
    each $address: BFPCTRL, CANINTE, CANINTF, CNF1, CNF2
    $address <- 18; modify $address 35 2F; $address = 2D
Figure 12-1: bits that are not writable do not change
    modify TXB0CTRL 2 FF; TXB0CTRL = 2; modify RXB0CTRL 60 FF; RXB0CTRL = 60
    modify CANCTRL C 8; CANCTRL = 8B; EFLG <- C0; modify EFLG 40 0; EFLG = 80
    modify CNF3 1 1; CNF3 = 1
12.10, note: on other registers the mask is forced to FFh
    each $address $name: 36 TXB0D0, 02 RXF0EID8, 23 RXM0EID0
    $address <- 0F; modify $address 80 F0; $address = F0; violation $name 12.10
12.10: the sequence is address, mask, data. Further bytes have no effect
    spi BIT_MODIFY CANINTE FF 11 22 33; CANINTE = 11 0
12.10: without its data byte BIT MODIFY changes nothing
    each $bytes: BIT_MODIFY, BIT_MODIFY+CANINTE, BIT_MODIFY+CANINTE+FF
    spi $bytes; CANINTE = 0; violation BIT MODIFY 12.10
12.5: a WRITE without data changes nothing. Drivers send it for empty frames
    TXB0D0 <- 5; spi WRITE TXB0D0; TXB0D0 = 5; spi READ TXB0D0; spi 40; TXB0D0 = 5
Table 12-1: other bytes are not instructions
    each $byte: 00, 01, 04, 46, 47, 88, 91, 98, A1, B1, C1, FF
    spi $byte CANINTE FF FF; violation $byteh Table 12-1; CANINTE = 0
12.1: an instruction ends when CS rises, and the next begins when CS falls
    spi; spi WRITE; spi READ CANSTAT; CANSTAT = 80
12.2, 8.1: the start-up timer runs after RESET
    in NORMAL; spi RESET; CNF3 <- 1 91 0; violation instruction 02h start-up 8.1; bits 8
    CNF3 = 0 0 0; CNF3 <- 1 91 0; CNF3 = 1 91 0
",
    );
}

#[test]
fn buffers() {
    run_all(
        "
Figure 12-5: LOAD TX BUFFER fills three buffers, from SIDH or from D0
    each $spi $byte $address: 40 C0 31, 41 C1 36, 42 C2 41, 43 C3 46, 44 C4 51, 45 C5 56
    spi $spi $byte E1; $address = $byte E1
12.6: a buffer ends at D7
    spi 41 11 11 11 11 11 11 11 11; spi 41 11 11 11 11 11 11 11 11 80 80; CANCTRL = 87
    violation LOAD TX BUFFER D7
12.7: bits 2 to 0 of RTS request the transmission of TXB2 to TXB0
    each $rts $0 $1 $2: 0 0 0 0, 1 8 0 0, 2 0 8 0, 3 8 8 0, 4 0 0 8, 5 8 0 8, 6 0 8 8, 7 8 8 8
    rts $rts; TXB0CTRL = $0; TXB1CTRL = $1; TXB2CTRL = $2
Figure 12-3: READ RX BUFFER reads two buffers, from SIDH or from D0; 92h is RXB0's data, not RXB1
    each $spi $flags $answer: 90 RX1IF 9+B+45+67+8+1+2+3, 92 RX1IF 1+2+3+4+5+6+7+8, \
                              94 RX0IF D5+E8+DE+F0+8+B+C+D, 96 RX0IF B+C+D+E+F+10+11+12
    in NORMAL; RXB0CTRL <- BUKT; peer 01234567#0102030405060708 1ABCDEF0#0B0C0D0E0F101112
    CANINTF = RX0IF|RX1IF; spi $spi 0 0 0 0 0 0 0 0 -> $answer; CANINTF = $flags
12.4: reading an empty buffer returns old data, and can discard the next frame
    in NORMAL; peer 123#01; spi 94 0 0; violation 94h RX1IF 12.4; CANINTF = RX0IF
12.4: READ RX BUFFER that ends at once clears the flag of a frame that was not read
    in NORMAL; peer 123#01; spi 90; violation RXB0 thrown away; CANINTF = 0
Figure 12-8: READ STATUS has flags
    each $flags $status: 01 01, 02 02, 04 08, 08 20, 10 80, E0 00
    CANINTF <- $flags; spi READ_STATUS 0 -> $status
Figure 12-8: ... and requests
    each $ctrl $status: TXB0CTRL 04, TXB1CTRL 10, TXB2CTRL 40
    $ctrl <- TXREQ; spi READ_STATUS 0 -> $status
Figure 12-9: bits 4 and 3 of RX STATUS are the type of the message. 12.9: it is repeated
    each $frame $status: 123#01 40, 123#R1 48, 00000123#01 51, 00000123#R1 59
    in NORMAL; peer $frame; spi RX_STATUS 0 0 -> $status $status
",
    );
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
        bench.run_to_flag();
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
