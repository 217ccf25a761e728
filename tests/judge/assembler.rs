//! Random programs in assembler: handlers that save some registers and flags or none, waits for
//! registers, flags and enable bits, tables of vectors of any form.

use crate::random::Random;

/// Enable bits: the vector, its register in the data space, and the bit.
const INTERRUPTS: [(usize, u16, u8); 6] =
    [(1, 0x3D, 0), (2, 0x3D, 1), (3, 0x68, 0), (14, 0x6E, 1), (11, 0x6F, 1), (9, 0x70, 0)];

/// Instructions of two registers, of one register, and of a register from 16 on and a constant.
const TWO: [&str; 12] =
    ["add", "adc", "sub", "sbc", "and", "or", "eor", "mov", "cp", "cpc", "mul", "cpse"];
const ONE: [&str; 8] = ["com", "neg", "swap", "inc", "dec", "asr", "lsr", "ror"];
const WITH_CONSTANT: [&str; 7] = ["cpi", "sbci", "subi", "ori", "andi", "ldi", "ldi"];

struct Writer<'a> {
    random: &'a mut Random,
    text: String,
    labels: u32,
    functions: u64,
    /// Enable bits that a handler may set.
    is_handler: bool,
    /// Bytes that were pushed.
    pushed: u32,
}

/// A program of this seed.
pub fn program(random: &mut Random) -> String {
    let mut writer = Writer {
        random,
        text: String::new(),
        labels: 0,
        functions: 0,
        is_handler: false,
        pushed: 0,
    };
    let used: Vec<(usize, u16, u8)> =
        INTERRUPTS.into_iter().filter(|_| writer.random.percent(50)).collect();
    writer.vectors(&used);
    let functions = writer.random.below(4);
    for n in 0..functions {
        writer.line(&format!(".type f{n}, @function"));
        writer.line(&format!("f{n}:"));
        writer.block(6);
        writer.line("ret");
        writer.functions = n + 1;
    }
    writer.is_handler = true;
    for (vector, register, bit) in &used {
        writer.line(&format!(".type handler{vector}, @function"));
        writer.line(&format!("handler{vector}:"));
        writer.handler(*register, *bit);
    }
    writer.is_handler = false;
    writer.main(&used);
    writer.text
}

impl Writer<'_> {
    fn line(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    fn label(&mut self) -> String {
        self.labels += 1;
        format!(".L{}", self.labels)
    }

    /// A table with a jump for each handler. The others return, or lead to the start.
    fn vectors(&mut self, used: &[(usize, u16, u8)]) {
        self.line(".text\n.global start\n.type start, @function\n jmp start");
        let rest = self.random.pick(&["reti\n nop", "jmp start", "jmp other"]);
        for vector in 1..26 {
            if used.iter().any(|(own, ..)| *own == vector) {
                let jump = self.random.pick(&["jmp", "jmp", "rjmp"]);
                self.line(&format!(" {jump} handler{vector}"));
                if jump == "rjmp" {
                    self.line(" nop");
                }
            } else {
                self.line(&format!(" {rest}"));
            }
        }
        self.line(".type other, @function\nother: reti");
    }

    fn register(&mut self) -> u64 {
        // Few, so that the parts of a program meet.
        self.random.pick(&[0, 1, 2, 16, 17, 18, 19, 20, 24, 25])
    }

    fn high_register(&mut self) -> u64 {
        self.random.pick(&[16, 17, 18, 19, 20, 24, 25])
    }

    fn block(&mut self, most: u64) {
        for _ in 0..1 + self.random.below(most) {
            self.statement(2);
        }
    }

    fn statement(&mut self, depth: u32) {
        let (d, r, high) = (self.register(), self.register(), self.high_register());
        let k = self.random.pick(&[0, 1, 2, 3, 7, 8, 16, 127, 128, 200, 255]);
        match self.random.below(22) {
            0..=3 => {
                let op = self.random.pick(&TWO);
                self.line(&format!(" {op} r{d}, r{r}"));
            }
            4..=5 => {
                let op = self.random.pick(&ONE);
                self.line(&format!(" {op} r{d}"));
            }
            6..=8 => {
                let op = self.random.pick(&WITH_CONSTANT);
                self.line(&format!(" {op} r{high}, {k}"));
            }
            9 => {
                let flag = self.random.below(7);
                let op = self.random.pick(&["bset", "bclr"]);
                self.line(&format!(" {op} {flag}"));
            }
            10 => {
                let op = self.random.pick(&["adiw", "sbiw"]);
                let pair = self.random.pick(&[24, 26, 28]);
                self.line(&format!(" {op} r{pair}, {}", k % 64));
            }
            11 => {
                let address = 0x100 + self.random.below(16);
                let text = if self.random.percent(50) {
                    format!(" lds r{d}, {address}")
                } else {
                    format!(" sts {address}, r{d}")
                };
                self.line(&text);
            }
            12 => {
                let source = self.random.pick(&["in r{}, 3", "in r{}, 6", "in r{}, 0x1E"]);
                self.line(&format!(" {}", source.replace("{}", &d.to_string())));
            }
            13 => {
                // A byte of the RAM of which only the page is known.
                self.line(&format!(" mov r26, r{d}\n ldi r27, 2"));
                let op = self.random.pick(&["st X, r{}", "st X+, r{}", "ld r{}, X"]);
                self.line(&format!(" {}", op.replace("{}", &r.to_string())));
            }
            14 if depth > 0 => {
                let (flag, label) = (self.random.below(7), self.label());
                let branch = self.random.pick(&["brbs", "brbc"]);
                self.line(&format!(" {branch} {flag}, {label}"));
                self.statement(depth - 1);
                self.line(&format!("{label}:"));
            }
            15 if depth > 0 => {
                let (bit, label) = (self.random.below(8), self.label());
                let skip = self.random.pick(&["sbrc", "sbrs"]);
                self.line(&format!(" {skip} r{d}, {bit}\n rjmp {label}"));
                self.statement(depth - 1);
                self.line(&format!("{label}:"));
            }
            16 if depth > 0 => {
                let label = self.label();
                let rounds = self.random.below(20) + 1;
                self.line(&format!(" ldi r{high}, {rounds}\n{label}:"));
                self.statement(depth - 1);
                self.line(&format!(" dec r{high}\n brne {label}"));
            }
            17 => {
                self.line(&format!(" push r{d}"));
                self.pushed += 1;
                self.statement(depth.saturating_sub(1));
                self.pushed -= 1;
                self.line(&format!(" pop r{r}"));
            }
            18 if self.functions > 0 => {
                let callee = self.random.below(self.functions);
                let call = self.random.pick(&["call", "rcall"]);
                self.line(&format!(" {call} f{callee}"));
            }
            19 => {
                let (_, register, bit) = self.random.pick(&INTERRUPTS);
                let is_set = !self.is_handler && self.random.percent(60);
                self.enable(register, bit, is_set, high);
            }
            20 => {
                let alias = self.random.below(26);
                self.line(&format!(" sts {alias}, r{d}"));
            }
            21 => self.line(&format!(" bst r{d}, {}\n bld r{r}, {}", k % 8, k / 8 % 8)),
            _ => self.line(" nop"),
        }
    }

    /// Sets or clears an enable bit, in one of several ways.
    fn enable(&mut self, register: u16, bit: u8, is_set: bool, high: u64) {
        if register == 0x3D && self.random.percent(70) {
            let op = if is_set { "sbi" } else { "cbi" };
            return self.line(&format!(" {op} 0x1D, {bit}"));
        }
        let mask = 1u8 << bit;
        let change = if is_set {
            format!("ori r{high}, {mask}")
        } else {
            format!("andi r{high}, {}", !mask)
        };
        self.line(&format!(" lds r{high}, {register}\n {change}\n sts {register}, r{high}"));
    }

    fn handler(&mut self, register: u16, bit: u8) {
        // None, the flags, or all registers that the program uses.
        let saves = self.random.below(3);
        let saved: &[u64] = &[0, 1, 2, 16, 17, 18, 19, 20, 24, 25, 26, 27, 28, 29];
        if saves > 0 {
            self.line(" push r23\n in r23, 0x3F");
        }
        if saves > 1 {
            saved.iter().for_each(|r| self.line(&format!(" push r{r}")));
        }
        let nests = register == 0x3D && self.random.percent(30);
        if nests {
            self.line(&format!(" cbi 0x1D, {bit}\n sei"));
        }
        self.block(5);
        if nests {
            self.line(&format!(" cli\n sbi 0x1D, {bit}"));
        }
        if self.random.percent(20) {
            let (_, register, bit) = self.random.pick(&INTERRUPTS[2..]);
            self.enable(register, bit, true, 18);
        }
        if saves > 1 {
            saved.iter().rev().for_each(|r| self.line(&format!(" pop r{r}")));
        }
        if saves > 0 {
            self.line(" out 0x3F, r23\n pop r23");
        }
        self.line(" reti");
    }

    fn main(&mut self, used: &[(usize, u16, u8)]) {
        self.line("start:\n ldi r28, 0xFF\n ldi r29, 4\n out 0x3E, r29\n out 0x3D, r28");
        let periods = [self.random.below(200) + 40, self.random.below(200) + 40];
        // Any edge; all pins; the clock of the core for the timers.
        for (register, value) in [
            (0x69, 5),
            (0x6B, 255),
            (0x44, 2),
            (0x45, 1),
            (0x47, periods[0]),
            (0x81, 9),
            (0x89, 0),
            (0x88, periods[1]),
            (0xB1, 1),
        ] {
            self.line(&format!(" ldi r16, {value}\n sts {register}, r16"));
        }
        for (_, register, bit) in used {
            self.enable(*register, *bit, true, 16);
        }
        self.line(" sei\nturn:");
        for _ in 0..1 + self.random.below(4) {
            self.block(3);
            if self.random.percent(50) {
                self.wait();
            }
            if self.random.percent(30) {
                self.line(" cli");
                self.statement(1);
                self.line(" sei");
            }
        }
        self.line(" rjmp turn");
    }

    /// A wait that a handler may end: for a register, a flag, or an enable bit.
    fn wait(&mut self) {
        let (label, high) = (self.label(), self.high_register());
        let (flag, bit) = (self.random.below(7), self.random.below(2));
        match self.random.below(5) {
            0 => self.line(&format!(" ldi r{high}, 1\n{label}: cpi r{high}, 1\n breq {label}")),
            1 => self.line(&format!(" bclr {flag}\n{label}: brbc {flag}, {label}")),
            2 => self.line(&format!(" cbi 0x1D, {bit}\n{label}: sbis 0x1D, {bit}\n rjmp {label}")),
            3 => self.line(&format!(" sbi 0x1D, {bit}\n{label}: sbic 0x1D, {bit}\n rjmp {label}")),
            _ => self.line(&format!("{label}: lds r{high}, 0x102\n tst r{high}\n brne {label}")),
        }
    }
}
