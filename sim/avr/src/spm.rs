//! Self-programming of the flash by SPM (DS40002061B, chapter 27, "Boot Loader Support"), with the
//! time that it takes.
//!
//! simavr erases and writes pages at once, from any place in the flash. In this model a page erase,
//! a page write and a write of the lock bits take [`PAGE_PROGRAMMING_CYCLES`], and the flash
//! changes at the end. Meanwhile SELFPRGEN reads 1. Programming a page of the read-while-write
//! (RWW) section sets RWWSB. While RWWSB is set, LPM reads 0xFF from that section, and a program
//! that executes there has crashed. SPM with RWWSRE, or a fill of the page buffer, clears RWWSB.
//! Programming a page of the other section (NRWW) halts the CPU. Operations that the datasheet
//! forbids have no effect, and are violations.
//!
//! A reset during an erase or a write leaves the page half programmed, like a loss of power: the
//! datasheet guarantees completion for no kind of reset. Each byte then has its old value, its new
//! value, or a mixture, depending on the chip's seed. Otherwise resets and loss of power do not
//! change flash and lock bits.
//!
//! Limits: a half-programmed cell reads the same each time; a real one may not. LPM ignores the
//! lock bits. Debuggers and the host read the stored flash while RWWSB is set. All fuses except
//! BOOTSZ and BOOTRST are those of Arduinos. SIGRD works on the ATmega168, too, although avr-libc
//! does not define it there.

use super::base::{Base, Timer};
use super::chip::Chip;
use super::core::{Activity, Vector};
use super::regs::{BLBSET, PGERS, PGWRT, RWWSB, RWWSRE, SELFPRGEN, SIGRD, SPMCSR, SPMIE};
use sim_base::Noise;
use sim_base::{Cycles, F_CPU_HZ};

/// > Flash write (Page Erase, Page Write, and write Lock bits by SPM): 3.7 ms to 4.5 ms
/// > ("Programming Time for Flash when
/// > Using SPM")
///
/// The calibrated RC oscillator determines the time. This is the longest one, so that a program
/// that waits less fails, unless [`Silicon`](crate::Silicon) has another.
pub const PAGE_PROGRAMMING_CYCLES: Cycles = F_CPU_HZ * 45 / 10_000;
/// Size of a page in bytes, the same for both chips.
pub const PAGE_BYTES: usize = 128;

const PAGE_WORDS: usize = PAGE_BYTES / 2;
/// > The SELFPRGEN bit will auto-clear upon completion of an SPM instruction, or if no SPM
/// > instruction is executed within
/// > four clock cycles. (SPMCSR)
const SPM_WINDOW_CYCLES: Cycles = 4;
/// > An LPM instruction within three cycles after BLBSET and SELFPRGEN are set [...] (SPMCSR)
const LPM_WINDOW_CYCLES: Cycles = 3;

/// Boot lock bits. If programmed (0), BLB01 protects the application section from SPM, and BLB11
/// the boot section.
const BLB01: u8 = 1 << 2;
const BLB11: u8 = 1 << 4;
/// > The only accessible Lock bits are the Boot Lock bits ("Setting the Boot Loader Lock Bits by
/// > SPM")
const BOOT_LOCK_BITS: u8 = 0b0011_1100;

/// Expires at the end of an erase or a write.
pub(super) const TIMER: Timer = Timer::Spm;

/// State of the EEPROM. While it is written, the program cannot write SPMCSR, and the SPM Ready
/// interrupt waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EepromActivity {
    Idle,
    Writing,
}

/// The action of the next SPM or LPM.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Command {
    FillBuffer,
    ErasePage,
    WritePage,
    EnableRww,
    LockBits,
    Signature,
}

/// Commands by the lower six bits of SPMCSR.
const COMMANDS: [(u8, Command); 6] = [
    (SELFPRGEN, Command::FillBuffer),
    (SELFPRGEN | PGERS, Command::ErasePage),
    (SELFPRGEN | PGWRT, Command::WritePage),
    (SELFPRGEN | RWWSRE, Command::EnableRww),
    (SELFPRGEN | BLBSET, Command::LockBits),
    (SELFPRGEN | SIGRD, Command::Signature),
];

/// A command in SPMCSR that waits for its SPM or LPM.
#[derive(Debug, Clone, Copy)]
struct Armed {
    bits: u8,
    command: Command,
    /// Time of the end of the instruction that wrote SPMCSR.
    since: Cycles,
}

/// The operation that keeps the flash busy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Job {
    /// Byte address of the page.
    Erase(usize),
    /// Byte address of the page.
    Write(usize),
    /// The new lock bits.
    LockBits(u8),
}

/// SPMCSR, the page buffer, the fuses and lock bits that concern SPM, and the operation in
/// progress.
#[derive(Debug)]
pub(super) struct Spm {
    chip: Chip,
    boot_start: usize,
    resets_to_boot: bool,
    lock_bits: u8,
    armed: Option<Armed>,
    job: Option<(Job, Cycles)>,
    rww_is_busy: bool,
    buffer: [u16; PAGE_WORDS],
    /// A bit for each word of the buffer: 1 if the program has filled it.
    filled: u64,
}

impl Spm {
    /// A new chip: the longest boot section, and no programmed lock bits.
    pub fn new(chip: Chip) -> Spm {
        Spm {
            chip,
            boot_start: chip.nrww_start(),
            resets_to_boot: false,
            lock_bits: 0xFF,
            armed: None,
            job: None,
            rww_is_busy: false,
            buffer: [0xFFFF; PAGE_WORDS],
            filled: 0,
        }
    }

    /// Byte address of the boot section.
    pub fn boot_start(&self) -> usize {
        self.boot_start
    }

    /// Sets BOOTSZ by the byte address of the boot section's start.
    pub fn set_boot_start(&mut self, start: usize) {
        assert!(
            self.chip.boot_sections().contains(&start),
            "no boot section begins at {start:#06x}"
        );
        self.boot_start = start;
    }

    /// Sets BOOTRST. If true, the program starts in the boot section after a reset.
    pub fn set_boot_reset(&mut self, resets_to_boot: bool) {
        self.resets_to_boot = resets_to_boot;
    }

    /// The lock bits; 0 is programmed.
    pub fn lock_bits(&self) -> u8 {
        self.lock_bits
    }

    /// True while a page is erased or written, or the lock bits are written.
    pub fn is_busy(&self) -> bool {
        self.job.is_some()
    }

    /// > The CPU is halted during the entire Page Write operation if the NRWW section is addressed.
    /// > (SPMCSR)
    pub fn halts_cpu(&self) -> bool {
        matches!(
            self.job,
            Some((Job::Erase(page) | Job::Write(page), _)) if page >= self.chip.nrww_start()
        )
    }

    /// Checks the program counter before an instruction. Stops a program that executes the RWW
    /// section while RWWSB is set.
    #[inline]
    pub fn check_execution(&self, base: &Base) {
        if !self.rww_is_busy {
            return;
        }
        if (base.core.pc() as usize) < self.chip.nrww_start() {
            base.report_violation(
                "the program executes the RWW section while RWWSB is set: it has crashed",
            );
            base.core.set_activity(Activity::Crashed);
        } else {
            base.core.run_singly();
        }
    }

    /// Handles a reset. A page that is being programmed stays half programmed.
    pub fn reset(&mut self, base: &Base, noise: &mut Noise) {
        let mut half_done = |old: u8, new: u8| match noise.below(3) {
            0 => old,
            1 => new,
            _ => old ^ (old ^ new) & noise.next_u64() as u8,
        };
        match self.job.take() {
            Some((Job::LockBits(new), _)) => self.lock_bits = half_done(self.lock_bits, new),
            Some((job @ (Job::Erase(page) | Job::Write(page)), _)) => {
                self.change_page(base, job, page, half_done);
            }
            None => {}
        }
        self.armed = None;
        self.rww_is_busy = false;
        self.erase_buffer();
    }

    /// Writes SPMCSR.
    pub fn write_control(&mut self, base: &Base, eeprom: EepromActivity, value: u8) {
        let core = &base.core;
        if eeprom == EepromActivity::Writing {
            base.report_violation("SPMCSR is written while the EEPROM is written: no effect");
            return;
        }
        core.set(SPMCSR, core.get(SPMCSR) & !SPMIE | value & SPMIE);
        // While busy, SELFPRGEN reads 1, and a read-modify-write of SPMIE writes it back. That is
        // not a mistake.
        if self.job.is_none() && value & SELFPRGEN != 0 {
            let bits = value & (SIGRD | RWWSRE | BLBSET | PGWRT | PGERS | SELFPRGEN);
            let command =
                COMMANDS.iter().find(|(pattern, _)| *pattern == bits).map(|(_, command)| *command);
            if let Some(command) = command {
                self.armed = Some(Armed { bits, command, since: base.write_time() });
            } else {
                base.report_violation(&format!(
                    "SPMCSR is written with {value:#04x}, which is not a command: no effect"
                ));
            }
            // > If the RWWSRE bit is written while the Flash is being loaded, the Flash load
            // > operation will abort and the data loaded will be lost. (SPMCSR)
            if command == Some(Command::EnableRww) {
                self.erase_buffer();
            }
        }
        self.update(base, eeprom);
    }

    /// Reads SPMCSR.
    pub fn read_control(&self, base: &Base) -> u8 {
        let command = match self.job {
            Some((Job::Erase(_), _)) => SELFPRGEN | PGERS,
            Some((Job::Write(_), _)) => SELFPRGEN | PGWRT,
            Some((Job::LockBits(_), _)) => SELFPRGEN | BLBSET,
            None => self.armed_within(base, SPM_WINDOW_CYCLES).map_or(0, |armed| armed.bits),
        };
        base.core.get(SPMCSR) & SPMIE | command | if self.rww_is_busy { RWWSB } else { 0 }
    }

    /// Executes SPM for the program, with these values of Z and R1:R0.
    pub fn execute(&mut self, base: &Base, eeprom: EepromActivity, z: u16, word: u16) {
        let start = self.boot_start;
        if (base.core.pc() as usize) < start {
            base.report_violation(&format!(
                "SPM outside the boot section, which begins at {start:#06x}: no effect"
            ));
            return;
        }
        if self.is_busy() {
            base.report_violation("SPM while the flash is programmed: no effect");
            return;
        }
        let armed = self.armed_within(base, SPM_WINDOW_CYCLES);
        self.armed = None;
        match armed.map(|armed| armed.command) {
            Some(Command::FillBuffer) => self.fill_buffer(base, z, word),
            Some(Command::ErasePage) => self.start_page(base, z, Job::Erase),
            Some(Command::WritePage) => self.start_page(base, z, Job::Write),
            Some(Command::EnableRww) => self.rww_is_busy = false,
            Some(Command::LockBits) => {
                let [r0, _] = word.to_le_bytes();
                let new = self.lock_bits & (r0 | !BOOT_LOCK_BITS);
                self.start(base, Job::LockBits(new));
            }
            Some(Command::Signature) => base.report_violation("SPM with SIGRD: no effect"),
            None => base.report_violation(
                "SPM without a command in SPMCSR in the four cycles before: no effect",
            ),
        }
        self.update(base, eeprom);
    }

    /// The byte that LPM reads at Z, if the flash has `stored` there.
    pub fn load(&mut self, base: &Base, z: u16, stored: u8) -> u8 {
        let z = usize::from(z);
        match self.armed_within(base, LPM_WINDOW_CYCLES).map(|armed| armed.command) {
            Some(Command::LockBits) => {
                self.armed = None;
                let [low, high, extended] = self.chip.fuses(self.boot_start, self.resets_to_boot);
                return [low, self.lock_bits, extended, high][z % 4];
            }
            Some(Command::Signature) => {
                self.armed = None;
                let [first, second, third] = self.chip.signature();
                // The byte 0x80 between those of the signature is the calibration of the RC
                // oscillator, which is not modelled.
                return [first, 0x80, second, 0xFF, third].get(z).copied().unwrap_or(0xFF);
            }
            _ => {}
        }
        if self.rww_is_busy && z < self.chip.nrww_start() {
            base.report_violation("LPM reads the RWW section while RWWSB is set: it reads 0xFF");
            return 0xFF;
        }
        stored
    }

    /// Ends the operation in progress.
    pub fn finish(&mut self, base: &Base, eeprom: EepromActivity) {
        match self.job {
            Some((job @ (Job::Erase(page) | Job::Write(page)), _)) => {
                self.change_page(base, job, page, |_, new| new);
                // > The temporary buffer will auto-erase after a Page Write operation ("Filling the
                // > Temporary Buffer")
                if matches!(job, Job::Write(_)) {
                    self.erase_buffer();
                }
            }
            Some((Job::LockBits(new), _)) => self.lock_bits = new,
            None => {}
        }
        self.job = None;
        self.update(base, eeprom);
    }

    /// Updates SPMCSR in the data space, for debuggers, and requests the interrupt.
    ///
    /// > The SPM Ready interrupt will be executed as long as the SELFPRGEN bit in the SPMCSR
    /// > Register is cleared. The
    /// > interrupt will not be generated during EEPROM write or SPM. (SPMCSR)
    pub fn update(&self, base: &Base, eeprom: EepromActivity) {
        let control = self.read_control(base);
        base.core.set(SPMCSR, control);
        if control & (SPMIE | SELFPRGEN) == SPMIE && eeprom == EepromActivity::Idle {
            base.core.raise(Vector::SpmReady);
        }
    }

    /// > If the EEPROM is written in the middle of an SPM Page Load operation, all data loaded will
    /// > be lost. ("Filling the
    /// > Temporary Buffer")
    pub fn lose_buffer(&mut self, base: &Base) {
        if self.filled != 0 {
            base.report_violation("an EEPROM write erases the page buffer, which was being filled");
        }
        self.erase_buffer();
    }

    fn erase_buffer(&mut self) {
        self.buffer = [0xFFFF; PAGE_WORDS];
        self.filled = 0;
    }

    fn armed_within(&self, base: &Base, cycles: Cycles) -> Option<Armed> {
        self.armed.filter(|armed| base.now() < armed.since + cycles)
    }

    fn fill_buffer(&mut self, base: &Base, z: u16, word: u16) {
        let index = usize::from(z) / 2 % PAGE_WORDS;
        // > it is not possible to write more than one time to each address without erasing the
        // > temporary buffer. ("Filling
        // > the Temporary Buffer")
        if self.filled >> index & 1 != 0 {
            base.report_violation(&format!(
                "word {index} of the page buffer is filled again: it holds the AND of both"
            ));
        }
        self.buffer[index] &= word;
        self.filled |= 1 << index;
        // > Alternatively the RWWSB bit will automatically be cleared if a page load operation is
        // > initiated. (SPMCSR)
        self.rww_is_busy = false;
    }

    fn start_page(&mut self, base: &Base, z: u16, job: impl Fn(usize) -> Job) {
        let page = usize::from(z) % self.chip.flash_bytes() / PAGE_BYTES * PAGE_BYTES;
        let forbidding = if page < self.boot_start { BLB01 } else { BLB11 };
        if self.lock_bits & forbidding == 0 {
            base.report_violation(&format!(
                "SPM changes the page at {page:#06x}, which the lock bits forbid: no effect"
            ));
            return;
        }
        let job = job(page);
        if job == Job::Write(page) {
            let old = base.core.flash(page..page + PAGE_BYTES);
            let fits = old.iter().zip(self.buffer_bytes()).all(|(old, new)| old & new == new);
            if !fits {
                base.report_violation(&format!(
                    "the page at {page:#06x} is written without an erase: bits only become 0"
                ));
            }
        }
        self.rww_is_busy |= page < self.chip.nrww_start();
        self.start(base, job);
    }

    fn start(&mut self, base: &Base, job: Job) {
        let silicon = base.silicon.get();
        let end = base.now() + silicon.cycles_in_us(silicon.flash_us);
        self.job = Some((job, end));
        base.schedule(TIMER, end);
        // The run loop must check whether the CPU is halted before the next instruction.
        base.core.run_singly();
    }

    /// Sets each byte of a page to the result of `choose` for its old value and its value after the
    /// complete operation.
    fn change_page(
        &self,
        base: &Base,
        job: Job,
        page: usize,
        mut choose: impl FnMut(u8, u8) -> u8,
    ) {
        let old = base.core.flash(page..page + PAGE_BYTES);
        let changed: Vec<u8> = old
            .iter()
            .zip(self.buffer_bytes())
            .map(|(old, buffered)| match job {
                Job::Erase(_) => choose(*old, 0xFF),
                // Without an erase, bits can only become 0.
                _ => choose(*old, old & buffered),
            })
            .collect();
        base.core.write_flash(page, &changed);
    }

    fn buffer_bytes(&self) -> impl Iterator<Item = u8> {
        self.buffer.iter().flat_map(|word| word.to_le_bytes())
    }
}
