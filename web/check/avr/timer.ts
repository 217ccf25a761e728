// Timer/Counter0, 1 and 2 (Atmel 2545 sections 15 to 18), in place of avr8js's AVRTimer.
//
// AVRTimer sets OCnx and OCFnx when the counter reaches OCRnx; the chip does so one timer clock
// later (figures 15-10 and 16-11). It starts the prescaler when the program selects the clock; the
// chip's prescaler runs freely (section 17.2). And it counts every timer clock in an event of its
// own, which takes most of the time of a simulation.
//
// This model advances from one clock that has an effect (match, TOP, BOTTOM) to the next. It sets
// flags and pins at exact times, and the processor sees them at the end of the instruction.
// Not modelled: input capture, external clocks, the asynchronous mode of Timer2.

import type { CPU } from "avr8js";
import { GTCCR } from "./registers";

/** Addresses, bits and vectors of one timer. Word addresses for the vectors. */
export interface TimerConfig {
  bits: 8 | 16;
  dividers: readonly number[];
  TCCRA: number;
  TCCRB: number;
  /** TCCRnC with the bits FOCnx, of 16-bit timers only. */
  TCCRC: number | null;
  TCNT: number;
  OCRA: number;
  OCRB: number;
  ICR: number | null;
  TIFR: number;
  TIMSK: number;
  vectors: { capture: number | null; a: number; b: number; overflow: number };
  /** Bit in GTCCR that resets the prescaler. */
  prescalerReset: number;
}

const SYNCHRONOUS = [0, 1, 8, 64, 256, 1024, 0, 0];
const ASYNCHRONOUS = [0, 1, 8, 32, 64, 128, 256, 1024];

export const TIMER0: TimerConfig = {
  bits: 8,
  dividers: SYNCHRONOUS,
  TCCRA: 0x44,
  TCCRB: 0x45,
  TCCRC: null,
  TCNT: 0x46,
  OCRA: 0x47,
  OCRB: 0x48,
  ICR: null,
  TIFR: 0x35,
  TIMSK: 0x6e,
  vectors: { capture: null, a: 0x1c, b: 0x1e, overflow: 0x20 },
  prescalerReset: 1,
};

export const TIMER1: TimerConfig = {
  bits: 16,
  dividers: SYNCHRONOUS,
  TCCRA: 0x80,
  TCCRB: 0x81,
  TCCRC: 0x82,
  TCNT: 0x84,
  OCRA: 0x88,
  OCRB: 0x8a,
  ICR: 0x86,
  TIFR: 0x36,
  TIMSK: 0x6f,
  vectors: { capture: 0x14, a: 0x16, b: 0x18, overflow: 0x1a },
  prescalerReset: 1,
};

export const TIMER2: TimerConfig = {
  bits: 8,
  dividers: ASYNCHRONOUS,
  TCCRA: 0xb0,
  TCCRB: 0xb1,
  TCCRC: null,
  TCNT: 0xb2,
  OCRA: 0xb3,
  OCRB: 0xb4,
  ICR: null,
  TIFR: 0x37,
  TIMSK: 0x70,
  vectors: { capture: null, a: 0x0e, b: 0x10, overflow: 0x12 },
  prescalerReset: 2,
};

/** How the counter runs, and when OCRnx is updated. */
const enum Kind {
  /** Normal and CTC: OCRnx at once. */
  Plain,
  /** Fast PWM: OCRnx at BOTTOM. */
  Fast,
  /** Phase correct PWM: OCRnx at TOP. */
  Phase,
  /** Phase and frequency correct PWM: OCRnx at BOTTOM. */
  PhaseFrequency,
}

const enum Top {
  Ocra = -1,
  Icr = -2,
}

type Mode = readonly [Kind, number];

/** Table 15-8. Modes 4 and 6 are reserved. */
const MODES_8: readonly Mode[] = [
  [Kind.Plain, 0xff],
  [Kind.Phase, 0xff],
  [Kind.Plain, Top.Ocra],
  [Kind.Fast, 0xff],
  [Kind.Plain, 0xff],
  [Kind.Phase, Top.Ocra],
  [Kind.Plain, 0xff],
  [Kind.Fast, Top.Ocra],
];

/** Table 16-4. Mode 13 is reserved. */
const MODES_16: readonly Mode[] = [
  [Kind.Plain, 0xffff],
  [Kind.Phase, 0xff],
  [Kind.Phase, 0x1ff],
  [Kind.Phase, 0x3ff],
  [Kind.Plain, Top.Ocra],
  [Kind.Fast, 0xff],
  [Kind.Fast, 0x1ff],
  [Kind.Fast, 0x3ff],
  [Kind.PhaseFrequency, Top.Icr],
  [Kind.PhaseFrequency, Top.Ocra],
  [Kind.Phase, Top.Icr],
  [Kind.Phase, Top.Ocra],
  [Kind.Plain, Top.Icr],
  [Kind.Plain, 0xffff],
  [Kind.Fast, Top.Icr],
  [Kind.Fast, Top.Ocra],
];

/** Bits of TIFRn and TIMSKn. */
const TOV = 1 << 0;
const OCFA = 1 << 1;
const OCFB = 1 << 2;
const ICF = 1 << 5;

/** Receives the level of OCnA (0) or OCnB (1), and null while the pin is the port's. */
export type OutputListener = (channel: 0 | 1, level: boolean | null, at: number) => void;

interface Interrupt {
  address: number;
  flagRegister: number;
  flagMask: number;
  enableRegister: number;
  enableMask: number;
}

export class Timer {
  private count = 0;
  private down = false;
  /** A write of TCNTn blocks the compare match of the next timer clock (section 15.7.2). */
  private matchBlocked = false;
  private prescalerStart: number;
  /** Time of the next timer clock. */
  private nextTick = Infinity;
  private divider = 0;
  private temp = 0;
  private icr = 0;
  /** The registers that the comparator uses, and the buffers that the program writes. */
  private readonly ocr = [0, 0];
  private readonly buffer = [0, 0];
  private readonly latch = [false, false];
  private mode: Mode;
  private readonly max: number;
  private readonly interrupts: Record<number, Interrupt> = {};
  private readonly wake = () => this.sync();

  constructor(
    private readonly cpu: CPU,
    private readonly config: TimerConfig,
    private readonly output: OutputListener,
  ) {
    this.prescalerStart = cpu.cycles;
    this.max = config.bits === 16 ? 0xffff : 0xff;
    this.mode = this.modes[0];
    const { vectors, TIFR, TIMSK } = config;
    const add = (flag: number, address: number | null) => {
      if (address !== null) {
        this.interrupts[flag] = {
          address,
          flagRegister: TIFR,
          flagMask: flag,
          enableRegister: TIMSK,
          enableMask: flag,
        };
      }
    };
    add(TOV, vectors.overflow);
    add(OCFA, vectors.a);
    add(OCFB, vectors.b);
    add(ICF, vectors.capture);
    this.hook();
  }

  /** Resets the prescaler (GTCCR, section 17.2). */
  resetPrescaler(gtccr: number) {
    if (gtccr & this.config.prescalerReset) {
      const at = this.writeTime();
      this.sync(at);
      this.prescalerStart = at;
      this.nextTick = this.divider ? at + this.divider : Infinity;
      this.schedule();
    }
  }

  /** A write takes effect at the clock edge that ends OUT (one cycle) or a store (two). */
  private writeTime() {
    const { cpu } = this;
    const isOut = (cpu.progMem[cpu.pc] & 0xf800) === 0xb800;
    return cpu.cycles + (isOut ? 1 : 2);
  }

  private get modes() {
    return this.config.bits === 16 ? MODES_16 : MODES_8;
  }

  private get top() {
    const top = this.mode[1];
    return top === Top.Ocra ? this.ocr[0] : top === Top.Icr ? this.icr : top;
  }

  private com(channel: 0 | 1) {
    return (this.cpu.data[this.config.TCCRA] >> (6 - 2 * channel)) & 3;
  }

  /** True if OCnx overrides the port (tables 15-2 to 15-7 and 16-1 to 16-3). */
  private isConnected(channel: 0 | 1) {
    const com = this.com(channel);
    if (com !== 1 || this.mode[0] === Kind.Plain) {
      return com !== 0;
    }
    // Toggling in a PWM mode: OCnA only, and only in modes in which OCRnA or ICRn is TOP.
    const wgm = this.modes.indexOf(this.mode);
    return channel === 0 && (this.config.bits === 8 ? wgm >= 5 : [9, 11, 14, 15].includes(wgm));
  }

  private hook() {
    const { cpu, config } = this;
    const { writeHooks, readHooks, data } = cpu;
    const wide = config.bits === 16;
    const own = (address: number, write: (value: number) => void) => {
      writeHooks[address] = (value) => {
        this.sync(this.writeTime());
        write(value);
        this.report(this.writeTime());
        this.schedule();
        return true;
      };
    };
    const word = (low: number) => (wide ? (this.temp << 8) | low : low);
    own(config.TCCRA, (value) => {
      data[config.TCCRA] = value;
      this.configure();
    });
    own(config.TCCRB, (value) => {
      // FOCnx reads as zero (section 15.9.2).
      data[config.TCCRB] = wide ? value : value & 0x3f;
      this.configure();
      if (!wide) {
        this.forceCompare(value);
      }
    });
    if (config.TCCRC !== null) {
      own(config.TCCRC, (value) => this.forceCompare(value));
    }
    own(config.TCNT, (value) => {
      this.count = word(value);
      this.matchBlocked = true;
    });
    [config.OCRA, config.OCRB].forEach((address, channel) => {
      own(address, (value) => {
        this.buffer[channel] = word(value);
        data[address] = value;
        if (wide) {
          data[address + 1] = this.temp;
        }
        if (this.mode[0] === Kind.Plain) {
          this.ocr[channel] = this.buffer[channel];
        }
      });
      if (wide) {
        own(address + 1, (value) => (this.temp = value));
      }
    });
    const icr = config.ICR;
    if (icr !== null) {
      // ICR1 can only be written in a mode that takes TOP from it (section 16.6).
      own(icr, (value) => {
        if (this.mode[1] === Top.Icr) {
          this.icr = word(value);
          data[icr] = value;
          data[icr + 1] = this.temp;
        }
      });
      own(icr + 1, (value) => (this.temp = value));
    }
    if (wide) {
      own(config.TCNT + 1, (value) => (this.temp = value));
      readHooks[config.TCNT + 1] = () => this.temp;
    }
    readHooks[config.TCNT] = () => {
      this.sync();
      this.temp = this.count >> 8;
      return this.count & 0xff;
    };
    readHooks[config.TIFR] = () => {
      this.sync();
      return data[config.TIFR];
    };
    own(config.TIFR, (value) => {
      for (const interrupt of Object.values(this.interrupts)) {
        cpu.clearInterruptByFlag(interrupt, value);
      }
    });
    own(config.TIMSK, (value) => {
      data[config.TIMSK] = value;
      for (const interrupt of Object.values(this.interrupts)) {
        cpu.updateInterruptEnable(interrupt, value);
      }
    });
  }

  private configure() {
    const { data } = this.cpu;
    const at = this.writeTime();
    const { TCCRA, TCCRB, bits, dividers } = this.config;
    const wgm = ((data[TCCRB] >> 1) & (bits === 16 ? 12 : 4)) | (data[TCCRA] & 3);
    this.mode = this.modes[wgm];
    const divider = dividers[data[TCCRB] & 7];
    if (divider !== this.divider) {
      this.divider = divider;
      const phase = divider ? (at - this.prescalerStart) % divider : 0;
      this.nextTick = divider ? at + divider - phase : Infinity;
    }
    if (this.mode[0] === Kind.Plain || this.mode[0] === Kind.Fast) {
      this.down = false;
    }
    if (this.mode[0] === Kind.Plain) {
      this.load();
    }
  }

  private load() {
    this.ocr[0] = this.buffer[0];
    this.ocr[1] = this.buffer[1];
  }

  /** FOCnx, which works only in modes that are not PWM (section 15.7.2). */
  private forceCompare(value: number) {
    if (this.mode[0] === Kind.Plain) {
      if (value & 0x80) {
        this.change(0, false);
      }
      if (value & 0x40) {
        this.change(1, false);
      }
    }
  }

  /** Performs the timer clocks up to now. */
  private sync(now = this.cpu.cycles) {
    if (this.nextTick > now) {
      return;
    }
    const { divider } = this;
    while (this.nextTick <= now) {
      const available = Math.floor((now - this.nextTick) / divider) + 1;
      const skipped = Math.min(available, this.quietTicks());
      if (skipped > 0) {
        this.count += this.down ? -skipped : skipped;
        this.nextTick += skipped * divider;
      } else {
        this.tick();
        this.report(this.nextTick);
        this.nextTick += divider;
      }
    }
    this.schedule();
  }

  /** Wakes the timer at its next clock that has an effect, if an interrupt or a pin shows it. */
  private schedule() {
    const { cpu } = this;
    cpu.clearClockEvent(this.wake);
    const isSeen =
      cpu.data[this.config.TIMSK] !== 0 || (cpu.data[this.config.TCCRA] & 0xf0) !== 0;
    if (this.divider !== 0 && isSeen) {
      const at = this.nextTick + this.quietTicks() * this.divider;
      cpu.addClockEvent(this.wake, at - cpu.cycles);
    }
  }

  /** Number of timer clocks that only count, before one that matches, wraps or turns. */
  private quietTicks() {
    if (this.matchBlocked) {
      return 0;
    }
    const { count, ocr, top, max } = this;
    const [kind] = this.mode;
    if (this.down) {
      let stop = 0;
      for (const value of ocr) {
        if (value <= count && value > stop) {
          stop = value;
        }
      }
      return count - stop;
    }
    const phase = kind === Kind.Phase || kind === Kind.PhaseFrequency;
    if (phase && count >= top) {
      return 0;
    }
    let stop = max;
    for (const value of [ocr[0], ocr[1], top]) {
      if (value >= count && value < stop) {
        stop = value;
      }
    }
    return stop - count;
  }

  private tick() {
    const { count, top, max, ocr } = this;
    const [kind, source] = this.mode;
    const blocked = this.matchBlocked;
    this.matchBlocked = false;
    const a = !blocked && ocr[0] === count;
    const b = !blocked && ocr[1] === count;
    if (kind === Kind.Plain) {
      if (a) {
        this.change(0, false);
      }
      if (b) {
        this.change(1, false);
      }
      const clears = count === top && !(blocked && source === Top.Ocra);
      if (count === max) {
        this.raise(TOV);
      }
      this.captureAtTop(clears);
      this.count = clears || count === max ? 0 : count + 1;
    } else if (kind === Kind.Fast) {
      const wraps = count === top || count === max;
      this.fastOutput(0, a, wraps);
      this.fastOutput(1, b, wraps);
      if (wraps) {
        this.load();
        this.raise(TOV);
        this.captureAtTop(count === top);
      }
      this.count = wraps ? 0 : count + 1;
    } else {
      this.turn(count, top, kind);
      if (a) {
        this.change(0, this.down);
      }
      if (b) {
        this.change(1, this.down);
      }
      const next = this.down ? Math.max(count - 1, 0) : Math.min(count + 1, Math.max(top, 1));
      this.count = top === 0 ? 0 : next;
    }
    if (a) {
      this.raise(OCFA);
    }
    if (b) {
      this.raise(OCFB);
    }
  }

  /** Turns a counter of a phase correct mode at TOP and at BOTTOM. */
  private turn(count: number, top: number, kind: Kind) {
    if (this.down ? count !== 0 : count < top) {
      return;
    }
    this.down = !this.down;
    if (this.down === (kind === Kind.Phase)) {
      this.load();
    }
    if (this.down) {
      this.captureAtTop(true);
    } else {
      this.raise(TOV);
    }
  }

  private captureAtTop(isTop: boolean) {
    if (isTop && this.mode[1] === Top.Icr) {
      this.raise(ICF);
    }
  }

  private raise(flag: number) {
    this.cpu.setInterruptFlag(this.interrupts[flag]);
  }

  private fastOutput(channel: 0 | 1, matches: boolean, wraps: boolean) {
    const com = this.com(channel);
    if (com === 1 && matches) {
      this.latch[channel] = !this.latch[channel];
    } else if (com >= 2 && wraps) {
      this.latch[channel] = com === 2;
    } else if (com >= 2 && matches) {
      this.latch[channel] = com === 3;
    }
  }

  /** Toggles, clears or sets an output. `inverted`, while counting down, exchanges the two. */
  private change(channel: 0 | 1, inverted: boolean) {
    const com = this.com(channel);
    if (com === 1) {
      this.latch[channel] = !this.latch[channel];
    } else if (com >= 2) {
      this.latch[channel] = (com === 2) === inverted;
    }
  }

  private report(at = this.cpu.cycles) {
    this.output(0, this.isConnected(0) ? this.latch[0] : null, at);
    this.output(1, this.isConnected(1) ? this.latch[1] : null, at);
  }
}

/** Lets writes of GTCCR reset the prescalers. TSM is not modelled. */
export function hookPrescalers(cpu: CPU, timers: readonly Timer[]) {
  cpu.writeHooks[GTCCR] = (value) => {
    timers.forEach((timer) => timer.resetPrescaler(value));
    return true;
  };
}
