//! A port for avr-gdb: GDB's remote serial protocol over TCP, on loopback.
//!
//! The crate `gdbstub` implements the protocol; this file connects it to the AVR. (simavr has its
//! own debugger, but that debugger runs the chip without the bench, and uses a fixed port.) The
//! board is halted at its reset until the first debugger comes; each later one halts it again.
//! While the board is halted, simulated time stops for all boards and the bus.
//!
//! Addresses are those of the AVR tool chain: flash at 0, data space at 0x800000, EEPROM at
//! 0x810000. Flash can be written, so `load` works. The run loop checks the breakpoints, so flash
//! stays as it is and their number has no limit. `step` enters a pending interrupt.
//!
//! Limits: one debugger at a time, others wait; no watchpoints; reading a register of a peripheral
//! has no side effects, so a running counter shows the value that the program last wrote or read.
//!
//! Source: "GDB Remote Serial Protocol", GDB manual appendix E; register numbers from GDB's
//! avr-tdep.c.

use super::Link;
use anyhow::{Context, Result};
use bench::Bench;
use bench::avr::{Debugger, Halt, Registers, Resume};
use gdbstub::arch::{Arch, RegId};
use gdbstub::common::Signal;
use gdbstub::conn::Connection;
use gdbstub::stub::state_machine::GdbStubStateMachine as Session;
use gdbstub::stub::{GdbStub, SingleThreadStopReason};
use gdbstub::target::ext::base::BaseOps;
use gdbstub::target::ext::base::single_register_access::{
    SingleRegisterAccess, SingleRegisterAccessOps,
};
use gdbstub::target::ext::base::singlethread::{
    SingleThreadBase, SingleThreadResume, SingleThreadResumeOps, SingleThreadSingleStep,
    SingleThreadSingleStepOps,
};
use gdbstub::target::ext::breakpoints::{
    Breakpoints, BreakpointsOps, HwBreakpoint, HwBreakpointOps, SwBreakpoint, SwBreakpointOps,
};
use gdbstub::target::{Target, TargetError, TargetResult};
use std::io::{self, ErrorKind, Read};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::num::NonZeroUsize;
use std::time::Duration;

/// Start of the data space and of the EEPROM in the addresses of the AVR tool chain.
const DATA_START: u32 = 0x80_0000;
const EEPROM_START: u32 = 0x81_0000;

/// Sleep in each turn of a halted bench, which would else use the whole host CPU.
const HALTED_PAUSE: Duration = Duration::from_millis(1);
/// Most bytes taken from the debugger in one turn.
const READ_CHUNK: usize = 4096;
/// The session ends when the debugger has left this many bytes of answers unread.
const UNREAD_MAX: usize = 1 << 20;

/// A port for avr-gdb.
pub struct Gdb {
    listener: TcpListener,
    port: u16,
    node: usize,
    chip: Chip,
    session: Option<GdbSession>,
}

type GdbSession = Session<'static, Chip, Client>;

impl Gdb {
    /// Waits for avr-gdb on a TCP port of loopback (0: any free port). `node` is the number of the
    /// board to debug.
    ///
    /// # Errors
    /// If the port is in use.
    pub fn open(port: u16, bench: &mut Bench, node: usize) -> Result<Gdb> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).with_context(|| {
            format!(
                "cannot wait for avr-gdb on TCP port {port}: is it in use? Choose another with \
                 --gdb"
            )
        })?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let debugger = bench.board(node).avr_mut().debugger();
        debugger.halt(Halt::Asked);
        Ok(Gdb {
            listener,
            port,
            node,
            chip: Chip { debugger, flash_writes: Vec::new() },
            session: None,
        })
    }

    /// The TCP port.
    pub fn port(&self) -> u16 {
        self.port
    }

    fn accept(&mut self) {
        let Ok((stream, _)) = self.listener.accept() else {
            return;
        };
        let client = Client { stream, out: Vec::new() };
        if client.stream.set_nonblocking(true).is_err() || client.stream.set_nodelay(true).is_err()
        {
            return;
        }
        self.chip.debugger.halt(Halt::Asked);
        self.session = GdbStub::new(client).run_state_machine(&mut self.chip).ok();
        if self.session.is_none() {
            self.chip.debugger.detach();
        }
    }

    /// Serves a session once. Returns `None` when the session has ended.
    fn serve_session(&mut self, session: GdbSession) -> Option<GdbSession> {
        let mut session = self.report_halt(session)?;
        let mut bytes = [0; READ_CHUNK];
        let count = match client(&mut session).stream.read(&mut bytes) {
            Ok(0) => return None,
            Ok(count) => count,
            Err(error) if is_transient(&error) => 0,
            Err(_) => return None,
        };
        for byte in &bytes[..count] {
            session = match session {
                Session::Idle(idle) => idle.incoming_data(&mut self.chip, *byte).ok()?,
                Session::Running(running) => running.incoming_data(&mut self.chip, *byte).ok()?,
                other => other,
            };
            if let Session::CtrlCInterrupt(interrupt) = session {
                self.chip.debugger.halt(Halt::Asked);
                let reason = SingleThreadStopReason::Signal(Signal::SIGINT);
                session = interrupt.interrupt_handled(&mut self.chip, Some(reason)).ok()?;
            }
            if matches!(session, Session::Disconnected(_)) {
                return None;
            }
        }
        let client = client(&mut session);
        client.send().ok()?;
        (client.out.len() <= UNREAD_MAX).then_some(session)
    }

    /// Reports to a debugger that has resumed the chip that the chip has halted.
    fn report_halt(&mut self, session: GdbSession) -> Option<GdbSession> {
        let Session::Running(running) = session else {
            return Some(session);
        };
        let debugger = &self.chip.debugger;
        if debugger.has_crashed() {
            debugger.halt(Halt::Crashed);
        }
        let reason = match debugger.halted() {
            None => return Some(running.into()),
            Some(Halt::Asked) => SingleThreadStopReason::Signal(Signal::SIGINT),
            Some(Halt::Breakpoint) => SingleThreadStopReason::Signal(Signal::SIGTRAP),
            Some(Halt::Stepped) => SingleThreadStopReason::DoneStep,
            Some(Halt::Crashed) => SingleThreadStopReason::Signal(Signal::SIGILL),
        };
        running.report_stop(&mut self.chip, reason).ok()
    }
}

impl Link for Gdb {
    fn serve(&mut self, bench: &mut Bench) -> Result<()> {
        match self.session.take() {
            None => self.accept(),
            Some(session) => {
                self.session = self.serve_session(session);
                for (address, value) in self.chip.flash_writes.drain(..) {
                    bench.board(self.node).avr_mut().load_flash(address as usize, &[value]);
                }
                if self.session.is_none() {
                    self.chip.debugger.detach();
                }
            }
        }
        if self.chip.debugger.halted().is_some() {
            std::thread::sleep(HALTED_PAUSE);
        }
        Ok(())
    }

    fn status(&self) -> String {
        let what = match (&self.session, self.chip.debugger.halted()) {
            (None, Some(_)) => "halted at reset, waits for avr-gdb",
            (None, None) => "waits for avr-gdb",
            (Some(_), Some(_)) => "halted by avr-gdb",
            (Some(_), None) => "avr-gdb attached",
        };
        format!("gdb localhost:{}: {what}", self.port)
    }
}

impl Drop for Gdb {
    fn drop(&mut self) {
        self.chip.debugger.detach();
    }
}

fn client(session: &mut GdbSession) -> &mut Client {
    match session {
        Session::Idle(state) => state.borrow_conn(),
        Session::Running(state) => state.borrow_conn(),
        Session::CtrlCInterrupt(state) => state.borrow_conn(),
        Session::Disconnected(state) => state.borrow_conn(),
    }
}

fn is_transient(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// The connection to the debugger.
struct Client {
    stream: TcpStream,
    /// Bytes that the socket has not taken yet.
    out: Vec<u8>,
}

impl Client {
    fn send(&mut self) -> io::Result<()> {
        while !self.out.is_empty() {
            match io::Write::write(&mut self.stream, &self.out) {
                Ok(count) => drop(self.out.drain(..count)),
                Err(error) if is_transient(&error) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl Connection for Client {
    type Error = io::Error;

    fn write(&mut self, byte: u8) -> io::Result<()> {
        self.out.push(byte);
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.send()
    }
}

/// GDB's architecture `avr`.
enum AvrArch {}

impl Arch for AvrArch {
    type Usize = u32;
    type Registers = GdbRegisters;
    type BreakpointKind = usize;
    type RegId = Register;
}

/// A register by GDB's number.
#[derive(Debug, Clone, Copy)]
enum Register {
    R(usize),
    Sreg,
    Sp,
    Pc,
}

impl RegId for Register {
    fn from_raw_id(id: usize) -> Option<(Register, Option<NonZeroUsize>)> {
        let (register, bytes) = match id {
            0..32 => (Register::R(id), 1),
            32 => (Register::Sreg, 1),
            33 => (Register::Sp, 2),
            34 => (Register::Pc, 4),
            _ => return None,
        };
        Some((register, NonZeroUsize::new(bytes)))
    }
}

/// Size of all registers together, in bytes.
const REGISTERS_BYTES: usize = 39;

/// All registers, in GDB's order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct GdbRegisters(Registers);

impl gdbstub::arch::Registers for GdbRegisters {
    type ProgramCounter = u32;

    fn pc(&self) -> u32 {
        self.0.pc
    }

    fn gdb_serialize(&self, mut write_byte: impl FnMut(Option<u8>)) {
        let [spl, sph] = self.0.sp.to_le_bytes();
        self.0
            .r
            .into_iter()
            .chain([self.0.sreg, spl, sph])
            .chain(self.0.pc.to_le_bytes())
            .for_each(|byte| {
                write_byte(Some(byte));
            });
    }

    fn gdb_deserialize(&mut self, bytes: &[u8]) -> Result<(), ()> {
        let bytes: &[u8; REGISTERS_BYTES] = bytes.try_into().map_err(drop)?;
        let (r, rest) = bytes.split_at(32);
        self.0.r.copy_from_slice(r);
        self.0.sreg = rest[0];
        self.0.sp = u16::from_le_bytes([rest[1], rest[2]]);
        self.0.pc = u32::from_le_bytes([rest[3], rest[4], rest[5], rest[6]]);
        Ok(())
    }
}

/// The target of gdbstub: the AVR of the board.
struct Chip {
    debugger: Debugger,
    /// Addresses and values that `serve` writes to flash after the turn, when it has the board.
    flash_writes: Vec<(u32, u8)>,
}

impl Chip {
    fn read(&self, address: u32) -> Option<u8> {
        match address {
            0..DATA_START => self.debugger.flash(address),
            DATA_START..EEPROM_START => self.debugger.data(address - DATA_START),
            EEPROM_START.. => self.debugger.eeprom(address - EEPROM_START),
        }
    }

    fn write(&mut self, address: u32, value: u8) -> bool {
        match address {
            0..DATA_START => {
                let exists = (address as usize) < self.debugger.chip().flash_bytes();
                if exists {
                    self.flash_writes.push((address, value));
                }
                exists
            }
            DATA_START..EEPROM_START => self.debugger.set_data(address - DATA_START, value),
            EEPROM_START.. => self.debugger.set_eeprom(address - EEPROM_START, value),
        }
    }

    fn end_of_memory(&self, address: u32) -> u32 {
        let chip = self.debugger.chip();
        match address {
            0..DATA_START => chip.flash_bytes() as u32,
            DATA_START..EEPROM_START => DATA_START + u32::from(chip.ram_end()) + 1,
            EEPROM_START.. => EEPROM_START + chip.eeprom_bytes() as u32,
        }
    }
}

impl Target for Chip {
    type Arch = AvrArch;
    type Error = &'static str;

    fn base_ops(&mut self) -> BaseOps<'_, AvrArch, &'static str> {
        BaseOps::SingleThread(self)
    }

    fn support_breakpoints(&mut self) -> Option<BreakpointsOps<'_, Chip>> {
        Some(self)
    }
}

impl SingleThreadBase for Chip {
    fn read_registers(&mut self, registers: &mut GdbRegisters) -> TargetResult<(), Chip> {
        registers.0 = self.debugger.registers();
        Ok(())
    }

    fn write_registers(&mut self, registers: &GdbRegisters) -> TargetResult<(), Chip> {
        self.debugger.set_registers(&registers.0);
        Ok(())
    }

    fn support_single_register_access(&mut self) -> Option<SingleRegisterAccessOps<'_, (), Chip>> {
        Some(self)
    }

    fn read_addrs(&mut self, start: u32, data: &mut [u8]) -> TargetResult<usize, Chip> {
        let available = self.end_of_memory(start).saturating_sub(start) as usize;
        let count = data.len().min(available);
        for (address, byte) in (start..).zip(&mut data[..count]) {
            *byte = self.read(address).ok_or(TargetError::NonFatal)?;
        }
        if count == 0 { Err(TargetError::NonFatal) } else { Ok(count) }
    }

    fn write_addrs(&mut self, start: u32, data: &[u8]) -> TargetResult<(), Chip> {
        // Writes all bytes or none: after an error the debugger assumes that nothing was written.
        if data.len() > self.end_of_memory(start).saturating_sub(start) as usize {
            return Err(TargetError::NonFatal);
        }
        let written = (start..).zip(data).all(|(address, byte)| self.write(address, *byte));
        if written { Ok(()) } else { Err(TargetError::NonFatal) }
    }

    fn support_resume(&mut self) -> Option<SingleThreadResumeOps<'_, Chip>> {
        Some(self)
    }
}

impl SingleRegisterAccess<()> for Chip {
    fn read_register(
        &mut self,
        (): (),
        register: Register,
        buffer: &mut [u8],
    ) -> TargetResult<usize, Chip> {
        let registers = self.debugger.registers();
        let bytes = match register {
            Register::R(index) => &registers.r[index..=index],
            Register::Sreg => &[registers.sreg][..],
            Register::Sp => &registers.sp.to_le_bytes()[..],
            Register::Pc => &registers.pc.to_le_bytes()[..],
        };
        buffer[..bytes.len()].copy_from_slice(bytes);
        Ok(bytes.len())
    }

    fn write_register(
        &mut self,
        (): (),
        register: Register,
        value: &[u8],
    ) -> TargetResult<(), Chip> {
        let mut registers = self.debugger.registers();
        match (register, value) {
            (Register::R(index), [value]) => registers.r[index] = *value,
            (Register::Sreg, [value]) => registers.sreg = *value,
            (Register::Sp, [low, high]) => registers.sp = u16::from_le_bytes([*low, *high]),
            (Register::Pc, [a, b, c, d]) => registers.pc = u32::from_le_bytes([*a, *b, *c, *d]),
            _ => return Err(TargetError::NonFatal),
        }
        self.debugger.set_registers(&registers);
        Ok(())
    }
}

impl SingleThreadResume for Chip {
    fn resume(&mut self, _signal: Option<Signal>) -> Result<(), &'static str> {
        self.debugger.resume(Resume::Run);
        Ok(())
    }

    fn support_single_step(&mut self) -> Option<SingleThreadSingleStepOps<'_, Chip>> {
        Some(self)
    }
}

impl SingleThreadSingleStep for Chip {
    fn step(&mut self, _signal: Option<Signal>) -> Result<(), &'static str> {
        self.debugger.resume(Resume::Step);
        Ok(())
    }
}

impl Breakpoints for Chip {
    fn support_sw_breakpoint(&mut self) -> Option<SwBreakpointOps<'_, Chip>> {
        Some(self)
    }

    fn support_hw_breakpoint(&mut self) -> Option<HwBreakpointOps<'_, Chip>> {
        Some(self)
    }
}

impl SwBreakpoint for Chip {
    fn add_sw_breakpoint(&mut self, address: u32, _kind: usize) -> TargetResult<bool, Chip> {
        self.add_hw_breakpoint(address, 0)
    }

    fn remove_sw_breakpoint(&mut self, address: u32, _kind: usize) -> TargetResult<bool, Chip> {
        self.remove_hw_breakpoint(address, 0)
    }
}

impl HwBreakpoint for Chip {
    fn add_hw_breakpoint(&mut self, address: u32, _kind: usize) -> TargetResult<bool, Chip> {
        let exists = (address as usize) < self.debugger.chip().flash_bytes();
        if exists {
            self.debugger.set_breakpoint(address);
        }
        Ok(exists)
    }

    fn remove_hw_breakpoint(&mut self, address: u32, _kind: usize) -> TargetResult<bool, Chip> {
        Ok(self.debugger.clear_breakpoint(address))
    }
}
