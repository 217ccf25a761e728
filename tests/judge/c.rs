//! Random programs in C: handlers, waits for flags and for enable bits, critical sections, function
//! pointers, recursion, arrays of computed length.

use crate::random::Random;

/// The handlers: avr-libc's name, and the statements that enable and disable the interrupt.
const HANDLERS: [(&str, &str, &str); 6] = [
    ("INT0_vect", "EIMSK |= 1;", "EIMSK &= ~1;"),
    ("INT1_vect", "EIMSK |= 2;", "EIMSK &= ~2;"),
    ("PCINT0_vect", "PCICR |= 1;", "PCICR &= ~1;"),
    ("TIMER0_COMPA_vect", "TIMSK0 |= 2;", "TIMSK0 &= ~2;"),
    ("TIMER1_COMPA_vect", "TIMSK1 |= 2;", "TIMSK1 &= ~2;"),
    ("TIMER2_OVF_vect", "TIMSK2 |= 1;", "TIMSK2 &= ~1;"),
];

/// Conditions for which the main program waits, which handlers can end.
const WAITS: [&str; 6] =
    ["EIMSK & 1", "!(EIMSK & 2)", "TIMSK0 & 2", "!flags[0]", "flags[1] < 3", "GPIOR0 & 4"];

const OPERATORS: [&str; 9] = ["+", "-", "*", "/", "%", "&", "|", "^", ">>"];

const INDIRECT: &str = "
[[indirect]]
function = \"call\"
targets = [\"f0\"]
reason = \"the table has no other\"
";

/// Two kinds of turns: by functions of the program, and by those of libgcc.
const KINDS: &str = "
[[turn]]
kind = \"own\"
calls = [\"f0\", \"f2\"]
[[turn]]
kind = \"libgcc\"
calls = [\"__mulhisi3\", \"__muluhisi3\", \"__umulhisi3\", \"__udivmodqi4\", \"__udivmodhi4\"]
";

/// A program, and the annotations that it needs.
pub struct Source {
    /// The text.
    pub text: String,
    /// A file of annotations.
    pub annotations: String,
}

struct Writer<'a> {
    random: &'a mut Random,
    text: String,
    /// Functions that can be called.
    functions: u64,
    /// Variables of loops that are in use.
    loops: u32,
    is_main: bool,
}

/// A program of this seed.
pub fn program(random: &mut Random) -> Source {
    let mut writer = Writer { random, text: HEAD.into(), functions: 0, loops: 0, is_main: false };
    let functions = 1 + writer.random.below(4);
    for n in 0..functions {
        let recursion = writer.random.percent(4);
        let alloca = writer.random.percent(4);
        writer.line(&format!("NEVER_INLINE uint8_t f{n}(uint8_t x, uint16_t y) {{"));
        if recursion {
            writer.line(&format!("if (x > 3) return f{n}(x / 2, y);"));
        }
        if alloca {
            writer.line("volatile char *p = __builtin_alloca(x & 15); p[0] = x; a[1] = p[0];");
        }
        writer.block(3);
        writer.line("return x + y; }");
        writer.functions = n + 1;
    }
    let has_pointers = writer.random.percent(25);
    if has_pointers {
        writer.line("typedef uint8_t (*function)(uint8_t, uint16_t);");
        writer.line("function volatile pointers[] = { f0, f0 };");
        writer.line("NEVER_INLINE void call(void) { a[0] = pointers[a[2] & 1](a[3], w[0]); }");
    }
    let mut enables = String::new();
    for (vector, enable, disable) in HANDLERS {
        if !writer.random.percent(50) {
            continue;
        }
        enables.push_str(enable);
        writer.line(&format!("ISR({vector}) {{ uint8_t x = a[0]; uint16_t y = w[1];"));
        let nests = writer.random.percent(25);
        if nests {
            writer.line(&format!("{disable} sei();"));
        }
        writer.block(2);
        if nests {
            writer.line(&format!("cli(); {enable}"));
        }
        writer.line("flags[x & 1] += y; }");
    }
    writer.line("int main(void) { uint8_t x = 1; uint16_t y = 3;");
    writer.line("EICRA = 5; PCMSK0 = 255; TCCR0B = 1; TCCR0A = 2; TCCR1B = 9; TCCR2B = 1;");
    let periods = [writer.random.below(200) + 40, writer.random.below(3000) + 60];
    writer.line(&format!("OCR0A = {}; OCR1A = {};", periods[0], periods[1]));
    writer.line(&format!("{enables} sei();"));
    writer.line("for (;;) {");
    writer.is_main = true;
    writer.block(5);
    if has_pointers {
        writer.line("call();");
    }
    writer.line("} }");
    let mut annotations = String::new();
    if has_pointers {
        annotations.push_str(INDIRECT);
    }
    if writer.random.percent(50) {
        annotations.push_str(KINDS);
    }
    Source { text: writer.text, annotations }
}

const HEAD: &str = "
#include <avr/io.h>
#include <avr/interrupt.h>
#include <stdint.h>
#define NEVER_INLINE __attribute__((noinline))
volatile uint8_t a[8], flags[2], bytes[16];
volatile uint16_t w[4];
volatile uint32_t l[2];
";

impl Writer<'_> {
    fn line(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    fn block(&mut self, most: u64) {
        for _ in 0..1 + self.random.below(most) {
            self.statement();
        }
    }

    fn value(&mut self) -> String {
        let n = self.random.below(8);
        match n {
            0..=2 => format!("a[{n}]"),
            3 => format!("w[{}]", self.random.below(4)),
            4 => "x".into(),
            5 => "y".into(),
            6 => "PINC".into(),
            _ => self.random.below(300).to_string(),
        }
    }

    fn expression(&mut self) -> String {
        let (left, right) = (self.value(), self.value());
        match self.random.pick(&OPERATORS) {
            operator @ ("/" | "%") => format!("({left} {operator} ({right} | 1))"),
            ">>" => format!("({left} >> ({right} & 7))"),
            operator => format!("({left} {operator} {right})"),
        }
    }

    fn condition(&mut self) -> String {
        let (left, right) = (self.expression(), self.value());
        let operator = self.random.pick(&["<", ">", "==", "!=", "<=", "&"]);
        format!("({left}) {operator} ({right})")
    }

    fn statement(&mut self) {
        let value = self.expression();
        match self.random.below(16) {
            0 => self.line(&format!("a[{}] = {value};", value.len() % 8)),
            1 => self.line(&format!("w[{}] += {value};", value.len() % 4)),
            2 => self.line(&format!("bytes[({value}) & 15] = x;")),
            3 => self.line(&format!("l[0] = l[1] * {value} / (l[0] | 1);")),
            4 => self.line(&format!("x ^= {value};")),
            5 => self.line("GPIOR0 ^= 4; PORTB |= 2;"),
            6 | 7 => {
                let condition = self.condition();
                self.line(&format!("if ({condition}) {{"));
                self.block(2);
                self.line("} else {");
                self.block(2);
                self.line("}");
            }
            8 | 9 if self.loops < 2 => {
                let i = self.loops;
                self.loops += 1;
                let most = self.random.below(9) + 1;
                let limit = if self.random.percent(50) {
                    most.to_string()
                } else {
                    format!("(a[{}] & 7)", most % 8)
                };
                self.line(&format!("for (uint8_t i{i} = 0; i{i} < {limit}; i{i}++) {{"));
                self.block(2);
                self.line("}");
                self.loops -= 1;
            }
            10 if self.functions > 0 => {
                let callee = self.random.below(self.functions);
                let argument = self.expression();
                self.line(&format!("x += f{callee}({value}, {argument});"));
            }
            11 if self.is_main => {
                let wait = self.random.pick(&WAITS);
                let sets = self.random.pick(&["EIMSK &= ~1", "EIMSK |= 2", "flags[0] = 0", "x++"]);
                self.line(&format!("{sets}; while ({wait}) ;"));
            }
            12 if self.is_main => {
                self.line("cli();");
                self.statement();
                self.line("sei();");
            }
            12 => {
                self.line("{ uint8_t sreg = SREG; cli();");
                self.line(&format!("w[2] = {value}; SREG = sreg; }}"));
            }
            13 => {
                let (_, enable, disable) = self.random.pick(&HANDLERS);
                let text = if self.random.percent(60) { enable } else { disable };
                self.line(if self.is_main || text == disable { text } else { "x++;" });
            }
            14 => {
                self.line(&format!("switch ({value}) {{"));
                for case in 0..2 + self.random.below(6) {
                    self.line(&format!("case {case}: "));
                    self.line(&format!("a[{}] += {case}; break;", case % 8));
                }
                self.line("}");
            }
            15 => {
                let length = self.random.below(40) + 1;
                self.line(&format!("{{ volatile uint8_t local[{length}];"));
                self.line(&format!("for (uint8_t k = 0; k < {length}; k++) local[k] = x + k;"));
                self.line(&format!("a[3] = local[x % {length}]; }}"));
            }
            _ => self.line("x++;"),
        }
    }
}
