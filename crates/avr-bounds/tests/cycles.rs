//! The times of small programs: each figure is counted by hand, from the instruction set manual.

use crate::support::{SET_SP, assembled, build, compiled, read, refusal};
use avr_bounds::annotations::Annotations;
use avr_bounds::stack::Analysis;
use avr_bounds::times::{Times, TurnTime, times};

/// Enables INT0 and interrupts.
const ENABLE: &str = "
    sbi 0x1D, 0
    sei
";

const NO_MAIN: &str = "rjmp .-2";

/// Options for a program in the boot section.
const LOADER: &[&str] = &["-nostartfiles", "-nostdlib", "-Wl,-Ttext=0x3800"];

fn timed(main: &str, handler: &str, annotations: &str) -> Times {
    let text = format!("{SET_SP}\n{ENABLE}\n{main}\n.type int0, @function\nint0:\n{handler}\nreti");
    let program = assembled("cycles", &text);
    let annotations = Annotations::parse(annotations).unwrap();
    times(&mut Analysis::new(&program, &annotations)).unwrap()
}

/// Cycles of INT0's handler without its response, the jump of the vector and RETI.
#[track_caller]
fn handler(times: &Times) -> u32 {
    let [int0] = &times.handlers[..] else { panic!("{times:?}") };
    assert!(int0.cycles.is_bounded(), "{times:?}");
    int0.cycles.0 - (4 + 3 + 4)
}

fn stretches(times: &Times, blocks: &str) -> Vec<u32> {
    let of = times.stretches.iter().filter(|stretch| stretch.blocks == blocks);
    of.map(|stretch| stretch.cycles.0).collect()
}

/// The turns with a call of each function, the longest first.
fn through(turn: &TurnTime) -> Vec<(&str, u32)> {
    turn.through.iter().map(|time| (time.function.as_str(), time.cycles.0)).collect()
}

#[test]
fn the_longer_of_two_paths_counts() {
    // IN 1, SBRC 1 and no skip, LDS 2, MUL 2; the other path has the skip of two words, 3.
    let times = timed(NO_MAIN, "in r24, 0x03\nsbrc r24, 0\nlds r25, 0x100\nmul r24, r25", "");
    assert_eq!(handler(&times), 1 + 1 + 2 + 2);
}

#[test]
fn a_counted_loop_has_the_bound_of_its_counter() {
    // LDI 1, then ten rounds of ST 2, DEC 1, BRNE 2, the last of which does not branch.
    let text = "ldi r24, 10\n1: st X+, r1\ndec r24\nbrne 1b";
    assert_eq!(handler(&timed(NO_MAIN, text, "")), 1 + 10 * 5 - 1);
}

#[test]
fn a_loop_with_a_counter_in_a_range_has_the_largest_of_its_bounds() {
    // IN 1, ANDI 1, INC 1; from 1 to 8 rounds of NOP 1, DEC 1, BRNE 2.
    let text = "in r24, 0x03\nandi r24, 7\ninc r24\n1: nop\ndec r24\nbrne 1b";
    assert_eq!(handler(&timed(NO_MAIN, text, "")), 3 + 8 * 4 - 1);
}

#[test]
fn a_delay_of_a_million_rounds_is_counted() {
    // Rounds of SUBI 1, SBCI 1, SBCI 1, BRNE 2.
    let text = "ldi r18, 0x40\nldi r24, 0x42\nldi r25, 0x0F\n\
                1: subi r18, 1\nsbci r24, 0\nsbci r25, 0\nbrne 1b";
    assert_eq!(handler(&timed(NO_MAIN, text, "")), 3 + 0xF_4240 * 5 - 1);
}

#[test]
fn a_delay_until_a_borrow_has_a_round_more() {
    // From 300 by 7 until less than 0: 42 rounds go back, and the 43rd does not.
    let text = "ldi r24, 0x2C\nldi r25, 1\n1: sbiw r24, 7\nbrcc 1b";
    assert_eq!(handler(&timed(NO_MAIN, text, "")), 2 + 42 * 4 + 3);
}

#[test]
fn a_loop_that_ends_by_a_value_in_memory_has_no_bound() {
    let text = "1: lds r24, 0x100\ntst r24\nbrne 1b";
    let times = timed(NO_MAIN, text, "");
    assert!(!times.is_bounded());
    let [missing] = &times.missing[..] else { panic!("{times:?}") };
    assert!(missing.contains("in int0: loop 1 has no bound"), "{missing}");
    let annotation = "[[loop]]\nfunction = \"int0\"\nat_most = 4\nreason = \"a test\"";
    // Five rounds of LDS 2, TST 1, BRNE 2.
    assert_eq!(handler(&timed(NO_MAIN, text, annotation)), 5 * 5 - 1);
}

#[test]
fn an_unbounded_loop_of_the_main_program_leaves_the_handlers_bounded() {
    let times = timed("2: nop\n1: lds r24, 0x100\ntst r24\nbrne 1b\nrjmp 2b", "nop", "");
    assert_eq!(handler(&times), 1);
    assert!(times.is_bounded());
    assert!(!times.turn.unwrap().cycles.is_bounded());
}

/// A wait for something outside of the chip.
const UNTIL: &str = "[[loop]]\nfunction = \"int0\"\nuntil = \"a test\"\nreason = \"a test\"";

#[test]
fn a_wait_for_something_outside_is_listed_and_not_counted() {
    // SEI of the start, LDS 2, TST 1, BRNE 2; CLI 1, NOP 1, SEI 1, RJMP 2 in each turn.
    let main = "2: cli\nnop\nsei\n1: lds r24, 0x100\ntst r24\nbrne 1b\nrjmp 2b";
    let times = timed(main, "nop", &UNTIL.replace("int0", "start"));
    let [open] = &times.open[..] else { panic!("{times:?}") };
    assert_eq!((open.number, open.cycles.0, open.until.as_str()), (2, 5, "a test"));
    assert!(times.is_explained() && times.is_bounded(), "{times:?}");
    assert!(stretches(&times, "interrupts").contains(&3), "{times:?}");
    // The turn contains the wait.
    assert!(!times.turn.unwrap().cycles.is_bounded());
}

#[test]
fn a_wait_for_something_outside_leaves_a_handler_without_a_bound() {
    let times = timed(NO_MAIN, "1: lds r24, 0x100\ntst r24\nbrne 1b", UNTIL);
    assert!(!times.is_bounded());
    assert!(times.missing[0].contains("INT0 contains a loop that is not counted"), "{times:?}");
}

#[test]
fn a_wait_for_something_outside_leaves_a_blocked_stretch_without_a_bound() {
    let main = "2: cli\n1: lds r24, 0x100\ntst r24\nbrne 1b\nsei\nrjmp 2b";
    let times = timed(main, "nop", &UNTIL.replace("int0", "start"));
    assert!(!times.is_bounded(), "{times:?}");
}

#[test]
fn the_rounds_that_an_annotation_names_are_the_turns() {
    // LDS 2, TST 1, BRNE 2.
    let main = "2: nop\n1: lds r24, 0x100\ntst r24\nbrne 1b\nrjmp 2b";
    let annotation = format!("{}\nis_turn = true", UNTIL.replace("int0", "start"));
    assert_eq!(timed(main, "nop", &annotation).turn.unwrap().cycles.0, 5);
}

#[test]
fn an_annotation_of_a_loop_that_begins_otherwise_is_refused() {
    let text = "1: lds r24, 0x100\ntst r24\nbrne 1b";
    let annotation = "[[loop]]\nfunction = \"int0\"\nnumber = 1\nbegins = \"nop\"\n\
                      at_most = 4\nreason = \"a test\"";
    assert!(timed(NO_MAIN, text, &annotation.replace("nop", "lds r24, 0x0100")).is_bounded());
    let program = assembled(
        "cycles",
        &format!("{SET_SP}\n{ENABLE}{NO_MAIN}\n.type int0, @function\nint0:{text}\nreti"),
    );
    let annotations = Annotations::parse(annotation).unwrap();
    let text = refusal(times(&mut Analysis::new(&program, &annotations)));
    assert!(text.contains("loop 1 begins with `lds r24, 0x0100`"), "{text}");
}

#[test]
fn a_loader_has_a_time_from_the_reset_to_the_jump_to_0() {
    // EOR 1; IN 1, SBRS 1 and no skip, RJMP 2, NOP 1, JMP 3; the other path skips.
    let text = ".global start\nstart: eor r1, r1\nin r24, 3\nsbrs r24, 0\nrjmp 1f\nrjmp 2f\n\
                1: nop\n2: jmp 0";
    let program = read(&build("loader", "S", text, LOADER));
    let none = Annotations::default();
    assert_eq!(times(&mut Analysis::new(&program, &none)).unwrap().start.unwrap().0, 9);
}

/// Rounds that are not followed one by one.
#[test]
fn an_annotated_loop_of_many_rounds_has_all_their_time() {
    let text = "1: lds r24, 0x100\ntst r24\nbrne 1b";
    let annotation = "[[loop]]\nfunction = \"int0\"\nat_most = 4000\nreason = \"a test\"";
    assert_eq!(handler(&timed(NO_MAIN, text, annotation)), 4001 * 5 - 1);
    // A counter that the wait does not depend on: INC 1.
    let text = "1: inc r25\nlds r24, 0x100\ntst r24\nbrne 1b";
    assert_eq!(handler(&timed(NO_MAIN, text, annotation)), 4001 * 6 - 1);
}

#[test]
fn a_sleep_in_a_handler_has_no_bound() {
    assert!(!timed(NO_MAIN, "sleep", "").is_bounded());
}

#[test]
fn a_wait_for_the_spi_takes_as_long_as_a_byte() {
    let text = "out 0x2E, r24\n1: in r24, 0x2D\nsbrs r24, 7\nrjmp 1b";
    let annotation = "[[wait]]\nregister = 0x4D\ncycles = 17\nreason = \"a test\"";
    // OUT 1; a round of IN 1, SBRS 1, RJMP 2 goes back 5 times, and the last round skips.
    assert_eq!(handler(&timed(NO_MAIN, text, annotation)), 1 + 5 * 4 + 3);
}

#[test]
fn a_stretch_without_interrupts_is_counted_to_the_instruction_that_ends_it() {
    // CLI 1, LDS 2, STS 2, OUT 1.
    let main = "1: in r24, 0x3F\ncli\nlds r25, 0x100\nsts 0x101, r25\nout 0x3F, r24\nrjmp 1b";
    assert_eq!(stretches(&timed(main, "nop", ""), "interrupts"), [12, 6]);
}

#[test]
fn stretches_that_meet_have_each_its_time() {
    // From the first CLI: CLI 1, SBIS 2, NOP 1, SEI 1, and from the second CLI 1, NOP 1, SEI 1.
    let main = "1: cli\nsbis 0x03, 0\nrjmp 2f\n3: nop\nsei\nrjmp 1b\n2: sei\ncli\nrjmp 3b";
    let found = stretches(&timed(main, "nop", ""), "interrupts");
    // CLI 1, SBIS 2, NOP 1, SEI 1; CLI 1, RJMP 2, NOP 1, SEI 1; CLI 1, SBIS 1, RJMP 2, SEI 1.
    assert_eq!(found.iter().filter(|cycles| **cycles == 5).count(), 3, "{found:?}");
}

/// Interrupts are enabled or not where the second stretch begins.
#[test]
fn a_stretch_that_may_have_begun_before_has_its_own_time() {
    let main = "1: cli\nsbis 0x03, 0\nsei\ncli\nnop\nsei\nrjmp 1b";
    let found = stretches(&timed(main, "nop", ""), "interrupts");
    // CLI 1, SBIS 1, SEI 1; CLI 1, SBIS 2, CLI 1, NOP 1, SEI 1; from the second: CLI 1, NOP 1,
    // SEI 1.
    assert_eq!(found, [12, 6, 3, 3]);
}

/// As with ATOMIC_BLOCK of avr-libc without optimisation.
#[test]
fn a_stretch_that_ends_by_an_unknown_sreg_has_no_bound() {
    let main = "1: in r24, 0x3F\ncli\nsts 0x100, r24\nlds r25, 0x100\nout 0x3F, r25\nrjmp 1b";
    let times = timed(main, "nop", "");
    assert!(!times.is_bounded(), "{times:?}");
    assert!(times.missing.iter().any(|text| text.contains("SREG")), "{times:?}");
}

#[test]
fn a_program_that_stops_with_interrupts_disabled_is_bounded() {
    // CLI 1, NOP 1, SEI 1.
    let main = "1: cli\nnop\nsei\nsbis 0x03, 0\nrjmp 1b\ncli\n2: rjmp 2b";
    let times = timed(main, "nop", "");
    assert!(times.is_bounded() && stretches(&times, "interrupts").contains(&3), "{times:?}");
}

/// A function that is called while interrupts are disabled, and enables them.
#[test]
fn a_stretch_that_ends_in_a_function_counts() {
    // CLI 1, CALL 4, NOP 1, SEI 1.
    let main = "1: cli\ncall f\nrjmp 1b\n.type f, @function\nf: nop\nsei\nret";
    assert_eq!(stretches(&timed(main, "nop", ""), "interrupts"), [12, 7]);
}

/// The calls of the second kind are in a function of no kind.
#[test]
fn each_combination_of_kinds_of_turns_has_its_own_bound() {
    let main = "1: in r24, 0x03\nsbrc r24, 0\nrcall a\nsbrc r24, 1\nrcall b\nrjmp 1b\n\
        .type a, @function\na: nop\nret\n.type b, @function\nb: rcall c\nret\n\
        .type c, @function\nc: nop\nnop\nret";
    let kinds = "
        [[turn]]
        kind = 'first'
        calls = ['a', 'not_there']
        [[turn]]
        kind = 'second'
        calls = ['c']";
    let turn = timed(main, "nop", kinds).turn.unwrap();
    let seen: Vec<(&[String], u32)> =
        turn.of_kinds.iter().map(|time| (&time.names[..], time.cycles.0)).collect();
    let [first, second] = ["first".to_owned(), "second".to_owned()];
    // IN 1, SBRC 1 or with the skip 2, RCALL 3, RJMP 2. A call of a takes 5 more, and one of b 13.
    assert_eq!(
        seen,
        [
            (&[first.clone(), second.clone()][..], 1 + 4 + 5 + 4 + 13 + 2),
            (&[second], 1 + 2 + 4 + 13 + 2),
            (&[first], 1 + 4 + 5 + 2 + 2),
            (&[], 1 + 2 + 2 + 2),
        ]
    );
    assert_eq!(turn.cycles.0, 29);
    let none = timed(main, "nop", "").turn.unwrap();
    assert!(none.of_kinds.is_empty() && none.cycles == turn.cycles);
}

/// Most turns that call `c` do so by way of `b`, which takes longer.
#[test]
fn a_turn_with_a_call_of_a_function_can_call_it_by_way_of_another() {
    let main = "1: in r24, 0x03\nsbrc r24, 0\nrjmp 2f\nrcall b\nrjmp 1b\n2: rcall c\nrjmp 1b\n\
        .type b, @function\nb: nop\nrcall c\nret\n.type c, @function\nc: nop\nret";
    let turn = timed(main, "nop", "").turn.unwrap();
    // IN 1, SBRC with the skip 2, RCALL 3, RJMP 2; b: NOP 1, RCALL 3, RET 4; c: NOP 1, RET 4.
    let by_way_of_b = 1 + 2 + 3 + (1 + 3 + 5 + 4) + 2;
    assert_eq!(through(&turn), [("b", by_way_of_b), ("c", by_way_of_b)]);
}

/// Its symbol has no type, as those of libgcc, so the jump stays in the function that jumps.
#[test]
fn a_turn_that_jumps_into_a_function_is_one_with_a_call_of_it() {
    let main = "1: in r24, 0x03\nsbrc r24, 0\nrjmp 2f\nrcall c\nrjmp 1b\n2: rcall b\nrjmp 1b\n\
        .type b, @function\nb: nop\nrjmp c\nc: nop\nret";
    let kind = "[[turn]]\nkind = 'of c'\ncalls = ['c']";
    let turn = timed(main, "nop", kind).turn.unwrap();
    // IN 1, SBRC 1, RJMP 2, RCALL 3; b: NOP 1, RJMP 2; c: NOP 1, RET 4; RJMP 2.
    let longest = 1 + 1 + 2 + 3 + (1 + 2) + (1 + 4) + 2;
    assert_eq!(turn.cycles.0, longest);
    assert_eq!(through(&turn), [("b", longest), ("c", longest)]);
    let [of_c] = &turn.of_kinds[..] else { panic!("{:?}", turn.of_kinds) };
    assert_eq!((&of_c.names[..], of_c.cycles.0), (&["of c".to_owned()][..], longest));
}

/// A stretch that begins at the end of a turn and ends in the next turn.
#[test]
fn a_stretch_from_one_turn_to_the_next_counts() {
    // CLI 1, NOP 1, RJMP 2, LDS 2, SEI 1.
    let main = "1: lds r24, 0x100\nsei\nnop\ncli\nnop\nrjmp 1b";
    assert!(stretches(&timed(main, "nop", ""), "interrupts").contains(&7));
}

#[test]
fn a_mask_of_the_handler_that_nests_is_a_stretch_of_its_own() {
    let main = "1: cbi 0x1D, 0\nmul r2, r3\nsbi 0x1D, 0\nrjmp 1b";
    let times = timed(main, "cbi 0x1D, 0\nsei\nnop\ncli\nsbi 0x1D, 0", "");
    // The handler: response 4, JMP 3, CBI 2, SEI 1, NOP 1, CLI 1, SBI 2, RETI 4. The mask: CBI 2,
    // MUL 2, SBI 2.
    assert_eq!(stretches(&times, "INT0"), [18, 6]);
    // Response 4, JMP 3, CBI 2, SEI 1; CLI 1, SBI 2, RETI 4.
    assert_eq!(stretches(&times, "interrupts"), [10, 7]);
}

/// `_delay_ms` of avr-libc, a division of libgcc, and a handler that the compiler has made.
#[test]
fn a_program_of_avr_gcc_is_bounded() {
    let program = compiled(
        "delay",
        "#define F_CPU 16000000UL
         #include <avr/interrupt.h>
         #include <util/delay.h>
         volatile uint16_t count, by;
         ISR(INT0_vect) { count = count / by; }
         int main(void) {
             EIMSK = 1;
             sei();
             for (;;) { _delay_ms(100); cli(); PORTB ^= 1; _delay_us(10); sei(); }
         }",
        "-Os",
    );
    let none = Annotations::default();
    let times = times(&mut Analysis::new(&program, &none)).unwrap();
    assert!(times.is_bounded(), "{times:?}");
    // A division takes 16 rounds; the compiler saves 14 registers.
    assert!((200..400).contains(&times.handlers[0].cycles.0), "{times:?}");
    let turn = times.turn.unwrap().cycles.0;
    assert!((1_600_160..1_600_250).contains(&turn), "{turn}");
    let masked = times.stretches.iter().find(|stretch| stretch.begins.contains("main")).unwrap();
    assert!((160..180).contains(&masked.cycles.0), "{masked:?}");
}

#[test]
fn the_time_of_a_bit_of_a_port_counts_from_the_response() {
    // Response 4, JMP 3, NOP 1, CALL 4, NOP 1, SBI 2.
    let times =
        timed("1: rjmp 1b\n.type f, @function\nf: nop\nsbi 0x05, 2\nret", "nop\ncall f", "");
    let [bit] = &times.handlers[0].bits[..] else { panic!("{times:?}") };
    assert_eq!((bit.register, bit.bit, bit.is_set, bit.cycles.0), (0x25, 2, true, 15));
}

#[test]
fn the_time_from_the_last_look_at_a_pin_ends_with_reti() {
    // SBIS 1 and no skip, RJMP 2, NOP 1, RETI 4; the other path skips and uses the SPI.
    let text = "in r24, 0x09\nsbis 0x09, 2\nrjmp 1f\nout 0x2E, r24\n1: nop";
    let times = timed("1: rjmp 1b", text, "");
    let [look] = &times.handlers[0].looks[..] else { panic!("{times:?}") };
    assert_eq!((look.register, look.cycles.0), (0x29, 2 + 1 + 4));
}

/// A bootloader reads the flash that the program before it fills.
#[test]
fn flash_that_is_not_in_the_elf_can_have_any_value() {
    let text = ".global start\nstart: eor r1, r1\n2: ldi r30, 0x68\nldi r31, 0\nlpm r24, Z\n\
                1: dec r24\nbrne 1b\nrjmp 2b";
    let program = read(&build("loader", "S", text, LOADER));
    let none = Annotations::default();
    let turn = times(&mut Analysis::new(&program, &none)).unwrap().turn.unwrap();
    // LDI 1, LDI 1, LPM 3; from 0 256 rounds of DEC 1 and BRNE 2, the last 1; RJMP 2.
    assert_eq!(turn.cycles.0, 5 + 256 * 3 - 1 + 2);
}

/// SBCI leaves Z as SUBI has set it if its own result is zero, so this loop never ends.
#[test]
fn a_loop_that_subtracts_twice_from_a_register_is_no_countdown() {
    let times = timed(NO_MAIN, "ldi r24, 20\n1: subi r24, 3\nsbci r24, 2\nbrne 1b", "");
    assert!(!times.is_bounded(), "{times:?}");
}
