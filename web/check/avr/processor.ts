// An ATmega168 or ATmega328P for a board of the simulator: avr8js executes the instructions, and
// its ports and ADC serve the pins. Timers, USART, SPI, EEPROM and watchdog are in this directory;
// each file says why avr8js's own is not used. docs/cross-check.md lists all differences.
//
// The class has the methods that web/src/js.rs imports. Times are CPU cycles since power-on; a reset
// does not change them.
//
// Not modelled: SPM (the flash never changes), sleep (SLEEP does nothing), IVSEL, TWI, the
// comparator, CLKPR, PRR.

import {
  AVRADC,
  AVRIOPort,
  CPU,
  adcConfig,
  avrInstruction,
  avrInterrupt,
  portBConfig,
  portCConfig,
  portDConfig,
} from "avr8js";
import { Eeprom, EepromCells } from "./memory";
import * as reg from "./registers";
import { Spi, SpiDevice } from "./spi";
import { TIMER0, TIMER1, TIMER2, Timer, TimerConfig, hookPrescalers } from "./timer";
import { Character, Usart } from "./usart";
import { Watchdog } from "./watchdog";

/** What a board gives a processor: voltages and oscillators. */
export interface Surroundings {
  /** Voltage at an ADC input at this moment, in microvolts. */
  sample(channel: number): number;
  /** Length of the watchdog's next time-out in cycles, for a value of WDTCSR. */
  watchdog(control: number): number;
}

export type PinWatcher = (level: boolean, at: number) => void;

/** States of web/src/js.rs. */
export const enum State {
  Running = 0,
  Crashed = 1,
}

/** Causes of a reset, as bits of MCUSR. */
export const POWER_ON = reg.PORF;

interface Port {
  io: AVRIOPort;
  pin: number;
  /** Pins that are driven from outside, and their levels. */
  driven: number;
  levels: number;
  watchers: { bit: number; level: boolean; call: PinWatcher }[];
}

/** avr8js's PinOverrideMode, which it does not export. */
const OVERRIDE = { none: 0, set: 2, clear: 3 };
/** Port (0 B, 1 C, 2 D) and bit of OCnA and OCnB. */
const OUTPUTS = [
  [[2, 6], [2, 5]],
  [[0, 1], [0, 2]],
  [[0, 3], [2, 3]],
] as const;
const INT_PINS = [2, 3];
const ADIF = 0x10;
const ADSC = 0x40;

export class Processor {
  cpu!: CPU;
  private ports!: Port[];
  private usart!: Usart;
  private readonly program: Uint16Array;
  private readonly flashWords: number;
  private readonly cells: EepromCells;
  private device: SpiDevice | null = null;
  private surroundings: Surroundings = { sample: () => 0, watchdog: () => 256_000 };
  private readonly line: number[] = [];
  private characters: Character[] = [];
  private readonly outputs: (boolean | null)[][] = [[], [], []];
  private readonly edges: number[][] = [[], []];
  private readonly edgeLevels = [false, false];
  private resetBy: number | null = null;

  constructor(
    flash: Uint8Array,
    private readonly ramBytes: number,
    eeprom: Uint8Array,
  ) {
    this.program = new Uint16Array(flash.buffer.slice(flash.byteOffset, flash.byteOffset + flash.length));
    this.flashWords = this.program.length;
    this.cells = new EepromCells(eeprom);
    this.boot(0);
  }

  /** Connects the device on the SPI, the ADC's inputs and the watchdog's oscillator. */
  connect(
    beginByte: SpiDevice["beginByte"],
    endByte: SpiDevice["endByte"],
    sample: Surroundings["sample"],
    watchdog: Surroundings["watchdog"],
  ) {
    this.device = { beginByte, endByte };
    this.surroundings = { sample, watchdog };
  }

  now() {
    return this.cpu.cycles;
  }

  pc() {
    return this.cpu.pc * 2;
  }

  state(): State {
    return this.cpu.pc < this.flashWords ? State.Running : State.Crashed;
  }

  /** Runs until `until`; the last instruction or interrupt entry can end later. */
  runUntil(until: number): State {
    for (;;) {
      const { cpu } = this;
      const { data } = cpu;
      while (cpu.cycles < until) {
        const wasEnabled = data[reg.SREG] & reg.SREG_I;
        const opcode = this.program[cpu.pc];
        avrInstruction(cpu);
        // CBI takes two cycles (section 31, "Instruction Set Summary"); avr8js takes one.
        if ((opcode & 0xff00) === 0x9800) {
          cpu.cycles++;
        }
        let event = cpu["nextClockEvent"];
        while (event !== null && event.cycles <= cpu.cycles) {
          cpu["nextClockEvent"] = event.next;
          event.callback();
          event = cpu["nextClockEvent"];
        }
        // After SEI and RETI one instruction is executed before an interrupt (section 7.7).
        if (cpu.nextInterrupt >= 0 && wasEnabled !== 0 && (data[reg.SREG] & reg.SREG_I) !== 0) {
          this.enterInterrupt();
        }
        if (this.resetBy !== null) {
          break;
        }
      }
      if (this.resetBy === null) {
        return this.state();
      }
      this.reset(this.resetBy);
    }
  }

  /** Resets the chip; `cause` is a bit of MCUSR. */
  reset(cause: number) {
    this.resetBy = null;
    if (cause === POWER_ON) {
      this.cells.programming = null;
    }
    if (this.usart.isSending) {
      this.characters.push({ toChip: false, start: this.now(), cyclesPerBit: 0, levels: 0, bits: 0 });
    }
    const flags = cause === POWER_ON ? 0 : this.cpu.data[reg.MCUSR];
    this.boot(flags | cause);
  }

  pin(port: number, bit: number) {
    const { io, pin, driven, levels } = this.ports[port];
    const mask = 1 << bit;
    if (this.cpu.data[pin + 1] & mask) {
      return (io["lastValue"] & mask) !== 0;
    }
    return driven & mask ? (levels & mask) !== 0 : (this.cpu.data[pin] & mask) !== 0;
  }

  watchPin(port: number, bit: number, call: PinWatcher) {
    this.ports[port].watchers.push({ bit, level: this.pin(port, bit), call });
  }

  /** Drives a pin from outside: 0 low, 1 high, -1 not at all. */
  drivePin(port: number, bit: number, level: number) {
    const it = this.ports[port];
    const mask = 1 << bit;
    it.driven = level < 0 ? it.driven & ~mask : it.driven | mask;
    it.levels = level === 1 ? it.levels | mask : it.levels & ~mask;
    this.applyInputs(it);
    this.notify(it);
  }

  /** Sends bytes to the serial port, back to back, as soon as the receiver is on. */
  sendSerial(bytes: Uint8Array) {
    this.line.push(...bytes);
    this.usart.startReceiving();
  }

  /** Characters since the last call: toChip, start, cyclesPerBit, levels, bits of each. */
  takeSerial() {
    const taken = this.characters;
    this.characters = [];
    return Float64Array.from(
      taken.flatMap((c) => [c.toChip ? 1 : 0, c.start, c.cyclesPerBit, c.levels, c.bits]),
    );
  }

  /** Edges of OC1A (0) or OC1B (1) since the last call: time and level of each. */
  takeEdges(channel: number) {
    return Float64Array.from(this.edges[channel].splice(0));
  }

  /** A byte of the data space, without side effects. */
  peek(address: number) {
    return this.cpu.data[address];
  }

  poke(address: number, value: number) {
    this.cpu.data[address] = value;
  }

  eeprom() {
    return this.cells.bytes;
  }

  private boot(mcusr: number) {
    const before = this.cpu as CPU | undefined;
    const cpu = new CPU(this.program, this.ramBytes);
    if (before) {
      cpu.cycles = before.cycles;
      cpu.data.set(before.data.subarray(0, 0x20));
      cpu.data.set(before.data.subarray(reg.RAMSTART), reg.RAMSTART);
    }
    this.cpu = cpu;
    cpu.data[reg.MCUSR] = mcusr;
    cpu.writeHooks[reg.MCUSR] = (value, old) => {
      cpu.data[reg.MCUSR] = old & value;
      return true;
    };
    this.makePorts();
    this.makeTimers();
    this.makeAdc();
    this.usart = new Usart(cpu, this.line, (character) => this.characters.push(character));
    new Spi(cpu, () => this.device);
    new Eeprom(cpu, this.cells);
    new Watchdog(
      cpu,
      before?.data[reg.WDTCSR] ?? 0,
      (control) => this.surroundings.watchdog(control),
      () => (this.resetBy = reg.WDRF),
    );
    this.ports.forEach((port) => {
      this.applyInputs(port);
      this.notify(port);
    });
  }

  private makePorts() {
    const { cpu } = this;
    const before = this.ports as Port[] | undefined;
    const configs = [portBConfig, portCConfig, portDConfig];
    this.ports = configs.map((config, index) => {
      const io = new AVRIOPort(cpu, config);
      const old = before?.[index];
      const port: Port = {
        io,
        pin: config.PIN,
        driven: old?.driven ?? 0,
        levels: old?.levels ?? 0,
        watchers: old?.watchers ?? [],
      };
      io.addListener(() => {
        this.applyInputs(port);
        this.notify(port);
      });
      return port;
    });
    this.keepMaskedEdges(this.ports[2].io);
  }

  /**
   * avr8js drops an edge of INT0 or INT1 while EIMSK masks it. The chip sets INTFn (section
   * 13.2.3).
   */
  private keepMaskedEdges(io: AVRIOPort) {
    const { data } = this.cpu;
    const original = io["toggleInterrupt"].bind(io);
    io["toggleInterrupt"] = (pin: number, rising: boolean) => {
      original(pin, rising);
      const n = INT_PINS.indexOf(pin);
      if (n >= 0) {
        const sense = (data[reg.EICRA] >> (2 * n)) & 3;
        if (sense === 1 || sense === (rising ? 3 : 2)) {
          data[reg.EIFR] |= 1 << n;
        }
      }
    };
  }

  private makeTimers() {
    const configs: TimerConfig[] = [TIMER0, TIMER1, TIMER2];
    const timers = configs.map((config, index) => {
      this.outputs[index] = [null, null];
      return new Timer(this.cpu, config, (channel, level, at) => {
        if (this.outputs[index][channel] !== level) {
          this.outputs[index][channel] = level;
          const [port, bit] = OUTPUTS[index][channel];
          const mode = level === null ? OVERRIDE.none : level ? OVERRIDE.set : OVERRIDE.clear;
          // Before the port: its listener knows only the end of the instruction.
          this.recordEdges(at);
          this.ports[port].io.timerOverridePin(bit, mode as never);
        }
      });
    });
    hookPrescalers(this.cpu, timers);
  }

  private makeAdc() {
    const { cpu } = this;
    const adc = new AVRADC(cpu, adcConfig);
    adc.onADCRead = (input) => {
      const channel = "channel" in input ? input.channel : null;
      const microvolts = channel === null ? 0 : this.surroundings.sample(channel);
      const reference = adc.referenceVoltageType === 2 ? 1_100_000 : 5_000_000;
      const code = Math.min(Math.floor((microvolts * 1024 + reference / 2) / reference), 1023);
      cpu.addClockEvent(() => adc.completeADCRead(code), adc.sampleCycles);
    };
    // A one clears ADIF (section 24.9.2), which avr8js keeps; a zero does not clear ADSC.
    const original = cpu.writeHooks[reg.ADCSRA];
    cpu.writeHooks[reg.ADCSRA] = (value, old, address, mask) => {
      const kept = old & ~value & ADIF;
      const busy = adc["converting"] ? ADSC : 0;
      original((value & ~ADIF) | busy, old, address, mask);
      cpu.data[reg.ADCSRA] = (value & ~ADIF) | busy | (cpu.data[reg.ADCSRA] & ADSC) | kept;
      if (value & ADIF) {
        cpu.clearInterrupt(adc["ADC"]);
      }
      return true;
    };
  }

  private enterInterrupt() {
    const { cpu } = this;
    const interrupt = cpu["pendingInterrupts"][cpu.nextInterrupt];
    if (interrupt) {
      avrInterrupt(cpu, interrupt.address);
      // Four cycles are the minimum (section 7.7.1); avr8js takes two.
      cpu.cycles += 2;
      if (!interrupt.constant) {
        cpu.clearInterrupt(interrupt);
      }
    }
  }

  /** Gives the inputs of a port their levels: driven from outside, else pulled up, else the last. */
  private applyInputs(port: Port) {
    const { data } = this.cpu;
    const [pins, ddr, latch] = [port.pin, port.pin + 1, port.pin + 2].map((at) => data[at]);
    for (let bit = 0; bit < 8; bit++) {
      const mask = 1 << bit;
      if (!(ddr & mask)) {
        const level =
          port.driven & mask ? port.levels & mask : (latch & mask) | (pins & mask);
        if ((port.io["pinValue"] & mask) !== level) {
          port.io.setPin(bit, level !== 0);
        }
      }
    }
  }

  private notify(port: Port) {
    const index = this.ports.indexOf(port);
    for (const watcher of port.watchers) {
      const level = this.pin(index, watcher.bit);
      if (watcher.level !== level) {
        watcher.level = level;
        watcher.call(level, this.cpu.cycles);
      }
    }
    if (index === 0) {
      this.recordEdges(this.cpu.cycles);
    }
  }

  /** Records the edges of OC1A and OC1B. A pin that is not an output counts as low. */
  private recordEdges(at: number) {
    const { data } = this.cpu;
    for (const channel of [0, 1]) {
      const mask = 2 << channel;
      const latch = this.outputs[1][channel] ?? (data[reg.PINB + 2] & mask) !== 0;
      const level = (data[reg.PINB + 1] & mask) !== 0 && latch;
      if (level !== this.edgeLevels[channel]) {
        this.edgeLevels[channel] = level;
        this.edges[channel].push(at, level ? 1 : 0);
      }
    }
  }
}
