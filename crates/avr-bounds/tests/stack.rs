//! The stack of small programs, and programs that are refused, each with the place.

use crate::support::{
    NO_HANDLER, SET_SP, assembled, build, compiled, read, refusal, stack, stack_with,
};

fn program(text: &str) -> avr_bounds::program::Program {
    assembled("stack", &format!("{SET_SP}\n{text}\n{NO_HANDLER}"))
}

#[test]
fn the_parts_of_the_deepest_path_add_up() {
    let program = program(
        "sei\ncall f\nrjmp .-2\n.type f, @function\nf: push r16\npush r17\ncall g\npop r17\n\
         pop r16\nret\n.type g, @function\ng: push r2\npop r2\nret",
    );
    let stack = stack(&program).unwrap();
    let parts: Vec<(&str, u32)> =
        stack.frames.iter().map(|frame| (frame.function.as_str(), frame.bytes)).collect();
    assert_eq!(parts, [("start", 0), ("f", 4), ("g", 3), ("int0", 2)]);
    assert_eq!(stack.bytes, 9);
    assert_eq!(stack.base, 0x4FF);
}

#[test]
fn a_frame_of_local_variables_counts() {
    let program = program(
        "call f\nrjmp .-2\n.type f, @function\nf: push r28\npush r29\nin r28, 0x3D\n\
         in r29, 0x3E\nsubi r28, 0x2C\nsbci r29, 0x01\nin r0, 0x3F\ncli\nout 0x3E, r29\n\
         out 0x3F, r0\nout 0x3D, r28\nstd Y+1, r24\nsubi r28, 0xD4\nsbci r29, 0xFE\n\
         in r0, 0x3F\ncli\nout 0x3E, r29\nout 0x3F, r0\nout 0x3D, r28\npop r29\npop r28\n\
         ret",
    );
    // The return address, two registers, and 300 bytes.
    assert_eq!(stack(&program).unwrap().bytes, 2 + 2 + 300);
}

/// INT0's handler, which masks itself and lets others interrupt it. It takes a register and the
/// return address.
const NESTING_INT0: &str = "
    .type int0, @function
    int0: cbi 0x1D, 0
    sei
    push r24
    pop r24
    cli
    sbi 0x1D, 0
    reti";

#[test]
fn a_handler_that_masks_itself_can_nest_below_another() {
    let program = assembled(
        "nest",
        &format!(
            "{SET_SP}
             sei
             rjmp .-2
             {NESTING_INT0}"
        ),
    );
    // INT0 with one register, and nothing above it: the other vectors lead to the start.
    assert_eq!(stack(&program).unwrap().bytes, 2 + 1);
}

/// INT0's handler rests on its own mask, and INT1's changes another bit of the same register.
#[test]
fn a_handler_may_mask_itself_beside_one_that_nests() {
    let nesting = |of_int1: &str| {
        assembled(
            "beside",
            &format!(
                "{SET_SP}
                 sei
                 rjmp .-2
                 {NESTING_INT0}
                 .type int1, @function
                 int1: push r24
                 push r24
                 {of_int1}
                 pop r24
                 pop r24
                 reti"
            ),
        )
    };
    assert_eq!(stack(&nesting("cbi 0x1D, 1")).unwrap().bytes, 2 + 1 + 2 + 2);
    for unmasks in ["sbi 0x1D, 0", "ldi r24, 3\n out 0x1D, r24", "andi r24, 0xFD\n out 0x1D, r24"] {
        let text = refusal(stack(&nesting(unmasks)));
        assert!(text.contains("the handler of INT1 at 0x"), "{unmasks}: {text}");
        assert!(text.contains("may enable INT0"), "{unmasks}: {text}");
    }
}

#[test]
fn a_program_without_a_bound_is_refused_with_the_reason() {
    let of_f = |f: &str| program(&format!("call f\nrjmp .-2\n.type f, @function\nf: {f}"));
    let int0 = "sei\nrjmp .-2\n.type int0, @function\nint0: sei\nreti";
    let itself = assembled("self", &format!("{SET_SP}\n{int0}"));
    for (name, program, reasons) in [
        (
            "a hidden recursion",
            of_f("tst r24\nbreq 1f\ndec r24\ncall g\n1: ret\n.type g, @function\ng: rjmp f"),
            ["recursion", ": f -> g -> f"],
        ),
        (
            "a push without a pop on one path",
            of_f("push r16\ntst r24\nbreq 1f\npop r16\n1: ret"),
            ["in f: ", "a push without a pop"],
        ),
        (
            "a computed stack pointer",
            of_f(
                "in r28, 0x3D\nin r29, 0x3E\nsub r28, r24\nsbc r29, r25\nout 0x3E, r29\n\
                 out 0x3D, r28\nret",
            ),
            ["in f: ", "SP is set to a computed value"],
        ),
        ("a handler that does not mask itself", itself, ["INT0", "can interrupt itself"]),
        (
            "code that is no instruction",
            program("nop\n .word 0xFFFF"),
            ["0xffff", "is no instruction of this core"],
        ),
    ] {
        let text = refusal(stack(&program));
        assert!(reasons.iter().all(|reason| text.contains(reason)), "{name}: {text}");
    }
}

#[test]
fn an_indirect_call_needs_an_annotation() {
    let program = program(
        "call f\nrjmp .-2\n.type f, @function\nf: movw r30, r24\nicall\nret\n\
         .type g, @function\ng: push r2\npop r2\nret",
    );
    let text = refusal(stack(&program));
    assert!(text.contains("in f: an indirect call"), "{text}");
    let annotation = "[[indirect]]\nfunction = \"f\"\ntargets = [\"g\"]\nreason = \"a test\"";
    assert_eq!(stack_with(&program, annotation).unwrap().bytes, 2 + 2 + 1);
}

/// Programs of avr-gcc with avr-libc.
#[test]
fn what_changes_sp_or_goes_to_any_address_is_refused_with_its_function() {
    let setjmp = "#include <setjmp.h>
        jmp_buf place; volatile char n;
        int main(void) { for (;;) if (!setjmp(place) && n) longjmp(place, 1); }";
    let alloca = "#include <string.h>
        volatile unsigned char n;
        __attribute__((noinline)) char sum(unsigned char len) {
            char *bytes = __builtin_alloca(len); memset(bytes, 3, len); return bytes[len / 2];
        }
        int main(void) { for (;;) n = sum(n); }";
    let pointer = "typedef void (*step)(void); volatile char n;
        void one(void) { n++; } void two(void) { n--; } step volatile steps[] = { one, two };
        __attribute__((noinline)) void run(void) { steps[n & 1](); }
        int main(void) { for (;;) run(); }";
    for (text, what) in [
        (setjmp, "in setjmp: a pop without a push"),
        (alloca, "in sum: SP is set to a computed value"),
        (pointer, "in run: an indirect jump"),
    ] {
        for optimisation in ["-Os", "-O2"] {
            let text = refusal(stack(&compiled("refused", text, optimisation)));
            assert!(text.contains("0x") && text.contains(what), "{what}: {text}");
        }
    }
}

#[test]
fn an_annotation_needs_a_reason() {
    let annotation = "[[indirect]]\nfunction = \"f\"\ntargets = []\nreason = \" \"";
    let text = refusal(avr_bounds::annotations::Annotations::parse(annotation));
    assert!(text.contains("the annotation of f needs a reason"), "{text}");
}

/// EEPE, which the chip clears.
#[test]
fn what_follows_a_wait_for_the_eeprom_counts() {
    let program = program(
        "sbi 0x1F, 1\n1: sbic 0x1F, 1\nrjmp 1b\ncall f\nrjmp .-2\n.type f, @function\n\
         f: push r16\npop r16\nret",
    );
    assert_eq!(stack(&program).unwrap().bytes, 2 + 1);
}

/// A switch, which avr-gcc compiles to a table of addresses, and a division of libgcc.
#[test]
fn the_jump_table_of_a_switch_is_followed() {
    let program = compiled(
        "switch",
        "#include <stdint.h>
         volatile uint8_t in; volatile uint32_t out, by;
         __attribute__((noinline)) uint32_t deep(uint32_t x) { return x / by; }
         int main(void) {
             for (;;) switch (in) {
                 case 0: out = 1; break;
                 case 1: out = deep(2); break;
                 case 2: out += 7; break;
                 case 3: out = by; break;
                 case 4: by = 3; break;
                 case 5: out ^= 3; break;
                 case 6: out = 11; break;
                 case 7: by = 0; break;
             }
         }",
        "-Os",
    );
    let stack = stack(&program).unwrap();
    let names: Vec<&str> = stack.frames.iter().map(|frame| frame.function.as_str()).collect();
    assert!(names.starts_with(&["start", "main", "deep", "__udivmodsi4"]), "{names:?}");
}

/// Two classes with a base. Which of them an object has, only the RAM tells.
const CLASSES: &str = r#"
    struct Sink {
        virtual char first(char c) = 0;
        virtual char put(char c) = 0;
    };
    struct Shallow : Sink {
        char first(char c) { return c; }
        char put(char c) { return c + 1; }
    };
    struct Deep : Sink {
        char first(char c) { volatile char big[99]; big[0] = c; return big[0]; }
        char put(char c) { volatile char big[30]; big[0] = c; return big[0]; }
    };
    Shallow shallow;
    Deep deep;
    Sink *volatile sink = &shallow;
    volatile char is_deep, result;
    extern "C" void __cxa_pure_virtual() { for (;;) { } }
    int main() {
        if (is_deep) sink = &deep;
        Sink *chosen = sink;
        for (;;) result = chosen->put(result) + 1;
    }
"#;

const CPP: [&str; 3] = ["-Os", "-fno-rtti", "-fno-exceptions"];

#[test]
fn a_virtual_call_leads_to_the_same_place_of_each_table() {
    let program = read(&build("virtual", "cpp", CLASSES, &CPP));
    let stack = stack(&program).unwrap();
    let deepest = stack.frames.last().unwrap();
    assert_eq!(deepest.function, "_ZN4Deep3putEc");
    assert!((30..40).contains(&deepest.bytes), "not that of `first`: {deepest:?}");
}

/// The same instructions, but no table has a symbol.
#[test]
fn a_call_through_a_table_that_is_not_one_of_virtual_functions_is_refused_with_an_annotation() {
    let text = "
        struct table { char (*first)(char); char (*put)(char); };
        struct object { const struct table *table; };
        static char id(char c) { return c; }
        const struct table table = { id, id };
        struct object object = { &table };
        struct object *volatile chosen = &object;
        volatile char result;
        int main(void) { for (;;) result = chosen->table->put(result) + 1; }";
    let program = compiled("table", text, "-Os");
    let refused = refusal(stack(&program));
    assert!(refused.contains("an indirect call whose targets are not known"), "{refused}");
    let at = refused.find("[[indirect]]\nfunction = \"main\"\ntargets = [").expect("an annotation");
    let pasted = refused[at..].replace("each function that it may call", "id");
    let stack = stack_with(&program, &pasted).unwrap();
    assert_eq!(stack.frames.last().unwrap().function, "id");
}
