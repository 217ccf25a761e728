//! The machine on the own engine: the run loop, and the bus on which the core finds the models.

use super::Machine;
use crate::base::{Peripheral, Timer};
use crate::core::{Access, Activity};
use crate::own::Own;
use crate::processor::ResetCause;
use crate::regs;
use avr_core::{Bus, Clock, Spm, Stop};
use sim_base::Cycles;

/// The registers that enable the interrupts whose condition can hold on after their entry, and
/// their bits.
const LEVELS: [(u16, u8); 4] = [
    (regs::UCSR0B, regs::RXCIE0 | regs::UDRIE0),
    (regs::EECR, regs::EERIE),
    (regs::SPMCSR, regs::SPMIE),
    (regs::TWCR, regs::TWIE),
];

/// Erased flash. The manual has no such instruction; the chip takes it for `SBRS r31, 7`, and comes
/// to what is behind it, such as a bootloader. Behind the last word the chip would begin at 0
/// again, which no program means: here it has crashed, so that somebody is told.
const ERASED: u16 = 0xFFFF;

impl Machine {
    /// Runs the program and the peripherals until `until`, or until a debugger halts the chip.
    pub(super) fn run_own(&self, own: &Own, until: Cycles) {
        let mut bus = Registers { machine: self, own };
        if own.cycle() < until {
            own.delay_interrupts();
        }
        while own.cycle() < until {
            own.run_freely();
            let cpu_waits = self.cpu_waits();
            if self.debug.is_watching()
                && (self.debug.is_halted() || !cpu_waits && self.debug.halts(&self.base.core))
            {
                return;
            }
            if !cpu_waits && own.activity() == Activity::Running {
                self.peripherals.nvm.spm.borrow().check_execution(&self.base);
                if self.trace.is_on() && own.activity() == Activity::Running {
                    self.trace.before_instruction(&self.base);
                }
            }
            if cpu_waits || own.activity() == Activity::Crashed || self.clocks_stand() {
                own.skip(until);
            } else {
                match own.run(&mut bus, until) {
                    // If clocks stand now, the next round skips.
                    Ok(Stop::Asleep) if self.stop_clocks() => {}
                    Ok(Stop::Asleep) => own.skip(until),
                    Ok(Stop::Deadline | Stop::Attention) => {}
                    Err(invalid) if invalid.opcode == ERASED => {
                        self.base.note_erased(invalid.address);
                        own.pass_word(invalid.address);
                    }
                    Err(invalid) => {
                        let text = format!("illegal instruction {:#06x}", invalid.opcode);
                        self.base.report_violation(&text);
                        own.set_activity(Activity::Crashed);
                    }
                }
            }
            own.set_stack_mark(self.stack.settle(&self.base, own.stack_mark()));
            while let Some((timer, at)) = own.take_due() {
                self.expire_on_own(own, timer, at);
            }
            let ends = own.runs_singly() || own.cycle() >= until;
            if ends && own.activity() == Activity::Running && !self.cpu_waits() {
                own.enter_interrupt(&mut bus);
            }
        }
    }

    fn expire_on_own(&self, own: &Own, timer: Timer, at: Cycles) {
        match timer {
            Timer::Adc => own.expire_adc(at, |admux| self.adc.borrow_mut().convert(admux)),
            Timer::Watchdog if own.watchdog_expires() => self.reset(ResetCause::Watchdog),
            Timer::Watchdog => {
                self.peripherals.watchdog.borrow_mut().timed_out(&self.base.core);
                own.continue_watchdog(at);
            }
            _ => self.expire(timer, at),
        }
    }
}

/// The I/O registers of a machine, as the core finds them.
struct Registers<'a> {
    machine: &'a Machine,
    own: &'a Own,
}

impl Registers<'_> {
    /// Calls a model in the middle of an instruction.
    #[inline]
    fn call<T>(&self, clock: &mut Clock, model: impl FnOnce(&Machine) -> T) -> T {
        self.own.set_moment(clock.now, clock.instruction());
        let result = model(self.machine);
        clock.now = self.own.cycle();
        if self.own.must_stop() {
            clock.ask_for_attention();
        } else if self.own.has_pending() {
            clock.check_interrupts();
        }
        result
    }
}

impl Bus for Registers<'_> {
    fn read(&mut self, address: u16, clock: &mut Clock) -> u8 {
        if self.machine.plain.get(usize::from(address)) == Some(&true) {
            return self.own.get(address);
        }
        self.call(clock, |machine| {
            if address < regs::RAMSTART {
                return machine.read(address);
            }
            machine.access_beyond_ram(Access::Read, address);
            0
        })
    }

    fn write(&mut self, address: u16, value: u8, clock: &mut Clock) {
        self.call(clock, |machine| {
            if address < regs::RAMSTART {
                machine.write(address, value);
            } else {
                machine.access_beyond_ram(Access::Write, address);
            }
        });
    }

    fn write_bit(&mut self, address: u16, mask: u8, set: bool, clock: &mut Clock) {
        self.call(clock, |machine| {
            let old = machine.read(address);
            machine.write(address, if set { old | mask } else { old & !mask });
        });
    }

    fn take_interrupt(&mut self, _clock: &mut Clock) -> Option<u8> {
        let Machine { base, peripherals, .. } = self.machine;
        if LEVELS.iter().any(|&(control, enables)| self.own.get(control) & enables != 0) {
            peripherals.uart.borrow().request_levels(base);
            peripherals.nvm.interrupt_returns(base);
            peripherals.twi.interrupt_returns(base);
        }
        self.own.take_interrupt()
    }

    fn status_written(&mut self, clock: &mut Clock) {
        self.own.set_moment(clock.now, clock.instruction());
        self.machine.starts.check(&self.machine.base);
    }

    fn load_program_memory(&mut self, z: u16, stored: u8, clock: &mut Clock) -> u8 {
        self.call(clock, |machine| {
            machine.peripherals.nvm.spm.borrow_mut().load(&machine.base, z, stored)
        })
    }

    fn store_program_memory(&mut self, spm: Spm, clock: &mut Clock) {
        self.call(clock, |machine| {
            machine.peripherals.nvm.execute_spm(&machine.base, spm.z, spm.word);
        });
    }

    fn sleep(&mut self, clock: &mut Clock) -> bool {
        self.call(clock, Machine::falls_asleep)
    }

    fn reset_watchdog(&mut self, clock: &mut Clock) {
        self.call(clock, |_| self.own.restart_watchdog());
    }

    fn stack_below_mark(&mut self, sp: u16, is_set_by_hand: bool, clock: &mut Clock) {
        self.machine.stack.lower(clock.now, sp, clock.instruction(), is_set_by_hand);
    }

    fn vector_table(&self) -> u32 {
        if self.own.get(regs::MCUCR) & regs::IVSEL == 0 {
            return 0;
        }
        self.machine.peripherals.nvm.spm.borrow().boot_start() as u32
    }
}
