//! Programs whose handlers, vectors and stores change what the rest of the program rests on. Each
//! has its true bound, or is refused with the address.

use std::path::Path;

use crate::support::{NO_HANDLER, SET_SP, assembled, build, read, refusal, stack};
use avr_bounds::annotations::Annotations;
use avr_bounds::program::Program;
use avr_bounds::stack::Analysis;
use avr_bounds::times::{Times, times};
use avr_bounds::whole::Stack;

/// A function that takes 20 bytes with its return address.
const DEEP: &str = "
    .type deep, @function
    deep:
    .rept 18
    push r2
    .endr
    .rept 18
    pop r2
    .endr
    ret
";

/// A program whose main part can be interrupted by INT0, and by INT1 if there is one.
fn program(main: &str, int0: &str, further: &str) -> Program {
    assembled(
        "sound",
        &format!(
            "{DEEP}\n{SET_SP}\nsbi 0x1D, 0\nsbi 0x1D, 1\n{main}\n.type int0, @function\n\
             int0: {int0}\nreti\n{further}"
        ),
    )
}

fn without_handler(main: &str) -> Program {
    assembled("sound", &format!("{DEEP}\n{SET_SP}\n{main}\n{NO_HANDLER}"))
}

/// The stack of a program in which `deep` can be called.
#[track_caller]
fn reaches_deep(program: &Program) -> Stack {
    let stack = stack(program).unwrap();
    assert!(stack.bytes >= 20, "{stack:?}");
    stack
}

#[track_caller]
fn is_refused(program: &Program, why: &str) {
    let text = refusal(stack(program));
    assert!(text.contains("0x") && text.contains(why), "{text}");
}

fn timed(program: &Program) -> Times {
    let none = Annotations::default();
    times(&mut Analysis::new(program, &none)).unwrap()
}

/// A program of tests/programs.
fn committed(file: &str, options: &[&str]) -> Program {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs").join(file);
    let (name, ending) = file.split_once('.').unwrap();
    read(&build(name, ending, &std::fs::read_to_string(path).unwrap(), options))
}

#[test]
fn what_follows_a_wait_for_an_enable_bit_that_a_handler_sets_counts() {
    for optimisation in ["-Os", "-O2", "-O0"] {
        let stack = stack(&committed("wait_for_mask.c", &[optimisation])).unwrap();
        assert!(stack.bytes >= 106, "{stack:?}");
    }
}

#[test]
fn a_table_of_vectors_with_returns_has_the_handlers_behind_them() {
    let program = committed("own_table.S", &["-nostartfiles"]);
    // The return address and four registers; the call of deep.
    assert_eq!(stack(&program).unwrap().bytes, 6 + 2);
    assert_eq!(timed(&program).handlers[0].cycles.0, 184);
}

#[test]
fn an_addition_changes_the_half_carry() {
    assert_eq!(timed(&committed("half_carry.S", &["-Os"])).handlers[0].cycles.0, 196);
}

#[test]
fn a_register_that_a_handler_changes_is_not_known() {
    for (before, wait, handler) in [
        ("ldi r20, 1", "cpi r20, 1", "ldi r20, 2"),
        ("ldi r20, 1", "cpi r20, 1", "mov r20, r3"),
        ("ldi r20, 1", "cpi r20, 1", "push r20\npop r3\ninc r20"),
        ("ldi r20, 1", "cpi r20, 1", "sts 0x14, r3"),
    ] {
        let main = format!("{before}\nsei\n1: {wait}\nbreq 1b\ncall deep\n2: rjmp 2b");
        let saved = format!("push r24\nin r24, 0x3F\n{handler}\nout 0x3F, r24\npop r24");
        reaches_deep(&program(&main, &saved, ""));
    }
    // Without a handler that changes it nothing is behind the loop.
    let main = "ldi r20, 1\nsei\n1: cpi r20, 1\nbreq 1b\ncall deep\n2: rjmp 2b";
    assert_eq!(stack(&program(main, "push r20\nldi r20, 2\npop r20", "")).unwrap().bytes, 2 + 1);
}

#[test]
fn each_flag_that_a_handler_changes_is_not_known() {
    for flag in ["c", "z", "n", "v", "s", "h", "t"] {
        let branch = format!("brb{}", if flag == "x" { "s" } else { "c" });
        let bit = "cznvsht".find(flag).unwrap();
        let main = format!("bclr {bit}\nsei\n1: {branch} {bit}, 1b\ncall deep\n2: rjmp 2b");
        reaches_deep(&program(&main, &format!("bset {bit}"), ""));
        // Saved and restored.
        let saves = format!("push r24\nin r24, 0x3F\nbset {bit}\nout 0x3F, r24\npop r24");
        assert_eq!(stack(&program(&main, &saves, "")).unwrap().bytes, 2 + 1, "{flag}");
    }
}

/// INT1 is masked, and INT0's handler unmasks it.
#[test]
fn a_handler_that_another_unmasks_counts() {
    let main = "cbi 0x1D, 1\nldi r20, 1\nsei\n1: cpi r20, 1\nbreq 1b\ncall deep\n2: rjmp 2b";
    let int1 = ".type int1, @function\nint1: ldi r20, 2\nreti";
    reaches_deep(&program(main, "sbi 0x1D, 1", int1));
    assert_eq!(stack(&program(main, "nop", int1)).unwrap().bytes, 2);
}

/// A bit that the program reads, changes and writes keeps the others.
#[test]
fn a_read_modify_write_of_a_handler_changes_its_bit_only() {
    let main = "ldi r20, 1\nsts 0x6E, r20\nsei\n\
                1: lds r24, 0x6E\nsbrc r24, BIT\nrjmp 1b\ncall deep\n2: rjmp 2b";
    let int0 = "push r24\npush r25\nin r25, 0x3F\nlds r24, 0x6E\nandi r24, 0xFD\nsts 0x6E, r24\n\
                out 0x3F, r25\npop r25\npop r24";
    // `sbrc` skips if the bit is 0.
    let program = program(&main.replace("BIT", "0"), int0, "");
    assert!(stack(&program).is_ok());
}

#[test]
fn a_register_of_the_core_can_be_written_by_its_address() {
    reaches_deep(&without_handler(
        "ldi r16, 1\nldi r17, 0\nsts 0x10, r17\ntst r16\nbrne 1f\ncall deep\n1: rjmp 1b",
    ));
}

/// Two reads of SREG are not equal.
#[test]
fn a_copy_of_sreg_is_no_number() {
    reaches_deep(&without_handler(
        "in r24, 0x3F\nsec\nin r25, 0x3F\ncp r24, r25\nbreq 1f\ncall deep\n1: rjmp 1b",
    ));
}

#[test]
fn a_handler_that_changes_sp_or_its_return_address_is_refused() {
    let main = "sei\n1: rjmp 1b";
    for (int0, why) in [
        ("ldi r24, 0x80\nldi r25, 4\nout 0x3E, r25\nout 0x3D, r24", "SP is set to a constant"),
        ("pop r24\npop r25\npush r3\npush r4", "a pop without a push"),
        ("push r3\npush r4\nreti", "returns with 2 bytes on the stack"),
        ("in r30, 0x3D\nin r31, 0x3E\nstd Z+1, r3", "overwrites the return address"),
        ("in r30, 0x3D\nin r31, 0x3E\nstd Z+3, r3", "a store above the stack of a handler"),
        (
            "in r30, 0x3D\nin r31, 0x3E\nadd r30, r3\nadc r31, r4\nout 0x3E, r31\nout 0x3D, r30",
            "SP is set to a computed value",
        ),
    ] {
        is_refused(&program(main, int0, ""), why);
    }
}

#[test]
fn a_function_may_not_overwrite_the_return_address_of_its_caller() {
    let f = |offset: u32| {
        without_handler(&format!(
            "call g\n1: rjmp 1b
             .type g, @function
             g: push r16
             call f
             pop r16
             ret
             .type f, @function
             f: in r30, 0x3D
             in r31, 0x3E
             std Z+{offset}, r3
             ret"
        ))
    };
    // The register that g has pushed, and its return address.
    assert!(stack(&f(3)).is_ok());
    is_refused(&f(4), "overwrites the return address");
    // What g has pushed is not known then.
    let clears = without_handler(
        "ldi r16, 1\npush r16\ncall f\npop r16\ntst r16\nbrne 1f\ncall deep\n1: rjmp 1b
         .type f, @function
         f: in r30, 0x3D
         in r31, 0x3E
         std Z+3, r1
         ret",
    );
    reaches_deep(&clears);
}

#[test]
fn a_store_to_a_fixed_address_in_the_stack_is_refused() {
    let at = |address: &str| without_handler(&format!("call deep\nsts {address}, r3\n1: rjmp 1b"));
    assert!(stack(&at("0x4EB")).is_ok());
    for address in ["0x4EC", "0x4FF"] {
        is_refused(&at(address), "where the stack can be");
    }
}

#[test]
fn a_store_to_an_unknown_register_of_the_core_or_of_interrupts_is_refused() {
    let to = |most: &str, displacement: u32| {
        without_handler(&format!(
            "in r30, 3\nandi r30, {most}\nldi r31, 0\nstd Z+{displacement}, r3\n1: rjmp 1b"
        ))
    };
    // DDRB to PORTD.
    assert!(stack(&to("7", 0x24)).is_ok());
    is_refused(&to("0x1F", 0), "a store to one of the registers from 0x0 to 0x1f");
}

#[test]
fn an_interrupt_between_the_writes_of_sp_is_refused() {
    let moves = |before: &str| {
        without_handler(&format!(
            "sei
             call f
             1: rjmp 1b
             .type f, @function
             f: in r28, 0x3D
             in r29, 0x3E
             sbiw r28, 8
             in r0, 0x3F
             {before}
             out 0x3E, r29
             out 0x3F, r0
             out 0x3D, r28
             adiw r28, 8
             cli
             out 0x3E, r29
             out 0x3F, r0
             out 0x3D, r28
             ret"
        ))
    };
    assert!(stack(&moves("cli")).is_ok());
    is_refused(&moves(""), "an interrupt can come between the writes of SPH and SPL");
}

#[test]
fn a_move_of_the_vectors_is_refused() {
    is_refused(&without_handler("ldi r24, 3\nout 0x35, r24\n1: rjmp 1b"), "IVSEL");
    is_refused(&without_handler("out 0x35, r3\n1: rjmp 1b"), "IVSEL");
    // The pull-ups.
    let main = "in r24, 0x35\nori r24, 0x10\nout 0x35, r24\n1: rjmp 1b";
    assert!(stack(&without_handler(main)).is_ok());
}

/// It begins in the boot section, so its vectors are where the ELF has no others.
#[test]
fn a_loader_that_enables_interrupts_is_refused() {
    let options = ["-nostartfiles", "-nostdlib", "-Wl,-Ttext=0x3800"];
    let text = ".global start\nstart: eor r1, r1\nsei\n1: rjmp 1b";
    is_refused(&read(&build("loader", "S", text, &options)), "its table of vectors is not known");
}

/// A table in which the code of a handler stands at the vector.
#[test]
fn a_vector_can_contain_any_code() {
    let options = ["-nostartfiles", "-nostdlib"];
    let text = |int0: &str| {
        format!(
            ".global start\n.type start, @function\n.text\n rjmp start\n nop\n {int0}\n\
             start: ldi r28, 0xFF\n ldi r29, 4\n out 0x3E, r29\n out 0x3D, r28\n\
             sbi 0x1D, 0\n sei\n\
             1: rjmp 1b"
        )
    };
    let program = read(&build("inline", "S", &text("push r2\npop r2\nreti"), &options));
    assert_eq!(stack(&program).unwrap().bytes, 2 + 1);
    // Response 4, PUSH 2, POP 2, RETI 4.
    assert_eq!(timed(&program).handlers[0].cycles.0, 12);
    let program = read(&build("inline", "S", &text(".word 0xFFFF\n.word 0xFFFF"), &options));
    is_refused(&program, "the vector of INT0, which the program may enable");
}

/// The interrupt pushes its return address, and the start does not set SP.
#[test]
fn an_interrupt_without_a_handler_restarts_a_program_that_sets_sp() {
    let restarts = without_handler("ldi r24, 1\nsts 0x70, r24\nsei\n1: rjmp 1b");
    let stack = stack(&restarts).unwrap();
    assert!(stack.handlers.iter().any(|handler| handler.restarts), "{stack:?}");
    let program = assembled(
        "restarts",
        &format!(
            ".type start, @function\nstart: ldi r24, 1\nsts 0x70, r24\nsei\n\
             1: rjmp 1b\n{NO_HANDLER}"
        ),
    );
    is_refused(&program, "does not set SP");
}

/// `push r0` is the second word of LDS.
#[test]
fn a_word_can_be_data_and_code() {
    let program = without_handler(
        "call f\n1: rjmp 1b
         .type f, @function
         f: rjmp 2f + 2
         2: lds r24, 0x920F
         pop r0
         ret",
    );
    assert_eq!(stack(&program).unwrap().bytes, 2 + 1);
}

/// The beginning of the loop is no target of a branch.
#[test]
fn a_loop_that_begins_where_ijmp_leads_is_followed_in_general() {
    let program = without_handler(
        "ldi r16, 1
         ldi r30, lo8(pm(3f))
         ldi r31, hi8(pm(3f))
         ijmp
         nop
         3: tst r16
         breq 4f
         dec r16
         ijmp
         4: call deep
         5: rjmp 5b",
    );
    reaches_deep(&program);
    assert!(timed(&program).is_bounded());
}

/// EECR through a pointer: ST 2 and four cycles in which the core halts.
#[test]
fn a_read_of_the_eeprom_halts_the_core() {
    let main = "sei\n1: rjmp 1b";
    let program = program(main, "ldi r30, 0x3F\nldi r31, 0\nldi r24, 1\nst Z, r24", "");
    assert_eq!(timed(&program).handlers[0].cycles.0, 7 + 3 + 2 + 4 + 4);
}

/// Interrupts that come while a counter is counted down, and do not save it.
#[test]
fn a_delay_whose_counter_a_handler_changes_has_no_bound() {
    let main = "sei\n1: ldi r24, 200\n2: dec r24\nbrne 2b\nrjmp 1b";
    let bounded = timed(&program(main, "push r24\nldi r24, 9\npop r24", ""));
    assert!(bounded.turn.unwrap().cycles.is_bounded());
    for int0 in ["ldi r24, 9", "clz"] {
        let times = timed(&program(main, int0, ""));
        assert!(!times.turn.unwrap().cycles.is_bounded(), "{int0}");
    }
}

/// The reset sets SP and begins at the vector of the reset.
#[test]
fn a_wait_for_a_reset_by_the_watchdog_is_a_loop_that_never_ends() {
    let program = without_handler(
        "ldi r24, 0x18\nldi r25, 8\ncli\nwdr\nsts 0x60, r24\nsts 0x60, r25\ncall deep\n1: rjmp 1b",
    );
    assert_eq!(stack(&program).unwrap().bytes, 20);
}

/// A copy of SREG that meets another one of the same state, as in a loop of C.
#[test]
fn a_critical_section_in_a_loop_ends() {
    let main = "sei\n1: in r18, 0x3F\ncli\nlds r24, 0x100\nout 0x3F, r18\n\
                tst r24\nbrne 1b\nrjmp 1b";
    let times = timed(&without_handler(main));
    assert!(times.is_bounded(), "{times:?}");
}

/// As in `__do_global_ctors` of libgcc.
#[test]
fn the_constructors_of_cpp_are_called() {
    let text = "struct deep { deep(); } made;
        volatile char n;
        __attribute__((noinline)) deep::deep() { volatile char bytes[50]; bytes[n] = 1; }
        int main() { for (;;) n++; }";
    let elf = build("constructors", "cpp", text, &["-Os"]);
    assert!(stack(&read(&elf)).unwrap().bytes > 50);
}
