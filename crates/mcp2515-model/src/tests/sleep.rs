//! Sleep and wake-up.

use super::script::run_all;

/// 8 bits are 128 periods of a 16 MHz crystal (DS20001801J 8.1).
#[test]
fn sleep_and_wake_up() {
    run_all(
        "
10.2: the chip enters sleep when the bus is idle, not during a frame
    in NORMAL; busy; request SLEEP; bits 50; mode = NORMAL; wait; mode = SLEEP
10.2: registers can be accessed in sleep
    CANINTE <- WAKIF; in SLEEP; TXB0D0 <- 77; TXB0D0 = 77; mode = SLEEP
7.5, 10.2.1: bus activity sets WAKIF, pulls INT, and after the start-up time the chip listens only
    CANINTE <- WAKIF; in SLEEP; int high; queue 123#01; bits 2; int low; shows CANINTF WAKIF
    mode = SLEEP; bits 9; mode = LISTEN_ONLY; OPMOD = LISTEN_ONLY
10.2.1: the message that woke the chip is not received
    CANINTE <- WAKIF; in SLEEP; witness; peer 123#01; CANINTF = WAKIF; peer 124#01
    CANINTF = WAKIF|RX0IF; enter NORMAL
10.2.1: without WAKIE bus activity does not wake the chip
    in SLEEP; peer 123#01; OPMOD = SLEEP; CANINTF = 0
10.2: the MCU wakes the chip by setting WAKIF while WAKIE is set
    CANINTE <- WAKIF; in SLEEP; modify CANINTF WAKIF WAKIF; bits 8; OPMOD = LISTEN_ONLY
    modify CANINTF WAKIF 0; enter NORMAL; peer 123#01; CANINTF = RX0IF
10.2: WAKIF alone does not wake the chip
    in SLEEP; modify CANINTF WAKIF WAKIF; wait; OPMOD = SLEEP
8.1: no SPI operation until the start-up time has passed
    CANINTE <- WAKIF; in SLEEP; modify CANINTF WAKIF WAKIF; CANINTE <- 0; violation start-up 8.1
    wait; CANINTE = WAKIF
10.2: a mode request does not wake the chip
    CANINTE <- WAKIF; in SLEEP; request NORMAL; wait; OPMOD = SLEEP; violation asleep 10.2
8.1, 9.0: RESET works in sleep and starts the oscillator
    CANINTE <- WAKIF; in SLEEP; spi RESET; bits 8; OPMOD = CONFIGURATION
8.1, 9.0: until it has started no instruction works
    CANINTE <- WAKIF; in SLEEP; spi RESET; spi READ CANSTAT 0; violation start-up
10.2: frames requested in sleep wait until normal mode
    CANINTE <- WAKIF; in SLEEP; send 111#; wait; got; modify CANINTF WAKIF WAKIF; wait
    enter NORMAL; wait; got 111#
",
    );
}
